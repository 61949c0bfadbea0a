//! `flankscope doctor`: what is installed, connected, calibrated and expired.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use flankscope_frames::{FrameReceiver, FrameSource, default_base};
use flankscope_instrument::controller::ClientSettings;
use flankscope_instrument::doctor::{self, Finding, healthy};
use flankscope_jobs::readiness;
use flankscope_metrology::tool::Tool;
use flankscope_profilometry::HeadModel;
use flankscope_record::origin::Link;
use flankscope_record::seal::Seals;
use serde::Serialize;
use serde_json::json;

use crate::bench_link::{BenchFileArgs, BenchSetup};
use crate::help;
use crate::instrument::{Instrument, fits_bench, head_path, scratch, tool_folder};
use crate::output::{Common, Outcome, in_words, say};
use crate::scene::Scene;
use crate::site::{Place, Site};
use crate::terminal::Terminal;

/// How long a camera process may take to start.
const CAMERA_PATIENCE: Duration = Duration::from_secs(3);

/// Report what is installed, connected, calibrated and expired, with a remedy for every problem; nothing moves.
#[derive(clap::Args)]
#[command(
    long_about = help::DOCTOR,
    after_help = "Example:\n  flankscope doctor --link /dev/ttyACM0 --tool DIR --history press.db\n\n\
    Exit code: 0 nothing has failed, 3 something has"
)]
pub struct Args {
    #[arg(long, value_name = "DIR", help = help::DOCTOR_TOOL)]
    tool: Option<PathBuf>,
    /// Head file instead of the tool folder's
    #[arg(long, value_name = "HEAD.toml")]
    head: Option<PathBuf>,
    /// History that checks are stored in [default: the station's]
    #[arg(long, value_name = "FILE")]
    history: Option<PathBuf>,
    /// Acknowledge the fault that the controller stands in, once its cause is gone: the press may then stroke again, and the next
    /// check may move the stages
    #[arg(long)]
    acknowledge_fault: bool,
    #[command(flatten)]
    place: Place,
    #[command(flatten)]
    common: Common,
    #[command(flatten)]
    bench: BenchFileArgs,
}

#[derive(Serialize)]
struct Document<'a> {
    healthy: bool,
    version: &'a str,
    station: &'a str,
    operator: Option<&'a str>,
    link: String,
    simulated: bool,
    findings: &'a [Finding],
}

/// Runs the subcommand.
pub fn run(args: &Args) -> anyhow::Result<Outcome> {
    args.common.try_json()?;
    let site = args.place.site(&[
        ("--tool", args.tool.is_some()),
        ("--history", args.history.is_some()),
    ])?;
    let bench = args.bench.setup()?;
    fits_bench(&bench, &site)?;
    if !args.common.quiet {
        say(&site.words());
    }
    let mut findings = vec![program()];
    let seals = Seals::default_folder().and_then(|folder| Seals::open(&folder));
    findings.push(readiness::key(&seals));
    let seals = seals.ok();
    let own = scratch()?;
    let tool = args.tool(&site, own.path());
    let mut made = Vec::new();
    findings.extend(args.head(&site, &tool, seals.as_ref(), own.path(), &mut made));
    findings.extend(args.instrument(&site, &bench, tool.folder.as_deref()));
    findings.insert(2, tool.finding);
    let history = args
        .history
        .as_ref()
        .or(site.settings.history.file.as_ref());
    if let (Some(path), Some(seals)) = (history, &seals) {
        let (found, last) = readiness::history(path, seals, &site.settings.stages);
        findings.extend(found);
        made.extend(last.map(|day| ("the last check of the history", day)));
    }
    findings.push(doctor::shared_memory(&default_base()?));
    findings.push(doctor::disk(
        history.map_or(Path::new("."), PathBuf::as_path),
    ));
    findings.push(doctor::clock(&made));

    let healthy = healthy(&findings);
    if args.common.shows_table() {
        let mut out = std::io::stdout().lock();
        for finding in &findings {
            writeln!(out, "{}", Terminal::of_stdout().text(&finding.line()))?;
        }
    }
    args.common.write_json(&Document {
        healthy,
        version: env!("CARGO_PKG_VERSION"),
        station: &site.setting.station,
        operator: site.setting.operator.as_deref(),
        link: site.link().to_string(),
        simulated: site.link().is_simulated(),
        findings: &findings,
    })?;
    Ok(match healthy {
        true => Outcome::Done,
        false => Outcome::CouldNotRun,
    })
}

fn program() -> Finding {
    let bench = match cfg!(feature = "bench") {
        true => "with the simulated bench",
        false => "without the simulated bench",
    };
    let version = env!("CARGO_PKG_VERSION");
    Finding::ok("program", format!("flankscope {version}, {bench}"))
}

/// The requested tool, as far as it could be read.
struct Looked {
    tool: Option<Tool>,
    /// Its folder; a bench needs nothing else.
    folder: Option<PathBuf>,
    finding: Finding,
}

