//! Changes to bytes, and to the numbers in a text.

use rand::RngExt;
use rand_pcg::Pcg64;

use super::NUMBERS;

/// Flips, overwrites, removes, repeats, inserts or cuts off.
pub fn any(content: &[u8], random: &mut Pcg64) -> Vec<u8> {
    let mut mutant = content.to_vec();
    if mutant.is_empty() {
        return vec![random.random()];
    }
    let at = random.random_range(0..mutant.len());
    let length = 1 << random.random_range(0..12);
    let end = mutant.len().min(at + random.random_range(1..=length));
    match random.random_range(0..8) {
        0 => mutant[at] ^= 1 << random.random_range(0..8),
        1 => mutant[at] = [0, 0xFF, 0x7F, 0x80, b'\n', b' ', b'-', b'"'][random.random_range(0..8)],
        2 => {
            mutant.drain(at..end);
        }
        3 => {
            let piece = mutant[at..end].to_vec();
            let into = random.random_range(0..=mutant.len());
            mutant.splice(into..into, piece);
        }
        4 => mutant.truncate(at),
        5 => {
            let piece: Vec<u8> = (at..end).map(|_| random.random()).collect();
            mutant.splice(at..at, piece);
        }
        6 => mutant[at..end].fill(random.random()),
        _ => {
            let other = random.random_range(0..mutant.len());
            mutant.swap(at, other);
        }
    }
    mutant
}

/// Puts another number in the place of one; `None`: there is none.
pub fn numbers(content: &[u8], random: &mut Pcg64) -> Option<Vec<u8>> {
    let is_number =
        |byte: u8| byte.is_ascii_digit() || matches!(byte, b'.' | b'-' | b'+' | b'e' | b'E');
    let starts: Vec<usize> = (0..content.len())
        .filter(|&at| content[at].is_ascii_digit() && (at == 0 || !is_number(content[at - 1])))
        .collect();
    let start = *starts.get(random.random_range(0..starts.len().max(1)))?;
    let length = content[start..]
        .iter()
        .take_while(|byte| is_number(**byte))
        .count();
    let old = std::str::from_utf8(&content[start..start + length]).ok()?;
    let new = changed(old, random);
    let mut mutant = content.to_vec();
    mutant.splice(start..start + length, new.into_bytes());
    Some(mutant)
}

/// A number that is another, or none.
fn changed(old: &str, random: &mut Pcg64) -> String {
    let Ok(value) = old.parse::<f64>() else {
        return NUMBERS[random.random_range(0..NUMBERS.len())].into();
    };
    match random.random_range(0..6) {
        0 => (-value).to_string(),
        1 => (value * 1000.0).to_string(),
        2 => (value / 1000.0).to_string(),
        3 => (value * (1.0 + 1e-4)).to_string(),
        _ => NUMBERS[random.random_range(0..NUMBERS.len())].into(),
    }
}
