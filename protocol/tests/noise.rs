//! Junk and damage: nothing panics, nothing damaged is accepted, one delimiter restores step.

mod common;

use common::{HEADER, commands, events, frame, replies, short_plan};
use flankscope_protocol::{Command, DecodeError, Decoder, Event, Header, Reply};
use rand::{Rng, RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// Frames that a decoder accepts out of `wire`, and its complaints.
fn decode(wire: &[u8]) -> (Vec<(Header, Vec<u8>)>, Vec<DecodeError>) {
    let mut decoder = Decoder::new();
    let (mut accepted, mut dropped) = (Vec::new(), Vec::new());
    for &byte in wire {
        match decoder.push(byte) {
            None => {}
            Some(Ok(whole)) => {
                let bytes = match whole.kind() {
                    flankscope_protocol::Kind::Command => {
                        whole.message::<Command>().map(|m| frame(&m))
                    }
                    flankscope_protocol::Kind::Reply => whole.message::<Reply>().map(|m| frame(&m)),
                    flankscope_protocol::Kind::Event => whole.message::<Event>().map(|m| frame(&m)),
                };
                match bytes {
                    Ok(bytes) => accepted.push((whole.header(), bytes)),
                    Err(error) => dropped.push(error),
                }
            }
            Some(Err(error)) => dropped.push(error),
        }
    }
    (accepted, dropped)
}

fn accepts_anything(wire: &[u8], decoder: &mut Decoder) -> bool {
    wire.iter()
        .any(|&byte| matches!(decoder.push(byte), Some(Ok(_))))
}

fn flip(wire: &mut [u8], bit: usize) {
    wire[bit / 8] ^= 1 << (bit % 8);
}

/// Every way to flip one, two or three bits, delimiters included.
///
/// Flips in a delimiter can leave the frame itself whole (an opening 0x00 turned to junk is refused with the frame
/// behind it; a closing one merely keeps the frame open), so what counts is that nothing *else* is ever accepted.
#[test]
fn no_one_two_or_three_flipped_bits_pass_in_any_command() {
    for command in commands() {
        let original = frame(&command);
        let bits = original.len() * 8;
        let mut decoder = Decoder::new();
        let mut tried = 0u64;
        let mut check = |wire: &[u8], flipped: &[usize]| {
            decoder = Decoder::new();
            tried += 1;
            assert!(
                !accepts_anything(wire, &mut decoder),
                "{command:?} with bits {flipped:?} flipped was accepted"
            );
        };
        let mut wire = original.clone();
        // The longest command has 37 million triples; a third bit in every second place keeps the test short there.
        let stride = if bits > 400 { 7 } else { 1 };
        for a in 8..bits {
            flip(&mut wire, a);
            check(&wire, &[a]);
            for b in a + 1..bits {
                flip(&mut wire, b);
                check(&wire, &[a, b]);
                for c in (b + 1..bits).step_by(stride) {
                    flip(&mut wire, c);
                    check(&wire, &[a, b, c]);
                    flip(&mut wire, c);
                }
                flip(&mut wire, b);
            }
            flip(&mut wire, a);
        }
        if stride == 1 {
            let n = bits as u64 - 8;
            assert_eq!(tried, n + n * (n - 1) / 2 + n * (n - 1) * (n - 2) / 6);
        }
    }
}

#[test]
fn no_frame_with_many_flipped_bits_passes() {
    let mut random = Pcg64Mcg::seed_from_u64(20);
    let frames: Vec<Vec<u8>> = commands()
        .iter()
        .map(frame)
        .chain(replies().iter().map(frame))
        .chain(events().iter().map(frame))
        .collect();
    for _ in 0..100_000 {
        let original = &frames[random.random_range(0..frames.len())];
        let mut wire = original.clone();
        for _ in 0..random.random_range(1..=24) {
            let bit = random.random_range(8..wire.len() * 8);
            flip(&mut wire, bit);
        }
        if wire != *original {
            let (accepted, _) = decode(&wire);
            assert!(
                accepted.is_empty(),
                "{wire:02x?} made of {original:02x?} was accepted"
            );
        }
    }
}

#[test]
fn no_random_bytes_pass_and_a_frame_behind_them_does() {
    let mut random = Pcg64Mcg::seed_from_u64(21);
    let whole = frame(&Command::LoadPlan(short_plan()));
    for round in 0..20_000 {
        let length = random.random_range(0..if round % 100 == 0 { 4_000 } else { 120 });
        let mut wire = vec![0; length];
        random.fill_bytes(&mut wire);
        assert_eq!(decode(&wire).0, []);
        wire.extend_from_slice(&whole);
        assert_eq!(
            decode(&wire).0,
            [(HEADER, whole.clone())],
            "the frame behind {length} junk bytes was lost"
        );
    }
}

#[test]
fn a_frame_cut_short_is_dropped_and_the_next_one_passes() {
    for command in commands() {
        let whole = frame(&command);
        for kept in 1..whole.len() - 1 {
            let mut wire = whole[..kept].to_vec();
            wire.extend_from_slice(&whole);
            let (accepted, dropped) = decode(&wire);
            assert_eq!(accepted, [(HEADER, whole.clone())]);
            assert_eq!(
                dropped.len(),
                usize::from(kept > 1),
                "after {kept} bytes of {command:?}"
            );
        }
    }
}

#[test]
fn each_reason_for_dropping_has_its_name() {
    use flankscope_protocol::frame::{FRAME_VERSION, MAX_PAYLOAD_BYTES};
    let seal = |raw: &[u8]| {
        let sum = crc::Crc::<u32>::new(&crc::CRC_32_ISCSI).checksum(raw);
        let mut wire = vec![0; 2 * MAX_PAYLOAD_BYTES];
        let length = cobs::encode(&[raw, &sum.to_le_bytes()].concat(), &mut wire);
        wire.truncate(length + 1);
        wire
    };
    let head = |version: u8, kind: u8| [version, kind, 1, 0, 0, 0, 2, 0, 0, 0];
    let reason = |wire: &[u8]| decode(wire).1;

    assert_eq!(reason(&[5, 1, 0]), [DecodeError::Stuffing]);
    assert_eq!(reason(&[2, 1, 0]), [DecodeError::TooShort { got: 1 }]);
    assert_eq!(
        reason(&[vec![1; 600], vec![0]].concat()),
        [DecodeError::TooLong]
    );
    assert_eq!(
        reason(&seal(&head(FRAME_VERSION + 1, 1))),
        [DecodeError::Version {
            got: FRAME_VERSION + 1
        }]
    );
    assert_eq!(
        reason(&seal(&head(FRAME_VERSION, 9))),
        [DecodeError::UnknownKind { got: 9 }]
    );
    assert_eq!(
        reason(&seal(&[&head(FRAME_VERSION, 1)[..], &[99]].concat())),
        [DecodeError::Payload]
    );
    assert_eq!(
        reason(&seal(&[&head(FRAME_VERSION, 1)[..], &[6, 6]].concat())),
        [DecodeError::Leftover { got: 1 }]
    );
    assert_eq!(
        reason(&seal(&[&head(FRAME_VERSION, 1)[..], &[6]].concat())),
        []
    );
}
