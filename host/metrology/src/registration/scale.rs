//! Is the die of the drawing's size? A scaled die, a warm one, or one of another drawing lies on the CAD almost well.
//!
//! Seen from one side a larger bore is a bore that stands farther away: every flank in the middle of the view moves as a shift
//! towards the wall moves it. What is left of a scale `s` at an angle `θ` from the middle is `s R θ` along the circumference, the
//! same on tips, roots and both flanks of a tooth: at a bore of 41 mm and one pitch aside 3 µm for a scale of 0.1 %. Wear of
//! single flanks, and different wear of both sides, contradict that.

use std::collections::BTreeMap;

use flankscope_foundation::normal::COVERAGE_95;
use flankscope_foundation::order::median_of;
use nalgebra::{Matrix4, Vector4};

use crate::gear::{Flank, FlankPlace, GearData};
use crate::surface::Closest;

/// Least number of points of a tooth part that counts.
const LEAST_POINTS: usize = 100;
/// Fewer parts leave nothing to contradict a scale.
const LEAST_PARTS: usize = 6;
/// A scale explains a view when it leaves the parts off by less than this part of what they are off without one, and by no more
/// than their form is known to. Flanks that are each off by some micrometres of their own agree as well as that by chance once in
/// some hundred views.
const MOST_OF_WITHOUT: f64 = 0.2;
/// A point belongs to tip or root land within this distance of its radius, mm.
const LAND_MM: f64 = 0.05;

/// By how much a view shows its die larger than the drawing, as a share of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scale {
    /// The share.
    pub value: f64,
    /// Its standard uncertainty by the form of the parts, be the deviations of a tooth's two flanks the same, opposite or independent.
    pub u_form: f64,
    /// The same with what the calibration leaves.
    pub u: f64,
    /// Residuals of the tooth parts in view after the fit of scale and pose, rms, mm.
    pub left_mm: f64,
    /// The same without a scale, mm.
    pub without_mm: f64,
    /// To what the form of each part is known, mm.
    form_mm: f64,
}

impl Scale {
    /// Whether the teeth in view may be of a scale other than 1: it leaves them off by no more than their form is known to, as damage
    /// does not, and their form alone does not explain it.
    pub fn is_possible(&self) -> bool {
        self.left_mm <= self.form_mm && self.value.abs() > COVERAGE_95 * self.u_form
    }

    /// Whether the teeth in view agree on such a scale, calibration error aside: without one they contradict each other.
    pub fn is_told(&self) -> bool {
        self.is_possible() && self.left_mm < MOST_OF_WITHOUT * self.without_mm
    }

    /// Whether the scale also exceeds what the calibration's uncertainty can explain.
    pub fn is_shown(&self) -> bool {
        self.is_told() && self.value.abs() > COVERAGE_95 * self.u
    }
}

/// Parts of the teeth in view; roots go by the tooth before them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum ToothPart {
    Tip,
    Root,
    Side(Flank),
}

/// Deviations and positions of the points on one part of a tooth.
#[derive(Default)]
struct SeenPart {
    off_mm: Vec<f64>,
    /// Sum of what shifts, a turn and a scale add to the points' deviation.
    rows: Vector4<f64>,
    /// Sum of their distances along the circumference from the middle of the view, mm.
    along_mm: f64,
}

