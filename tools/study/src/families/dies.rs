//! The dies of each family: their damage drawn at random, and its true figures where a closed form gives them.

use std::collections::{BTreeMap, BTreeSet};
use std::f64::consts::{FRAC_PI_2, PI};

use flankscope_bench::damage::{Random, Rectangle, largest_mean_um};
use flankscope_bench::world::{CoreTruth, FlankId};
use flankscope_gear_cad::{Flank, GearSpec, Mesh};
use flankscope_tests::die::{Fine, Place, bore};

use super::{Family, LIMIT_UM};
use crate::setup::FLANKS_UM;
use crate::stand::Stand;
use crate::structure::{Plan, Section, Structure, cut, cut_into, profile_mm};

/// Greatest depth of an opening, mm: the gap to the opposite flank is 1.5 mm wide.
const DEEPEST_MM: f64 = 0.4;
/// Roughness of a sound flank, standard deviation, and its grain, mm.
const ROUGH_MM: f64 = 3e-3;
const GRAIN_MM: f64 = 0.03;
/// Largest depth of an opening over its width: what the estimator supposes (three), exceeded by two thirds.
const DEEPEST_PER_WIDTH: f64 = 5.0;
/// Least length and width of a patch of texture, mm: about half a disc.
const SMALLEST_PATCH_MM: f64 = 0.3;
/// Raster of the true values of hairlines, mm.
const RASTER_MM: f64 = 0.01;
/// A point of a flank is in view if a core's light falls into a square of this size, mm, which is larger than the cores' spacing on it.
const SEEN_MM: f64 = 0.1;

/// A die, and the true wear of its two judged flanks if known in closed form, µm.
pub(super) struct Die {
    pub what: String,
    pub mesh: Mesh,
    pub truths_um: Option<[f64; 2]>,
    /// Damage of a neighbour.
    pub beside: Option<Beside>,
}

/// Damage of a neighbour of the judged tooth.
pub(super) struct Beside {
    id: FlankId,
    /// Loss of its flank, µm; infinite if the tooth is missing.
    loss_um: f64,
    /// The damage is above this height, mm.
    from_mm: f64,
}

impl Beside {
    /// The largest mean loss over a disc, for the part of the flank that camera and projector see, µm: parts facing away from
    /// them, or beyond the projector circle in the head file, are not in view and count as no loss.
    pub(super) fn in_view_um(&self, stand: &Stand, lit: &[CoreTruth]) -> f64 {
        if self.loss_um.is_infinite() {
            return f64::INFINITY;
        }
        let base_mm = stand.gear().base_radius_mm();
        let judged = stand.judged;
        let cell = |profile_mm: f64, height_mm: f64| {
            let [from, low] = [judged.profile_mm[0], judged.height_mm[0]];
            [profile_mm - from, height_mm - low].map(|mm| (mm / SEEN_MM).floor() as i64)
        };
        let on_flank = |truth: &&CoreTruth| {
            let [_, _, height_mm] = truth.point_tool_mm;
            truth.lit
                && stand.is_in_projector_circle(truth.projector_px)
                && truth.flank == Some(self.id)
                && height_mm >= self.from_mm
        };
        let seen: BTreeSet<[i64; 2]> = lit
            .iter()
            .filter(on_flank)
            .map(|truth| {
                let [x, y, height_mm] = truth.point_tool_mm;
                let profile_mm = (x * x + y * y - base_mm * base_mm) / (2.0 * base_mm);
                cell(profile_mm, height_mm)
            })
            .collect();
        largest_mean_um(
            judged,
            stand.disc_area_mm2,
            SEEN_MM,
            |profile, height| match seen.contains(&cell(profile, height)) {
                true => 1e-3 * self.loss_um,
                false => 0.0,
            },
        )
    }
}

