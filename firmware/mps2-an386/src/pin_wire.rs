// Messages about virtual pins between the emulated image and the bench (which includes this very file).
//
// ```text
// A5 | subject u8 | value u16 | time u64 | check u8      little-endian; check = all bytes before, xor-ed
// ```
// The image sends what it drives and, with the time at which it saw them, the inputs it was given; the bench sends
// inputs and questions, with time 0. A receiver that has lost step looks for the next A5 whose message checks.

/// First byte of every message.
const START: u8 = 0xA5;
/// Bytes of a message.
pub const MESSAGE_BYTES: usize = 13;

/// What a message is about. Levels are 0 and 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Subject {
    // Outputs of the image.
    LedEnable = 1,
    /// Value in milliamperes.
    LedCurrent = 2,
    DmdTrigger = 3,
    CameraTrigger = 4,
    /// Value is the DMD index; answered by `PatternTaken`.
    SelectPattern = 5,
    /// The image has started; value is the cause of the start.
    Started = 6,
    // Inputs of the image; sent back when seen.
    LedSense = 16,
    DmdReady = 17,
    CameraReady = 18,
    CameraExposing = 19,
    PatternTaken = 20,
    // Questions; the answer repeats the subject with a value.
    /// Most stack ever used, bytes.
    StackUsed = 32,
    /// Longest time from an alarm's due time to its interrupt, us.
    AlarmLatency = 33,
}

impl Subject {
    const ALL: [Self; 13] = [
        Self::LedEnable,
        Self::LedCurrent,
        Self::DmdTrigger,
        Self::CameraTrigger,
        Self::SelectPattern,
        Self::Started,
        Self::LedSense,
        Self::DmdReady,
        Self::CameraReady,
        Self::CameraExposing,
        Self::PatternTaken,
        Self::StackUsed,
        Self::AlarmLatency,
    ];

    fn from_number(number: u8) -> Option<Self> {
        Self::ALL.into_iter().find(|subject| *subject as u8 == number)
    }
}

/// One message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PinMessage {
    pub subject: Subject,
    pub value: u16,
    /// The image's own time, us.
    pub at_us: u64,
}

impl PinMessage {
    /// As it goes over the wire.
    pub fn to_bytes(self) -> [u8; MESSAGE_BYTES] {
        let [v0, v1] = self.value.to_le_bytes();
        let [t0, t1, t2, t3, t4, t5, t6, t7] = self.at_us.to_le_bytes();
        let body = [START, self.subject as u8, v0, v1, t0, t1, t2, t3, t4, t5, t6, t7];
        let check = body.iter().fold(0, |check, byte| check ^ byte);
        let [a, b, c, d, e, f, g, h, i, j, k, l] = body;
        [a, b, c, d, e, f, g, h, i, j, k, l, check]
    }

    fn from_bytes(bytes: [u8; MESSAGE_BYTES]) -> Option<Self> {
        let [start, subject, v0, v1, t0, t1, t2, t3, t4, t5, t6, t7, _] = bytes;
        let whole = start == START && bytes.iter().fold(0, |check, byte| check ^ byte) == 0;
        Some(Self {
            subject: Subject::from_number(subject).filter(|_| whole)?,
            value: u16::from_le_bytes([v0, v1]),
            at_us: u64::from_le_bytes([t0, t1, t2, t3, t4, t5, t6, t7]),
        })
    }
}

/// Bytes to messages.
#[derive(Debug, Clone, Default)]
pub struct PinDecoder {
    /// The last bytes, oldest first.
    window: [u8; MESSAGE_BYTES],
}

impl PinDecoder {
    pub const fn new() -> Self {
        Self { window: [0; MESSAGE_BYTES] }
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