/// The scale of what one view shows, the judged tooth and the roots beside it left out. `form_mm` is to what each part's form is
/// known, `calibration_mm` what the head's calibration leaves at each end of the field, both standard uncertainties. None where
/// too little is in view.
pub fn of_view(
    gear: &GearData,
    judged_tooth: u32,
    closest: &[Closest],
    places: &[Option<FlankPlace>],
    [form_mm, calibration_mm]: [f64; 2],
) -> Option<Scale> {
    let mut parts: BTreeMap<(u32, ToothPart), SeenPart> = BTreeMap::new();
    let active_mm = gear.active_flank_mm();
    let (sin_middle, cos_middle) = middle_rad(closest).sin_cos();
    let before_judged = (judged_tooth + gear.teeth - 2) % gear.teeth + 1;
    for (hit, place) in closest.iter().zip(places) {
        let [x, y, _] = hit.point;
        let land = |land_mm: f64| {
            let radius_mm = x.hypot(y);
            (radius_mm - land_mm).abs() < LAND_MM
        };
        let (tooth, part) = match place {
            Some(place) if (active_mm[0]..active_mm[1]).contains(&place.radius_mm) => {
                (place.tooth, ToothPart::Side(place.flank))
            }
            Some(_) => continue,
            None if land(gear.tip_radius_mm) => (gear.tooth_at(y.atan2(x)), ToothPart::Tip),
            None if land(gear.root_radius_mm) => {
                let before_rad = y.atan2(x) - 0.5 * gear.pitch_rad();
                (gear.tooth_at(before_rad), ToothPart::Root)
            }
            None => continue,
        };
        if tooth == judged_tooth || (part == ToothPart::Root && tooth == before_judged) {
            continue;
        }
        let [nx, ny, _] = hit.normal;
        let row = Vector4::new(nx, ny, x * ny - y * nx, x * nx + y * ny);
        let seen = parts.entry((tooth, part)).or_default();
        seen.off_mm.push(hit.signed_distance_mm);
        seen.rows += row;
        seen.along_mm += y * cos_middle - x * sin_middle;
    }
    parts.retain(|_, seen| seen.off_mm.len() >= LEAST_POINTS);
    if parts.len() < LEAST_PARTS {
        return None;
    }
    // About the middle of the view, and in lengths: a turn as what it moves at the bore.
    let rows: Vec<(Vector4<f64>, f64)> = parts
        .values()
        .map(|seen| {
            let mut row = seen.rows / seen.off_mm.len() as f64;
            row[2] /= gear.tip_radius_mm;
            row[3] /= gear.tip_radius_mm;
            let off_mm = median_of(seen.off_mm.iter().copied());
            (row, off_mm.unwrap_or(f64::NAN))
        })
        .collect();
    let ends_mm = parts
        .values()
        .map(|seen| (seen.along_mm / seen.off_mm.len() as f64).abs())
        .fold(0.0, f64::max);
    let count = rows.len() as f64;
    let (with, normal) = solve(&rows, 4)?;
    let (without, _) = solve(&rows, 3)?;
    let rms_mm = |solution: &Vector4<f64>, unknowns: f64| {
        let squares = rows
            .iter()
            .map(|(row, off)| (off - row.dot(solution)).powi(2));
        (squares.sum::<f64>() / (count - unknowns)).sqrt()
    };
    let left_mm = rms_mm(&with, 4.0);
    let inverse = normal.try_inverse()?;
    let weights = rows.iter().map(|(row, _)| (inverse * row)[3]);
    let per_mm = worst_case(parts.keys().copied().zip(weights)) / gear.tip_radius_mm;
    let u_form = per_mm * left_mm.max(form_mm);
    // Both ends are off by amounts of their own.
    let u_calibration = calibration_mm / (2f64.sqrt() * ends_mm);
    Some(Scale {
        value: with[3] / gear.tip_radius_mm,
        u_form,
        u: u_form.hypot(u_calibration),
        form_mm,
        left_mm,
        without_mm: rms_mm(&without, 3.0),
    })
}

/// Root sum of squares of the parts' weights; those of a tooth's two flanks are added first, because a pitch deviation moves both.
fn worst_case(weights: impl Iterator<Item = ((u32, ToothPart), f64)>) -> f64 {
    let mut flanks: BTreeMap<u32, f64> = BTreeMap::new();
    let mut squares = 0.0;
    for ((tooth, part), weight) in weights {
        match part {
            ToothPart::Side(_) => *flanks.entry(tooth).or_default() += weight.abs(),
            ToothPart::Tip | ToothPart::Root => squares += weight * weight,
        }
    }
    let of_flanks: f64 = flanks.values().map(|sum| sum * sum).sum();
    (squares + of_flanks).sqrt()
}

fn middle_rad(closest: &[Closest]) -> f64 {
    let sum = |k: usize| closest.iter().map(|hit| hit.point[k]).sum::<f64>();
    sum(1).atan2(sum(0))
}

