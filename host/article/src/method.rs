//! The article's way from the same views to a map: one view after the other, each free to lie where its points want.
//!
//! ```text
//!  view ─► mask ─► 10 % ─► start ─► point-to-point ICP ─► axial shift ─► voxel centroids ─► nearest-point deviation
//!                            ▲                                │
//!                            └── correction for the next view ┘
//! ```
//!
//! Scattered points were removed before the views were kept; `denoise` removes more of them, the article's way. Where the article's formulas allow two readings or carry a
//! slip (which side the initial transformation stands on, the reflection case), the geometrically right one is taken.

use std::path::{Path, PathBuf};

use flankscope_foundation::rigid::{Cloud, Rigid, Tool as ToolFrame};
use flankscope_foundation::textfile::{self, BadValue, TextFileError, load_toml};
use flankscope_metrology::cloud::merge::{check_voxel_size, voxel_centroids};
use flankscope_metrology::cloud::outlier;
use flankscope_metrology::deviation::{Order, SampleTree, Statistics, statistics};
use flankscope_metrology::multiview::adjustment::{Pose, Stages};
use flankscope_metrology::multiview::cylinder::{CylinderMap, cell_observations};
use flankscope_metrology::registration::{
    ArticleOptions, Status, register_by_article, search_phase,
};
use flankscope_metrology::surface::sampling::{self, centre_of_mass};
use flankscope_metrology::tool::Tool;
use flankscope_metrology::verdict::Reason;
use nalgebra::{Isometry3, Point3, Translation3};
use serde::{Deserialize, Serialize};

use crate::drawn::coordinates;
use crate::space::InitialTransformation;
use crate::{ArticleError, ViewPoint, ViewPoints};
use flankscope_metrology::view::PlannedView;

/// Density of the reference points that the merged cloud is compared with, per mm²: chosen near the one at which a perfect piece has
/// the mean distance that the article reports, 0.5 / √50 mm = 71 µm of 74. It names none, and what it says allows 3 to 1700
/// (docs/density.md).
pub const MERGED_PER_MM2: f64 = 50.0;

/// Which scattered points go: those farther from their neighbours than most are from theirs.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Denoise {
    /// Neighbours that a point's mean distance is taken to.
    pub neighbours: usize,
    /// It goes when that is above the mean of all by more than so many standard deviations.
    pub std_ratio: f64,
}

impl Denoise {
    /// The article names neither; these are the defaults of the toolbox that it used (`pcdenoise`).
    pub const TOOLBOX: Self = Self {
        neighbours: 4,
        std_ratio: 1.0,
    };
}

/// Settings of the article's method, also as the file of `--article-settings`. They act on views that are kept: other settings stitch
/// the same views anew.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ArticleSettings {
    /// File of picked pairs that the first view starts from: x, y, z in its camera frame, then in CAD, mm.
    #[serde(skip_serializing)]
    pub pairs: Option<PathBuf>,
    /// Pose of the first view (tool frame from its camera frame) from picked pairs; without one, the files' hand-eye and a
    /// search for the tooth phase.
    #[serde(skip)]
    pub first_pose: Option<Rigid<ToolFrame, Cloud>>,
    /// The file says where the toothing ends; else the tool does.
    #[serde(skip)]
    pub radial_threshold_given: bool,
    /// Points around which the fringes oscillate less are masked: smoothed standard deviation, counts.
    pub mask_dn: f64,
    /// Scattered points that go beside those that are in no kept view.
    pub denoise: Option<Denoise>,
    /// Share of the points that are drawn.
    pub share: f64,
    /// Window, reference points and ends of every registration; its seed is that of all that is drawn.
    pub registration: ArticleOptions,
    /// Density of the reference points that the merged cloud is compared with, per mm².
    pub merged_per_mm2: f64,
    /// Side of the voxels of the merged cloud, mm.
    pub voxel_mm: f64,
    /// Distance between points.
    pub order: Order,
    /// Share of the pairs that count where a view is laid on the one before, without CAD; without it nine tenths of the points that
    /// both have.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub serial_inlier_ratio: Option<f64>,
}

