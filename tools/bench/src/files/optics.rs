//! `optics.toml`: the design of a head with all optical properties; used by the bench only, because a head file does not contain them.

use std::path::Path;
use std::str::FromStr;

use super::{FileError, parse, read};
use crate::world::{AT_HAND, Driven, HeadDesign};

/// Name of the file, in the folder of a tool or target.
pub const FILE: &str = "optics.toml";

/// The head in the folder of a tool or target file, else that of the demo.
pub fn made_head_beside(file: &Path) -> Result<HeadDesign, FileError> {
    let path = file.with_file_name(FILE);
    match path.exists() {
        true => checked(read(&path)?, &path),
        false => Ok(HeadDesign::demo()),
    }
}

/// Checks values that the world does not check.
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
        // Written so that NaN fails.
        if !(got > 0.0 && got < 1e4) {
            return Err(bad(key, got, "above 0 and below 10 000"));
        }
    }
    if !(head.angle_deg > 0.0 && head.angle_deg < 90.0) {
        return Err(bad("angle_deg", head.angle_deg, "above 0 and below 90"));
    }
    if let Some(angle_deg) = head.second_angle_deg
        && !(angle_deg > 0.0 && angle_deg < 90.0)
    {
        let expected = "above 0 and below 90: it is on the camera's other side";
        return Err(bad("second_angle_deg", angle_deg, expected));
    }
    if head.volume_mm[0] >= head.volume_mm[1] {
        let expected = "beyond volume_mm[0]";
        return Err(bad("volume_mm[1]", head.volume_mm[1], expected));
    }
    check_lens(&head, bad)?;
    Ok(head)
}

/// Checks that a liquid lens forms an image, and is driven within its range.
fn check_lens(
    head: &HeadDesign,
    bad: impl Fn(&'static str, f64, &'static str) -> FileError,
) -> Result<(), FileError> {
    let driven = head.driven;
    let Some(lens) = &head.lens else {
        return match driven {
            Some(driven) => Err(bad(
                "driven.setting_dpt",
                driven.setting_dpt,
                "left out: this head has no [lens]",
            )),
            None => Ok(()),
        };
    };
    // Written so that NaN fails, here and below.
    if !(lens.apart_mm >= 0.0 && lens.apart_mm < head.stand_off_mm) {
        let expected = "0 or more, and less than stand_off_mm";
        return Err(bad("lens.apart_mm", lens.apart_mm, expected));
    }
    let [least_dpt, most_dpt] = lens.range_dpt;
    if !(least_dpt < most_dpt && least_dpt > -20.0 && most_dpt < 20.0) {
        let expected = "beyond range_dpt[0], both within 20 dpt of nothing";
        return Err(bad("lens.range_dpt[1]", most_dpt, expected));
    }
    for (key, got, least, most) in [
        ("lens.zero_counts", lens.zero_counts, 0.0, 1023.0),
        ("lens.dpt_per_count", lens.dpt_per_count.abs(), 1e-4, 1.0),
    ] {
        if !(least..=most).contains(&got) {
            return Err(bad(key, got, "0 to 1023 counts, 0.0001 to 1 dpt each"));
        }
    }
    let decentres = [lens.camera_decentre_mm, lens.projector_decentre_mm];
    for mm in decentres.into_iter().flatten() {
        if !(-1.0..=1.0).contains(&mm) {
            let expected = "at most a millimetre either way";
            return Err(bad("lens decentre_mm", mm, expected));
        }
    }
    if !(-1.0..=1.0).contains(&lens.drift_dpt_per_kelvin) {
        let expected = "at most a dioptre per kelvin either way";
        return Err(bad(
            "lens.drift_dpt_per_kelvin",
            lens.drift_dpt_per_kelvin,
            expected,
        ));
    }
    let celsius = driven.and_then(|driven| driven.celsius);
    for (key, celsius) in [
        ("lens.neutral_celsius", lens.neutral_celsius),
        ("driven.celsius", celsius.unwrap_or(lens.neutral_celsius)),
    ] {
        if !(celsius > -50.0 && celsius < 100.0) {
            return Err(bad(key, celsius, "above -50 and below 100"));
        }
    }
    let Some(driven) = driven else { return Ok(()) };
    if !(least_dpt..=most_dpt).contains(&driven.setting_dpt) {
        let expected = "within lens.range_dpt";
        return Err(bad("driven.setting_dpt", driven.setting_dpt, expected));
    }
    // Drift adds to the range; with both, best focus must still be in front of the lens.
    let near_mm = head.best_focus_mm() - lens.apart_mm;
    if !(near_mm > 0.0 && near_mm < 1e4) {
        let expected = "such that something before the lens is in focus";
        return Err(bad("driven.setting_dpt", driven.setting_dpt, expected));
    }
    Ok(())
}

