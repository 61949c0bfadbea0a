//! What the article's method is told: options of `scan` and `article`, with the article's values where it names them.

use std::path::PathBuf;

use flankscope_jobs::scan::{Denoise, Hinz2019Settings};
use flankscope_metrology::cloud::merge::check_voxel_size;
use flankscope_metrology::deviation::Order;

use crate::geometry::{MinkowskiOrder, pose_of_pairs};

/// Settings of the article's method. They act on views that are kept: a session is stitched anew with others.
#[derive(clap::Args, Clone, Debug)]
#[command(next_help_heading = "The article's method")]
pub struct PaperOptions {
    /// Take the article's values for what is not given here: those below that name it, and the denoising of its toolbox
    /// (--denoise 4 --denoise-sigma 1)
    #[arg(long)]
    article: bool,
    /// Start from picked pairs: per line x,y,z in the first view's camera frame, then CAD x,y,z, mm [default: from the head
    /// file and a search for the tooth phase]
    #[arg(long, value_name = "P.csv")]
    pairs: Option<PathBuf>,
    /// Order of the distance between points [default: 2]
    #[arg(long, value_enum)]
    order: Option<MinkowskiOrder>,
    /// Mask: least smoothed standard deviation of the finest fringes, counts [default: 40; the article names none]
    #[arg(long, value_name = "DN")]
    mask_threshold: Option<f64>,
    /// Denoising: neighbours that a point's mean distance is taken to [default: none but what every scan removes; the
    /// article names no number]
    #[arg(long, value_name = "K")]
    denoise: Option<usize>,
    /// Denoising: a point goes beyond so many standard deviations [default: 1]
    #[arg(long, value_name = "SIGMA")]
    denoise_sigma: Option<f64>,
    /// Share of the points that are drawn [default: 0.1, the article's]
    #[arg(long, value_name = "RATIO")]
    share: Option<f64>,
    /// Half height of the window of reference points [default: 10: the article's "10 mm" read as ±10]
    #[arg(long, value_name = "MM")]
    roi_mm: Option<f64>,
    /// Half width of that window [default: 0.2: the article's "0.2 rad" read as ±0.2]
    #[arg(long, value_name = "RAD")]
    roi_rad: Option<f64>,
    /// Reference points in the window of a view [default: 100000, the article's]
    #[arg(long, value_name = "COUNT")]
    alpha_points: Option<usize>,
    /// Reference points that the merged cloud is compared with [default: 50; the article names no density]
    #[arg(long, value_name = "PER_MM2")]
    alpha_per_mm2: Option<f64>,
    /// Share of the pairs that count in a step [default: 0.8, the article's]
    #[arg(long, value_name = "RATIO")]
    inlier_ratio: Option<f64>,
    /// Most steps of a registration [default: 25, the article's]
    #[arg(long, value_name = "COUNT")]
    most_iterations: Option<usize>,
    /// A registration ends with a step that shifts by less [default: 0.001, the article's]
    #[arg(long, value_name = "MM")]
    translation_tolerance_mm: Option<f64>,
    /// ... and turns by less [default: 0.005: the article's, which has no unit, read as degrees; 0.286 is the same in radians]
    #[arg(long, value_name = "DEG")]
    rotation_tolerance_deg: Option<f64>,
    /// Side of the voxels of the merged cloud [default: 0.05; the article names none]
    #[arg(long, value_name = "MM")]
    voxel_mm: Option<f64>,
}

