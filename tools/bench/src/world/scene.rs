//! One view: the point of the die that every camera core sees, and its illumination by the projector's cores.

use super::bundle::Bundle;
use super::die::Die;
use super::dmd::DmdPass;
use super::film::Film;
use super::indirect;
use super::lamp::{HeadLamp, projector_reaches};
use super::optics::HeadOptics;
use super::pattern::PatternSpec;
use super::print::Print;
use super::rays::RayCaster;
use super::surface::Finish;
use super::transport::{START_MM, Spot, Transport};
use super::wear::FlankId;
use nalgebra::{Isometry3, Matrix2, Point3, Vector3};
use rayon::prelude::*;

/// True values at one camera core.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CoreTruth {
    /// Index of the core in the camera bundle.
    pub core: u32,
    /// Point of the real surface in the tool frame, mm.
    pub point_tool_mm: [f64; 3],
    /// Unit normal there, out of the material.
    pub normal_tool: [f64; 3],
    /// Whether the projector sees the point, too, and has a core and a pixel for it.
    pub lit: bool,
    /// DMD column and row from which light arrives there, px.
    pub projector_px: [f64; 2],
    /// Flank that the point lies on, if any.
    pub flank: Option<FlankId>,
    /// Wear depth there, mm: positive for loss.
    pub wear_mm: f64,
}

/// Most distinct fringe frequencies in one set.
pub(crate) const MAX_FREQUENCIES: usize = 4;
/// Sums per core: the uniform pattern, and cosine and sine of each frequency.
pub(crate) const LANES: usize = 1 + 2 * MAX_FREQUENCIES;
/// Light of a uniform pattern, and cosine and sine component of the fringes of each frequency; zero for unused frequencies.
pub type Lanes = [f32; LANES];

/// Standard deviation of the DMD area that a core collects from, in pitches.
pub(crate) const CORE_APERTURE_PITCH: f64 = 0.2;
/// Largest footprint of a camera core on the DMD in projector pitches: at grazing incidence modulation is lost anyway.
const MAX_FOOTPRINT_PITCH: f64 = 4.0;
/// The blur is truncated at this many standard deviations.
const BLUR_REACH: f64 = 3.0;

/// A camera core's line of sight in the camera frame (z = 1) and its change per pixel in x and y.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sight {
    direction: Vector3<f64>,
    per_px: [Vector3<f64>; 2],
}

/// Lines of sight of all cores.
pub(crate) fn sights(optics: &HeadOptics, bundle: &Bundle) -> Vec<Sight> {
    let camera = &optics.camera;
    let sight = |&[x, y]: &[f64; 2]| Sight {
        direction: camera.direction([x, y]),
        per_px: [
            camera.direction([x + 0.5, y]) - camera.direction([x - 0.5, y]),
            camera.direction([x, y + 0.5]) - camera.direction([x, y - 0.5]),
        ],
    };
    bundle.positions_px().par_iter().map(sight).collect()
}

/// Light emitted by each projector core for the frequencies of a pattern set, as far as the pass lights it.
pub(crate) fn emission(
    optics: &HeadOptics,
    bundle: &Bundle,
    frequencies: &[f64],
    pass: Option<&DmdPass>,
) -> Vec<Lanes> {
    let [columns, rows] = optics.projector_size_px.map(|n| n as f64);
    let pitch = bundle.spec().pitch_px();
    let leaving = |(&[x, y], &gain): (&[f64; 2], &f32)| {
        let mut lanes = [0f32; LANES];
        let on_dmd = x >= -0.5 && x < columns - 0.5 && y >= -0.5 && y < rows - 0.5;
        if !on_dmd {
            return lanes;
        }
        let gain = gain * pass.map_or(1.0, |pass| pass.ratio([x, y])) as f32;
        lanes[0] = gain;
        for (pair, periods) in lanes[1..].chunks_exact_mut(2).zip(frequencies) {
            let per_px = std::f64::consts::TAU * periods / columns;
            let averaged = (-0.5 * (per_px * CORE_APERTURE_PITCH * pitch).powi(2)).exp();
            let (sin, cos) = (per_px * (x + 0.5)).sin_cos();
            pair[0] = gain * (averaged * cos) as f32;
            pair[1] = gain * (averaged * sin) as f32;
        }
        lanes
    };
    let light: Vec<Lanes> = bundle
        .positions_px()
        .iter()
        .zip(bundle.gains())
        .map(leaving)
        .collect();
    bundle.with_crosstalk(&light)
}

