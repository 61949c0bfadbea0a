//! Image of a die by an ideal head of two pinholes: no fibres, no blur, no loss towards the edge. For comparison with other
//! renderers, which do not model a fibre bundle.

use super::lamp::PinholeLamp;
use super::optics::Pinhole;
use super::random::{Purpose, stream};
use super::rays::RayCaster;
use super::scene::{LANES, Lanes, MAX_FREQUENCIES};
use super::surface::{Finish, Surface};
use super::transport::{Spot, Transport, spread};
use super::{WorldError, die};
use flankscope_gear_cad::Mesh;
use nalgebra::{Isometry3, Point3};
use rand::RngExt;
use rayon::prelude::*;

/// A die in front of two pinholes.
#[derive(Clone, Debug)]
pub struct IdealView<'a> {
    /// The surface in the tool frame, mm, facing outwards.
    pub mesh: &'a Mesh,
    /// Its reflectance.
    pub surface: Surface,
    /// Largest number of reflections; 1 is direct light alone.
    pub bounces: u32,
    pub camera: Pinhole,
    /// The projector; it lights a plane perpendicular to its axis uniformly.
    pub projector: Pinhole,
    /// Columns and rows of its DMD.
    pub projector_size_px: [usize; 2],
    /// Projector frame from camera frame.
    pub projector_from_camera: Isometry3<f64>,
    /// Tool frame from camera frame.
    pub tool_from_camera: Isometry3<f64>,
    /// Periods of the fringes over the width of the DMD, four at most.
    pub frequencies: Vec<f64>,
    /// Seed of the random light paths.
    pub seed: u64,
}

/// Light of one pixel, relative to that of a white plane perpendicular to the projector's axis at 1 mm: for the uniform pattern,
/// then cosine and sine component of each frequency.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PixelLight {
    /// Point in the middle of the pixel, tool frame, mm.
    pub point_mm: [f64; 3],
    /// Normal there.
    pub normal: [f64; 3],
    /// Light directly from the projector.
    pub direct: Lanes,
    /// Light reflected by other parts of the die.
    pub indirect: Lanes,
}

impl IdealView<'_> {
    /// Light of each of `pixels` (column, row), the mean of `paths` light paths through points spread over the pixel; `None` if
    /// its centre does not see the die.
    ///
    /// # Errors
    /// The mesh or surface is invalid, or there are more than four frequencies.
    pub fn look(
        &self,
        pixels: &[[u32; 2]],
        paths: u32,
    ) -> Result<Vec<Option<PixelLight>>, WorldError> {
        die::check_mesh(self.mesh)?;
        if self.frequencies.len() > MAX_FREQUENCIES {
            return Err(WorldError::Frequencies {
                got: self.frequencies.len(),
                max: MAX_FREQUENCIES,
            });
        }
        let finish = Finish::new(self.surface.clone(), None, self.seed)?;
        let rays = RayCaster::new(self.mesh);
        let transport = Transport {
            rays: &rays,
            finish: &finish,
            either_side: false,
            bounces: self.bounces,
        };
        let lamp = PinholeLamp {
            projector: &self.projector,
            size_px: self.projector_size_px,
            projector_from_tool: self.projector_from_camera * self.tool_from_camera.inverse(),
            frequencies: &self.frequencies,
            plane_mm: 1.0,
        };
        Ok((0..pixels.len())
            .into_par_iter()
            .map(|i| self.pixel(&transport, &lamp, i, pixels[i], paths))
            .collect())
    }

    fn spot(&self, rays: &RayCaster, px: [f64; 2]) -> Option<Spot> {
        let eye = self.tool_from_camera * Point3::origin();
        let along = (self.tool_from_camera * self.camera.direction(px)).normalize();
        let hit = rays.nearest(eye, along)?;
        (hit.normal.dot(&along) < 0.0).then(|| Spot {
            point: eye + hit.distance * along,
            normal: hit.normal,
            eye: -along,
        })
    }

    fn pixel(
        &self,
        transport: &Transport<'_>,
        lamp: &PinholeLamp<'_>,
        number: usize,
        [column, row]: [u32; 2],
        paths: u32,
    ) -> Option<PixelLight> {
        let px = [column, row].map(f64::from);
        let middle = self.spot(transport.rays, px)?;
        let mut random = stream(self.seed, Purpose::Paths(number as u32));
        let turn = [random.random(), random.random()];
        let (mut direct, mut indirect) = ([0f64; LANES], [0f64; LANES]);
        for [x, y] in spread(turn).take(paths as usize) {
            let Some(spot) = self.spot(transport.rays, [px[0] + x - 0.5, px[1] + y - 0.5]) else {
                continue;
            };
            let first = std::array::from_fn(|_| random.random());
            // Means over many pixels are computed, so no path is widened to a patch.
            transport.follow(lamp, spot, first, f64::INFINITY, &mut random, &mut indirect);
            for (all, lane) in direct
                .iter_mut()
                .zip(transport.direct(lamp, &spot).unwrap_or_default())
            {
                *all += f64::from(lane);
            }
        }
        let mean = |sum: [f64; LANES]| sum.map(|lane| (lane / f64::from(paths.max(1))) as f32);
        Some(PixelLight {
            point_mm: middle.point.coords.into(),
            normal: middle.normal.into(),
            direct: mean(direct),
            indirect: mean(indirect),
        })
    }
}