impl Args {
    fn tool(&self, site: &Site, scratch: &Path) -> Looked {
        let refused = |why: anyhow::Error| Looked {
            tool: None,
            folder: None,
            finding: Finding::failed(
                "tool",
                in_words(&why),
                "name the folder of the tool by --tool DIR",
            ),
        };
        if let Err(why) = site.demands_tool(self.tool.as_deref()) {
            return refused(why);
        }
        let folder = match tool_folder(self.tool.as_deref(), scratch) {
            Ok(folder) => folder,
            Err(why) => return refused(why),
        };
        let tool = Tool::load(&folder);
        let finding = readiness::tool(&tool);
        Looked {
            folder: tool.is_ok().then_some(folder),
            tool: tool.ok(),
            finding,
        }
    }

    fn head(
        &self,
        site: &Site,
        looked: &Looked,
        seals: Option<&Seals>,
        scratch: &Path,
        made: &mut Vec<(&'static str, flankscope_foundation::date::Date)>,
    ) -> Option<Finding> {
        const REMEDY: &str = "name a head file by --head, made by flankscope calibrate";
        let path = match (&self.head, &looked.tool) {
            (Some(head), _) => Ok(head.clone()),
            (None, Some(tool)) => site
                .demands([self.tool.as_deref(), None])
                .and_then(|()| head_path(tool, None, scratch)),
            (None, None) => {
                return Some(Finding::not_asked(
                    "head",
                    "it is looked for beside the tool",
                ));
            }
        };
        let head = path.and_then(|path| Ok((HeadModel::load(&path)?, path)));
        let (head, path) = match head {
            Ok(head) => head,
            Err(why) => return Some(Finding::failed("head", in_words(&why), REMEDY)),
        };
        made.extend(
            head.calibration
                .as_ref()
                .map(|of| ("the head's calibration", of.date)),
        );
        let fits = site.takes_head(&head).map_err(|why| in_words(&why));
        Some(readiness::head(&path, &head, fits, seals))
    }

    /// Findings on controller, stages, press and camera, through the bench if there is one.
    fn instrument(&self, site: &Site, bench: &BenchSetup, folder: Option<&Path>) -> Vec<Finding> {
        const ASKED: [&str; 4] = ["controller", "stages", "press", "camera"];
        let unasked = |why: &str| ASKED.map(|check| Finding::not_asked(check, why)).to_vec();
        let folder = match (folder, site.link()) {
            (Some(folder), _) => folder,
            (None, Link::Port(_)) => Path::new("."),
            (None, _) => return unasked("the bench needs a tool to stand on it"),
        };
        let started = scratch().and_then(|scratch| {
            let scene = Scene::default();
            Instrument::before(folder, site, bench, scene, true, scratch, |root| {
                Ok(FrameReceiver::create(&root)?)
            })
        });
        let mut instrument = match started {
            Ok(instrument) => instrument,
            Err(why) => {
                let why = in_words(&why);
                let Link::Port(port) = site.link() else {
                    let mut findings = unasked("the bench could not be started");
                    findings[0] = Finding::failed("controller", why, BENCH_REMEDY);
                    return findings;
                };
                // Only the camera's process is started at a press: the port can be asked without it.
                let mut findings = self.controller(port, ClientSettings::default(), site);
                let remedy = match site.settings.camera.command.is_empty() {
                    true => BENCH_REMEDY,
                    false => CAMERA_REMEDY,
                };
                findings.push(Finding::failed("camera", why, remedy));
                return findings;
            }
        };
        let settings = instrument.settings.clone();
        let mut findings = self.controller(&instrument.port, settings, site);
        findings.push(camera(&mut instrument.job, site));
        findings
    }

    /// Findings on controller, stages and press.
    fn controller(&self, port: &Path, settings: ClientSettings, site: &Site) -> Vec<Finding> {
        let stages = site.settings.stages.config();
        doctor::controller(port, settings, &stages, self.acknowledge_fault).to_vec()
    }
}

const BENCH_REMEDY: &str = "free /dev/shm and the ports of the machine, and try again";
const CAMERA_REMEDY: &str = "correct camera.command in the station file: its first word is a program of this machine (flankscope-camera), then its arguments";

/// Waits for the first message of the camera.
fn camera(receiver: &mut FrameReceiver, site: &Site) -> Finding {
    const CHECK: &str = "camera";
    if !site.link().is_simulated() && site.settings.camera.command.is_empty() {
        return Finding::attention(
            CHECK,
            "nobody says what starts its process",
            "give station.toml a [camera] with its command, or start it by hand with the folder that a check names",
        );
    }
    let begun = Instant::now();
    while begun.elapsed() < CAMERA_PATIENCE {
        match receiver.ready() {
            Ok(Some(word)) => {
                let (model, link) = (word.model(), word.link());
                let (width_px, height_px, bits) = (word.width_px, word.height_px, word.bits);
                let seen = format!("{model} ({link}), {width_px} x {height_px} px, {bits} bits");
                return Finding::ok(CHECK, seen).with(json!({
                    "model": model, "link": link, "width_px": width_px, "height_px": height_px, "bits": bits,
                }));
            }
            Ok(None) => std::thread::sleep(Duration::from_millis(10)),
            Err(error) => {
                return Finding::failed(CHECK, error.to_string(), "free /dev/shm, and try again");
            }
        }
    }
    let seen = format!(
        "no camera has said a word within {} s",
        CAMERA_PATIENCE.as_secs()
    );
    Finding::failed(
        CHECK,
        seen,
        "plug the camera in, and try it alone: flankscope-camera ... --dry-run (docs/camera.md)",
    )
}
