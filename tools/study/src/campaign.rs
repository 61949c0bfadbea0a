//! Random damage measured through frames: shapes that were not used for tuning, compared with the exact distance of die and drawing.

use flankscope_gear_cad::Flank;
use flankscope_profilometry::decode::GridKind;
use flankscope_record::document::Feature;

use super::calibration::Calibrated;
use super::capture::{Instrument, Trouble, judged};
use super::setup::{Place, Setup, flank, on_all_cores, own_seed};
use super::truth;
use flankscope_bench::damage::{Damage, Random, Workpiece};
use flankscope_bench::world::{FlankId, World};
use flankscope_bench::zones::{Judged, ZoneTruth, compare};

/// Number of damages per calibrated head, two at a time: one on each flank of a tooth.
const PER_HEAD: u32 = 76;
/// True depths are uniformly distributed up to this, µm.
const DEEPEST_UM: f64 = 120.0;

/// One damage, its true values, and the finding.
#[derive(Clone, Debug)]
pub struct Judgement {
    pub shape: &'static str,
    /// True values in the zone, by exact distances.
    pub truth: ZoneTruth,
    /// Result of the instrument.
    pub found: Feature,
}

/// Cuts `count` random damages into dies that otherwise follow the drawing, and judges each from frames. Heads are calibrated on
/// the bench, one for every 76 damages, each at its own place.
///
/// # Errors
/// The bench or the instrument returns an error.
pub fn random_damages(
    count: u32,
    seed: u64,
    tell: impl Fn(&str) + Sync,
) -> anyhow::Result<Vec<Judgement>> {
    let setup = Setup::load(None)?;
    let of_heads = on_all_cores(count.div_ceil(PER_HEAD), |number| {
        let views = PER_HEAD.min(count - PER_HEAD * number).div_ceil(2);
        let found = of_head(&setup, number, views, seed)?;
        tell(&format!("head {}: {} damages", number + 1, found.len()));
        Ok(found)
    })?;
    Ok(of_heads.into_iter().flatten().collect())
}

fn of_head(setup: &Setup, number: u32, views: u32, seed: u64) -> anyhow::Result<Vec<Judgement>> {
    let own = own_seed(number, seed);
    let Calibrated { rig, head, .. } = Calibrated::first_of(&setup.made, own)?;
    let place = Place::of_block(number);
    let tool = setup.tool(place, false);
    let instrument = Instrument::new(&tool, &head, place.tooth, GridKind::Core, None, None)?;
    let config = setup.world(&rig, false, own);
    let (rectangle, disc_area_mm2) = truth::judged(&tool)?;
    let base = config.gear.base_radius_mm();
    let flanks = [Flank::Left, Flank::Right].map(|flank| FlankId {
        tooth: place.tooth,
        flank,
    });
    let zone = Judged {
        cad: config.cad.clone(),
        gear: config.gear.clone(),
        flanks: flanks.to_vec(),
        radius_mm: rectangle
            .profile_mm
            .map(|profile| (base * base + 2.0 * base * profile).sqrt()),
        height_mm: rectangle.height_mm,
        disc_area_mm2,
    };
    let mut world = World::new(&config)?;
    let workpiece = Workpiece::new(&config.cad, &config.gear, &flanks, rectangle)?;
    let mut all = Vec::new();
    for view in 0..views {
        let draw = |what: u32| (own << 24) | u64::from(8 * view + what);
        let damages = [0, 1].map(|side| {
            let target_um = DEEPEST_UM * Random::new(draw(side), 5).uniform();
            Damage::draw(draw(side), rectangle, disc_area_mm2, target_um)
        });
        let cut: Vec<(FlankId, Damage)> = flanks.into_iter().zip(damages.clone()).collect();
        world.stand(Some(workpiece.cut(&cut)?))?;
        let state = instrument.approach(&world, draw(2), Trouble::default())?;
        let outcome = instrument.capture(&world, &state, view, Trouble::default())?;
        let truths = compare(&world, &zone);
        for (id, damage) in cut {
            all.push(Judgement {
                shape: damage.name(),
                truth: truths.get(&id).copied().unwrap_or_default(),
                found: judged(&outcome, flank(id.flank))?,
            });
        }
    }
    Ok(all)
}
