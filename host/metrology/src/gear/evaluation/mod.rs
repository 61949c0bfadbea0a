//! Gear evaluation in the sense of ISO 1328-1: profile, helix, pitch and runout of every tooth from a cloud of points.
//!
//! | file | holds |
//! |---|---|
//! | `axis` | the axis that deviations are stated about |
//! | `limits` | between which radii and heights figures are read, and which points are flank |
//! | `gather` | points by flank, cloud after cloud |
//! | `trace` | smoothing along profile and helix, and what is read from it |
//! | `across` | what deviations do across a trace, taken away from it |
//! | `areal` | the whole flank as a few terms |
//! | `tolerance` | classes |
//! | `not_told` | why a figure is missing, and what would bring it |
//!
//! Deviations are along the normal of the involute, positive where material stands proud, and exact in closed form
//! ([`GearData::involute_deviation_mm`]). The standard is for external and internal gears; for a die it is used by analogy.
//!
//! Slopes follow the edition of 2013: the mean line is fitted over the evaluated part, 95 % of the roll length from the
//! profile control radius to the tip form radius, and its rise is stated from the control radius to the tip radius, positive
//! where there is more material towards the tip; a helix slope over the whole face width. [`EvaluationRange`] names the radii, and
//! [`TraceFigures::slope_usable_um`] gives the rise between the ends of the usable flank beside it.

mod across;
mod areal;
mod axis;
mod flank;
mod gather;
mod limits;
mod not_told;
mod tolerance;
mod trace;

pub use areal::ArealTerms;
pub use axis::AxisFit;
pub use gather::Gathering;
pub use limits::EvaluationRange;
pub use not_told::NotTold;
pub use tolerance::{CLASSES, Quantity};
pub use trace::TraceFigures;

use serde::Serialize;

use crate::gear::{Flank, GearData};
use flankscope_foundation::normal::guard_factor;
use flankscope_foundation::order::range_of;
use limits::standard_of_u95;
use not_told::{joined, split};

/// Settings of a gear evaluation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EvaluationSettings {
    /// Ends of the usable flank: radii between which it is an involute, mm, in any order. That at the root end is the profile
    /// control radius (beyond any fillet), that at the tip end the tip form radius (before any edge break).
    pub usable_mm: [f64; 2],
    /// Radii between which the profile slope is stated, mm, in any order; none for the standard's, control and tip radius.
    pub slope_mm: Option<[f64; 2]>,
    /// Points farther than this from the involute belong to something else, mm.
    pub capture_mm: f64,
    /// A profile trace takes points up to this far from mid face, a helix trace up to half of it (as roll length) from the
    /// measuring circle, mm.
    pub band_mm: f64,
    /// State deviations about the axis that fits best instead of the tool's own.
    pub best_fit_axis: bool,
    /// Expanded uncertainty of a deviation (95 %), um.
    pub u95_um: f64,
    /// That of a cumulative pitch and of the runout, um, where the pose of each part of the cloud was found from its own teeth
    /// and so took up some of both; none for the same.
    pub cumulative_u95_um: Option<f64>,
}

/// Distance of the usable flank from the base circle, in modules, where the active flank begins within it.
const LEAST_ABOVE_BASE: f64 = 0.05;

impl EvaluationSettings {
    /// The active flank outside the base circle, a band of 1 mm, an uncertainty of 5 um.
    pub fn for_gear(gear: &GearData) -> Self {
        // The involute of a gear of few teeth begins above three quarters of a module within the pitch circle.
        let least_mm = gear.base_radius_mm() + LEAST_ABOVE_BASE * gear.module_mm;
        Self {
            usable_mm: gear.active_flank_mm().map(|radius| radius.max(least_mm)),
            slope_mm: None,
            capture_mm: 0.15 * gear.module_mm,
            band_mm: 1.0,
            best_fit_axis: false,
            u95_um: 5.0,
            cumulative_u95_um: None,
        }
    }

