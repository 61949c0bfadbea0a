//! Reasons for the verdict indeterminate, each with its figures, and the closed list of their codes.

use std::fmt;
use std::str::FromStr;

use flankscope_foundation::display::Number;
use serde::{Deserialize, Serialize};

use crate::registration;

/// One row per word: what it stands for, its name here, the word in files, and what to do about it.
macro_rules! codes {
    ($($(#[$about:meta])* $name:ident = $word:literal, $remedy:literal;)*) => {
        /// Code of a reason: a closed list, so that reasons can be counted. A word in a file keeps its meaning for good;
        /// new ones are added.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub enum Code {
            $($(#[$about])* $name,)*
        }

        impl Code {
            /// All of them.
            pub const ALL: &'static [Self] = &[$(Self::$name),*];

            /// The word for files, always the same for the same kind of reason.
            pub const fn word(self) -> &'static str {
                match self {
                    $(Self::$name => $word,)*
                }
            }

            /// Remedy, in the imperative.
            pub const fn remedy(self) -> &'static str {
                match self {
                    $(Self::$name => $remedy,)*
                }
            }
        }
    };
}

codes! {
    /// No feature was evaluated.
    NoFeatures = "no_features", "name the teeth to inspect, in the tool file (inspect.teeth) or with --teeth";
    /// A figure, a coordinate or a probability that is no usable number.
    NotFinite = "not_finite", "look for values that are no numbers in the tool file, the head file and the cloud";
    /// Limits that contradict each other.
    Limits = "limits", "put the limits of the tool file in order: 0 < warn <= stop";
    /// A figure too near to a limit for its uncertainty.
    Undecidable = "undecidable", "measure again (inspect.remeasure), or look at the flank";
    /// Too little of the zone was measured.
    Coverage = "coverage", "clean flank and head; spray polished steel, or light it in passes (--adaptive); or look from another height";
    /// No disc fits into what was measured of the zone.
    NoDisc = "no_disc", "judge a larger zone, or smaller discs (inspect.wear_area_mm2)";
    /// Wear hidden in unmeasured areas may exceed a limit.
    Hidden = "hidden", "clean the flank, look from another height, or look at it by eye";
    /// Damage at the warning limit would not be seen.
    Detection = "detection_limit", "lower the largest part of the uncertainty, which the reason names";
    /// The estimate is not what was read.
    Disagreement = "disagreement", "measure again; if it stays so, look at the flank";
    /// The tip edge was not seen whole.
    TipUnseen = "tip_unseen", "clean the tip, or look from another height";
    /// The pose hides too much of the wear.
    Leakage = "leakage", "fit the pose to other surfaces (inspect.datum), or bring in a better stage";
    /// The tool's temperature is needed and not known.
    TemperatureMissing = "temperature_missing", "give --tool-temperature";
    /// The tool is too warm or too cold.
    TemperatureRange = "temperature_range", "let the tool come to a temperature within its range";
    /// Too few points to lay on the CAD.
    TooFewPoints = "too_few_points", "clean the head, and check the exposures";
    /// Not one uncertainty per point.
    SigmaCount = "sigma_count", "give one standard uncertainty per point, or none";
    /// The cloud begins too far from the CAD.
    Disjoint = "disjoint", "check unit and pose of the cloud; give a start pose";
    /// Too few of the points lie on the CAD.
    TooFewInliers = "too_few_inliers", "check that the die is the CAD's and the head file the head's";
    /// The pose did not settle.
    NotConverged = "not_converged", "give a nearer start pose, or look at a part with more shape";
    /// The surface leaves the pose open.
    Unconstrained = "unconstrained", "look at a part with more shape, or say what the stages know of the pose";
    /// A tooth further, the cloud would fit as well.
    AmbiguousTooth = "ambiguous_tooth", "check how the die was put down, and the hand-eye of the head";
    /// The pose is not where the stages say.
    PriorViolated = "prior_violated", "reference the stages; check how die and head are mounted";
    /// The prior's covariance is not positive definite.
    BadPrior = "bad_prior", "check the standard uncertainties of the stages";
    /// Frames are missing, or not one per trigger.
    FramesMissing = "frames_missing", "check the link to the camera, and the load of this host";
    /// A frame of the wrong size, order or brightness.
    FrameContent = "frame_content", "check LED, pattern projector and the exposures of the head file";
    /// A frame without a trigger, or of another session.
    FrameForeign = "frame_foreign", "see that one camera process alone sends frames here";
    /// A frame could not be read from the shared memory.
    FrameUnreadable = "frame_unreadable", "start the camera process anew; its release must be this one";
    /// A frame does not show what its trigger asked for.
    TriggerMismatch = "trigger_mismatch", "check the trigger line, and the camera's exposure mode";
    /// Something stood still between trigger, exposure and frame.
    Stalled = "stalled", "see what stopped controller, camera process or host; see that the host is not overloaded";
    /// Somebody interrupted the check.
    Interrupted = "interrupted", "check again";
    /// The view was not captured.
    NotCaptured = "not_captured", "see why the capture ended early";
    /// The controller stopped.
    ControllerFault = "controller_fault", "clear the cause, and acknowledge the fault (flankscope doctor --acknowledge-fault)";
    /// Events of the controller are missing.
    EventsLost = "events_lost", "check the link to the controller";
    /// The link to the controller broke.
    LinkLost = "link_lost", "check cable, port and power of the controller";
    /// The check did not fit into the time for which the press may be held.
    HoldTime = "hold_time", "inspect fewer teeth, or allow more time (press.hold_limit_s)";
    /// The camera is not there, does not say that it is armed, or is another one than the head's; nothing moved.
    CameraUnusable = "camera_unusable", "start flankscope-camera, and see that it has the head's camera (flankscope doctor)";
    /// A thread of the capture did not answer.
    CaptureStalled = "capture_stalled", "start the instrument anew";
    /// The head's calibration does not count today.
    HeadUnfit = "head_unfit", "run flankscope calibrate, or its self-test with --check";
    /// The sums of a view cannot be decoded.
    Decoding = "decoding", "check that head file and pattern set are those of the head";
    /// The frames of too many points do not follow one fringe.
    Inconsistent = "inconsistent", "keep press and head still while it looks; check the light";
    /// The exposures of too many points do not show one scene.
    ExposuresDisagree = "exposures_disagree", "keep press and head still while it looks; see that all frames are of one capture";
    /// The baseline does not know the flank.
    BaselineLacks = "baseline_lacks", "record the baseline again with this tooth";
    /// The baseline was measured on another grid.
    BaselineMismatch = "baseline_mismatch", "record the baseline again with these files";
    /// The result could not be stored.
    NotStored = "not_stored", "make room on the disk, or name another history";
    /// A view does not fit the CAD.
    OffCad = "off_cad", "check that the die is the CAD's and the head file the head's";
    /// Too few views of a scan could be laid on the CAD.
    FewViews = "few_views", "see why the first of them was lost";
    /// The views of a scan still moved against each other.
    Unsettled = "unsettled", "scan again; see that the die stands firmly";
    /// Less was seen of the die than was asked for.
    Unseen = "unseen", "clean the flanks that are named, and scan into the same session";
    /// It is not the CAD's die.
    OtherDie = "other_die", "check tool file and head file";
    /// Tooth numbers cannot be determined, or differ from those of the earlier scan.
    TurnedDie = "turned_die", "put the die down as it was";
    /// The method, or a cloud, claims no uncertainty.
    NoUncertainty = "no_uncertainty", "stitch by --method surface; state the uncertainty of clouds";
    /// The points come without their frames.
    NoFrames = "no_frames", "scan with --save-frames, and scan those; or look at the flank";
    /// There are no limits to judge by.
    NoLimits = "no_limits", "give the tool file an [inspect] section";
    /// The uncertainty is too large for the class that is asked for.
    NotCapable = "not_capable", "measure with less uncertainty, or ask for a wider class";
    /// A figure of the gear could not be told.
    NotTold = "not_told", "see its next step in the table";
}

/// Not the word of a reason.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "{got:?} is no word for a reason that this release knows; a later release may have written it"
)]
pub struct UnknownCode {
    got: String,
}

