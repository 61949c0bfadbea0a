//! One calibrated head in front of one die at one place, with all cases of damage that are applied there.

use flankscope_gear_cad::Flank as CadFlank;
use flankscope_metrology::tool::{Temperature, Tool};
use flankscope_profilometry::HeadModel;
use flankscope_profilometry::decode::GridKind;
use flankscope_record::baseline::Baseline;
use flankscope_record::document::Feature;
use serde::Serialize;

use super::calibration::{Calibrated, Rig};
use super::capture::{Instrument, Trouble, judged};
use super::cases::{Case, Damaged, Group, Right};
use super::setup::{Place, Setup, flank, own_seed};
use super::truth;
use flankscope_bench::damage::{Damage, Workpiece};
use flankscope_bench::world::{FlankId, Wear, World};

/// Thermal expansion of steel.
const EXPANSION_PER_K: f64 = 11.5e-6;
/// Number of noise seeds that one case may use; the first of a block are the baseline's.
const FRAMES_PER_CASE: u32 = 1 << 8;

/// Description of one block in the results.
#[derive(Clone, Debug, Serialize)]
pub struct BlockReport {
    /// Tooth and height that it views.
    #[serde(flatten)]
    pub(super) place: Place,
    /// Standard uncertainty of a point along the view due to the calibration alone, µm.
    pub depth_sigma_um: f64,
    /// Standard uncertainty of a point across the view due to the calibration alone, µm.
    pub lateral_sigma_um: f64,
    /// Why calibrations of other heads, drawn before this one, were refused.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub refused: Vec<String>,
}

/// One result: its case and row, the true value, and the finding.
pub(super) struct Found {
    pub case: usize,
    pub flank: CadFlank,
    pub truth_um: f64,
    pub feature: Feature,
}

/// A calibrated head at a place.
pub(super) struct Block<'a> {
    setup: &'a Setup,
    seed: u64,
    /// Whether it also captures the cases of every fourth block.
    wholly: bool,
    rig: Rig,
    head: HeadModel,
    /// Why calibrations of other heads, drawn before, were refused.
    refused: Vec<String>,
    place: Place,
}

impl<'a> Block<'a> {
    pub fn new(setup: &'a Setup, number: u32, seed: u64) -> anyhow::Result<Self> {
        let own = own_seed(number, seed);
        let Calibrated { rig, head, refused } = Calibrated::first_of(&setup.made, own)?;
        Ok(Self {
            setup,
            seed: own,
            wholly: number.is_multiple_of(4),
            head: setup.throwing(head),
            rig,
            refused,
            place: Place::of_block(number),
        })
    }

    pub fn report(&self) -> BlockReport {
        let record = self.head.calibration.as_ref();
        BlockReport {
            place: self.place,
            depth_sigma_um: record.map_or(f64::NAN, |r| r.depth_sigma_um),
            lateral_sigma_um: record.map_or(f64::NAN, |r| r.lateral_sigma_um),
            refused: self.refused.clone(),
        }
    }

    /// Captures every case `captures` times.
    pub fn run(&self, cases: &[Case], captures: u32) -> anyhow::Result<Vec<Found>> {
        let mut found = Vec::new();
        let (rectangle, _) = truth::judged(&self.setup.tool(self.place, false))?;
        let drawn = self.setup.world(&self.rig, false, self.seed);
        let flanks = [CadFlank::Left, CadFlank::Right].map(|flank| FlankId {
            tooth: self.place.tooth,
            flank,
        });
        let workpiece = Workpiece::new(&drawn.cad, &drawn.gear, &flanks, rectangle)?;
        // A world is shared by all cases with the same die.
        let mut standing: Option<((bool, [u64; 2]), World, Option<Baseline>)> = None;
        for (index, case) in cases.iter().enumerate() {
            if matches!(case.group, Group::Spoiled | Group::Measure) && !self.wholly {
                continue;
            }
            let kelvin = case.warm.map_or(0.0, |(kelvin, _)| kelvin);
            let [film_um, _] = case.film_um;
            let key = (case.group.is_built(), [kelvin, film_um].map(f64::to_bits));
            if standing.as_ref().is_none_or(|(of, ..)| *of != key) {
                let mut config = self.setup.world(&self.rig, key.0, self.seed);
                config.growth = 1.0 + EXPANSION_PER_K * kelvin;
                config.film_um = film_um;
                standing = Some((key, World::new(&config)?, None));
            }
            let Some((_, world, baseline)) = &mut standing else {
                continue;
            };
            if case.group == Group::Baseline && baseline.is_none() {
                *baseline = Some(self.baseline(world)?);
            }
            let baseline = match case.group {
                Group::Baseline => baseline.clone(),
                _ => None,
            };
            let tool = self.tool(case);
            let degc = case.warm.map(|_| 20.0 + kelvin);
            let tooth = self.place.tooth;
            let instrument = Instrument::new(&tool, &self.head, tooth, case.grid, degc, baseline)?;
            for capture in 0..captures {
                let draw = self.draw(1 + case.number, capture);
                let truths_um = self.damage(world, &workpiece, &tool, case, draw)?;
                let state = instrument.approach(world, draw, case.trouble)?;
                let frames = (1 + case.number) * FRAMES_PER_CASE + capture;
                let outcome = instrument.capture(world, &state, frames, case.trouble)?;
                for (side, truth_um) in [CadFlank::Left, CadFlank::Right].into_iter().zip(truths_um)
                {
                    if side == CadFlank::Right && case.right == Right::Ignored {
                        continue;
                    }
                    found.push(Found {
                        case: index,
                        flank: side,
                        truth_um,
                        feature: judged(&outcome, flank(side))?,
                    });
                }
            }
        }
        Ok(found)
    }

