//! Common parts of `inspect`, `watch` and `scan`: tool, head, controller, and the simulated bench.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::Context;
use flankscope_frames::{RunFolder, SharedRoot, default_base};
use flankscope_instrument::acquisition::Recording;
use flankscope_instrument::controller::ClientSettings;
use flankscope_instrument::doctor::check_shared_memory;
use flankscope_instrument::patterns::Adaptive;
use flankscope_jobs::inspection::ViewOutcome;
use flankscope_jobs::job::{Job, RecordedFrames};
use flankscope_jobs::plan::ViewPlan;
use flankscope_jobs::subject::Subject;
use flankscope_metrology::tool::Tool;
use flankscope_profilometry::HeadModel;
use flankscope_record::baseline::Baseline;
use flankscope_record::history::{History, HistoryWriter, Retention};
use flankscope_record::origin::Link;
use flankscope_record::seal::{Kind, SealError, Seals};

use crate::bench_link::{Bench, BenchSetup, demo_tool, fits_real_press, fits_recording};
use crate::camera_process::CameraProcess;
use crate::interrupt::DeferredExit;
use crate::output::say;
use crate::scene::Scene;
use crate::site::{Place, Site, station_file, user_name};
use crate::{help, interrupt};

/// Which tool is looked at through which controller.
#[derive(clap::Args, Clone, Debug)]
pub struct Source {
    #[arg(long, value_name = "DIR", help = help::TOOL)]
    pub tool: Option<PathBuf>,
    /// Head file instead of the tool folder's, for example a fresh calibration
    #[arg(long, value_name = "HEAD.toml")]
    pub head: Option<PathBuf>,
    #[command(flatten)]
    pub place: Place,
    /// Teeth to check instead of the tool file's, for example 12,40,68
    #[arg(long, value_delimiter = ',', value_name = "N,N,...")]
    pub teeth: Option<Vec<u32>>,
    /// Temperature of the tool in degrees C; required by a tool file with the section `temperature`
    #[arg(long, value_name = "DEGC", allow_negative_numbers = true)]
    pub tool_temperature: Option<f64>,
    /// For bare steel, where flanks reflect light onto each other: light left flanks, right flanks and the rest one after the other,
    /// with the pictures in this folder (made by `flankscope patterns --adaptive` and loaded into the DMD)
    #[arg(long, value_name = "DIR")]
    pub adaptive: Option<PathBuf>,
    /// Judge the loss since this baseline instead of the deviation from CAD
    #[arg(long, value_name = "FILE")]
    pub baseline: Option<PathBuf>,
    /// Store every check in this file, which is created if missing; a check that cannot be stored is not go [default: not stored]
    #[arg(long, value_name = "FILE")]
    pub history: Option<PathBuf>,
    /// Press cycles of the tool so far [default: continued from its last check in the history]
    #[arg(long, value_name = "N")]
    pub tool_cycles: Option<u32>,
}

impl Source {
    /// Sets the temperature and baseline of a subject by the options.
    fn furnish(&self, subject: &mut Subject, link: &Link) -> anyhow::Result<()> {
        subject.temperature_degc = self.tool_temperature.or(subject.temperature_degc);
        if let Some(path) = &self.baseline {
            let baseline =
                Baseline::load(path, &subject.hashes, link.is_simulated(), &subject.seals)?;
            subject.hashes.insert("baseline", baseline.hash());
            subject.baseline = Some(Arc::new(baseline));
        }
        Ok(())
    }

    /// Path of the history, if checks are stored.
    pub fn store<'a>(&'a self, site: &'a Site) -> anyhow::Result<Option<&'a PathBuf>> {
        let store = self.history.as_ref();
        let store = store.or(site.settings.history.file.as_ref());
        anyhow::ensure!(
            self.tool_cycles.is_none() || store.is_some(),
            "--tool-cycles without --history: nothing is stored; add --history FILE"
        );
        Ok(store)
    }