/// The parts of the world that determine a view.
#[derive(Clone, Copy)]
pub(crate) struct Stage<'a> {
    pub optics: &'a HeadOptics,
    pub camera_bundle: &'a Bundle,
    pub projector_bundle: &'a Bundle,
    pub sights: &'a [Sight],
    pub die: &'a Die,
    pub rays: &'a RayCaster,
    pub finish: &'a Finish,
    pub film: Option<&'a Film>,
    /// Largest number of reflections.
    pub bounces: u32,
    pub print: Option<&'a Print>,
    /// Seed of the random light paths.
    pub seed: u64,
    /// Mirrors that the DMD lights; all of them if `None`.
    pub pass: Option<&'a DmdPass>,
}

/// Result of one camera core in a view.
pub(crate) struct CoreView {
    pub truth: Option<CoreTruth>,
    /// Light that enters the core in the lanes of [`emission`], relative to a plane of reflectance 1 that faces the projector in
    /// the centre of the field, uniformly lit; contrast is already applied to the fringes.
    pub light: Lanes,
}

/// A core without light.
const DARK: CoreView = CoreView {
    truth: None,
    light: [0.0; LANES],
};

impl Stage<'_> {
    /// All camera cores for one pose of the stages.
    pub(crate) fn look(
        &self,
        tool_from_camera: Isometry3<f64>,
        frequencies: &[f64],
    ) -> Vec<CoreView> {
        let eye = tool_from_camera * Point3::origin();
        if self.die.encloses_eye(self.rays, eye) {
            // The head is inside the die.
            return self.sights.iter().map(|_| DARK).collect();
        }
        let emission = &emission(self.optics, self.projector_bundle, frequencies, self.pass);
        let lamp =
            tool_from_camera * (self.optics.projector_from_camera.inverse() * Point3::origin());
        let mut views: Vec<CoreView> = (0..self.sights.len())
            .into_par_iter()
            .with_min_len(512)
            .map(|core| self.look_through(core, &tool_from_camera, eye, lamp, emission))
            .collect();
        if self.bounces > 1 {
            self.add_indirect(&mut views, &tool_from_camera, eye, frequencies);
        }
        views
    }

    /// Adds the light reflected by other parts of the die.
    fn add_indirect(
        &self,
        views: &mut [CoreView],
        tool_from_camera: &Isometry3<f64>,
        eye: Point3<f64>,
        frequencies: &[f64],
    ) {
        let lamp = HeadLamp::new(
            self.optics,
            self.projector_bundle,
            tool_from_camera,
            frequencies,
            self.pass,
        );
        let transport = Transport {
            rays: self.rays,
            finish: self.finish,
            either_side: self.die.has_no_winding(),
            bounces: self.bounces,
        };
        let spot = |truth: &CoreTruth| {
            let point = Point3::from(truth.point_tool_mm);
            Spot {
                point,
                normal: truth.normal_tool.into(),
                eye: (eye - point).normalize(),
            }
        };
        let spots: Vec<Option<Spot>> = views
            .iter()
            .map(|view| view.truth.as_ref().map(spot))
            .collect();
        let light = indirect::light(&transport, &lamp, &spots, self.seed);
        let camera_from_tool = tool_from_camera.inverse();
        for ((view, spot), over) in views.iter_mut().zip(&spots).zip(light) {
            let Some(spot) = spot else { continue };
            let p_camera = camera_from_tool * spot.point;
            let brightness = self.optics.camera_objective.brightness(p_camera) as f32;
            let contrast = self.optics.contrast(p_camera) as f32;
            for (lane, (sum, over)) in view.light.iter_mut().zip(over).enumerate() {
                *sum += over * brightness * if lane == 0 { 1.0 } else { contrast };
            }
        }
    }

    fn look_through(
        &self,
        core: usize,
        tool_from_camera: &Isometry3<f64>,
        eye: Point3<f64>,
        lamp: Point3<f64>,
        emission: &[Lanes],
    ) -> CoreView {
        let sight = &self.sights[core];
        let along = tool_from_camera * sight.direction;
        let Some(hit) = self.rays.nearest(eye, along) else {
            return DARK;
        };
        let normal = match hit.normal.dot(&along) {
            facing if facing < 0.0 => hit.normal,
            away if away > 0.0 && self.die.has_no_winding() => -hit.normal,
            // Seen from inside the material: the head has collided with the die.
            _ => return DARK,
        };
        let metal = eye + hit.distance * along;
        let before_mm = self
            .film
            .map_or(0.0, |film| film.along_ray_mm(metal, -normal.dot(&along)));
        let distance = hit.distance - before_mm;
        let point = eye + distance * along;
        let p_camera = Point3::from(distance * sight.direction);
        let p_projector = self.optics.projector_from_camera * p_camera;
        let Some(projector_px) = self.optics.projector.project(p_projector) else {
            return DARK;
        };

        let to_lamp = lamp - point;
        let faces_lamp = normal.dot(&to_lamp) > 0.0;
        let lighted = projector_reaches(self.optics, self.projector_bundle, projector_px);
        // Just outside the lighted field, blur still contributes some light; in shadow there is none.
        let unshaded = faces_lamp && !self.rays.blocked(point + START_MM * normal, lamp);
        let lit = unshaded && lighted;
        let flank = self.die.flank_at(hit.triangle, metal, normal);
        let truth = CoreTruth {
            core: core as u32,
            point_tool_mm: point.coords.into(),
            normal_tool: normal.into(),
            lit,
            projector_px,
            flank,
            wear_mm: flank.map_or(0.0, |id| self.die.wear_at_mm(id, metal.coords.into())),
        };
        if !unshaded {
            return CoreView {
                truth: Some(truth),
                light: [0.0; LANES],
            };
        }

        let returned = self
            .finish
            .returned(point, normal, to_lamp.normalize(), -along.normalize());
        let projector = &self.optics.projector_objective;
        let nearer = (projector.focus_mm / to_lamp.norm()).powi(2);
        let brightness = returned
            * self.printed(hit.triangle, point, p_camera)
            * nearer
            * projector.brightness(p_projector)
            * self.optics.camera_objective.brightness(p_camera);
        let normal_camera = tool_from_camera.inverse_transform_vector(&normal);
        let blur = self.blur_px2(sight, distance, normal_camera, p_camera, projector_px);
        let mut light = self.gather(projector_px, blur, emission);
        let contrast = self.optics.contrast(p_camera);
        for (lane, value) in light.iter_mut().enumerate() {
            *value *= (brightness * if lane == 0 { 1.0 } else { contrast }) as f32;
        }
        CoreView {
            truth: Some(truth),
            light,
        }
    }

    /// Reflectance of the print at a point, relative to the unprinted surface.
    fn printed(&self, triangle: usize, point: Point3<f64>, p_camera: Point3<f64>) -> f64 {
        let Some(print) = self.print else { return 1.0 };
        let objective = &self.optics.camera_objective;
        let blur_pitch = objective.sigma_pitch(p_camera).hypot(CORE_APERTURE_PITCH);
        let blur_px = blur_pitch * self.camera_bundle.spec().pitch_px();
        print.ratio(
            triangle,
            point,
            blur_px * p_camera.z / self.optics.camera.focal_px[0],
        )
    }

    /// Covariance on the DMD of the light that one camera core collects: the projector's blur, plus the core's blurred footprint
    /// projected by the tangent plane of the surface, px².
    fn blur_px2(
        &self,
        sight: &Sight,
        distance: f64,
        normal_camera: Vector3<f64>,
        p_camera: Point3<f64>,
        projector_px: [f64; 2],
    ) -> Matrix2<f64> {
        let projector_pitch = self.projector_bundle.spec().pitch_px();
        let p_projector = self.optics.projector_from_camera * p_camera;
        let sharp = self.optics.projector_objective.sigma_pitch(p_projector) * projector_pitch;
        let own = Matrix2::identity() * (sharp * sharp);

        // Displacement on the tangent plane for one pixel in the image.
        let aside = |change: Vector3<f64>| {
            let receding = normal_camera.dot(&change) / normal_camera.dot(&sight.direction);
            let moved = p_camera + distance * (change - receding * sight.direction);
            self.optics
                .projector
                .project(self.optics.projector_from_camera * moved)
        };
        let [Some(x), Some(y)] = sight.per_px.map(aside) else {
            return own;
        };
        let [u, v] = projector_px;
        let per_px = Matrix2::new(x[0] - u, y[0] - u, x[1] - v, y[1] - v);
        let sigma_px = self.optics.camera_objective.sigma_pitch(p_camera)
            * self.camera_bundle.spec().pitch_px();
        let mut footprint = per_px * per_px.transpose() * (sigma_px * sigma_px);
        let limit = (MAX_FOOTPRINT_PITCH * projector_pitch).powi(2);
        if footprint.trace() > limit {
            footprint *= limit / footprint.trace();
        }
        own + footprint
    }

    /// Light of the projector cores around `at_px`, weighted by a Gaussian of covariance `blur_px2`.
    fn gather(&self, at_px: [f64; 2], blur_px2: Matrix2<f64>, emission: &[Lanes]) -> Lanes {
        let (a, b, c) = (blur_px2[(0, 0)], blur_px2[(0, 1)], blur_px2[(1, 1)]);
        let determinant = a * c - b * b;
        let largest = 0.5 * (a + c) + (0.25 * (a - c) * (a - c) + b * b).sqrt();
        let reach_px = BLUR_REACH * largest.sqrt();
        let inverse = [c / determinant, -b / determinant, a / determinant];
        let positions = self.projector_bundle.positions_px();
        let mut sum = [0f32; LANES];
        for run in self.projector_bundle.near(at_px, reach_px) {
            for (position, light) in positions[run.clone()].iter().zip(&emission[run]) {
                let (dx, dy) = (position[0] - at_px[0], position[1] - at_px[1]);
                let squares =
                    inverse[0] * dx * dx + 2.0 * inverse[1] * dx * dy + inverse[2] * dy * dy;
                if squares < BLUR_REACH * BLUR_REACH {
                    let weight = (-0.5 * squares as f32).exp();
                    for (s, l) in sum.iter_mut().zip(light) {
                        *s += weight * l;
                    }
                }
            }
        }
        // Normalised to 1 for a uniform perfect lattice: integral of the truncated Gaussian over the area of a core's cell.
        let pitch = self.projector_bundle.spec().pitch_px();
        let cell_px2 = 0.5 * 3f64.sqrt() * pitch * pitch;
        let integral = std::f64::consts::TAU
            * determinant.sqrt()
            * (1.0 - (-0.5 * BLUR_REACH * BLUR_REACH).exp());
        let scale = (cell_px2 / integral) as f32;
        sum.map(|s| s * scale)
    }
}

