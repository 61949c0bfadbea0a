//! The article's way and ours to stitch the same views, in the same figures.

use std::time::Duration;

use flankscope_metrology::deviation::{Statistics, deviations, statistics};
use flankscope_metrology::multiview::adjustment::{Pose, Solution, Stages, ViewInformation};
use flankscope_metrology::multiview::cylinder::CylinderMap;
use flankscope_metrology::multiview::drift::{Drift, durbin_watson};
use flankscope_metrology::multiview::form::Form;
use flankscope_metrology::tool::Tool;
use flankscope_metrology::view::PlannedView;
use nalgebra::{Point3, Vector3};
use serde::Serialize;

use crate::method::{ArticleSettings, ArticleStitched};

/// One way to stitch, in figures.
#[derive(Clone, Debug, Serialize)]
pub struct MethodResult {
    /// `surface` or `article`.
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
    pub metric: String,
    /// Distances of one view's points by this metric.
    pub one_view: Option<Spread>,
    /// Distances of the merged points by this metric.
    pub merged: Option<Spread>,
    /// Root mean square distance of every view by this metric, µm, in order of capture; null for a lost one.
    pub rms_um: Vec<Option<f64>>,
    /// Steps of every view's registration, in order of capture; absent where all views are solved together.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub iterations: Option<Vec<Option<usize>>>,
    /// What the article's method was told; absent for ours.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub settings: Option<ArticleSettings>,
    /// Whether that, or where the views lie, drifts.
    pub drift: ScanDrift,
    /// From the views of the session to the map, ms.
    pub stitching_ms: f64,
}

/// Mean, standard deviation and root mean square, µm.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Spread {
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

/// Whether anything drifts from view to view (Durbin and Watson): how well they lie on the CAD, and where they lie.
#[derive(Clone, Debug, Serialize)]
pub struct ScanDrift {
    /// With the angle, layer by layer from the bottom.
    pub layers: Vec<LayerDrift>,
    /// From layer to layer: of the layers' mean root mean squares.
    pub across_layers: Option<Trend>,
    /// The largest drift of where the views lie; absent when none drifts.
    pub largest: Option<Creep>,
}

#[derive(Clone, Copy, Debug, Serialize)]
pub struct LayerDrift {
    /// Its height on the vertical stage, mm.
    pub vertical_mm: f64,
    /// Mean root mean square of its views, µm.
    pub mean_rms_um: f64,
    /// Of the root mean squares; absent for too few views.
    pub rms: Option<Trend>,
    /// Of the views' places against what all views share: outwards, around, up.
    pub place: [Option<Trend>; 3],
}

/// The statistic of a series.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Trend {
    /// Durbin-Watson statistic: 2 without a trend, less with one.
    pub durbin_watson: f64,
    /// Standard deviations below 2.
    pub sigmas: f64,
    /// Standard deviation of the part that neighbours share, µm.
    pub trend_um: f64,
    /// Whether it is one: more than 3 standard deviations, and more than a view's pose is trusted to.
    pub drifts: bool,
}

/// Where views lie drifts.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Creep {
    pub direction: &'static str,
    /// Layer, mm on the vertical stage.
    pub vertical_mm: f64,
    /// Standard deviation of the drift, µm.
    pub trend_um: f64,
}

/// Trends below this are none, µm: the map does not trust a view's pose to less.
const LEAST_TREND_UM: f64 = 1.0;

impl From<Drift> for Trend {
    fn from(of: Drift) -> Self {
        Self {
            durbin_watson: of.durbin_watson,
            sigmas: of.sigmas,
            trend_um: of.trend,
            drifts: of.drifts(LEAST_TREND_UM),
        }
    }
}

/// A view on the CAD, µm.
#[derive(Clone, Copy)]
struct ViewFigures {
    rms_um: f64,
    /// Its place against what all views share: outwards, around, up.
    place_um: [f64; 3],
}

impl ViewFigures {
    /// Of a view whose centre lies `off_mm` from where what all views share puts it.
    fn new(rms_mm: f64, centre_mm: Point3<f64>, off_mm: Vector3<f64>) -> Self {
        let (sin, cos) = centre_mm.y.atan2(centre_mm.x).sin_cos();
        let [x, y, z] = (off_mm * 1e3).into();
        Self {
            rms_um: rms_mm * 1e3,
            place_um: [x * cos + y * sin, y * cos - x * sin, z],
        }
    }
}

