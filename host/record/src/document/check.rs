//! Result of a check: the JSON document, and the data that the report draws.

use std::collections::BTreeMap;
use std::time::Duration;

use flankscope_metrology::gear::GearData;
use flankscope_metrology::tool::Tool;
use flankscope_metrology::verdict::{Code, Reason, Word};
use flankscope_metrology::wear::leakage::Leakage;
use flankscope_metrology::wear::standing::MissingTooth;
use flankscope_metrology::wear::{Approaches, PoseEvidence};
use flankscope_profilometry::decode::{LightMedians, Projectors, Rejected};
use serde::{Deserialize, Serialize};

use crate::baseline::{Baseline, BaselineError, Reference, ViewReference};
use crate::die::DieKey;
use crate::origin::Origin;
use flankscope_metrology::kinematics::Moves;

use crate::document::{Evidence, FeatureId, FlankInView, Phasors, Recipe, ToothIdentity};
use flankscope_foundation::activity::Activity;
use flankscope_foundation::clock::BootTime;
use flankscope_foundation::date;
use flankscope_profilometry::Picture;

/// Result of one inspected flank or patch: a row of the table.
#[derive(Clone, Debug, Serialize)]
pub struct Feature {
    #[serde(flatten)]
    pub id: FeatureId,
    /// Wear, µm, positive for loss; absent if it could not be measured.
    pub wear_um: Option<f64>,
    /// Expanded uncertainty of the wear (95 %), µm; absent if only a lower bound is known.
    pub u95_um: Option<f64>,
    /// Lower bound of the wear (95 %), µm. Given if unmeasured parts may have lost so much that no interval about the wear holds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub at_least_um: Option<f64>,
    /// Mean loss over the zone, µm.
    pub mean_um: Option<f64>,
    /// Fraction of the zone that was measured, 0..1.
    pub coverage_ratio: f64,
    /// Warn limit, µm.
    pub warn_um: f64,
    /// Stop limit, µm.
    pub limit_um: f64,
    /// Probability that the wear is below the stop limit; absent when it could not be measured.
    pub conformity: Option<f64>,
    /// Further results of the flank; absent if it could not be measured.
    pub detail: Option<FlankDetail>,
    /// If it was measured more than once: the wear by each single capture, µm.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub measurements: Vec<Option<Expanded>>,
    pub verdict: Word,
    /// Why it is not go.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// Class of the reason, if the verdict is indeterminate.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub code: Option<Code>,
}

/// Results besides the judged wear, each with its expanded uncertainty (95 %), and the uncertainty budget.
#[derive(Clone, Debug, Serialize)]
pub struct FlankDetail {
    /// Wear depth relative to CAD, µm. The judged wear is relative to the baseline if there is one.
    pub absolute_um: Expanded,
    /// Expanded uncertainty of the mean loss, µm.
    pub mean_u95_um: f64,
    /// Largest mean loss over a disc before correction, µm: the expected contribution of noise to a maximum is not subtracted.
    pub raw_um: f64,
    /// Centre of that disc, mm: along the profile from the zone's smaller radius, and up from its lower end.
    pub deepest_at_mm: [f64; 2],
    /// Area of the disc, mm².
    pub area_mm2: f64,
    /// For a scan: lower and upper end of the zone that these results apply to, mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub zone_height_mm: Option<[f64; 2]>,
    /// Largest mean height of proud material over such a disc, µm; negative if the whole zone has lost material.
    pub proud_um: Expanded,
    /// Its warning and stop limit, µm.
    pub proud_limits_um: [f64; 2],
    /// Loss of the cell with the largest loss, by the median of its points, µm; absent if no cell has three points.
    pub cell_um: Option<Expanded>,
    /// Its warning and stop limit, µm.
    pub cell_limits_um: [f64; 2],
    /// Area of the cells that lost more than the warning limit, mm².
    pub area_beyond_warn_mm2: f64,
    /// Area of the cells that lost more than the stop limit, mm².
    pub area_beyond_limit_mm2: f64,
    /// Area worn beyond the threshold of detection, mm².
    pub worn_area_mm2: Expanded,
    /// Volume lost there, mm³.
    pub lost_volume_mm3: Expanded,
    /// Volume of material that stands proud beyond the threshold of detection, mm³.
    pub proud_volume_mm3: Expanded,
    /// Radius of the tip edge's rounding, mm; absent when the edge was not seen.
    pub tip_edge_radius_mm: Option<Expanded>,
    /// Its warning and stop limit, mm.
    pub tip_limits_mm: Option<[f64; 2]>,
    /// Largest mean loss that is possible for a disc with unmeasured parts, µm; absent if every disc was measured completely.
    pub hidden_um: Option<f64>,
    /// Smallest wear that is distinguished from none with errors of 5 % of both kinds, µm.
    pub detection_limit_um: f64,
    /// Standard uncertainty of the wear by source, µm.
    pub budget_um: BTreeMap<&'static str, f64>,
}