impl ArticleSettings {
    /// The article's values as a settings file, with the unit of each and what the article leaves open.
    pub const FILE: &str = r#"# Settings of the article's method (scan --method article|both, article): its values.

mask_dn = 40.0                  # counts, points around which the fringes oscillate less are masked; the article names no number
share = 0.1                     # of the points that are drawn
voxel_mm = 0.05                 # mm, side of the voxels of the merged cloud; the article names none
merged_per_mm2 = 50.0           # reference points per mm2 that the merged cloud is compared with; the article names no density
order = "2"                     # of the distance between points: "1", "2" or "inf"
# serial_inlier_ratio = 0.5     # of the pairs that count where a view is laid on the one before, without CAD; else nine tenths of
                                # the points that both have, at most registration.inlier_ratio
# pairs = "pairs.csv"           # start from picked pairs: x,y,z in the first view's camera frame, then in CAD, mm; else from the head
                                # file and a search for the tooth phase

[denoise]                       # the defaults of the article's toolbox; without this table none beside what every scan removes
neighbours = 4                  # that a point's mean distance is taken to
std_ratio = 1.0                 # standard deviations beyond which a point goes

[registration]
samples = 100000                # reference points in the window of a view
inlier_ratio = 0.8              # of the pairs that count in a step
most_iterations = 25            # steps
translation_mm = 0.001          # mm, it ends with a step that shifts by less ...
rotation_deg = 0.005            # degrees, ... and turns by less; the article names no unit: 0.286 is the same number in radians

[registration.region]           # the window of reference points
half_height_mm = 10.0           # mm, the article's "10 mm" read as +-10
half_angle_rad = 0.2            # rad, the article's "0.2 rad" read as +-0.2
radial_threshold_mm = 50.0      # mm, only points nearer to the axis belong to the toothing
"#;

    /// Reads a settings file; the name of its pairs is relative to it.
    ///
    /// # Errors
    /// With file and line: it cannot be read, has an unknown key, or a value out of range.
    pub fn load(path: &Path) -> Result<Self, TextFileError> {
        let (mut settings, _) = load_toml(path, textfile::MAX_BYTES, Self::check)?;
        let is_key = |line: &str| line.trim_start().starts_with("radial_threshold_mm");
        settings.radial_threshold_given = textfile::read(path)?.lines().any(is_key);
        if let Some(pairs) = &mut settings.pairs {
            *pairs = path.with_file_name("").join(&pairs);
        }
        Ok(settings)
    }

    #[rustfmt::skip]
    fn check(&self) -> Result<(), BadValue> {
        let options = &self.registration;
        let region = options.region;
        let denoise = self.denoise.unwrap_or(Denoise::TOOLBOX);
        let serial = self.serial_inlier_ratio.unwrap_or(1.0);
        let pi = std::f64::consts::PI;
        for (key, value, [least, most], unit) in [
            ("mask_dn", self.mask_dn, [0.0, 65_535.0], "counts"),
            ("share", self.share, [1e-4, 1.0], "of the points"),
            ("merged_per_mm2", self.merged_per_mm2, [0.1, 2000.0], "points per mm2"),
            ("serial_inlier_ratio", serial, [0.01, 1.0], "of the pairs"),
            ("denoise.neighbours", denoise.neighbours as f64, [1.0, 100.0], "neighbours"),
            ("denoise.std_ratio", denoise.std_ratio, [0.0, 100.0], "standard deviations"),
            ("registration.samples", options.samples as f64, [100.0, 1e7], "points"),
            ("registration.inlier_ratio", options.inlier_ratio, [0.01, 1.0], "of the pairs"),
            ("registration.most_iterations", options.most_iterations as f64, [1.0, 1000.0], "steps"),
            ("registration.translation_mm", options.translation_mm, [0.0, 1.0], "mm"),
            ("registration.rotation_deg", options.rotation_deg, [0.0, 1.0], "degrees"),
            ("registration.region.half_height_mm", region.half_height_mm, [0.1, 1000.0], "mm"),
            ("registration.region.half_angle_rad", region.half_angle_rad, [0.001, pi], "rad"),
            ("registration.region.radial_threshold_mm", region.radial_threshold_mm, [0.1, 1e4], "mm"),
        ] {
            // A NaN is in no range.
            if !(least..=most).contains(&value) {
                let right = format!("{least} to {most} {unit} are possible");
                return Err(BadValue::new(key, value, right));
            }
        }
        check_voxel_size(self.voxel_mm)
            .map_err(|_| BadValue::new("voxel_mm", self.voxel_mm, "a length above 0 mm"))
    }
}

