//! Fringes that a head projects: a set that the instrument knows by name, or one of its own.

use flankscope_foundation::textfile::BadValue;
use serde::{Deserialize, Serialize};

use super::HeadModel;
use crate::pattern::{FringeSet, NAMED, PatternError, PatternSet};

/// A frequency of a head's own set, in the instrument's convention.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fringes {
    /// Periods over the projector's full width: integers, because the controller takes integers.
    pub periods: u32,
    /// Phase steps.
    pub steps: u32,
}

impl HeadModel {
    /// The set that it throws, if its file says which.
    ///
    /// # Errors
    /// [`PatternError`]: an unknown name, or invalid frequencies.
    pub fn patterns(&self) -> Result<Option<PatternSet>, PatternError> {
        let Some(name) = &self.pattern_set else {
            return Ok(None);
        };
        if self.fringes.is_empty() {
            return PatternSet::named(name).map(Some);
        }
        let sets = self.fringes.iter();
        let sets = sets.map(|set| FringeSet::new(f64::from(set.periods), set.steps));
        PatternSet::new(name, sets.collect()).map(Some)
    }

    pub(super) fn check_patterns(&self) -> Result<(), BadValue> {
        let bad = |key: &str, got: &str, expected| Err(BadValue::new(key, got, expected));
        let own = !self.fringes.is_empty();
        match self.pattern_set.as_deref() {
            None if own => {
                return bad("pattern_set", "nothing", "must name the set of [[fringes]]");
            }
            Some(name) if own && NAMED.iter().any(|(known, _)| *known == name) => {
                let expected = "must be another name where the head has [[fringes]] of its own";
                return bad("pattern_set", name, expected);
            }
            // The set's pictures go into a folder of this name.
            Some(name) if own && !is_plain(name) => {
                return bad("pattern_set", name, "must be letters, digits, - and _");
            }
            _ => {}
        }
        let key = |set: usize, name: &str| format!("fringes[{set}].{name}");
        self.patterns()
            .map(drop)
            .map_err(|error| error.bad_value(key))
    }
}

fn is_plain(name: &str) -> bool {
    let plain = |letter: char| letter.is_ascii_alphanumeric() || matches!(letter, '-' | '_');
    !name.is_empty() && name.chars().all(plain)
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEAD: &str = "name = 'test'\n\
        [camera]\nwidth_px = 960\nheight_px = 600\nfocal_px = [1265.0, 1265.0]\nprincipal_px = [480.0, 300.0]\n\
        [projector]\nwidth_px = 1024\nheight_px = 768\nfocal_px = [2300.0, 2310.0]\nprincipal_px = [510.0, 380.0]\n\
        [projector_from_camera]\nrotation = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]\ntranslation_mm = [6.0, 5.0, 0.8]\n";

    fn head(name: Option<&str>, fringes: &[(u32, u32)]) -> HeadModel {
        let mut head: HeadModel = toml::from_str(HEAD).unwrap();
        head.pattern_set = name.map(str::to_owned);
        head.fringes = fringes
            .iter()
            .map(|&(periods, steps)| Fringes { periods, steps })
            .collect();
        head
    }

    #[test]
    fn a_set_of_its_own_goes_by_its_own_name_and_frequencies() {
        let head = head(Some("mine14"), &[(37, 4), (41, 4), (47, 6)]);
        head.check_patterns().unwrap();
        let set = head.patterns().unwrap().unwrap();
        assert_eq!(set.name, "mine14");
        let told: Vec<_> = set
            .sets
            .iter()
            .map(|set| (set.periods, set.steps))
            .collect();
        assert_eq!(told, [(37.0, 4), (41.0, 4), (47.0, 6)]);
        assert_eq!(set.frames_per_exposure(), 14);
    }

    #[test]
    fn what_is_wrong_with_it_is_named() {
        let good: &[(u32, u32)] = &[(37, 4), (41, 4)];
        for (name, fringes, key) in [
            (None, good, "pattern_set"),
            (Some("high12"), good, "pattern_set"),
            (Some("../mine"), good, "pattern_set"),
            (Some(""), good, "pattern_set"),
            (Some("mine"), &[][..], "pattern_set"),
            (Some("mine"), &[(37, 2)], "fringes[0].steps"),
            (Some("mine"), &[(37, 65)], "fringes[0].steps"),
            (Some("mine"), &[(0, 4)], "fringes[0].periods"),
            (Some("mine"), &[(37, 4), (4097, 4)], "fringes[1].periods"),
            (Some("mine"), &[(41, 4), (37, 4)], "fringes[1].periods"),
            (Some("mine"), &[(41, 4), (41, 4)], "fringes[1].periods"),
        ] {
            let bad = head(name, fringes).check_patterns().unwrap_err();
            assert_eq!(bad.key, key, "{name:?} {fringes:?}");
        }
        let many: Vec<_> = (0..13).map(|n| (30 + n, 4)).collect();
        let bad = head(Some("mine"), &many).check_patterns().unwrap_err();
        assert_eq!(bad.key, "fringes");
    }
}