    /// The writer that stores the checks of a subject in the history at `path`.
    fn writer(&self, path: &Path, site: &Site, subject: &Subject) -> anyhow::Result<HistoryWriter> {
        let history = History::open(path, &subject.seals)?;
        history.takes_head(&subject.head_id())?;
        let said = &site.settings.history;
        let keep = Retention {
            checks: said.keep_phasors,
            bytes: (1e9 * said.keep_phasors_gb) as u64,
        };
        let operator = site.setting.operator.clone();
        let mut opened = HistoryWriter::new(
            history,
            self.tool_cycles,
            keep,
            operator.unwrap_or_else(user_name),
        );
        if let Some(room) = opened.room()? {
            say(&room);
        }
        let baseline = subject.baseline.as_deref();
        opened.begin(&subject.die(), site.link().is_simulated(), baseline)?;
        Ok(opened)
    }

    /// The site of this instrument.
    pub fn site(&self) -> anyhow::Result<Site> {
        self.place.site(&[
            ("--tool", self.tool.is_some()),
            ("--history", self.history.is_some()),
        ])
    }
}

/// The files of a head.
struct HeadFiles {
    head: PathBuf,
    cores: Option<PathBuf>,
}

impl HeadFiles {
    fn copy_to(&self, recording: &Path) -> anyhow::Result<PathBuf> {
        let name = PathBuf::from(self.head.file_name().unwrap_or_default());
        let check = self.head.with_extension("check.toml");
        let mut files = vec![(self.head.clone(), name.clone())];
        if check.exists() {
            files.push((check, name.with_extension("check.toml")));
        }
        // An absolute path stays valid.
        if let Some(cores) = self.cores.as_ref().filter(|cores| cores.is_relative()) {
            files.push((self.head.with_file_name("").join(cores), cores.clone()));
        }
        for (from, name) in files {
            let to = recording.join(name);
            let copied = to.parent().map_or(Ok(()), std::fs::create_dir_all);
            copied
                .and_then(|()| std::fs::copy(&from, &to).map(drop))
                .with_context(|| format!("cannot copy {} to {}", from.display(), to.display()))?;
        }
        Ok(name)
    }
}

/// A job with running threads, and the controller's port.
pub struct Instrument<J = Job<ViewOutcome>> {
    /// The job; by default a check.
    pub job: J,
    /// The controller's port.
    pub port: PathBuf,
    /// Timeouts of the client.
    pub settings: ClientSettings,
    /// The head's files, if they were read.
    head: Option<HeadFiles>,
    bench: Option<Bench>,
    _camera: Option<CameraProcess>,
    _root: Arc<SharedRoot>,
    scratch: RunFolder,
    /// The head may be in the die.
    _deferred: DeferredExit,
}

impl Instrument {
    /// Reads tool and head, and starts a check and the bench, if there is one. Also returns the writer that stores the checks, if
    /// requested.
    pub fn open(
        source: &Source,
        site: &Site,
        bench: &BenchSetup,
        checks_every: Option<u32>,
        quiet: bool,
    ) -> anyhow::Result<(Self, Option<HistoryWriter>)> {
        let scene = Scene {
            checks_every,
            teeth: source.teeth.as_deref(),
            pictures: source.adaptive.as_deref(),
            ..Scene::default()
        };
        let store = source.store(site)?;
        let mut writer = None;
        let instrument = Self::start(
            [source.tool.as_deref(), source.head.as_deref()],
            site,
            bench,
            scene,
            quiet,
            |mut subject, root| {
                source.furnish(&mut subject, site.link())?;
                let teeth = source.teeth.as_deref();
                let light = match &source.adaptive {
                    Some(folder) => {
                        let pictures = Adaptive::open(folder)?;
                        let views = ViewPlan::new(&subject.tool, &subject.head, teeth)?.views;
                        Some(pictures.light(&subject.tool, &subject.head, &views)?)
                    }
                    None => None,
                };
                let known = subject.clone();
                let setting = site.setting.clone();
                let job = Job::check_live(subject, setting, teeth, light, root)?;
                writer = store
                    .map(|path| source.writer(path, site, &known))
                    .transpose()?;
                Ok(job)
            },
        )?;
        Ok((instrument, writer))
    }
}

