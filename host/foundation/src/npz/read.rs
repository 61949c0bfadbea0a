//! Reads archives as [`super::NpzWriter`] and `numpy.savez` write them: stored entries, little-endian numbers, the last axis the fastest.

/// An array of an archive.
#[derive(Clone, Debug, PartialEq)]
pub struct Array<'a> {
    /// Its name, without `.npy`.
    pub name: String,
    /// NumPy's name of the numbers' type, as `<f8`.
    pub descr: String,
    /// How many numbers along each axis.
    pub shape: Vec<usize>,
    /// The numbers, as many as the shape has, [`Array::number_bytes`] each.
    pub bytes: &'a [u8],
}

impl Array<'_> {
    /// Bytes of one number.
    #[must_use]
    pub fn number_bytes(&self) -> usize {
        number_bytes(&self.descr).unwrap_or(1)
    }
}

/// Why an archive was refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum NpzError {
    /// It ends where something should stand.
    #[error("{what} at byte {at} is cut off: the file has {got} bytes")]
    Cut {
        /// What.
        what: &'static str,
        /// Where it begins.
        at: usize,
        /// Bytes of the file.
        got: usize,
    },
    /// Something else stands there.
    #[error("byte {at} is no {what}; an archive as numpy.savez writes it would be right")]
    Misplaced {
        /// What should be there.
        what: &'static str,
        /// Where.
        at: usize,
    },
    /// Too many entries.
    #[error("the archive has {got} arrays, at most {MOST_ARRAYS} are read")]
    Many {
        /// Entries.
        got: usize,
    },
    /// A compressed entry.
    #[error(
        "array \"{name}\" is compressed (method {method}); stored ones, by numpy.savez, would be right"
    )]
    Compressed {
        /// The array.
        name: String,
        /// ZIP's number of the method.
        method: u16,
    },
    /// Two arrays of one name.
    #[error("there are two arrays \"{name}\"; each has a name of its own")]
    Twice {
        /// Their name.
        name: String,
    },
    /// Its bytes are not those that were written.
    #[error("array \"{name}\" is damaged: its check sum is {got:#010x}, not {expected:#010x}")]
    Damaged {
        /// The array.
        name: String,
        /// Of the bytes.
        got: u32,
        /// By the directory.
        expected: u32,
    },
    /// No `.npy` header, or one that is not understood.
    #[error("entry \"{name}\" is no array: {why}")]
    Header {
        /// The entry.
        name: String,
        /// What is wrong, and what would be right.
        why: String,
    },
}

/// More arrays than any file of points has.
const MOST_ARRAYS: usize = 256;

/// The arrays of an archive, in the directory's order; nothing is copied.
///
/// # Errors
/// [`NpzError`]: the first thing that is wrong.
pub fn read(bytes: &[u8]) -> Result<Vec<Array<'_>>, NpzError> {
    const END: usize = 22;
    const LONGEST_COMMENT: usize = 0xFFFF;
    let earliest = bytes.len().saturating_sub(END + LONGEST_COMMENT);
    let end = (earliest..=bytes.len().saturating_sub(END))
        .rev()
        .find(|&at| bytes[at..].starts_with(b"PK\x05\x06"));
    let end = end.ok_or(NpzError::Cut {
        what: "the directory's end",
        at: bytes.len(),
        got: bytes.len(),
    })?;
    let count = usize::from(word(bytes, end + 10, "the directory's end")?);
    if count > MOST_ARRAYS {
        return Err(NpzError::Many { got: count });
    }
    let mut at = long(bytes, end + 16, "the directory's end")?;
    let mut arrays: Vec<Array<'_>> = Vec::with_capacity(count);
    for _ in 0..count {
        const WHAT: &str = "entry of the directory";
        signature(bytes, at, b"PK\x01\x02", WHAT)?;
        let field = |offset: usize| word(bytes, at + offset, WHAT);
        let (method, name_bytes) = (field(10)?, field(28)?);
        let after_name = usize::from(field(30)?) + usize::from(field(32)?);
        let sum = long(bytes, at + 16, WHAT)?;
        let size = long(bytes, at + 24, WHAT)?;
        let local = long(bytes, at + 42, WHAT)?;
        let name = slice(bytes, at + 46, usize::from(name_bytes), WHAT)?;
        let name = String::from_utf8_lossy(name);
        let name = name.strip_suffix(".npy").unwrap_or(&name).to_owned();
        if method != 0 {
            return Err(NpzError::Compressed { name, method });
        }
        if arrays.iter().any(|array| array.name == name) {
            return Err(NpzError::Twice { name });
        }
        let content = entry(bytes, local, size)?;
        let got = crc32fast::hash(content);
        if got as usize != sum {
            let expected = sum as u32;
            return Err(NpzError::Damaged {
                name,
                got,
                expected,
            });
        }
        arrays.push(array(name, content)?);
        at += 46 + usize::from(name_bytes) + after_name;
    }
    Ok(arrays)
}

