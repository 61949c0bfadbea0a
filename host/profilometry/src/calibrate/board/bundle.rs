//! The equations of the adjustment: lenses, their places and all poses of the board from all points.

use nalgebra::{DVector, Isometry3};
use rayon::prelude::*;

use super::model::{OF_LENS, OF_POSE, OF_RIG, PROJECTOR, Rig, Seen, small_pose_step, step_pose};
use super::{BoardMark, Geometry};
use crate::calibrate::least_squares::{Normal, Problem};
use crate::calibrate::model::DISTORTION_SIGMA;
use flankscope_foundation::order::{SIGMA_PER_MAD, quantile};

/// Which unknowns are looked for, besides the poses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Free {
    /// None: the poses by what the camera sees.
    Poses,
    /// The camera's, by what it sees.
    Camera,
    /// All, by what both see.
    All,
}

impl Free {
    fn unknowns(self) -> std::ops::Range<usize> {
        match self {
            Self::Poses => 0..0,
            Self::Camera => 0..PROJECTOR,
            Self::All => 0..OF_RIG,
        }
    }

    /// How many of the coordinates of a point count.
    fn coordinates(self) -> usize {
        match self {
            Self::Poses | Self::Camera => 2,
            Self::All => 4,
        }
    }
}

/// The equations about a state.
#[derive(Clone)]
pub(super) struct Bundle<'a> {
    pub geometry: Geometry,
    pub free: Free,
    pub rig: Rig,
    pub poses: Vec<Isometry3<f64>>,
    /// Points that take part, pose by pose.
    pub kept: &'a [Vec<BoardMark>],
    /// Standard uncertainty of a coordinate in the camera's and in the projector's image.
    pub sigma_px: [f64; 2],
}