/// A check of recorded frames, and the writer that stores it, if requested: reads tool and head, starts no instrument.
pub fn recorded_check(
    source: &Source,
    recording: &Recording,
    bench: &BenchSetup,
    site: &Site,
    quiet: bool,
) -> anyhow::Result<(Job<ViewOutcome>, RecordedFrames, Option<HistoryWriter>)> {
    fits_recording(bench)?;
    anyhow::ensure!(
        source.adaptive.is_none(),
        "--adaptive with --frames: no patterns are projected for recorded frames"
    );
    let store = source.store(site)?;
    let files = [source.tool.as_deref(), source.head.as_deref()];
    let mut subject = recorded_subject(files, recording.head(), site, quiet)?;
    subject.temperature_degc = recording.index.tool_temperature_degc;
    source.furnish(&mut subject, site.link())?;
    let teeth = source.teeth.as_deref();
    let known = subject.clone();
    let (check, frames) = Job::check_recorded(subject, site.setting.clone(), recording, teeth)?;
    let writer = store
        .map(|path| source.writer(path, site, &known))
        .transpose()?;
    Ok((check, frames, writer))
}

/// Subject of a recording: tool and head by their options, else the head that the recording `names`, else the tool folder's.
pub fn recorded_subject(
    [tool, head]: [Option<&Path>; 2],
    names: Option<PathBuf>,
    site: &Site,
    quiet: bool,
) -> anyhow::Result<Subject> {
    let own = scratch()?;
    let folder = tool_folder(tool, own.path())?;
    let head = head.or(names.as_deref());
    let (subject, _) = standing(&folder, head, site, quiet, own.path())?;
    Ok(subject)
}

impl<J> Instrument<J> {
    /// Reads tool and head, and starts the job that `job` makes of them, then the bench, if there is one.
    ///
    /// `files` are the tool's folder, and a head file used instead of the one in it.
    pub fn start(
        [tool, head]: [Option<&Path>; 2],
        site: &Site,
        bench: &BenchSetup,
        scene: Scene<'_>,
        quiet: bool,
        job: impl FnOnce(Subject, Arc<SharedRoot>) -> anyhow::Result<J>,
    ) -> anyhow::Result<Self> {
        let own = scratch()?;
        fits_bench(bench, site)?;
        site.demands([tool, head])?;
        let folder = tool_folder(tool, own.path())?;
        let (subject, head_path) = standing(&folder, head, site, quiet, own.path())?;
        let cores = subject.head.cores.as_ref().map(|cores| cores.file.clone());
        let instrument = Self::before(&folder, site, bench, scene, quiet, own, |root| {
            job(subject, root)
        })?;
        Ok(Self {
            head: Some(HeadFiles {
                head: head_path,
                cores,
            }),
            ..instrument
        })
    }

    /// Starts the job that `job` makes for the shared memory of the frames, then the bench with the contents of `folder`, if there is one.
    pub fn before(
        folder: &Path,
        site: &Site,
        bench: &BenchSetup,
        scene: Scene<'_>,
        quiet: bool,
        scratch: RunFolder,
        job: impl FnOnce(Arc<SharedRoot>) -> anyhow::Result<J>,
    ) -> anyhow::Result<Self> {
        let link = site.link();
        let deferred = DeferredExit::until_dropped();
        check_shared_memory()?;
        // The shared-memory services must exist when the camera process connects.
        let root = Arc::new(SharedRoot::create(&default_base()?)?);
        let job = job(Arc::clone(&root))?;
        let Link::Port(port) = link else {
            let stages = &site.settings.stages;
            let bench = Bench::start(bench, link, scene, folder, &root, stages)?;
            return Ok(Self {
                job,
                port: bench.port().to_path_buf(),
                settings: interrupted(bench.client_settings())?,
                head: None,
                bench: Some(bench),
                _camera: None,
                _root: root,
                scratch,
                _deferred: deferred,
            });
        };
        let command = &site.settings.camera.command;
        let camera = CameraProcess::start(command, root.path())?;
        if camera.is_none() && !quiet {
            say(&format!("frames are expected in {}", root.path().display()));
        }
        Ok(Self {
            job,
            port: port.clone(),
            settings: interrupted(ClientSettings::default())?,
            head: None,
            bench: None,
            _camera: camera,
            _root: root,
            scratch,
            _deferred: deferred,
        })
    }

