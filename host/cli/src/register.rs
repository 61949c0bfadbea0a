//! `flankscope register`: registers a cloud to a CAD mesh, or to another cloud.

use std::f64::consts::TAU;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, bail};
use flankscope_foundation::rigid::{Cloud, Rigid, Tool};
use flankscope_metrology::cloud_surface::CloudSurface;
use flankscope_metrology::io::cloud::Cloud as CloudFile;
use flankscope_metrology::io::ply::Scalar;
use flankscope_metrology::io::points::Format;
use flankscope_metrology::registration::{
    Options, Registration, RegistrationFailure, Status, TYPICAL_NOISE_MM, detect_teeth, register,
    register_by_article,
};
use flankscope_metrology::surface::{Surface, sampling};
use flankscope_metrology::tool::gear_in_cad::find_gear;
use flankscope_metrology::verdict::Code;
use flankscope_report::{MOST_PICK_POINTS, PickSides, pick_html};
use serde::Serialize;

use crate::article_settings::ArticleSettingsFile;
use crate::geometry::{
    Cad, CadArgs, CloudReading, LoadedCloud, StartPose, milliseconds, tell, write_file,
};
use crate::output::{Common, Outcome, say, write_whole};

/// Tolerance of the CAD's periodicity for poses one pitch apart to count as alike, mm.
const REPEAT_TOLERANCE_MM: f64 = 0.02;

/// Seed of the article's reference points, and of those on the page for picking.
const SEED: u64 = 0;

/// Register a cloud to a CAD mesh or to another cloud.
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  flankscope register --cad die.stl --cloud view.ply -o aligned.ply --json -\n\n\
    With --method article, --article-settings gives the window of reference points, their number, the share of pairs and the end of the fit by its\n\
    table [registration], and the start pose by its pairs; what it says of views (mask_dn, share, denoise, voxel_mm) does not concern one cloud.\n\n\
    Without a start pose the fit begins at the identity. If the CAD has teeth and more than a tenth of the points stays off the surface,\n\
    it begins anew from turns within a pitch, and the fit with most points on the surface counts.\n\n\
    Exit codes: 0 registered, 2 indeterminate, 3 could not run.",
    group(clap::ArgGroup::new("on").args(["path", "reference"]).required(true))
)]
pub struct Args {
    #[command(flatten)]
    cad: Option<CadArgs>,
    /// Reference cloud instead of a mesh: PLY, arrays (.npz) or text with `x y z` per line. Each of its points stands for the plane
    /// through its 20 nearest neighbours.
    #[arg(long, value_name = "CLOUD")]
    reference: Option<PathBuf>,
    /// Cloud: PLY, arrays (.npz) or text with `x y z` per line.
    #[arg(long, value_name = "CLOUD")]
    cloud: PathBuf,
    #[command(flatten)]
    reading: CloudReading,
    #[command(flatten)]
    start: StartPose,
    /// Standard deviation of a point, mm. All limits of the fit scale with it: the first iterations use points up to 250 times this
    /// distance from the surface, an inlier lies within 7.5 times, a direction is weak if its own standard deviation is above 0.05
    /// times, and unobserved above 0.5 times.
    #[arg(long, value_name = "MM", default_value_t = TYPICAL_NOISE_MM, value_parser = positive_mm)]
    noise_mm: f64,
    /// Least share of the points that must lie on the surface after the fit, 0 to 1.
    #[arg(long, value_name = "SHARE", default_value_t = 0.5, value_parser = share)]
    least_inliers: f64,
    /// Number of teeth about z, if poses one pitch apart look alike [default: found in the CAD; none for a reference cloud]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(2..=1000))]
    teeth: Option<u32>,
    /// Fit to the surface itself, or the article's point-to-point fit to random points on it.
    #[arg(long, value_enum, default_value_t = Method::Surface)]
    method: Method,
    #[command(flatten)]
    article: ArticleSettingsFile,
    /// Write the cloud in CAD coordinates, as binary PLY, text (name.xyz) or arrays for NumPy (name.npz); only if it was registered.
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Register nothing, but write a page on which corresponding points of cloud and CAD are picked by clicks and saved for --pairs.
    #[arg(long, value_name = "PAGE.html", conflicts_with_all = ["output", "init", "pairs"])]
    pick: Option<PathBuf>,
    #[command(flatten)]
    common: Common,
}

