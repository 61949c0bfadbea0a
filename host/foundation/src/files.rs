//! Files that appear whole or not at all.

use std::io::{self, Write};
use std::path::Path;

/// Writes `bytes` to `path` whole or not at all: a temporary file in the same folder, flushed to the disk, then renamed.
///
/// # Errors
/// The operating system's error (missing folder, no permission, disk full); an older file at `path` is then untouched.
pub fn write_whole(path: &Path, bytes: &[u8]) -> io::Result<()> {
    stream_whole(path, |file| file.write_all(bytes))
}

/// As [`write_whole`], for content that `write` produces piece by piece.
///
/// # Errors
/// Those of the operating system and of `write`.
pub fn stream_whole(
    path: &Path,
    write: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> io::Result<()> {
    stream_with_mode(path, 0o666, write)
}

/// As [`write_whole`], with the rights that a file has when it is made, less the process's umask.
///
/// # Errors
/// As [`write_whole`].
pub fn write_whole_with_mode(path: &Path, bytes: &[u8], mode: u32) -> io::Result<()> {
    stream_with_mode(path, mode, |file| file.write_all(bytes))
}

fn stream_with_mode(
    path: &Path,
    mode: u32,
    write: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> io::Result<()> {
    // A device or a pipe cannot be replaced by a renamed file, and must not be: it is written to as it is.
    if std::fs::metadata(path).is_ok_and(|meta| !meta.is_file() && !meta.is_dir()) {
        let mut file = io::BufWriter::with_capacity(
            1 << 20,
            std::fs::OpenOptions::new().write(true).open(path)?,
        );
        write(&mut file)?;
        return file.flush();
    }
    // The process's umask decides how much of that is left.
    let mut file = tempfile::Builder::new()
        .permissions(std::os::unix::fs::PermissionsExt::from_mode(mode))
        .tempfile_in(folder_of(path))?;
    {
        let mut buffered = io::BufWriter::with_capacity(1 << 20, file.as_file_mut());
        write(&mut buffered)?;
        buffered.flush()?;
    }
    file.as_file().sync_all()?;
    file.persist(path).map_err(|error| error.error)?;
    Ok(())
}

fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

/// What a place is tried with: a page of results, generously.
const PROBE_BYTES: usize = 1 << 20;

/// Tries whether [`write_whole`] will be able to write to `path`; an older file there stays as it is, and nothing is left.
///
/// # Errors
/// As [`write_whole`], or there is a folder at `path`.
pub fn try_place(path: &Path) -> io::Result<()> {
    match std::fs::metadata(path) {
        Ok(meta) if meta.is_dir() => {
            let why = "it is a folder, where a file should go";
            return Err(io::Error::new(io::ErrorKind::IsADirectory, why));
        }
        // Who listens at a pipe should not hear a trial.
        Ok(meta) if !meta.is_file() => {
            return Ok(rustix::fs::access(path, rustix::fs::Access::WRITE_OK)?);
        }
        _ => {}
    }
    if path.file_name().is_none() {
        return Err(io::Error::new(
            io::ErrorKind::InvalidInput,
            "it names no file",
        ));
    }
    let mut probe = tempfile::tempfile_in(folder_of(path))?;
    probe.write_all(&vec![0; PROBE_BYTES])?;
    probe.sync_data()
}

/// BLAKE3 of some bytes, as hexadecimal text.
#[must_use]
pub fn hash(bytes: &[u8]) -> String {
    blake3::hash(bytes).to_hex().to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failing_writer_leaves_the_old_file_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("verdict.json");
        write_whole(&path, b"old").unwrap();
        let failed = stream_whole(&path, |file| {
            file.write_all(b"half of the new")?;
            Err(io::Error::other("disk full"))
        });
        assert!(failed.is_err());
        assert_eq!(std::fs::read(&path).unwrap(), b"old");
        assert_eq!(
            std::fs::read_dir(folder.path()).unwrap().count(),
            1,
            "no temporary file stays"
        );
    }

    #[test]
    fn a_full_disk_is_an_error_and_a_device_stays_a_device() {
        use std::os::unix::fs::FileTypeExt;
        let full = Path::new("/dev/full");
        assert_eq!(
            write_whole(full, b"x").unwrap_err().kind(),
            io::ErrorKind::StorageFull
        );
        assert!(
            std::fs::metadata(full)
                .unwrap()
                .file_type()
                .is_char_device()
        );
    }

    #[test]
    fn a_place_is_tried_without_a_trace() {
        let folder = tempfile::tempdir().unwrap();
        let (new, old) = (folder.path().join("new"), folder.path().join("old"));
        std::fs::write(&old, b"old").unwrap();
        for path in [&new, &old, Path::new("/dev/null"), Path::new("/dev/full")] {
            try_place(path).unwrap();
        }
        assert_eq!(std::fs::read(&old).unwrap(), b"old");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
        for path in [
            folder.path(),
            &old.join("below a file"),
            &new.join("below nothing"),
        ] {
            assert!(try_place(path).is_err(), "{}", path.display());
        }
    }
}
