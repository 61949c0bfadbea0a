//! The physical world of the simulated bench: a worn die, the measuring head and its camera, and the true values.
//!
//! ```text
//! WorldConfig ──► Die (CAD + wear)   ──rays──► what each camera core sees ─┐
//!                 Bundle x 2, optics ─────────► how it is lit ─────────────┴─► ViewState: light per pixel and pattern
//!                                                                             │ exposure, LED, noise
//!                                                                             ▼ frame (counts)     and the truth per core
//! ```
//!
//! This module does not know how frames are decoded: the forward model is independent, so that agreement between a decoded point
//! and the true one is meaningful. Millimetres and radians; frames as in the head file: `tool` has the die's axis as z, `stage`
//! the rotation axis, `camera` looks along +z with x to the right and y down.
//!
//! A view is prepared once per pose (the costly part, on all threads); its frames are then rendered in milliseconds.

mod bundle;
mod design;
mod die;
mod die_mesh;
mod dmd;
mod error;
mod film;
mod form;
mod ideal;
mod indirect;
mod lamp;
mod liquid;
mod microfacet;
mod mount;
mod optics;
mod pattern;
mod print;
pub(crate) mod random;
mod rays;
mod refine;
mod scene;
mod sensor;
mod surface;
mod transport;
mod unevenness;
mod wear;

pub use bundle::{Bundle, BundleSpec};
pub use design::{AT_HAND, DrivenHead, Fibres, HeadDesign, Side};
pub use die::Die;
pub(crate) use die::flank_of_facet;
pub use die_mesh::{DieMesh, MAX_DIE_TRIANGLES};
pub use dmd::DmdPass;
pub use error::WorldError;
pub use form::Form;
pub use ideal::{IdealView, PixelLight};
pub use liquid::{Driven, LiquidLens};
pub use mount::{Carries, Mount, Saw};
pub use optics::{HeadOptics, Objective, Pinhole, SecondProjector};
pub use pattern::{Fringes, PatternSpec};
pub use print::Print;
pub use rays::{Hit, RayCaster};
pub use scene::{CoreTruth, Lanes};
pub use sensor::SensorSpec;
pub use surface::{Metal, Oil, SprayEdge, Surface};
pub use unevenness::{Remainder, Unevenness};
pub use wear::{
    FlankId, FlankZone, MAX_DEPTH_UM, VIEW_HALF_MM, Wear, WearError, WearField, WearKind,
};

use film::Film;
use flankscope_gear_cad::{GearSpec, Mesh};
use nalgebra::{Isometry3, Point3, Vector3};
use random::{Normals, Purpose, stream};
use rayon::prelude::*;
use scene::{CoreView, Moved, Sight, Stage};
use sensor::{Rates, Sensor};
use std::sync::Arc;
use surface::Finish;

/// Configuration of a world. The same configuration gives the same frames.
#[derive(Clone, Debug)]
pub struct WorldConfig {
    /// CAD surface of the die in the tool frame, mm, facing outwards.
    pub cad: Mesh,
    /// Gear data of that surface, which define the positions of its flanks.
    pub gear: GearSpec,
    /// Wear of the die.
    pub wear: Vec<Wear>,
    /// A mesh used instead of the CAD and its wear.
    pub die_mesh: Option<Arc<DieMesh>>,
    /// Size of the warm die relative to its CAD; it grows from the axis and from z = 0.
    pub growth: f64,
    /// Form error of the die.
    pub form: Form,
    /// Mounting of die and head on the stages.
    pub mount: Mount,
    /// Vibration between head and die from frame to frame, along the direction in which the fringes change: standard deviation, µm.
    pub vibration_um: f64,
    /// Vibration within a frame, faster than the exposure: standard deviation, µm. It blurs the fringes.
    pub shiver_um: f64,
    /// Reflectance.
    pub surface: Surface,
    /// Edge of a sprayed part of the die.
    pub spray_edge: Option<SprayEdge>,
    /// Mean thickness of the matt layer, µm.
    pub film_um: f64,
    /// Largest number of reflections at the die between projector and camera; 1 is direct light alone.
    pub bounces: u32,
    /// Pattern printed on a calibration target.
    pub print: Option<Print>,
    pub optics: HeadOptics,
    /// Design of the head, if a controller may drive its liquid lenses.
    pub driven_head: Option<Box<DrivenHead>>,
    /// Bundle between objective and camera, px of the camera.
    pub camera_bundle: BundleSpec,
    /// Bundle between DMD and objective, px of the DMD.
    pub projector_bundle: BundleSpec,
    /// Mirrors that the DMD lights in each pass, with all patterns per pass; empty: one pass of all mirrors.
    pub passes: Vec<DmdPass>,
    /// The camera.
    pub sensor: SensorSpec,
    /// Seed of the head's individual properties: cores, gains, pixel response. One seed is one head.
    pub head_seed: u64,
    /// Seed of what differs from run to run: surface grain and noise.
    pub run_seed: u64,
}