/// Least squares of the first so many unknowns; the others are zero.
fn solve(rows: &[(Vector4<f64>, f64)], unknowns: usize) -> Option<(Vector4<f64>, Matrix4<f64>)> {
    let mut normal = Matrix4::zeros();
    let mut right = Vector4::zeros();
    for (row, off_mm) in rows {
        let mut row = *row;
        row.rows_range_mut(unknowns..).fill(0.0);
        normal += row * row.transpose();
        right += row * *off_mm;
    }
    for unknown in unknowns..4 {
        normal[(unknown, unknown)] = 1.0;
    }
    let solution = normal.cholesky()?.solve(&right);
    Some((solution, normal))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gear::tests::ring84;
    use crate::surface::Feature;
    use flankscope_foundation::random::normal;

    /// Tips, roots and flanks of five teeth about tooth 3, a larger die by `scale` that lies elsewhere and turned; `lost_mm` is
    /// gone from each flank, and from each tip and root land, which it takes for faces, the roots of teeth beyond the last.
    fn view(scale: f64, lost_mm: impl Fn(u32, Flank) -> f64) -> Option<Scale> {
        let gear = ring84();
        let (mut closest, mut places) = (Vec::new(), Vec::new());
        let mut push = |point: [f64; 3], normal: [f64; 3], lost_mm: f64| {
            let [x, y, _] = point;
            let moved = [scale * x + 0.03 - 1e-3 * y, scale * y - 0.02 + 1e-3 * x];
            let off_mm = moved[0] * normal[0] + moved[1] * normal[1] - lost_mm;
            places.push(gear.place(point, normal));
            closest.push(Closest {
                point,
                signed_distance_mm: off_mm,
                normal,
                triangle: 0,
                feature: Feature::Face,
                smoothness: 1.0,
            });
        };
        for tooth in 1..=5 {
            for step in 0..120 {
                let part = f64::from(step) / 120.0;
                for flank in Flank::BOTH {
                    let radius = 41.2 + 1.5 * part;
                    let point = gear.flank_point(tooth, flank, radius, 33.0).unwrap();
                    push(
                        point,
                        gear.flank_normal(flank, point),
                        lost_mm(tooth, flank),
                    );
                }
                let half_land = 0.2 * gear.pitch_rad() * (part - 0.5);
                let centre = gear.tooth_centre_rad(tooth);
                for (land, angle, radius) in [
                    (tooth, centre + half_land, gear.tip_radius_mm),
                    (
                        tooth + gear.teeth,
                        centre + half_land + 0.5 * gear.pitch_rad(),
                        gear.root_radius_mm,
                    ),
                ] {
                    let (sin, cos) = angle.sin_cos();
                    push(
                        [radius * cos, radius * sin, 33.0],
                        [-cos, -sin, 0.0],
                        lost_mm(land, Flank::Face),
                    );
                }
            }
        }
        of_view(&gear, 3, &closest, &places, [0.5e-3, 2e-3])
    }

    #[test]
    fn a_larger_die_is_told_from_a_shift_and_from_wear() {
        for scale in [1e-3, -1e-3] {
            // Whatever the judged tooth has lost.
            let found = view(scale, |tooth, _| if tooth == 3 { 0.15 } else { 0.0 }).unwrap();
            assert!((found.value - scale).abs() < 1e-5, "{found:?}");
            assert!(found.is_shown(), "{found:?}");
        }
        let as_drawn = view(0.0, |_, _| 0.0).unwrap();
        assert!(!as_drawn.is_told(), "{as_drawn:?}");
        // Beyond 1.96 times what the form leaves, not beyond what the calibration leaves as well: told, not shown.
        let little = view(3.4e-4, |_, _| 0.0).unwrap();
        assert!(little.is_told() && !little.is_shown(), "{little:?}");
    }

    #[test]
    fn wear_of_any_flanks_is_no_scale() {
        for (tooth, flank) in [(2, Flank::Left), (4, Flank::Right), (4, Flank::Left)] {
            for lost_mm in [0.01, 0.04, 0.15] {
                let found = view(0.0, |t, f| {
                    if (t, f) == (tooth, flank) {
                        lost_mm
                    } else {
                        0.0
                    }
                });
                let found = found.unwrap();
                assert!(!found.is_told(), "{tooth} {flank} {lost_mm}: {found:?}");
            }
        }
        // One side of all teeth is a turn.
        let side = view(
            0.0,
            |_, flank| if flank == Flank::Left { 0.05 } else { 0.0 },
        )
        .unwrap();
        assert!(!side.is_told(), "{side:?}");
    }

    /// Teeth that are each off along the pitch circle feign a scale no more often than flanks that are off by themselves: 5 %.
    #[test]
    fn pitch_deviations_are_no_scale() {
        const VIEWS: u64 = 1000;
        let feigned = |of_tooth: bool| {
            let is_feigned = |seed: &u64| {
                let off_mm = |tooth: u32, flank: Flank| match flank {
                    Flank::Face => 0.5e-3 * normal(*seed, 1000 + u64::from(tooth)),
                    _ => {
                        let one =
                            2 * u64::from(tooth) + u64::from(!of_tooth && flank == Flank::Left);
                        0.5e-3 * flank.sign() * normal(*seed, one)
                    }
                };
                view(0.0, off_mm)
                    .is_some_and(|found| found.value.abs() > COVERAGE_95 * found.u_form)
            };
            (0..VIEWS).filter(is_feigned).count() as f64 / VIEWS as f64
        };
        // Three standard deviations of a count above 5 %.
        let most = 0.05 + 3.0 * (0.05 * 0.95 / VIEWS as f64).sqrt();
        for of_tooth in [false, true] {
            let ratio = feigned(of_tooth);
            assert!(ratio <= most, "{of_tooth}: {ratio}");
        }
    }
}
