//! Result of a scan: the JSON document.

mod coverage;
mod gear;
mod metrics;
mod placement;
mod stages;

pub use coverage::{Coverage, Hole, percent};
pub use gear::ScanGear;
pub use metrics::{Metrics, TwoMetrics};
pub use placement::Placement;
pub use stages::{Adjustment, StageErrors, StageU95, Step, Steps};

use std::collections::BTreeMap;

use serde::Serialize;

use flankscope_foundation::normal::COVERAGE_95;
use flankscope_foundation::rigid::{Camera, Rigid, Tool};
use flankscope_foundation::seal::Seal;
use flankscope_metrology::multiview::cylinder::{Cell, CylinderMap, FieldQuality};
use flankscope_metrology::multiview::spacing::Spacing;
use flankscope_metrology::multiview::tooth_identity::FlankMean;
use flankscope_metrology::verdict::{Code, Reason, Word};

use super::{Feature, FrameCount, Timing, Toothing, ViewStatus};
use crate::origin::Origin;
use flankscope_article::{ArticleStitched, MethodResult};
use flankscope_metrology::gear::Flank;
use flankscope_metrology::multiview::form::Form;

/// The complete result of a scan, serialised as the `--json` document.
#[derive(Clone, Debug, Serialize)]
pub struct Scan {
    /// Link, head, station and operator.
    #[serde(flatten)]
    pub origin: Origin,
    /// End of the scan: ISO 8601, UTC, by the host's clock.
    pub date: String,
    pub verdict: Word,
    /// Reason of the verdict, in one sentence.
    pub reason: String,
    /// One entry per requested flank, and per other flank with damage; judged as in a check.
    pub features: Vec<Feature>,
    /// Mean loss of every measured flank, requested or not; a later scan recognises the die by it.
    pub flank_means: Vec<FlankSeen>,
    /// Size, ovality and taper of the bore; absent if too little was measured.
    pub form: Option<Form>,
    /// Distances of opposite teeth across the bore, where both were measured.
    pub spacing: Vec<OppositeTeeth>,
    /// Durations.
    pub timing_ms: Timing,
    /// From the last view's last exposure to this result, ms.
    pub last_view_to_result_ms: f64,
    /// Frame counts and transfer times.
    pub frames: FrameCount,
    /// Peak memory of this process, MB; absent if the system does not report it.
    pub peak_memory_mb: Option<f64>,
    /// Number of views around, and of layers.
    pub views: String,
    /// Number of views from an earlier part of the scan.
    pub resumed_views: usize,
    /// Fraction of the unrolled bore that was measured.
    pub coverage_ratio: f64,
    /// Planned fields, and those missing in the map.
    pub coverage: Coverage,
    /// Fraction of the measured cells in which views contradict each other.
    pub inconsistent_ratio: f64,
    /// One entry per view.
    pub registration: Vec<ScanRegistration>,
    /// Data on the stitching.
    pub stitching: Stitching,
    /// Common parameters of all views; absent if they were registered one by one (`--method article`).
    #[serde(rename = "joint", skip_serializing_if = "Option::is_none")]
    pub adjustment: Option<Adjustment>,
    /// Relative excess of the teeth's distances over the CAD's, median over the views; absent if unknown.
    pub teeth_stretch_ratio: Option<f64>,
    /// Rotation of the die about the axis relative to stages and head file, degrees. Teeth look alike and are numbered by the
    /// nearest position; only an earlier scan can show whether the die was rotated by whole teeth.
    pub teeth_turned_deg: f64,
    /// Rotation of the die relative to an earlier scan; absent if none was given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub placement: Option<Placement>,
    /// Results of the stitching methods, for comparison.
    pub methods: Vec<MethodResult>,
    /// The article's metrics for the same points; absent unless a report was requested.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub metrics: Option<Metrics>,
    /// Profile, helix and pitch of every tooth; absent unless requested.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gear: Option<ScanGear>,
    /// True values, from the simulated bench only.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub truth: Option<serde_json::Value>,
    /// Signature of the station over all other entries.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seal: Option<Seal>,
    /// Tool name.
    pub tool: String,
    /// Versions of host, protocol and firmware.
    pub versions: BTreeMap<&'static str, String>,
    /// BLAKE3 of the inputs: CAD, tool file, head file.
    pub hashes: BTreeMap<&'static str, String>,
    /// The toothing, as the report draws it.
    #[serde(skip)]
    pub toothing: Option<Toothing>,
    /// Deviations over the unrolled bore.
    #[serde(skip)]
    pub map: CylinderMap,
    /// Calibration error in each part of the head's field, which adds to the noise.
    #[serde(skip)]
    pub quality: FieldQuality,
    /// Standard uncertainty of the mean radius, mm, common to all cells; `None` if no uncertainty is stated.
    #[serde(skip)]
    pub size_sigma_mm: Option<f64>,
}