fn positive_mm(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| "not a number".to_owned())?;
    if value.is_finite() && value > 0.0 {
        return Ok(value);
    }
    Err(format!("{value} is no length above 0 mm"))
}

fn share(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| "not a number".to_owned())?;
    if value > 0.0 && value <= 1.0 {
        return Ok(value);
    }
    Err(format!("{value} is no share above 0, up to 1"))
}

#[derive(clap::ValueEnum, Clone, Copy, PartialEq)]
enum Method {
    Surface,
    // Its earlier name is understood, too.
    #[value(alias = "paper")]
    Article,
}

#[derive(Serialize)]
struct Report {
    tool_from_cloud: [[f64; 4]; 4],
    status: &'static str,
    reason: Option<String>,
    reason_code: Option<Code>,
    converged: bool,
    iterations: usize,
    points: usize,
    /// Points of the file that were left out because a coordinate is not finite.
    points_not_finite: usize,
    inliers: usize,
    rms_mm: Option<f64>,
    /// Unit vectors (rotation x, y, z times `arm_mm`; translation x, y, z), weakest first.
    weak_directions: Vec<[f64; 6]>,
    /// For each weak direction, the prior's fraction of the information along it.
    weak_prior_share: Vec<f64>,
    /// For each weak direction, its standard deviation from the points alone; null if they give no information.
    weak_sigma_mm: Vec<Option<f64>>,
    centre_mm: [f64; 3],
    arm_mm: f64,
    teeth: Option<u32>,
    elapsed_ms: Elapsed,
}

#[derive(Serialize)]
struct Elapsed {
    load: f64,
    prepare: f64,
    align: f64,
}

impl Elapsed {
    /// Durations of loading, preparation and registration.
    fn between(at: [Instant; 4]) -> Self {
        Self {
            load: milliseconds(at[0], at[1]),
            prepare: milliseconds(at[1], at[2]),
            align: milliseconds(at[2], at[3]),
        }
    }
}

/// Runs the subcommand.
pub fn run(args: &Args) -> anyhow::Result<Outcome> {
    let format = args.output.as_deref().map(Format::of_cloud).transpose()?;
    anyhow::ensure!(
        args.article.article_settings.is_none() || args.method == Method::Article,
        "--article-settings is for the article's method: add --method article"
    );
    if let Some(page) = &args.pick {
        return args.write_pick_page(page);
    }
    let start = Instant::now();
    let Laid {
        loaded_cloud: LoadedCloud { cloud, not_finite },
        found,
        teeth,
        elapsed_ms,
    } = match (&args.cad, &args.reference) {
        (Some(cad), _) => args.on_mesh(cad, start)?,
        (None, Some(reference)) => args.on_cloud(reference, start)?,
        (None, None) => bail!("nothing to lay the cloud on: --cad MESH or --reference CLOUD"),
    };
    if let Status::Indeterminate(reason @ RegistrationFailure::TooFewPoints { .. }) = &found.status
    {
        // Not a doubtful result, but an unusable input.
        bail!("cloud {} has {reason}", args.cloud.display());
    }

    if found.is_registered()
        && let Some((output, format)) = args.output.as_ref().zip(format)
    {
        let points: Vec<[f64; 3]> = cloud
            .points
            .iter()
            .map(|&point| found.tool_from_cloud.apply(point))
            .collect();
        let laid = CloudFile {
            points: flankscope_metrology::io::cloud::FinitePoints::new(points)?,
            // Rotated coordinates are no longer rounded as in the file, so they are written in double precision.
            coordinate: Scalar::F64,
            extras: cloud.extras,
        };
        write_file(output, |out| laid.write(format, out, &[]))?;
    }
    let report = Report::new(&found, (cloud.points.len(), not_finite), teeth, elapsed_ms);
    args.common.write_json(&report)?;
    let off = report.points - report.inliers;
    if found.is_registered()
        && !args.common.quiet
        && off as f64 > (1.0 - ENOUGH_INLIERS) * report.points as f64
    {
        say(&format!(
            "note: {off} of {} points do not lie on the surface after the fit; `flankscope deviation` shows where",
            report.points
        ));
    }
    tell(&args.common, || report.line());
    Ok(if found.is_registered() {
        Outcome::Done
    } else {
        Outcome::INDETERMINATE
    })
}

