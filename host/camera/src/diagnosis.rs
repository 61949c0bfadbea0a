//! What is wrong with the link to the camera, in words.

use crate::backend::Status;

/// The kernel's largest receive buffer of a socket, bytes, where it tells.
#[must_use]
pub fn largest_socket_buffer() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/sys/net/core/rmem_max").ok()?;
    text.trim().parse().ok()
}

/// Why frames are missing, and what would help; nothing where none are.
#[must_use]
pub fn diagnose(status: &Status, socket_buffer: Option<u64>) -> Option<String> {
    let bad = status.incomplete + status.missing;
    if bad == 0 {
        return None;
    }
    let frames = status.whole + bad;
    let mut words = match (status.incomplete, status.missing) {
        (incomplete, 0) => format!("{incomplete} of {frames} frames incomplete"),
        (0, missing) => format!("{missing} of {frames} frames missing"),
        (incomplete, missing) => {
            format!("{incomplete} of {frames} frames incomplete, {missing} missing")
        }
    };
    if let Some(packets) = status.packets_lost {
        words += &format!(" ({packets} packets lost)");
    }
    // Two whole frames, so that one may wait while the next one comes.
    let wanted = (2 * status.frame_bytes).next_power_of_two();
    words += &match (status.network, socket_buffer) {
        (true, Some(has)) if has < wanted => {
            format!(": raise net.core.rmem_max to {wanted} (it is {has}): sysctl -w net.core.rmem_max={wanted}")
        }
        (true, _) => ": give the camera a network card of its own, larger packets (mtu 9000), or a lower rate".into(),
        (false, _) => {
            ": give the camera a USB 3 port of its own, or raise usbcore.usbfs_memory_mb to 1000".into()
        }
    };
    Some(words)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_remedy_fits_what_was_seen() {
        let mut status = Status {
            whole: 13,
            incomplete: 12,
            frame_bytes: 4_608_000,
            network: true,
            ..Status::default()
        };
        let words = diagnose(&status, Some(212_992)).unwrap();
        assert!(
            words.starts_with("12 of 25 frames incomplete: raise net.core.rmem_max to 16777216"),
            "{words}"
        );
        let words = diagnose(&status, Some(1 << 25)).unwrap();
        assert!(words.contains("mtu 9000"), "{words}");
        status.network = false;
        status.packets_lost = Some(3);
        let words = diagnose(&status, None).unwrap();
        assert!(
            words.contains("(3 packets lost)") && words.contains("usbfs_memory_mb"),
            "{words}"
        );
        assert_eq!(diagnose(&Status::default(), None), None);
    }
}