pub(super) fn die(family: Family, random: &mut Random, stand: &Stand) -> Die {
    match family {
        Family::Texture => structured(random, stand, texture),
        Family::Opening => structured(random, stand, opening),
        Family::BothSides => both_sides(random, stand),
        Family::Neighbours => neighbours(random, stand),
        Family::Scale => scaled(random, stand),
        Family::Hairlines => hairlines(random, stand),
        Family::Rough => rough(random, stand),
        Family::Class7 => class7(random, stand),
        Family::Scoring => on_wear(random, stand, scoring),
        Family::PitRows => on_wear(random, stand, pit_rows),
        Family::WornDatum => worn_datum(random),
        Family::OppositeAndLocal => opposite_and_local(random, stand),
    }
}

/// A random number between two, uniform in its logarithm.
fn log_between(random: &mut Random, low: f64, high: f64) -> f64 {
    low * (high / low).powf(random.uniform())
}

/// True with a probability in percent.
fn chance(random: &mut Random, percent: f64) -> bool {
    100.0 * random.uniform() < percent
}

fn sign(random: &mut Random) -> f64 {
    if chance(random, 50.0) { 1.0 } else { -1.0 }
}

/// A die with a structure on both judged flanks.
fn structured(
    random: &mut Random,
    stand: &Stand,
    draw: impl Fn(&mut Random, Rectangle) -> Structure,
) -> Die {
    let (judged, area_mm2) = (stand.judged, stand.disc_area_mm2);
    let cuts = stand.flanks().map(|id| {
        let target_um = log_between(random, LIMIT_UM + 2.0, 160.0);
        let shape = draw(random, judged);
        let deepest_mm = DEEPEST_MM.min(DEEPEST_PER_WIDTH * shape.width_mm);
        (id, shape.scaled_to(target_um, judged, area_mm2, deepest_mm))
    });
    let words = cuts.map(|(_, of)| {
        let pitch = of
            .pitch_mm
            .map_or(String::new(), |mm| format!(" every {mm:.3}"));
        format!(
            "{:?} {:?} {:.3} mm wide{pitch}, {:.0} um deep on {:.2} x {:.2} mm",
            of.plan,
            of.section,
            of.width_mm,
            1e3 * of.depth_mm,
            of.within.profile_mm[1] - of.within.profile_mm[0],
            of.within.height_mm[1] - of.within.height_mm[0]
        )
    });
    Die {
        what: words.join(" | "),
        mesh: cut(stand.gear(), &cuts),
        truths_um: Some(cuts.map(|(_, of)| of.largest_mean_um(judged, area_mm2))),
        beside: None,
    }
}

/// A structure all over each judged flank, on wear that is even or slopes along the profile.
fn on_wear(
    random: &mut Random,
    stand: &Stand,
    draw: impl Fn(&mut Random, Rectangle) -> Structure,
) -> Die {
    let judged = stand.judged;
    let flanks = stand.flanks();
    let cuts = flanks.map(|id| (id, draw(random, judged)));
    let bases = flanks.map(|_| {
        let even_um = match chance(random, 50.0) {
            true => 0.0,
            false => random.between(0.0, 45.0),
        };
        let slope_um_per_mm = match chance(random, 70.0) {
            true => 0.0,
            false => random.between(-20.0, 20.0),
        };
        [even_um, slope_um_per_mm].map(|um| 1e-3 * um)
    });
    let middle_mm = 0.5 * (judged.profile_mm[0] + judged.profile_mm[1]);
    let base_mm =
        |side: usize, profile_mm: f64| bases[side][0] + bases[side][1] * (profile_mm - middle_mm);
    let gear = stand.gear();
    let mesh = cut_into(gear, &cuts, |at| {
        let (tooth, flank) = (at.tooth, at.flank);
        let side = flanks.iter().position(|id| *id == FlankId { tooth, flank });
        side.map_or(0.0, |side| base_mm(side, profile_mm(gear, at)))
    });
    let truths_um = [0, 1].map(|side| {
        let structure = cuts[side].1;
        let raster_mm = (structure.width_mm / 8.0).max(4e-3);
        largest_mean_um(judged, stand.disc_area_mm2, raster_mm, |profile, height| {
            base_mm(side, profile) + structure.loss_mm(profile, height)
        })
    });
    let words = [0, 1].map(|side| {
        let (of, [even, slope]) = (cuts[side].1, bases[side]);
        format!(
            "{:?} {:.3} mm wide every {:.3}, {:.0} um deep on {:.0} um and {:.0} um/mm",
            of.plan,
            of.width_mm,
            of.pitch_mm.unwrap_or(f64::NAN),
            1e3 * of.depth_mm,
            1e3 * even,
            1e3 * slope
        )
    });
    Die {
        what: words.join(" | "),
        mesh,
        truths_um: Some(truths_um),
        beside: None,
    }
}

