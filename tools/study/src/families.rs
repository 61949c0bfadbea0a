//! Families of randomly drawn dies that earlier versions of the verdict assumed not to occur: frequency of each verdict.

mod dies;

use std::collections::BTreeMap;
use std::fmt::Write as _;

use flankscope_bench::damage::Random;
use flankscope_foundation::files::write_whole;
use flankscope_gear_cad::Mesh;
use flankscope_metrology::verdict::Word;
use flankscope_record::document::Feature;

use dies::die;

use super::Args;
use super::capture::judged;
use super::page::command;
use super::runs::{self, Counts};
use super::setup::{Setup, flank, on_all_cores};
use super::stand::Stand;
use super::tally::upper_bound;

/// Limits of the demo tool, µm.
pub(super) const WARN_UM: f64 = 30.0;
pub(super) const LIMIT_UM: f64 = 50.0;

/// Kinds of dies.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Family {
    /// Grooves or pits finer than a cell, side by side.
    Texture,
    /// One groove, scratch or pit with steep walls.
    Opening,
    /// One side of the teeth worn, the other proud.
    BothSides,
    /// The judged tooth is sound, a neighbour in view is worn or missing.
    Neighbours,
    /// The die is of another size and worn.
    Scale,
    /// Sound: a few hairlines.
    Hairlines,
    /// Sound: rough.
    Rough,
    /// Sound: pitch, slope and crown of class 7.
    Class7,
    /// Grooves along the height or askew, apart from each other, on even or sloping wear.
    Scoring,
    /// Straight rows of pits.
    PitRows,
    /// All flanks of one or both sides worn, the only band of the datum with them.
    WornDatum,
    /// Equal and opposite changes of both sides of all teeth, and local wear.
    OppositeAndLocal,
}

impl Family {
    /// All families.
    pub const ALL: [Self; 12] = [
        Self::Texture,
        Self::Opening,
        Self::BothSides,
        Self::Neighbours,
        Self::Scale,
        Self::Hairlines,
        Self::Rough,
        Self::Class7,
        Self::Scoring,
        Self::PitRows,
        Self::WornDatum,
        Self::OppositeAndLocal,
    ];

    /// Whether its dies should get a "go".
    #[must_use]
    pub fn is_sound(self) -> bool {
        matches!(self, Self::Hairlines | Self::Rough | Self::Class7)
    }

    /// Name in tables.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Texture => "texture below a cell",
            Self::Opening => "single openings with steep walls",
            Self::BothSides => "one side worn, the other proud",
            Self::Neighbours => "worn or missing neighbours",
            Self::Scale => "another size, and worn",
            Self::Hairlines => "hairlines (sound)",
            Self::Rough => "roughness of 3 µm (sound)",
            Self::Class7 => "class 7 (sound)",
            Self::Scoring => "scoring along the height or askew",
            Self::PitRows => "rows of pits",
            Self::WornDatum => "a single datum band that wore",
            Self::OppositeAndLocal => "opposite sides and local wear",
        }
    }

    /// Whether heads with odd numbers use a baseline of the sound die for this family.
    fn has_baselines(self) -> bool {
        matches!(
            self,
            Self::Texture | Self::BothSides | Self::Scoring | Self::WornDatum
        )
    }
}

/// One judged item: a flank, or for [`Family::Neighbours`] a check; its true values and the finding.
#[derive(Clone, Debug)]
pub struct Draw {
    pub family: Family,
    /// Number of its head.
    pub head: u32,
    /// Description of the item.
    pub what: String,
    /// True wear, µm; for a check, that of the worst flank in view, infinite if a tooth is missing.
    pub truth_um: f64,
    /// The verdict that counts.
    pub word: Word,
    /// Result for the flank; `None` for a check.
    pub found: Option<Feature>,
}

impl Draw {
    /// Whether the true wear exceeds the stop limit.
    pub fn is_beyond(&self) -> bool {
        self.truth_um > LIMIT_UM
    }

    /// Whether it got a "go" although the true wear exceeds the stop limit.
    pub fn is_false_go(&self) -> bool {
        self.is_beyond() && self.word == Word::Go
    }

    /// Whether the true value is within the interval or bound stated for a flank; `None` if none is stated.
    pub fn holds(&self) -> Option<bool> {
        let found = self.found.as_ref()?;
        if let Some(least_um) = found.at_least_um {
            return Some(least_um <= self.truth_um);
        }
        let (wear_um, u95_um) = (found.wear_um?, found.u95_um?);
        let judged = found.verdict != Word::Indeterminate;
        judged.then_some((wear_um - self.truth_um).abs() <= u95_um)
    }