    /// With the uncertainty of a quantity.
    pub fn of_quantity(self, quantity: Quantity) -> Self {
        let own_um = match quantity {
            Quantity::CumulativePitch | Quantity::Runout => self.cumulative_u95_um,
            _ => None,
        };
        Self {
            u95_um: own_um.unwrap_or(self.u95_um),
            ..self
        }
    }

    /// Guard band of a figure about its tolerance for a probability of conformity: the same as for wear
    /// ([`crate::verdict`]), um.
    pub fn guard_um(&self, probability: f64) -> f64 {
        guard_factor(probability) * self.u_um()
    }

    /// Standard uncertainty of a deviation, um.
    pub fn u_um(&self) -> f64 {
        standard_of_u95(self.u95_um)
    }

    /// The same, mm.
    fn u_mm(&self) -> f64 {
        1e-3 * self.u_um()
    }
}

/// Reasons for which nothing can be evaluated.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum GearEvaluationError {
    /// The formulas do not hold for this gear.
    #[error("{key} = {value} is outside of ISO 1328-1; right would be {least} to {most}")]
    Scope {
        /// Name of the setting.
        key: &'static str,
        /// Its value.
        value: f64,
        /// Least.
        least: f64,
        /// Most.
        most: f64,
    },
    /// A setting makes no sense.
    #[error("{key} = {value} is no use; right would be {right}")]
    Setting {
        /// Name of the setting.
        key: &'static str,
        /// Its value.
        value: f64,
        /// Valid values.
        right: &'static str,
    },
    /// The cloud is not on the flanks.
    #[error(
        "{near} of {points} points lie within {capture_mm} mm of a flank; right would be a cloud in the tool's coordinates"
    )]
    NotOnFlanks {
        /// Points near a flank.
        near: usize,
        /// All points.
        points: usize,
        /// The limit.
        capture_mm: f64,
    },
    /// The axis is not fixed by what was seen.
    #[error(
        "the flanks seen do not fix an axis; right would be flanks all around the gear, or the tool's axis"
    )]
    AxisNotFixed,
}

#[derive(Debug, Clone, Copy)]
struct PointNearFlank {
    /// Roll length, mm.
    roll_mm: f64,
    height_mm: f64,
    deviation_mm: f64,
}

/// One flank's figures. Each that is missing has its reason beside it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FlankFigures {
    /// Tooth, from 1.
    pub tooth: u32,
    /// Side.
    pub flank: Flank,
    /// Profile at mid face.
    pub profile: Option<TraceFigures>,
    /// Reason of a missing profile.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub profile_not_told: Option<NotTold>,
    /// Helix at the measuring circle.
    pub helix: Option<TraceFigures>,
    /// Reason of a missing helix.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub helix_not_told: Option<NotTold>,
    /// Terms over the whole flank.
    pub areal: Option<ArealTerms>,
    /// Reason of missing terms.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub areal_not_told: Option<NotTold>,
    /// Deviation at the measuring circle at mid face, which pitch and runout are made of, um.
    pub position_um: Option<f64>,
    /// Its standard uncertainty by how the points there scatter, um.
    pub position_noise_um: Option<f64>,
    /// Reason of a missing position.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub position_not_told: Option<NotTold>,
}

/// Pitch deviations of one side of all teeth, at the measuring circle, um.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PitchFigures {
    /// Single pitch deviation from the tooth before, by tooth; missing where one of the two has no position.
    pub single_um: Vec<Option<f64>>,
    /// Teeth whose flank has no position.
    pub missing_teeth: Vec<u32>,
    /// Largest single pitch deviation in size.
    pub f_p_um: Option<f64>,
    /// Reason of a missing figure.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub f_p_not_told: Option<NotTold>,
    /// Largest difference between neighbouring ones.
    pub f_u_um: Option<f64>,
    /// Reason of a missing figure.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub f_u_not_told: Option<NotTold>,
    /// Total cumulative pitch deviation; only when every tooth was seen.
    pub total_um: Option<f64>,
    /// Reason of a missing figure.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub total_not_told: Option<NotTold>,
}

