//! Camera, projector and all poses from all points, without any guess; and once more without each pose.

use nalgebra::{DMatrix, Isometry3, Matrix3, Point3};
use rayon::prelude::*;

use super::left_out::{LeftOut, hold_out};
use super::model::{BoardModel, COORDINATES, Free, PROJECTOR, observations};
use super::uncertainty::{Parameter, parameters, scatter_of_points_mm};
use super::{BoardError, BoardMark, BoardView, Geometry, closed_form};
use crate::calibrate::bundle::{
    Bundle, FIRST_SIGMA_PX, MAX_STEPS, Observation, Reweighting, beyond, mean_squares_px2, settle,
};
use crate::calibrate::least_squares::{NoMinimum, SETTLED, minimise};
use crate::calibrate::rig::{ImagePoint, Rig, transform};
use crate::head::{HeadModel, HoldOut, Pinhole};
use flankscope_foundation::order::median_of;

/// Without one of them three must remain: fewer leave no redundancy.
pub const LEAST_POSES: usize = 4;
/// Four times at a complete minimum.
const REWEIGHTING: Reweighting = Reweighting {
    rounds: 4,
    unfinished: SETTLED,
    same: 0.0,
};
/// Factor by which all others scatter less without a pose that was not at rest, or is not of this board or head.
const SPOILS: f64 = 1.5;
/// Residuals beyond these, camera and projector, are no calibration.
const LIMIT_PX: [f64; 2] = [1.0, 3.0];
/// Largest standard uncertainties of what poses must determine: focal lengths (of themselves), principal points (of the image).
const FOCAL_LIMIT: f64 = 0.02;
const PRINCIPAL_LIMIT: f64 = 0.03;

/// Residuals of one pose.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct PoseReport {
    /// Its folder.
    pub name: String,
    /// Points of the board found.
    pub points: usize,
    /// Points that took no part because they do not fit the others.
    pub dropped: usize,
    /// Whether it took part in the adjustment; it does not if it does not fit the others.
    pub used: bool,
    /// Residuals in the camera's image: root mean square per axis, and of the distances.
    pub camera_rms_px: [f64; 2],
    /// The same in the projector's.
    pub projector_rms_px: [f64; 2],
    /// Measured by the head that the other poses give.
    pub left_out: Option<LeftOut>,
}

/// A head by an ordinary board.
#[derive(Clone, Debug)]
pub struct BoardAdjusted {
    /// The head: camera, projector and their places.
    pub head: HeadModel,
    /// Pose by pose, as they were given.
    pub poses: Vec<PoseReport>,
    /// Points that took part.
    pub points: usize,
    /// Points left out in poses that took part.
    pub dropped: usize,
    /// Residuals in the camera's image: root mean square per axis, and of the distances.
    pub camera_rms_px: [f64; 2],
    /// The same in the projector's.
    pub projector_rms_px: [f64; 2],
    /// The unknowns.
    pub parameters: Vec<Parameter>,
    /// Their covariance, row by row in that order.
    pub covariance: Vec<Vec<f64>>,
    /// Nearest and farthest point of the boards along the camera's axis.
    pub depth_mm: [f64; 2],
    /// Standard uncertainty of a point along the camera's axis and across it after a rigid motion, by leaving out one pose after the
    /// other; that of the board's pitch is counted where it is known.
    pub sigma_mm: [f64; 2],
    /// All poses together, each measured by the others' head.
    pub hold_out: Option<HoldOut>,
}

/// An adjustment to some of the poses.
pub(super) struct Solved {
    pub rig: Rig,
    pub poses: Vec<Isometry3<f64>>,
    pub kept: Vec<Vec<Observation>>,
    sigma_px: [f64; 2],
    pub covariance: DMatrix<f64>,
}

/// Adjusts a head to the poses of a board. Sizes are those of camera and projector.
///
/// # Errors
/// [`BoardError`]: too few poses, poses that do not determine an unknown, residuals beyond noise.
pub fn adjust(
    views: &[BoardView],
    geometry: Geometry,
    name: &str,
    [camera_px, projector_px]: [[u32; 2]; 2],
) -> Result<BoardAdjusted, BoardError> {
    let mut used: Vec<usize> = (0..views.len()).collect();
    let (all, without) = loop {
        if used.len() < LEAST_POSES {
            return Err(BoardError::FewPoses {
                got: used.len(),
                of: views.len(),
                limit: LEAST_POSES,
            });
        }
        let marks = |poses: &[usize]| {
            poses
                .iter()
                .map(|&pose| views[pose].marks.clone())
                .collect()
        };
        let all = solve(marks(&used), geometry, [camera_px, projector_px])?;
        let without: Vec<Option<Solved>> = (0..used.len())
            .into_par_iter()
            .map(|out| {
                let mut others = used.clone();
                others.remove(out);
                solve(marks(&others), geometry, [camera_px, projector_px]).ok()
            })
            .collect();
        let spoils = |solved: &Option<Solved>| {
            let sigma_px = solved.as_ref()?.sigma_px;
            let ratios = [0, 1].map(|image| all.sigma_px[image] / sigma_px[image]);
            Some(ratios[0].max(ratios[1]))
        };
        let ratios = without
            .iter()
            .enumerate()
            .filter_map(|(at, solved)| Some((at, spoils(solved)?)));
        match ratios.max_by(|a, b| a.1.total_cmp(&b.1)) {
            Some((at, ratio)) if ratio > SPOILS => drop(used.remove(at)),
            _ => break (all, without),
        }
    };
    let without = without.into_iter().zip(&used).map(|(solved, &pose)| {
        let hinges = || BoardError::Hinges {
            pose: views[pose].name.clone(),
        };
        solved.ok_or_else(hinges)
    });
    let without: Vec<Solved> = without.collect::<Result<_, _>>()?;
    conclude(views, geometry, name, &used, &all, &without)
}

