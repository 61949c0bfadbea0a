//! Files that appear whole or not at all, and files that are read: regular ones only, and no more of them than is asked for.

use std::fs::File;
use std::io::{self, Read, Write};
use std::os::fd::AsRawFd;
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};
use std::path::Path;

use rustix::fs::{AtFlags, CWD, Mode, OFlags, linkat, openat};

/// No file that a person writes, and no document of a check, comes near this.
pub const MOST_DOCUMENT_BYTES: u64 = 1 << 30;
/// No mesh, cloud or image that fits in a station's memory is larger.
pub const MOST_DATA_BYTES: u64 = 16 << 30;

/// Makes a folder within another one, or takes the one that is there; somebody else's link of that name is not followed.
///
/// # Errors
/// The operating system's; [`io::ErrorKind::NotADirectory`] for a link.
pub fn make_folder_within(path: &Path) -> io::Result<()> {
    if std::fs::symlink_metadata(path).is_ok_and(|meta| meta.is_symlink()) {
        let why = "it is a link, where a folder of its own is needed";
        return Err(io::Error::new(io::ErrorKind::NotADirectory, why));
    }
    std::fs::create_dir_all(path)
}

/// Opens a regular file for reading. A pipe, a device or a folder is refused without waiting for anybody: its reader may never
/// come to an end.
///
/// # Errors
/// The operating system's; [`io::ErrorKind::InvalidInput`] with what is there instead.
pub fn open_regular(path: &Path) -> io::Result<File> {
    let mut options = File::options();
    // A pipe without a writer would keep this waiting.
    options.custom_flags(rustix::fs::OFlags::NONBLOCK.bits().cast_signed());
    let file = options.read(true).open(path)?;
    let kind = file.metadata()?.file_type();
    if kind.is_file() {
        return Ok(file);
    }
    let what = if kind.is_dir() {
        "a folder"
    } else if kind.is_fifo() {
        "a pipe"
    } else {
        "a device"
    };
    let why = format!("it is {what}, where a regular file is needed");
    Err(io::Error::new(io::ErrorKind::InvalidInput, why))
}

/// Reads a regular file of at most `most_bytes`, however long it says it is.
///
/// # Errors
/// As [`open_regular`]; [`io::ErrorKind::FileTooLarge`].
pub fn read_regular(path: &Path, most_bytes: u64) -> io::Result<Vec<u8>> {
    let file = open_regular(path)?;
    let mut bytes = Vec::new();
    // One more: the end is found without making room again.
    let says = file.metadata()?.len().min(most_bytes) + 1;
    bytes
        .try_reserve_exact(usize::try_from(says).unwrap_or(usize::MAX))
        .map_err(io::Error::other)?;
    file.take(most_bytes + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > most_bytes {
        let why =
            format!("it has more than {most_bytes} bytes, the most that is read of such a file");
        return Err(io::Error::new(io::ErrorKind::FileTooLarge, why));
    }
    Ok(bytes)
}

/// As [`read_regular`], of text in UTF-8 of at most [`MOST_DOCUMENT_BYTES`].
///
/// # Errors
/// As [`read_regular`]; [`io::ErrorKind::InvalidData`].
pub fn read_text(path: &Path) -> io::Result<String> {
    let bytes = read_regular(path, MOST_DOCUMENT_BYTES)?;
    String::from_utf8(bytes).map_err(|error| {
        let at = error.utf8_error().valid_up_to();
        let why = format!("it is no text: byte {at} is not UTF-8");
        io::Error::new(io::ErrorKind::InvalidData, why)
    })
}

/// Writes `bytes` to `path` whole or not at all: a nameless file in the same folder, flushed to the disk, then named and moved there.
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
    let folder = folder_of(path);
    let fill = |file: &mut File| {
        let mut buffered = io::BufWriter::with_capacity(1 << 20, &mut *file);
        write(&mut buffered)?;
        buffered.flush()?;
        drop(buffered);
        file.sync_all()
    };
    // The process's umask decides how much of the rights is left.
    let whole = if let Some(mut file) = nameless(folder, mode) {
        fill(&mut file)?;
        let at = format!("/proc/self/fd/{}", file.as_raw_fd());
        let named = tempfile::Builder::new().make_in(folder, |name| {
            Ok(linkat(CWD, &at, CWD, name, AtFlags::SYMLINK_FOLLOW)?)
        });
        named?.into_temp_path()
    } else {
        let mut file = tempfile::Builder::new()
            .permissions(std::os::unix::fs::PermissionsExt::from_mode(mode))
            .tempfile_in(folder)?;
        fill(file.as_file_mut())?;
        file.into_temp_path()
    };
    whole.persist(path).map_err(|error| error.error)
}

/// A file without a name, which is gone with a process that is killed while it writes; `None` where the file system has none such.
fn nameless(folder: &Path, mode: u32) -> Option<File> {
    let flags = OFlags::TMPFILE | OFlags::WRONLY | OFlags::CLOEXEC;
    let file = openat(CWD, folder, flags, Mode::from_raw_mode(mode));
    file.ok().map(File::from)
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

    /// What a process writes when it is killed has no name that would stay.
    #[test]
    fn nothing_has_a_name_before_it_is_whole() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("verdict.json");
        let names = || std::fs::read_dir(folder.path()).unwrap().count();
        for (there, content) in [(0, b"old"), (1, b"new")] {
            stream_whole(&path, |file| {
                file.write_all(content)?;
                file.flush()?;
                assert_eq!(names(), there);
                Ok(())
            })
            .unwrap();
            assert_eq!(
                (names(), std::fs::read(&path).unwrap()),
                (1, content.to_vec())
            );
        }
    }

    #[test]
    fn only_regular_files_are_read_and_only_so_much_of_them() {
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("pipe");
        rustix::fs::mknodat(
            rustix::fs::CWD,
            &pipe,
            rustix::fs::FileType::Fifo,
            rustix::fs::Mode::RUSR | rustix::fs::Mode::WUSR,
            0,
        )
        .unwrap();
        // A pipe with no writer, one that never ends, a folder: none is waited for.
        for (path, said) in [
            (&*pipe, "a pipe"),
            (Path::new("/dev/zero"), "a device"),
            (folder.path(), "a folder"),
        ] {
            let error = read_regular(path, 100).unwrap_err().to_string();
            assert!(error.contains(said), "{error}");
        }
        let file = folder.path().join("file");
        std::fs::write(&file, [b'x'; 100]).unwrap();
        assert_eq!(read_regular(&file, 100).unwrap().len(), 100);
        let error = read_regular(&file, 99).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::FileTooLarge);
        assert!(error.to_string().contains("99 bytes"), "{error}");
        // It says nothing of its length, and is regular.
        assert!(read_regular(Path::new("/proc/self/maps"), 1 << 20).is_ok_and(|b| !b.is_empty()));
        std::fs::write(&file, b"abc\xff").unwrap();
        assert!(read_text(&file).unwrap_err().to_string().contains("byte 3"));
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