fn scoring(random: &mut Random, judged: Rectangle) -> Structure {
    let askew = match chance(random, 50.0) {
        true => 0.0,
        false => random.between(-10.0, 10.0).to_radians(),
    };
    let angle = match chance(random, 30.0) {
        true => random.between(0.0, PI),
        false => askew,
    };
    // Oblique ones are cut equally finely along and across: narrower ones would need too large a mesh.
    let finest_mm = if angle == 0.0 { 0.02 } else { 0.03 };
    let width_mm = log_between(random, finest_mm, 0.12);
    let pitch_mm = width_mm * log_between(random, 1.2, 10.0);
    Structure {
        plan: Plan::Line(angle),
        section: Section::Flat,
        width_mm,
        pitch_mm: Some(pitch_mm),
        depth_mm: DEEPEST_MM.min(width_mm * random.between(1.0, 10.0)),
        at_mm: [
            judged.profile_mm[0] + random.uniform() * pitch_mm,
            judged.height_mm[0],
        ],
        within: judged,
    }
}

fn pit_rows(random: &mut Random, judged: Rectangle) -> Structure {
    let width_mm = log_between(random, 0.03, 0.08);
    let pitch_mm = width_mm * random.between(1.05, 2.0);
    Structure {
        plan: Plan::Rows(width_mm * random.between(1.5, 6.0)),
        section: Section::Flat,
        width_mm,
        pitch_mm: Some(pitch_mm),
        depth_mm: DEEPEST_MM.min(width_mm * random.between(3.0, 10.0)),
        at_mm: [
            judged.profile_mm[0] + random.uniform() * pitch_mm,
            judged.height_mm[0] + random.uniform() * pitch_mm,
        ],
        within: judged,
    }
}

fn worn_datum(random: &mut Random) -> Die {
    let worn_um = random.between(30.0, 70.0);
    let other_um = random.between(-20.0, worn_um);
    let is_left = chance(random, 50.0);
    let mesh = by_flank(|id| match (id.flank == Flank::Left) == is_left {
        true => worn_um,
        false => other_um,
    });
    Die {
        what: format!(
            "one side of all teeth and its band worn {worn_um:.0}, the other {other_um:.0}"
        ),
        mesh,
        truths_um: None,
        beside: None,
    }
}

fn opposite_and_local(random: &mut Random, stand: &Stand) -> Die {
    let opposite_um = random.between(10.0, 45.0);
    let target_um = random.between(LIMIT_UM + 1.0, 70.0);
    let is_left = chance(random, 50.0);
    let [low, high] = stand.judged.height_mm;
    let middle_mm = random.between(low + 1.0, high - 1.0);
    let tooth = stand.place.tooth;
    let worn = |at: Place| (at.flank == Flank::Left) == is_left;
    let loss = |at: Place| {
        let local = at.tooth == tooth && at.height_mm < middle_mm;
        1e-3 * match (worn(at), local) {
            (true, true) => target_um,
            (true, false) => opposite_um,
            (false, _) => -opposite_um,
        }
    };
    let fine = stand.flanks().map(|id| whole(id, stand.judged, 0.1));
    Die {
        what: format!("opposite {opposite_um:.0}, together {target_um:.0} below {middle_mm:.1} mm"),
        mesh: bore(loss, &fine),
        truths_um: None,
        beside: None,
    }
}