/// From the closed form to the minimum.
fn solve(
    marks: Vec<Vec<BoardMark>>,
    geometry: Geometry,
    [camera_px, projector_px]: [[u32; 2]; 2],
) -> Result<Solved, BoardError> {
    // The projector sees the board as a camera does.
    let mirrored: Vec<Vec<BoardMark>> = marks
        .iter()
        .map(|marks| marks.iter().map(BoardMark::by_projector).collect())
        .collect();
    let (camera, poses) = lens(&marks, geometry, camera_px, "camera")?;
    let (projector, projector_poses) = lens(&mirrored, geometry, projector_px, "projector")?;
    // Each pose gives a pose of the projector: the one that explains all others best is the start.
    let candidates = poses
        .iter()
        .zip(&projector_poses)
        .map(|(camera, projector)| projector * camera.inverse());
    let rigs = candidates.map(|projector_from_camera| Rig {
        camera: camera.clone(),
        projector: projector.clone(),
        projector_from_camera,
    });
    let mut kept = observations(&marks, geometry);
    let model = |rig: Rig| BoardModel {
        free: Free::All,
        rig,
        poses: poses.clone(),
    };
    let off = |rig: &Rig| {
        let bundle = Bundle {
            model: model(rig.clone()),
            kept: &kept,
            sigma_px: FIRST_SIGMA_PX,
        };
        median_of(bundle.all_residuals().map(|off| off[2].hypot(off[3]))).unwrap_or(f64::INFINITY)
    };
    let rig = rigs
        .map(|rig| (off(&rig), rig))
        .min_by(|a, b| a.0.total_cmp(&b.0));
    let (_, rig) = rig.ok_or(BoardError::NoStart { what: "projector" })?;
    let settled =
        settle(model(rig), FIRST_SIGMA_PX, &mut kept, REWEIGHTING).map_err(|why| match why {
            NoMinimum::Singular => BoardError::Singular,
            NoMinimum::NotSettled(limit) => BoardError::NotSettled { limit },
        })?;
    Ok(Solved {
        rig: settled.model.rig,
        poses: settled.model.poses,
        covariance: settled.covariance,
        sigma_px: settled.sigma_px,
        kept,
    })
}

/// A lens from its own image of the board alone, with the board's poses before it.
fn lens(
    marks: &[Vec<BoardMark>],
    geometry: Geometry,
    size_px: [u32; 2],
    what: &'static str,
) -> Result<(Pinhole, Vec<Isometry3<f64>>), BoardError> {
    let no_start = || BoardError::NoStart { what };
    let homographies: Option<Vec<Matrix3<f64>>> = marks
        .iter()
        .map(|marks| {
            let pairs: Vec<_> = marks
                .iter()
                .map(|mark| (mark.at_mm(geometry.pitch_mm), mark.pixel))
                .collect();
            closed_form::homography(&pairs)
        })
        .collect();
    let homographies = homographies.ok_or_else(no_start)?;
    let kept = observations(marks, geometry);
    let minima = closed_form::lenses(&homographies, size_px)
        .into_iter()
        .filter_map(|lens| {
            let poses: Option<Vec<_>> = homographies
                .iter()
                .map(|h| closed_form::pose(h, &lens))
                .collect();
            let rig = Rig {
                camera: lens.clone(),
                projector: lens,
                projector_from_camera: Isometry3::identity(),
            };
            let bundle = Bundle {
                model: BoardModel {
                    free: Free::Camera,
                    rig,
                    poses: poses?,
                },
                kept: &kept,
                sigma_px: FIRST_SIGMA_PX,
            };
            let minimum = minimise(bundle, MAX_STEPS, SETTLED).ok()?.state;
            let scatter = minimum.scatter_px()[0];
            Some((scatter, minimum.model.rig.camera, minimum.model.poses))
        });
    let best = minima.min_by(|a, b| a.0.total_cmp(&b.0));
    best.map(|(_, lens, poses)| (lens, poses))
        .ok_or_else(no_start)
}

/// Root mean squares per axis and of the distances, in both images.
pub(super) fn rms_px(off: &[ImagePoint]) -> [[f64; 2]; 2] {
    mean_squares_px2(off.iter().copied(), COORDINATES)
        .map(|per_axis| [per_axis.sqrt(), (2.0 * per_axis).sqrt()])
}

