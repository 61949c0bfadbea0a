//! `flankscope inspect`: the in-situ check of the critical teeth.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use anyhow::Context;
use flankscope_metrology::tool::Tool;
use flankscope_profilometry::HeadModel;
use flankscope_station::capture::SharedRoot;
use flankscope_station::controller::ClientSettings;
use flankscope_station::inspection::{Inspection, Progress, Station, Subject};

use crate::output::{Common, Outcome, write_whole};

/// Check the critical teeth now: position, capture, register, judge.
///
/// Without options the built-in demo die is checked on the simulated bench.
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  flankscope inspect --wear 40:left:80 --report out\n\
    checks the demo die with 80 um worn off the left flank of tooth 40 and writes out/report.html\n\n\
    Exit code: 0 go, 1 no-go, 2 indeterminate, 3 could not run, 4 warn"
)]
pub struct Args {
    /// Folder with tool.toml, and head.toml unless the demo head is meant [default: the demo die]
    #[arg(long, value_name = "DIR")]
    tool: Option<PathBuf>,
    /// Controller: `sim` for the simulated bench, `qemu` for the bench with the emulated firmware image, else a serial
    /// port such as /dev/ttyACM0
    #[arg(long, value_name = "sim|qemu|PORT", default_value = "sim")]
    link: String,
    /// Teeth to check instead of the tool file's, for example 12,40,68
    #[arg(long, value_delimiter = ',', value_name = "N,N,...")]
    teeth: Option<Vec<u32>>,
    /// Write report.html and inspection.json into this folder
    #[arg(long, value_name = "DIR")]
    report: Option<PathBuf>,
    #[command(flatten)]
    bench: BenchArgs,
    #[command(flatten)]
    common: Common,
}

/// What only the simulated bench knows.
#[derive(clap::Args, Clone, Debug)]
#[command(next_help_heading = "Simulated bench")]
pub struct BenchArgs {
    /// Seed of everything random
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Wear of a flank: TOOTH:left|right:DEPTH_UM, a fourth word uniform|tip|pit|buildup may follow
    #[arg(long, value_name = "TOOTH:FLANK:DEPTH_UM")]
    pub wear: Vec<String>,
    /// How many times faster than real time the bench runs, or max
    #[arg(long, value_name = "1|K|max", default_value = "1")]
    pub speed: String,
    /// A camera that misbehaves, to see what the instrument makes of it: lose|repeat|extra:FRAME, `:once` may follow
    #[arg(long, value_name = "KIND:FRAME")]
    pub frame_fault: Option<String>,
}

/// The link's far end: the port to open, and what to collect after the check.
struct Link {
    port: PathBuf,
    settings: ClientSettings,
    #[cfg(feature = "bench")]
    bench: Option<crate::bench_link::Bench>,
}

/// Runs the subcommand.
pub fn run(args: &Args) -> anyhow::Result<Outcome> {
    let scratch = Scratch::new()?;
    let folder = match &args.tool {
        Some(folder) => folder.clone(),
        None => demo_tool(scratch.path())?,
    };
    let subject = load(&folder, scratch.path())?;
    if let Some(report) = &args.report {
        // Before anything moves: a check whose report cannot be written should not begin.
        std::fs::create_dir_all(report)
            .with_context(|| format!("cannot make the report folder {}", report.display()))?;
    }
    let root = Arc::new(SharedRoot::create(&SharedRoot::default_base())?);
    let mut station = Station::open(subject, args.teeth.as_deref(), Arc::clone(&root))?;
    let link = connect(args, &folder, &root)?;
    let mut watcher = Watcher::new(args.common.quiet);
    let inspection =
        station.inspect(&link.port, link.settings, |progress| watcher.show(progress))?;
    watcher.finish();
    drop(station);
    let mut document = serde_json::to_value(&inspection)?;
    #[cfg(feature = "bench")]
    if let Some(bench) = link.bench {
        let truth = bench.finish()?;
        if let Some(notice) = truth.notice().filter(|_| !args.common.quiet) {
            eprintln!("{notice}");
        }
        document["truth"] = truth.document();
    }
    if let Some(report) = &args.report {
        let page = flankscope_station::report::html(&inspection)?;
        write_whole(&report.join("report.html"), page.as_bytes())?;
        write_whole(
            &report.join("inspection.json"),
            serde_json::to_string_pretty(&document)?.as_bytes(),
        )?;
    }
    args.common.write_json(&document)?;
    if !args.common.quiet && args.common.json.as_deref() != Some(Path::new("-")) {
        print_table(&inspection, args.report.as_deref())?;
    }
    Ok(match inspection.verdict.as_str() {
        "go" => Outcome::Go,
        "warn" => Outcome::Warn,
        "no-go" => Outcome::NoGo,
        _ => Outcome::Indeterminate,
    })
}

/// Reads tool and head, and hashes what was read.
fn load(folder: &Path, scratch: &Path) -> anyhow::Result<Subject> {
    let tool = Tool::load(folder)?;
    let mut head_path = if folder.is_dir() {
        folder.join("head.toml")
    } else {
        folder.with_file_name("head.toml")
    };
    if !head_path.exists() {
        // A tool folder may leave the head out: the demo head then looks at it.
        head_path = demo_tool(scratch)?.join("head.toml");
    }
    let head = HeadModel::load(&head_path)?;
    let mut hashes = BTreeMap::new();
    for (name, path) in [
        ("tool", tool.path.clone()),
        ("cad", tool.cad_path()),
        ("head", head_path),
    ] {
        let bytes =
            std::fs::read(&path).with_context(|| format!("cannot read {}", path.display()))?;
        hashes.insert(name, flankscope_station::files::hash(&bytes));
    }
    Ok(Subject {
        tool: Arc::new(tool),
        head: Arc::new(head),
        hashes,
    })
}