fn section(random: &mut Random) -> Section {
    match (3.0 * random.uniform()) as u32 {
        0 => Section::Flat,
        1 => Section::Vee,
        _ => Section::Round,
    }
}

/// One third each along, across and at a random angle.
fn line(random: &mut Random) -> Plan {
    Plan::Line(match (3.0 * random.uniform()) as u32 {
        0 => 0.0,
        1 => FRAC_PI_2,
        _ => random.between(0.0, PI),
    })
}

fn texture(random: &mut Random, judged: Rectangle) -> Structure {
    let plan = if chance(random, 30.0) {
        Plan::Pit
    } else {
        line(random)
    };
    // Wider pits: the mesh is equally fine along and across.
    let finest_mm = match plan {
        Plan::Line(angle) if angle == 0.0 || angle == FRAC_PI_2 => 0.03,
        Plan::Line(_) | Plan::Pit | Plan::Rows(_) => 0.04,
    };
    let width_mm = log_between(random, finest_mm, 0.11);
    let pitch_mm = width_mm * random.between(1.1, 2.2);
    let mut part = |[low, high]: [f64; 2]| {
        let length_mm = log_between(random, SMALLEST_PATCH_MM, 2.4).min(high - low);
        let from_mm = random.between(low, high - length_mm);
        [from_mm, from_mm + length_mm]
    };
    let within = Rectangle {
        profile_mm: part(judged.profile_mm),
        height_mm: part(judged.height_mm),
    };
    let middle_mm = 0.5 * (within.height_mm[0] + within.height_mm[1]);
    Structure {
        plan,
        section: section(random),
        width_mm,
        pitch_mm: Some(pitch_mm),
        depth_mm: 0.0,
        at_mm: [
            within.profile_mm[0] + random.uniform() * pitch_mm,
            middle_mm,
        ],
        within,
    }
}

fn opening(random: &mut Random, judged: Rectangle) -> Structure {
    let plan = if chance(random, 30.0) {
        Plan::Pit
    } else {
        line(random)
    };
    let width_mm = match plan {
        Plan::Line(_) => log_between(random, 0.08, 0.35),
        Plan::Pit | Plan::Rows(_) => log_between(random, 0.25, 0.8),
    };
    // Anywhere, across the rim too: draws that kept away from it once hid that the verdict did not look there.
    let at_mm = [judged.profile_mm, judged.height_mm].map(|[low, high]| random.between(low, high));
    let [low, high] = judged.height_mm;
    let reach_mm = 1.5;
    Structure {
        plan,
        section: section(random),
        width_mm,
        pitch_mm: None,
        depth_mm: 0.0,
        at_mm,
        within: Rectangle {
            height_mm: [low.max(at_mm[1] - reach_mm), high.min(at_mm[1] + reach_mm)],
            ..judged
        },
    }
}

/// A bore with a given loss of every tooth's flanks, µm.
fn by_flank(loss_um: impl Fn(FlankId) -> f64) -> Mesh {
    let loss = |at: Place| {
        let (tooth, flank) = (at.tooth, at.flank);
        1e-3 * loss_um(FlankId { tooth, flank })
    };
    bore(loss, &[])
}

fn both_sides(random: &mut Random, stand: &Stand) -> Die {
    let worn_um = log_between(random, LIMIT_UM + 1.0, 90.0);
    let proud_um = random.between(0.0, 45.0);
    let is_left = chance(random, 50.0);
    let reach = if chance(random, 70.0) { 84 } else { 2 };
    let tooth = stand.place.tooth;
    let gear = stand.gear();
    let near = |other: u32| {
        let away = other.abs_diff(tooth);
        away.min(gear.teeth - away) <= reach
    };
    let mesh = by_flank(|id| match near(id.tooth) {
        true if (id.flank == Flank::Left) == is_left => worn_um,
        true => -proud_um,
        false => 0.0,
    });
    let worn = if is_left { "left" } else { "right" };
    Die {
        what: format!("{worn} worn {worn_um:.0}, other proud {proud_um:.0}, {reach} teeth around"),
        mesh,
        truths_um: None,
        beside: None,
    }
}

