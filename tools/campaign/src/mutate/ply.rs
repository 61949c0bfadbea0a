//! Changes to a PLY file: its header's counts, types and format, and the numbers of its body.

use rand::RngExt;
use rand_pcg::Pcg64;

use super::{NUMBERS, bytes};

const END: &[u8] = b"end_header\n";
const WORDS: &[&str] = &[
    "ply",
    "format",
    "ascii",
    "binary_little_endian",
    "binary_big_endian",
    "1.0",
    "element",
    "vertex",
    "face",
    "property",
    "list",
    "uchar",
    "char",
    "short",
    "ushort",
    "int",
    "uint",
    "float",
    "double",
    "x",
    "y",
    "z",
    "nx",
    "vertex_indices",
    "comment",
    "end_header",
];

/// `None`: it has no header any more.
pub fn header_or_body(content: &[u8], random: &mut Pcg64) -> Option<Vec<u8>> {
    let end = content
        .windows(END.len())
        .position(|window| window == END)?
        + END.len();
    let (header, body) = content.split_at(end);
    if random.random_bool(0.5) {
        let text = std::str::from_utf8(header).ok()?;
        return Some([changed(text, random).as_bytes(), body].concat());
    }
    if text_body(header) {
        return Some([header, &bytes::numbers(body, random)?].concat());
    }
    // A word of the body becomes what no coordinate or index should be.
    let mut mutant = content.to_vec();
    let wide = random.random_bool(0.5);
    let value: &[u8] = match (random.random_range(0..5), wide) {
        (0, true) => &f64::NAN.to_le_bytes(),
        (0, false) => &f32::NAN.to_le_bytes(),
        (1, true) => &f64::INFINITY.to_le_bytes(),
        (1, false) => &f32::INFINITY.to_le_bytes(),
        (2, true) => &1e300f64.to_le_bytes(),
        (2, false) => &1e38f32.to_le_bytes(),
        (3, _) => &u32::MAX.to_le_bytes(),
        _ => &i32::MIN.to_le_bytes(),
    };
    let last = mutant.len().checked_sub(value.len())?;
    let at = random.random_range(end.min(last)..=last);
    mutant[at..at + value.len()].copy_from_slice(value);
    Some(mutant)
}

fn text_body(header: &[u8]) -> bool {
    header.windows(12).any(|window| window == b"format ascii")
}

fn changed(header: &str, random: &mut Pcg64) -> String {
    let mut lines: Vec<String> = header.lines().map(str::to_owned).collect();
    let n = random
        .random_range(0..lines.len().max(1))
        .min(lines.len() - 1);
    match random.random_range(0..5) {
        0 => {
            lines.remove(n);
        }
        1 => {
            let line = lines[n].clone();
            lines.insert(n, line);
        }
        2 => {
            let other = random.random_range(0..lines.len());
            lines.swap(n, other);
        }
        kind => {
            let mut words: Vec<&str> = lines[n].split(' ').collect();
            let word = random.random_range(0..words.len());
            words[word] = match kind {
                3 => WORDS[random.random_range(0..WORDS.len())],
                _ => NUMBERS[random.random_range(0..NUMBERS.len())],
            };
            lines[n] = words.join(" ");
        }
    }
    lines.iter().map(|line| format!("{line}\n")).collect()
}
