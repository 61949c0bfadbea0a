//! Arrays for NumPy: `.npz`, a ZIP archive of `.npy` files.
//!
//! Sources: NumPy Enhancement Proposal 1 (`.npy`, version 1.0); PKWARE's APPNOTE 6.3 (ZIP). The entries are stored, not
//! compressed, so that plain readers take them, too; their lengths and sums follow them (bit 3 of the flags), so that an array may be
//! longer than memory. No archive above 4 GiB is written.

mod read;

use std::io::{self, Write};

pub use read::{Array, NpzError, read};

/// A number as NumPy stores it, or several that follow each other.
pub trait Element: Copy {
    /// NumPy's name of the number's type, little endian.
    const DESCR: &'static str;
    /// How many numbers it is.
    const NUMBERS: usize = 1;
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

impl<T: Element, const N: usize> Element for [T; N] {
    const DESCR: &'static str = T::DESCR;
    const NUMBERS: usize = N * T::NUMBERS;
    fn append(self, to: &mut Vec<u8>) {
        self.into_iter().for_each(|number| number.append(to));
    }
}

element!(
    f32 => "<f4", f64 => "<f8", i8 => "|i1", u8 => "|u1", i16 => "<i2", u16 => "<u2", i32 => "<i4", u32 => "<u4"
);

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
        self.stream(name, shape, values.iter().map(|&value| Ok(value)))
    }

    /// As [`NpzWriter::array`], with values that come one by one.
    ///
    /// # Errors
    /// As [`NpzWriter::array`], and the first of the values.
    pub fn stream<T: Element>(
        &mut self,
        name: &str,
        shape: &[usize],
        values: impl IntoIterator<Item = io::Result<T>>,
    ) -> io::Result<()> {
        let invalid = |what: String| io::Error::new(io::ErrorKind::InvalidInput, what);
        let taken = self.entries.iter().any(|entry| entry.name == name);
        if taken || name.is_empty() || !name.is_ascii() || name.len() > LONGEST_NAME {
            return Err(invalid(format!(
                "\"{name}\" is no name for an array: ASCII of at most {LONGEST_NAME} letters, each once, is needed"
            )));
        }
        let expected = shape
            .iter()
            .try_fold(1usize, |n, &more| n.checked_mul(more));
        let size = expected.and_then(|numbers| numbers.checked_mul(size_of::<T>() / T::NUMBERS));
        let end = size.and_then(|size| size.checked_add(self.written + OVERHEAD_BYTES));
        let (Some(expected), Some(end)) = (expected, end) else {
            return Err(invalid(format!("array \"{name}\" does not fit into 4 GiB")));
        };
        if u32::try_from(end).is_err() || self.entries.len() >= 0xFFFF {
            return Err(invalid(format!("array \"{name}\" does not fit into 4 GiB")));
        }
        let mut entry = Entry {
            name: name.to_owned(),
            crc32: 0,
            bytes: 0,
            offset: self.written,
        };
        let mut header = vec![];
        header.extend_from_slice(b"PK\x03\x04");
        entry.append_common(&mut header);
        header.extend_from_slice(entry.file_name().as_bytes());
        self.write(&header)?;

        let (mut sum, mut count) = (crc32fast::Hasher::new(), 0);
        let mut block = npy_header::<T>(shape);
        for value in values {
            value?.append(&mut block);
            count += T::NUMBERS;
            if block.len() >= BLOCK_BYTES {
                sum.update(&block);
                entry.bytes += block.len();
                self.write(&block)?;
                block.clear();
            }
            if count > expected {
                break;
            }
        }
        if count != expected {
            let than = if count > expected {
                "more than"
            } else {
                "only"
            };
            let told = count.min(expected);
            return Err(invalid(format!(
                "array \"{name}\" has {than} {told} values, its shape {shape:?} asks for {expected}"
            )));
        }
        sum.update(&block);
        entry.bytes += block.len();
        self.write(&block)?;
        entry.crc32 = sum.finalize();
        let mut descriptor = b"PK\x07\x08".to_vec();
        entry.append_sums(&mut descriptor);
        self.write(&descriptor)?;
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
/// Bit 3: lengths and sum stand behind the entry, and in the directory.
const FLAGS: u16 = 1 << 3;
/// Values are written so many bytes at a time.
const BLOCK_BYTES: usize = 1 << 16;
/// Names of arrays are at most so long, which keeps ZIP's headers small.
const LONGEST_NAME: usize = 255;
/// More than the headers of an entry take, with its share of the directory.
const OVERHEAD_BYTES: usize = 2048;

impl Entry {
    fn file_name(&self) -> String {
        format!("{}.npy", self.name)
    }

    /// What an entry's own header and the directory have in common: version, flags, method, time, sums, lengths of names.
    fn append_common(&self, to: &mut Vec<u8>) {
        /// 1980-01-01, the first day that ZIP knows: the same arrays make the same bytes.
        const DATE: u16 = 1 << 5 | 1;
        for word in [VERSION, FLAGS, 0, 0, DATE] {
            to.extend_from_slice(&word.to_le_bytes());
        }
        self.append_sums(to);
        for word in [self.file_name().len() as u16, 0] {
            to.extend_from_slice(&word.to_le_bytes());
        }
    }

    /// Check sum and both lengths; nothing is known of them before the values.
    fn append_sums(&self, to: &mut Vec<u8>) {
        for word in [self.crc32, self.bytes as u32, self.bytes as u32] {
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
            ("many", &[], &[1.0, 2.0]),
            ("endless", &[1 << 40, 1 << 40], &[]),
            ("too large", &[1 << 30], &[]),
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
