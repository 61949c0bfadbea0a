//! The controller as its Cortex-M4 image in QEMU, in place of the one that runs in the bench's own process.
//!
//! ```text
//!  host ══ pseudo-terminal ══ Port ── socket ── UART0 ┐
//!  device models ── lines ── pins ─── socket ── UART1 ├ image in qemu-system-arm, machine mps2-an386
//!  stage model ── ESP301 text ─────── socket ── UART2 ┘
//! ```
//! Devices, camera and frames are those of the in-process bench. The image's processor lives in real time and so do
//! the devices here; what a frame shows depends on neither, because an exposure lasts from edge to edge by the image's
//! own clock, in whole lines of the sensor.

pub mod figures;
mod machine;
mod pins;

/// The messages about virtual pins; the image includes the same file.
#[path = "../../../../firmware/mps2-an386/src/pin_wire.rs"]
#[allow(missing_docs)]
pub mod pin_wire;

pub use figures::Figures;
pub use machine::{EmulatorError, Machine, find_image};
pub use pins::{Drill, Emulated, join};

#[cfg(test)]
mod tests {
    use super::pin_wire::*;

    #[test]
    fn messages_survive_the_wire_and_junk_before_them() {
        let subjects = [
            Subject::LedEnable,
            Subject::CameraTrigger,
            Subject::StackUsed,
        ];
        let mut decoder = PinDecoder::new();
        for (n, subject) in subjects.into_iter().enumerate() {
            let sent = PinMessage {
                subject,
                value: 0xA5A5,
                at_us: 0x0102_0304_0506_07A5 + n as u64,
            };
            let junk = [0xA5, n as u8, 0xA5];
            let heard: Vec<_> = junk
                .into_iter()
                .chain(sent.to_bytes())
                .filter_map(|byte| decoder.push(byte))
                .collect();
            assert_eq!(heard, [sent]);
        }
    }

    #[test]
    fn inputs_survive_the_wire_and_junk_before_them() {
        let mut decoder = InputDecoder::new();
        for (subject, value) in [
            (Subject::DmdReady, 1),
            (Subject::LedSense, 0),
            (Subject::PatternTaken, 0x5A),
        ] {
            let bytes = [0x5A, subject as u8]
                .into_iter()
                .chain(input_bytes(subject, value));
            let heard: Vec<_> = bytes.filter_map(|byte| decoder.push(byte)).collect();
            assert_eq!(heard, [(subject, value)]);
        }
    }

    #[test]
    fn one_flipped_bit_is_noticed() {
        let whole = PinMessage {
            subject: Subject::DmdTrigger,
            value: 1,
            at_us: 77,
        }
        .to_bytes();
        for bit in 0..whole.len() * 8 {
            let mut bytes = whole;
            bytes[bit / 8] ^= 1 << (bit % 8);
            let mut decoder = PinDecoder::new();
            assert_eq!(
                bytes
                    .into_iter()
                    .filter_map(|byte| decoder.push(byte))
                    .count(),
                0,
                "bit {bit}"
            );
        }
    }
}