pub(super) fn head_of(rig: &Rig, name: &str) -> HeadModel {
    let (camera, projector) = (rig.camera.clone(), rig.projector.clone());
    HeadModel::from_lenses(
        name,
        camera,
        projector,
        transform(&rig.projector_from_camera),
    )
}

fn conclude(
    views: &[BoardView],
    geometry: Geometry,
    name: &str,
    used: &[usize],
    all: &Solved,
    without: &[Solved],
) -> Result<BoardAdjusted, BoardError> {
    let bundle = Bundle {
        model: BoardModel {
            free: Free::All,
            rig: all.rig.clone(),
            poses: all.poses.clone(),
        },
        kept: &all.kept,
        sigma_px: all.sigma_px,
    };
    let residuals = (0..used.len()).map(|pose| bundle.residuals(pose).unwrap_or_default());
    let residuals: Vec<Vec<ImagePoint>> = residuals.collect();
    let [camera_rms_px, projector_rms_px] = rms_px(&residuals.concat());
    check_fit([camera_rms_px[0], projector_rms_px[0]])?;
    check_determined(&all.rig, &all.covariance)?;
    let head = head_of(&all.rig, name);
    head.check().map_err(BoardError::Head)?;
    let poses: Vec<PoseReport> = views
        .iter()
        .enumerate()
        .map(|(index, view)| {
            let at = used.iter().position(|&pose| pose == index);
            let others = at.map_or(all, |at| &without[at]);
            let left_out = LeftOut::measure(view, geometry, &others.rig);
            let own = at.map(|at| (residuals[at].as_slice(), all.kept[at].len()));
            PoseReport::new(view, own, left_out)
        })
        .collect();
    let measured = poses.iter().filter(|pose| pose.used);
    let measured = measured.filter_map(|pose| Some((pose.points as f64, pose.left_out?)));
    let depths = all.kept.iter().zip(&all.poses).flat_map(|(dots, pose)| {
        dots.iter()
            .map(move |dot| (pose * Point3::new(dot.at_mm[0], dot.at_mm[1], 0.0)).z)
    });
    let depth_mm = depths.fold([f64::INFINITY, f64::NEG_INFINITY], |[near, far], z| {
        [near.min(z), far.max(z)]
    });
    let covariance = all.covariance.row_iter();
    Ok(BoardAdjusted {
        parameters: parameters(all, without),
        covariance: covariance
            .map(|row| row.iter().copied().collect())
            .collect(),
        sigma_mm: scatter_of_points_mm(all, without, geometry.scale_sigma_ratio),
        hold_out: hold_out(&measured.collect::<Vec<_>>()),
        points: all.kept.iter().map(Vec::len).sum(),
        dropped: poses
            .iter()
            .filter(|pose| pose.used)
            .map(|pose| pose.dropped)
            .sum(),
        head,
        poses,
        camera_rms_px,
        projector_rms_px,
        depth_mm,
    })
}

impl PoseReport {
    /// `own`: residuals of a pose that took part, and the number of its points that did.
    fn new(
        view: &BoardView,
        own: Option<(&[ImagePoint], usize)>,
        left_out: Option<LeftOut>,
    ) -> Self {
        let both = |px: f64| [px, px * std::f64::consts::SQRT_2];
        let [camera_rms_px, projector_rms_px] = match (own, left_out) {
            (Some((residuals, _)), _) => rms_px(residuals),
            (None, Some(out)) => [both(out.camera_rms_px), both(out.projector_rms_px)],
            (None, None) => [[f64::NAN; 2]; 2],
        };
        Self {
            name: view.name.clone(),
            points: view.marks.len(),
            dropped: view.marks.len() - own.map_or(0, |(_, kept)| kept),
            used: own.is_some(),
            camera_rms_px,
            projector_rms_px,
            left_out,
        }
    }
}

fn check_fit(rms_px: [f64; 2]) -> Result<(), BoardError> {
    match beyond([0, 1].map(|image| {
        (
            ["camera", "projector"][image],
            rms_px[image],
            LIMIT_PX[image],
        )
    })) {
        None => Ok(()),
        Some((what, got_px, limit_px)) => Err(BoardError::Residual {
            what,
            got_px,
            limit_px,
        }),
    }
}

fn check_determined(rig: &Rig, covariance: &DMatrix<f64>) -> Result<(), BoardError> {
    for (first, what, lens) in [
        (0, "camera", &rig.camera),
        (PROJECTOR, "projector", &rig.projector),
    ] {
        let sigma = |unknown: usize| covariance[(first + unknown, first + unknown)].sqrt();
        let size = f64::from(lens.width_px.max(lens.height_px));
        let checks = [
            ("focal length", sigma(0) / lens.focal_px[0], FOCAL_LIMIT),
            ("focal length", sigma(1) / lens.focal_px[1], FOCAL_LIMIT),
            ("principal point", sigma(2) / size, PRINCIPAL_LIMIT),
            ("principal point", sigma(3) / size, PRINCIPAL_LIMIT),
        ];
        if let Some((unknown, sigma, limit)) = beyond(checks) {
            return Err(BoardError::Degenerate {
                what,
                unknown,
                sigma,
                limit,
            });
        }
    }
    Ok(())
}