impl ArticleSettings {
    /// Seed of what is drawn for a view.
    fn seed_of(&self, view: usize) -> u64 {
        self.registration.seed.wrapping_add((view as u64) << 32)
    }

    /// For people.
    pub fn in_words(&self) -> String {
        let of = &self.registration;
        let denoise = match self.denoise {
            Some(by) => format!(
                "points beyond {} standard deviations of the distance to {} neighbours removed",
                by.std_ratio, by.neighbours
            ),
            None => "no further denoising".into(),
        };
        format!(
            "mask at {} counts; {denoise}; {} % of the points; {} reference points in ±{} mm by ±{} rad; {} % of the pairs; at most {} \
             steps, until below {} mm and {}°; voxels of {} mm; {} reference points per mm² for all views",
            self.mask_dn,
            100.0 * self.share,
            of.samples,
            of.region.half_height_mm,
            of.region.half_angle_rad,
            100.0 * of.inlier_ratio,
            of.most_iterations,
            of.translation_mm,
            of.rotation_deg,
            self.voxel_mm,
            self.merged_per_mm2
        )
    }
}

impl ArticleSettings {
    /// For a tool whose toothing ends there, unless the file says otherwise: the article's 50 mm are its own die's.
    #[must_use]
    pub fn for_toothing(mut self, radial_threshold_mm: f64) -> Self {
        if !self.radial_threshold_given {
            self.registration.region.radial_threshold_mm = radial_threshold_mm;
        }
        self
    }
}

impl Default for ArticleSettings {
    /// The article's values without its denoising: a view's scattered points are gone before it is kept.
    fn default() -> Self {
        Self {
            pairs: None,
            first_pose: None,
            radial_threshold_given: false,
            serial_inlier_ratio: None,
            mask_dn: 40.0,
            denoise: None,
            share: 0.1,
            registration: ArticleOptions::default(),
            merged_per_mm2: MERGED_PER_MM2,
            voxel_mm: 0.05,
            order: Order::Two,
        }
    }
}

/// A view on random CAD points.
pub struct ArticleView {
    /// Its number.
    pub view: usize,
    /// Root mean square distance of its points to the nearest reference points, mm.
    pub rms_mm: f64,
    /// Its pose.
    pub tool_from_camera: Isometry3<f64>,
    /// Steps of its registration.
    pub iterations: usize,
    /// Centre of its points there, mm.
    pub centre_mm: Point3<f64>,
}

/// Views that were laid on random CAD points one by one.
pub struct ArticleStitched {
    /// Views that took part.
    pub views: Vec<ArticleView>,
    /// Where the first of them started from.
    pub initial: Option<InitialTransformation>,
    /// Views that did not settle on the CAD.
    pub refused: Vec<(usize, Reason)>,
    /// Exact distances of the laid points: what the stitching alone makes of the form.
    pub map: CylinderMap,
    /// Distances of the first view's points to the nearest reference point.
    pub one_view: Option<Statistics>,
    /// The same of the merged cloud.
    pub merged: Option<Statistics>,
}

