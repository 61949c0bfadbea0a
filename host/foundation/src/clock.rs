//! Time since the computer started. Unlike the wall clock it is never set, and it counts while a process is stopped and while the
//! computer sleeps, so that two processes of one computer agree on the age of an event.

use std::sync::OnceLock;
use std::time::Duration;

use rustix::time::{ClockId, clock_gettime};
use serde::{Deserialize, Serialize};

/// File in which Linux states an id that changes with every start of the computer (random(4)).
const BOOT_ID: &str = "/proc/sys/kernel/random/boot_id";

/// A moment, by the time since the computer started.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct BootTime {
    /// Id of this start of the computer; empty if the system states none.
    pub boot: String,
    /// Time since the start, ms.
    pub since_boot_ms: u64,
}

impl BootTime {
    /// This moment (`CLOCK_BOOTTIME`).
    #[must_use]
    pub fn now() -> Self {
        static BOOT: OnceLock<String> = OnceLock::new();
        let boot = BOOT.get_or_init(|| {
            let id = std::fs::read_to_string(BOOT_ID).unwrap_or_default();
            id.trim().to_owned()
        });
        let time = clock_gettime(ClockId::Boottime);
        let ms = time.tv_sec * 1000 + time.tv_nsec / 1_000_000;
        Self {
            boot: boot.clone(),
            since_boot_ms: u64::try_from(ms).unwrap_or(0),
        }
    }

    /// The moment that long before, at most the start of the computer.
    #[must_use]
    pub fn before(mut self, earlier: Duration) -> Self {
        let earlier_ms = u64::try_from(earlier.as_millis()).unwrap_or(u64::MAX);
        self.since_boot_ms = self.since_boot_ms.saturating_sub(earlier_ms);
        self
    }

    /// Time since an earlier moment. `None` if the computer was started in between, or if the other moment is later.
    #[must_use]
    pub fn since(&self, earlier: &Self) -> Option<Duration> {
        let ms = self.since_boot_ms.checked_sub(earlier.since_boot_ms)?;
        (self.boot == earlier.boot).then(|| Duration::from_millis(ms))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moments_of_one_start_have_a_distance_and_others_have_none() {
        let now = BootTime::now();
        let earlier = now.clone().before(Duration::from_millis(1));
        assert_eq!(now.since(&earlier), Some(Duration::from_millis(1)));
        assert_eq!(earlier.since(&now), None);
        let other = BootTime {
            boot: "another start".into(),
            ..earlier
        };
        assert_eq!(now.since(&other), None);
        assert!(BootTime::now().since(&now).is_some());
        let start = now.before(Duration::MAX);
        assert_eq!(start.since_boot_ms, 0);
    }
}
