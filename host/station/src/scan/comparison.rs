//! Two ways to stitch the same views, in the same figures.

use std::time::Duration;

use flankscope_metrology::cylinder::CylinderMap;
use flankscope_metrology::deviation::{Order, Statistics, deviations, statistics};
use flankscope_metrology::drift::{Drift, durbin_watson};
use flankscope_metrology::tool::Tool;
use nalgebra::Point3;
use serde::Serialize;

use super::job::ScanError;
use super::paper::{PaperSettings, PaperStitched};
use super::result::Form;
use super::session::Session;
use super::stitch::Stitched;
use super::view::{SAMPLE, coordinates};
use crate::inspection::PlannedView;

/// Which way the result is made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Method {
    /// All views on the surface, in one joint solve.
    #[default]
    Surface,
    /// The article's; ours beside it.
    Paper,
    /// Ours; the article's beside it.
    Both,
}

/// One way to stitch, in figures.
#[derive(Clone, Debug, Serialize)]
pub struct MethodResult {
    /// `surface` or `paper`.
    pub method: &'static str,
    /// What the first pose rests on.
    pub start: &'static str,
    /// Views that were laid on the CAD.
    pub registered_views: usize,
    /// Form of the bore as the laid points show it, by their exact distances.
    pub form: Option<Form>,
    /// Exact deviations of the map's cells.
    pub exact: Option<Spread>,
    /// How this method measures distances.
    pub metric: &'static str,
    /// Distances of one view's points by this metric.
    pub one_view: Option<Spread>,
    /// Distances of the merged points by this metric.
    pub merged: Option<Spread>,
    /// Root mean square distance of every view by this metric, µm, in order of capture; null for a lost one.
    pub rms_um: Vec<Option<f64>>,
    /// Whether that drifts.
    pub drift: ScanDrift,
    /// From the views of the session to the map, ms.
    pub stitching_ms: f64,
}

/// Mean, standard deviation and root mean square, µm.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Spread {
    /// Mean.
    pub mean_um: f64,
    /// Standard deviation.
    pub std_um: f64,
    /// Root mean square.
    pub rms_um: f64,
}

impl From<Statistics> for Spread {
    fn from(of: Statistics) -> Self {
        Self {
            mean_um: of.mean_mm * 1e3,
            std_um: of.std_mm * 1e3,
            rms_um: of.rms_mm * 1e3,
        }
    }
}

/// Whether the views' root mean square distances drift (Durbin and Watson).
#[derive(Clone, Debug, Serialize)]
pub struct ScanDrift {
    /// Whether any of it does.
    pub drifts: bool,
    /// With the angle, layer by layer from the bottom.
    pub layers: Vec<LayerDrift>,
    /// From layer to layer: of the layers' means.
    pub across_layers: Option<Trend>,
}

/// One layer.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct LayerDrift {
    /// Its height on the vertical stage, mm.
    pub vertical_mm: f64,
    /// Mean over its views, µm.
    pub mean_rms_um: f64,
    /// With the angle; absent for too few views.
    pub with_angle: Option<Trend>,
}

/// The statistic of a series.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Trend {
    /// Durbin-Watson statistic: 2 without a trend, less with one.
    pub durbin_watson: f64,
    /// Standard deviations below 2; more than 3 is a drift.
    pub sigmas: f64,
    /// Whether it is one.
    pub drifts: bool,
}

impl From<Drift> for Trend {
    fn from(of: Drift) -> Self {
        Self {
            durbin_watson: of.durbin_watson,
            sigmas: of.sigmas,
            drifts: of.drifts(),
        }
    }
}

impl ScanDrift {
    /// Of the views' figures in order of capture, which goes layer by layer.
    fn of(planned: &[PlannedView], rms_um: &[Option<f64>]) -> Self {
        let views: Vec<(f64, Option<f64>)> = planned
            .iter()
            .zip(rms_um)
            .map(|(view, rms)| (view.vertical_mm, *rms))
            .collect();
        let layers: Vec<LayerDrift> = views
            .chunk_by(|a, b| a.0 == b.0)
            .filter_map(|layer| {
                let vertical_mm = layer.first()?.0;
                let series: Vec<f64> = layer.iter().filter_map(|(_, rms)| *rms).collect();
                (!series.is_empty()).then(|| LayerDrift {
                    vertical_mm,
                    mean_rms_um: series.iter().sum::<f64>() / series.len() as f64,
                    with_angle: durbin_watson(&series).map(Trend::from),
                })
            })
            .collect();
        let means: Vec<f64> = layers.iter().map(|layer| layer.mean_rms_um).collect();
        let across_layers = durbin_watson(&means).map(Trend::from);
        let trends = layers.iter().map(|layer| layer.with_angle);
        let drifts = trends.chain([across_layers]).flatten().any(|t| t.drifts);
        Self {
            drifts,
            layers,
            across_layers,
        }
    }
}

/// Ours in figures.
pub(super) fn of_surface(
    stitched: &Stitched,
    session: &Session,
    tool: &Tool,
    planned: &[PlannedView],
    took: Duration,
) -> Result<MethodResult, ScanError> {
    let mut rms_um = vec![None; planned.len()];
    for (view, info) in &stitched.views {
        rms_um[*view] = Some(info.rms_mm * 1e3);
    }
    let mut one_view = None;
    if let (Some((view, _)), Some(pose)) = (stitched.views.first(), stitched.joint.poses.first()) {
        let laid: Vec<[f64; 3]> = coordinates(&session.points(*view)?, SAMPLE)
            .into_iter()
            .map(|p| (pose * Point3::from(p)).into())
            .collect();
        one_view = statistics(&deviations(&tool.surface, &laid)).map(Spread::from);
    }
    let exact = exact(&stitched.map);
    Ok(MethodResult {
        method: "surface",
        start: "priors of stages and hand-eye, tooth phase searched",
        registered_views: stitched.views.len(),
        form: stitched.map.form().map(Form::from),
        exact,
        metric: "signed distance to the surface",
        one_view,
        merged: exact,
        drift: ScanDrift::of(planned, &rms_um),
        rms_um,
        stitching_ms: took.as_secs_f64() * 1e3,
    })
}

/// The article's in figures.
pub(super) fn of_paper(
    stitched: &PaperStitched,
    settings: &PaperSettings,
    planned: &[PlannedView],
    took: Duration,
) -> MethodResult {
    let mut rms_um = vec![None; planned.len()];
    for (view, rms_mm) in &stitched.views {
        rms_um[*view] = Some(rms_mm * 1e3);
    }
    MethodResult {
        method: "paper",
        start: match settings.first_pose {
            Some(_) => "picked pairs",
            None => "priors of stages and hand-eye, tooth phase searched; no pairs were picked",
        },
        registered_views: stitched.views.len(),
        form: stitched.map.form().map(Form::from),
        exact: exact(&stitched.map),
        metric: match settings.order {
            Order::One => "distance to the nearest of random CAD points, order 1",
            Order::Two => "distance to the nearest of random CAD points, order 2",
            Order::Infinity => "distance to the nearest of random CAD points, order infinity",
        },
        one_view: stitched.one_view.map(Spread::from),
        merged: stitched.merged.map(Spread::from),
        drift: ScanDrift::of(planned, &rms_um),
        rms_um,
        stitching_ms: took.as_secs_f64() * 1e3,
    }
}

fn exact(map: &CylinderMap) -> Option<Spread> {
    let deviations: Vec<f64> = map.cells().map(|cell| cell.deviation_mm).collect();
    statistics(&deviations).map(Spread::from)
}
