//! Gear evaluation in the sense of ISO 1328-1: profile, helix, pitch and runout of every tooth from a cloud of points.
//!
//! | file | holds |
//! |---|---|
//! | `axis` | the axis that deviations are stated about |
//! | `trace` | smoothing along profile and helix, and what is read from it |
//! | `areal` | the whole flank as a few terms |
//! | `tolerance` | classes |
//!
//! Deviations are along the normal of the involute, positive where material stands proud, and exact in closed form
//! ([`GearData::involute_deviation_mm`]). The standard is for external and internal gears; for a die it is used by analogy.

mod areal;
mod axis;
mod tolerance;
mod trace;

pub use areal::ArealTerms;
pub use axis::AxisFit;
pub use tolerance::{CLASSES, Quantity};
pub use trace::TraceFigures;

use serde::Serialize;

use crate::gear::{Flank, GearData};

/// What to evaluate, and by what.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// Ends of the usable flank: radii between which it is an involute, mm, in any order.
    pub usable_mm: [f64; 2],
    /// Points farther than this from the involute belong to something else, mm.
    pub capture_mm: f64,
    /// A profile trace takes points up to this far from mid face, a helix trace up to half of it (as roll length) from the
    /// measuring circle, mm.
    pub band_mm: f64,
    /// State deviations about the axis that fits best instead of the tool's own.
    pub best_fit_axis: bool,
    /// Expanded uncertainty of a deviation (95 %), um.
    pub u95_um: f64,
}

impl Settings {
    /// The active flank, a band of 1 mm, an uncertainty of 5 um.
    pub fn of(gear: &GearData) -> Self {
        Self {
            usable_mm: gear.active_flank_mm(),
            capture_mm: 0.15 * gear.module_mm,
            band_mm: 1.0,
            best_fit_axis: false,
            u95_um: 5.0,
        }
    }
}

/// Why nothing can be evaluated.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum GearEvaluationError {
    /// The formulas do not hold for this gear.
    #[error("{key} = {value} is outside of ISO 1328-1; right would be {least} to {most}")]
    Scope {
        /// What.
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
        /// Which.
        key: &'static str,
        /// Its value.
        value: f64,
        /// What would be right.
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

/// A point near a flank.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FlankPoint {
    tooth: u32,
    flank: Flank,
    /// Roll length, mm.
    roll_mm: f64,
    height_mm: f64,
    deviation_mm: f64,
    /// Outward normal of the involute in the plane.
    normal: [f64; 2],
    /// Sign of the flank: what a rotation of the gear does to its deviation.
    sign: f64,
}

/// One flank's figures. Traces and terms are missing where the cloud does not cover them.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FlankFigures {
    /// Tooth, from 1.
    pub tooth: u32,
    /// Side.
    pub flank: Flank,
    /// Profile at mid face.
    pub profile: Option<TraceFigures>,
    /// Helix at the measuring circle.
    pub helix: Option<TraceFigures>,
    /// Terms over the whole flank.
    pub areal: Option<ArealTerms>,
    /// Mean deviation at the measuring circle, which pitch and runout are made of, um.
    pub position_um: Option<f64>,
}

/// Pitch deviations of one side of all teeth, at the measuring circle, um.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PitchFigures {
    /// Single pitch deviation from the tooth before, by tooth; missing where one of the two was not seen.
    pub single_um: Vec<Option<f64>>,
    /// Largest of them in size.
    pub f_p_um: Option<f64>,
    /// Largest difference between neighbouring ones.
    pub f_u_um: Option<f64>,
    /// Total cumulative pitch deviation; only when every tooth was seen.
    pub total_um: Option<f64>,
}