/// Result of one quantity over all flanks.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Rating {
    /// The quantity.
    pub quantity: Quantity,
    /// The standard's symbol.
    pub symbol: &'static str,
    /// Largest value, um; none when nothing could be read.
    pub value_um: Option<f64>,
    /// Reason of a missing figure, with its remedy.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub not_told: Option<NotTold>,
    /// Flanks that the value is the largest of.
    pub flanks: usize,
    /// Best class that holds it.
    pub class: Option<u32>,
    /// Tolerance of that class, um.
    pub tolerance_um: Option<f64>,
    /// Best class that can be stated with this uncertainty: U/T at most 0.3.
    pub best_stateable_class: Option<u32>,
    /// Set when there is a value but no class, or a class better than what can be stated: why.
    pub note: Option<String>,
}

impl Rating {
    /// Reason of a missing value, with its remedy; empty where there is a value.
    pub fn why_not_told(&self) -> String {
        let told = self.not_told.as_ref();
        told.map_or_else(String::new, |why| format!("{why}; {}", why.next_step()))
    }
}

/// The whole evaluation.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GearEvaluation {
    /// Radii and heights between which figures are evaluated.
    pub limits: EvaluationRange,
    /// Axis of the flanks against that of the tool; taken out of every figure when the settings say so.
    pub axis: Option<AxisFit>,
    /// Reason of a missing axis.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub axis_not_told: Option<NotTold>,
    /// Whether it was taken out.
    pub about_best_fit_axis: bool,
    /// Points on flanks.
    pub points: usize,
    /// Every flank of which something was seen.
    pub flanks: Vec<FlankFigures>,
    /// Pitch of the left flanks.
    pub left: PitchFigures,
    /// Pitch of the right flanks.
    pub right: PitchFigures,
    /// Runout; only when every tooth was seen on both sides.
    pub runout_um: Option<f64>,
    /// Reason of the missing value.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub runout_not_told: Option<NotTold>,
    /// Classes.
    pub ratings: Vec<Rating>,
}

/// Largest share of a tolerance that the uncertainty may take for a class to be stated.
const LARGEST_SHARE: f64 = 0.3;

/// Evaluates a cloud in tool coordinates (finite points, mm).
///
/// # Errors
/// [`GearEvaluationError`]: a gear or settings out of scope, a cloud that is not on the flanks, an axis that is not fixed.
pub fn evaluate(
    gear: &GearData,
    points: &[[f64; 3]],
    settings: &EvaluationSettings,
) -> Result<GearEvaluation, GearEvaluationError> {
    let mut gathering = Gathering::new(gear, settings)?;
    gathering.add(points);
    gathering.evaluated()
}

fn check(gear: &GearData, settings: &EvaluationSettings) -> Result<(), GearEvaluationError> {
    let refuse = |key, value, right| Err(GearEvaluationError::Setting { key, value, right });
    let width = gear.height_mm[1] - gear.height_mm[0];
    for (key, value, least, most) in [
        ("module_mm", gear.module_mm, 0.5, 70.0),
        ("teeth", f64::from(gear.teeth), 5.0, 1000.0),
        ("face width (height_mm)", width, 4.0, 1200.0),
    ] {
        if !(least..=most).contains(&value) {
            return Err(GearEvaluationError::Scope {
                key,
                value,
                least,
                most,
            });
        }
    }
    let cumulative = settings.of_quantity(Quantity::CumulativePitch);
    let positive = [
        ("capture_mm", settings.capture_mm),
        ("band_mm", settings.band_mm),
        ("u95_um", settings.u95_um),
        ("cumulative_u95_um", cumulative.u95_um),
    ];
    for (key, value) in positive {
        if !(value > 0.0 && value.is_finite()) {
            return refuse(key, value, "a positive number");
        }
    }
    let base = gear.base_radius_mm();
    let slope = settings.slope_mm.unwrap_or(settings.usable_mm);
    for (key, radii) in [
        ("a usable radius", settings.usable_mm),
        ("a radius of the profile slope", slope),
    ] {
        if let Some(&value) = radii.iter().find(|r| !(**r > base && r.is_finite())) {
            return refuse(key, value, "a radius outside the base circle");
        }
    }
    let [low, high] = slope;
    if low == high {
        return refuse("a radius of the profile slope", low, "two different radii");
    }
    let (inner, outer) = ends([gear.tip_radius_mm, gear.root_radius_mm]);
    for value in settings.usable_mm {
        if !(inner..=outer).contains(&value) {
            let right = "a radius between tip and root circle";
            return refuse("a usable radius", value, right);
        }
    }
    let (low, high) = ends(settings.usable_mm);
    let pitch = gear.pitch_radius_mm();
    if !(low < pitch && pitch < high) {
        let value = if low >= pitch { low } else { high };
        let right = "radii on both sides of the pitch circle";
        return refuse("a usable radius", value, right);
    }
    Ok(())
}