impl Bundle<'_> {
    /// What the points of a pose are off by; `None` where one would lie behind a lens.
    pub fn residuals(&self, pose: usize) -> Option<Vec<Seen>> {
        self.off(pose, &self.rig, &self.poses[pose])
    }

    fn off(&self, pose: usize, rig: &Rig, camera_from_board: &Isometry3<f64>) -> Option<Vec<Seen>> {
        let of_mark = |mark: &BoardMark| {
            let seen = rig.seen(
                camera_from_board,
                mark.at_mm(self.geometry.pitch_mm),
                self.geometry.radius_mm,
            )?;
            let [u, v, column, row] = seen;
            let [[u0, v0], [c0, r0]] = [mark.pixel, mark.lit_px];
            Some([u - u0, v - v0, column - c0, row - r0])
        };
        self.kept[pose].iter().map(of_mark).collect()
    }

    fn sigmas(&self) -> Seen {
        let [camera, projector] = self.sigma_px;
        [camera, camera, projector, projector]
    }

    fn squares(&self, residuals: Option<Vec<Seen>>) -> f64 {
        let Some(residuals) = residuals else {
            return f64::INFINITY;
        };
        let sigmas = self.sigmas();
        let of_mark = |off: Seen| {
            let parts = off.into_iter().zip(sigmas).take(self.free.coordinates());
            parts.map(|(off, sigma)| (off / sigma).powi(2)).sum::<f64>()
        };
        residuals.into_iter().map(of_mark).sum()
    }

    /// Coefficients of distortion that no point determines stay near zero: which unknown, its value, its sigma.
    fn priors(&self) -> impl Iterator<Item = (usize, f64, f64)> + '_ {
        let lenses = [(0, &self.rig.camera), (PROJECTOR, &self.rig.projector)];
        let of_lens = |(first, lens): (usize, &crate::head::Pinhole)| {
            let values = lens.distortion;
            let sigmas = DISTORTION_SIGMA.into_iter().enumerate();
            sigmas.map(move |(k, sigma)| (first + OF_LENS - 4 + k, values[k], sigma))
        };
        let free = self.free.unknowns();
        lenses
            .into_iter()
            .flat_map(of_lens)
            .filter(move |(unknown, ..)| free.contains(unknown))
    }

    fn cost(&self) -> f64 {
        let poses = (0..self.kept.len()).map(|pose| self.squares(self.residuals(pose)));
        poses.sum::<f64>()
            + self
                .priors()
                .map(|(_, value, sigma)| (value / sigma).powi(2))
                .sum::<f64>()
    }

    /// Robust standard deviations of the coordinates in both images.
    pub fn scatter_px(&self) -> [f64; 2] {
        let mut off = [Vec::new(), Vec::new()];
        for residual in (0..self.kept.len())
            .filter_map(|pose| self.residuals(pose))
            .flatten()
        {
            off[0].extend(residual[..2].iter().map(|x| x.abs()));
            off[1].extend(residual[2..].iter().map(|x| x.abs()));
        }
        // A thousandth of a pixel is nobody's noise, and keeps perfect data from being weighed infinitely.
        off.map(|mut off| (SIGMA_PER_MAD * quantile(&mut off, 0.5).unwrap_or(0.0)).max(1e-3))
    }

    /// Equations of one pose about the free unknowns of the rig and its own; of the symmetric part the lower half.
    fn of_pose(&self, pose: usize) -> Normal {
        let shared = self.free.unknowns();
        let unknowns = shared.len() + OF_POSE;
        let size_mm = self.poses[pose].translation.vector.norm();
        let stepped = |unknown: usize, by: f64| {
            let (mut rig, mut camera_from_board) = (self.rig.clone(), self.poses[pose]);
            match unknown.checked_sub(shared.len()) {
                None => rig.step(unknown, by),
                Some(own) => step_pose(&mut camera_from_board, own, by),
            }
            self.off(pose, &rig, &camera_from_board)
        };
        let step_of = |unknown: usize| match unknown.checked_sub(shared.len()) {
            None => Rig::small_step(unknown, size_mm),
            Some(own) => small_pose_step(own, size_mm),
        };
        let here = self.residuals(pose);
        let mut normal = Normal::zero(unknowns);
        normal.cost = self.squares(here.clone());
        let sides: Option<Vec<_>> = (0..unknowns)
            .map(|unknown| {
                let step = step_of(unknown);
                Some((stepped(unknown, step)?, stepped(unknown, -step)?, step))
            })
            .collect();
        let (Some(here), Some(sides)) = (here, sides) else {
            normal.cost = f64::INFINITY;
            return normal;
        };
        let sigmas = self.sigmas();
        for (mark, off) in here.iter().enumerate() {
            for coordinate in 0..self.free.coordinates() {
                let slope = DVector::from_iterator(
                    unknowns,
                    sides.iter().map(|(more, less, step)| {
                        (more[mark][coordinate] - less[mark][coordinate])
                            / (2.0 * step * sigmas[coordinate])
                    }),
                );
                normal
                    .gradient
                    .axpy(off[coordinate] / sigmas[coordinate], &slope, 1.0);
                normal.hessian.syger(1.0, &slope, &slope, 1.0);
            }
        }
        normal
    }
}

impl Problem for Bundle<'_> {
    fn normal(&self) -> Normal {
        let shared = self.free.unknowns().len();
        let mut all = Normal::zero(shared + OF_POSE * self.poses.len());
        let shares: Vec<Normal> = (0..self.poses.len())
            .into_par_iter()
            .map(|pose| self.of_pose(pose))
            .collect();
        for (pose, share) in shares.into_iter().enumerate() {
            let own = shared + OF_POSE * pose;
            let places: Vec<usize> = (0..shared).chain(own..own + OF_POSE).collect();
            all.add(&share, &places);
        }
        for (unknown, value, sigma) in self.priors() {
            all.add_prior(unknown, value, sigma);
        }
        all
    }

    fn stepped(&self, step: &DVector<f64>) -> (Self, f64) {
        let mut next = self.clone();
        let shared = self.free.unknowns();
        for unknown in shared.clone() {
            next.rig.step(unknown, step[unknown]);
        }
        for (pose, camera_from_board) in next.poses.iter_mut().enumerate() {
            for own in 0..OF_POSE {
                step_pose(
                    camera_from_board,
                    own,
                    step[shared.len() + OF_POSE * pose + own],
                );
            }
        }
        let cost = next.cost();
        (next, cost)
    }
}
