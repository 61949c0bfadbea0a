//! Bytes of any kind into the decoder: it never panics, and accepts nothing but what it would send itself.
//!
//! `corpus/` holds hexadecimal inputs worth keeping, one file each, `#` begins a comment; all are replayed.
//! `DECODE_ROUNDS=1000000 cargo test -p flankscope-protocol --test corpus` tries more random ones. An input that fails
//! is printed in the corpus's format. `protocol/fuzz` is the same for a fuzzer.

mod common;

use common::feed::feed;
use common::{commands, events, frame, replies};
use rand::{Rng, RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
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
            println!("keep this in corpus/: {}", hex(self.0));
        }
    }
}

fn read(path: &Path) -> Vec<u8> {
    let text = std::fs::read_to_string(path).expect("a readable file");
    let digits: String = text
        .lines()
        .map(|line| line.split('#').next().unwrap_or_default())
        .flat_map(str::chars)
        .filter(|c| !c.is_whitespace())
        .collect();
    assert!(
        digits.len().is_multiple_of(2),
        "{}: half a byte",
        path.display()
    );
    (0..digits.len() / 2)
        .map(|n| u8::from_str_radix(&digits[2 * n..2 * n + 2], 16).expect("hexadecimal"))
        .collect()
}

#[test]
fn the_corpus_is_replayed() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/corpus");
    let mut files: Vec<_> = std::fs::read_dir(folder)
        .expect("the corpus")
        .map(|entry| entry.expect("an entry").path())
        .collect();
    files.sort();
    assert!(files.len() >= 8, "{} files", files.len());
    for file in files {
        let bytes = read(&file);
        let (accepted, refused) = feed(&bytes);
        let name = file
            .file_stem()
            .and_then(|name| name.to_str())
            .unwrap_or_default();
        // The name says how it ends.
        match name.split('-').next() {
            Some("whole") => assert!(
                accepted > 0 && refused == 0,
                "{name}: {accepted}, {refused}"
            ),
            Some("bad") => assert!(
                accepted == 0 && refused > 0,
                "{name}: {accepted}, {refused}"
            ),
            Some("mixed") => assert!(accepted > 0 && refused > 0, "{name}: {accepted}, {refused}"),
            other => panic!("{other:?} is no ending: whole, bad, mixed"),
        }
    }
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
