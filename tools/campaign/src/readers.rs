//! How each file is read, and what must hold of whatever is not refused.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use anyhow::{Context, ensure};
use flankscope_foundation::files;
use flankscope_instrument::acquisition::Recording;
use flankscope_instrument::patterns::{Adaptive, PatternLight};
use flankscope_instrument::poses::PoseTable;
use flankscope_instrument::settings::StationSettings;
use flankscope_jobs::calibration::{BoardFolder, CaptureFolder};
use flankscope_jobs::scan::CloudRecording;
use flankscope_metrology::io::{Unit, cloud, mesh};
use flankscope_metrology::tool::Tool;
use flankscope_metrology::view::PlannedView;
use flankscope_profilometry::HeadModel;
use flankscope_profilometry::calibrate::{FocusSeries, Target};
use flankscope_profilometry::io::images::read_grey;
use flankscope_profilometry::plan::Plan;
use flankscope_record::baseline::Baseline;
use flankscope_record::history::History;
use flankscope_record::seal::Seals;
use serde_json::Value;

use crate::originals::{FILES, IMAGE_PX, Originals};

/// What became of a mutant.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// When it was read, with these words.
    Refused(String),
    /// It was read, and what a command does with it ended with these words.
    RefusedLater(String),
    /// As something that may be so.
    Accepted,
}

/// A worker's own folder, and what it compares with.
pub struct Readers {
    folder: PathBuf,
    seals: Seals,
    hashes: BTreeMap<&'static str, String>,
    baseline: Value,
    history: Vec<String>,
    /// Where the station keeps its history, and its content.
    kept: PathBuf,
    kept_content: Vec<u8>,
    /// The head with a short core map, and the map's hash in it.
    cores: (String, String),
    /// What mutants stand beside.
    beside: BTreeMap<&'static str, Vec<u8>>,
    target: Target,
    /// The head that the captures calibrate.
    drawn: HeadModel,
    /// The tool and the head that the pictures in passes are for, and their view.
    tool: Tool,
    head: HeadModel,
    views: Vec<PlannedView>,
}

/// One worker at a time reads the history, where the station keeps it.
static PLACE: Mutex<()> = Mutex::new(());

/// Files that others refer to.
const BESIDE: [&str; 9] = [
    "tool/tool.toml",
    "tool/die.ply",
    "cores/head.toml",
    "cores/cores.csv",
    "worn/PLAN.toml",
    "worn/frames.toml",
    "clouds/cloud.ply",
    "board/board.toml",
    "board/columns.toml",
];
/// Folders whose other files no mutant replaces.
const FOLDERS: [&str; 3] = ["captures", "focus", "board"];
/// Where the head of a focus series is computed: within all of its settings.
const BETWEEN_DPT: f64 = 1.0;
const LENS_CELSIUS: f64 = 23.0;

impl Readers {
    /// Copies what stands beside the files that are mutated into `folder`.
    pub fn new(originals: &Originals, folder: &Path) -> anyhow::Result<Self> {
        let from = |name: &str| originals.folder.join(name);
        let mut beside = BTreeMap::new();
        for name in BESIDE {
            let content = std::fs::read(from(name))?;
            let to = folder.join(name);
            std::fs::create_dir_all(to.parent().unwrap_or(folder))?;
            std::fs::write(to, &content)?;
            beside.insert(name, content);
        }
        for name in FOLDERS {
            link(&originals.folder, &folder.join(name), Path::new(name))?;
        }
        let seals = Seals::open(&originals.state())?;
        let place = PLACE.lock().unwrap_or_else(PoisonError::into_inner);
        let history = told(&History::read(&from("press.db"), &seals)?)?;
        let kept_content = std::fs::read(from("press.db"))?;
        drop(place);
        let hash = |name: &str| std::fs::read(from(name)).map(|bytes| files::hash(&bytes));
        let baseline: Value = serde_json::from_slice(&std::fs::read(from("baseline.json"))?)?;
        let recorded = baseline["hashes"]
            .as_object()
            .context("a baseline has hashes")?;
        let known = |what: &'static str| Some((what, recorded.get(what)?.as_str()?.to_owned()));
        let cores = (
            std::fs::read_to_string(from("cores/head.toml"))?,
            hash("cores/cores.csv")?,
        );
        Ok(Self {
            target: Target::load(&from("captures/target.toml"))?,
            drawn: HeadModel::load(&from("captures/head.toml"))?,
            tool: Tool::load(&from("tool/tool.toml"))?,
            head: HeadModel::load(&from("tool/head.toml"))?,
            views: vec![Adaptive::open(&from("adaptive"))?.view],
            folder: folder.to_owned(),
            hashes: ["tool", "cad", "head"]
                .into_iter()
                .filter_map(known)
                .collect(),
            history,
            kept: from("press.db"),
            kept_content,
            seals,
            baseline,
            cores,
            beside,
        })
    }