impl FlankDetail {
    /// Sources of uncertainty that are not zero at the precision of a report.
    pub fn shown_budget(&self) -> Vec<(&'static str, f64)> {
        let shown = self.budget_um.iter().filter(|(_, um)| **um >= 0.005);
        shown.map(|(name, um)| (*name, *um)).collect()
    }
}

/// A value with its expanded uncertainty (95 %) in the same unit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Expanded {
    pub value: f64,
    /// Expanded uncertainty.
    pub u95: f64,
}

/// When the last exposure of a check ended. The age of a check is counted from here.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LastExposure {
    /// By the host's wall clock: ISO 8601, UTC.
    pub at: String,
    /// By the time since the computer started, which is never set.
    #[serde(flatten)]
    pub boot: BootTime,
}

impl LastExposure {
    /// The moment that long before now.
    #[must_use]
    pub fn before_now(age: Duration) -> Self {
        Self {
            at: date::before_now(age),
            boot: BootTime::now().before(age),
        }
    }
}

/// Durations of a check, ms.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Timing {
    /// From the start order to the verdict with the head retracted.
    pub total: f64,
    /// Moving and settling, retract included, on the controller's clock.
    pub positioning: f64,
    /// Sum of the exposures, on the controller's clock.
    pub exposure: f64,
    /// From the end of the last exposure to the verdict.
    pub last_exposure_to_verdict: f64,
}

/// Frames: triggered by the controller, received by the host.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct FrameCount {
    /// Triggers reported.
    pub triggered: u64,
    /// Frames received and paired.
    pub received: u64,
    /// Bytes of pixels copied out of the shared memory.
    pub bytes_copied: u64,
    /// Views that had to be captured again.
    pub recaptured_views: u32,
    /// Largest delay of a trigger or frame relative to the clock of the device that reports it, ms; absent if that clock is not real time.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub late_ms: Option<f64>,
    /// Time from hand-over by the camera process to reception by the host.
    pub handover_us: Handover,
}

/// Distribution of the transfer times of frames, µs.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Handover {
    pub median: f64,
    /// 99th percentile.
    pub p99: f64,
}

impl Handover {
    /// From the times of all frames; zeros without any. Sorts the times.
    #[must_use]
    pub fn of(times_ns: &mut [u64]) -> Self {
        times_ns.sort_unstable();
        let at = |share: f64| {
            let rank = (share * times_ns.len() as f64).ceil() as usize;
            times_ns
                .get(rank.saturating_sub(1))
                .map_or(0.0, |&ns| ns as f64 / 1e3)
        };
        Self {
            median: at(0.5),
            p99: at(0.99),
        }
    }
}

/// Whether a view was registered to the CAD.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum ViewStatus {
    Registered,
    /// A view of a check was not registered.
    Indeterminate,
    /// A view of a scan was not registered.
    Lost,
}

impl std::fmt::Display for ViewStatus {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Registered => "registered",
            Self::Indeterminate => "indeterminate",
            Self::Lost => "lost",
        })
    }
}

