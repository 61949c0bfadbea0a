//! Dies as a press leaves them: all teeth worn nearly alike, on one side or both, since a mounting that drifts or was made anew.

use std::fmt::Write as _;

use flankscope_bench::damage::Random;
use flankscope_foundation::files::write_whole;
use flankscope_gear_cad::{Flank, Mesh};
use flankscope_metrology::verdict::Word;
use flankscope_record::document::Feature;
use flankscope_tests::die::{Fine, worn_bore};
use nalgebra::{Isometry3, Point3, Translation3, Vector3};

use super::Args;
use super::capture::{Repeating, judged};
use super::families::{LIMIT_UM, WARN_UM};
use super::page::command;
use super::runs::{self, Counts};
use super::setup::{Setup, flank, on_all_cores};
use super::stand::Stand;
use super::structure::profile_mm;
use super::tally::upper_bound;

/// Approaches of a baseline.
const APPROACHES: u32 = 5;
/// Teeth on either side of the judged one that are in view.
const IN_VIEW: u32 = 4;
/// Within this of a limit a flank may well be indeterminate, µm.
const NEAR_UM: f64 = 8.0;
/// Above the datum band, which the press does not load, wear begins over this height, mm from the middle of the view.
const ABOVE_BAND_MM: [f64; 2] = [-0.2, 0.3];

/// Knowledge of the die beside its CAD.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Knows {
    Cad,
    Baseline,
    DatumBand,
    DatumBandAndBaseline,
}

impl Knows {
    const ALL: [Self; 4] = [
        Self::Cad,
        Self::Baseline,
        Self::DatumBand,
        Self::DatumBandAndBaseline,
    ];

    fn name(self) -> &'static str {
        match self {
            Self::Cad => "the CAD alone",
            Self::Baseline => "a baseline",
            Self::DatumBand => "one datum band",
            Self::DatumBandAndBaseline => "one datum band and a baseline",
        }
    }

    fn has_band(self) -> bool {
        matches!(self, Self::DatumBand | Self::DatumBandAndBaseline)
    }

    fn has_baseline(self) -> bool {
        matches!(self, Self::Baseline | Self::DatumBandAndBaseline)
    }
}

/// Loss of one flank of every tooth.
struct Side {
    level_um: f64,
    /// Relative scatter from tooth to tooth.
    scatter: f64,
    /// Relative change from the middle of the judged zone to its ends, along profile and height.
    slopes: [f64; 2],
}

impl Side {
    fn drawn(random: &mut Random) -> Self {
        let mut slope = || match random.uniform() < 0.5 {
            true => 0.0,
            false => random.between(-0.5, 0.5),
        };
        let slopes = [slope(), slope()];
        Self {
            level_um: random.between(15.0, 80.0),
            scatter: random.between(0.0, 0.3),
            slopes,
        }
    }
}

/// Motion of the die from where it lay at the baseline to where it lies at the check.
#[derive(Clone, Copy)]
struct Moved {
    by: Isometry3<f64>,
    /// Length of a drift; infinite for a die that was taken out and put back.
    um: f64,
}

impl Moved {
    /// A die that was put back in one of five checks; else the frame drifted by 0 to 10 µm in any direction, as by a rotation about a point
    /// 100 to 300 mm away.
    fn drawn(random: &mut Random) -> Self {
        let remounted = random.uniform() < 0.2;
        let mut vector = || Vector3::from_fn(|_, _| random.normal());
        let (shift, turn) = (vector(), vector());
        let by = |shift: Vector3<f64>, turn| Isometry3::from_parts(Translation3::from(shift), turn);
        if remounted {
            let turn = nalgebra::UnitQuaternion::new(25e-3 / 40.0 * turn);
            return Self {
                by: by(25e-3 * shift, turn),
                um: f64::INFINITY,
            };
        }
        let um = random.between(0.0, 10.0);
        let arm_mm = random.between(100.0, 300.0);
        let turn = nalgebra::UnitQuaternion::new(1e-3 * um / arm_mm * turn.normalize());
        Self {
            by: by(1e-3 * um * shift.normalize(), turn),
            um,
        }
    }

    fn mesh(self, mesh: &Mesh) -> Mesh {
        let mut moved = mesh.clone();
        for p in &mut moved.vertices {
            *p = (self.by * Point3::from(*p)).into();
        }
        moved
    }
}

/// A judged flank.
struct Draw {
    knows: Knows,
    moved_um: f64,
    truth_um: f64,
    found: Feature,
}

impl Draw {
    fn is_near(&self) -> bool {
        let off_um = [WARN_UM, LIMIT_UM].map(|limit| (self.truth_um - limit).abs());
        off_um[0].min(off_um[1]) <= NEAR_UM
    }

    fn is_right(&self) -> bool {
        let right = match self.truth_um {
            um if um > LIMIT_UM => Word::NoGo,
            um if um > WARN_UM => Word::Warn,
            _ => Word::Go,
        };
        self.found.verdict == right
    }

    fn is_false_go(&self) -> bool {
        self.truth_um > LIMIT_UM && self.found.verdict == Word::Go
    }

