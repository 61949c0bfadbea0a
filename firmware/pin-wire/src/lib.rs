//! Messages about virtual pins between the emulated image and the bench that plays its board.
//!
//! ```text
//! image -> bench:  A5 | subject u8 | value u16 | time u64 | check u8     little-endian, check = CRC-8 of all bytes before
//! bench -> image:  5A | subject u8 | value u8 | check u8                 short, for an emulated UART is slow
//! ```
//! The image sends what it drives and, with the time at which it saw them, the inputs it was given; the bench sends
//! inputs and questions. A receiver that has lost step finds it again at the next message that checks.
#![no_std]
#![forbid(unsafe_code)]

const START: u8 = 0xA5;
/// Bytes of a message to the bench.
pub const MESSAGE_BYTES: usize = 13;
const INPUT_START: u8 = 0x5A;
/// Bytes of a message to the image.
pub const INPUT_BYTES: usize = 4;

/// What a message is about. Levels are 0 and 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Subject {
    /// Outputs of the image begin here: the LED shall be lit.
    LedEnable = 1,
    /// Value in milliamperes.
    LedCurrent = 2,
    /// The DMD shall show the next pattern.
    DmdTrigger = 3,
    /// The camera shall expose while it is high.
    CameraTrigger = 4,
    /// Value is the DMD index; answered by `PatternTaken`.
    SelectPattern = 5,
    /// The image has started; value is the cause of the start.
    Started = 6,
    /// First channel: the head is out of the die.
    HeadClear1 = 7,
    /// Second channel of the same.
    HeadClear2 = 8,
    /// Verdict to the press.
    Go = 9,
    /// Verdict to the press.
    NoGo = 10,
    /// Toggles while the verdict counts.
    VerdictBeat = 11,
    /// Inputs of the image begin here, sent back when seen: current flows through the LED.
    LedSense = 16,
    /// The DMD stands on its pattern.
    DmdReady = 17,
    /// The camera takes a trigger.
    CameraReady = 18,
    /// The camera exposes.
    CameraExposing = 19,
    /// Answers `SelectPattern`.
    PatternTaken = 20,
    /// First channel: the press is open.
    PressOpenA = 21,
    /// Second channel of the same.
    PressOpenB = 22,
    /// No workpiece lies in the die.
    DieClear = 23,
    GuardClosed = 24,
    /// A pulse per stroke.
    Cycle = 25,
    /// The head stands on its retract switch.
    RetractSwitch = 26,
    /// Questions begin here; the answer repeats the subject with a value. Most stack ever used, bytes.
    StackUsed = 32,
    /// Longest time from an alarm's due time to its interrupt, us.
    AlarmLatency = 33,
    /// Asked by the image, answered by the bench: are you there?
    Tick = 34,
    /// Order to go wrong, see [`injection`]; only an image built for it obeys.
    InjectFault = 35,
}

impl Subject {
    const ALL: [Self; 26] = [
        Self::LedEnable,
        Self::LedCurrent,
        Self::DmdTrigger,
        Self::CameraTrigger,
        Self::SelectPattern,
        Self::Started,
        Self::HeadClear1,
        Self::HeadClear2,
        Self::Go,
        Self::NoGo,
        Self::VerdictBeat,
        Self::LedSense,
        Self::DmdReady,
        Self::CameraReady,
        Self::CameraExposing,
        Self::PatternTaken,
        Self::PressOpenA,
        Self::PressOpenB,
        Self::DieClear,
        Self::GuardClosed,
        Self::Cycle,
        Self::RetractSwitch,
        Self::StackUsed,
        Self::AlarmLatency,
        Self::Tick,
        Self::InjectFault,
    ];

    fn from_number(number: u8) -> Option<Self> {
        Self::ALL
            .into_iter()
            .find(|subject| *subject as u8 == number)
    }
}

