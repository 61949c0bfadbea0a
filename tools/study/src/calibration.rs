//! Heads as described by their own calibration: the demo target is captured, its dots are found, all unknowns adjusted.

use std::sync::Arc;

use anyhow::Context;
use flankscope_foundation::date::Date;
use flankscope_profilometry::calibrate::cores::{self, FlatField};
use flankscope_profilometry::calibrate::{Sighting, adjust};
use flankscope_profilometry::cloud::CellColumn;
use flankscope_profilometry::decode::GridKind;
use flankscope_profilometry::head::{ApartRecord, CalibrationRecord};
use flankscope_profilometry::{Accumulator, DecodeOptions, Decoder, HeadModel};

use super::capture::add_all;
use flankscope_bench::world::{HeadDesign, HeadOptics, PatternSpec, World};
use flankscope_demo::{self as demo, TargetView};

/// Residual distortion of the lenses beyond the distortion model: root mean square, µm.
pub(super) const LENS_ERROR_UM: f64 = 2.0;
/// Standard uncertainty of stages with errors of ±15 mdeg and ±5 µm, rectangular distribution.
const STAGE_SIGMA: [f64; 2] = [
    15e-3 * std::f64::consts::PI / 180.0 / 1.732_050_807_568_877_2,
    5e-3 / 1.732_050_807_568_877_2,
];

/// Number of views for comparing two projectors.
const APART_VIEWS: usize = 4;

/// Largest number of heads that are tried if calibrations are refused.
const ATTEMPTS: u64 = 8;

/// A head and its calibration.
pub(super) struct Calibrated {
    pub rig: Rig,
    pub head: HeadModel,
}

impl Calibrated {
    /// The first head drawn from `seed` whose calibration is accepted. The calibration refuses results that it does not trust;
    /// the next head is then used.
    pub fn first_of(made: &HeadDesign, seed: u64) -> anyhow::Result<Self> {
        let mut refused = Vec::new();
        for attempt in 0..ATTEMPTS {
            let own = seed | (attempt << 40);
            let rig = Rig::new(made, own);
            match rig.calibrated(own) {
                Ok(head) => return Ok(Self { rig, head }),
                Err(error) => refused.push(error.to_string()),
            }
        }
        anyhow::bail!("no head could be calibrated: {}", refused.join("; "))
    }
}

/// The true head for a calibration.
pub(super) struct Rig {
    made: HeadDesign,
    /// Its true lenses.
    pub optics: HeadOptics,
    /// Seed of its cores, gains and lenses.
    pub head_seed: u64,
}

impl Rig {
    /// A head with the individual properties of `head_seed`.
    pub fn new(made: &HeadDesign, head_seed: u64) -> Self {
        let mut optics = made.optics();
        optics.make_uneven(LENS_ERROR_UM, head_seed);
        Self {
            made: made.clone(),
            optics,
            head_seed,
        }
    }

    /// The head by its calibration; `seed` draws the deviations of the target's plates, the stages' errors and the noise. The
    /// head file contains the record of the calibration.
    pub fn calibrated(&self, seed: u64) -> anyhow::Result<HeadModel> {
        let target = demo::target_of(&self.made);
        let mut config = demo::target_world(&target, seed);
        self.made.impose(&mut config);
        config.optics = self.optics.clone();
        config.head_seed = self.head_seed;
        config.run_seed = seed;
        let world = World::new(&config)?;
        let views = demo::target_views(&target, seed, &target.beside[..2]);
        let patterns = demo::drawn_head_of(&self.made).patterns()?;
        let shown = PatternSpec::of_head(&self.made.pattern_set, &self.made.fringes);
        let patterns = patterns.context("the head names no patterns")?;
        let shown = shown.context("patterns of the bench")?;
        let sets: Vec<(f64, u32)> = patterns.sets.iter().map(|s| (s.periods, s.steps)).collect();
        let exposures_us = [target.exposure_us];
        let decoder = |head: &HeadModel, options| {
            Decoder::new(head, &patterns, &exposures_us, options).context("the target's patterns")
        };
        let sums = |decoder: &Decoder, view: &TargetView| -> anyhow::Result<Accumulator> {
            let [rotation, vertical] = view.true_pose;
            let state = world.prepare(rotation, vertical, &shown)?;
            let mut sums = decoder.begin();
            add_all(&mut sums, decoder, &sets, |light, _, i, pixels| {
                let number = view.first_frame + i;
                Ok(world.expose(&state, light, target.exposure_us, number, pixels)?)
            })?;
            Ok(sums)
        };

        // The bundle's cores are found on the blank plate, independent of the drawing.
        let blank = views.first().context("the target has no blank plate")?;
        let mut start = demo::drawn_head_of(&self.made);
        let without_circle = HeadModel {
            image_circle: None,
            second_projector: None,
            ..start.clone()
        };
        let by_pixel = DecodeOptions {
            grid: GridKind::Pixel,
            binning: 1,
            ..DecodeOptions::for_head(&without_circle)
        };
        let offset_dn = start.sensor.context("the head has no sensor")?.offset_dn;
        let flat = sums(&decoder(&without_circle, by_pixel)?, blank)?;
        start.core_map = Some(Arc::new(cores::find(&FlatField::from_view(
            &flat, offset_dn,
        )?)?));

        let by_core = decoder(&start, DecodeOptions::for_head(&start))?;
        let blank = by_core.columns_of_each(&sums(&by_core, blank)?)?;
        let flat = |cells: &Vec<CellColumn>| cells.iter().map(|cell| cell.mean_e).collect();
        let flat: Vec<Vec<f64>> = blank.iter().map(flat).collect();
        let (mut sightings, mut seen) = (Vec::new(), Vec::new());
        for (number, view) in views.iter().enumerate() {
            let Some(plate) = view.plate else { continue };
            let lit = by_core.columns_of_each(&sums(&by_core, view)?)?;
            let sighting = Sighting::new(number, plate, view.told, &lit, &flat, &target, &start)?;
            // No plate is withheld for testing here: some dozen unknowns cannot overfit tens of thousands of cells.
            if seen.len() < APART_VIEWS {
                seen.push((sighting.clone(), lit));
            }
            sightings.push(sighting);
        }
        let adjusted = adjust(&start, &target, &sightings, STAGE_SIGMA)?;
        let mut head = adjusted.head.clone();
        let day: Date = "2026-01-01".parse().context("a day")?;
        head.calibration = Some(CalibrationRecord::new(
            &adjusted,
            &head,
            &target.name,
            [None, None],
            ApartRecord::from_views(&adjusted, &target, &seen),
            day,
            90,
        ));
        Ok(head)
    }
}