    fn is_open(&self) -> bool {
        self.found.verdict == Word::Indeterminate
    }

    /// Whether U95 holds the truth; none where no figure is stated.
    fn holds(&self) -> Option<bool> {
        let (wear_um, u95_um) = (self.found.wear_um?, self.found.u95_um?);
        Some((wear_um - self.truth_um).abs() <= u95_um)
    }

    fn line(&self) -> String {
        let um = |value: Option<f64>| value.map_or("-".into(), |um| format!("{um:.1}"));
        format!(
            "{}, moved by {:.1} um, {}: true {:.1}, {} ({} ± {}; {})",
            self.knows.name(),
            self.moved_um,
            self.found.id.flank,
            self.truth_um,
            self.found.verdict,
            um(self.found.wear_um),
            um(self.found.u95_um),
            self.found.reason.as_deref().unwrap_or("")
        )
    }
}

/// The worn die.
fn worn(random: &mut Random, stand: &Stand, knows: Knows) -> Mesh {
    let which = (3.0 * random.uniform()) as u32;
    let is_worn = [which != 1, which != 0];
    let sides = [Side::drawn(random), Side::drawn(random)];
    let worse_um = match random.uniform() < 0.25 {
        true => random.between(0.0, 30.0),
        false => 0.0,
    };
    let gear = stand.gear().clone();
    let factors: Vec<[f64; 2]> = (0..gear.teeth)
        .map(|_| [0, 1].map(|side: usize| 1.0 + sides[side].scatter * random.normal()))
        .collect();
    let tooth = stand.place.tooth;
    let of_middle = |at: f64, [low, high]: [f64; 2]| (2.0 * at - low - high) / (high - low);
    let (profile, height) = (stand.judged.profile_mm, stand.judged.height_mm);
    let middle_mm = stand.place.height_mm;
    // Whole, so that the edge of the band is as sharp on all of them.
    let around = (0..2 * IN_VIEW + 1).map(|n| (tooth + gear.teeth - 1 + n - IN_VIEW) % gear.teeth);
    let fine = |tooth: u32| {
        [Flank::Left, Flank::Right].map(|flank| Fine {
            tooth: 1 + tooth,
            flank,
            from_tip_mm: [0.0, 10.0],
            height_mm: [height[0] - 0.5, height[1] + 0.5],
            step_mm: [0.1, 0.25],
        })
    };
    let in_view: Vec<Fine> = around.flat_map(fine).collect();
    worn_bore(
        |at| {
            let side = usize::from(at.flank == Flank::Right);
            if !is_worn[side] {
                return 0.0;
            }
            let Side {
                level_um, slopes, ..
            } = sides[side];
            let graded = 1.0
                + slopes[0] * of_middle(profile_mm(&gear, at), profile)
                + slopes[1] * of_middle(at.height_mm, height);
            let more_um = if at.tooth == tooth { worse_um } else { 0.0 };
            let factor = factors[at.tooth as usize - 1][side];
            let um = (level_um * factor * graded.max(0.0) + more_um).max(0.0);
            let loaded = match knows.has_band() {
                true => {
                    let [from, to] = ABOVE_BAND_MM.map(|mm| middle_mm + mm);
                    ((at.height_mm - from) / (to - from)).clamp(0.0, 1.0)
                }
                false => 1.0,
            };
            1e-3 * um * loaded
        },
        &in_view,
    )
}

/// All dies before one head, whose stages repeat as they do.
fn before(
    stand: Stand,
    knows: Knows,
    head: u32,
    views: u32,
    cad: &Mesh,
    tell: &(impl Fn(&str) + Sync),
) -> anyhow::Result<Vec<Draw>> {
    let mut random = Random::new(stand.seed, 11);
    let mut stand = stand;
    stand.trouble.stages = Some(Repeating {
        seed: stand.seed,
        share: random.between(0.5, 4.0) / 15.0,
    });
    if knows.has_band() {
        stand = stand.with_datum_band()?;
    }
    if knows.has_baseline() {
        stand = stand.with_baseline(APPROACHES)?;
    }
    let mut all = Vec::new();
    for view in 1..=views {
        let mut random = Random::new((stand.seed << 24) | u64::from(view), 12);
        let mesh = worn(&mut random, &stand, knows);
        stand.put(mesh.clone())?;
        let truths = stand.truths(cad);
        let moved = Moved::drawn(&mut random);
        let outcome = stand.look(moved.mesh(&mesh), APPROACHES + view)?;
        for (id, truth) in stand.flanks().into_iter().zip(truths) {
            let draw = Draw {
                knows,
                moved_um: moved.um,
                truth_um: truth.max_disc_wear_um.unwrap_or(f64::NAN),
                found: judged(&outcome, flank(id.flank))?,
            };
            tell(&format!("head {head} view {view}, {}", draw.line()));
            all.push(draw);
        }
    }
    Ok(all)
}