impl FromStr for Code {
    type Err = UnknownCode;

    fn from_str(text: &str) -> Result<Self, UnknownCode> {
        let known = Self::ALL.iter().find(|code| code.word() == text);
        known
            .copied()
            .ok_or_else(|| UnknownCode { got: text.into() })
    }
}

impl fmt::Display for Code {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.word())
    }
}

impl Serialize for Code {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.word())
    }
}

impl<'de> Deserialize<'de> for Code {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let word = String::deserialize(deserializer)?;
        word.parse().map_err(serde::de::Error::custom)
    }
}

/// Reason for the verdict indeterminate.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Reason {
    /// No feature was evaluated.
    #[error("no feature was evaluated")]
    NoFeatures,
    /// A figure that is no number.
    #[error("the {what} is no number that can be judged")]
    NotFinite {
        /// Name of the figure.
        what: &'static str,
    },
    /// Limits that contradict each other.
    #[error(
        "the limits are out of order: warn {warn_um} um, stop {limit_um} um; right would be 0 < warn <= stop", warn_um = Number(*warn_um), limit_um = Number(*limit_um))]
    Limits {
        /// Warning limit.
        warn_um: f64,
        /// Stop limit.
        limit_um: f64,
    },
    /// The figure is too near to the limit for its uncertainty.
    #[error(
        "{what} {value_um:.1} um is too near to the stop limit of {limit_um} um to decide: the guard band is {guard_um:.1} um to either side", value_um = Number(*value_um), limit_um = Number(*limit_um), guard_um = Number(*guard_um))]
    Undecidable {
        /// Name of the figure.
        what: &'static str,
        /// Its value.
        value_um: f64,
        /// Guard band: least distance of the figure from a limit, same unit.
        guard_um: f64,
        /// Stop limit.
        limit_um: f64,
    },
    /// Too little of the zone was measured.
    #[error("only {:.0} % of the zone was measured, at least {:.0} % are needed", Number(100.0 * coverage), Number(100.0 * least))]
    Coverage {
        /// Measured share of the zone.
        coverage: f64,
        /// Least share.
        least: f64,
    },
    /// Nothing fits the zone over which the largest mean loss could be sought, or nothing was measured.
    #[error(
        "no disc of {area_mm2} mm2 could be measured in the zone; a larger zone or a smaller inspect.wear_area_mm2 is needed", area_mm2 = Number(*area_mm2))]
    NoDisc {
        /// Area of the disc.
        area_mm2: f64,
    },
    /// Wear hidden in unmeasured areas may exceed the limit: unmeasured patches, floors behind steep walls, grooves too narrow to
    /// look into.
    #[error(
        "what was not seen of the flank (holes, shadows of steep walls, narrow grooves, fine texture) may hide up to {hidden_um:.1} um of mean loss if up to {supposed_um:.0} um are lost there, {limit_um} um are the limit; clean the flank, look from another height, or look at it by eye", hidden_um = Number(*hidden_um), supposed_um = Number(*supposed_um), limit_um = Number(*limit_um))]
    Hidden {
        /// The largest mean loss that a disc may have.
        hidden_um: f64,
        /// Loss that is assumed wherever nothing was measured, µm.
        supposed_um: f64,
        /// The limit that it may exceed.
        limit_um: f64,
    },
    /// Damage at the warning limit would not be seen.
    #[error(
        "the least wear that can be distinguished from none is {detects_um:.1} um, not below the warning limit of {warn_um} um; largest part of the uncertainty: {largest}", detects_um = Number(*detects_um), warn_um = Number(*warn_um))]
    Detection {
        /// Detection limit of wear, µm.
        detects_um: f64,
        /// Warning limit.
        warn_um: f64,
        /// Largest term of the uncertainty budget.
        largest: &'static str,
    },
    /// The estimate is not what was read.
    #[error(
        "the estimate of {wear_um:.1} um differs from the largest mean loss as read, {raw_um:.1} um, by more than its uncertainty allows ({guard_um:.1} um)", wear_um = Number(*wear_um), raw_um = Number(*raw_um), guard_um = Number(*guard_um))]
    Disagreement {
        /// Estimate.
        wear_um: f64,
        /// As read.
        raw_um: f64,
        /// Allowed difference.
        guard_um: f64,
    },
    /// The tip edge was not seen.
    #[error("the tip edge was not seen whole, so that its rounding cannot be told")]
    TipUnseen,
    /// The pose hides too much of the wear.
    #[error(
        "the pose hides {} of the flank's wear, at most {:.0} % may be; fit to other surfaces (inspect.datum) or bring in a better stage",
        share(*leakage), Number(100.0 * limit)
    )]
    Leakage {
        /// Worst leakage of the flank; not finite where it cannot be told.
        leakage: f64,
        /// Largest that leaves enough to see.
        limit: f64,
    },
    /// Local wear and what the pose may hide by equal and opposite changes of both sides exceed the limit together.
    #[error(
        "local wear and equal and opposite changes of both sides of all teeth, as far as the stages allow them, may together be {together_um:.1} um, {limit_um} um are the limit; name a datum (inspect.datum_height_mm) or bring in a better stage", together_um = Number(*together_um), limit_um = Number(*limit_um))]
    Opposite {
        /// The largest loss, guard band included, µm.
        together_um: f64,
        /// The stop limit, µm.
        limit_um: f64,
    },
    /// The tool's temperature is needed and not known.
    #[error(
        "the tool's temperature is not known, but its file asks for it; give --tool-temperature"
    )]
    TemperatureMissing,
    /// The tool's temperature is outside its range.
    #[error("the tool has {degc} degrees C, outside its range of {low} to {high}", degc = Number(*degc), low = Number(*low), high = Number(*high))]
    TemperatureRange {
        /// Temperature.
        degc: f64,
        /// Lowest.
        low: f64,
        /// Highest.
        high: f64,
    },
    /// The cloud could not be laid on CAD.
    #[error("registration: {0}")]
    Registration(crate::registration::RegistrationFailure),
    /// A failure of another part of the instrument: frames, controller, head, baseline, history.
    #[error("{sentence}")]
    Instrument {
        /// Code of the failure.
        code: Code,
        /// Message of the part that failed.
        sentence: String,
    },
}

