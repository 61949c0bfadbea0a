//! `optics.toml`: a head as it was made, with all that light does in it; the bench's alone, for no head file tells that.

use std::path::Path;
use std::str::FromStr;

use super::{FileError, parse, read};
use crate::world::{AT_HAND, HeadDesign};

/// Name of the file, beside a tool's or a target's.
pub const FILE: &str = "optics.toml";

/// The head beside a tool's or target's file, else that of the demo.
///
/// # Errors
/// [`FileError`].
pub fn made_head_beside(file: &Path) -> Result<HeadDesign, FileError> {
    let path = file.with_file_name(FILE);
    match path.exists() {
        true => checked(read(&path)?, &path),
        false => Ok(HeadDesign::demo()),
    }
}

/// What a file states and no part of a world checks.
fn checked(head: HeadDesign, path: &Path) -> Result<HeadDesign, FileError> {
    let lengths = [
        ("working_distance_mm", head.working_distance_mm),
        ("stand_off_mm", head.stand_off_mm),
        ("focus_radius_mm", head.focus_radius_mm),
        ("field_mm", head.field_mm),
        ("camera.circle_px", head.camera.circle_px),
        ("projector.circle_px", head.projector.circle_px),
        ("volume_mm[0]", head.volume_mm[0]),
        ("volume_mm[1]", head.volume_mm[1]),
    ];
    let bad = |key: &'static str, got: f64, expected: &'static str| FileError::Value {
        path: path.to_path_buf(),
        key,
        got,
        expected,
    };
    for (key, got) in lengths {
        // Written so that a NaN fails.
        if !(got > 0.0 && got < 1e4) {
            return Err(bad(key, got, "above 0 and below 10 000"));
        }
    }
    if !(head.angle_deg > 0.0 && head.angle_deg < 90.0) {
        return Err(bad("angle_deg", head.angle_deg, "above 0 and below 90"));
    }
    if head.volume_mm[0] >= head.volume_mm[1] {
        let expected = "beyond volume_mm[0]";
        return Err(bad("volume_mm[1]", head.volume_mm[1], expected));
    }
    Ok(head)
}

/// A head that comes along, by its name, or any other, by its file; its text goes into a folder as it is.
#[derive(Clone, Debug, PartialEq)]
pub struct MadeHead {
    /// As it was asked for.
    pub given: String,
    /// What it is.
    pub optics: Box<HeadDesign>,
    /// As it is written.
    pub text: String,
}

impl FromStr for MadeHead {
    type Err = FileError;

    fn from_str(given: &str) -> Result<Self, FileError> {
        let path = Path::new(given);
        let text = match AT_HAND.iter().find(|(name, _)| *name == given) {
            Some((_, text)) => (*text).to_owned(),
            None => super::text(path)?,
        };
        let optics = checked(parse(path, &text)?, path)?;
        Ok(Self {
            given: given.to_owned(),
            optics: Box::new(optics),
            text,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_head_is_refused_with_its_key() {
        let text = AT_HAND[1].1;
        let refused = |from: &str, to: &str| {
            assert!(text.contains(from), "{from}");
            let given = text.replacen(from, to, 1);
            let path = Path::new("x");
            let made = parse(path, &given).and_then(|head| checked(head, path));
            made.err().map(|error| error.to_string())
        };
        assert_eq!(refused("30.0", "29.0"), None);
        for (from, to, key) in [
            ("stand_off_mm = 22.0", "stand_off_mm = 0.0", "stand_off_mm"),
            ("field_mm = 10.0", "field_mm = nan", "field_mm"),
            ("angle_deg = 30.0", "angle_deg = inf", "angle_deg"),
            ("20.3, 23.7", "23.7, 20.3", "volume_mm[1]"),
            ("field_mm", "feld_mm", "feld_mm"),
        ] {
            let words = refused(from, to).unwrap_or_default();
            assert!(words.contains(key), "{to}: {words}");
        }
    }
}