/// What one quantity comes to over all flanks.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Rating {
    /// Which.
    pub quantity: Quantity,
    /// The standard's symbol.
    pub symbol: &'static str,
    /// Largest value, um; none when nothing could be read.
    pub value_um: Option<f64>,
    /// Best class that holds it.
    pub class: Option<u32>,
    /// Tolerance of that class, um.
    pub tolerance_um: Option<f64>,
    /// Best class that can be stated with this uncertainty: U/T at most 0.3.
    pub best_stateable_class: Option<u32>,
    /// Set when the class found is better than what can be stated.
    pub note: Option<String>,
}

/// The whole evaluation.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GearEvaluation {
    /// How the flanks lie about the tool's axis; taken out of every figure when asked for.
    pub axis: Option<AxisFit>,
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
    /// Classes.
    pub ratings: Vec<Rating>,
}

/// Largest share of a tolerance that the uncertainty may take for a class to be stated.
const LARGEST_SHARE: f64 = 0.3;
/// Of the usable profile this much is evaluated, from the root end on: tips are rounded.
const EVALUATED_SHARE: f64 = 0.95;
/// Fewer points than this near the measuring circle leave a flank's position open.
const LEAST_POSITION_POINTS: usize = 8;

/// Evaluates a cloud in tool coordinates (finite points, mm).
///
/// # Errors
/// [`GearEvaluationError`]: a gear or settings out of scope, a cloud that is not on the flanks, an axis that is not fixed.
pub fn evaluate(
    gear: &GearData,
    points: &[[f64; 3]],
    settings: &Settings,
) -> Result<GearEvaluation, GearEvaluationError> {
    check(gear, settings)?;
    let roll = |radius: f64| {
        (radius * radius - gear.base_radius_mm().powi(2))
            .max(0.0)
            .sqrt()
    };
    let [first, second] = settings.usable_mm;
    // From the root end to the tip end, whichever of the two is farther out.
    let root_first = (first - gear.root_radius_mm).abs() < (second - gear.root_radius_mm).abs();
    let (root_mm, tip_mm) = if root_first {
        (roll(first), roll(second))
    } else {
        (roll(second), roll(first))
    };
    let mut found: Vec<FlankPoint> = points
        .iter()
        .filter_map(|&point| on_flank(gear, point, settings))
        .collect();
    if 10 * found.len() < points.len() || found.is_empty() {
        return Err(GearEvaluationError::NotOnFlanks {
            near: found.len(),
            points: points.len(),
            capture_mm: settings.capture_mm,
        });
    }
    let axis = axis::fit(gear, &found);
    if settings.best_fit_axis {
        let motion = axis.as_ref().ok_or(GearEvaluationError::AxisNotFixed)?;
        motion.take_out(gear, &mut found);
    }
    found.sort_by_key(|point| (point.tooth, point.flank));
    let flanks: Vec<FlankFigures> = found
        .chunk_by(|a, b| (a.tooth, a.flank) == (b.tooth, b.flank))
        .map(|own| flank_figures(gear, own, (root_mm, tip_mm), settings))
        .collect();
    let [left, right] = Flank::BOTH.map(|side| pitch(gear, &flanks, side));
    let runout_um = runout(gear, &flanks);
    let ratings = ratings(gear, &flanks, [&left, &right], runout_um, settings.u95_um);
    Ok(GearEvaluation {
        axis,
        about_best_fit_axis: settings.best_fit_axis,
        points: found.len(),
        flanks,
        left,
        right,
        runout_um,
        ratings,
    })
}

fn check(gear: &GearData, settings: &Settings) -> Result<(), GearEvaluationError> {
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
    let positive = [
        ("capture_mm", settings.capture_mm),
        ("band_mm", settings.band_mm),
        ("u95_um", settings.u95_um),
    ];
    for (key, value) in positive {
        if !(value > 0.0 && value.is_finite()) {
            return Err(GearEvaluationError::Setting {
                key,
                value,
                right: "a positive number",
            });
        }
    }
    for value in settings.usable_mm {
        if !(value > gear.base_radius_mm() && value.is_finite()) {
            return Err(GearEvaluationError::Setting {
                key: "a usable radius",
                value,
                right: "a radius outside the base circle",
            });
        }
    }
    let (low, high) = ends(settings.usable_mm);
    let pitch = gear.pitch_radius_mm();
    if !(low < pitch && pitch < high) {
        return Err(GearEvaluationError::Setting {
            key: "a usable radius",
            value: if low >= pitch { low } else { high },
            right: "radii on both sides of the pitch circle",
        });
    }
    Ok(())
}