/// A share in words, in per cent where it is known.
fn share(ratio: f64) -> String {
    if ratio.is_finite() {
        format!("{:.0} %", 100.0 * ratio)
    } else {
        "an unknown part (too few points were seen)".into()
    }
}

impl Reason {
    /// Reason of a failure in another part of the instrument, with that part's message.
    pub fn instrument(code: Code, sentence: impl fmt::Display) -> Self {
        Self::Instrument {
            code,
            sentence: sentence.to_string(),
        }
    }

    /// Code of the reason.
    pub fn code(&self) -> Code {
        match self {
            Self::NoFeatures => Code::NoFeatures,
            Self::NotFinite { .. } => Code::NotFinite,
            Self::Limits { .. } => Code::Limits,
            Self::Undecidable { .. } => Code::Undecidable,
            Self::Coverage { .. } => Code::Coverage,
            Self::NoDisc { .. } => Code::NoDisc,
            Self::Hidden { .. } => Code::Hidden,
            Self::Detection { .. } => Code::Detection,
            Self::Disagreement { .. } => Code::Disagreement,
            Self::TipUnseen => Code::TipUnseen,
            Self::Leakage { .. } | Self::Opposite { .. } => Code::Leakage,
            Self::TemperatureMissing => Code::TemperatureMissing,
            Self::TemperatureRange { .. } => Code::TemperatureRange,
            Self::Registration(reason) => reason.into(),
            Self::Instrument { code, .. } => *code,
        }
    }
}