impl PaperOptions {
    /// The first of these options that was given.
    pub fn given(&self) -> Option<&'static str> {
        let options = [
            ("--article", self.article),
            ("--pairs", self.pairs.is_some()),
            ("--order", self.order.is_some()),
            ("--mask-threshold", self.mask_threshold.is_some()),
            ("--denoise", self.denoise.is_some()),
            ("--denoise-sigma", self.denoise_sigma.is_some()),
            ("--share", self.share.is_some()),
            ("--roi-mm", self.roi_mm.is_some()),
            ("--roi-rad", self.roi_rad.is_some()),
            ("--alpha-points", self.alpha_points.is_some()),
            ("--alpha-per-mm2", self.alpha_per_mm2.is_some()),
            ("--inlier-ratio", self.inlier_ratio.is_some()),
            ("--most-iterations", self.most_iterations.is_some()),
            (
                "--translation-tolerance-mm",
                self.translation_tolerance_mm.is_some(),
            ),
            (
                "--rotation-tolerance-deg",
                self.rotation_tolerance_deg.is_some(),
            ),
            ("--voxel-mm", self.voxel_mm.is_some()),
        ];
        let mut given = options.iter().filter(|(_, given)| *given);
        given.next().map(|(option, _)| *option)
    }

    /// What was asked for; what is drawn, by `seed`.
    pub fn settings(&self, seed: u64) -> anyhow::Result<Hinz2019Settings> {
        let mut settings = match self.article {
            true => Hinz2019Settings::article(),
            false => Hinz2019Settings::default(),
        };
        settings.first_pose = self.pairs.as_deref().map(pose_of_pairs).transpose()?;
        settings.order = self.order.map_or(settings.order, Order::from);
        set(
            ("--mask-threshold", self.mask_threshold),
            (0.0, 65_535.0, "counts"),
            &mut settings.mask_dn,
        )?;
        self.set_denoise(&mut settings)?;
        set(
            ("--share", self.share),
            (1e-4, 1.0, "of the points"),
            &mut settings.share,
        )?;
        set(
            ("--alpha-per-mm2", self.alpha_per_mm2),
            (0.1, 2000.0, "points per mm2"),
            &mut settings.merged_per_mm2,
        )?;
        let registration = &mut settings.registration;
        registration.seed = seed;
        let region = &mut registration.region;
        set(
            ("--roi-mm", self.roi_mm),
            (0.1, 1000.0, "mm"),
            &mut region.half_height_mm,
        )?;
        set(
            ("--roi-rad", self.roi_rad),
            (0.001, std::f64::consts::PI, "rad"),
            &mut region.half_angle_rad,
        )?;
        set(
            ("--inlier-ratio", self.inlier_ratio),
            (0.01, 1.0, "of the pairs"),
            &mut registration.inlier_ratio,
        )?;
        set(
            ("--translation-tolerance-mm", self.translation_tolerance_mm),
            (0.0, 1.0, "mm"),
            &mut registration.translation_mm,
        )?;
        set(
            ("--rotation-tolerance-deg", self.rotation_tolerance_deg),
            (0.0, 1.0, "degrees"),
            &mut registration.rotation_deg,
        )?;
        count(
            ("--alpha-points", self.alpha_points),
            (100, 10_000_000),
            &mut registration.samples,
        )?;
        count(
            ("--most-iterations", self.most_iterations),
            (1, 1000),
            &mut registration.most_iterations,
        )?;
        settings.voxel_mm = self.voxel_mm.unwrap_or(settings.voxel_mm);
        check_voxel_size(settings.voxel_mm)?;
        Ok(settings)
    }

    fn set_denoise(&self, settings: &mut Hinz2019Settings) -> anyhow::Result<()> {
        let mut denoise = settings.denoise.unwrap_or(Denoise::TOOLBOX);
        anyhow::ensure!(
            settings.denoise.is_some() || self.denoise.is_some() || self.denoise_sigma.is_none(),
            "--denoise-sigma without neighbours: add --denoise K, or --article"
        );
        count(
            ("--denoise", self.denoise),
            (1, 100),
            &mut denoise.neighbours,
        )?;
        set(
            ("--denoise-sigma", self.denoise_sigma),
            (0.0, 100.0, "standard deviations"),
            &mut denoise.std_ratio,
        )?;
        if self.article || self.denoise.is_some() {
            settings.denoise = Some(denoise);
        }
        Ok(())
    }
}

/// Sets what was given, if it is one of what is possible.
fn set(
    (option, given): (&str, Option<f64>),
    (low, high, unit): (f64, f64, &str),
    value: &mut f64,
) -> anyhow::Result<()> {
    let Some(given) = given else {
        return Ok(());
    };
    anyhow::ensure!(
        (low..=high).contains(&given),
        "{option} {given}: {low} to {high} {unit} are possible, {value} is usual"
    );
    *value = given;
    Ok(())
}

/// As [`set`], of things that are counted.
fn count(
    (option, given): (&str, Option<usize>),
    (low, high): (usize, usize),
    value: &mut usize,
) -> anyhow::Result<()> {
    let Some(given) = given else {
        return Ok(());
    };
    anyhow::ensure!(
        (low..=high).contains(&given),
        "{option} {given}: {low} to {high} are possible, {value} is usual"
    );
    *value = given;
    Ok(())
}