/// Values of [`Subject::InjectFault`].
pub mod injection {
    /// A task (its number, in the low half) is never polled again.
    pub const HANG: u8 = 0x10;
    /// A task (its number, in the low half) loops without end.
    pub const SPIN: u8 = 0x20;
    /// The program panics.
    pub const PANIC: u8 = 0x30;
    /// The processor meets an instruction that it does not have.
    pub const FAULT: u8 = 0x31;
}

/// A message to the image, as it goes over the wire.
pub fn input_bytes(subject: Subject, value: u8) -> [u8; INPUT_BYTES] {
    let body = [INPUT_START, subject as u8, value];
    let [a, b, c] = body;
    [a, b, c, check(&body)]
}

/// CRC-8 (polynomial x8 + x2 + x + 1). A plain xor would take two starts of a message in a row for a message.
fn check(bytes: &[u8]) -> u8 {
    bytes.iter().fold(0, |crc, byte| {
        (0..8).fold(crc ^ byte, |crc: u8, _| {
            (crc << 1) ^ if crc & 0x80 == 0 { 0 } else { 0x07 }
        })
    })
}

/// Bytes to messages to the image.
#[derive(Debug, Clone, Copy, Default)]
pub struct InputDecoder {
    window: [u8; INPUT_BYTES],
}

impl InputDecoder {
    /// In step with a silent wire.
    pub const fn new() -> Self {
        Self {
            window: [0; INPUT_BYTES],
        }
    }

    /// Takes one byte; subject and value if it was the last of a message.
    pub fn push(&mut self, byte: u8) -> Option<(Subject, u8)> {
        let [_, a, b, c] = self.window;
        self.window = [a, b, c, byte];
        let whole = a == INPUT_START && check(&[a, b, c]) == byte;
        let subject = Subject::from_number(b).filter(|_| whole)?;
        // These bytes are spent.
        self.window = [0; INPUT_BYTES];
        Some((subject, c))
    }
}

/// One message to the bench.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PinMessage {
    /// What it is about.
    pub subject: Subject,
    /// A level, or what the subject says.
    pub value: u16,
    /// The image's own time, us.
    pub at_us: u64,
}

impl PinMessage {
    /// As it goes over the wire.
    pub fn to_bytes(self) -> [u8; MESSAGE_BYTES] {
        let [v0, v1] = self.value.to_le_bytes();
        let [t0, t1, t2, t3, t4, t5, t6, t7] = self.at_us.to_le_bytes();
        let body = [
            START,
            self.subject as u8,
            v0,
            v1,
            t0,
            t1,
            t2,
            t3,
            t4,
            t5,
            t6,
            t7,
        ];
        let [a, b, c, d, e, f, g, h, i, j, k, l] = body;
        [a, b, c, d, e, f, g, h, i, j, k, l, check(&body)]
    }

    fn from_bytes(bytes: [u8; MESSAGE_BYTES]) -> Option<Self> {
        let [start, subject, v0, v1, t0, t1, t2, t3, t4, t5, t6, t7, _] = bytes;
        // A message followed by its own check has the check 0.
        let whole = start == START && check(&bytes) == 0;
        Some(Self {
            subject: Subject::from_number(subject).filter(|_| whole)?,
            value: u16::from_le_bytes([v0, v1]),
            at_us: u64::from_le_bytes([t0, t1, t2, t3, t4, t5, t6, t7]),
        })
    }
}

/// Bytes to messages to the bench.
#[derive(Debug, Clone, Default)]
pub struct PinDecoder {
    /// The last bytes, oldest first.
    window: [u8; MESSAGE_BYTES],
}

impl PinDecoder {
    /// In step with a silent wire.
    pub const fn new() -> Self {
        Self {
            window: [0; MESSAGE_BYTES],
        }
    }

    /// Takes one byte; a message if it was the last of one.
    pub fn push(&mut self, byte: u8) -> Option<PinMessage> {
        self.window.rotate_left(1);
        if let Some(last) = self.window.last_mut() {
            *last = byte;
        }
        let message = PinMessage::from_bytes(self.window)?;
        self.window = [0; MESSAGE_BYTES];
        Some(message)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    extern crate std;
    use std::vec::Vec;

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