impl Scan {
    /// The verdict and its reason.
    pub fn sentence(&self) -> String {
        format!("{}: {}", self.verdict, self.reason)
    }

    /// Sets the standard uncertainty of the mean radius, mm.
    pub fn take_size_sigma(&mut self, sigma_mm: f64) {
        self.size_sigma_mm = Some(sigma_mm);
        if let Some(form) = &mut self.form {
            form.size_u95_um = Some(1e3 * COVERAGE_95 * sigma_mm);
        }
    }

    /// Standard uncertainty of a cell's deviation from the CAD, mm: its own, and the component of the mean radius's along its normal.
    #[must_use]
    pub fn sigma_mm(&self, cell: &Cell) -> f64 {
        let ([x, y, _], [nx, ny, _]) = (cell.point, cell.normal);
        let radial = (nx * x + ny * y) / x.hypot(y).max(f64::MIN_POSITIVE);
        let size_mm = self.size_sigma_mm.unwrap_or(0.0);
        cell.sigma_mm.hypot(radial * size_mm)
    }

    /// Invalidates all results, including damage, because the die is not that of the CAD.
    pub fn invalidate(&mut self, why: &Reason) {
        self.verdict = Word::Indeterminate;
        self.reason = why.to_string();
        self.features.clear();
        self.flank_means.clear();
        self.spacing.clear();
        self.form = None;
    }

    /// The points came without frames, so no flank can be "go". A loss that is proven to exceed its limit stays.
    pub fn without_frames(&mut self) {
        let why = Reason::instrument(
            Code::NoFrames,
            "clouds do not say what their frames would: whether fringe orders are sure, light came over second surfaces, and all stood \
             still; so no flank is found sound",
        );
        let is_sound = |word: Word| matches!(word, Word::Go | Word::Warn);
        for feature in self.features.iter_mut().filter(|of| is_sound(of.verdict)) {
            feature.verdict = Word::Indeterminate;
            feature.reason = Some(why.to_string());
            feature.code = Some(Code::NoFrames);
        }
        if is_sound(self.verdict) {
            self.verdict = Word::Indeterminate;
            self.reason = why.to_string();
        }
    }

    /// Replaces our result by that of the article's method. It states no uncertainty, so there is no verdict and no flank is judged.
    pub fn show_instead(&mut self, laid: ArticleStitched, figures: &MethodResult) {
        let why = "the article's method claims no uncertainty, so it gives no verdict; --method surface does";
        self.invalidate(&Reason::instrument(Code::NoUncertainty, why));
        self.form = figures.form;
        // These poses are not based on the joint solution.
        self.adjustment = None;
        self.size_sigma_mm = None;
        self.teeth_stretch_ratio = None;
        let poses: BTreeMap<usize, Rigid<Tool, Camera>> = laid
            .views
            .iter()
            .map(|of| (of.view, Rigid::from_isometry(of.tool_from_camera)))
            .collect();
        let mut refused: BTreeMap<usize, Reason> = laid.refused.into_iter().collect();
        for (entry, rms_um) in self.registration.iter_mut().zip(&figures.rms_um) {
            let why = refused.remove(&entry.view).map(|why| why.to_string());
            let why = why.or(entry.reason.take());
            (entry.rms_um, entry.residual_um) = (*rms_um, None);
            (entry.rms_about_form_um, entry.residual_turn_mdeg) = (None, None);
            entry.tool_from_camera = poses.get(&entry.view).map(Rigid::to_rows);
            (entry.status, entry.reason) = match rms_um {
                Some(_) => (ViewStatus::Registered, None),
                None => (ViewStatus::Lost, why),
            };
        }
        self.map = laid.map;
        self.coverage_ratio = self.map.coverage();
        self.inconsistent_ratio = self.map.inconsistent();
    }
}

