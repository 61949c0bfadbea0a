//! `flankscope gear`: ISO 1328 evaluation of a cloud.

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::Context;
use flankscope_metrology::gear::evaluation::{
    CLASSES, EvaluationSettings, GearEvaluation, evaluate,
};
use flankscope_metrology::tool::Tool;
use flankscope_metrology::verdict::{PROBABILITY, Word, holds_class};
use serde::Serialize;

use crate::geometry::{CloudReading, LoadedCloud, numbers};
use crate::output::{Common, Outcome};

/// Evaluate profile, helix, pitch and runout deviations of every tooth in a cloud, as ISO 1328-1 defines them.
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  flankscope gear --tool die --cloud merged.ply --class 9 --json gear.json\n\n\
    Deviations are along the normal, positive where material stands proud. The standard covers gears; for a die it is\n\
    used by analogy. A class is only stated where the uncertainty is at most 0.3 of its tolerance.\n\
    F_alpha and f_f_alpha are read over 95 % of the roll length between the usable radii, from the root end on; f_H_alpha is\n\
    the rise of their mean line from the root end to the tip radius (ISO 1328-1:2013) or between the radii of --slope-mm,\n\
    positive for more material towards the tip. A figure that cannot be told says why and what to do next.\n\
    With --class, a figure keeps the tool's `probability` (95 %): 0.84 of U95 from its tolerance, as wear does.\n\n\
    Exit code: 0 evaluated (with --class: held), 1 --class not held, 2 --class not decidable, 3 could not run"
)]
pub struct Args {
    /// Folder with tool.toml, or the file itself; only its section `gear` is used.
    #[arg(long, value_name = "DIR")]
    tool: PathBuf,
    /// Cloud in tool coordinates: PLY, arrays (.npz) or text with `x y z` per line.
    #[arg(long, value_name = "CLOUD")]
    cloud: PathBuf,
    #[command(flatten)]
    reading: CloudReading,
    /// Axis about which deviations are stated.
    #[arg(long, value_enum, default_value_t = Axis::Tool)]
    axis: Axis,
    /// Profile control radius and tip form radius: the flank between root rounding and tip edge [default: the active flank].
    #[arg(long, value_name = "A,B", value_parser = numbers::<2>)]
    usable_mm: Option<[f64; 2]>,
    /// Radii between which f_H_alpha is stated [default: profile control radius and tip radius].
    #[arg(long, value_name = "A,B", value_parser = numbers::<2>)]
    slope_mm: Option<[f64; 2]>,
    /// Largest distance of a profile's points from mid face.
    #[arg(long, value_name = "MM", default_value_t = 1.0)]
    band_mm: f64,
    /// Expanded uncertainty (95 %) of a deviation.
    #[arg(long, value_name = "UM", default_value_t = 5.0)]
    u95_um: f64,
    /// Tolerance class that every quantity must meet, 1 to 11.
    #[arg(long, value_name = "CLASS", value_parser = clap::value_parser!(u32).range(1..=11))]
    class: Option<u32>,
    #[command(flatten)]
    common: Common,
}

/// What deviations are stated about.
#[derive(clap::ValueEnum, Clone, Copy, PartialEq)]
enum Axis {
    /// The tool's own axis.
    Tool,
    /// The axis that fits the flanks best.
    Fit,
}

#[derive(Serialize)]
struct Report<'a> {
    #[serde(skip_serializing_if = "Option::is_none")]
    verdict: Option<Word>,
    #[serde(skip_serializing_if = "Option::is_none")]
    reason: Option<String>,
    u95_um: f64,
    /// Guard band: distance that a deviation must keep from its tolerance.
    guard_um: f64,
    /// Probability of conformity at that distance.
    probability: f64,
    /// Points of the file that were left out because a coordinate is not finite.
    points_not_finite: usize,
    #[serde(flatten)]
    evaluation: &'a GearEvaluation,
}

