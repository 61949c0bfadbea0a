//! Sets of projected fringes: frequencies, low to high, with their phase steps.

use std::f64::consts::TAU;

use flankscope_foundation::textfile::BadValue;
use serde::{Deserialize, Serialize};

use crate::gray::{GrayCode, MAX_BITS};

/// One frequency: `steps` frames of the same sinusoid, shifted by `TAU / steps` from frame to frame.
///
/// `phase = TAU periods (column - phase_origin_px) / width`, columns counted at pixel centres. With fringes along rows,
/// columns and width are the projector's rows and height.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FringeSet {
    /// Periods over the projector's full width.
    pub periods: f64,
    /// Phase steps, at least 3.
    pub steps: u32,
    /// The column where the phase is zero: -0.5, the outer edge of the first column, for the instrument's own patterns; 0
    /// where phase is counted from the centre of the first column.
    pub phase_origin_px: f64,
}

impl FringeSet {
    /// A frequency in the instrument's own convention.
    pub fn new(periods: f64, steps: u32) -> Self {
        Self {
            periods,
            steps,
            phase_origin_px: OWN_PHASE_ORIGIN_PX,
        }
    }

    /// The unwrapped phase at `column`.
    pub fn phase_rad(&self, column: f64, width_px: f64) -> f64 {
        TAU * self.periods * (column - self.phase_origin_px) / width_px
    }

    /// The inverse of [`FringeSet::phase_rad`].
    pub fn column_px(&self, phase_rad: f64, width_px: f64) -> f64 {
        phase_rad * width_px / (TAU * self.periods) + self.phase_origin_px
    }
}

/// Projector coordinate that the fringes encode.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Axis {
    /// The projector's columns: stripes stand upright.
    #[default]
    Columns,
    /// The projector's rows: stripes lie.
    Rows,
}

impl Axis {
    /// 0 along the projector's x, 1 along its y.
    pub fn index(self) -> usize {
        match self {
            Self::Columns => 0,
            Self::Rows => 1,
        }
    }
}

/// Direction in which the fringes move from step to step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum StepSign {
    /// Step n shows `cos(phase + TAU n / N)`: the instrument's own patterns.
    #[default]
    Plus,
    /// Step n shows `cos(phase - TAU n / N)`.
    Minus,
}

impl StepSign {
    /// +1 or -1.
    pub fn factor(self) -> f64 {
        match self {
            Self::Plus => 1.0,
            Self::Minus => -1.0,
        }
    }
}

/// The frequencies of one capture, low to high, in any ratio ([`crate::unwrap`] says what they tell apart).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PatternSet {
    /// `insitu12`, the plan file's name, ...
    pub name: String,
    /// 1 to 12 frequencies, ascending.
    pub sets: Vec<FringeSet>,
    /// Direction in which the fringes move from step to step.
    pub step_sign: StepSign,
    /// Projector coordinate that the fringes encode.
    pub axis: Axis,
    /// A code that tells the stripe, shown after the fringes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub code: Option<GrayCode>,
}

/// One picture of a set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shown {
    /// A phase step.
    Fringe {
        /// Index of the frequency, low to high.
        set: usize,
        /// Index of the phase step.
        step: u32,
    },
    /// A bit of the code.
    Code {
        /// Index of the bit, 0 the most significant.
        bit: u32,
        /// Whether dark and bright are exchanged (complement of the bit).
        complement: bool,
    },
}