impl WorldConfig {
    /// The demo's head in front of a sprayed die.
    pub fn new(cad: Mesh, gear: GearSpec) -> Self {
        let head = HeadDesign::demo();
        Self {
            cad,
            gear,
            wear: Vec::new(),
            die_mesh: None,
            growth: 1.0,
            form: Form::default(),
            mount: Mount::perfect(),
            vibration_um: 0.0,
            shiver_um: 0.0,
            surface: Surface::sprayed(),
            spray_edge: None,
            film_um: 0.0,
            bounces: 1,
            print: None,
            optics: head.optics(),
            driven_head: None,
            camera_bundle: head.bundle(&head.camera),
            projector_bundle: head.bundle(&head.projector),
            passes: Vec::new(),
            sensor: head.sensor,
            head_seed: 1,
            run_seed: 1,
        }
    }
}

/// Farthest shift of the cores' image either way.
pub const MAX_SHIFT_PX: f64 = 10.0;

/// Largest number of reflections that may be configured.
pub const MAX_BOUNCES: u32 = 16;

/// Bits that identify a pose, used as a seed.
fn pose_bits(rotation_rad: f64, vertical_mm: f64) -> u64 {
    rotation_rad.to_bits() ^ vertical_mm.to_bits().rotate_left(32)
}

/// The bench's world.
pub struct World {
    cad: Mesh,
    gear: GearSpec,
    die_mesh: Option<Arc<DieMesh>>,
    growth: f64,
    optics: HeadOptics,
    driven_head: Option<Box<DrivenHead>>,
    head_seed: u64,
    mount: Mount,
    /// Pose of the camera in the die's frame, if an arm carries the head.
    carried: Option<Isometry3<f64>>,
    vibration_um: f64,
    shiver_um: f64,
    form: Form,
    sensor_spec: SensorSpec,
    finish: Finish,
    film: Option<Film>,
    light_ratio: f64,
    bounces: u32,
    print: Option<Print>,
    passes: Vec<DmdPass>,
    camera_bundle: Bundle,
    projector_bundle: Bundle,
    /// The optics with the second projector, and its bundle.
    second: Option<(HeadOptics, Bundle)>,
    sights: Vec<Sight>,
    core_exponents: Vec<f32>,
    die: Die,
    rays: RayCaster,
    sensor: Sensor,
    run_seed: u64,
}

/// One pose, prepared for rendering.
pub struct ViewState {
    rates: Rates,
    truth: Vec<CoreTruth>,
}