fn slice<'a>(
    bytes: &'a [u8],
    at: usize,
    count: usize,
    what: &'static str,
) -> Result<&'a [u8], NpzError> {
    let cut = NpzError::Cut {
        what,
        at,
        got: bytes.len(),
    };
    let end = at.checked_add(count);
    end.and_then(|end| bytes.get(at..end)).ok_or(cut)
}

fn word(bytes: &[u8], at: usize, what: &'static str) -> Result<u16, NpzError> {
    let two = slice(bytes, at, 2, what)?;
    Ok(u16::from_le_bytes([two[0], two[1]]))
}

fn long(bytes: &[u8], at: usize, what: &'static str) -> Result<usize, NpzError> {
    let low = usize::from(word(bytes, at, what)?);
    Ok(low | usize::from(word(bytes, at + 2, what)?) << 16)
}

fn signature(
    bytes: &[u8],
    at: usize,
    expected: &[u8; 4],
    what: &'static str,
) -> Result<(), NpzError> {
    match slice(bytes, at, 4, what)? == expected {
        true => Ok(()),
        false => Err(NpzError::Misplaced { what, at }),
    }
}

/// The content of an entry; its length is the directory's, for the entry's own may stand behind it.
fn entry(bytes: &[u8], at: usize, size: usize) -> Result<&[u8], NpzError> {
    const WHAT: &str = "entry";
    signature(bytes, at, b"PK\x03\x04", WHAT)?;
    let name = usize::from(word(bytes, at + 26, WHAT)?);
    let extra = usize::from(word(bytes, at + 28, WHAT)?);
    slice(bytes, at + 30 + name + extra, size, "array")
}

/// A `.npy` file.
fn array(name: String, content: &[u8]) -> Result<Array<'_>, NpzError> {
    let bad = |why: &str| NpzError::Header {
        name: name.clone(),
        why: why.to_owned(),
    };
    let short = || bad("it ends within its header");
    let at = |place: usize| content.get(place).copied().map(usize::from);
    if !content.starts_with(b"\x93NUMPY") {
        return Err(bad("it does not begin as a .npy file does"));
    }
    let number = |places: std::ops::Range<usize>| {
        let mut bytes = places.rev().map(at);
        bytes.try_fold(0, |sum, byte| Some(sum << 8 | byte?))
    };
    let (start, length) = match at(6) {
        Some(1) => (10, number(8..10)),
        Some(2 | 3) => (12, number(8..12)),
        _ => return Err(bad("its version is none of 1, 2 and 3")),
    };
    let end = start + length.ok_or_else(short)?;
    let text = content.get(start..end).ok_or_else(short)?;
    let text = std::str::from_utf8(text).map_err(|_| bad("its header is no text"))?;
    let descr = value(text, "descr")
        .and_then(|text| text.strip_prefix('\'')?.split_once('\''))
        .map(|(descr, _)| descr)
        .ok_or_else(|| bad("its header names no type of numbers ('descr')"))?;
    let bytes_each = number_bytes(descr).ok_or_else(|| {
        bad(&format!(
            "its numbers are {descr:?}; little-endian whole numbers or floats of 1, 2, 4 or 8 bytes would be right"
        ))
    })?;
    match value(text, "fortran_order") {
        Some(text) if text.starts_with("False") => {}
        _ => {
            return Err(bad(
                "its first axis is the fastest (fortran_order); C order would be right",
            ));
        }
    }
    let shape = value(text, "shape")
        .and_then(|text| text.strip_prefix('(')?.split_once(')'))
        .and_then(|(axes, _)| {
            let axes = axes
                .split(',')
                .map(str::trim)
                .filter(|axis| !axis.is_empty());
            axes.map(|axis| axis.parse::<usize>().ok())
                .collect::<Option<Vec<_>>>()
        })
        .ok_or_else(|| bad("its header names no shape"))?;
    let numbers = shape
        .iter()
        .try_fold(bytes_each, |n, &axis| n.checked_mul(axis));
    let bytes = &content[end..];
    if numbers != Some(bytes.len()) {
        return Err(bad(&format!(
            "it has {} bytes of numbers, its shape {shape:?} of {descr} asks for others",
            bytes.len()
        )));
    }
    let descr = descr.to_owned();
    Ok(Array {
        name,
        descr,
        shape,
        bytes,
    })
}

