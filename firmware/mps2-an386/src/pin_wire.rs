// Messages about virtual pins between the emulated image and the bench (which includes this very file).
//
// ```text
// image -> bench:  A5 | subject u8 | value u16 | time u64 | check u8     little-endian, check = CRC-8 of all bytes before
// bench -> image:  5A | subject u8 | value u8 | check u8                 short, for an emulated UART is slow
// ```
// The image sends what it drives and, with the time at which it saw them, the inputs it was given; the bench sends
// inputs and questions. A receiver that has lost step finds it again at the next message that checks.

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
    HeadClear1 = 7,
    HeadClear2 = 8,
    Go = 9,
    NoGo = 10,
    VerdictBeat = 11,
    // Inputs of the image; sent back when seen.
    LedSense = 16,
    DmdReady = 17,
    CameraReady = 18,
    CameraExposing = 19,
    PatternTaken = 20,
    PressOpenA = 21,
    PressOpenB = 22,
    DieClear = 23,
    GuardClosed = 24,
    Cycle = 25,
    RetractSwitch = 26,
    // Questions; the answer repeats the subject with a value.
    /// Most stack ever used, bytes.
    StackUsed = 32,
    /// Longest time from an alarm's due time to its interrupt, us.
    AlarmLatency = 33,
    /// Asked by the image, answered by the bench: are you there?
    Tick = 34,
    /// Order to hang, panic or fault; only an image built for it obeys.
    Drill = 35,
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
        Self::Drill,
    ];

    fn from_number(number: u8) -> Option<Self> {
        Self::ALL
            .into_iter()
            .find(|subject| *subject as u8 == number)
    }
}

/// A message to the image, as it goes over the wire.
#[allow(dead_code)] // each end uses its half of this file
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
#[allow(dead_code)]
pub struct InputDecoder {
    window: [u8; INPUT_BYTES],
}

#[allow(dead_code)]
impl InputDecoder {
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
    pub subject: Subject,
    pub value: u16,
    /// The image's own time, us.
    pub at_us: u64,
}

impl PinMessage {
    /// As it goes over the wire.
    #[allow(dead_code)]
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

    #[allow(dead_code)]
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
#[allow(dead_code)]
pub struct PinDecoder {
    /// The last bytes, oldest first.
    window: [u8; MESSAGE_BYTES],
}

#[allow(dead_code)]
impl PinDecoder {
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
