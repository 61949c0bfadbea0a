//! Raw phasors beside the history: one compressed file per capture of a view, named by the hash of its content.
//!
//! A file is a zlib stream (RFC 1950) of the bytes in four parts: every fourth byte from the first, second, third and fourth.
//! Exponents of neighbours are similar and mantissas are not, so separating them improves compression.

use std::fs::DirBuilder;
use std::io::{self, Read, Write};
use std::os::unix::fs::DirBuilderExt;
use std::path::PathBuf;

use flate2::Compression;
use flate2::read::ZlibDecoder;
use flate2::write::ZlibEncoder;

use flankscope_metrology::verdict::Word;

use super::error::HistoryError;
use super::store::History;
use crate::beside::beside;
use crate::document::Phasors;
use flankscope_foundation::files;

/// Compresses at a fast level, because the press waits.
pub(super) fn pack(bytes: &[u8]) -> io::Result<Vec<u8>> {
    let mut apart = Vec::with_capacity(bytes.len());
    for part in 0..4 {
        apart.extend(bytes.iter().skip(part).step_by(4));
    }
    let mut packed = ZlibEncoder::new(Vec::with_capacity(bytes.len()), Compression::fast());
    packed.write_all(&apart)?;
    packed.finish()
}

/// Undoes [`pack`]; reads at most `length` bytes, whatever the file says.
fn unpack(packed: &[u8], length: usize) -> io::Result<Vec<u8>> {
    let mut apart = Vec::with_capacity(length);
    ZlibDecoder::new(packed)
        .take(length as u64 + 1)
        .read_to_end(&mut apart)?;
    let mut bytes = vec![0; apart.len()];
    let mut rest = &apart[..];
    for part in 0..4 {
        let count = (apart.len() + 3 - part) / 4;
        let (now, later) = rest.split_at(count);
        for (byte, &value) in bytes.iter_mut().skip(part).step_by(4).zip(now) {
            *byte = value;
        }
        rest = later;
    }
    Ok(bytes)
}

impl History {
    pub fn phasors_folder(&self) -> PathBuf {
        beside(self.path(), ".phasors")
    }

    fn phasors_file(&self, blake3: &str) -> PathBuf {
        self.phasors_folder().join(format!("{blake3}.zz"))
    }

    /// Writes packed phasors; on return they are on disk.
    pub(super) fn keep_phasors(&self, blake3: &str, packed: &[u8]) -> Result<(), HistoryError> {
        let path = self.phasors_file(blake3);
        let folder = self.phasors_folder();
        let keep = || {
            DirBuilder::new()
                .recursive(true)
                .mode(0o750)
                .create(&folder)?;
            files::write_whole_with_mode(&path, packed, 0o640)?;
            // The name is on disk only after the folder is synchronised, too.
            std::fs::File::open(&folder)?.sync_all()
        };
        keep().map_err(|source| HistoryError::Phasors {
            path: path.clone(),
            source,
        })
    }

    /// Removes phasors that are no longer needed; silent if they are gone already.
    pub(super) fn forget_phasors(&self, blake3: &str) {
        let _ = std::fs::remove_file(self.phasors_file(blake3));
    }

    /// Whether a replay failed because its phasors were deleted by retention. Those of a no-go never are.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn gave_up_phasors(&self, id: i64, error: &HistoryError) -> Result<bool, HistoryError> {
        let gone = matches!(error, HistoryError::Phasors { source, .. } if source.kind() == io::ErrorKind::NotFound);
        Ok(gone && self.check(id)?.verdict != Word::NoGo)
    }

    /// The `length` bytes of phasors with this hash.
    ///
    /// # Errors
    /// The file is missing, unreadable, or differs from what was stored.
    pub fn phasors(&self, blake3: &str, length: usize) -> Result<Phasors, HistoryError> {
        let path = self.phasors_file(blake3);
        let read = || unpack(&files::read_regular(&path, files::MOST_DATA_BYTES)?, length);
        let bytes = read().map_err(|source| HistoryError::Phasors {
            path: path.clone(),
            source,
        })?;
        let got = files::hash(&bytes);
        if got != blake3 {
            return Err(HistoryError::Damaged {
                path,
                got,
                expected: blake3.to_owned(),
            });
        }
        Ok(Phasors { blake3: got, bytes })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_packed_comes_back_whatever_its_length() {
        for length in [0, 1, 2, 3, 4, 5, 1023, 4096] {
            let bytes: Vec<u8> = (0..length).map(|i| (i * i % 251) as u8).collect();
            assert_eq!(unpack(&pack(&bytes).unwrap(), length).unwrap(), bytes);
        }
        // A stream that claims to be longer is not read further.
        let long = pack(&[0; 100_000]).unwrap();
        assert_eq!(unpack(&long, 100).unwrap().len(), 101);
        assert!(unpack(b"no stream", 100).is_err());
    }
}