    /// A line of text.
    pub fn line(&self) -> String {
        let mut line = format!(
            "{}: {}, true {:.1} um, {}",
            self.family.name(),
            self.what,
            self.truth_um,
            self.word
        );
        if let Some(found) = &self.found {
            let um = |value: Option<f64>| value.map_or("-".into(), |um| format!("{um:.1}"));
            line += &format!(
                " ({} ± {}, at least {}; {})",
                um(found.wear_um),
                um(found.u95_um),
                um(found.at_least_um),
                found.reason.as_deref().unwrap_or("")
            );
        }
        if self.is_false_go() {
            line += " FALSE GO";
        }
        if self.holds() == Some(false) {
            line += " NOT HELD";
        }
        line
    }
}

/// Draws `views` dies of each family for each of `heads` heads, every head calibrated once, and judges them; in the order of the families.
///
/// # Errors
/// The bench or the instrument returns an error.
pub fn draws(
    families: &[Family],
    (heads, views): (u32, u32),
    seed: u64,
    tell: impl Fn(&str) + Sync,
) -> anyhow::Result<Vec<Draw>> {
    let setup = Setup::load(None)?;
    let cad = setup.cad();
    let of_heads = on_all_cores(heads, |head| {
        let calibrated = Stand::calibrated(&setup, head, seed)?;
        let of_families = families.iter().map(|&family| {
            let mut stand = Stand::of(&setup, &calibrated, head, seed, family == Family::Class7)?;
            if family == Family::WornDatum {
                stand = stand.with_datum_band()?;
            }
            let since = family.has_baselines() && head % 2 == 1;
            if since {
                stand = stand.with_baseline(1)?;
            }
            before(stand, family, (head, views), since, &cad, &tell)
        });
        of_families.collect::<anyhow::Result<Vec<Vec<Draw>>>>()
    })?;
    let mut all: Vec<Draw> = of_heads.into_iter().flatten().flatten().collect();
    // Stable: within a family, head by head.
    all.sort_by_key(|draw| families.iter().position(|of| *of == draw.family));
    Ok(all)
}

/// The dies of one family before one head.
fn before(
    mut stand: Stand,
    family: Family,
    (head, views): (u32, u32),
    since: bool,
    cad: &Mesh,
    tell: &(impl Fn(&str) + Sync),
) -> anyhow::Result<Vec<Draw>> {
    let mut all = Vec::new();
    for view in 1..=views {
        let number = (family as u32) << 12 | view;
        let mut random = Random::new((stand.seed << 24) | u64::from(number), 9);
        let die = die(family, &mut random, &stand);
        let (outcome, lit) = stand.look_truly(die.mesh, number)?;
        let since = if since { ", since a baseline" } else { "" };
        let found = stand
            .flanks()
            .map(|id| judged(&outcome, flank(id.flank)))
            .into_iter()
            .collect::<anyhow::Result<Vec<Feature>>>()?;
        let what = format!("head {head} view {view}, {}{since}", die.what);
        if let Some(beside) = die.beside {
            let own = found.iter().map(|of| of.verdict).max();
            let word = own
                .max(outcome.in_view.word())
                .unwrap_or(Word::Indeterminate);
            all.push(Draw {
                family,
                head,
                what,
                truth_um: beside.in_view_um(&stand, &lit),
                word,
                found: None,
            });
        } else {
            let by_distance = || {
                let zones = stand.truths(cad);
                zones.map(|zone| zone.max_disc_wear_um.unwrap_or(f64::NAN))
            };
            let truths_um = die.truths_um.unwrap_or_else(by_distance);
            for (found, truth_um) in found.into_iter().zip(truths_um) {
                all.push(Draw {
                    family,
                    head,
                    what: format!("{what}, {}", found.id.flank),
                    truth_um,
                    word: found.verdict,
                    found: Some(found),
                });
            }
        }
        let new = if family == Family::Neighbours { 1 } else { 2 };
        for draw in all.iter().rev().take(new) {
            tell(&draw.line());
        }
    }
    Ok(all)
}

/// Of all draws.
fn counts(draws: &[Draw]) -> Counts {
    let count = |among: &dyn Fn(&Draw) -> bool| draws.iter().filter(|d| among(d)).count();
    let open = |d: &Draw| d.word == Word::Indeterminate;
    Counts {
        beyond: count(&Draw::is_beyond),
        beyond_go: count(&Draw::is_false_go),
        beyond_indeterminate: count(&|d| d.is_beyond() && open(d)),
        sound: count(&|d| d.truth_um < WARN_UM),
        sound_go: count(&|d| d.truth_um < WARN_UM && d.word == Word::Go),
        claims: count(&|d| d.holds().is_some()),
        claims_missed: count(&|d| d.holds() == Some(false)),
    }
}