/// The setting after the last `@`: dioptres, and degrees Celsius if given. `None` if no number follows, because a file name may
/// contain `@`.
fn driven_in(given: &str) -> (&str, Option<Driven>) {
    let finite = |text: &str| text.parse().ok().filter(|number: &f64| number.is_finite());
    let setting = given.rsplit_once('@').and_then(|(head, setting)| {
        let (dpt, celsius) = match setting.split_once(',') {
            Some((dpt, celsius)) => (dpt, Some(finite(celsius)?)),
            None => (setting, None),
        };
        let setting_dpt = finite(dpt)?;
        Some((
            head,
            Driven {
                setting_dpt,
                celsius,
            },
        ))
    });
    setting.map_or((given, None), |(head, driven)| (head, Some(driven)))
}

/// A built-in head by its name, or any other by its file, with the setting of its liquid lenses (`liquid@1.5`, or `liquid@1.5,30`
/// at a lens temperature of 30 °C). The text is written into a folder unchanged, followed by the setting.
#[derive(Clone, Debug, PartialEq)]
pub struct MadeHead {
    /// Name or file, as given.
    pub given: String,
    pub optics: Box<HeadDesign>,
    /// Text of its file.
    pub text: String,
}

impl FromStr for MadeHead {
    type Err = FileError;

    fn from_str(given: &str) -> Result<Self, FileError> {
        let (head, driven) = driven_in(given);
        let path = Path::new(head);
        let mut text = match AT_HAND.iter().find(|(name, _)| *name == head) {
            Some((_, text)) => (*text).to_owned(),
            None => super::text(path)?,
        };
        if let Some(driven) = driven {
            text += &format!("\n[driven]\nsetting_dpt = {:?}\n", driven.setting_dpt);
            if let Some(celsius) = driven.celsius {
                text += &format!("celsius = {celsius:?}\n");
            }
        }
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

    #[test]
    fn a_liquid_lens_is_driven_within_its_range() {
        let made = |given: &str| given.parse::<MadeHead>();
        let radius_mm = |given: &str| made(given).unwrap().optics.driven_radius_mm();
        assert_eq!(radius_mm("liquid"), 41.5);
        assert_eq!(radius_mm("liquid@0"), 41.5);
        assert!(radius_mm("liquid@3") < 40.5 && radius_mm("liquid@-3,23") > 42.5);
        // A kelvin changes the power by a twentieth of a dioptre.
        assert!((radius_mm("liquid@1,43") - radius_mm("liquid@2")).abs() < 1e-9);
        for (given, key) in [
            ("liquid@4.5", "driven.setting_dpt = 4.5"),
            ("liquid@nan", "liquid@nan"),
            ("liquid@1,inf", "liquid@1,inf"),
            ("liquid@1,200", "driven.celsius = 200"),
            ("20mm@1", "driven.setting_dpt = 1"),
            ("liquid@near", "liquid@near"),
        ] {
            let words = made(given).unwrap_err().to_string();
            assert!(words.contains(key), "{given}: {words}");
        }
    }
}