    /// Path of the head file; `None` for the built-in one.
    pub fn own_head_file(&self) -> Option<&Path> {
        let file = self.head.as_ref()?.head.as_path();
        (!file.starts_with(self.scratch.path())).then_some(file)
    }

    /// Copies the head file and its further files into the folder of a recording; returns its name there.
    pub fn copy_head(&self, recording: &Path) -> anyhow::Result<PathBuf> {
        let files = self.head.as_ref().context("no head was read")?;
        files.copy_to(recording)
    }

    /// Ends it. For a simulated bench, returns the true values, and prints a note if the bench did not keep up with real time.
    pub fn close(self, quiet: bool) -> anyhow::Result<Option<serde_json::Value>> {
        drop(self.job);
        let Some(bench) = self.bench else {
            return Ok(None);
        };
        let (truth, notice) = bench.finish()?;
        if let Some(notice) = notice.filter(|_| !quiet) {
            say(&notice);
        }
        Ok(Some(truth))
    }
}

/// Reads tool and head from a folder, or those of the demo; `head` replaces the folder's. The instrument is that of a station's file.
pub fn subject(
    tool: Option<&Path>,
    head: Option<&Path>,
    station: Option<&Path>,
) -> anyhow::Result<Subject> {
    let own = scratch()?;
    let folder = tool_folder(tool, own.path())?;
    let (mut subject, _) = load(&folder, head, own.path())?;
    let (settings, hash) = station_file(station)?;
    subject.station = Arc::new(settings);
    subject.hashes.extend(hash.map(|hash| ("station", hash)));
    Ok(subject)
}

/// Refuses options of the bench if there is none.
pub fn fits_bench(bench: &BenchSetup, site: &Site) -> anyhow::Result<()> {
    match site.link() {
        link if link.is_simulated() => Ok(()),
        link => fits_real_press(bench, link),
    }
}

/// Prints before anything moves which station, tool and head are used.
fn announce(site: &Site, subject: &Subject, head: &Path, scratch: &Path) {
    let from = |path: &Path| match path.starts_with(scratch) {
        true => "built in".into(),
        false => path.display().to_string(),
    };
    let made = match &subject.head.calibration {
        Some(made) => format!("calibrated {}, expires {}", made.date, made.expires),
        None => "not calibrated: a drawing's values".into(),
    };
    say(&format!(
        "{}\ntool     {} ({})\nhead     {} ({}; {made})",
        site.words(),
        subject.tool.name,
        from(&subject.tool.path),
        subject.head.name,
        from(head),
    ));
}

/// Adds the interrupt to the settings: the client ends its work when the user interrupts the program.
fn interrupted(settings: ClientSettings) -> anyhow::Result<ClientSettings> {
    Ok(ClientSettings {
        interrupt: interrupt::on_signals()?,
        ..settings
    })
}

/// The named folder, else the demo's.
pub fn tool_folder(named: Option<&Path>, scratch: &Path) -> anyhow::Result<PathBuf> {
    named.map_or_else(|| demo_tool(scratch), |folder| Ok(folder.to_path_buf()))
}

