//! One pitch of the toothed outline, from the middle of a space to the middle of the next.

use crate::spec::{GearKind, GearSpec};

/// A point of the outline in polar coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Polar {
    pub radius_mm: f64,
    /// From the middle of the space before the tooth, rad.
    pub angle_rad: f64,
}

/// Outline of one pitch by increasing angle: half a root, right flank, tip land, left flank.
///
/// The other half of the root belongs to the next pitch, so pitches join without a repeated point: the last point returned
/// is the last before the middle of the next space.
pub(crate) fn pitch_outline(gear: &GearSpec, chord_error_mm: f64) -> Vec<Polar> {
    let centre_rad = 0.5 * gear.pitch_angle_rad();
    let half = root_to_tip(gear, chord_error_mm);
    let mut outline: Vec<Polar> = half
        .iter()
        .map(|p| Polar {
            radius_mm: p.radius_mm,
            angle_rad: centre_rad - p.angle_rad,
        })
        .collect();
    // Mirror at the tooth centre; the first point (middle of the space) is the next pitch's.
    let on_centre = half.last().is_some_and(|p| p.angle_rad == 0.0);
    let mirrored = half.iter().skip(1).rev().skip(usize::from(on_centre));
    outline.extend(mirrored.map(|p| Polar {
        radius_mm: p.radius_mm,
        angle_rad: centre_rad + p.angle_rad,
    }));
    outline
}

/// Half a pitch with angles measured from the tooth centre (positive), from the middle of the space to the tip.
fn root_to_tip(gear: &GearSpec, chord_error_mm: f64) -> Vec<Polar> {
    let half_pitch_rad = 0.5 * gear.pitch_angle_rad();
    let root_mm = gear.root_radius_mm;
    let tip_mm = gear.tip_radius_mm;
    let flank_root_mm = gear.flank_root_radius_mm();
    let root_end_rad = if gear.root_fillet_radius_mm > 0.0 {
        gear.fillet_centre_from_tooth_rad()
    } else {
        gear.tooth_half_angle_rad(flank_root_mm)
    };

    let mut points = arc(root_mm, half_pitch_rad, root_end_rad, chord_error_mm);
    points.push(Polar {
        radius_mm: root_mm,
        angle_rad: root_end_rad,
    });
    if gear.root_fillet_radius_mm > 0.0 {
        points.extend(fillet(gear, root_end_rad, chord_error_mm));
    }
    // With no fillet and the root outside the base circle, the flank starts at the point just pushed.
    let continues = flank_root_mm == root_mm;
    points.extend(
        involute_points(gear, flank_root_mm, tip_mm, chord_error_mm).skip(usize::from(continues)),
    );
    let tip_rad = gear.tooth_half_angle_rad(tip_mm);
    points.extend(
        arc(tip_mm, tip_rad, 0.0, chord_error_mm)
            .into_iter()
            .skip(1),
    );
    points.push(Polar {
        radius_mm: tip_mm,
        angle_rad: 0.0,
    });
    points
}

/// Points on a circle about the axis from `from_rad` up to, not including, `to_rad`.
fn arc(radius_mm: f64, from_rad: f64, to_rad: f64, chord_error_mm: f64) -> Vec<Polar> {
    let steps = arc_steps(radius_mm, (to_rad - from_rad).abs(), chord_error_mm);
    (0..steps)
        .map(|i| Polar {
            radius_mm,
            angle_rad: from_rad + (to_rad - from_rad) * i as f64 / steps as f64,
        })
        .collect()
}

/// Chords needed for an arc: the sagitta of a chord over angle `a` is `r (1 - cos(a/2))`.
pub(crate) fn arc_steps(radius_mm: f64, angle_rad: f64, chord_error_mm: f64) -> usize {
    let widest_rad = 2.0 * (1.0 - (chord_error_mm / radius_mm).min(1.0)).acos();
    ((angle_rad / widest_rad).ceil() as usize).max(1)
}

/// Interior points of the root fillet, from the root circle towards the flank.
fn fillet(gear: &GearSpec, centre_from_tooth_rad: f64, chord_error_mm: f64) -> Vec<Polar> {
    let radius = gear.root_fillet_radius_mm;
    let centre_mm = match gear.kind {
        GearKind::Internal => gear.root_radius_mm - radius,
        GearKind::External => gear.root_radius_mm + radius,
    };
    // Local axes at the fillet centre: x away from the axis, y away from the tooth.
    let flank_mm = gear.flank_root_radius_mm();
    let flank_rad = gear.tooth_half_angle_rad(flank_mm) - centre_from_tooth_rad;
    let touch = [
        flank_mm * flank_rad.cos() - centre_mm,
        flank_mm * flank_rad.sin(),
    ];
    let start_rad: f64 = match gear.kind {
        GearKind::Internal => 0.0,
        GearKind::External => -std::f64::consts::PI,
    };
    let end_rad = touch[1].atan2(touch[0]);
    let steps = arc_steps(radius, (end_rad - start_rad).abs(), chord_error_mm);
    (1..steps)
        .map(|i| {
            let turn = start_rad + (end_rad - start_rad) * i as f64 / steps as f64;
            let local = [centre_mm + radius * turn.cos(), radius * turn.sin()];
            Polar {
                radius_mm: local[0].hypot(local[1]),
                angle_rad: centre_from_tooth_rad + local[1].atan2(local[0]),
            }
        })
        .collect()
}

/// Points on the involute from root to tip, both ends included.
fn involute_points(
    gear: &GearSpec,
    root_mm: f64,
    tip_mm: f64,
    chord_error_mm: f64,
) -> impl Iterator<Item = Polar> + use<'_> {
    let (from, to) = (gear.roll_angle_rad(root_mm), gear.roll_angle_rad(tip_mm));
    let base = gear.base_radius_mm();
    // Radius of curvature b t, arc length b t dt: the sagitta s^2/(8 rho) of one step is b t dt^2 / 8 at its largest t.
    let widest = (8.0 * chord_error_mm / (base * from.max(to))).sqrt();
    let steps = (((to - from).abs() / widest).ceil() as usize).max(1);
    (0..=steps).map(move |i| {
        let radius_mm = if i == 0 {
            root_mm
        } else if i == steps {
            tip_mm
        } else {
            base * (from + (to - from) * i as f64 / steps as f64).hypot(1.0)
        };
        Polar {
            radius_mm,
            angle_rad: gear.tooth_half_angle_rad(radius_mm),
        }
    })
}