impl World {
    /// Builds die, head and sensor (about a second on two cores).
    pub fn new(config: &WorldConfig) -> Result<Self, WorldError> {
        config.optics.validate()?;
        let finish = Finish::new(config.surface.clone(), config.spray_edge, config.run_seed)?;
        WorldError::check(
            "bounces",
            f64::from(config.bounces),
            1.0,
            f64::from(MAX_BOUNCES),
        )?;
        let film = Film::new(config.film_um, config.gear.tip_radius_mm, config.run_seed)?;
        config.sensor.validate()?;
        let camera_bundle = Bundle::camera(&config.camera_bundle, config.head_seed)?;
        let projector_bundle = Bundle::projector(&config.projector_bundle, config.head_seed)?;
        // An independent bundle from the same seed.
        let second_bundle = || Bundle::projector(&config.projector_bundle, !config.head_seed);
        let second = config.optics.by_second_projector();
        let second = second
            .map(|optics| Ok::<_, WorldError>((optics, second_bundle()?)))
            .transpose()?;
        WorldError::check("growth", config.growth, 0.9, 1.1)?;
        WorldError::check("vibration_um", config.vibration_um, 0.0, 100.0)?;
        WorldError::check("shiver_um", config.shiver_um, 0.0, 1000.0)?;
        config.form.validate()?;
        let field = WearField::new(&config.gear, &config.wear)?;
        let mut die = match &config.die_mesh {
            Some(_) if !config.wear.is_empty() => {
                return Err(WorldError::WearOnMesh {
                    got: config.wear.len(),
                });
            }
            Some(mesh) => Die::standing(mesh, field, config.form),
            None => Die::as_built(&config.cad, field, config.form)?,
        };
        die.grow(config.growth);
        let mut random = Normals::new(stream(config.head_seed, Purpose::CoreResponse));
        let spread = config.sensor.core_exponent_spread;
        let core_exponents = camera_bundle
            .positions_px()
            .iter()
            .map(|_| (1.0 + spread * random.next().clamp(-3.0, 3.0)) as f32)
            .collect();
        let sensor = Sensor::new(
            &config.sensor,
            config.optics.camera_size_px,
            &camera_bundle,
            config.head_seed,
            config.run_seed,
        );
        Ok(Self {
            cad: config.cad.clone(),
            gear: config.gear.clone(),
            die_mesh: config.die_mesh.clone(),
            growth: config.growth,
            sights: scene::sights(&config.optics, &camera_bundle),
            rays: RayCaster::new(die.mesh()),
            optics: config.optics.clone(),
            driven_head: config.driven_head.clone(),
            head_seed: config.head_seed,
            mount: config.mount.clone(),
            carried: None,
            vibration_um: config.vibration_um,
            shiver_um: config.shiver_um,
            form: config.form,
            sensor_spec: config.sensor.clone(),
            finish,
            film,
            light_ratio: 1.0,
            bounces: config.bounces,
            print: config.print.clone(),
            passes: config.passes.clone(),
            camera_bundle,
            projector_bundle,
            second,
            core_exponents,
            die,
            sensor,
            run_seed: config.run_seed,
        })
    }

    /// Replaces the damage of the die, after more press cycles. Views prepared before show the previous state.
    ///
    /// # Errors
    /// The damage is not possible for this die; it then stays unchanged.
    pub fn wear_to(&mut self, wear: &[Wear]) -> Result<(), WorldError> {
        if self.die_mesh.is_some() {
            return match wear.len() {
                0 => Ok(()),
                got => Err(WorldError::WearOnMesh { got }),
            };
        }
        let field = WearField::new(&self.gear, wear)?;
        let mut die = Die::as_built(&self.cad, field, self.form)?;
        die.grow(self.growth);
        self.rays = RayCaster::new(die.mesh());
        self.die = die;
        Ok(())
    }

    /// Replaces the die by a mesh with the present form error; `None`: by the undamaged CAD. Views prepared before show the previous die.
    ///
    /// # Errors
    /// The drawing is not a valid die.
    pub fn stand(&mut self, mesh: Option<Arc<DieMesh>>) -> Result<(), WorldError> {
        let field = WearField::new(&self.gear, &[])?;
        let mut die = match &mesh {
            Some(mesh) => Die::standing(mesh, field, self.form),
            None => Die::as_built(&self.cad, field, self.form)?,
        };
        die.grow(self.growth);
        self.rays = RayCaster::new(die.mesh());
        self.die = die;
        self.die_mesh = mesh;
        Ok(())
    }

    /// Shifts the cores' image along the rows relative to its design position, px, as a head bends when it warms up. Views
    /// prepared before show the previous state.
    ///
    /// # Errors
    /// The shift is more than [`MAX_SHIFT_PX`].
    pub fn shift_cores(&mut self, shift_px: f64) -> Result<(), WorldError> {
        WorldError::check("shift_px", shift_px, -MAX_SHIFT_PX, MAX_SHIFT_PX)?;
        self.sensor.shift(&self.camera_bundle, shift_px);
        Ok(())
    }