impl ScanDrift {
    /// Of the views in order of capture, which goes layer by layer; lost ones are missing.
    fn of(planned: &[PlannedView], figures: &[Option<ViewFigures>]) -> Self {
        let trend = |series: Vec<f64>| durbin_watson(&series).map(Trend::from);
        let views: Vec<(f64, Option<ViewFigures>)> = planned
            .iter()
            .zip(figures)
            .map(|(view, found)| (view.vertical_mm, *found))
            .collect();
        let layers: Vec<LayerDrift> = views
            .chunk_by(|a, b| a.0 == b.0)
            .filter_map(|layer| {
                let vertical_mm = layer.first()?.0;
                let found: Vec<ViewFigures> = layer.iter().filter_map(|view| view.1).collect();
                let rms_um: Vec<f64> = found.iter().map(|view| view.rms_um).collect();
                let place = |axis: usize| found.iter().map(|view| view.place_um[axis]).collect();
                (!found.is_empty()).then(|| LayerDrift {
                    vertical_mm,
                    mean_rms_um: rms_um.iter().sum::<f64>() / rms_um.len() as f64,
                    rms: trend(rms_um),
                    place: [0, 1, 2].map(|axis| trend(place(axis))),
                })
            })
            .collect();
        let creeps = layers.iter().flat_map(|layer| {
            let named = layer.place.iter().zip(["outwards", "around", "up"]);
            named.filter_map(|(trend, direction)| {
                let trend = trend.filter(|trend| trend.drifts)?;
                Some(Creep {
                    direction,
                    vertical_mm: layer.vertical_mm,
                    trend_um: trend.trend_um,
                })
            })
        });
        Self {
            across_layers: trend(layers.iter().map(|layer| layer.mean_rms_um).collect()),
            largest: creeps.max_by(|a, b| a.trend_um.total_cmp(&b.trend_um)),
            layers,
        }
    }
}

/// What the joint solve found.
#[derive(Clone, Copy)]
pub struct JointSolve<'a> {
    /// Views that took part, and what each says of its pose.
    pub views: &'a [(usize, ViewInformation)],
    /// Their poses, and what all of them share.
    pub adjustment: &'a Solution,
    /// Root mean square distance of each of these views about the form of the whole bore, mm; absent where it is not known.
    pub rms_about_form_mm: &'a [Option<f64>],
    pub map: &'a CylinderMap,
}

impl MethodResult {
    /// Ours in figures. `sample` are points of the first view that took part, in its camera's frame, mm.
    #[must_use]
    pub fn of_surface(
        joint: JointSolve<'_>,
        sample: &[[f64; 3]],
        tool: &Tool,
        planned: &[PlannedView],
        took: Duration,
    ) -> Self {
        let mut figures = vec![None; planned.len()];
        let pose_residuals = joint.adjustment.pose_residuals.iter();
        let pose_residuals = pose_residuals.zip(joint.rms_about_form_mm);
        for ((view, info), (residual, rms_mm)) in joint.views.iter().zip(pose_residuals) {
            let off_mm = residual.fixed_rows::<3>(3).into_owned();
            let rms_mm = rms_mm.unwrap_or(info.rms_mm);
            figures[*view] = Some(ViewFigures::new(rms_mm, info.centre_mm.into(), off_mm));
        }
        let one_view = joint.adjustment.poses.first().and_then(|pose| {
            let laid: Vec<[f64; 3]> = sample.iter().map(|&p| pose.apply(p)).collect();
            statistics(&deviations(&tool.surface, &laid)).map(Spread::from)
        });
        let exact = exact(joint.map);
        Self {
            method: "surface",
            start: "priors of stages and hand-eye, tooth phase searched",
            registered_views: joint.views.len(),
            form: joint.map.form().map(|form| match &tool.gear {
                Some(gear) => {
                    let [low, high] = gear.height_mm;
                    Form::with_sigma(form, joint.adjustment.form_sigma_mm(high - low))
                }
                None => form.into(),
            }),
            exact,
            metric:
                "signed distance to the surface, of every view about the form of the whole bore"
                    .into(),
            one_view,
            merged: exact,
            iterations: None,
            settings: None,
            drift: ScanDrift::of(planned, &figures),
            rms_um: rms_um(&figures),
            stitching_ms: took.as_secs_f64() * 1e3,
        }
    }