/// Frequencies of a pattern set without duplicates, in order of appearance.
pub(crate) fn frequencies(patterns: &[PatternSpec]) -> Vec<f64> {
    let mut distinct: Vec<f64> = Vec::new();
    for pattern in patterns {
        if pattern.periods != 0.0 && !distinct.contains(&pattern.periods) {
            distinct.push(pattern.periods);
        }
    }
    distinct
}

/// Effect of motion on the fringes of one frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Moved {
    /// Phase shift.
    pub shift_rad: f64,
    /// Remaining fraction of the contrast.
    pub kept: f64,
}

/// Brightness of one pattern from the lanes of a core: half its uniform light, and half its fringe shifted by the step.
pub(crate) fn brightness(
    lanes: &Lanes,
    pattern: &PatternSpec,
    frequencies: &[f64],
    moved: Moved,
) -> f32 {
    let (sin, cos) = (pattern.step_rad() + moved.shift_rad).sin_cos();
    match frequencies.iter().position(|&f| f == pattern.periods) {
        Some(i) => {
            let (sin, cos) = ((moved.kept * sin) as f32, (moved.kept * cos) as f32);
            0.5 * (lanes[0] + cos * lanes[1 + 2 * i] - sin * lanes[2 + 2 * i])
        }
        // Uniform pattern: the cosine of the step alone.
        None => 0.5 * lanes[0] * (1.0 + cos as f32),
    }
}