impl From<&registration::RegistrationFailure> for Code {
    fn from(reason: &registration::RegistrationFailure) -> Self {
        use registration::RegistrationFailure;
        match reason {
            RegistrationFailure::TooFewPoints { .. } => Self::TooFewPoints,
            RegistrationFailure::NotFinite { .. } => Self::NotFinite,
            RegistrationFailure::SigmaCount { .. } => Self::SigmaCount,
            RegistrationFailure::Disjoint { .. } => Self::Disjoint,
            RegistrationFailure::TooFewInliers { .. } => Self::TooFewInliers,
            RegistrationFailure::NotConverged { .. } => Self::NotConverged,
            RegistrationFailure::Unconstrained { .. } | RegistrationFailure::AllWeak { .. } => {
                Self::Unconstrained
            }
            RegistrationFailure::AmbiguousTooth { .. } => Self::AmbiguousTooth,
            RegistrationFailure::PriorViolated { .. } => Self::PriorViolated,
            RegistrationFailure::BadPrior => Self::BadPrior,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn every_reason_has_a_word_of_its_own_and_says_what_to_do() {
        let words: BTreeSet<&str> = Code::ALL.iter().map(|code| code.word()).collect();
        assert_eq!(words.len(), Code::ALL.len());
        for &code in Code::ALL {
            let word = code.word();
            let plain = word.chars().all(|c| c.is_ascii_lowercase() || c == '_');
            assert!(plain && !word.is_empty(), "{word}");
            assert!(code.remedy().len() > 10, "{word}");
            assert_eq!(word.parse(), Ok(code));
            let json = serde_json::to_string(&code).unwrap();
            assert_eq!(json, format!("\"{word}\""));
            assert_eq!(serde_json::from_str::<Code>(&json).unwrap(), code);
        }
    }

    #[test]
    fn no_sentence_prints_what_is_no_number() {
        let nan = f64::NAN;
        let mut sentences: Vec<String> = [nan, f64::INFINITY]
            .into_iter()
            .flat_map(|x| {
                [
                    Reason::NotFinite { what: "wear" },
                    Reason::Limits {
                        warn_um: x,
                        limit_um: x,
                    },
                    Reason::Undecidable {
                        what: "wear",
                        value_um: x,
                        guard_um: x,
                        limit_um: x,
                    },
                    Reason::Coverage {
                        coverage: x,
                        least: x,
                    },
                    Reason::NoDisc { area_mm2: x },
                    Reason::Hidden {
                        hidden_um: x,
                        supposed_um: x,
                        limit_um: x,
                    },
                    Reason::Detection {
                        detects_um: x,
                        warn_um: x,
                        largest: "noise",
                    },
                    Reason::Disagreement {
                        wear_um: x,
                        raw_um: x,
                        guard_um: x,
                    },
                    Reason::Leakage {
                        leakage: x,
                        limit: x,
                    },
                    Reason::Opposite {
                        together_um: x,
                        limit_um: x,
                    },
                    Reason::TemperatureRange {
                        degc: x,
                        low: x,
                        high: x,
                    },
                ]
                .map(|reason| reason.to_string())
            })
            .collect();
        use registration::RegistrationFailure as Lost;
        for lost in [
            Lost::Disjoint {
                ratio: nan,
                least_ratio: nan,
                capture_mm: nan,
            },
            Lost::TooFewInliers {
                inliers: 0,
                points: 0,
                reach_mm: nan,
                least_ratio: nan,
            },
            Lost::NotConverged {
                iterations: 1,
                step_mm: nan,
                limit_mm: nan,
            },
            Lost::Unconstrained {
                unobserved: 3,
                limit_mm: nan,
            },
            Lost::AmbiguousTooth {
                moved_rad: nan,
                rival_rad: nan,
                limit_ratio: nan,
            },
            Lost::PriorViolated {
                distance: nan,
                limit: nan,
            },
        ] {
            sentences.push(Reason::Registration(lost).to_string());
        }
        for sentence in sentences {
            assert!(
                !sentence.contains("NaN") && !sentence.contains("inf "),
                "{sentence}"
            );
        }
    }

    #[test]
    fn an_unknown_word_is_refused_by_name() {
        for text in ["", "go", "Undecidable", "undecidable "] {
            let error = text.parse::<Code>().unwrap_err().to_string();
            assert!(
                error.starts_with(&format!("{text:?} is no word")),
                "{error}"
            );
        }
    }
}
