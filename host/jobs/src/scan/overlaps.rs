//! Overlapping views: pairs, their relative poses, and the steps between them.

use std::collections::BTreeMap;
use std::f64::consts::{PI, TAU};

use flankscope_metrology::multiview::adjustment::{
    CameraPose, Overlap, Solution, ViewInformation, take_off_common,
};
use flankscope_metrology::multiview::cylinder::{CellObservation, Layout};
use flankscope_record::document::scan::{Step, Steps};
use nalgebra::{Point3, Vector6};
use rayon::prelude::*;

use super::patches::Patches;
use super::session::SessionError;

/// Views whose centres are farther apart than this many fields of view do not overlap: one field, and its rim.
const APART_PER_FIELD: f64 = 1.05;

/// Views closer together around the bore than this are above each other, rad.
const LEVEL_RAD: f64 = 1e-4;

/// A view's number and its information.
type Laid = (usize, ViewInformation);

/// Information of overlapping neighbours on their relative poses, beyond what all pairs of a kind have in common with the poses
/// `alone` (by number of the view), which follow from the CAD alone.
pub(super) fn overlaps(
    patches: &Patches,
    layout: &Layout,
    views: &[Laid],
    alone: &BTreeMap<usize, CameraPose>,
    field_mm: f64,
) -> Result<Vec<Overlap>, SessionError> {
    let apart_mm = APART_PER_FIELD * field_mm;
    let there = |at: usize| -> Result<Vec<CellObservation>, SessionError> {
        let (view, info) = &views[at];
        patches.moved_to(*view, &info.tool_from_camera, layout)
    };
    let centre = |at: usize| Point3::from(views[at].1.centre_mm);
    let of_view = |first: usize| -> Result<Vec<Overlap>, SessionError> {
        let near = |&second: &usize| (centre(first) - centre(second)).norm() < apart_mm;
        let neighbours: Vec<usize> = (first + 1..views.len()).filter(near).collect();
        if neighbours.is_empty() {
            return Ok(Vec::new());
        }
        let here = there(first)?;
        let mut found = Vec::new();
        for second in neighbours {
            let other = there(second)?;
            let (mut pair, mut seen) = ([first, second], [&here, &other]);
            if follows(&views[first].1, &views[second].1) {
                pair.reverse();
                seen.reverse();
            }
            let centres = pair.map(|at| views[at].1.centre_mm);
            found.extend(Overlap::between(pair, seen.map(Vec::as_slice), centres));
        }
        Ok(found)
    };
    let found: Result<Vec<_>, SessionError> =
        (0..views.len()).into_par_iter().map(of_view).collect();
    let mut found = found?.concat();
    let of_views: Vec<ViewInformation> = views.iter().map(|(_, info)| info.clone()).collect();
    let poses = views.iter().map(|(view, info)| {
        let alone = alone.get(view);
        *alone.unwrap_or(&info.tool_from_camera)
    });
    take_off_common(&mut found, &of_views, &poses.collect::<Vec<_>>());
    Ok(found)
}

/// Whether a view follows another one: further around, or above it.
fn follows(view: &ViewInformation, other: &ViewInformation) -> bool {
    let turn_rad = (view.at.rotation_rad - other.at.rotation_rad).rem_euclid(TAU);
    let level = turn_rad.min(TAU - turn_rad) < LEVEL_RAD;
    if level {
        view.at.vertical_mm > other.at.vertical_mm
    } else {
        turn_rad < PI
    }
}

/// Steps from overlaps between `views`, with the poses of each view (by its number) before and after the overlaps were used.
pub(super) fn steps(
    overlaps: &[Overlap],
    views: &[Laid],
    before: &BTreeMap<usize, CameraPose>,
    adjustment: &Solution,
) -> Steps {
    let after: Vec<Vector6<f64>> = (views.iter().enumerate())
        .map(|(at, (_, info))| info.motion_to(&adjustment.poses[at]))
        .collect();
    let before: Vec<Vector6<f64>> = (views.iter().zip(&after))
        .map(|((view, info), after)| before.get(view).map_or(*after, |p| info.motion_to(p)))
        .collect();
    let layer = |at: usize| views[at].1.at.vertical_mm;
    let of_kind = |same_layer: bool| {
        let kind = |of: &&Overlap| (layer(of.views[0]) == layer(of.views[1])) == same_layer;
        let of: Vec<&Overlap> = overlaps.iter().filter(kind).collect();
        let rms_um = |motions: &[Vector6<f64>]| {
            let squares = of.iter().map(|of| {
                let step_mm = of.step_mm(of.views.map(|at| &motions[at]));
                step_mm * step_mm
            });
            1e3 * (squares.sum::<f64>() / of.len() as f64).sqrt()
        };
        (!of.is_empty()).then(|| Step {
            pairs: of.len(),
            before_um: rms_um(&before),
            after_um: rms_um(&after),
        })
    };
    Steps {
        around: of_kind(true),
        up: of_kind(false),
    }
}
