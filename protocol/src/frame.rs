//! Frames: one message each, self-delimiting, self-checking.
//!
//! ```text
//! 00 | COBS( version u8 | kind u8 | session u32 | sequence u16 | ack u16 | postcard payload | CRC-32C u32 ) | 00
//!            all integers little-endian; the CRC covers everything before it
//! ```
//! COBS (Cheshire & Baker, 1999) keeps 0x00 out of the frame, so a receiver that has lost step is in step again at the
//! next 0x00. The leading 0x00 ends whatever junk came before, so junk never costs the frame behind it. CRC-32C
//! (Castagnoli, 1993) finds every error of up to 5 bits in frames of this length.
//!
//! Sequence numbers: the host counts its commands; a retry repeats session and sequence, so the controller can tell it
//! from a new command and answer again without doing it again. A reply's `ack` is the command's sequence. Events have
//! a count of their own in `sequence`, from 1 in each session, and a reply repeats the number of the latest one: so the
//! host sees when one is missing, the last one included.

use crate::message::{Command, Event, Reply};
use crc::{CRC_32_ISCSI, Crc};
use serde::Serialize;
use serde::de::DeserializeOwned;

/// Version of the frame layout in this file. Messages have [`crate::PROTOCOL_VERSION`].
pub const FRAME_VERSION: u8 = 1;
/// Longest postcard payload; the largest plan takes about 270 bytes.
pub const MAX_PAYLOAD_BYTES: usize = 320;
/// Header before the payload.
const HEADER_BYTES: usize = 1 + 1 + 4 + 2 + 2;
const CRC_BYTES: usize = 4;
/// Longest frame before COBS.
const MAX_RAW_BYTES: usize = HEADER_BYTES + MAX_PAYLOAD_BYTES + CRC_BYTES;
/// COBS adds one byte per 254, and one.
const MAX_COBS_BYTES: usize = MAX_RAW_BYTES + MAX_RAW_BYTES / 254 + 1;
/// Longest frame on the wire, with both delimiters.
pub const MAX_FRAME_BYTES: usize = MAX_COBS_BYTES + 2;

const CHECKSUM: Crc<u32> = Crc::<u32>::new(&CRC_32_ISCSI);

/// What a frame carries.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Kind {
    /// A [`Command`].
    Command = 1,
    /// A [`Reply`].
    Reply = 2,
    /// An [`Event`].
    Event = 3,
}

impl Kind {
    fn from_wire(byte: u8) -> Option<Self> {
        [Self::Command, Self::Reply, Self::Event]
            .into_iter()
            .find(|kind| *kind as u8 == byte)
    }
}

/// Something that fits into a frame.
pub trait Message: Serialize + DeserializeOwned {
    /// How frames that carry it are marked.
    const KIND: Kind;
}

impl Message for Command {
    const KIND: Kind = Kind::Command;
}
impl Message for Reply {
    const KIND: Kind = Kind::Reply;
}
impl Message for Event {
    const KIND: Kind = Kind::Event;
}

/// Addressing of a frame.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash)]
pub struct Header {
    /// Link session, chosen by the host in its hello; 0 before any.
    pub session: u32,
    /// The sender's count: per command for the host, per event for the controller; in a reply that of the latest event.
    pub sequence: u16,
    /// In a reply: sequence of the command it answers. In an event: of the last command answered.
    pub ack: u16,
}

/// Why a message could not be framed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum EncodeError {
    /// The payload exceeds [`MAX_PAYLOAD_BYTES`].
    #[error("the message does not fit into {limit} bytes")]
    PayloadTooLong {
        /// Longest payload.
        limit: usize,
    },
    /// The buffer given is too short for this frame; [`MAX_FRAME_BYTES`] always suffices.
    #[error(
        "the frame does not fit into the {limit} bytes given; {MAX_FRAME_BYTES} always suffice"
    )]
    BufferTooShort {
        /// Length of the buffer.
        limit: usize,
    },
}

/// Why bytes were dropped instead of becoming a message. Each reason can be counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, thiserror::Error)]
pub enum DecodeError {
    /// More bytes without a delimiter than any frame has.
    #[error("more than {MAX_COBS_BYTES} bytes without a delimiter")]
    TooLong,
    /// The byte stuffing is broken.
    #[error("broken byte stuffing")]
    Stuffing,
    /// Fewer bytes than a header and a checksum.
    #[error("frame of {got} bytes is shorter than header and checksum")]
    TooShort {
        /// Bytes received.
        got: usize,
    },
    /// The checksum does not match.
    #[error("checksum mismatch")]
    Checksum,
    /// Another frame layout.
    #[error("frame layout {got} instead of {FRAME_VERSION}")]
    Version {
        /// Version received.
        got: u8,
    },
    /// An unknown kind of frame.
    #[error("unknown kind of frame {got}")]
    UnknownKind {
        /// Kind received.
        got: u8,
    },
    /// A known kind, but not the one asked for.
    #[error("a {got:?} frame where a {want:?} was expected")]
    WrongKind {
        /// Kind received.
        got: Kind,
        /// Kind asked for.
        want: Kind,
    },
    /// The payload is no message of this version.
    #[error("the payload is no message of this version")]
    Payload,
    /// The payload is a message with bytes left over.
    #[error("{got} bytes left over behind the message")]
    Leftover {
        /// Bytes left over.
        got: usize,
    },
}

