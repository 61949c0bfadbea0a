//! How much of the projector's light arrives at a place.

use super::bundle::Bundle;
use super::optics::{HeadOptics, Pinhole};
use super::scene::{CORE_APERTURE_PITCH, LANES, Lanes};
use nalgebra::{Isometry3, Point3};
use std::f64::consts::TAU;

/// Something that throws fringes from one point.
pub(crate) trait Lamp: Sync {
    /// Where it stands in the tool frame.
    fn position(&self) -> Point3<f64>;

    /// Light on a plane at `p` (tool frame) that faces the lamp, nothing in between; none beyond its field.
    fn arriving(&self, p: Point3<f64>) -> Option<Lanes>;
}

/// Lanes of fringes at a column of the DMD: their mean, and their contrast after a blur of `sigma_px`.
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

/// The head's projector, its cores taken together: for light that comes over another place, where no core shows any more.
pub(crate) struct HeadLamp<'a> {
    optics: &'a HeadOptics,
    bundle: &'a Bundle,
    projector_from_tool: Isometry3<f64>,
    position: Point3<f64>,
    frequencies: &'a [f64],
    mean_gain: f64,
}

impl<'a> HeadLamp<'a> {
    pub(crate) fn new(
        optics: &'a HeadOptics,
        bundle: &'a Bundle,
        tool_from_camera: &Isometry3<f64>,
        frequencies: &'a [f64],
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
        }
    }
}

impl Lamp for HeadLamp<'_> {
    fn position(&self) -> Point3<f64> {
        self.position
    }

    fn arriving(&self, p: Point3<f64>) -> Option<Lanes> {
        let p = self.projector_from_tool * p;
        let px = self.optics.projector.project(p)?;
        if !projector_reaches(self.optics, self.bundle, px) {
            return None;
        }
        let objective = &self.optics.projector_objective;
        let mean = self.mean_gain * projector_brightness(self.optics, p);
        let sigma_px =
            objective.sigma_pitch(p).hypot(CORE_APERTURE_PITCH) * self.bundle.spec().pitch_px();
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

/// Whether a core of the projector's bundle sits at this place of the DMD.
pub(crate) fn projector_reaches(optics: &HeadOptics, bundle: &Bundle, [x, y]: [f64; 2]) -> bool {
    let bundle = bundle.spec();
    let from_centre = (x - bundle.centre_px[0]).hypot(y - bundle.centre_px[1]);
    on_dmd(optics.projector_size_px, [x, y]) && from_centre < 0.5 * bundle.diameter_px
}

fn on_dmd(size_px: [usize; 2], [x, y]: [f64; 2]) -> bool {
    let [columns, rows] = size_px.map(|n| n as f64);
    x >= -0.5 && x < columns - 0.5 && y >= -0.5 && y < rows - 0.5
}

/// A pinhole without fibres or blur that lights a plane across its axis evenly.
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

    fn arriving(&self, p: Point3<f64>) -> Option<Lanes> {
        let p = self.projector_from_tool * p;
        let px = self.projector.project(p)?;
        if !on_dmd(self.size_px, px) {
            return None;
        }
        // On a plane at z the light is 1/z² and falls there under the cosine z / r; here the plane faces the lamp.
        let cos = p.z / p.coords.norm();
        let mean = (self.plane_mm / p.z).powi(2) / cos;
        let columns = self.size_px[0] as f64;
        Some(fringes(self.frequencies, columns, px[0], mean, 0.0))
    }
}