/// Runs the subcommand.
pub fn run(args: &Args) -> anyhow::Result<Outcome> {
    let tool = Tool::load(&args.tool)?;
    let gear = tool.gear.as_ref().with_context(|| {
        format!(
            "{} has no [gear] section (see docs/formats/tool.md)",
            tool.path.display()
        )
    })?;
    let LoadedCloud { cloud, not_finite } = args.reading.load(&args.cloud, &args.common)?;
    let mut settings = EvaluationSettings {
        band_mm: args.band_mm,
        best_fit_axis: args.axis == Axis::Fit,
        u95_um: args.u95_um,
        slope_mm: args.slope_mm,
        ..EvaluationSettings::for_gear(gear)
    };
    if let Some(usable_mm) = args.usable_mm {
        settings.usable_mm = usable_mm;
    }
    let evaluation = evaluate(gear, &cloud.points, &settings)
        .with_context(|| format!("cannot evaluate {}", args.cloud.display()))?;
    let inspect = tool.inspect.as_ref();
    let probability = inspect.map_or(PROBABILITY, |inspect| inspect.probability);
    let guard_um = settings.guard_um(probability);
    let judged = args
        .class
        .map(|class| holds_class(gear, &evaluation, &settings, class, probability));
    let (verdict, reason) = match judged {
        Some((verdict, reason)) => (Some(verdict.word()), Some(reason)),
        None => (None, None),
    };
    args.common.write_json(&Report {
        verdict,
        reason: reason.clone(),
        u95_um: args.u95_um,
        guard_um,
        probability,
        points_not_finite: not_finite,
        evaluation: &evaluation,
    })?;
    if !args.common.quiet && args.common.json.as_deref() != Some(Path::new("-")) {
        print_table(&evaluation, verdict.zip(reason))?;
    }
    Ok(verdict.map_or(Outcome::Done, Outcome::Verdict))
}

fn print_table(evaluation: &GearEvaluation, judged: Option<(Word, String)>) -> anyhow::Result<()> {
    let mut out = std::io::stdout().lock();
    write_evaluation(&mut out, evaluation)?;
    if let Some((verdict, reason)) = judged {
        writeln!(out, "\n{}: {reason}", verdict.as_str().to_uppercase())?;
    }
    Ok(())
}

/// Writes what was evaluated, and a line for every quantity.
pub fn write_evaluation(out: &mut impl Write, evaluation: &GearEvaluation) -> std::io::Result<()> {
    writeln!(
        out,
        "{} points on {} flanks, about {}",
        evaluation.points,
        evaluation.flanks.len(),
        if evaluation.about_best_fit_axis {
            "the axis that fits best"
        } else {
            "the tool's axis"
        }
    )?;
    if let Some(axis) = evaluation.axis {
        let [x, y] = axis.offset_um;
        writeln!(
            out,
            "the axis that fits best lies {x:+.1}, {y:+.1} um beside the tool's, tilted by {:+.3}, {:+.3} mrad",
            axis.tilt_mrad[0], axis.tilt_mrad[1]
        )?;
    }
    if let Some(why) = &evaluation.axis_not_told {
        writeln!(out, "{why}; {}", why.next_step())?;
    }
    let limits = &evaluation.limits;
    let [slope_from, slope_to] = limits.slope_radii_mm;
    let [low, high] = limits.helix_heights_mm;
    writeln!(
        out,
        "profile from radius {:.3} to {:.3} mm, f_H_alpha from {slope_from:.3} to {slope_to:.3} mm; helix from height {low:.2} to {high:.2} mm",
        limits.control_radius_mm, limits.evaluated_to_radius_mm
    )?;
    writeln!(out, "\nquantity     value/um  class  tolerance/um  flanks")?;
    for rating in &evaluation.ratings {
        let number = |value: Option<f64>| value.map_or("-".into(), |value| format!("{value:.1}"));
        let class = match (rating.value_um, rating.class) {
            (Some(_), None) => format!(">{}", CLASSES.end()),
            (_, class) => class.map_or("-".into(), |class| class.to_string()),
        };
        writeln!(
            out,
            "{:<12} {:>8} {:>6} {:>13} {:>7}  {}",
            rating.symbol,
            number(rating.value_um),
            class,
            number(rating.tolerance_um),
            rating.flanks,
            rating.note.clone().unwrap_or_else(|| rating.why_not_told())
        )?;
    }
    Ok(())
}
