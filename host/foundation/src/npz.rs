//! Arrays for NumPy: `.npz`, a ZIP archive of `.npy` files.
//!
//! Sources: NumPy Enhancement Proposal 1 (`.npy`, version 1.0); PKWARE's APPNOTE 6.3 (ZIP). The entries are stored, not
//! compressed, so that `numpy.load(mmap_mode=...)` and plain readers alike take them; no archive above 4 GiB is written.

use std::io::{self, Write};

/// A number as NumPy stores it.
pub trait Element: Copy {
    /// NumPy's name of the type, little endian.
    const DESCR: &'static str;
    /// Appends its bytes.
    fn append(self, to: &mut Vec<u8>);
}

macro_rules! element {
    ($($type:ty => $descr:literal),*) => {$(
        impl Element for $type {
            const DESCR: &'static str = $descr;
            fn append(self, to: &mut Vec<u8>) {
                to.extend_from_slice(&self.to_le_bytes());
            }
        }
    )*};
}

element!(f32 => "<f4", f64 => "<f8", i32 => "<i4");

/// An archive that is being written.
#[derive(Debug)]
pub struct NpzWriter<W> {
    to: W,
    entries: Vec<Entry>,
    written: usize,
}

#[derive(Debug)]
struct Entry {
    name: String,
    crc32: u32,
    bytes: usize,
    offset: usize,
}

impl<W: Write> NpzWriter<W> {
    /// An empty archive.
    pub fn new(to: W) -> Self {
        Self {
            to,
            entries: Vec::new(),
            written: 0,
        }
    }

    /// Adds an array of `shape`, its last axis the fastest, under a name of its own.
    ///
    /// # Errors
    /// What the writer says; [`io::ErrorKind::InvalidInput`] where the values are not as many as the shape has, the name is
    /// taken or no ASCII, or the archive grows beyond 4 GiB.
    pub fn array<T: Element>(
        &mut self,
        name: &str,
        shape: &[usize],
        values: &[T],
    ) -> io::Result<()> {
        let invalid = |what: String| io::Error::new(io::ErrorKind::InvalidInput, what);
        let expected: usize = shape.iter().product();
        if values.len() != expected {
            return Err(invalid(format!(
                "array \"{name}\" has {} values, its shape {shape:?} asks for {expected}",
                values.len()
            )));
        }
        let taken = self.entries.iter().any(|entry| entry.name == name);
        if taken || name.is_empty() || !name.is_ascii() {
            return Err(invalid(format!(
                "\"{name}\" is no name for an array: ASCII, each once, is needed"
            )));
        }
        let mut npy = npy_header::<T>(shape);
        for value in values {
            value.append(&mut npy);
        }
        let entry = Entry {
            name: name.to_owned(),
            crc32: crc32fast::hash(&npy),
            bytes: npy.len(),
            offset: self.written,
        };
        if u32::try_from(self.written + npy.len()).is_err() || self.entries.len() >= 0xFFFF {
            return Err(invalid(format!("array \"{name}\" does not fit into 4 GiB")));
        }
        let mut header = vec![];
        header.extend_from_slice(b"PK\x03\x04");
        entry.append_common(&mut header);
        header.extend_from_slice(entry.file_name().as_bytes());
        self.write(&header)?;
        self.write(&npy)?;
        self.entries.push(entry);
        Ok(())
    }

