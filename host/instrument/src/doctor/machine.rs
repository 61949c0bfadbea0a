//! Findings on the host computer: shared memory, free disk space, a plausible clock.

use std::path::Path;
use std::time::{Duration, SystemTime};

use flankscope_foundation::date::Date;
use flankscope_frames::{FrameReceiver, SEGMENT_BYTES, SharedRoot};
use serde_json::json;

use super::Finding;

const MEGABYTE: u64 = 1_000_000;
/// Below this, writing the next report or history row may fail.
const DISK_LEAST: u64 = 100 * MEGABYTE;
/// Below this, the operator should free space: a check with its phasors takes some megabytes, a recording of frames hundreds.
const DISK_SOON: u64 = 1_000 * MEGABYTE;

/// Bytes free for this user on the file system where `place` is, or will be.
fn free_bytes(place: &Path) -> std::io::Result<u64> {
    let there = place.ancestors().find(|folder| folder.exists());
    let there = there.filter(|folder| !folder.as_os_str().is_empty());
    let stat = rustix::fs::statvfs(there.unwrap_or(Path::new(".")))?;
    Ok(stat.f_bavail.saturating_mul(stat.f_frsize))
}

/// Folder of the shared memory.
const SHARED_MEMORY: &str = "/dev/shm";

/// Too little shared memory for the frames of a capture.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[error(
    "{SHARED_MEMORY} has {} MB free, the frames of a capture take {} MB: make it larger (mount -o remount,size=512M {SHARED_MEMORY}; of a \
     container, --shm-size=512m) or free it",
    free_bytes / MEGABYTE,
    needed_bytes.div_ceil(MEGABYTE)
)]
pub struct SharedMemoryTooSmall {
    /// Bytes free.
    pub free_bytes: u64,
    /// Bytes needed.
    pub needed_bytes: u64,
}

/// Checks before a capture that the shared memory holds its frames. A file system whose size is not known is not checked: creating the
/// services names what is wrong with it.
///
/// # Errors
/// [`SharedMemoryTooSmall`].
pub fn check_shared_memory() -> Result<(), SharedMemoryTooSmall> {
    free_bytes(Path::new(SHARED_MEMORY)).map_or(Ok(()), check_free)
}

fn check_free(free_bytes: u64) -> Result<(), SharedMemoryTooSmall> {
    let needed_bytes = SEGMENT_BYTES as u64;
    match free_bytes < needed_bytes {
        true => Err(SharedMemoryTooSmall {
            free_bytes,
            needed_bytes,
        }),
        false => Ok(()),
    }
}

/// Creates the shared-memory services of a capture and removes them again.
#[must_use]
pub fn shared_memory(base: &Path) -> Finding {
    const CHECK: &str = "shared memory";
    let used = match SharedRoot::create(base) {
        Err(error) => Err(error.to_string()),
        Ok(root) => FrameReceiver::create(&root)
            .map(drop)
            .map_err(|error| error.to_string()),
    };
    if let Err(why) = used {
        let remedy = "free /dev/shm, or choose another place by TMPDIR or XDG_RUNTIME_DIR";
        return Finding::failed(CHECK, why, remedy);
    }
    let needed = SEGMENT_BYTES as u64;
    let free = match free_bytes(Path::new("/dev/shm")) {
        Ok(free) => free,
        Err(error) => {
            return Finding::failed(
                CHECK,
                format!("/dev/shm: {error}"),
                "mount a tmpfs at /dev/shm",
            );
        }
    };
    let seen = format!(
        "{} MB free, the frames of a capture take {} MB",
        free / MEGABYTE,
        needed / MEGABYTE
    );
    let figures = json!({ "free_bytes": free, "needed_bytes": needed });
    if free < needed {
        let remedy = "make it larger: mount -o remount,size=512M /dev/shm";
        return Finding::failed(CHECK, seen, remedy).with(figures);
    }
    Finding::ok(CHECK, seen).with(figures)
}

/// Free space where results are written.
#[must_use]
pub fn disk(place: &Path) -> Finding {
    const CHECK: &str = "disk";
    let free = match free_bytes(place) {
        Ok(free) => free,
        Err(error) => {
            let seen = format!("{}: {error}", place.display());
            return Finding::failed(CHECK, seen, "name another place for the results");
        }
    };
    let seen = format!("{} MB free at {}", free / MEGABYTE, place.display());
    let finding = if free < DISK_LEAST {
        Finding::failed(CHECK, seen, "clear up, or name another place")
    } else if free < DISK_SOON {
        Finding::attention(CHECK, seen, "clear up soon")
    } else {
        Finding::ok(CHECK, seen)
    };
    finding.with(json!({ "free_bytes": free }))
}

/// Whether the clock is plausible: no existing file or calibration may be dated later than now. Each entry is a name and its day.
#[must_use]
pub fn clock(made: &[(&str, Date)]) -> Finding {
    const CHECK: &str = "clock";
    const REMEDY: &str =
        "set the clock (timedatectl set-ntp true), or dates of checks and calibrations are wrong";
    let today = Date::today();
    // Time zones differ: a date one day ahead is no sign of a wrong clock.
    if let Some((what, date)) = made.iter().find(|(_, date)| *date > today.plus_days(1)) {
        let seen = format!("today is {today}, but {what} is of {date}");
        return Finding::failed(CHECK, seen, REMEDY);
    }
    let built = std::env::current_exe()
        .and_then(std::fs::metadata)
        .and_then(|of| of.modified());
    let day = Duration::from_secs(86_400);
    if built.is_ok_and(|built| built > SystemTime::now() + day) {
        let seen = format!("today is {today}, but this program was installed later");
        return Finding::failed(CHECK, seen, REMEDY);
    }
    Finding::ok(
        CHECK,
        format!("today is {today} (UTC), later than everything that it could be compared with"),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::doctor::Health;

    #[test]
    fn shared_memory_that_is_too_small_is_named_with_the_size_needed() {
        let needed_bytes = SEGMENT_BYTES as u64;
        assert_eq!(check_free(needed_bytes), Ok(()));
        let error = check_free(64 * MEGABYTE).unwrap_err();
        assert_eq!(error.needed_bytes, needed_bytes);
        let words = error.to_string();
        assert!(
            words.contains("64 MB") && words.contains("--shm-size"),
            "{words}"
        );
    }

    #[test]
    fn a_clock_that_runs_behind_what_was_made_is_wrong() {
        let today = Date::today();
        assert_eq!(clock(&[("the head", today)]).health, Health::Ok);
        let wrong = clock(&[("the head", today), ("check 7", today.plus_days(9))]);
        assert_eq!(wrong.health, Health::Failed);
        assert!(wrong.seen.contains("check 7"), "{}", wrong.seen);
    }

    #[test]
    fn places_that_are_not_there_yet_lie_on_a_disk() {
        let folder = tempfile::tempdir().unwrap();
        let later = folder.path().join("a/b/c");
        assert_eq!(
            disk(&later).figures["free_bytes"]
                .as_u64()
                .map(|free| free > 0),
            Some(true)
        );
    }

    #[test]
    fn shared_memory_is_tried_and_a_bad_place_is_named() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(shared_memory(folder.path()).health, Health::Ok);
        let file = folder.path().join("file");
        std::fs::write(&file, "").unwrap();
        let bad = shared_memory(&file.join("x"));
        assert_eq!(bad.health, Health::Failed, "{bad:?}");
        assert!(bad.seen.contains("file"), "{}", bad.seen);
    }
}