    /// Applies the damage of a case to the die; returns the true values of its left and its right flank, µm.
    fn damage(
        &self,
        world: &mut World,
        workpiece: &Workpiece,
        tool: &Tool,
        case: &Case,
        draw: u64,
    ) -> anyhow::Result<[f64; 2]> {
        let sides = [CadFlank::Left, CadFlank::Right];
        let (rectangle, disc_mm2) = truth::judged(tool)?;
        let tooth = self.place.tooth;
        let damages = match case.damage {
            Damaged::Nothing => {
                world.stand(None)?;
                return Ok([0.0; 2]);
            }
            Damaged::Wear(kind, um) => {
                let wear = [Wear {
                    tooth,
                    flank: CadFlank::Left,
                    depth_mm: 1e-3 * um,
                    kind,
                }];
                world.stand(None)?;
                world.wear_to(&wear)?;
                let mut truths = [0.0; 2];
                for (truth, side) in truths.iter_mut().zip(sides) {
                    *truth = truth::of_wear_um(tool, world.gear(), &wear, (tooth, side))?;
                }
                return Ok(truths);
            }
            Damaged::Spot { area_mm2, depth_um } => {
                [0, 1].map(|side| Damage::spot(2 * draw + side, rectangle, area_mm2, depth_um))
            }
            Damaged::Random(um) => {
                [0, 1].map(|side| Damage::draw(2 * draw + side, rectangle, disc_mm2, um))
            }
        };
        let truths_um = [0, 1].map(|side: usize| damages[side].largest_mean_um(disc_mm2));
        let cut: Vec<(FlankId, Damage)> = sides
            .map(|flank| FlankId { tooth, flank })
            .into_iter()
            .zip(damages)
            .collect();
        world.stand(Some(workpiece.cut(&cut)?))?;
        Ok(truths_um)
    }

    fn tool(&self, case: &Case) -> Tool {
        let mut tool = self.setup.tool(self.place, case.group.is_built());
        if let Some(inspect) = &mut tool.inspect {
            inspect.datum = case.datum;
            [_, inspect.film_um] = case.film_um;
        }
        if case.warm.is_some_and(|(_, known)| known) {
            tool.temperature = Some(Temperature {
                reference_degc: 20.0,
                range_degc: [10.0, 80.0],
                expansion_per_k: EXPANSION_PER_K,
                u_k: 1.0,
            });
        }
        tool
    }

    /// Baseline of the new die by the same head, from one approach.
    fn baseline(&self, world: &mut World) -> anyhow::Result<Baseline> {
        world.stand(None)?;
        let tool = self.setup.tool(self.place, true);
        let tooth = self.place.tooth;
        let instrument = Instrument::new(&tool, &self.head, tooth, GridKind::Core, None, None)?;
        let state = instrument.approach(world, self.draw(0, 0), Trouble::default())?;
        let golden = instrument.capture(world, &state, 0, Trouble::default())?;
        Ok(Baseline {
            tool: tool.name.clone(),
            hashes: std::collections::BTreeMap::new(),
            simulated: true,
            flanks: golden.fields,
            poses: golden.pose.into_iter().collect(),
            in_view: Vec::new(),
        })
    }

    fn draw(&self, case: u32, capture: u32) -> u64 {
        (self.seed << 20) | u64::from(case << 8) | u64::from(capture)
    }
}
