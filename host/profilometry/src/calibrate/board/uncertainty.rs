//! Uncertainty of a head and of the points that it measures, by leaving out one pose after the other.

use nalgebra::Point3;

use super::adjust::{Solved, head_of};
use super::model::{NAMES, OF_RIG, PROJECTOR};
use crate::calibrate::bundle::Observation;
use crate::calibrate::form;
use crate::calibrate::rig::Rig;
use crate::head::HeadModel;
use crate::triangulate::HeadTriangulator;

/// A value of the head with its uncertainty.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Parameter {
    /// Its name; turns are about the axes of the projector's frame.
    pub name: &'static str,
    /// Its value.
    pub value: f64,
    /// Standard uncertainty from the residuals, for independent points.
    pub sigma: f64,
    /// Standard uncertainty by leaving out one pose after the other (jackknife), which includes errors that the points of a pose have in common.
    pub sigma_by_poses: f64,
}

/// Values of a rig's unknowns; turns are relative to those of `zero`.
fn values(rig: &Rig, zero: &Rig) -> [f64; OF_RIG] {
    let mut values = [0.0; OF_RIG];
    for (first, lens) in [(0, &rig.camera), (PROJECTOR, &rig.projector)] {
        let all = [lens.focal_px, lens.principal_px].concat();
        for (k, value) in all
            .into_iter()
            .chain(lens.distortion[..4].iter().copied())
            .enumerate()
        {
            values[first + k] = value;
        }
    }
    let turn = rig.projector_from_camera.rotation * zero.projector_from_camera.rotation.inverse();
    let turn = turn.scaled_axis();
    for axis in 0..3 {
        values[2 * PROJECTOR + axis] = turn[axis];
        values[2 * PROJECTOR + 3 + axis] = rig.projector_from_camera.translation.vector[axis];
    }
    values
}

/// Jackknife of as many estimates, each without one of the poses (Efron and Tibshirani 1993, 11.5).
fn jackknife(estimates: &[f64]) -> f64 {
    let count = estimates.len() as f64;
    let mean = estimates.iter().sum::<f64>() / count;
    let squares: f64 = estimates.iter().map(|x| (x - mean).powi(2)).sum();
    ((count - 1.0) / count * squares).sqrt()
}

/// The unknowns of a head with their uncertainties; `without` are the heads without one pose each.
pub(super) fn parameters(all: &Solved, without: &[Solved]) -> Vec<Parameter> {
    let own = values(&all.rig, &all.rig);
    let others: Vec<[f64; OF_RIG]> = without
        .iter()
        .map(|solved| values(&solved.rig, &all.rig))
        .collect();
    let turn = all.rig.projector_from_camera.rotation.scaled_axis();
    let parameter = |(index, name): (usize, &'static str)| Parameter {
        name,
        value: match index.checked_sub(2 * PROJECTOR) {
            Some(axis @ 0..3) => turn[axis],
            _ => own[index],
        },
        sigma: all.covariance[(index, index)].sqrt(),
        sigma_by_poses: jackknife(
            &others
                .iter()
                .map(|values| values[index])
                .collect::<Vec<_>>(),
        ),
    };
    NAMES.into_iter().enumerate().map(parameter).collect()
}

/// Standard uncertainty of the boards' points along the camera's axis and across, by the heads without one pose each and by the
/// uncertainty of the scale where it is known. The camera's frame is arbitrary, so each head's points are first moved onto those of all.
/// NaN where a head does not see a point.
pub(super) fn scatter_of_points_mm(
    all: &Solved,
    without: &[Solved],
    scale_sigma_ratio: Option<f64>,
) -> [f64; 2] {
    let dots: Vec<&Observation> = all.kept.iter().flatten().collect();
    let points = |head: &HeadModel| -> Option<Vec<[f64; 3]>> {
        let triangulator = HeadTriangulator::new(head);
        let points = dots.iter().map(|dot| {
            let [u, v, column, _] = dot.seen_px;
            triangulator.point([u, v], column)
        });
        points.collect()
    };
    let laid = |of_one: &HeadModel, of_all: &[[f64; 3]]| {
        let pairs: Vec<_> = points(of_one)?
            .into_iter()
            .zip(of_all.iter().copied())
            .collect();
        let motion = form::rigid_motion(&pairs)?;
        let laid = pairs
            .iter()
            .map(|pair| (motion * Point3::from(pair.0)).into());
        Some(laid.collect::<Vec<[f64; 3]>>())
    };
    let Some(of_all) = points(&head_of(&all.rig, "")) else {
        return [f64::NAN; 2];
    };
    let clouds: Option<Vec<_>> = without
        .iter()
        .map(|solved| laid(&head_of(&solved.rig, ""), &of_all))
        .collect();
    let Some(clouds) = clouds else {
        return [f64::NAN; 2];
    };
    let mut squares = [0.0; 2];
    for (at, point) in of_all.iter().enumerate() {
        let along = |axis: usize| {
            let estimates: Vec<f64> = clouds.iter().map(|cloud| cloud[at][axis]).collect();
            jackknife(&estimates).hypot(scale_sigma_ratio.unwrap_or(0.0) * point[axis])
        };
        let [x, y, z] = [0, 1, 2].map(along);
        squares[0] += z * z;
        squares[1] += 0.5 * (x * x + y * y);
    }
    squares.map(|sum: f64| (sum / of_all.len() as f64).sqrt())
}
