//! What a scan hands over: the JSON document.

use std::collections::BTreeMap;

use serde::Serialize;

use flankscope_foundation::normal::COVERAGE_95;
use flankscope_foundation::rigid::{Camera, Rigid, Tool};
use flankscope_foundation::seal::Seal;
use flankscope_metrology::multiview::adjustment::StageSigma;
use flankscope_metrology::multiview::cylinder::{Cell, CylinderMap, FieldQuality};
use flankscope_metrology::multiview::spacing::Spacing;
use flankscope_metrology::multiview::tooth_identity::FlankMean;
use flankscope_metrology::verdict::{Code, Reason, Word};

use super::coverage::Coverage;
use super::gear::ScanGear;
use super::metrics::Metrics;
use super::overlaps::Steps;
use super::reference::Placement;
use flankscope_article::{Hinz2019Stitched, MethodResult};
use flankscope_metrology::gear::Flank;
use flankscope_metrology::multiview::form::Form;
use flankscope_record::document::{Feature, FrameCount, Timing, Toothing, ViewStatus};
use flankscope_record::origin::Origin;

/// The whole result: serialised as the `--json` document.
#[derive(Clone, Debug, Serialize)]
pub struct Scan {
    /// Where it comes from.
    #[serde(flatten)]
    pub origin: Origin,
    /// When it ended: ISO 8601, UTC, by the host's clock.
    pub date: String,
    /// The verdict.
    pub verdict: Word,
    /// Why, in one sentence.
    pub reason: String,
    /// One entry per flank that was asked for, and per other flank that shows damage: judged as in a check.
    pub features: Vec<Feature>,
    /// Mean loss of every flank that was seen, asked for or not: what a later scan recognises the die by.
    pub flank_means: Vec<FlankSeen>,
    /// Size, ovality and taper of the bore; absent when too little was seen.
    pub form: Option<Form>,
    /// Distances of teeth from those across the bore, where both were seen.
    pub spacing: Vec<OppositeTeeth>,
    /// Where the time went.
    pub timing_ms: Timing,
    /// From the last view's last exposure to this result, ms.
    pub last_view_to_result_ms: f64,
    /// Frame bookkeeping.
    pub frames: FrameCount,
    /// Most memory that this process held at once, MB; absent where the system does not say.
    pub peak_memory_mb: Option<f64>,
    /// Views around and layers.
    pub views: String,
    /// Views taken over from an earlier part of the scan.
    pub resumed_views: usize,
    /// Share of the unrolled bore that was seen.
    pub coverage_ratio: f64,
    /// What the plan promised and the map lacks.
    pub coverage: Coverage,
    /// Cells in which the views contradict each other, share of those seen.
    pub inconsistent_ratio: f64,
    /// One entry per view.
    pub registration: Vec<ScanRegistration>,
    /// How the views became one map.
    pub stitching: Stitching,
    /// What all views share; absent where they were laid one by one (`--method paper`).
    #[serde(rename = "joint", skip_serializing_if = "Option::is_none")]
    pub adjustment: Option<Adjustment>,
    /// By what share the teeth stand farther apart than the CAD's, in the middle of all views; absent when none tells.
    pub teeth_stretch_ratio: Option<f64>,
    /// How far around the axis the die stands from where stages and head file say, degrees. Teeth that look alike are
    /// numbered by being nearest: whether the die was turned by whole teeth, only an earlier scan of it can tell.
    pub teeth_turned_deg: f64,
    /// How the die stands against an earlier scan; absent when none was given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub placement: Option<Placement>,
    /// The ways in which these views were stitched, side by side.
    pub methods: Vec<MethodResult>,
    /// The article's metrics on the same points; absent unless a report or the raster was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub metrics: Option<Metrics>,
    /// Profile, helix and pitch of every tooth; absent unless asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gear: Option<ScanGear>,
    /// From the simulated bench alone: what was true.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub truth: Option<serde_json::Value>,
    /// Whose word it is; over everything else in it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seal: Option<Seal>,
    /// Tool name.
    pub tool: String,
    /// Host, protocol, firmware.
    pub versions: BTreeMap<&'static str, String>,
    /// BLAKE3 of what went in: CAD, tool file, head file.
    pub hashes: BTreeMap<&'static str, String>,
    /// The toothing, as the report draws it.
    #[serde(skip)]
    pub toothing: Option<Toothing>,
    /// Deviations over the unrolled bore.
    #[serde(skip)]
    pub map: CylinderMap,
    /// What the head's calibration adds to the noise in each part of its field.
    #[serde(skip)]
    pub quality: FieldQuality,
    /// Standard uncertainty of the mean radius, mm, which all cells share; none where no uncertainty is claimed.
    #[serde(skip)]
    pub size_sigma_mm: Option<f64>,
}