/// A registration with its inputs.
struct Laid {
    loaded_cloud: LoadedCloud,
    found: Registration,
    teeth: Option<u32>,
    elapsed_ms: Elapsed,
}

impl Args {
    /// Cloud and CAD (or reference cloud) beside each other.
    fn write_pick_page(&self, page: &Path) -> anyhow::Result<Outcome> {
        let LoadedCloud { cloud, .. } = self.reading.load(&self.cloud, &self.common)?;
        let (cad, cad_mm): (&Path, Vec<[f64; 3]>) = match (&self.cad, &self.reference) {
            (Some(cad), _) => {
                let Cad { mesh, .. } = cad.load(&self.common)?;
                let sampled = sampling::sample(&mesh, MOST_PICK_POINTS, SEED);
                (&cad.path, sampled.with_context(|| cad.trouble())?)
            }
            (None, Some(reference)) => {
                let LoadedCloud { cloud: other, .. } =
                    self.reading.load(reference, &self.common)?;
                (reference, other.points.to_vec())
            }
            (None, None) => bail!("nothing to pick on: --cad MESH or --reference CLOUD"),
        };
        let [cloud_name, cad_name] = [self.cloud.as_path(), cad].map(|file| {
            file.file_name()
                .unwrap_or_default()
                .to_string_lossy()
                .into_owned()
        });
        let html = pick_html(&PickSides {
            cloud: &cloud_name,
            cloud_mm: &cloud.points,
            cad: &cad_name,
            cad_mm: &cad_mm,
        })?;
        write_whole(page, html.as_bytes())?;
        tell(&self.common, || {
            format!(
                "{}: open it in a browser, pick pairs, save them, and register with --pairs pairs.csv",
                page.display()
            )
        });
        Ok(Outcome::Done)
    }

    fn on_mesh(&self, cad: &CadArgs, start: Instant) -> anyhow::Result<Laid> {
        let Cad { mesh, orientation } = cad.load(&self.common)?;
        let loaded_cloud = self.reading.load(&self.cloud, &self.common)?;
        let cloud = &loaded_cloud.cloud;
        let article = self.article.load(SEED)?;
        let initial = match article.first_pose {
            Some(_) if self.start.is_given() => bail!(
                "the start pose is given twice: pairs in the file of --article-settings, and --init or --pairs; leave one out"
            ),
            Some(picked) => picked,
            None => self.start.pose()?,
        };
        let loaded = Instant::now();
        let surface = Surface::oriented(&mesh, &orientation).with_context(|| cad.trouble())?;
        let found = || detect_teeth(&mesh, &surface, REPEAT_TOLERANCE_MM);
        let teeth = self.teeth.or_else(found);
        if teeth.is_none()
            && let Ok((gear, _)) = find_gear(&mesh)
        {
            say(&format!(
                "note: CAD mesh {}: it shows a gear of {} teeth about another axis than z, so neighbouring teeth are not told apart; \
                 `flankscope init` writes the CAD with its axis along z",
                cad.path.display(),
                gear.gear.teeth
            ));
        }
        let options = self.options(initial, teeth);
        let prepared = Instant::now();
        let found = match self.method {
            Method::Surface if self.start.is_given() => {
                register(&surface, &cloud.points, None, &options)
            }
            Method::Surface => register_any_turn(&surface, &cloud.points, &options),
            Method::Article => {
                register_by_article(&mesh, &cloud.points, &initial, &article.registration).0
            }
        };
        Ok(Laid {
            loaded_cloud,
            found,
            teeth: options.teeth,
            elapsed_ms: Elapsed::between([start, loaded, prepared, Instant::now()]),
        })
    }

    fn on_cloud(&self, reference: &Path, start: Instant) -> anyhow::Result<Laid> {
        anyhow::ensure!(
            self.method == Method::Surface,
            "--method article draws its points on a mesh: name one by --cad instead of --reference"
        );
        let LoadedCloud { cloud: other, .. } = self.reading.load(reference, &self.common)?;
        let loaded_cloud = self.reading.load(&self.cloud, &self.common)?;
        let cloud = &loaded_cloud.cloud;
        let initial = self.start.pose()?;
        let loaded = Instant::now();
        let surface = CloudSurface::new(&other.points, self.noise_mm)
            .with_context(|| format!("cannot use cloud {}", reference.display()))?;
        // A part of a ring does not show the number of teeth of the whole.
        let options = self.options(initial, self.teeth);
        let prepared = Instant::now();
        let found = register(&surface, &cloud.points, None, &options);
        Ok(Laid {
            loaded_cloud,
            found,
            teeth: options.teeth,
            elapsed_ms: Elapsed::between([start, loaded, prepared, Instant::now()]),
        })
    }