/// Why a pattern set is refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PatternError {
    /// Not one of the built-in names.
    #[error("pattern set \"{name}\" is unknown: {KNOWN_SETS}; any other goes into a plan file")]
    UnknownName {
        /// Value asked for.
        name: String,
    },
    /// None, or more than twelve.
    #[error("{got} frequencies: 1 to {MAX_FREQUENCIES} are possible")]
    FrequencyCount {
        /// Frequencies given.
        got: usize,
    },
    /// A sinusoid has three unknowns.
    #[error(
        "{got} phase steps in frequency {set}: 3 to {MAX_STEPS} are possible (offset, amplitude and phase are three unknowns)"
    )]
    Steps {
        /// Index of the frequency.
        set: usize,
        /// Its number of steps.
        got: u32,
    },
    /// Zero, negative or not finite.
    #[error("{got} periods in frequency {set}: must be above 0 and at most {MAX_PERIODS}")]
    Periods {
        /// Index of the frequency.
        set: usize,
        /// Its periods.
        got: f64,
    },
    /// Unwrapping goes from low to high.
    #[error("frequency {set} has {got} periods after {previous}: frequencies must ascend")]
    Order {
        /// Index of the frequency.
        set: usize,
        /// Its periods.
        got: f64,
        /// The periods before it.
        previous: f64,
    },
    /// The phase origin is not a column near the projector.
    #[error(
        "phase origin of frequency {set} at column {got}: must be within a projector's width of column 0"
    )]
    Origin {
        /// Index of the frequency.
        set: usize,
        /// Value given.
        got: f64,
    },
    /// No bit, or more stripes than any projector has columns.
    #[error("a Gray code of {got} bits: 1 to {MAX_BITS} are possible")]
    CodeBits {
        /// Number given.
        got: u32,
    },
    /// Zero, negative or not finite.
    #[error("a Gray code of {got} stripes: must be above 0 and at most {MAX_PERIODS}")]
    CodeStripes {
        /// Its stripes.
        got: f64,
    },
    /// The first stripe begins nowhere near the projector.
    #[error(
        "the first stripe of the Gray code begins at column {got}: must be within a projector's width of column 0"
    )]
    CodeOrigin {
        /// Value given.
        got: f64,
    },
}

impl PatternError {
    /// The value of a file that is wrong; `key` says what a frequency's own are called there.
    #[rustfmt::skip]
    pub(crate) fn bad_value(&self, key: impl Fn(usize, &str) -> String) -> BadValue {
        let near = "must be within a projector's width of column 0";
        match *self {
            Self::Steps { set, got } => BadValue::new(key(set, "steps"), got, "must be 3 to 64 (offset, amplitude and phase are three unknowns)"),
            Self::Periods { set, got } => BadValue::new(key(set, "periods"), got, "must be above 0 and at most 4096"),
            Self::Order { set, got, .. } => BadValue::new(key(set, "periods"), got, "must be more than those before"),
            Self::FrequencyCount { got } => BadValue::new("fringes", got, "must be 1 to 12 frequencies"),
            Self::Origin { set, got } => BadValue::new(key(set, "phase_origin_px"), got, near),
            Self::CodeBits { got } => BadValue::new("gray_code.bits", got, "must be 1 to 16"),
            Self::CodeStripes { got } => BadValue::new("gray_code.stripes", got, "must be above 0 and at most 4096"),
            Self::CodeOrigin { got } => BadValue::new("gray_code.phase_origin_px", got, near),
            Self::UnknownName { ref name } => BadValue::new("pattern_set", name, KNOWN_SETS),
        }
    }
}

/// The instrument's patterns have phase zero at the outer edge of the projector's first column.
pub const OWN_PHASE_ORIGIN_PX: f64 = -0.5;
/// The instrument's own pattern sets: name, and periods x steps of each frequency.
///
/// Eight steps on the finest frequency cancel the harmonics of a non-linear response up to the sixth; the lowest is
/// not a unit frequency because the measuring volume already fixes its fringe order. The sets without a low frequency are for
/// surfaces that light each other (bare steel): `docs/formats/plan.md` has their order margins.
pub const NAMED: [(&str, &[(f64, u32)]); 5] = [
    ("article8", &[(4.0, 4), (48.0, 4)]),
    ("insitu12", &[(4.0, 4), (48.0, 8)]),
    ("scan16", &[(4.0, 4), (13.0, 4), (48.0, 8)]),
    ("high12", &[(36.0, 4), (39.0, 4), (48.0, 4)]),
    ("high16", &[(41.0, 4), (45.0, 4), (48.0, 8)]),
];
/// Values allowed for `pattern_set`.
pub(crate) const KNOWN_SETS: &str = "must be article8, insitu12, scan16, high12 or high16";
/// More than micro phase shifting needs.
pub const MAX_FREQUENCIES: usize = 12;
/// More steps than any pattern memory holds.
pub const MAX_STEPS: u32 = 64;
/// Finer than two columns per period on any projector.
pub const MAX_PERIODS: f64 = 4096.0;
/// Farther than any projector is wide.
const MAX_ORIGIN_PX: f64 = 16384.0;