/// Frames `message` into `out`, delimiters included, and returns the length.
///
/// # Errors
/// The message or the frame does not fit.
pub fn encode<M: Message>(
    header: Header,
    message: &M,
    out: &mut [u8],
) -> Result<usize, EncodeError> {
    let mut raw: heapless::Vec<u8, MAX_RAW_BYTES> = heapless::Vec::new();
    let mut payload = [0u8; MAX_PAYLOAD_BYTES];
    let too_long = EncodeError::PayloadTooLong {
        limit: MAX_PAYLOAD_BYTES,
    };
    let payload = postcard::to_slice(message, &mut payload).map_err(|_| too_long)?;
    for part in [
        [FRAME_VERSION, M::KIND as u8].as_slice(),
        &header.session.to_le_bytes(),
        &header.sequence.to_le_bytes(),
        &header.ack.to_le_bytes(),
        payload,
    ] {
        raw.extend_from_slice(part).map_err(|_| too_long)?;
    }
    let checksum = CHECKSUM.checksum(&raw);
    raw.extend_from_slice(&checksum.to_le_bytes())
        .map_err(|_| too_long)?;

    let too_short = EncodeError::BufferTooShort { limit: out.len() };
    let (first, rest) = out.split_first_mut().ok_or(too_short)?;
    *first = 0;
    let stuffed = cobs::try_encode(&raw, rest).map_err(|_| too_short)?;
    *rest.get_mut(stuffed).ok_or(too_short)? = 0;
    Ok(stuffed.saturating_add(2))
}

/// A whole, undamaged frame; its payload is not read yet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Frame<'a> {
    header: Header,
    kind: Kind,
    payload: &'a [u8],
}

impl Frame<'_> {
    /// Addressing.
    #[must_use]
    pub fn header(&self) -> Header {
        self.header
    }

    /// What it carries.
    #[must_use]
    pub fn kind(&self) -> Kind {
        self.kind
    }

    /// The message it carries.
    ///
    /// # Errors
    /// The frame carries another kind, or the payload is not exactly one message of this version.
    // A decoder is a kilobyte and more: not once for every place that an optimiser finds for it.
    #[inline(never)]
    pub fn message<M: Message>(&self) -> Result<M, DecodeError> {
        if self.kind != M::KIND {
            return Err(DecodeError::WrongKind {
                got: self.kind,
                want: M::KIND,
            });
        }
        let (message, rest) =
            postcard::take_from_bytes(self.payload).map_err(|_| DecodeError::Payload)?;
        if rest.is_empty() {
            Ok(message)
        } else {
            Err(DecodeError::Leftover { got: rest.len() })
        }
    }
}

/// Collects bytes into frames and finds its step again after any junk.
#[derive(Debug, Clone, Default)]
pub struct Decoder {
    bytes: heapless::Vec<u8, MAX_COBS_BYTES>,
    overlong: bool,
    /// The last push ended a frame, which may still be lent out of `bytes`.
    ended: bool,
}

impl Decoder {
    /// An empty decoder.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            bytes: heapless::Vec::new(),
            overlong: false,
            ended: false,
        }
    }

    /// Takes one byte; returns a frame or the reason for dropping one when the byte ends it.
    ///
    /// Two delimiters in a row are no frame and no error.
    pub fn push(&mut self, byte: u8) -> Option<Result<Frame<'_>, DecodeError>> {
        if self.ended {
            *self = Self::new();
        }
        if byte != 0 {
            // Once overlong, nothing is a frame until the next delimiter.
            self.overlong |= self.bytes.push(byte).is_err();
            return None;
        }
        self.ended = true;
        if self.overlong {
            return Some(Err(DecodeError::TooLong));
        }
        if self.bytes.is_empty() {
            return None;
        }
        Some(open(&mut self.bytes))
    }
}

/// Undoes COBS in place and returns the length; `None` if a block runs over the end. Cannot panic.
fn unstuff(bytes: &mut [u8]) -> Option<usize> {
    let (mut read, mut written) = (0usize, 0usize);
    while let Some(&block) = bytes.get(read) {
        read = read.saturating_add(1);
        for _ in 1..block {
            let byte = *bytes.get(read)?;
            // Writing never overtakes reading: a block has one byte more than it stands for.
            *bytes.get_mut(written)? = byte;
            read = read.saturating_add(1);
            written = written.saturating_add(1);
        }
        // A full block, and the last one, stand for no zero.
        if block != u8::MAX && read < bytes.len() {
            *bytes.get_mut(written)? = 0;
            written = written.saturating_add(1);
        }
    }
    Some(written)
}

/// Unstuffs and checks one frame in place.
fn open(bytes: &mut [u8]) -> Result<Frame<'_>, DecodeError> {
    let length = unstuff(bytes).ok_or(DecodeError::Stuffing)?;
    let raw = bytes.get(..length).ok_or(DecodeError::Stuffing)?;
    let too_short = DecodeError::TooShort { got: length };
    let (covered, checksum) = raw.split_last_chunk::<CRC_BYTES>().ok_or(too_short)?;
    let (header, payload) = covered
        .split_first_chunk::<HEADER_BYTES>()
        .ok_or(too_short)?;
    if CHECKSUM.checksum(covered) != u32::from_le_bytes(*checksum) {
        return Err(DecodeError::Checksum);
    }
    let &[version, kind, s0, s1, s2, s3, n0, n1, a0, a1] = header;
    if version != FRAME_VERSION {
        return Err(DecodeError::Version { got: version });
    }
    let kind = Kind::from_wire(kind).ok_or(DecodeError::UnknownKind { got: kind })?;
    let header = Header {
        session: u32::from_le_bytes([s0, s1, s2, s3]),
        sequence: u16::from_le_bytes([n0, n1]),
        ack: u16::from_le_bytes([a0, a1]),
    };
    Ok(Frame {
        header,
        kind,
        payload,
    })
}
