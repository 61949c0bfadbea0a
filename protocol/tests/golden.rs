//! The bytes of every message, pinned. `BLESS=1 cargo test -p flankscope-protocol` rewrites them; raise
//! `PROTOCOL_VERSION` in the same commit.

mod common;

use common::{HEADER, commands, events, frame, longest_plan, replies};
use crc::{CRC_32_ISCSI, Crc};
use flankscope_protocol::{
    Command, Decoder, MAX_FRAME_BYTES, Message, PROTOCOL_VERSION, SCHEMA_HASH,
};
use std::fmt::{Debug, Write as _};

const GOLDEN: &str = include_str!("golden.txt");

fn lines<M: Message + Debug>(messages: &[M]) -> Vec<(String, Vec<u8>)> {
    messages
        .iter()
        .map(|message| (format!("{message:?}"), frame(message)))
        .collect()
}

fn all() -> Vec<(String, Vec<u8>)> {
    [lines(&commands()), lines(&replies()), lines(&events())].concat()
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |mut text, byte| {
        let _ = write!(text, "{byte:02x}");
        text
    })
}

#[test]
fn every_message_has_its_golden_bytes() {
    let ours = all().iter().fold(String::new(), |mut text, (name, bytes)| {
        let _ = writeln!(text, "{name}\n  {}", hex(bytes));
        text
    });
    if std::env::var_os("BLESS").is_some() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/golden.txt");
        std::fs::write(path, &ours).expect("the golden file can be written");
        return;
    }
    for (number, (ours, golden)) in ours.lines().zip(GOLDEN.lines()).enumerate() {
        assert_eq!(ours, golden, "line {} of golden.txt", number + 1);
    }
    assert_eq!(
        ours.lines().count(),
        GOLDEN.lines().count(),
        "lines in golden.txt"
    );
}

#[test]
fn the_schema_hash_is_that_of_the_golden_bytes() {
    let bytes: Vec<u8> = all().into_iter().flat_map(|(_, bytes)| bytes).collect();
    let hash = Crc::<u32>::new(&CRC_32_ISCSI).checksum(&bytes);
    assert_eq!(
        SCHEMA_HASH, hash,
        "layout changed: set SCHEMA_HASH to {hash:#010x}, raise PROTOCOL_VERSION"
    );
    assert_ne!(PROTOCOL_VERSION, 0);
}

#[test]
fn every_message_comes_back() {
    fn round_trip<M: Message + PartialEq + Debug>(messages: &[M]) {
        let mut decoder = Decoder::new();
        for message in messages {
            let wire = frame(message);
            let mut received = Vec::new();
            for &byte in &wire {
                if let Some(frame) = decoder.push(byte) {
                    let frame = frame.expect("undamaged");
                    assert_eq!((frame.header(), frame.kind()), (HEADER, M::KIND));
                    received.push(frame.message::<M>().expect("the same message"));
                }
            }
            assert_eq!(received.as_slice(), std::slice::from_ref(message));
            assert!(
                !wire[1..wire.len() - 1].contains(&0),
                "a delimiter inside {message:?}"
            );
        }
    }
    round_trip(&commands());
    round_trip(&replies());
    round_trip(&events());
    round_trip(&[Command::LoadPlan(longest_plan())]);
}

#[test]
fn the_longest_plan_fits_with_little_to_spare() {
    let length = frame(&Command::LoadPlan(longest_plan())).len();
    assert!(
        length <= MAX_FRAME_BYTES && length + 80 > MAX_FRAME_BYTES,
        "{length} of {MAX_FRAME_BYTES} bytes"
    );
}