impl PatternSet {
    /// A set in the instrument's own convention (`StepSign::Plus`, along the columns).
    ///
    /// # Errors
    /// [`PatternError`]: see its variants for the limits.
    pub fn new(name: impl Into<String>, sets: Vec<FringeSet>) -> Result<Self, PatternError> {
        Self::with_convention(name, sets, StepSign::Plus, Axis::Columns)
    }

    /// A set of patterns that are not the instrument's own.
    ///
    /// # Errors
    /// [`PatternError`]: see its variants for the limits.
    pub fn with_convention(
        name: impl Into<String>,
        sets: Vec<FringeSet>,
        step_sign: StepSign,
        axis: Axis,
    ) -> Result<Self, PatternError> {
        if sets.is_empty() || sets.len() > MAX_FREQUENCIES {
            return Err(PatternError::FrequencyCount { got: sets.len() });
        }
        for (set, fringes) in sets.iter().enumerate() {
            if !(3..=MAX_STEPS).contains(&fringes.steps) {
                return Err(PatternError::Steps {
                    set,
                    got: fringes.steps,
                });
            }
            // Written so that NaN fails.
            if !(fringes.phase_origin_px.abs() <= MAX_ORIGIN_PX) {
                return Err(PatternError::Origin {
                    set,
                    got: fringes.phase_origin_px,
                });
            }
            if !(fringes.periods > 0.0 && fringes.periods <= MAX_PERIODS) {
                return Err(PatternError::Periods {
                    set,
                    got: fringes.periods,
                });
            }
            if set > 0 && fringes.periods <= sets[set - 1].periods {
                return Err(PatternError::Order {
                    set,
                    got: fringes.periods,
                    previous: sets[set - 1].periods,
                });
            }
        }
        Ok(Self {
            name: name.into(),
            sets,
            step_sign,
            axis,
            code: None,
        })
    }

    /// The same fringes, followed by a code.
    ///
    /// # Errors
    /// [`PatternError`]: see its variants for the limits.
    pub fn with_code(self, code: Option<GrayCode>) -> Result<Self, PatternError> {
        if let Some(code) = code {
            if !(1..=MAX_BITS).contains(&code.bits) {
                return Err(PatternError::CodeBits { got: code.bits });
            }
            // Written so that NaN fails.
            if !(code.stripes > 0.0 && code.stripes <= MAX_PERIODS) {
                return Err(PatternError::CodeStripes { got: code.stripes });
            }
            if !(code.origin_px.abs() <= MAX_ORIGIN_PX) {
                return Err(PatternError::CodeOrigin {
                    got: code.origin_px,
                });
            }
        }
        Ok(Self { code, ..self })
    }

    /// The same set, if it is within the limits: one that was read from a file is not known to be.
    ///
    /// # Errors
    /// [`PatternError`]: see its variants for the limits.
    pub fn checked(self) -> Result<Self, PatternError> {
        Self::with_convention(self.name, self.sets, self.step_sign, self.axis)?.with_code(self.code)
    }