fn ends([a, b]: [f64; 2]) -> (f64, f64) {
    (a.min(b), a.max(b))
}

/// A flank's position as a length along the measuring circle, um, counted with the angle.
fn arc_um(gear: &GearData, flank: &FlankFigures) -> Option<f64> {
    // A rotation moves the flank along its normal by the base radius, along the measuring circle by the pitch radius.
    let ratio = gear.pitch_radius_mm() / gear.base_radius_mm();
    Some(flank.flank.sign() * flank.position_um? * ratio)
}

fn pitch(gear: &GearData, flanks: &[FlankFigures], side: Flank) -> PitchFigures {
    let mut arcs = vec![None; gear.teeth as usize];
    for flank in flanks.iter().filter(|flank| flank.flank == side) {
        arcs[flank.tooth as usize - 1] = arc_um(gear, flank);
    }
    let count = arcs.len();
    let single_um: Vec<Option<f64>> = (0..count)
        .map(|i| Some(arcs[i]? - arcs[(i + count - 1) % count]?))
        .collect();
    let largest = |values: &mut dyn Iterator<Item = f64>| values.map(f64::abs).reduce(f64::max);
    let mut neighbours =
        (0..count).filter_map(|i| Some(single_um[i]? - single_um[(i + count - 1) % count]?));
    let few = |count| NotTold::NoNeighbours { count, flank: side };
    let missing_teeth: Vec<u32> = (1..=gear.teeth)
        .filter(|tooth| arcs[*tooth as usize - 1].is_none())
        .collect();
    let total = match missing_teeth.first() {
        None => Ok(range_of(arcs.iter().copied().flatten())),
        Some(&first) => Err(NotTold::TeethMissing {
            flank: side,
            missing: missing_teeth.len(),
            teeth: count,
            first,
        }),
    };
    let single = largest(&mut single_um.iter().flatten().copied());
    let (f_p_um, f_p_not_told) = split(single.ok_or_else(|| few(2)));
    let (f_u_um, f_u_not_told) = split(largest(&mut neighbours).ok_or_else(|| few(3)));
    let (total_um, total_not_told) = split(total);
    PitchFigures {
        f_p_um,
        f_p_not_told,
        f_u_um,
        f_u_not_told,
        total_um,
        total_not_told,
        missing_teeth,
        single_um,
    }
}

/// Range of the radial place of a ball that touches both flanks of a space at the measuring circle.
fn runout(
    gear: &GearData,
    flanks: &[FlankFigures],
    pitches: [&PitchFigures; 2],
) -> Result<f64, NotTold> {
    let count = gear.teeth as usize;
    let mut positions = vec![[None; 2]; count];
    for flank in flanks {
        positions[flank.tooth as usize - 1][usize::from(flank.flank == Flank::Right)] =
            flank.position_um;
    }
    let out = 2.0 * gear.pressure_angle_deg.to_radians().sin();
    let places: Option<Vec<f64>> = (0..count)
        .map(|i| {
            // The space between this tooth's left flank and the next tooth's right flank.
            Some((positions[i][0]? + positions[(i + 1) % count][1]?) / out)
        })
        .collect();
    // Without a place a flank is missing, and the pitch of its side says which.
    let missing = || {
        let why = pitches
            .iter()
            .find_map(|pitch| pitch.total_not_told.clone());
        why.unwrap_or(NotTold::NotSeen)
    };
    places.map(range_of).ok_or_else(missing)
}