fn ends([a, b]: [f64; 2]) -> (f64, f64) {
    (a.min(b), a.max(b))
}

fn on_flank(gear: &GearData, point: [f64; 3], settings: &Settings) -> Option<FlankPoint> {
    let (low, high) = ends(settings.usable_mm);
    let radius = point[0].hypot(point[1]);
    if !(low..=high).contains(&radius)
        || !(gear.height_mm[0]..=gear.height_mm[1]).contains(&point[2])
    {
        return None;
    }
    let angle = point[1].atan2(point[0]);
    let tooth = gear.tooth_at(angle);
    // In a space the nearer tooth is the one whose flank is nearer, on the side that the angle says.
    let nearest = Flank::BOTH
        .into_iter()
        .filter_map(|flank| Some((flank, gear.involute_deviation_mm(tooth, flank, point)?)))
        .min_by(|a, b| a.1.abs().total_cmp(&b.1.abs()))?;
    let (flank, deviation_mm) = nearest;
    if deviation_mm.abs() > settings.capture_mm {
        return None;
    }
    // The normal of an involute touches the base circle: it leans back from the tangent by the pressure angle there.
    let pressure = (gear.base_radius_mm() / radius).acos();
    let lean = angle + flank.sign() * (std::f64::consts::FRAC_PI_2 + pressure);
    Some(FlankPoint {
        tooth,
        flank,
        roll_mm: (radius * radius - gear.base_radius_mm().powi(2))
            .max(0.0)
            .sqrt(),
        height_mm: point[2],
        deviation_mm,
        normal: [lean.cos(), lean.sin()],
        sign: flank.sign(),
    })
}

fn flank_figures(
    gear: &GearData,
    own: &[FlankPoint],
    (root_mm, tip_mm): (f64, f64),
    settings: &Settings,
) -> FlankFigures {
    let [low, high] = gear.height_mm;
    let middle = 0.5 * (low + high);
    let measuring = (gear.pitch_radius_mm().powi(2) - gear.base_radius_mm().powi(2)).sqrt();
    // Both lengths run from the root end (or the lower end) on.
    let along = |point: &FlankPoint| (point.roll_mm - root_mm) * (tip_mm - root_mm).signum();
    let whole = (tip_mm - root_mm).abs();
    let evaluated = EVALUATED_SHARE * whole;
    let mut profile: Vec<(f64, f64)> = own
        .iter()
        .filter(|point| (point.height_mm - middle).abs() <= settings.band_mm)
        .map(|point| (along(point), point.deviation_mm))
        .collect();
    let profile = trace::figures(&mut profile, [0.0, evaluated], whole, cutoff(evaluated));
    let half_band = 0.5 * settings.band_mm;
    let near: Vec<&FlankPoint> = own
        .iter()
        .filter(|point| (point.roll_mm - measuring).abs() <= half_band)
        .collect();
    let width = high - low;
    let shortened = (0.05 * width).min(gear.module_mm);
    let length = width - 2.0 * shortened;
    let mut helix: Vec<(f64, f64)> = near
        .iter()
        .map(|point| (point.height_mm - low, point.deviation_mm))
        .collect();
    let helix = trace::figures(
        &mut helix,
        [shortened, width - shortened],
        width,
        cutoff(length),
    );
    let position: Vec<f64> = near
        .iter()
        .filter(|point| (point.height_mm - middle).abs() <= settings.band_mm)
        .map(|point| point.deviation_mm)
        .collect();
    let unit: Vec<(f64, f64, f64)> = own
        .iter()
        .map(|point| {
            let v = 2.0 * (point.height_mm - middle) / width;
            (2.0 * along(point) / whole - 1.0, v, point.deviation_mm)
        })
        .collect();
    FlankFigures {
        tooth: own[0].tooth,
        flank: own[0].flank,
        profile,
        helix,
        areal: areal::terms(&unit),
        position_um: (position.len() >= LEAST_POSITION_POINTS)
            .then(|| 1e3 * position.iter().sum::<f64>() / position.len() as f64),
    }
}

