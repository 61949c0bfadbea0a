//! One calibrated head in front of one die at one place, with all cases of damage that are applied there.

use flankscope_gear_cad::Flank as CadFlank;
use flankscope_metrology::tool::{Temperature, Tool};
use flankscope_profilometry::HeadModel;
use flankscope_profilometry::decode::GridKind;
use flankscope_record::baseline::Baseline;
use serde::{Deserialize, Serialize};

use super::calibration::Rig;
use super::capture::{Instrument, Trouble, judged};
use super::cases::{Case, Damaged, Depth, Group, Right};
use super::setup::{Place, Setup, flank, own_seed};
use super::tally::{Found, Sample, budget_um};
use super::truth;
use flankscope_bench::damage::{Damage, Random, Workpiece};
use flankscope_bench::world::{FlankId, Wear, World};

/// Thermal expansion of steel.
const EXPANSION_PER_K: f64 = 11.5e-6;
/// Number of noise seeds that one case may use; the first of a block are the baseline's.
const FRAMES_PER_CASE: u32 = 1 << 8;
/// Purpose of the random numbers that draw depths.
const DEPTHS: u64 = 5;

/// Description of one block in the results.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct BlockReport {
    /// Tooth and height that it views.
    #[serde(flatten)]
    pub(super) place: Place,
    /// Uncertainty by the calibration alone; absent: the calibration was refused.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub calibrated: Option<PointSigma>,
    /// Why the calibration was refused: the head judges nothing.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub refused: Option<String>,
}

/// Standard uncertainty of a point due to the calibration alone.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct PointSigma {
    /// Along the view, µm.
    pub depth_sigma_um: f64,
    /// Across the view, µm.
    pub lateral_sigma_um: f64,
}

/// What a block found, as it is kept.
#[derive(Serialize, Deserialize)]
pub(super) struct Measured {
    pub report: BlockReport,
    pub found: Vec<Found>,
}

/// Which die stands before the head, but for its damage.
#[derive(PartialEq)]
struct Die {
    is_built: bool,
    /// Temperature above that of its CAD.
    kelvin: f64,
    film_um: f64,
}

/// A calibrated head at a place.
pub(super) struct Block<'a> {
    setup: &'a Setup,
    seed: u64,
    /// Whether it also captures the cases of every fourth block.
    wholly: bool,
    rig: Rig,
    head: HeadModel,
    place: Place,
    number: u32,
}

/// Calibrates the head of a block and captures every case. A head whose calibration is refused judges nothing, and counts.
pub(super) fn measured(
    setup: &Setup,
    (number, seed): (u32, u64),
    cases: &[Case],
    captures: u32,
) -> anyhow::Result<Measured> {
    let own = own_seed(number, seed);
    let rig = Rig::new(&setup.made, own);
    let place = Place::of_block(number);
    let head = match rig.calibrated(own) {
        Ok(head) => head,
        Err(error) => {
            return Ok(Measured {
                report: BlockReport {
                    place,
                    calibrated: None,
                    refused: Some(error.to_string()),
                },
                found: Vec::new(),
            });
        }
    };
    let block = Block {
        setup,
        seed: own,
        wholly: number.is_multiple_of(4),
        head: setup.throwing(head),
        rig,
        place,
        number,
    };
    Ok(Measured {
        report: block.report(),
        found: block.run(cases, captures)?,
    })
}

impl Block<'_> {
    fn report(&self) -> BlockReport {
        let record = self.head.calibration.as_ref();
        BlockReport {
            place: self.place,
            calibrated: record.map(|record| PointSigma {
                depth_sigma_um: record.depth_sigma_um,
                lateral_sigma_um: record.lateral_sigma_um,
            }),
            refused: None,
        }
    }

    /// Captures every case `captures` times.
    fn run(&self, cases: &[Case], captures: u32) -> anyhow::Result<Vec<Found>> {
        let mut found = Vec::new();
        let (rectangle, _) = truth::judged(&self.setup.tool(self.place, false))?;
        let drawn = self.setup.world(&self.rig, false, self.seed);
        let flanks = [CadFlank::Left, CadFlank::Right].map(|flank| FlankId {
            tooth: self.place.tooth,
            flank,
        });
        let workpiece = Workpiece::new(&drawn.cad, &drawn.gear, &flanks, rectangle)?;
        // A world is shared by all cases with the same die.
        let mut standing: Option<(Die, World, Option<Baseline>)> = None;
        for (index, case) in cases.iter().enumerate() {
            if matches!(case.group, Group::Spoiled | Group::Measure) && !self.wholly {
                continue;
            }
            let kelvin = case.warm.map_or(0.0, |(kelvin, _)| kelvin);
            let die = Die {
                is_built: case.group.is_built(),
                kelvin,
                film_um: case.film_um[0],
            };
            if standing.as_ref().is_none_or(|(of, ..)| *of != die) {
                let mut config = self.setup.world(&self.rig, die.is_built, self.seed);
                config.growth = 1.0 + EXPANSION_PER_K * kelvin;
                config.film_um = die.film_um;
                standing = Some((die, World::new(&config)?, None));
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
            for capture in 0..captures * case.times {
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
                    let feature = judged(&outcome, flank(side))?;
                    found.push(Found {
                        case: index,
                        is_right: side == CadFlank::Right,
                        sample: Sample::new(self.number, truth_um, &feature),
                        budget_um: budget_um(&feature),
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
        let depth_um = |depth: Depth, side: u64| match depth {
            Depth::Fixed(um) => um,
            Depth::DrawnTo(um) => um * Random::new(2 * draw + side, DEPTHS).uniform(),
        };
        let damages = match case.damage {
            Damaged::Nothing => {
                world.stand(None)?;
                return Ok([0.0; 2]);
            }
            Damaged::Wear(kind, depth) => {
                let wear = [Wear {
                    tooth,
                    flank: CadFlank::Left,
                    depth_mm: 1e-3 * depth_um(depth, 0),
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
            Damaged::Random(depth) => [0, 1].map(|side| {
                let um = depth_um(depth, side);
                Damage::draw(2 * draw + side, rectangle, disc_mm2, um)
            }),
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
        if case.by_class {
            tool.as_built_um = Some(self.setup.class_um());
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
            approaches: None,
        })
    }

    fn draw(&self, case: u32, capture: u32) -> u64 {
        (self.seed << 20) | u64::from(case << 8) | u64::from(capture)
    }
}
