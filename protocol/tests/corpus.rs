//! Bytes of any kind into the decoder: it never panics, and accepts nothing but what it would send itself.
//!
//! The inputs are the fuzzer's own corpus, `fuzz/corpus/decode`, one file each. Those with a name say with it how they
//! end: `whole-` accepted and nothing refused, `bad-` the reverse, `mixed-` both. What the fuzzer adds is named by it.
//! `DECODE_ROUNDS=1000000 cargo test -p flankscope-protocol --test corpus` tries more random ones. An input that fails
//! is printed in hexadecimal: keep it with `xxd -r -p`.

mod common;

use common::feed::feed;
use common::{commands, events, frame, replies};
use rand::{Rng, RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::path::Path;

fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |mut text, byte| {
        let _ = write!(text, "{byte:02x}");
        text
    })
}

/// Prints the input if what follows panics.
struct Shown<'a>(&'a [u8]);

impl Drop for Shown<'_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            println!("keep this in the corpus: {}", hex(self.0));
        }
    }
}

#[test]
fn the_corpus_is_replayed() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/corpus/decode");
    let mut files: Vec<_> = std::fs::read_dir(folder)
        .expect("the corpus")
        .map(|entry| entry.expect("an entry").path())
        .collect();
    files.sort();
    let (mut named, mut endings) = (0, BTreeSet::new());
    for file in files {
        let bytes = std::fs::read(&file).expect("a readable file");
        let shown = Shown(&bytes);
        let (accepted, refused) = feed(&bytes);
        drop(shown);
        let name = file.file_name().unwrap_or_default().to_string_lossy();
        let Some((ending, _)) = name.split_once('-') else {
            continue;
        };
        let as_named = match ending {
            "whole" => accepted > 0 && refused == 0,
            "bad" => accepted == 0 && refused > 0,
            "mixed" => accepted > 0 && refused > 0,
            other => panic!("{other} is no ending: whole, bad, mixed"),
        };
        assert!(as_named, "{name}: {accepted} accepted, {refused} refused");
        named += 1;
        endings.insert(ending.to_string());
    }
    assert!(named >= 8 && endings.len() == 3, "{named} of {endings:?}");
}

/// Random bytes, and real frames with a few bytes replaced, inserted or cut out: the mutations of a fuzzer.
#[test]
fn no_bytes_make_the_decoder_panic_or_accept_what_nobody_sends() {
    let rounds = std::env::var("DECODE_ROUNDS")
        .ok()
        .and_then(|text| text.parse().ok())
        .unwrap_or(100_000u32);
    let mut random = Pcg64Mcg::seed_from_u64(47);
    let frames: Vec<Vec<u8>> = commands()
        .iter()
        .map(frame)
        .chain(replies().iter().map(frame))
        .chain(events().iter().map(frame))
        .collect();
    let (mut accepted, mut refused) = (0, 0);
    for round in 0..rounds {
        let mut bytes = if round % 4 == 0 {
            let mut bytes = vec![0; random.random_range(0..700)];
            random.fill_bytes(&mut bytes);
            bytes
        } else {
            let first = &frames[random.random_range(0..frames.len())];
            let second = &frames[random.random_range(0..frames.len())];
            [first.as_slice(), second].concat()
        };
        for _ in 0..random.random_range(0..6) {
            let at = random.random_range(0..bytes.len().max(1));
            match random.random_range(0..3) {
                0 => bytes.insert(at.min(bytes.len()), random.random()),
                1 if at < bytes.len() => bytes[at] = random.random(),
                _ if at < bytes.len() => drop(bytes.remove(at)),
                _ => {}
            }
        }
        let shown = Shown(&bytes);
        let (one, other) = feed(&bytes);
        drop(shown);
        accepted += one;
        refused += other;
    }
    println!("{rounds} inputs: {accepted} messages accepted, {refused} frames refused");
    assert!(accepted > 0 && refused > 0);
}