    /// Writes the archive's directory and gives the writer back.
    ///
    /// # Errors
    /// What the writer says.
    pub fn finish(mut self) -> io::Result<W> {
        let start = self.written;
        let mut directory = Vec::new();
        for entry in &self.entries {
            directory.extend_from_slice(b"PK\x01\x02");
            directory.extend_from_slice(&VERSION.to_le_bytes());
            entry.append_common(&mut directory);
            // No comment, first disk, no attributes.
            directory.extend_from_slice(&[0; 10]);
            directory.extend_from_slice(&(entry.offset as u32).to_le_bytes());
            directory.extend_from_slice(entry.file_name().as_bytes());
        }
        let count = (self.entries.len() as u16).to_le_bytes();
        let size = directory.len() as u32;
        directory.extend_from_slice(b"PK\x05\x06\0\0\0\0");
        directory.extend_from_slice(&[count, count].concat());
        directory.extend_from_slice(&size.to_le_bytes());
        directory.extend_from_slice(&(start as u32).to_le_bytes());
        directory.extend_from_slice(&[0; 2]);
        self.write(&directory)?;
        self.to.flush()?;
        Ok(self.to)
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.to.write_all(bytes)?;
        self.written += bytes.len();
        Ok(())
    }
}

/// Version of ZIP that is needed to read a stored entry: 2.0.
const VERSION: u16 = 20;

impl Entry {
    fn file_name(&self) -> String {
        format!("{}.npy", self.name)
    }

    /// What an entry's own header and the directory have in common: version, flags, method, time, sum, sizes, lengths.
    fn append_common(&self, to: &mut Vec<u8>) {
        /// 1980-01-01, the first day that ZIP knows: the same arrays make the same bytes.
        const DATE: u16 = 1 << 5 | 1;
        for word in [VERSION, 0, 0, 0, DATE] {
            to.extend_from_slice(&word.to_le_bytes());
        }
        for word in [self.crc32, self.bytes as u32, self.bytes as u32] {
            to.extend_from_slice(&word.to_le_bytes());
        }
        for word in [self.file_name().len() as u16, 0] {
            to.extend_from_slice(&word.to_le_bytes());
        }
    }
}

fn npy_header<T: Element>(shape: &[usize]) -> Vec<u8> {
    let axes: String = shape.iter().map(|n| format!("{n}, ")).collect();
    let mut text = format!(
        "{{'descr': '{}', 'fortran_order': False, 'shape': ({axes}), }}",
        T::DESCR
    );
    const MAGIC: &[u8] = b"\x93NUMPY\x01\x00";
    // Values start at a multiple of 64 bytes.
    let unpadded = MAGIC.len() + 2 + text.len() + 1;
    text.extend(std::iter::repeat_n(
        ' ',
        unpadded.next_multiple_of(64) - unpadded,
    ));
    text.push('\n');
    let mut header = MAGIC.to_vec();
    header.extend_from_slice(&(text.len() as u16).to_le_bytes());
    header.extend_from_slice(text.as_bytes());
    header
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_array_is_refused_by_name() {
        let mut npz = NpzWriter::new(Vec::new());
        npz.array("depth", &[2, 2], &[1f32; 4]).unwrap();
        for (name, shape, values) in [
            ("depth", &[1][..], &[1f32][..]),
            ("", &[1], &[1.0]),
            ("Größe", &[1], &[1.0]),
            ("few", &[2, 3], &[1.0]),
        ] {
            let error = npz.array(name, shape, values).unwrap_err();
            assert_eq!(error.kind(), io::ErrorKind::InvalidInput);
            assert!(error.to_string().contains(name), "{error}");
        }
    }

    #[test]
    fn values_are_aligned_and_the_directory_names_every_entry() {
        let mut npz = NpzWriter::new(Vec::new());
        npz.array("a", &[3], &[1i32, -2, 3]).unwrap();
        npz.array("b", &[], &[0.5f64]).unwrap();
        let bytes = npz.finish().unwrap();
        let header = npy_header::<i32>(&[3]);
        assert_eq!(header.len() % 64, 0);
        let tail = &bytes[bytes.len() - 22..];
        assert_eq!(&tail[..4], b"PK\x05\x06");
        assert_eq!(u16::from_le_bytes([tail[10], tail[11]]), 2);
        let start = u32::from_le_bytes(tail[16..20].try_into().unwrap()) as usize;
        assert_eq!(&bytes[start..start + 4], b"PK\x01\x02");
    }
}