    /// The article's in figures; `shared` is what our adjustment found of die, head and stages.
    #[must_use]
    pub fn of_article(
        stitched: &ArticleStitched,
        shared: &Stages,
        settings: &ArticleSettings,
        planned: &[PlannedView],
        took: Duration,
    ) -> Self {
        let mut figures = vec![None; planned.len()];
        let mut iterations = vec![None; planned.len()];
        for laid in &stitched.views {
            iterations[laid.view] = Some(laid.iterations);
            let at = Pose::from(&planned[laid.view]);
            let p_camera = laid
                .tool_from_camera
                .inverse_transform_point(&laid.centre_mm);
            let off_mm = laid.centre_mm - shared.tool_from_camera(at).isometry() * p_camera;
            figures[laid.view] = Some(ViewFigures::new(laid.rms_mm, laid.centre_mm, off_mm));
        }
        Self {
            method: "article",
            start: match settings.first_pose {
                Some(_) => "picked pairs",
                None => "priors of stages and hand-eye, tooth phase searched; no pairs were picked",
            },
            registered_views: stitched.views.len(),
            form: stitched.map.form().map(Form::from),
            exact: exact(&stitched.map),
            metric: format!(
                "distance to the nearest of random CAD points, order {}",
                settings.order
            ),
            one_view: stitched.one_view.map(Spread::from),
            merged: stitched.merged.map(Spread::from),
            iterations: Some(iterations),
            settings: Some(settings.clone()),
            drift: ScanDrift::of(planned, &figures),
            rms_um: rms_um(&figures),
            stitching_ms: took.as_secs_f64() * 1e3,
        }
    }
}

fn rms_um(figures: &[Option<ViewFigures>]) -> Vec<Option<f64>> {
    let rms = |view: &Option<ViewFigures>| view.map(|view| view.rms_um);
    figures.iter().map(rms).collect()
}

fn exact(map: &CylinderMap) -> Option<Spread> {
    let deviations: Vec<f64> = map.cells().map(|cell| cell.deviation_mm).collect();
    statistics(&deviations).map(Spread::from)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn planned(around: u32, layers: u32) -> Vec<PlannedView> {
        (0..layers)
            .flat_map(|layer| (0..around).map(move |step| (layer, step)))
            .map(|(layer, step)| PlannedView {
                tooth: 1,
                rotation_rad: std::f64::consts::TAU * f64::from(step) / f64::from(around),
                vertical_mm: 10.0 * f64::from(layer),
            })
            .collect()
    }

    /// What neighbours do not share.
    fn jitter(index: usize) -> f64 {
        if index.is_multiple_of(2) { 0.4 } else { -0.4 }
    }

    #[test]
    fn a_slow_wave_of_the_places_is_a_drift_and_jitter_and_lost_views_are_none() {
        let planned = planned(28, 2);
        let figures: Vec<Option<ViewFigures>> = planned
            .iter()
            .enumerate()
            .map(|(index, at)| {
                // The second layer's views rise and fall by 12 µm around the turn.
                let wave_um = if at.vertical_mm > 5.0 {
                    12.0 * at.rotation_rad.sin()
                } else {
                    0.0
                };
                (index != 3).then(|| ViewFigures {
                    rms_um: 3.0 + jitter(index),
                    place_um: [jitter(index), jitter(index), wave_um + jitter(index)],
                })
            })
            .collect();
        let drift = ScanDrift::of(&planned, &figures);
        let [first, second] = &drift.layers[..] else {
            panic!("{} layers", drift.layers.len())
        };
        for trend in first
            .place
            .iter()
            .chain([&first.rms, &second.rms, &second.place[0]])
        {
            assert!(!trend.unwrap().drifts, "{trend:?}");
        }
        let creep = drift.largest.unwrap();
        assert_eq!((creep.direction, creep.vertical_mm), ("up", 10.0));
        assert!(
            (creep.trend_um - 12.0 / 2f64.sqrt()).abs() < 0.5,
            "{creep:?}"
        );
        assert!(drift.across_layers.is_none(), "two layers are too few");
        let rms = rms_um(&figures);
        assert_eq!((rms[3], rms.iter().flatten().count()), (None, 55));
    }

    #[test]
    fn a_view_that_lies_off_is_off_outwards_around_and_up() {
        // A view on +y: outwards is +y, around (counter-clockwise) is -x.
        let off = ViewFigures::new(
            1e-3,
            Point3::new(0.0, 41.0, 20.0),
            Vector3::new(-2e-3, 3e-3, 5e-3),
        );
        for (got, expected) in off.place_um.into_iter().zip([3.0, 2.0, 5.0]) {
            assert!((got - expected).abs() < 1e-9, "{:?}", off.place_um);
        }
    }
}