impl Scan {
    /// The verdict and its reason.
    #[must_use]
    pub fn sentence(&self) -> String {
        format!("{}: {}", self.verdict, self.reason)
    }

    /// Takes the standard uncertainty of the mean radius, mm.
    pub(super) fn take_size_sigma(&mut self, sigma_mm: f64) {
        self.size_sigma_mm = Some(sigma_mm);
        if let Some(form) = &mut self.form {
            form.size_u95_um = Some(1e3 * COVERAGE_95 * sigma_mm);
        }
    }

    /// Standard uncertainty of a cell's deviation from the CAD, mm: its own, and its part of the mean radius's along its normal.
    #[must_use]
    pub fn sigma_mm(&self, cell: &Cell) -> f64 {
        let ([x, y, _], [nx, ny, _]) = (cell.point, cell.normal);
        let radial = (nx * x + ny * y) / x.hypot(y).max(f64::MIN_POSITIVE);
        let size_mm = self.size_sigma_mm.unwrap_or(0.0);
        cell.sigma_mm.hypot(radial * size_mm)
    }

    /// It is not the CAD's die: nothing that was measured against the CAD means anything, damage that was found included.
    pub(super) fn invalidate(&mut self, why: &Reason) {
        self.verdict = Word::Indeterminate;
        self.reason = why.to_string();
        self.features.clear();
        self.flank_means.clear();
        self.spacing.clear();
        self.form = None;
    }