/// What stands behind a key of the header's dictionary.
fn value<'a>(text: &'a str, key: &str) -> Option<&'a str> {
    let (_, behind) = text.split_once(&format!("'{key}':"))?;
    Some(behind.trim_start())
}

/// Bytes of a number of NumPy's type; none of what is not read.
fn number_bytes(descr: &str) -> Option<usize> {
    Some(match descr {
        "|i1" | "|u1" => 1,
        "<i2" | "<u2" | "<f2" => 2,
        "<i4" | "<u4" | "<f4" => 4,
        "<i8" | "<u8" | "<f8" => 8,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::super::NpzWriter;
    use super::*;

    fn archive() -> Vec<u8> {
        let mut npz = NpzWriter::new(Vec::new());
        npz.array("points_mm", &[2, 3], &[[1.0, 2.0, 3.0], [4.0, 5.0, 6.5]])
            .expect("an array");
        npz.array("sigma", &[2], &[0.5f32, 0.25]).expect("an array");
        npz.finish().expect("an archive")
    }

    #[test]
    fn what_was_written_is_read() {
        let bytes = archive();
        let arrays = read(&bytes).expect("its own");
        let [points, sigma] = &arrays[..] else {
            panic!("{arrays:?}")
        };
        assert_eq!(
            (points.name.as_str(), &points.shape[..]),
            ("points_mm", &[2, 3][..])
        );
        assert_eq!((points.descr.as_str(), points.number_bytes()), ("<f8", 8));
        assert_eq!(points.bytes[40..], 6.5f64.to_le_bytes());
        assert_eq!((sigma.descr.as_str(), &sigma.shape[..]), ("<f4", &[2][..]));
        assert_eq!(sigma.bytes[4..], 0.25f32.to_le_bytes());
    }

    /// Every single byte wrong, and every cut: read as it was, or refused, never a panic; never other numbers.
    #[test]
    fn no_damaged_archive_passes_for_another() {
        let bytes = archive();
        let whole = read(&bytes).expect("its own");
        for at in 0..bytes.len() {
            assert!(read(&bytes[..at]).is_err(), "cut at {at}");
            for flip in [0x01, 0x80, 0xFF] {
                let mut damaged = bytes.clone();
                damaged[at] ^= flip;
                let Ok(arrays) = read(&damaged) else { continue };
                for (is, was) in arrays.iter().zip(&whole) {
                    assert_eq!(
                        (&is.bytes, &is.shape, &is.descr),
                        (&was.bytes, &was.shape, &was.descr),
                        "byte {at}"
                    );
                }
            }
        }
    }

    #[test]
    fn what_is_not_read_is_named() {
        let bytes = archive();
        let changed = |from: &[u8], to: &[u8]| {
            let at = bytes.windows(from.len()).position(|w| w == from);
            let at = at.expect("something to change");
            let mut other = bytes.clone();
            other[at..at + to.len()].copy_from_slice(to);
            // Its new sum, in the directory.
            let directory = other
                .windows(4)
                .position(|w| w == b"PK\x01\x02")
                .expect("a directory");
            let size = long(&other, directory + 24, "").expect("a size");
            let sum = crc32fast::hash(entry(&other, 0, size).expect("an entry"));
            other[directory + 16..directory + 20].copy_from_slice(&sum.to_le_bytes());
            read(&other).expect_err("refused").to_string()
        };
        for (from, to, words) in [
            (&b"<f8"[..], &b">f8"[..], "its numbers are \">f8\""),
            (b"False", b"True ", "fortran_order"),
            (b"(2, 3, )", b"(2, 4, )", "asks for others"),
            (b"(2, 3, )", b"(2, x, )", "no shape"),
            (b"\x93NUMPY", b"\x93NOMPY", "does not begin"),
            (b"NUMPY\x01", b"NUMPY\x09", "version"),
        ] {
            let said = changed(from, to);
            assert!(said.contains(words) && said.contains("points_mm"), "{said}");
        }
        // The directory: compressed, twice the same name.
        let at = bytes
            .windows(4)
            .position(|w| w == b"PK\x01\x02")
            .expect("a directory");
        let mut other = bytes.clone();
        other[at + 10] = 8;
        assert!(matches!(
            read(&other),
            Err(NpzError::Compressed { method: 8, .. })
        ));
        assert!(matches!(read(b"PK\x03\x04"), Err(NpzError::Cut { .. })));
    }
}