    /// Sets the share of its light that the head passes on, relative to its design: bent bundles lose some. Views prepared before
    /// show the previous state.
    ///
    /// # Errors
    /// No share of 0 to 1.
    pub fn dim(&mut self, light_ratio: f64) -> Result<(), WorldError> {
        WorldError::check("light_ratio", light_ratio, 0.0, 1.0)?;
        self.light_ratio = light_ratio;
        Ok(())
    }

    /// Drives the head's liquid lenses to these counts; `None`: to the setting in its file. Views prepared before show the previous state.
    /// # Errors
    /// The optics are invalid; the present ones are kept.
    pub fn focus(&mut self, counts: Option<u16>) -> Result<(), WorldError> {
        if let Some(head) = &self.driven_head {
            let optics = head.optics(counts, self.head_seed);
            optics.validate()?;
            self.sights = scene::sights(&optics, &self.camera_bundle);
            if let (Some((second, _)), Some(by)) = (&mut self.second, optics.by_second_projector())
            {
                *second = by;
            }
            self.optics = optics;
        }
        Ok(())
    }

    /// Sets the pose of the camera in the die's frame, held by an arm, independent of the stages. Views prepared before show the
    /// previous pose.
    pub fn carry(&mut self, tool_from_camera: Isometry3<f64>) {
        self.carried = Some(tool_from_camera);
    }

    /// Columns and rows of a frame.
    pub fn size_px(&self) -> [usize; 2] {
        self.optics.camera_size_px
    }

