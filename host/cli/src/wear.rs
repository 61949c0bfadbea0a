//! `flankscope wear`: a cloud of another scanner, judged like a check.

use std::io::Write;
use std::path::PathBuf;
use std::sync::Arc;

use flankscope_jobs::inspection::{CloudVerdict, ForeignCloud, judge_cloud};
use flankscope_metrology::tool::Tool;
use flankscope_metrology::verdict::Word;
use flankscope_record::document::FlankInView;
use serde::Serialize;

use crate::geometry::{CloudReading, LoadedCloud, StartPose, sigma_of};
use crate::inspect::{in_words, print_flanks};
use crate::output::{Common, Outcome};
use crate::terminal::Terminal;

/// Judge the wear of a tool by a cloud of any scanner.
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  flankscope wear --tool die scan.ply --u95-um 8 --json wear.json\n\n\
    The cloud is registered to the tool's CAD by what is not judged (inspect.datum of the tool file), then the flanks are judged\n\
    by the figures, limits and rules of `flankscope inspect`. Its points must lie closer than a fifth of the diameter of the judged\n\
    disc (0.11 mm for 0.25 mm2). A cloud has no rays: what a wall or a narrow groove hides counts as not scanned.\n\n\
    Exit code: 0 go, 1 no-go, 2 indeterminate, 3 could not run, 4 warn"
)]
pub struct Args {
    /// Folder with tool.toml, or the file itself
    #[arg(long, value_name = "DIR")]
    tool: PathBuf,
    /// Cloud: PLY, arrays (.npz) or text with `x y z` per line
    #[arg(value_name = "CLOUD")]
    cloud: PathBuf,
    #[command(flatten)]
    reading: CloudReading,
    #[command(flatten)]
    start: StartPose,
    /// Expanded uncertainty (95 %) of a deviation by what does not average out, as the scanner's certificate states it
    #[arg(long, value_name = "UM", default_value_t = 5.0)]
    u95_um: f64,
    /// Teeth or patches to judge instead of the tool file's, for example 12,40,68
    #[arg(long, value_delimiter = ',', value_name = "N,N,...")]
    teeth: Option<Vec<u32>>,
    /// Temperature of the tool in degrees C; required by a tool file with the section `temperature`
    #[arg(long, value_name = "DEGC", allow_negative_numbers = true)]
    tool_temperature: Option<f64>,
    #[command(flatten)]
    common: Common,
}

#[derive(Serialize)]
struct Report<'a> {
    tool: &'a str,
    points: usize,
    /// Points of the file that were left out because a coordinate is not finite.
    points_not_finite: usize,
    u95_um: f64,
    #[serde(flatten)]
    judged: &'a CloudVerdict,
}

/// Runs the subcommand.
pub fn run(args: &Args) -> anyhow::Result<Outcome> {
    anyhow::ensure!(
        args.u95_um.is_finite() && args.u95_um > 0.0,
        "--u95-um is {}; an uncertainty is above 0 um",
        args.u95_um
    );
    args.common.try_json()?;
    let tool = Arc::new(Tool::load(&args.tool)?);
    let LoadedCloud { cloud, not_finite } = args.reading.load(&args.cloud, &args.common)?;
    let sigma_mm = sigma_of(&cloud, &args.cloud)?;
    let foreign = ForeignCloud {
        points: &cloud.points,
        sigma_mm: sigma_mm.as_deref(),
        u95_mm: 1e-3 * args.u95_um,
        start: args.start.pose()?,
        temperature_degc: args.tool_temperature,
    };
    let judged = judge_cloud(Arc::clone(&tool), &foreign, args.teeth.as_deref())?;
    args.common.write_json(&Report {
        tool: &tool.name,
        points: cloud.points.len(),
        points_not_finite: not_finite,
        u95_um: args.u95_um,
        judged: &judged,
    })?;
    if args.common.shows_table() {
        print_table(args, &judged)?;
    }
    Ok(Outcome::Verdict(judged.verdict))
}

fn print_table(args: &Args, judged: &CloudVerdict) -> anyhow::Result<()> {
    let terminal = Terminal::of_stdout();
    let mut out = std::io::stdout().lock();
    let is_bad = |flank: &FlankInView| matches!(flank.verdict, Word::Warn | Word::NoGo);
    let (bad, others): (Vec<_>, Vec<_>) = judged.in_view.iter().cloned().partition(is_bad);
    print_flanks(&mut out, &judged.features, &bad)?;
    if !others.is_empty() {
        let others = format!("{} other flanks in the cloud show no damage", others.len());
        writeln!(out, "{}", terminal.sentence(&others))?;
    }
    let verdict = in_words(terminal, judged.verdict, &judged.reason);
    writeln!(out, "\n{verdict}")?;
    for pose in &judged.registration {
        let fit = match (&pose.reason, pose.rms_mm) {
            (None, Some(rms_mm)) => format!(
                "registered by {} of {} points that are not judged, rms {:.1} um",
                pose.inliers,
                pose.points,
                1e3 * rms_mm
            ),
            (why, _) => format!("not registered: {}", why.as_deref().unwrap_or_default()),
        };
        writeln!(out, "{}", terminal.sentence(&fit))?;
    }
    let stated = format!(
        "the scanner's deviations count as known to {} um (U95, --u95-um)",
        args.u95_um
    );
    writeln!(out, "{}", terminal.sentence(&stated))?;
    Ok(())
}