/// Stitches views as the article does, into an empty `map`. `progress` is told how many views are done, and of how many.
///
/// # Errors
/// The points of a view cannot be read, or not be merged.
pub fn stitch<P: ViewPoints>(
    scanned: &P,
    tool: &Tool,
    planned: &[PlannedView],
    nominal: &Stages,
    mut map: CylinderMap,
    settings: &ArticleSettings,
    progress: &mut dyn FnMut(usize, usize),
) -> Result<ArticleStitched, ArticleError<P::Error>> {
    let teeth = tool.gear.as_ref().map_or(1, |gear| gear.teeth);
    let stages = Stages::nominal(Rigid::from_isometry(Isometry3::identity()));
    // What stands between stage and camera: found with one view, it is where the next one starts.
    let mut stage_from_camera: Option<Isometry3<f64>> = None;
    // Height of a view's centre of mass above its place on the vertical stage.
    let mut centre_above_mm = None;
    let (mut views, mut refused, mut cloud) = (Vec::new(), Vec::new(), Vec::new());
    let (mut one_view, mut initial) = (None, None);
    let numbers = scanned.view_numbers();
    for (done, &view) in numbers.iter().enumerate() {
        progress(done, numbers.len());
        let Some(at) = planned.get(view).map(Pose::from) else {
            continue;
        };
        let points = scanned.view_points(view).map_err(ArticleError::Points)?;
        let seed = settings.seed_of(view);
        let drawn = Drawing::of_view(&points, settings, view).points;
        let xyz = coordinates(&drawn);
        let moved = *stages.tool_from_camera(at).isometry();
        let start = match (stage_from_camera, settings.first_pose) {
            (Some(known), _) => moved * known,
            (None, Some(picked)) => *picked.isometry(),
            (None, None) => {
                let start = Rigid::from_isometry(*nominal.tool_from_camera(at).isometry());
                *search_phase(&tool.surface, &xyz, &start, teeth).isometry()
            }
        };
        let options = ArticleOptions {
            seed,
            ..settings.registration
        };
        let start = Rigid::from_isometry(start);
        let (found, reference) = register_by_article(&tool.mesh, &xyz, &start, &options);
        let Some(reference) = reference.filter(|_| found.is_registered()) else {
            if let Status::Indeterminate(reason) = found.status {
                refused.push((view, Reason::instrument((&reason).into(), reason)));
            }
            continue;
        };
        let mut pose = *found.tool_from_cloud.isometry();
        let laid: Vec<[f64; 3]> = xyz
            .iter()
            .map(|&p| found.tool_from_cloud.apply(p))
            .collect();
        let Some(centre) = centre_of_mass(&laid) else {
            continue;
        };
        let above = *centre_above_mm.get_or_insert(centre[2] - at.vertical_mm);
        pose = Translation3::new(0.0, 0.0, at.vertical_mm + above - centre[2]) * pose;
        stage_from_camera = Some(moved.inverse() * pose);
        let tool_from_camera = pose;
        let pose = Rigid::<ToolFrame, Cloud>::from_isometry(pose);
        let laid: Vec<[f64; 3]> = xyz.iter().map(|&p| pose.apply(p)).collect();
        let Some(distances) = statistics(&reference.distances(&laid, settings.order)) else {
            continue;
        };
        one_view.get_or_insert(distances);
        initial.get_or_insert(InitialTransformation::new(view, start.isometry()));
        let sigma: Vec<f32> = drawn.iter().map(|p| p[3]).collect();
        let closest = tool.surface.closest_many(&laid);
        map.add_view(&cell_observations(&map.layout(), &closest, &sigma), |_| 0.0);
        views.push(ArticleView {
            view,
            rms_mm: distances.rms_mm,
            tool_from_camera,
            iterations: found.iterations,
            centre_mm: Point3::new(centre[0], centre[1], at.vertical_mm + above),
        });
        cloud.extend(laid);
    }
    let merged = voxel_centroids(&cloud, settings.voxel_mm)?;
    Ok(ArticleStitched {
        views,
        initial,
        refused,
        map,
        one_view,
        merged: nearest(&merged, &whole_reference(tool, settings), settings.order),
    })
}