/// A quantity's value over all flanks, and of how many flanks it is the largest.
fn value_of(quantity: Quantity, evaluation: &GearEvaluation) -> (Result<f64, NotTold>, usize) {
    let flanks = &evaluation.flanks;
    type Read<'a> = &'a dyn Fn(&TraceFigures) -> f64;
    let largest = |profile: bool, read: Read<'_>| {
        let told = |f: &FlankFigures| if profile { f.profile } else { f.helix };
        let values: Vec<f64> = flanks
            .iter()
            .filter_map(told)
            .map(|f| read(&f).abs())
            .collect();
        let value = values.iter().copied().reduce(f64::max).ok_or_else(|| {
            // There is at least one flank, else nothing would have been evaluated.
            let f = &flanks[0];
            let why = if profile {
                &f.profile_not_told
            } else {
                &f.helix_not_told
            };
            NotTold::NoFlank {
                flanks: flanks.len(),
                tooth: f.tooth,
                flank: f.flank,
                first: Box::new(why.clone().unwrap_or(NotTold::NotSeen)),
            }
        });
        (value, values.len())
    };
    let pitches = [&evaluation.left, &evaluation.right];
    let positions = || flanks.iter().filter(|f| f.position_um.is_some()).count();
    type ReadPitch<'a> = &'a dyn Fn(&PitchFigures) -> Result<f64, NotTold>;
    // Half of the flanks is not all of them: the first side that is missing says why.
    let both = |read: ReadPitch<'_>| {
        let larger = read(pitches[0]).and_then(|left| Ok(left.max(read(pitches[1])?)));
        (larger, positions())
    };
    match quantity {
        Quantity::ProfileTotal => largest(true, &|f| f.total_um),
        Quantity::ProfileForm => largest(true, &|f| f.form_um),
        Quantity::ProfileSlope => largest(true, &|f| f.slope_um),
        Quantity::HelixTotal => largest(false, &|f| f.total_um),
        Quantity::HelixForm => largest(false, &|f| f.form_um),
        Quantity::HelixSlope => largest(false, &|f| f.slope_um),
        Quantity::SinglePitch => both(&|p| joined(p.f_p_um, &p.f_p_not_told)),
        Quantity::CumulativePitch => both(&|p| joined(p.total_um, &p.total_not_told)),
        Quantity::Runout => {
            let runout = joined(evaluation.runout_um, &evaluation.runout_not_told);
            (runout, positions())
        }
    }
}

fn ratings(
    gear: &GearData,
    evaluation: &GearEvaluation,
    settings: &EvaluationSettings,
) -> Vec<Rating> {
    let rating = |quantity: Quantity| {
        let (value, flanks) = value_of(quantity, evaluation);
        let u95_um = settings.of_quantity(quantity).u95_um;
        let (value_um, not_told) = split(value);
        let class = value_um.and_then(|value| quantity.class_of(gear, value));
        let best_stateable_class = CLASSES
            .into_iter()
            .find(|&class| u95_um / quantity.tolerance_um(gear, class) <= LARGEST_SHARE);
        let note = match (value_um, class) {
            (Some(_), None) => Some(format!(
                "beyond class {}, which allows {} um",
                CLASSES.end(),
                quantity.tolerance_um(gear, *CLASSES.end())
            )),
            (_, Some(class)) if best_stateable_class.is_none_or(|least| class < least) => {
                let next = match best_stateable_class {
                    Some(best) => format!("class {best} is the best that can be stated"),
                    None => "no class can be stated".into(),
                };
                Some(format!(
                    "not capable for class {class}: U/T = {:.2}, at most {LARGEST_SHARE}; {next} until U95 is smaller (--u95-um)",
                    u95_um / quantity.tolerance_um(gear, class)
                ))
            }
            _ => None,
        };
        Rating {
            quantity,
            symbol: quantity.symbol(),
            value_um,
            not_told,
            flanks,
            class,
            tolerance_um: class.map(|class| quantity.tolerance_um(gear, class)),
            best_stateable_class,
            note,
        }
    };
    Quantity::ALL.into_iter().map(rating).collect()
}