/// Draws dies before heads, a quarter of which knows what each of [`Knows`] says, and writes `press.md`.
pub(super) fn run(args: &Args) -> anyhow::Result<()> {
    let setup = Setup::load(None)?;
    let cad = setup.cad();
    let seed = args.seed()?;
    let of_heads = on_all_cores(args.blocks, |head| {
        let knows = Knows::ALL[head as usize % Knows::ALL.len()];
        let wanted = args.only.as_ref();
        if wanted.is_some_and(|text| knows.name() != text) {
            return Ok(Vec::new());
        }
        let stand = Stand::new(&setup, head, seed, false)?;
        before(stand, knows, head, args.captures, &cad, &|line| {
            eprintln!("{line}");
        })
    })?;
    let draws: Vec<Draw> = of_heads.into_iter().flatten().collect();
    write_whole(&args.out.join("press.md"), page(args, &draws)?.as_bytes()).map_err(Into::into)
}

fn page(args: &Args, draws: &[Draw]) -> anyhow::Result<String> {
    let count = |among: &dyn Fn(&Draw) -> bool| draws.iter().filter(|draw| among(draw)).count();
    let counts = Counts {
        beyond: count(&|draw| draw.truth_um > LIMIT_UM),
        beyond_go: count(&Draw::is_false_go),
        beyond_indeterminate: count(&|draw| draw.truth_um > LIMIT_UM && draw.is_open()),
        sound: count(&|draw| draw.truth_um < WARN_UM),
        sound_go: count(&|draw| draw.truth_um < WARN_UM && draw.found.verdict == Word::Go),
        claims: count(&|draw| draw.holds().is_some()),
        claims_missed: count(&|draw| draw.holds() == Some(false)),
    };
    let mut text = format!(
        "# Dies whose teeth all wear\n\nMade by `{}` at commit `{}`.\n\n{} dies are drawn before each of {} heads, each head calibrated on \
         the bench.\n\nLeft, right or both flanks of all teeth are worn by 15 to 80 µm, with 0 to 30 % of scatter from tooth to tooth; half \
         of them are graded by up to 50 % along the profile, half along the height; one of four judged teeth lost up to 30 µm more. \
         Stages err by 15 mdeg, of which 0.5 to 4 do not repeat; a baseline is recorded by {APPROACHES} approaches.\n\nUntil the check the \
         mounting drifts by 0 to 10 µm in any direction, with a rotation about a point 100 to 300 mm away. In one of five the die is taken \
         out and put back instead, within 25 µm along each axis and at its rim (standard deviations). No drift is stated to the instrument. Bounds \
         are one-sided (95 %, Clopper and Pearson); draws before one head share its calibration, stages and baseline.\n\n{}\
         | known | mounting | flanks | beyond {LIMIT_UM} µm: go | P(go) at most | farther than {NEAR_UM} µm from both limits: right, \
         indeterminate, wrong | U95 / µm: median, 90 % | holds the truth |\n|---|---|---|---|---|---|---|---|\n",
        command(args),
        args.commit,
        args.captures,
        args.blocks,
        runs::append(args, counts)?
    );
    for knows in Knows::ALL {
        let kinds: [(&str, &dyn Fn(f64) -> bool); 3] = [
            ("drift up to 2 µm", &|um| um <= 2.0),
            ("drift of 2 to 10 µm", &|um| um > 2.0 && um.is_finite()),
            ("put back", &f64::is_infinite),
        ];
        for (mounting, is_of) in kinds {
            let row: Vec<&Draw> = draws
                .iter()
                .filter(|draw| draw.knows == knows && is_of(draw.moved_um))
                .collect();
            if row.is_empty() {
                continue;
            }
            let count = |among: &dyn Fn(&Draw) -> bool| row.iter().filter(|d| among(d)).count();
            let beyond = count(&|draw| draw.truth_um > LIMIT_UM);
            let go = count(&Draw::is_false_go);
            let far = |among: &dyn Fn(&Draw) -> bool| count(&|d| !d.is_near() && among(d));
            let mut u95_um: Vec<f64> = row.iter().filter_map(|draw| draw.found.u95_um).collect();
            u95_um.sort_by(f64::total_cmp);
            let share = |part: f64| {
                let at = (part * u95_um.len() as f64) as usize;
                u95_um.get(at).copied().unwrap_or(f64::NAN)
            };
            writeln!(
                text,
                "| {} | {mounting} | {} | {go} of {beyond} | {:.1} % | {}, {}, {} | {:.1}, {:.1} | {} of {} |",
                knows.name(),
                row.len(),
                100.0 * upper_bound(go, beyond),
                far(&Draw::is_right),
                far(&Draw::is_open),
                far(&|draw| !draw.is_right() && !draw.is_open()),
                share(0.5),
                share(0.9),
                count(&|draw| draw.holds() == Some(true)),
                count(&|draw| draw.holds().is_some()),
            )?;
        }
    }
    let wrong = draws.iter().filter(|draw| {
        draw.is_false_go()
            || draw.holds() == Some(false)
            || !(draw.is_near() || draw.is_right() || draw.is_open())
    });
    let notes: Vec<String> = wrong.map(|draw| format!("* {}\n", draw.line())).collect();
    if !notes.is_empty() {
        text += "\nWrong ones, and figures that do not hold the truth:\n\n";
        text += &notes.concat();
    }
    Ok(text)
}
