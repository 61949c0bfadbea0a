//! Light of the projector that arrives at a point.

use super::bundle::Bundle;
use super::dmd::DmdPass;
use super::microfacet::tangents;
use super::optics::{HeadOptics, Pinhole};
use super::scene::{CORE_APERTURE_PITCH, LANES, Lanes};
use nalgebra::{Isometry3, Point3, Vector3};
use std::f64::consts::TAU;

/// A light source that projects fringes from one point.
pub(crate) trait Lamp: Sync {
    /// Position in the tool frame.
    fn position(&self) -> Point3<f64>;

    /// Light on a plane perpendicular to the ray, averaged over a patch, without obstacles; `None` beyond the field.
    fn arriving(&self, about: &Patch) -> Option<Lanes>;
}

/// A part of a face in the tool frame, as large as the area that one light path represents.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Patch {
    /// Its centre.
    pub point: Point3<f64>,
    /// Unit normal out of the material.
    pub normal: Vector3<f64>,
    /// Its size: standard deviation of a Gaussian over the face, mm.
    pub sigma_mm: f64,
}

impl Patch {
    /// Standard deviation of the DMD columns over the patch, px.
    fn sigma_columns_px(&self, projector: &Pinhole, projector_from_tool: &Isometry3<f64>) -> f64 {
        /// Small relative to changes of the lens distortion, large relative to rounding errors.
        const STEP_MM: f64 = 1e-3;
        if self.sigma_mm == 0.0 {
            return 0.0;
        }
        let column = |point: Point3<f64>| {
            let px = projector.project(projector_from_tool * point);
            px.map(|[column, _]| column)
        };
        let slope = |along: Vector3<f64>| {
            let [before, after] =
                [-0.5, 0.5].map(|ends| column(self.point + ends * STEP_MM * along));
            before
                .zip(after)
                .map_or(0.0, |(before, after)| after - before)
                / STEP_MM
        };
        let [x, y] = tangents(&self.normal).map(slope);
        self.sigma_mm * x.hypot(y)
    }
}

/// Lanes of the fringes at a DMD column: their mean, and their contrast after a blur of `sigma_px`.
fn fringes(frequencies: &[f64], columns: f64, column: f64, mean: f64, sigma_px: f64) -> Lanes {
    let mut lanes = [0f32; LANES];
    lanes[0] = mean as f32;
    for (pair, periods) in lanes[1..].chunks_exact_mut(2).zip(frequencies) {
        let per_px = TAU * periods / columns;
        let kept = mean * (-0.5 * (per_px * sigma_px).powi(2)).exp();
        let (sin, cos) = (per_px * (column + 0.5)).sin_cos();
        pair[0] = (kept * cos) as f32;
        pair[1] = (kept * sin) as f32;
    }
    lanes
}

/// The head's projector without individual cores: for light reflected by another part of the die, in which cores are no longer visible.
pub(crate) struct HeadLamp<'a> {
    optics: &'a HeadOptics,
    bundle: &'a Bundle,
    projector_from_tool: Isometry3<f64>,
    position: Point3<f64>,
    frequencies: &'a [f64],
    mean_gain: f64,
    pass: Option<&'a DmdPass>,
}

impl<'a> HeadLamp<'a> {
    pub(crate) fn new(
        optics: &'a HeadOptics,
        bundle: &'a Bundle,
        tool_from_camera: &Isometry3<f64>,
        frequencies: &'a [f64],
        pass: Option<&'a DmdPass>,
    ) -> Self {
        let projector_from_tool = optics.projector_from_camera * tool_from_camera.inverse();
        let gains = bundle.gains();
        Self {
            optics,
            bundle,
            position: projector_from_tool.inverse() * Point3::origin(),
            projector_from_tool,
            frequencies,
            mean_gain: gains.iter().map(|g| f64::from(*g)).sum::<f64>() / gains.len() as f64,
            pass,
        }
    }
}

impl Lamp for HeadLamp<'_> {
    fn position(&self) -> Point3<f64> {
        self.position
    }

    fn arriving(&self, about: &Patch) -> Option<Lanes> {
        let p = self.projector_from_tool * about.point;
        let px = self.optics.projector.project(p)?;
        if !projector_reaches(self.optics, self.bundle, px) {
            return None;
        }
        let objective = &self.optics.projector_objective;
        let kept = self.pass.map_or(1.0, |pass| pass.ratio(px));
        let mean = kept * self.mean_gain * projector_brightness(self.optics, p);
        let own_px =
            objective.sigma_pitch(p).hypot(CORE_APERTURE_PITCH) * self.bundle.spec().pitch_px();
        let patch_px = about.sigma_columns_px(&self.optics.projector, &self.projector_from_tool);
        let sigma_px = own_px.hypot(patch_px);
        let columns = self.optics.projector_size_px[0] as f64;
        Some(fringes(self.frequencies, columns, px[0], mean, sigma_px))
    }
}

/// Light at a point of the projector's frame, relative to the middle of the field in best focus.
fn projector_brightness(optics: &HeadOptics, p_projector: Point3<f64>) -> f64 {
    let objective = &optics.projector_objective;
    let nearer = (objective.focus_mm / p_projector.coords.norm()).powi(2);
    nearer * objective.brightness(p_projector)
}

/// Whether a core of the projector's bundle is at this position of the DMD.
pub(crate) fn projector_reaches(optics: &HeadOptics, bundle: &Bundle, [x, y]: [f64; 2]) -> bool {
    let bundle = bundle.spec();
    let from_centre = (x - bundle.centre_px[0]).hypot(y - bundle.centre_px[1]);
    on_dmd(optics.projector_size_px, [x, y]) && from_centre < 0.5 * bundle.diameter_px
}

fn on_dmd(size_px: [usize; 2], [x, y]: [f64; 2]) -> bool {
    let [columns, rows] = size_px.map(|n| n as f64);
    x >= -0.5 && x < columns - 0.5 && y >= -0.5 && y < rows - 0.5
}

/// A pinhole without fibres or blur that lights a plane perpendicular to its axis uniformly.
pub(crate) struct PinholeLamp<'a> {
    pub projector: &'a Pinhole,
    pub size_px: [usize; 2],
    pub projector_from_tool: Isometry3<f64>,
    pub frequencies: &'a [f64],
    /// Distance of the plane on which the light is 1, mm.
    pub plane_mm: f64,
}

impl Lamp for PinholeLamp<'_> {
    fn position(&self) -> Point3<f64> {
        self.projector_from_tool.inverse() * Point3::origin()
    }

    fn arriving(&self, about: &Patch) -> Option<Lanes> {
        let p = self.projector_from_tool * about.point;
        let px = self.projector.project(p)?;
        if !on_dmd(self.size_px, px) {
            return None;
        }
        // On a plane at z the irradiance is 1/z², with the cosine z / r; here the plane is perpendicular to the ray.
        let cos = p.z / p.coords.norm();
        let mean = (self.plane_mm / p.z).powi(2) / cos;
        let columns = self.size_px[0] as f64;
        let sigma_px = about.sigma_columns_px(self.projector, &self.projector_from_tool);
        Some(fringes(self.frequencies, columns, px[0], mean, sigma_px))
    }
}