fn neighbours(random: &mut Random, stand: &Stand) -> Die {
    let gear = stand.gear();
    let step = if chance(random, 50.0) {
        1
    } else {
        gear.teeth - 1
    };
    let other = (stand.place.tooth - 1 + step) % gear.teeth + 1;
    let [low, high] = stand.judged.height_mm;
    let from_mm = match chance(random, 50.0) {
        true => 0.0,
        false => random.between(low + 1.0, high - 2.0),
    };
    let is_missing = chance(random, 25.0);
    let um = log_between(random, LIMIT_UM + 5.0, 200.0);
    // The flanks of both neighbours that face the judged tooth, or those that face away.
    let flank = if chance(random, 50.0) {
        Flank::Left
    } else {
        Flank::Right
    };
    let loss = |at: Place| match at.tooth == other && at.height_mm >= from_mm {
        true if is_missing => f64::INFINITY,
        true if at.flank == flank => 1e-3 * um,
        _ => 0.0,
    };
    let fine = Fine {
        tooth: other,
        flank,
        from_tip_mm: [0.0, 10.0],
        height_mm: [low - 1.0, high + 1.0],
        step_mm: [0.1, 0.1],
    };
    let what = match is_missing {
        true => format!("tooth {other} missing above {from_mm:.1} mm"),
        false => format!("tooth {other} {flank:?} worn {um:.0} um above {from_mm:.1} mm"),
    };
    Die {
        what,
        mesh: bore(loss, &[fine]),
        truths_um: None,
        beside: Some(Beside {
            id: FlankId {
                tooth: other,
                flank,
            },
            loss_um: if is_missing { f64::INFINITY } else { um },
            from_mm,
        }),
    }
}

fn scaled(random: &mut Random, stand: &Stand) -> Die {
    let scale = 1.0 + sign(random) * log_between(random, 2e-4, 2e-3);
    let um = log_between(random, LIMIT_UM + 15.0, 160.0);
    let tooth = stand.place.tooth;
    let is_left = chance(random, 50.0);
    let mut mesh = by_flank(
        |id| match id.tooth == tooth && (id.flank == Flank::Left) == is_left {
            true => um,
            false => 0.0,
        },
    );
    for vertex in &mut mesh.vertices {
        *vertex = vertex.map(|x| x * scale);
    }
    Die {
        what: format!("{scale:.5} times as large, one flank worn {um:.0} um"),
        mesh,
        truths_um: None,
        beside: None,
    }
}

fn hairlines(random: &mut Random, stand: &Stand) -> Die {
    let judged = stand.judged;
    let [low, high] = judged.height_mm;
    let mut counts = [0; 2];
    let lines: Vec<(FlankId, Structure)> = stand
        .flanks()
        .into_iter()
        .zip(&mut counts)
        .flat_map(|(id, count)| {
            *count = 1 + (8.0 * random.uniform()) as usize;
            let mut all: Vec<Structure> = (0..*count)
                .map(|_| Structure {
                    plan: line(random),
                    section: Section::Round,
                    width_mm: random.between(0.15, 0.3),
                    pitch_mm: None,
                    depth_mm: 1e-3 * random.between(5.0, 25.0),
                    at_mm: [
                        random.between(judged.profile_mm[0], judged.profile_mm[1]),
                        random.between(low, high),
                    ],
                    within: judged,
                })
                .collect();
            all.sort_by(|a, b| a.width_mm.total_cmp(&b.width_mm));
            all.into_iter().map(move |of| (id, of)).collect::<Vec<_>>()
        })
        .collect();
    let truths_um = stand.flanks().map(|id| {
        largest_mean_um(judged, stand.disc_area_mm2, RASTER_MM, |profile, height| {
            let here = lines.iter().filter(|(of, _)| *of == id);
            here.map(|(_, of)| of.loss_mm(profile, height)).sum()
        })
    });
    Die {
        what: format!("{} and {} hairlines", counts[0], counts[1]),
        mesh: cut_lines(stand.gear(), &lines, judged),
        truths_um: Some(truths_um),
        beside: None,
    }
}

