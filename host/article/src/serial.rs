//! One view after the other, each on the one before it, without a CAD (figure 4b): errors add up around the bore.

use std::collections::BTreeMap;

use flankscope_foundation::order::quantile;
use flankscope_foundation::rigid::{Cloud, Rigid, Tool as ToolFrame};
use flankscope_metrology::deviation::Order;
use flankscope_metrology::multiview::adjustment::Stages;
use flankscope_metrology::registration::{ArticleOptions, ArticleReference, register_to_reference};
use flankscope_metrology::view::PlannedView;
use nalgebra::{Isometry3, Point3};
use serde::Serialize;

use crate::drawn::{Drawn, laid};

/// A point and one of the view before are of the same place when they lie so near to each other where the stages put them, mm.
const SAME_PLACE_MM: f64 = 0.3;
/// Views with a smaller share of points in common are not laid on each other.
const LEAST_COMMON: f64 = 1.0 / 3.0;
/// Pairs that count, of those points: the rim may be of the other view's rim.
const TRUSTED: f64 = 0.9;

/// A layer of views, each laid on the one before.
#[derive(Clone, Debug, Serialize)]
pub struct SerialLayer {
    /// Its height on the vertical stage, mm.
    pub vertical_mm: f64,
    /// Its views, in the order in which they were laid.
    pub views: Vec<usize>,
    /// Share of the points that each has in common with the one before, in the middle of the layer's steps.
    pub common_ratio: f64,
    /// How far each lies from where the joint solve puts it when the first ones coincide: outwards, around, up, µm.
    pub off_um: Vec<[f64; 3]>,
    /// The first view laid on the last: how far from where it was, µm; absent for a layer with a gap.
    pub closing_um: Option<[f64; 3]>,
}

/// All layers.
#[derive(Default)]
pub(crate) struct Serial {
    pub poses: BTreeMap<usize, Isometry3<f64>>,
    pub layers: Vec<SerialLayer>,
}

/// Lays the views of every layer from its first one on, whose pose is the joint solve's: an ideal start. Of the pairs counts
/// `inlier_ratio`, or what either view has in common with the one before. The error says why views cannot be laid on each other.
pub(crate) fn serial(
    views: &BTreeMap<usize, Drawn>,
    joint: &BTreeMap<usize, Isometry3<f64>>,
    planned: &[PlannedView],
    options: &ArticleOptions,
    inlier_ratio: Option<f64>,
) -> Result<Serial, String> {
    let mut found = Serial {
        poses: BTreeMap::new(),
        layers: Vec::new(),
    };
    let stages = Stages::nominal(Rigid::from_isometry(Isometry3::identity()));
    let moved = |view: usize| *stages.tool_from_camera((&planned[view]).into()).isometry();
    let numbers: Vec<usize> = (0..planned.len()).collect();
    for layer in numbers.chunk_by(|&a, &b| planned[a].vertical_mm == planned[b].vertical_mm) {
        let known: Vec<usize> = layer
            .iter()
            .copied()
            .filter(|view| views.contains_key(view) && joint.contains_key(view))
            .collect();
        let Some((&first, rest)) = known.split_first() else {
            continue;
        };
        let mut common = Vec::new();
        // From where `before` lies to `view`, by what the stages were told, and then by what both show.
        let mut step = |pose: &Isometry3<f64>, before: usize, view: usize| {
            let start = moved(view) * moved(before).inverse() * pose;
            let Some(reference) = ArticleReference::of_points(laid(&views[&before].xyz, pose))
            else {
                return Ok(start);
            };
            let distances = reference.distances(&laid(&views[&view].xyz, &start), Order::Two);
            let same = distances.iter().filter(|&&mm| mm < SAME_PLACE_MM).count();
            let ratio = same as f64 / distances.len() as f64;
            if ratio < LEAST_COMMON {
                return Err(format!(
                    "views {before} and {view} have {:.0} % of their points in common, a third is needed; a scan with more views around has it",
                    100.0 * ratio
                ));
            }
            common.push(ratio);
            let options = ArticleOptions {
                inlier_ratio: inlier_ratio.unwrap_or(options.inlier_ratio.min(TRUSTED * ratio)),
                ..*options
            };
            let start = Rigid::<ToolFrame, Cloud>::from_isometry(start);
            let fit = register_to_reference(&reference, &views[&view].xyz, &start, &options);
            Ok(*fit.tool_from_cloud.isometry())
        };
        let mut pose = joint[&first];
        let mut poses = vec![(first, pose)];
        let mut before = first;
        for &view in rest {
            pose = step(&pose, before, view)?;
            poses.push((view, pose));
            before = view;
        }
        let whole = known.len() == layer.len() && known.len() > 2;
        let closed = if whole {
            Some(step(&pose, before, first)?)
        } else {
            None
        };
        let closing_um = closed.map(|pose| off_um(&views[&first], &pose, &joint[&first]));
        found.layers.push(SerialLayer {
            vertical_mm: planned[first].vertical_mm,
            views: known,
            off_um: poses
                .iter()
                .map(|(view, pose)| off_um(&views[view], pose, &joint[view]))
                .collect(),
            closing_um,
            common_ratio: quantile(&mut common, 0.5).unwrap_or(0.0),
        });
        found.poses.extend(poses);
    }
    Ok(found)
}

/// How far the middle of a view lies at one pose from where it lies at another: outwards, around, up, µm.
fn off_um(view: &Drawn, at: &Isometry3<f64>, from: &Isometry3<f64>) -> [f64; 3] {
    let centre = Point3::from(view.centre_mm);
    let was = from * centre;
    let off = at * centre - was;
    let (sin, cos) = was.y.atan2(was.x).sin_cos();
    [
        1e3 * (off.x * cos + off.y * sin),
        1e3 * (off.y * cos - off.x * sin),
        1e3 * off.z,
    ]
}