/// Registration of one view to the CAD.
#[derive(Clone, Debug, Serialize)]
pub struct ViewRegistration {
    /// Tooth in the middle of the view.
    pub tooth: u32,
    /// Whether it was registered.
    pub status: ViewStatus,
    /// Why it was not.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// Points decoded.
    pub points: usize,
    /// Fraction of the cells with fringes whose frames do not fit a sinusoid.
    pub inconsistent_ratio: f64,
    /// Measured properties of the light; absent if the view was not decoded.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub light: Option<Light>,
    /// Points that the fit used.
    pub inliers: usize,
    /// Robust rms distance of the inliers, mm.
    pub rms_mm: f64,
    pub iterations: usize,
    /// Correction of the stage's pose by the registration: along x, y, z of the tool, mm.
    pub shift_mm: [f64; 3],
    /// Correction about x, y, z of the tool, rad.
    pub turn_rad: [f64; 3],
    /// For each flank: fraction of the wear that the fitted pose would absorb, for three shapes of wear on the judged flank and
    /// for wear that all teeth in view share.
    pub leakage: BTreeMap<&'static str, Leakage>,
    /// Directions that the surface does not determine: unit 6-vectors (rotation, translation) and the fraction of information
    /// that the prior gives.
    pub weak_directions: Vec<WeakDirection>,
    /// Decoding, registration and evaluation, ms.
    pub elapsed_ms: BTreeMap<&'static str, f64>,
}

/// Properties of the light in a view, which show whether it came from the projector alone and by one path.
#[derive(Clone, Debug, Serialize)]
pub struct Light {
    /// Cells without a point, by the first reason found.
    pub rejected: Rejected,
    /// Median contrast of each frequency over the cells with a point. A loss at one frequency is due to indirect light or the optics.
    pub contrast: Vec<f64>,
    /// Direct and global light, medians over the points; absent without points.
    #[serde(flatten)]
    pub medians: Option<LightMedians>,
    /// Comparison of two projectors in the view; absent if the head has one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub projectors: Option<Projectors>,
    /// Fraction of the points whose fringe order differs from that of the drawing at the fitted pose. Causes: damage deeper than
    /// half a fringe, another die, light reflected by a second surface. It is reported only: the fringe order follows from the
    /// frequencies alone.
    pub other_order_ratio: f64,
}

/// A direction of motion about which the measured surface gives little information.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct WeakDirection {
    /// Rotation (3) and translation (3), unit length in scaled units.
    pub direction: [f64; 6],
    /// Fraction of the information that comes from the stage, 0..1.
    pub prior_share: f64,
}

/// The complete result of a check, serialised as the `--json` document.
#[derive(Clone, Debug, Serialize)]
pub struct Inspection {
    /// Number of the check in the history; null if it was not stored in one.
    pub id: Option<i64>,
    /// Link, head, station and operator.
    #[serde(flatten)]
    pub origin: Origin,
    /// End of the check: ISO 8601, UTC, by the host's clock.
    pub date: String,
    /// End of the last exposure; absent for a recording and if nothing was exposed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub last_exposure: Option<LastExposure>,
    pub verdict: Word,
    /// Reason of the verdict, in one sentence.
    pub reason: String,
    /// One entry per inspected flank.
    pub features: Vec<Feature>,
    /// One entry per flank that was in view but not requested.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub in_view: Vec<FlankInView>,
    /// Missing teeth in view.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub missing_teeth: Vec<MissingTooth>,
    /// How the numbering of the teeth was established; absent if the tool has no teeth.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tooth_identity: Option<ToothIdentity>,
    /// Durations.
    pub timing_ms: Timing,
    /// Frame counts and transfer times.
    pub frames: FrameCount,
    /// Press cycles since the controller's power-up, when the die was captured.
    pub press_cycles: u32,
    /// Peak memory of this process, MB; absent if the system does not report it.
    pub peak_memory_mb: Option<f64>,
    /// One entry per view.
    pub registration: Vec<ViewRegistration>,
    /// Tool name.
    pub tool: String,
    /// Identity of the die.
    pub die: DieKey,
    /// Temperature of the tool that the scale was corrected for, °C; absent if not known.
    pub temperature_degc: Option<f64>,
    /// Versions of host, protocol and firmware.
    pub versions: BTreeMap<&'static str, String>,
    /// BLAKE3 of the inputs: CAD, tool file, head file, core map, baseline, recipe.
    pub hashes: BTreeMap<&'static str, String>,
    /// Measurement settings of the check that are not in the files.
    pub recipe: Recipe,
    /// Data from which the verdict of each view was computed.
    pub evidence: Vec<Evidence>,
    /// Why the check ended early, if it did.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stopped: Option<String>,
    /// Class of that reason.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stopped_code: Option<Code>,
    /// True values, from the simulated bench only.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub truth: Option<serde_json::Value>,
    /// The phasor sums of every capture, to be stored.
    #[serde(skip)]
    pub phasors: Vec<Phasors>,
    /// Deviation from CAD of every measured flank, cell by cell: becomes part of a baseline.
    #[serde(skip)]
    pub fields: Vec<Reference>,
    /// Neighbouring flanks in every view: becomes part of a baseline.
    #[serde(skip)]
    pub neighbours: Vec<ViewReference>,
    /// Evidence of every view's rotation about the axis: becomes part of a baseline.
    #[serde(skip)]
    pub poses: Vec<PoseEvidence>,
    /// Repeatability of the rotary stage, if views were approached anew: becomes part of a baseline.
    #[serde(skip)]
    pub approaches: Option<Approaches>,
    /// Data that only the report draws.
    #[serde(skip)]
    pub pictures: Pictures,
}