/// Lines in several directions on the same flank: the mesh is equally fine across and along.
fn cut_lines(gear: &GearSpec, lines: &[(FlankId, Structure)], judged: Rectangle) -> Mesh {
    let loss = |at: Place| {
        let (tooth, flank) = (at.tooth, at.flank);
        let here = lines
            .iter()
            .filter(|(id, _)| *id == FlankId { tooth, flank });
        here.map(|(_, of)| of.loss_mm(profile_mm(gear, at), at.height_mm))
            .sum()
    };
    let ids: std::collections::BTreeSet<FlankId> = lines.iter().map(|(id, _)| *id).collect();
    let fine: Vec<Fine> = ids.into_iter().map(|id| whole(id, judged, 0.02)).collect();
    bore(loss, &fine)
}

/// The whole flank, with this mesh step in the judged heights.
fn whole(id: FlankId, judged: Rectangle, step_mm: f64) -> Fine {
    let [low, high] = judged.height_mm;
    Fine {
        tooth: id.tooth,
        flank: id.flank,
        from_tip_mm: [0.0, 10.0],
        height_mm: [low - 0.5, high + 0.5],
        step_mm: [step_mm; 2],
    }
}

fn rough(random: &mut Random, stand: &Stand) -> Die {
    let seed = (1e9 * random.uniform()) as u64;
    let grain = |at: f64| (at / GRAIN_MM).round() as i64 as u64;
    let flanks = stand.flanks();
    let loss = |at: Place| {
        let (tooth, flank) = (at.tooth, at.flank);
        if !flanks.contains(&FlankId { tooth, flank }) {
            return 0.0;
        }
        let side = u64::from(flank == Flank::Left);
        let number =
            seed ^ (grain(at.from_tip_mm) << 40) ^ (grain(at.height_mm) << 20) ^ (side << 62);
        let mut random = Random::new(number.wrapping_mul(0x9e37_79b9_7f4a_7c15), 11);
        ROUGH_MM * random.normal()
    };
    let fine = flanks.map(|id| whole(id, stand.judged, GRAIN_MM));
    Die {
        what: "white over 0.03 mm".into(),
        mesh: bore(loss, &fine),
        truths_um: None,
        beside: None,
    }
}

/// Every flank has its own pitch error, slopes along profile and height, and crowning.
fn class7(random: &mut Random, stand: &Stand) -> Die {
    let gear = stand.gear();
    let forms: BTreeMap<(u32, bool), [f64; 4]> = (1..=gear.teeth)
        .flat_map(|tooth| [true, false].map(|left| (tooth, left)))
        .map(|key| {
            let pitch = FLANKS_UM * gear.pressure_angle_rad.cos() * random.normal();
            let slopes = [1.5, 1.5].map(|um| um * random.normal());
            (key, [pitch, slopes[0], slopes[1], random.between(0.0, 3.0)])
        })
        .collect();
    let [low, high] = stand.judged.height_mm;
    let depth_mm = (gear.root_radius_mm - gear.tip_radius_mm).abs();
    let loss = |at: Place| {
        let form = forms.get(&(at.tooth, at.flank == Flank::Left));
        let [pitch, profile, helix, crown] = form.copied().unwrap_or_default();
        let x = 2.0 * at.from_tip_mm / depth_mm - 1.0;
        let y = (2.0 * (at.height_mm - low) / (high - low) - 1.0).clamp(-2.0, 2.0);
        1e-3 * (pitch + profile * x + helix * y + crown * (0.5 * (x * x + y * y) - 0.33))
    };
    Die {
        what: "pitch, slopes, crown".into(),
        mesh: bore(loss, &[]),
        truths_um: None,
        beside: None,
    }
}
