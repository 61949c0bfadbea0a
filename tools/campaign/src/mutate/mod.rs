//! One change to a file, of the kind that its structure has.

mod bytes;
mod document;
mod ply;
mod png;
mod sqlite;

use rand_pcg::Pcg64;

/// What a file is, to whoever changes it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Structure {
    /// Lines, numbers, nothing else known.
    Text,
    Toml,
    Json,
    Sqlite,
    Ply,
    Png,
    Bytes,
}

/// A mutant of a file's content. One in four knows nothing of the structure.
pub fn mutate(content: &[u8], structure: Structure, random: &mut Pcg64) -> Vec<u8> {
    use rand::RngExt;
    let times = if random.random_bool(0.7) {
        1
    } else {
        random.random_range(2..6)
    };
    let mut mutant = content.to_vec();
    for _ in 0..times {
        let aware = random.random_range(0..4) != 0;
        let changed = match structure {
            _ if !aware => None,
            Structure::Text => bytes::numbers(&mutant, random),
            Structure::Toml => {
                document::toml(&mutant, random).or_else(|| bytes::numbers(&mutant, random))
            }
            Structure::Json => {
                document::json(&mutant, random).or_else(|| bytes::numbers(&mutant, random))
            }
            Structure::Sqlite => sqlite::rows(&mutant, random),
            Structure::Ply => ply::header_or_body(&mutant, random),
            Structure::Png => png::chunks(&mutant, random),
            Structure::Bytes => None,
        };
        mutant = changed.unwrap_or_else(|| bytes::any(&mutant, random));
    }
    mutant
}

/// Numbers that files are read wrongly over, as people and programs write them.
pub const NUMBERS: &[&str] = &[
    "0",
    "-0.0",
    "1",
    "-1",
    "0.5",
    "1e-12",
    "1e-308",
    "5e-324",
    "1e9",
    "1e308",
    "-1e308",
    "1e400",
    "nan",
    "inf",
    "-inf",
    "NaN",
    "Infinity",
    "2147483647",
    "2147483648",
    "-2147483649",
    "4294967295",
    "4294967296",
    "9223372036854775807",
    "9223372036854775808",
    "18446744073709551616",
    "65535",
    "65536",
    "255",
    "256",
    "1,5",
    "1.5.2",
    "0x10",
    "1_000",
    "+1",
    "1e",
    "",
    "true",
    "\"1\"",
    "[]",
    "{}",
    "null",
];