    /// The points came without their frames: no flank is found sound by them. A loss that is shown to exceed its limit stays.
    pub(super) fn without_frames(&mut self) {
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

    /// Shows what the article's method makes of the views in the place of ours. It claims no uncertainty, so there is no
    /// verdict and no flank is judged.
    pub(super) fn show_instead(&mut self, laid: Hinz2019Stitched, figures: &MethodResult) {
        let why = "the article's method claims no uncertainty, so it gives no verdict; --method surface does";
        self.invalidate(&Reason::instrument(Code::NoUncertainty, why));
        self.form = figures.form;
        // What the joint solve found is not what these poses rest on.
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

/// Two teeth across the bore.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct OppositeTeeth {
    /// The teeth.
    pub teeth: [u32; 2],
    /// Distance of the points on their centre lines at the pitch circle, mm.
    pub distance_mm: f64,
    /// The same less that of the CAD, µm.
    pub deviation_um: f64,
    /// Expanded uncertainty of both (95 %), µm: of the cells, of how the views on either side lie, and of the head's
    /// calibration. What a bore that is larger all around has in common with a head farther from the wall is the CAD's.
    pub u95_um: f64,
}

impl OppositeTeeth {
    /// With the standard uncertainty of how the views lie, and of the calibration at either tooth, mm.
    pub(super) fn new(of: Spacing, views_mm: f64, calibration_mm: f64) -> Self {
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

/// Mean loss of one flank as far as it was seen.
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

/// How one view was laid on the CAD.
#[derive(Clone, Debug, Serialize)]
pub struct ScanRegistration {
    /// Number of the view, in order of capture.
    pub view: usize,
    /// Commanded angle, degrees.
    pub rotation_deg: f64,
    /// Commanded height, mm.
    pub vertical_mm: f64,
    /// `registered`, or `lost`: no point of it is in the map.
    pub status: ViewStatus,
    /// Why it is lost.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// Distance of its points from the CAD in its final pose, root mean square, µm.
    pub rms_um: Option<f64>,
    /// The same of its cells about size, place, ovality and taper of the whole bore.
    pub rms_about_form_um: Option<f64>,
    /// Pose residual: how far it is from what all views share, µm.
    #[serde(rename = "stray_um")]
    pub residual_um: Option<f64>,
    /// The same of the angle of its rotary stage, millidegrees.
    #[serde(rename = "stray_turn_mdeg")]
    pub residual_turn_mdeg: Option<f64>,
    /// Its final pose, row by row: tool frame from camera frame, mm.
    pub tool_from_camera: Option<[[f64; 4]; 4]>,
}

/// How the views became one map.
#[derive(Clone, Debug, Serialize)]
pub struct Stitching {
    /// Views that were laid on the CAD once more, because they ended up elsewhere.
    pub relaid_views: usize,
    /// Time of the adjustment, of laying views on once more, and of the merge, ms.
    pub elapsed_ms: BTreeMap<&'static str, f64>,
}

/// What all views share.
#[derive(Clone, Debug, Serialize)]
pub struct Adjustment {
    /// Solves until nothing moved.
    pub rounds: usize,
    /// Whether it did settle.
    pub settled: bool,
    /// Condition number of the information of all views together, in units of what was known before.
    pub condition: f64,
    /// Combinations of parameters of which the views say less than was known before, and the share of that.
    pub weak: Vec<(&'static str, f64)>,
    /// Steps between views that overlap, before and after what they say of each other counted.
    pub steps: Steps,
    /// Errors found of die, head and stages.
    pub found: StageErrors,
}

/// How die, head and stages differ from their files.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct StageErrors {
    /// Die off the rotation axis, mm.
    pub eccentricity_mm: f64,
    /// Where the rotation axis passes the die's lower and upper end, x and y in the tool frame, mm.
    pub axis_mm: [[f64; 2]; 2],
    /// Die's axis against the rotation axis, degrees.
    pub tilt_deg: f64,
    /// Turn of the head against its file, degrees, camera axes.
    pub head_turn_deg: [f64; 3],
    /// Shift of the head against its file, mm, camera axes.
    pub head_shift_mm: [f64; 3],
    /// Lean of the vertical axis against the rotation axis, along the wall and towards it, millirad. The second looks like a
    /// conical die: the views add nothing to what was known of it.
    pub vertical_lean_mrad: [f64; 2],
    /// Cosine and sine part of the encoder's error once, twice, three times per turn, millidegrees.
    pub harmonics_mdeg: [[f64; 2]; 3],
    /// Expanded uncertainties (95 %) of some of these.
    pub u95: StageU95,
}

/// Expanded uncertainties (95 %) of how die and stages differ from their files.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct StageU95 {
    /// Of the eccentricity, mm.
    pub eccentricity_mm: f64,
    /// Of the tilt, degrees.
    pub tilt_deg: f64,
    /// Of the vertical axis's lean, millirad.
    pub vertical_lean_mrad: [f64; 2],
    /// Of the encoder's harmonics, millidegrees.
    pub harmonics_mdeg: [[f64; 2]; 3],
}

impl From<StageSigma> for StageU95 {
    fn from(sigma: StageSigma) -> Self {
        let mdeg = |rad: f64| COVERAGE_95 * rad.to_degrees() * 1e3;
        Self {
            eccentricity_mm: COVERAGE_95 * sigma.eccentricity_mm,
            tilt_deg: COVERAGE_95 * sigma.tilt_rad.to_degrees(),
            vertical_lean_mrad: sigma.vertical_lean_rad.map(|rad| COVERAGE_95 * rad * 1e3),
            harmonics_mdeg: sigma.harmonics_rad.map(|pair| pair.map(mdeg)),
        }
    }
}