    fn options(&self, initial: Rigid<Tool, Cloud>, teeth: Option<u32>) -> Options {
        Options {
            initial,
            teeth,
            least_inlier_ratio: self.least_inliers,
            ..Options::for_noise(self.noise_mm)
        }
    }
}

/// Share of inliers from which on a registration is not tried from other turns.
const ENOUGH_INLIERS: f64 = 0.9;
/// Turns within a pitch from which a registration is tried.
const TURNS: u32 = 8;

/// Registers a cloud whose start pose is not known. Plain faces of a gear (bore, ends) fit at any turn about the axis, so that a fit
/// may end between two teeth with more than half of the points on the surface. Where points are left over, turns within one pitch
/// are tried, and the registration with most inliers counts.
fn register_any_turn(surface: &Surface, points: &[[f64; 3]], options: &Options) -> Registration {
    let mut best = register(surface, points, None, options);
    let Some(teeth) = options.teeth else {
        return best;
    };
    let is_enough = |found: &Registration| {
        found.is_registered() && found.inliers as f64 >= ENOUGH_INLIERS * points.len() as f64
    };
    for turn in 1..TURNS {
        if is_enough(&best) {
            break;
        }
        let angle = TAU * f64::from(turn) / f64::from(TURNS * teeth);
        let (sin, cos) = angle.sin_cos();
        let turned = Rigid::<Tool, Tool>::from_rows(&[
            [cos, -sin, 0.0, 0.0],
            [sin, cos, 0.0, 0.0],
            [0.0, 0.0, 1.0, 0.0],
            [0.0, 0.0, 0.0, 1.0],
        ]);
        let Ok(turned) = turned else { continue };
        let options = Options {
            initial: turned * options.initial,
            ..options.clone()
        };
        let found = register(surface, points, None, &options);
        let is_better = found.is_registered() && !best.is_registered()
            || found.is_registered() == best.is_registered() && found.inliers > best.inliers;
        if is_better {
            best = found;
        }
    }
    best
}

impl Report {
    fn new(
        found: &Registration,
        (points, not_finite): (usize, usize),
        teeth: Option<u32>,
        elapsed_ms: Elapsed,
    ) -> Self {
        let reason = match &found.status {
            Status::Registered => None,
            Status::Indeterminate(reason) => Some(reason),
        };
        let finite = |value: f64| value.is_finite().then_some(value);
        let weak = &found.weak_directions;
        Self {
            tool_from_cloud: found.tool_from_cloud.to_rows(),
            status: if reason.is_none() {
                "registered"
            } else {
                "indeterminate"
            },
            reason: reason.map(ToString::to_string),
            reason_code: reason.map(Code::from),
            converged: found.converged,
            iterations: found.iterations,
            points,
            points_not_finite: not_finite,
            inliers: found.inliers,
            rms_mm: finite(found.rms_mm),
            weak_directions: weak.iter().map(|w| w.vector).collect(),
            weak_prior_share: weak.iter().map(|w| w.prior_share).collect(),
            weak_sigma_mm: weak.iter().map(|w| finite(w.sigma_mm)).collect(),
            centre_mm: found.centre_mm,
            arm_mm: found.arm_mm,
            teeth,
            elapsed_ms,
        }
    }

    fn line(&self) -> String {
        match (&self.reason, self.rms_mm) {
            (None, Some(rms_mm)) => format!(
                "registered: rms {:.2} um over {} of {} points, {} steps, {} weak directions, {:.1} ms",
                1e3 * rms_mm,
                self.inliers,
                self.points,
                self.iterations,
                self.weak_directions.len(),
                self.elapsed_ms.align
            ),
            (reason, _) => format!(
                "indeterminate: {}",
                reason.as_deref().unwrap_or("no figure")
            ),
        }
    }
}