/// Reads tool and head, assigns them to the site's instrument, and prints them; also returns the path of the head file.
fn standing(
    folder: &Path,
    head: Option<&Path>,
    site: &Site,
    quiet: bool,
    scratch: &Path,
) -> anyhow::Result<(Subject, PathBuf)> {
    let (mut subject, head_path) = load(folder, head, scratch)?;
    site.stand_before(&mut subject);
    site.takes_head(&subject.head)?;
    if !quiet {
        announce(site, &subject, &head_path, scratch);
    }
    Ok((subject, head_path))
}

/// Reads tool and head, and hashes the files; also returns the path of the head file.
fn load(folder: &Path, head: Option<&Path>, scratch: &Path) -> anyhow::Result<(Subject, PathBuf)> {
    let tool = Tool::load(folder)?;
    let head_path = head_path(&tool, head, scratch)?;
    let ours = head_path.starts_with(scratch);
    let head = HeadModel::load(&head_path)?;
    let seals = seals()?;
    let head_seal = if ours {
        "built in".into()
    } else {
        seals.head(&head_path, head.calibration.is_some())?.words()
    };
    believe_as_built(&tool, &seals)?;
    let mut hashes = BTreeMap::new();
    let mut files = vec![
        ("tool", tool.path.clone()),
        ("cad", tool.cad_path()),
        ("head", head_path.clone()),
    ];
    if let Some(cores) = &head.cores {
        files.push(("cores", head_path.with_file_name("").join(&cores.file)));
    }
    for (name, path) in files {
        let bytes = flankscope_foundation::files::read_regular(
            &path,
            flankscope_foundation::files::MOST_DATA_BYTES,
        )
        .with_context(|| format!("cannot read {}", path.display()))?;
        hashes.insert(name, flankscope_foundation::files::hash(&bytes));
    }
    let subject = Subject {
        tool: Arc::new(tool),
        head: Arc::new(head),
        temperature_degc: None,
        baseline: None,
        station: Arc::default(),
        head_seal,
        seals,
        hashes,
    };
    Ok((subject, head_path))
}

/// Verifies the scan that a tool file names as the die's shape when new.
fn believe_as_built(tool: &Tool, seals: &Seals) -> anyhow::Result<()> {
    let inspect = tool.inspect.as_ref();
    let Some(scan) = inspect.and_then(|inspect| inspect.as_built_scan.as_ref()) else {
        return Ok(());
    };
    let path = tool.path.with_file_name("").join(scan);
    let bytes = flankscope_foundation::files::read_regular(
        &path,
        flankscope_foundation::files::MOST_DATA_BYTES,
    )
    .with_context(|| format!("cannot read {}", path.display()))?;
    let document = serde_json::from_slice(&bytes)
        .with_context(|| format!("{} (inspect.as_built_scan)", path.display()))?;
    seals.believe(Kind::Scan, &path, &document)?;
    Ok(())
}

/// The station's key, created at first use. If no folder is known for it, a key of this run only: the check goes on, but its
/// signatures cannot be verified later.
pub fn seals() -> anyhow::Result<Seals> {
    let error = match Seals::default_folder().and_then(|folder| Seals::open(&folder)) {
        Ok(seals) => return Ok(seals),
        // If other users may know the key, the program reports it and stops.
        Err(error @ SealError::KeyOpen { .. }) => return Err(error.into()),
        Err(error) => error,
    };
    say(&format!(
        "{error}; results of this run are signed with a temporary key"
    ));
    Ok(Seals::passing()?)
}

/// Path of the head file: the one named, else the one in the tool's folder, else the demo's.
pub fn head_path(tool: &Tool, named: Option<&Path>, scratch: &Path) -> anyhow::Result<PathBuf> {
    if let Some(head) = named {
        return Ok(head.to_path_buf());
    }
    let beside = tool.path.with_file_name("head.toml");
    if beside.exists() {
        return Ok(beside);
    }
    // A tool folder may lack a head file: the demo head is then used.
    Ok(demo_tool(scratch)?.join("head.toml"))
}

/// A temporary folder of this run, removed afterwards, which other users cannot write to.
pub fn scratch() -> anyhow::Result<RunFolder> {
    Ok(RunFolder::create(&default_base()?)?)
}