#[cfg(test)]
mod tests {
    use super::super::World;
    use super::super::random::{Purpose, stream};
    use super::super::surface::Surface;
    use super::*;

    #[test]
    fn light_over_other_places_is_that_of_many_ways_from_every_core() {
        let mut config = crate::demo::world_config().unwrap();
        config.surface = Surface::ground();
        config.bounces = 5;
        let world = World::new(&config).unwrap();
        let pose = (-config.gear.tooth_centre_rad(40), 33.0);
        let frequencies = [4.0, 48.0];
        let stage = |bounces| Stage {
            bounces,
            ..world.stage(pose)
        };
        let at = world.mount.tool_from_camera(&world.optics, pose.0, pose.1);
        let [all, straight] = [5, 1].map(|bounces| stage(bounces).look(at, &frequencies));
        let eye = at * Point3::origin();
        let lamp = HeadLamp::new(
            &world.optics,
            &world.projector_bundle,
            &at,
            &frequencies,
            None,
        );
        let transport = Transport {
            rays: &world.rays,
            finish: &world.finish,
            either_side: false,
            bounces: 5,
        };
        let on_flank = |truth: &&CoreTruth| truth.lit && truth.flank.is_some();
        let cores = all.iter().filter_map(|view| view.truth.as_ref());
        let picked: Vec<&CoreTruth> = cores.filter(on_flank).step_by(400).collect();
        assert!(picked.len() > 50, "{}", picked.len());
        let (mut even, mut coarse, mut fine) = ([0.0; 2], [0.0; 2], Vec::new());
        for truth in picked {
            let (with, without) = (&all[truth.core as usize], &straight[truth.core as usize]);
            let point = Point3::from(truth.point_tool_mm);
            let spot = Spot {
                point,
                normal: truth.normal_tool.into(),
                eye: (eye - point).normalize(),
            };
            let mut random = stream(9, Purpose::Paths(truth.core));
            let exact = transport.indirect(&lamp, &spot, 20_000, &mut random);
            let p_camera = at.inverse() * point;
            let brightness = world.optics.camera_objective.brightness(p_camera);
            let contrast = brightness * world.optics.contrast(p_camera);
            let ours = |lane: usize| f64::from(with.light[lane] - without.light[lane]);
            let exact = |lane: usize| {
                f64::from(exact[lane]) * if lane == 0 { brightness } else { contrast }
            };
            even = [even[0] + ours(0), even[1] + exact(0)];
            let off =
                |lane: usize| (ours(lane) - exact(lane)).hypot(ours(lane + 1) - exact(lane + 1));
            coarse = [coarse[0] + off(1), coarse[1] + exact(1).hypot(exact(2))];
            fine.push(off(3) / f64::from(without.light[3].hypot(without.light[4])));
        }
        fine.sort_by(f64::total_cmp);
        let fine = fine[fine.len() / 2];
        println!("even {even:?} coarse {coarse:?} fine {fine}");
        assert!((even[0] / even[1] - 1.0).abs() < 0.03, "{even:?}");
        assert!(coarse[0] < 0.1 * coarse[1], "{coarse:?}");
        // Median phase error of the fine fringes: one two-hundredth of a fringe.
        assert!(fine < std::f64::consts::TAU / 200.0, "{fine}");
    }
}