/// What a view comes to before it is laid on the CAD.
pub(crate) struct Drawing {
    /// Points that the mask leaves.
    pub masked: usize,
    /// Points of those that denoising leaves.
    pub denoised: usize,
    /// A share of these.
    pub points: Vec<ViewPoint>,
}

impl Drawing {
    /// Masks and denoises the points of a view, and draws a share of what is left.
    pub fn of_view(points: &[ViewPoint], settings: &ArticleSettings, view: usize) -> Self {
        let lit = |point: &&ViewPoint| f64::from(point[4]) >= settings.mask_dn;
        let masked: Vec<ViewPoint> = points.iter().filter(lit).copied().collect();
        let masked_count = masked.len();
        let left = denoised(masked, settings.denoise);
        let seed = settings.seed_of(view);
        let drawn = |(_, index): &(&ViewPoint, u64)| sampling::drawn(seed, *index, settings.share);
        let points = left.iter().zip(0..).filter(drawn);
        Self {
            masked: masked_count,
            denoised: left.len(),
            points: points.map(|(point, _)| *point).collect(),
        }
    }
}

/// Points that are not scattered.
fn denoised(points: Vec<ViewPoint>, denoise: Option<Denoise>) -> Vec<ViewPoint> {
    let Some(denoise) = denoise else {
        return points;
    };
    let xyz = coordinates(&points);
    let keep = outlier::statistical(&xyz, denoise.neighbours, denoise.std_ratio);
    let kept = points.into_iter().zip(keep).filter(|(_, keep)| *keep);
    kept.map(|(point, _)| point).collect()
}

/// Reference points all over the toothing.
pub(crate) fn whole_reference(tool: &Tool, settings: &ArticleSettings) -> Vec<[f64; 3]> {
    let registration = &settings.registration;
    let threshold_mm = registration.region.radial_threshold_mm;
    let area_mm2 = sampling::area_mm2(&tool.mesh);
    let count = (area_mm2 * settings.merged_per_mm2).clamp(1.0, 1e8) as usize;
    let mut points = sampling::sample(&tool.mesh, count, registration.seed).unwrap_or_default();
    points.retain(|p| p[0].hypot(p[1]) <= threshold_mm);
    points
}

fn nearest(points: &[[f64; 3]], reference: &[[f64; 3]], order: Order) -> Option<Statistics> {
    let tree = SampleTree::new(reference).ok()?;
    statistics(&tree.distances(points, order))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_settings_file_has_the_article_s_values() {
        let file: ArticleSettings = toml::from_str(ArticleSettings::FILE).unwrap();
        let article = ArticleSettings {
            denoise: Some(Denoise::TOOLBOX),
            ..ArticleSettings::default()
        };
        assert_eq!(file, article);
        let empty: ArticleSettings = toml::from_str("").unwrap();
        assert_eq!(empty, ArticleSettings::default());
        // Every key that a result says, but those that no file sets.
        let said = serde_json::to_value(&file).unwrap();
        for (table, own) in [
            ("", &["denoise", "registration"][..]),
            ("/denoise", &[]),
            (
                "/registration",
                &["seed", "region", "least_points", "most_rms_mm"],
            ),
            ("/registration/region", &[]),
        ] {
            let keys = said.pointer(table).unwrap().as_object().unwrap().keys();
            for key in keys.filter(|key| !own.contains(&key.as_str())) {
                let line = format!("\n{key} = ");
                assert!(ArticleSettings::FILE.contains(&line), "{key}");
            }
        }
    }
}