/// Cutoff of the Gaussian for an evaluated length.
fn cutoff(length_mm: f64) -> f64 {
    (length_mm / 30.0).max(0.025)
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
    let neighbours =
        (0..count).filter_map(|i| Some(single_um[i]? - single_um[(i + count - 1) % count]?));
    let all: Option<Vec<f64>> = arcs.iter().copied().collect();
    PitchFigures {
        f_p_um: largest(&mut single_um.iter().flatten().copied()),
        f_u_um: largest(&mut neighbours.into_iter()),
        total_um: all.map(|arcs| range(&arcs)),
        single_um,
    }
}

/// Range of the radial place of a ball that touches both flanks of a space at the measuring circle.
fn runout(gear: &GearData, flanks: &[FlankFigures]) -> Option<f64> {
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
    places.map(|places| range(&places))
}

fn range(values: &[f64]) -> f64 {
    let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    high - values.iter().copied().fold(f64::INFINITY, f64::min)
}

fn ratings(
    gear: &GearData,
    flanks: &[FlankFigures],
    pitches: [&PitchFigures; 2],
    runout_um: Option<f64>,
    u95_um: f64,
) -> Vec<Rating> {
    let traces = |of: &dyn Fn(&FlankFigures) -> Option<f64>| {
        flanks.iter().filter_map(of).map(f64::abs).reduce(f64::max)
    };
    let both = |of: &dyn Fn(&PitchFigures) -> Option<f64>| {
        let [left, right] = pitches.map(of);
        // Half of the flanks is not all of them.
        Some(left?.max(right?))
    };
    let value_of = |quantity| match quantity {
        Quantity::ProfileTotal => traces(&|f| Some(f.profile?.total_um)),
        Quantity::ProfileForm => traces(&|f| Some(f.profile?.form_um)),
        Quantity::ProfileSlope => traces(&|f| Some(f.profile?.slope_um)),
        Quantity::HelixTotal => traces(&|f| Some(f.helix?.total_um)),
        Quantity::HelixForm => traces(&|f| Some(f.helix?.form_um)),
        Quantity::HelixSlope => traces(&|f| Some(f.helix?.slope_um)),
        Quantity::SinglePitch => both(&|p| p.f_p_um),
        Quantity::CumulativePitch => both(&|p| p.total_um),
        Quantity::Runout => runout_um,
    };
    Quantity::ALL
        .into_iter()
        .map(|quantity| {
            let value_um = value_of(quantity);
            let class = value_um.and_then(|value| quantity.class_of(gear, value));
            let stateable = CLASSES
                .into_iter()
                .find(|&class| u95_um / quantity.tolerance_um(gear, class) <= LARGEST_SHARE);
            let note = class
                .filter(|class| stateable.is_none_or(|least| *class < least))
                .map(|class| {
                    let tolerance = quantity.tolerance_um(gear, class);
                    format!(
                        "not capable for class {class}: U/T = {:.2}, at most {LARGEST_SHARE}",
                        u95_um / tolerance
                    )
                });
            Rating {
                quantity,
                symbol: quantity.symbol(),
                value_um,
                class,
                tolerance_um: class.map(|class| quantity.tolerance_um(gear, class)),
                best_stateable_class: stateable,
                note,
            }
        })
        .collect()
}
