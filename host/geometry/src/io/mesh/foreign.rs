//! Recognition of files that are no mesh that can be read.

use super::{MeshError, stl};

/// Signatures of other formats, their names, and the way to a mesh of them.
const KNOWN: &[(&[u8], &str, &str)] = &[
    (b"ISO-10303-21", "STEP", TESSELLATE),
    (b"DBRep_DrawableShape", "BREP", TESSELLATE),
    (b"OFF", "OFF", CONVERT),
    (b"COFF", "OFF", CONVERT),
    (b"NOFF", "OFF", CONVERT),
    (b"\xff\xfe", "text in UTF-16", UTF8),
    (b"\xfe\xff", "text in UTF-16", UTF8),
    (b"glTF", "glTF", CONVERT),
    (b"PK\x03\x04", "an archive (3MF, ZIP)", CONVERT),
    (b"#VRML", "VRML", CONVERT),
    (b"<", "XML or HTML", CONVERT),
    (b"\x89PNG", "an image (PNG)", CONVERT),
    (b"%PDF", "PDF", CONVERT),
];
const UTF8: &str = "save it as UTF-8";
const TESSELLATE: &str =
    "export a mesh from the CAD system, with a chord error of a few micrometres";
const CONVERT: &str = "convert it to PLY, STL or OBJ";

/// The best explanation: another format by its first bytes, a table of numbers, a damaged binary STL, or none.
pub(super) fn explain(bytes: &[u8]) -> MeshError {
    let start = bytes.trim_ascii_start();
    let known = KNOWN.iter().find(|(magic, ..)| start.starts_with(magic));
    if let Some(&(_, format, advice)) = known {
        return MeshError::OtherFormat { format, advice };
    }
    if is_table(start) {
        return MeshError::OtherFormat {
            format: "a table of numbers",
            advice: "a mesh has triangles; a cloud of points goes to --cloud",
        };
    }
    match stl::declared_size(bytes) {
        Some((declared, need_bytes)) => MeshError::StlSize {
            declared,
            need_bytes,
            have_bytes: bytes.len() as u64,
        },
        None => MeshError::Foreign,
    }
}

/// Whether one of the first two lines (the other may be a heading) holds three numbers and nothing else.
fn is_table(start: &[u8]) -> bool {
    let mut lines = start.split(|&b| b == b'\n').take(2);
    lines.any(|line| {
        let text = String::from_utf8_lossy(&line[..line.len().min(1 << 10)]);
        let is_separator = |c: char| c.is_whitespace() || c == ',' || c == ';';
        let mut words = text.split(is_separator).filter(|word| !word.is_empty());
        let count = words.clone().count();
        count >= 3 && words.all(|word| word.parse::<f64>().is_ok())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told(bytes: &[u8]) -> String {
        explain(bytes).to_string()
    }

    #[test]
    fn other_formats_are_called_by_their_names() {
        // Long enough for the header of a binary STL.
        let long = |start: &str| format!("{start}\n{}", "x ".repeat(100)).into_bytes();
        for (start, name) in [
            ("ISO-10303-21;\nHEADER;", "STEP"),
            ("OFF\n8 6 0", "OFF"),
            ("<?xml version=\"1.0\"?>", "XML"),
            ("x,y,z\n1.0,2.0,3.0", "table of numbers"),
            ("1.0 2.0 3.0 0.5", "table of numbers"),
            ("PK\x03\x04", "3MF"),
        ] {
            let told = told(&long(start));
            assert!(told.contains(name), "{start:?}: {told}");
            assert!(!told.contains("declares"), "{start:?}: {told}");
        }
    }

    #[test]
    fn a_truncated_binary_stl_is_still_told_by_its_size() {
        let mut bytes = vec![b' '; 80];
        bytes.extend(3_u32.to_le_bytes());
        bytes.extend([0; 70]);
        assert!(told(&bytes).contains("3 triangles, which are 234 bytes"));
    }
}