/// Draws all families and writes `families.md` with the results of each.
pub(super) fn run(args: &Args) -> anyhow::Result<()> {
    let wanted = |family: &Family| {
        let only = args.only.as_ref();
        only.is_none_or(|text| family.name().contains(text))
    };
    let families: Vec<Family> = Family::ALL.into_iter().filter(wanted).collect();
    let of_all = draws(
        &families,
        (args.blocks, args.captures),
        args.seed()?,
        |line| eprintln!("{line}"),
    )?;
    let mut text = format!(
        "# Families of dies, drawn at random\n\nMade by `{}` at commit \
         `{}`.\n\nOf every family {} dies are drawn before each of {} heads, each head calibrated on the bench, and judged by frames \
         against the truth. *Texture*: grooves and pits 30 to 110 µm wide (what finer ones do is in [resolution](resolution.md)), 1.1 to 2.2 widths apart, flat, V-shaped or round, along, \
         across or at any angle, in patches 0.3 to 2.4 mm long and wide, at most five widths deep. *Single openings*: the same alone, 80 µm to 0.8 mm wide, with their middles anywhere in the zone. *One side worn*: 51 to 90 µm, the other \
         side 0 to 45 µm proud, of all teeth or of five, without a datum. *Neighbours*: one flank beside the judged tooth 55 to \
         200 µm worn, in full or above some height, or a tooth missing; the word of the whole check counts, and the truth is that of \
         what camera and projector see of the flank within the head's stated field. *Another size*: 0.02 \
         to 0.2 % larger or smaller, one flank worn 65 to 160 µm. *Scoring*: grooves 20 to 120 µm wide, 1.2 to 10 widths apart, 1 to 10 widths deep, \
         along the height or up to 10° askew, half of them oblique at any angle, on 0 to 45 µm of even wear and a slope of up to 20 µm/mm. *Rows of pits*: 30 to 80 µm \
         wide, 1.05 to 2 widths apart in rows 1.5 to 6 widths apart. *A single datum band*: one side of all teeth worn 30 to 70 µm, the other from 20 µm proud to as much worn. \
         *Opposite and local*: both sides changed by 10 to 45 µm, and more on half of one flank until 51 to 70 µm are lost. Of texture, scoring, worn sides and the datum every second head looks against a \
         baseline. Bounds are one-sided (95 %, Clopper and Pearson); draws before one head share its calibration.\n\n{}\
         | family | beyond {LIMIT_UM} µm | go | warn | no-go | indeterminate | P(go) at most |\n|---|---|---|---|---|---|---|\n",
        command(args),
        args.commit,
        args.captures,
        args.blocks,
        runs::append(args, counts(&of_all))?
    );
    let mut sound = String::from(
        "\n| family | below 30 µm | go | warn | no-go | indeterminate | P(not go) at most |\n|---|---|---|---|---|---|---|\n",
    );
    let mut rest = String::from(
        "\n| family | claims of judged flanks and lower bounds | do not hold | reasons of the indeterminate ones |\n|---|---|---|---|\n",
    );
    let mut notes = String::new();
    for family in families {
        let all: Vec<&Draw> = of_all.iter().filter(|d| d.family == family).collect();
        let count = |of: &[&Draw], word| of.iter().filter(|d| d.word == word).count();
        let row = |of: &[&Draw], wrong: usize| {
            let words = [Word::Go, Word::Warn, Word::NoGo, Word::Indeterminate];
            format!(
                "| {} | {} | {} | {:.1} % |",
                family.name(),
                of.len(),
                words.map(|word| count(of, word).to_string()).join(" | "),
                100.0 * upper_bound(wrong, of.len())
            )
        };
        if family.is_sound() {
            let of: Vec<&Draw> = all
                .iter()
                .copied()
                .filter(|d| d.truth_um < WARN_UM)
                .collect();
            writeln!(sound, "{}", row(&of, of.len() - count(&of, Word::Go)))?;
        } else {
            let of: Vec<&Draw> = all.iter().copied().filter(|d| d.is_beyond()).collect();
            writeln!(text, "{}", row(&of, count(&of, Word::Go)))?;
        }
        let claims: Vec<bool> = all.iter().filter_map(|d| d.holds()).collect();
        let mut why: BTreeMap<&str, usize> = BTreeMap::new();
        for code in all.iter().filter_map(|d| d.found.as_ref()?.code) {
            *why.entry(code.word()).or_default() += 1;
        }
        let why: Vec<String> = why.iter().map(|(code, n)| format!("{code} {n}")).collect();
        writeln!(
            rest,
            "| {} | {} | {} | {} |",
            family.name(),
            claims.len(),
            claims.iter().filter(|holds| !**holds).count(),
            why.join(", ")
        )?;
        let wrong = all.iter().filter(|d| match family.is_sound() {
            true => d.word != Word::Go && d.truth_um < WARN_UM,
            false => d.is_false_go() || d.holds() == Some(false),
        });
        for draw in wrong {
            writeln!(notes, "* {}", draw.line())?;
        }
        let mut page = format!("{text}{sound}{rest}");
        if !notes.is_empty() {
            page += "\nWrong ones, and sound ones without a go:\n\n";
            page += &notes;
        }
        write_whole(&args.out.join("families.md"), page.as_bytes())?;
    }
    Ok(())
}