#[cfg(feature = "bench")]
fn demo_tool(scratch: &Path) -> anyhow::Result<PathBuf> {
    crate::bench_link::demo_tool(scratch)
}

#[cfg(not(feature = "bench"))]
fn demo_tool(_scratch: &Path) -> anyhow::Result<PathBuf> {
    anyhow::bail!(
        "this build has no demo tool: name a folder with tool.toml and head.toml by --tool"
    )
}

fn connect(args: &Args, _folder: &Path, root: &SharedRoot) -> anyhow::Result<Link> {
    #[cfg(feature = "bench")]
    if matches!(args.link.as_str(), "sim" | "qemu") {
        let bench = crate::bench_link::Bench::start(&args.bench, &args.link, _folder, root)?;
        return Ok(Link {
            port: bench.port().to_path_buf(),
            settings: bench.client_settings(),
            bench: Some(bench),
        });
    }
    if matches!(args.link.as_str(), "sim" | "qemu") {
        anyhow::bail!("this build has no simulated bench: name the controller's port by --link");
    }
    if !args.common.quiet {
        eprintln!("frames are expected in {}", root.path().display());
    }
    Ok(Link {
        port: PathBuf::from(&args.link),
        settings: ClientSettings::default(),
        #[cfg(feature = "bench")]
        bench: None,
    })
}

/// A folder of this run alone, gone afterwards.
struct Scratch(PathBuf);

impl Scratch {
    fn new() -> anyhow::Result<Self> {
        let path = std::env::temp_dir().join(format!("flankscope-run-{}", std::process::id()));
        std::fs::create_dir_all(&path)
            .with_context(|| format!("cannot make {}", path.display()))?;
        Ok(Self(path))
    }

    fn path(&self) -> &Path {
        &self.0
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// Tells on standard error how far the check is.
struct Watcher {
    quiet: bool,
    start: Instant,
    open_line: bool,
}

impl Watcher {
    fn new(quiet: bool) -> Self {
        Self {
            quiet,
            start: Instant::now(),
            open_line: false,
        }
    }

    fn show(&mut self, progress: Progress) {
        if self.quiet {
            return;
        }
        let line = match progress {
            Progress::Connected => "controller answered".to_string(),
            Progress::Homing => "stages reference".to_string(),
            Progress::Moving(view, views) => format!("head moves to view {} of {views}", view + 1),
            Progress::Exposed(_, frame, frames) => {
                // One line per view, drawn as it grows: a mark for every frame.
                if frame == 0 {
                    self.begin_line("LED on, frames ");
                }
                eprint!("{}", if frame == 0 { '.' } else { '|' });
                if frame + 1 == frames {
                    eprintln!(" {frames}");
                    self.open_line = false;
                }
                let _ = std::io::stderr().flush();
                return;
            }
            Progress::Recapture(view) => format!("view {} is captured again", view + 1),
            Progress::Retracting => "head retracts".to_string(),
            Progress::Evaluated(view) => format!("view {} evaluated", view + 1),
        };
        self.begin_line(&line);
        eprintln!();
        self.open_line = false;
    }

    fn begin_line(&mut self, text: &str) {
        self.finish();
        eprint!("{:6.2} s  {text}", self.start.elapsed().as_secs_f64());
        self.open_line = true;
    }

    fn finish(&mut self) {
        if std::mem::take(&mut self.open_line) {
            eprintln!();
        }
    }
}

fn print_table(inspection: &Inspection, report: Option<&Path>) -> anyhow::Result<()> {
    let mut out = std::io::stdout().lock();
    writeln!(
        out,
        "\ntooth  flank   wear/um   ±U95  warn  stop  seen  verdict"
    )?;
    for f in &inspection.features {
        let number =
            |value: Option<f64>| value.map_or_else(|| "–".to_string(), |v| format!("{v:.1}"));
        writeln!(
            out,
            "{:>5}  {:<6} {:>8} {:>6} {:>5.0} {:>5.0} {:>4.0}%  {}{}",
            f.tooth,
            f.flank,
            number(f.wear_um),
            number(f.u95_um),
            f.warn_um,
            f.limit_um,
            100.0 * f.coverage_ratio,
            f.verdict,
            f.reason
                .as_ref()
                .map(|reason| format!(": {reason}"))
                .unwrap_or_default(),
        )?;
    }
    let timing = inspection.timing_ms;
    let frames = inspection.frames;
    writeln!(
        out,
        "\n{}: {}",
        inspection.verdict.to_uppercase(),
        inspection.reason
    )?;
    writeln!(
        out,
        "check {:.2} s (positioning {:.2} s, exposure {:.2} s), last exposure to verdict {:.0} ms, {} of {} frames, {} bytes copied, {:.0} MB",
        timing.total / 1000.0,
        timing.positioning / 1000.0,
        timing.exposure / 1000.0,
        timing.last_exposure_to_verdict,
        frames.received,
        frames.triggered,
        frames.bytes_copied,
        inspection.peak_memory_mb.unwrap_or(f64::NAN),
    )?;
    match report {
        Some(folder) => writeln!(out, "report: {}", folder.join("report.html").display())?,
        None => writeln!(
            out,
            "add --report DIR for maps, histogram and timeline as one HTML file"
        )?,
    }
    Ok(())
}