    /// Where the last mutant lies.
    pub fn place(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// Reads a mutant of the file `name`; an error says what should not be. What others refer to is as it was afterwards.
    pub fn read(&self, name: &str, content: &[u8]) -> anyhow::Result<Outcome> {
        let outcome = self.read_mutant(name, content);
        if let Some(original) = self.beside.get(name) {
            std::fs::write(self.place(name), original)?;
        }
        outcome
    }

    fn read_mutant(&self, name: &str, content: &[u8]) -> anyhow::Result<Outcome> {
        let path = self.place(name);
        if let Some(parent) = path.parent() {
            std::fs::create_dir_all(parent)?;
        }
        std::fs::write(&path, content)?;
        Ok(match name {
            "tool/tool.toml" => match Tool::load(&path) {
                Ok(tool) => {
                    let said = format!("{tool:?}");
                    ensure!(
                        !said.contains("limit_um: NaN") && !said.contains("limit_um: inf"),
                        "a limit that is none"
                    );
                    Outcome::Accepted
                }
                Err(error) => refused(&error)?,
            },
            "target/head.toml" | "cores/head.toml" | "head.yml" => head(&path)?,
            "cores/cores.csv" => {
                let (head_file, hash) = &self.cores;
                let adapted = self.place("cores/adapted.toml");
                std::fs::write(&adapted, head_file.replace(hash, &files::hash(content)))?;
                head(&adapted)?
            }
            "target/target.toml" => accepted(Target::load(&path))?,
            "focus/focus.toml" => made(
                FocusSeries::load(&path),
                |series| series.heads(&path)?.at(BETWEEN_DPT, LENS_CELSIUS),
                |(head, record)| {
                    let sigma_um = [record.depth_sigma_um, record.lateral_sigma_um];
                    sound(head, &sigma_um)
                },
            )?,
            "captures/captures.toml" => made(
                CaptureFolder::open(
                    &self.place("captures"),
                    self.drawn.clone(),
                    self.target.clone(),
                ),
                |mut captures| captures.calibrate(|_| {}),
                |calibrated| {
                    let adjusted = &calibrated.adjusted;
                    let sigma_mm = [adjusted.depth_sigma_mm, adjusted.lateral_sigma_mm];
                    sound(&adjusted.head, &sigma_mm)
                },
            )?,
            "board/board.toml" | "board/columns.toml" => made(
                BoardFolder::open(&self.place("board"), None),
                |board| board.calibrate(|_| {}),
                |adjusted| sound(&adjusted.head, &adjusted.sigma_mm),
            )?,
            "worn/PLAN.toml" => accepted(Plan::load(&path))?,
            "adaptive/adaptive.json" => made(
                Adaptive::open(&self.place("adaptive")),
                |adaptive| adaptive.light(&self.tool, &self.head, &self.views),
                |PatternLight { lit_ratios }| {
                    let lit = lit_ratios
                        .iter()
                        .all(|ratio| ratio.is_finite() && *ratio > 0.0);
                    ensure!(
                        lit && lit_ratios.len() == 3,
                        "passes with the light {lit_ratios:?}"
                    );
                    Ok(())
                },
            )?,
            "worn/frames.toml" => accepted(Recording::open(&self.place("worn")))?,
            "clouds/clouds.toml" => accepted(CloudRecording::open(&self.place("clouds")))?,
            "poses.csv" => accepted(PoseTable::load(&path))?,
            "station.toml" => accepted(StationSettings::load(&path))?,
            "baseline.json" => self.baseline(&path)?,
            "press.db" => self.history(content)?,
            "image.png" | "image.pgm" => accepted(read_grey(&path, content, [IMAGE_PX, IMAGE_PX]))?,
            "cloud.ply" | "cloud.npz" | "cloud.xyz" => match cloud::parse(content, Unit::Mm) {
                Ok(cloud) => {
                    let finite = cloud
                        .points
                        .iter()
                        .all(|point| point.iter().all(|value| value.is_finite()));
                    ensure!(
                        finite && !cloud.points.is_empty(),
                        "a point that is no place"
                    );
                    Outcome::Accepted
                }
                Err(error) => refused(&error)?,
            },
            _ => match mesh::parse(content, Unit::Mm) {
                Ok(mesh) => {
                    let finite = mesh
                        .vertices
                        .iter()
                        .all(|vertex| vertex.iter().all(|value| value.is_finite()));
                    let inside = mesh
                        .triangles
                        .iter()
                        .flatten()
                        .all(|&corner| (corner as usize) < mesh.vertices.len());
                    ensure!(finite && inside, "a corner that is no place");
                    Outcome::Accepted
                }
                Err(error) => refused(&error)?,
            },
        })
    }

    /// Believed only where it says what was signed.
    fn baseline(&self, path: &Path) -> anyhow::Result<Outcome> {
        if let Err(error) = Baseline::load(path, &self.hashes, true, &self.seals) {
            return refused(&error);
        }
        let document: Value = serde_json::from_slice(&std::fs::read(path)?)?;
        ensure!(
            document == self.baseline,
            "a baseline is believed that nobody signed"
        );
        Ok(Outcome::Accepted)
    }

    /// Believed only where every check says what it said. It lies where the station knows one to be.
    fn history(&self, content: &[u8]) -> anyhow::Result<Outcome> {
        let _one_at_a_time = PLACE.lock().unwrap_or_else(PoisonError::into_inner);
        let outcome = self.history_there(content);
        std::fs::write(&self.kept, &self.kept_content)?;
        outcome
    }

    fn history_there(&self, content: &[u8]) -> anyhow::Result<Outcome> {
        // What SQLite left of the last one.
        for left in ["press.db-wal", "press.db-shm"] {
            let _ = std::fs::remove_file(self.kept.with_file_name(left));
        }
        std::fs::write(&self.kept, content)?;
        let found = History::read(&self.kept, &self.seals).and_then(|history| {
            history.verify()?;
            Ok(history)
        });
        match found {
            Ok(history) => {
                let (now, then) = (told(&history)?, &self.history);
                ensure!(
                    &now == then,
                    "a history is believed that says {now:?} instead of {then:?}"
                );
                Ok(Outcome::Accepted)
            }
            Err(error) => refused(&error),
        }
    }
}

fn head(path: &Path) -> anyhow::Result<Outcome> {
    match HeadModel::load(path) {
        Ok(head) => {
            let said = format!("{:?}{:?}", head.camera, head.projector);
            ensure!(
                !said.contains("NaN") && !said.contains("inf"),
                "a head with {said}"
            );
            Ok(Outcome::Accepted)
        }
        Err(error) => refused(&error),
    }
}

/// Everything that a history tells.
fn told(history: &History) -> anyhow::Result<Vec<String>> {
    let ids = history.ids()?;
    let one = |id: &i64| {
        anyhow::Ok(format!(
            "{:?} {}",
            history.check(*id)?,
            history.document(*id)?
        ))
    };
    ids.iter().map(one).collect()
}

/// A refusal has something to say, and no NaN in it.
fn refused(error: &dyn std::error::Error) -> anyhow::Result<Outcome> {
    let said = error.to_string();
    ensure!(said.len() > 10, "a refusal that says nothing: {said:?}");
    ensure!(
        said.len() < 20_000,
        "a refusal of {} characters",
        said.len()
    );
    Ok(Outcome::Refused(said))
}

/// What a command makes of a file once it is read; an error says what must not be made of any.
fn made<F, T, E, G>(
    read: Result<F, E>,
    make: impl FnOnce(F) -> Result<T, G>,
    check: impl FnOnce(&T) -> anyhow::Result<()>,
) -> anyhow::Result<Outcome>
where
    E: std::error::Error,
    G: std::error::Error,
{
    let read = match read {
        Ok(read) => read,
        Err(error) => return refused(&error),
    };
    match make(read) {
        Ok(made) => check(&made).map(|()| Outcome::Accepted),
        Err(error) => Ok(match refused(&error)? {
            Outcome::Refused(said) => Outcome::RefusedLater(said),
            other => other,
        }),
    }
}

/// A head that was computed has finite values and uncertainties above zero.
fn sound(head: &HeadModel, sigma: &[f64; 2]) -> anyhow::Result<()> {
    let said = format!("{:?}{:?}", head.camera, head.projector);
    ensure!(
        !said.contains("NaN") && !said.contains("inf"),
        "a head with {said}"
    );
    let stated = sigma.iter().all(|sigma| sigma.is_finite() && *sigma > 0.0);
    ensure!(stated, "a head with the uncertainties {sigma:?}");
    Ok(())
}

/// Links the files of a folder, and copies those that mutants replace.
fn link(originals: &Path, to: &Path, name: &Path) -> std::io::Result<()> {
    std::fs::create_dir_all(to)?;
    for entry in std::fs::read_dir(originals.join(name))?.flatten() {
        let (inner, target) = (name.join(entry.file_name()), to.join(entry.file_name()));
        if entry.path().is_dir() {
            link(originals, &target, &inner)?;
        } else if FILES.iter().any(|(file, ..)| Path::new(file) == inner) {
            std::fs::copy(entry.path(), target)?;
        } else {
            std::fs::hard_link(entry.path(), target)?;
        }
    }
    Ok(())
}

fn accepted<T, E: std::error::Error>(read: Result<T, E>) -> anyhow::Result<Outcome> {
    read.map_or_else(|error| refused(&error), |_| Ok(Outcome::Accepted))
}