/// Two opposite teeth across the bore.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct OppositeTeeth {
    pub teeth: [u32; 2],
    /// Distance of the points on their centre lines at the pitch circle, mm.
    pub distance_mm: f64,
    /// Deviation of this distance from that of the CAD, µm.
    pub deviation_um: f64,
    /// Expanded uncertainty of both (95 %), µm: from the cells, the poses of the views on either side, and the head's
    /// calibration. A bore that is larger all around cannot be distinguished from a head farther from the wall; this part is
    /// taken from the CAD.
    pub u95_um: f64,
}

impl OppositeTeeth {
    /// Adds the standard uncertainty of the views' poses, and of the calibration at either tooth, mm.
    pub fn new(of: Spacing, views_mm: f64, calibration_mm: f64) -> Self {
        let calibration_mm = std::f64::consts::SQRT_2 * calibration_mm;
        let sigma_mm = of.sigma_mm.hypot(views_mm).hypot(calibration_mm);
        Self {
            teeth: of.teeth,
            distance_mm: of.distance_mm,
            deviation_um: of.deviation_mm * 1e3,
            u95_um: 1.96e3 * sigma_mm,
        }
    }
}

/// Mean loss of the measured part of one flank.
#[derive(Clone, Debug, Serialize)]
pub struct FlankSeen {
    /// Tooth, from 1.
    pub tooth: u32,
    /// `left` or `right`.
    pub flank: Flank,
    /// Mean loss, µm.
    pub mean_um: f64,
}

impl From<FlankMean> for FlankSeen {
    fn from(of: FlankMean) -> Self {
        Self {
            tooth: of.tooth,
            flank: of.flank,
            mean_um: -of.deviation_um,
        }
    }
}

/// Registration of one view to the CAD.
#[derive(Clone, Debug, Serialize)]
pub struct ScanRegistration {
    /// Number of the view, in order of capture.
    pub view: usize,
    /// Commanded angle, degrees.
    pub rotation_deg: f64,
    /// Commanded height, mm.
    pub vertical_mm: f64,
    /// `registered`, or `lost`: none of its points is in the map.
    pub status: ViewStatus,
    /// Why it is lost.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// Distance of its points from the CAD in its final pose, root mean square, µm.
    pub rms_um: Option<f64>,
    /// Root mean square deviation of its cells from the fitted size, position, ovality and taper of the whole bore, µm.
    pub rms_about_form_um: Option<f64>,
    /// Pose residual relative to the common parameters, µm.
    #[serde(rename = "stray_um")]
    pub residual_um: Option<f64>,
    /// Residual of the rotary stage's angle, millidegrees.
    #[serde(rename = "stray_turn_mdeg")]
    pub residual_turn_mdeg: Option<f64>,
    /// Its final pose, row by row: tool frame from camera frame, mm.
    pub tool_from_camera: Option<[[f64; 4]; 4]>,
}

/// Data on the stitching.
#[derive(Clone, Debug, Serialize)]
pub struct Stitching {
    /// Number of views that were registered again, because they had moved.
    pub relaid_views: usize,
    /// Time of the adjustment, of the repeated registrations, and of the merge, ms.
    pub elapsed_ms: BTreeMap<&'static str, f64>,
}
