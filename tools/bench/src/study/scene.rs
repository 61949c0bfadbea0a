//! One die and its captures, in blocks.

use anyhow::Context;
use flankscope_gear_cad::Flank as CadFlank;
use flankscope_metrology::gear::Flank;
use flankscope_metrology::tool::{Temperature, Tool};
use flankscope_profilometry::HeadModel;
use flankscope_station::baseline::Baseline;
use flankscope_station::inspection::Feature;
use rayon::prelude::*;

use super::TOOTH;
use super::capture::{CALIBRATION_PX, DRIFT_PX, Instrument, calibrated, judged};
use super::cases::Case;
use super::tally::Cell;
use super::truth::truth_um;
use crate::demo;
use crate::world::{Wear, World};

/// Stage positions and calibrations of a block; each calibration looks once from each position.
const POSITIONS: u32 = 2;
const CALIBRATIONS: u32 = 4;
pub(super) const BLOCK: u32 = POSITIONS * CALIBRATIONS;
/// Steel.
const EXPANSION_PER_K: f64 = 11.5e-6;

/// A die, and what the instrument believes of it.
pub(super) struct Scene<'a> {
    cases: &'a [&'a Case],
    truths_um: Vec<f64>,
    /// What all its cases share.
    setup: &'a Case,
    tool: Tool,
    head: &'a HeadModel,
    world: World,
    /// The die before it was damaged, where a baseline is taken of it.
    fresh: Option<World>,
    degc: Option<f64>,
    seed: u64,
}

impl<'a> Scene<'a> {
    /// The die of `cases`, which differ only in the flank and its damage.
    pub fn new(
        cases: &'a [&'a Case],
        plain: &Tool,
        head: &'a HeadModel,
        seed: u64,
    ) -> anyhow::Result<Self> {
        let setup = *cases.first().context("a scene without a case")?;
        let mut tool = plain.clone();
        if let Some(inspect) = &mut tool.inspect {
            inspect.datum = setup.datum;
        }
        let (kelvin, known) = setup.warm.unwrap_or((0.0, true));
        if setup.warm.is_some() && known {
            tool.temperature = Some(Temperature {
                reference_degc: 20.0,
                range_degc: [10.0, 80.0],
                expansion_per_k: EXPANSION_PER_K,
                u_k: 1.0,
            });
        }
        let mut config = demo::world_of(&tool, head)?;
        config.run_seed = seed;
        config.growth = 1.0 + EXPANSION_PER_K * kelvin;
        let fresh = setup.baseline.then(|| World::new(&config)).transpose()?;
        config.wear = cases
            .iter()
            .filter_map(|case| {
                let (kind, um) = case.wear?;
                Some(Wear {
                    tooth: TOOTH,
                    flank: case.flank,
                    depth_mm: um * 1e-3,
                    kind,
                })
            })
            .collect();
        let truths_um = cases
            .iter()
            .map(|case| truth_um(&tool, &config.gear, &config.wear, case.flank))
            .collect::<anyhow::Result<_>>()?;
        Ok(Self {
            cases,
            truths_um,
            setup,
            tool,
            head,
            world: World::new(&config)?,
            fresh,
            degc: setup.warm.map(|_| 20.0 + kelvin),
            seed,
        })
    }

    /// What all captures of a study of `whole` per row say, case by case. Blocks run on all threads; what they find does not
    /// depend on it.
    pub fn cells(&self, whole: u32) -> anyhow::Result<Vec<Cell>> {
        let captures = self.setup.captures(whole);
        let blocks: Vec<Vec<Vec<Feature>>> = (0..captures.div_ceil(BLOCK))
            .into_par_iter()
            .map(|block| self.block(block, captures))
            .collect::<anyhow::Result<_>>()?;
        let mut cells: Vec<Cell> = self
            .cases
            .iter()
            .zip(&self.truths_um)
            .map(|(case, &truth)| Cell::new(case, truth))
            .collect();
        for capture in blocks.iter().flatten() {
            for (cell, feature) in cells.iter_mut().zip(capture) {
                cell.add(feature);
            }
        }
        Ok(cells)
    }

    /// The captures of one block, of `captures` in all: for each, what was found of every case.
    fn block(&self, block: u32, captures: u32) -> anyhow::Result<Vec<Vec<Feature>>> {
        let first = block * BLOCK;
        let count = BLOCK.min(captures - first);
        let instruments: Vec<Instrument> = (0..count.min(CALIBRATIONS))
            .map(|i| self.instrument(block * CALIBRATIONS + i))
            .collect::<anyhow::Result<_>>()?;
        let trouble = self.setup.trouble;
        let mut found = Vec::new();
        for position in 0..count.div_ceil(CALIBRATIONS) {
            let Some(any) = instruments.first() else {
                break;
            };
            let draw = self.draw(Drawn::Position, block * POSITIONS + position);
            let state = any.approach(&self.world, draw, trouble)?;
            let from = position * CALIBRATIONS;
            for (number, instrument) in (first + from..first + count).zip(&instruments) {
                let number = self.frame_number(number);
                let outcome = instrument.capture(&self.world, &state, number, trouble)?;
                let of = |case: &&Case| judged(&outcome, flank(case.flank));
                found.push(self.cases.iter().map(of).collect::<anyhow::Result<_>>()?);
            }
        }
        Ok(found)
    }

    /// An instrument with a drawn calibration, and a baseline where the cases want one.
    fn instrument(&self, calibration: u32) -> anyhow::Result<Instrument> {
        let draw = self.draw(Drawn::Calibration, calibration);
        let head = calibrated(self.head, draw, CALIBRATION_PX);
        let believes = |head: &HeadModel, baseline| {
            Instrument::new(&self.tool, head, self.setup.grid, self.degc, baseline)
        };
        let Some(fresh) = &self.fresh else {
            return believes(&head, None);
        };
        // With its own stage errors and noise, as on another day.
        let drift = self.draw(Drawn::Drift, calibration);
        let before = believes(&calibrated(&head, drift, DRIFT_PX), None)?;
        let position = self.draw(Drawn::PositionBefore, calibration);
        let state = before.approach(fresh, position, self.setup.trouble)?;
        let number = self.frame_number(FRAMES_PER_CASE / 2 + calibration);
        let golden = before.capture(fresh, &state, number, self.setup.trouble)?;
        believes(
            &head,
            Some(Baseline {
                tool: self.tool.name.clone(),
                hashes: std::collections::BTreeMap::new(),
                simulated: Some(true),
                flanks: golden.fields,
                poses: golden.pose.into_iter().collect(),
            }),
        )
    }

    fn draw(&self, what: Drawn, index: u32) -> u64 {
        (self.seed << 44)
            | (u64::from(self.setup.number) << 36)
            | ((what as u64) << 32)
            | u64::from(index)
    }

    fn frame_number(&self, index: u32) -> u32 {
        (1 + self.setup.number) * FRAMES_PER_CASE + index
    }
}

/// Numbers for the frames' noise that one case may use.
const FRAMES_PER_CASE: u32 = 1 << 16;

/// What a number is drawn for.
#[derive(Clone, Copy)]
enum Drawn {
    Position,
    Calibration,
    Drift,
    PositionBefore,
}

fn flank(of_cad: CadFlank) -> Flank {
    match of_cad {
        CadFlank::Left => Flank::Left,
        CadFlank::Right => Flank::Right,
    }
}