    /// Whether the die is in the field of a head raised by `vertical_mm`.
    pub fn sees_die(&self, vertical_mm: f64) -> bool {
        let centre_mm = self
            .mount
            .tool_from_camera(&self.optics, 0.0, vertical_mm)
            .translation
            .vector
            .z;
        // The edge of the field at twice its angle: distortion and blur extend slightly beyond the circle.
        let reach_mm = 2.0 * self.optics.camera_objective.field_radius_mm;
        let heights = || self.die.mesh().vertices.iter().map(|vertex| vertex[2]);
        let (low, high) = heights().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), z| {
            (l.min(z), h.max(z))
        });
        (low - reach_mm..=high + reach_mm).contains(&centre_mm)
    }

    /// The gear of the die.
    pub fn gear(&self) -> &GearSpec {
        &self.gear
    }

    /// The real die.
    pub fn die(&self) -> &Die {
        &self.die
    }

    /// Distance of the die's surface from a point of the drawing along `normal` (a unit vector, tool frame), mm: the nearest
    /// intersection within `reach_mm` on either side, with the die at the temperature of its drawing.
    pub fn surface_along_mm(
        &self,
        point_mm: Point3<f64>,
        normal: Vector3<f64>,
        reach_mm: f64,
    ) -> Option<f64> {
        /// Each ray starts this far behind the point, mm, so that both rays hit a surface through the point itself.
        const START_MM: f64 = 1e-3;
        let along = |direction: Vector3<f64>| {
            let start = self.growth * (point_mm - START_MM * direction).coords;
            let hit = self.rays.nearest_within(
                Point3::from(start),
                self.growth * direction,
                reach_mm + START_MM,
            )?;
            Some(hit.distance - START_MM)
        };
        match (along(normal), along(-normal)) {
            (Some(out), Some(into)) if out.abs() <= into.abs() => Some(out),
            (out, into) => into.map(|mm| -mm).or(out),
        }
    }

    pub fn sensor(&self) -> &SensorSpec {
        &self.sensor_spec
    }

    /// The camera's bundle, with the positions of its cores on the sensor.
    pub fn camera_bundle(&self) -> &Bundle {
        &self.camera_bundle
    }

    /// The projector's bundle, with the positions of its cores on the DMD.
    pub fn projector_bundle(&self) -> &Bundle {
        &self.projector_bundle
    }

    /// Moves the stages to their *true* position and computes the light of every pattern on every pixel.
    ///
    /// `rotation_rad` turns the die, `vertical_mm` raises the head; stage errors are the caller's to add. Pattern `i` of
    /// `patterns` becomes index `i + 1`, index 0 is black; with passes, those of each follow the ones before,
    /// and those of a second projector those of the first. Runs on rayon's threads; the result does not depend on their
    /// number.
    pub fn prepare(
        &self,
        rotation_rad: f64,
        vertical_mm: f64,
        patterns: &[PatternSpec],
    ) -> Result<ViewState, WorldError> {
        WorldError::check("rotation_rad", rotation_rad, -1e6, 1e6)?;
        WorldError::check("vertical_mm", vertical_mm, -1e4, 1e4)?;
        for pattern in patterns {
            pattern.validate()?;
        }
        let frequencies = scene::frequencies(patterns);
        if frequencies.len() > scene::MAX_FREQUENCIES {
            return Err(WorldError::Frequencies {
                got: frequencies.len(),
                max: scene::MAX_FREQUENCIES,
            });
        }
        let tool_from_camera = self.carried.unwrap_or_else(|| {
            let mount = &self.mount;
            mount.tool_from_camera(&self.optics, rotation_rad, vertical_mm)
        });
        let stage = self.stage((rotation_rad, vertical_mm));
        // Every mirror leaks, lit or not; reflected leakage is negligible.
        let all = match self.passes.is_empty() {
            true => stage.look(tool_from_camera, &frequencies),
            false => {
                let direct = Stage {
                    bounces: 1,
                    ..stage
                };
                direct.look(tool_from_camera, &frequencies)
            }
        };
        let leak = self.optics.dmd_leak_ratio as f32;
        let leaked: Vec<f32> = all.iter().map(|view| leak * view.light[0]).collect();
        let mut per_core = vec![self.core_rates(&leaked)];
        let mut shifts_mm = self.shifts_mm(rotation_rad, vertical_mm);
        let mut show = |views: &[CoreView]| {
            for (pattern, shift_mm) in patterns.iter().zip(&mut shifts_mm) {
                let turn_per_mm = pattern.periods * self.turn_per_mm();
                let moved = Moved {
                    shift_rad: turn_per_mm * shift_mm,
                    kept: (-0.5 * (turn_per_mm * 1e-3 * self.shiver_um).powi(2)).exp(),
                };
                let brightness = |(view, leaked): (&CoreView, &f32)| {
                    leaked + scene::brightness(&view.light, pattern, &frequencies, moved)
                };
                let shown: Vec<f32> = views.par_iter().zip(&leaked).map(brightness).collect();
                per_core.push(self.core_rates(&shown));
            }
        };
        if self.passes.is_empty() {
            show(&all);
            if let Some((optics, projector_bundle)) = &self.second {
                let stage = Stage {
                    optics,
                    projector_bundle,
                    ..stage
                };
                show(&stage.look(tool_from_camera, &frequencies));
            }
        }
        for pass in &self.passes {
            let stage = Stage {
                pass: Some(pass),
                ..stage
            };
            show(&stage.look(tool_from_camera, &frequencies));
        }
        let rates = self.sensor.expose(&per_core);
        Ok(ViewState {
            rates,
            truth: all.into_iter().filter_map(|view| view.truth).collect(),
        })
    }

    /// Data of a view at a pose, given by angle and height.
    fn stage(&self, (rotation_rad, vertical_mm): (f64, f64)) -> Stage<'_> {
        Stage {
            optics: &self.optics,
            camera_bundle: &self.camera_bundle,
            projector_bundle: &self.projector_bundle,
            sights: &self.sights,
            die: &self.die,
            rays: &self.rays,
            finish: &self.finish,
            film: self.film.as_ref(),
            bounces: self.bounces,
            print: self.print.as_ref(),
            seed: self.run_seed ^ pose_bits(rotation_rad, vertical_mm),
            pass: None,
        }
    }

    /// Shifts by vibration, for each frame of a view.
    fn shifts_mm(&self, rotation_rad: f64, vertical_mm: f64) -> impl Iterator<Item = f64> {
        let pose = pose_bits(rotation_rad, vertical_mm);
        let mut random = Normals::new(stream(self.run_seed ^ pose, Purpose::Vibration));
        let sigma_mm = 1e-3 * self.vibration_um;
        std::iter::repeat_with(move || sigma_mm * random.next())
    }

    /// Phase change of a pattern of one period per shift across the projector's view in best focus, rad/mm.
    fn turn_per_mm(&self) -> f64 {
        let px_per_mm =
            self.optics.projector.focal_px[0] / self.optics.projector_objective.focus_mm;
        std::f64::consts::TAU * px_per_mm / self.optics.projector_size_px[0] as f64
    }

    /// Charge rate per mean pixel of each core, e⁻/ms, after gain, cross-talk and the core's own response.
    fn core_rates(&self, brightness: &[f32]) -> Vec<f32> {
        // The sensor's rate is stated for reflectance 0.3 and half brightness.
        let rate_e_per_ms = self.light_ratio * self.sensor_spec.rate_e_per_ms;
        let scale = (rate_e_per_ms / (surface::SPRAYED_RATIO * 0.5)) as f32;
        let entering: Vec<[f32; 1]> = brightness.iter().map(|light| [scale * light]).collect();
        let mixed = self.camera_bundle.with_crosstalk(&entering);
        let reference = 2.0 * self.sensor_spec.rate_e_per_ms as f32;
        let bent = |(([light], gain), exponent): ((&[f32; 1], &f32), &f32)| {
            let relative = (light / reference).max(0.0);
            if relative == 0.0 {
                0.0
            } else {
                gain * reference * relative.powf(*exponent)
            }
        };
        mixed
            .par_iter()
            .zip(self.camera_bundle.gains())
            .zip(&self.core_exponents)
            .map(bent)
            .collect()
    }

    /// Renders one frame: 12-bit counts, row by row.
    ///
    /// `frame_counter` seeds the noise: the same counter gives the same frame.
    pub fn render(
        &self,
        view: &ViewState,
        pattern_index: u16,
        exposure_us: u32,
        led_on: bool,
        frame_counter: u32,
        out: &mut [u16],
    ) -> Result<(), WorldError> {
        let need = self.size_px()[0] * self.size_px()[1];
        if out.len() != need {
            return Err(WorldError::Buffer {
                got: out.len(),
                need,
            });
        }
        let pattern = usize::from(pattern_index);
        if pattern >= view.rates.patterns() {
            return Err(WorldError::Pattern {
                got: pattern_index,
                last: view.rates.patterns() - 1,
            });
        }
        let lit_ms = if led_on {
            f64::from(exposure_us) * 1e-3
        } else {
            0.0
        };
        self.sensor
            .read_out(&view.rates, pattern, lit_ms, frame_counter, out);
        Ok(())
    }

    /// Renders one frame with the pattern index that each projector shows during the exposure; `None` if it is dark.
    pub fn expose(
        &self,
        view: &ViewState,
        shown: [Option<u16>; 2],
        exposure_us: u32,
        frame_counter: u32,
        out: &mut [u16],
    ) -> Result<(), WorldError> {
        let projectors = 1 + usize::from(self.second.is_some());
        let last = (view.rates.patterns() - 1) / projectors;
        let mut lit = Vec::new();
        for (before, got) in shown.into_iter().take(projectors).enumerate() {
            match got {
                Some(got) if usize::from(got) > last => {
                    return Err(WorldError::Pattern { got, last });
                }
                Some(0) => lit.push(0),
                Some(got) => lit.push(before * last + usize::from(got)),
                None => {}
            }
        }
        match lit[..] {
            [] => self.render(view, 0, exposure_us, false, frame_counter, out),
            [one] => self.render(view, one as u16, exposure_us, true, frame_counter, out),
            _ => {
                let both = ViewState {
                    rates: self.sensor.together(&view.rates, &lit),
                    truth: Vec::new(),
                };
                self.render(&both, 0, exposure_us, true, frame_counter, out)
            }
        }
    }

    /// True values of a view: one entry per camera core that sees the die.
    pub fn truth<'a>(&self, view: &'a ViewState) -> &'a [CoreTruth] {
        &view.truth
    }
}