impl Inspection {
    /// The baseline that results from the check of a new tool.
    ///
    /// # Errors
    /// The verdict is not "go".
    pub fn baseline(&self) -> Result<Baseline, BaselineError> {
        if self.verdict != Word::Go {
            return Err(BaselineError::NotNew {
                verdict: self.verdict,
            });
        }
        let hash = |(name, hash): (&&str, &String)| ((*name).to_owned(), hash.clone());
        Ok(Baseline {
            tool: self.tool.clone(),
            hashes: self.hashes.iter().map(hash).collect(),
            simulated: self.origin.simulated,
            flanks: self.fields.clone(),
            poses: self.poses.clone(),
            in_view: self.neighbours.clone(),
            approaches: self.approaches,
        })
    }

    /// The verdict and its reason.
    pub fn sentence(&self) -> String {
        format!("{}: {}", self.verdict, self.reason)
    }

    /// Downgrades the verdict for a reason: a no-go stays, every other verdict becomes indeterminate.
    pub fn withhold(&mut self, why: &Reason) {
        self.verdict = self.verdict.withheld();
        self.reason = match self.verdict {
            Word::NoGo => format!("{}; {why}", self.reason),
            Word::Go | Word::Warn | Word::Indeterminate => why.to_string(),
        };
    }
}

/// Data of the report's pictures.
#[derive(Clone, Debug, Default)]
pub struct Pictures {
    /// Deviation maps, one per inspected flank.
    pub maps: Vec<FlankMap>,
    /// Signed deviations in the inspected zones, µm.
    pub deviations_um: Vec<f64>,
    /// Activity of the devices.
    pub activities: Vec<Activity>,
    /// What the rotary stage turned: die or head.
    pub moves: Moves,
    /// A raw frame of each view, and the view's name.
    pub frames: Vec<(String, Picture)>,
    /// Teeth around the flanks; absent if the tool has no teeth.
    pub toothing: Option<Toothing>,
}

/// A toothing, as reports draw it.
#[derive(Clone, Debug)]
pub struct Toothing {
    /// Its geometry.
    pub gear: GearData,
    /// Lower and upper end of the judged zone's profile, as radii, mm.
    pub zone_radius_mm: [f64; 2],
}

impl Toothing {
    /// The toothing of a tool, if it has teeth.
    #[must_use]
    pub fn of(tool: &Tool) -> Option<Self> {
        let gear = tool.gear.clone()?;
        let zone_radius_mm = tool
            .zone()
            .map_or_else(|| gear.active_flank_mm(), |zone| zone.radius_mm);
        Some(Self {
            gear,
            zone_radius_mm,
        })
    }
}

/// Mean deviation per cell of one flank or patch.
#[derive(Clone, Debug)]
pub struct FlankMap {
    /// Which flank or patch.
    pub id: FeatureId,
    /// Cells along the profile (from tip to root), or along the patch.
    pub columns: usize,
    /// Cells along the die axis, or up the patch.
    pub rows: usize,
    /// Size of the map, mm: profile, axis; of a patch along and up.
    pub size_mm: [f64; 2],
    /// Mean deviation, µm, row by row from the top; NaN without points.
    pub deviation_um: Vec<f64>,
    /// Middles of the cells on the nominal surface, in tool coordinates, mm, in the same order; NaN where a gear has no involute.
    pub middles_mm: Vec<[f64; 3]>,
    /// Unit normal at the map's middle, out of the material.
    pub outward: [f64; 3],
}