    /// One of the instrument's own sets, [`NAMED`].
    ///
    /// # Errors
    /// [`PatternError::UnknownName`].
    pub fn named(name: &str) -> Result<Self, PatternError> {
        let (name, sets) = NAMED
            .iter()
            .find(|(known, _)| *known == name)
            .ok_or_else(|| PatternError::UnknownName {
                name: name.to_owned(),
            })?;
        Self::new(
            *name,
            sets.iter()
                .map(|&(periods, steps)| FringeSet::new(periods, steps))
                .collect(),
        )
    }

    /// The finest frequency.
    pub fn finest(&self) -> FringeSet {
        self.sets[self.sets.len() - 1]
    }

    /// Frames of one exposure.
    pub fn frames_per_exposure(&self) -> usize {
        self.pictures().count()
    }

    /// The pictures of one exposure, in the order in which they are shown: frequencies low to high step by step, then the code from
    /// its most significant bit on, each followed by its complement if there is one.
    pub fn pictures(&self) -> impl Iterator<Item = Shown> + '_ {
        let fringes = self.sets.iter().enumerate().flat_map(|(set, fringes)| {
            (0..fringes.steps).map(move |step| Shown::Fringe { set, step })
        });
        let bits = self.code.iter().flat_map(|code| {
            let last = code.complement;
            (0..code.bits).flat_map(move |bit| {
                (0..=u8::from(last)).map(move |complement| Shown::Code {
                    bit,
                    complement: complement == 1,
                })
            })
        });
        fringes.chain(bits)
    }

    /// Brightness of the projector in column `column` (pixel centres at integers), 0 dark to 1 bright.
    pub fn intensity(&self, picture: Shown, column: f64, width_px: f64) -> f64 {
        let (set, step) = match picture {
            Shown::Fringe { set, step } => (set, step),
            Shown::Code { bit, complement } => {
                let lit = |code: GrayCode| code.is_lit(bit, column, width_px) != complement;
                return f64::from(u8::from(self.code.is_some_and(lit)));
            }
        };
        let fringes = self.sets[set];
        let phase_rad = fringes.phase_rad(column, width_px);
        let shift_rad = self.step_sign.factor() * TAU * f64::from(step) / f64::from(fringes.steps);
        0.5 + 0.5 * (phase_rad + shift_rad).cos()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn named_sets_have_as_many_frames_as_their_names_say() {
        for (name, _) in NAMED {
            let frames = PatternSet::named(name).unwrap().frames_per_exposure();
            let digits = name.trim_start_matches(char::is_alphabetic);
            assert_eq!(digits.parse(), Ok(frames));
            assert!(KNOWN_SETS.contains(name), "{name}");
        }
        assert!(matches!(
            PatternSet::named("insitu"),
            Err(PatternError::UnknownName { .. })
        ));
    }

    #[test]
    fn limits_are_named() {
        let set = FringeSet::new;
        assert_eq!(
            PatternSet::new("", vec![]),
            Err(PatternError::FrequencyCount { got: 0 })
        );
        assert_eq!(
            PatternSet::new("", vec![set(1.0, 2)]),
            Err(PatternError::Steps { set: 0, got: 2 })
        );
        assert!(matches!(
            PatternSet::new("", vec![set(f64::NAN, 3)]),
            Err(PatternError::Periods { .. })
        ));
        assert_eq!(
            PatternSet::new("", vec![set(4.0, 3), set(4.0, 3)]),
            Err(PatternError::Order {
                set: 1,
                got: 4.0,
                previous: 4.0
            })
        );
    }

    #[test]
    fn column_and_phase_are_inverse() {
        let set = FringeSet {
            periods: 7.0,
            steps: 3,
            phase_origin_px: 0.3,
        };
        for column in [-0.5, 0.0, 17.25, 1023.0] {
            let phase_rad = set.phase_rad(column, 1024.0);
            assert!((set.column_px(phase_rad, 1024.0) - column).abs() < 1e-10);
        }
        // Half a column left of the first centre lies the edge.
        assert_eq!(FringeSet::new(7.0, 3).phase_rad(-0.5, 1024.0), 0.0);
    }
}
