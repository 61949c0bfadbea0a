//! What an inspection hands over: the JSON document, and what the report draws from.

use std::collections::BTreeMap;

use flankscope_metrology::gear::GearData;
use flankscope_metrology::tool::Tool;
use flankscope_metrology::verdict::{Code, Reason, Word};
use flankscope_metrology::wear::PoseEvidence;
use flankscope_metrology::wear::leakage::Leakage;
use flankscope_metrology::wear::standing::MissingTooth;
use flankscope_profilometry::decode::{LightMedians, Projectors, Rejected};
use serde::Serialize;

use crate::baseline::{Baseline, BaselineError, Reference, ViewReference};
use crate::die::DieKey;
use crate::origin::Origin;
use flankscope_metrology::kinematics::Moves;

use crate::document::{Evidence, FeatureId, FlankInView, Phasors, Recipe, ToothIdentity};
use flankscope_foundation::activity::Activity;
use flankscope_profilometry::Picture;

/// One inspected flank or patch: a row of the table.
#[derive(Clone, Debug, Serialize)]
pub struct Feature {
    /// Which one.
    #[serde(flatten)]
    pub id: FeatureId,
    /// Wear, µm, positive for loss; absent when it could not be measured.
    pub wear_um: Option<f64>,
    /// Expanded uncertainty of the wear (95 %), µm; absent of a lower bound.
    pub u95_um: Option<f64>,
    /// Where unseen parts may have lost so much that no interval about the wear holds: what was lost at least (95 %), µm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub at_least_um: Option<f64>,
    /// Mean loss over the zone, µm.
    pub mean_um: Option<f64>,
    /// Part of the zone that was measured, 0..1.
    pub coverage_ratio: f64,
    /// Warn limit, µm.
    pub warn_um: f64,
    /// Stop limit, µm.
    pub limit_um: f64,
    /// Probability that the wear is below the stop limit; absent when it could not be measured.
    pub conformity: Option<f64>,
    /// What else is known of the flank; absent when it could not be measured.
    pub detail: Option<FlankDetail>,
    /// Where it was measured more than once: the figure of each capture alone, µm.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub measurements: Vec<Option<Expanded>>,
    /// Its verdict.
    pub verdict: Word,
    /// Why it is not go.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// What kind of reason, where it is indeterminate.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub code: Option<Code>,
}

/// The figures beside the judged one, each with its expanded uncertainty (95 %), and where the uncertainty comes from.
#[derive(Clone, Debug, Serialize)]
pub struct FlankDetail {
    /// Wear depth against CAD, µm; beside the wear, which is the difference to the baseline where there is one.
    pub absolute_um: Expanded,
    /// Expanded uncertainty of the mean loss, µm.
    pub mean_u95_um: f64,
    /// The largest mean loss over a disc as read, µm: without what noise adds to a maximum taken off.
    pub raw_um: f64,
    /// Middle of that disc, mm: along the profile from the zone's smaller radius, and up from its lower end.
    pub deepest_at_mm: [f64; 2],
    /// Area of the disc, mm².
    pub area_mm2: f64,
    /// Of a scan, lower and upper end of the zone that these figures are of, mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub zone_height_mm: Option<[f64; 2]>,
    /// Largest mean height of proud material over such a disc, µm; negative where all of the zone has lost.
    pub proud_um: Expanded,
    /// Its warning and stop limit, µm.
    pub proud_limits_um: [f64; 2],
    /// Loss of the single cell that lost most, by the median of its points, µm; absent where no cell has three points.
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
    /// The largest mean loss that a disc with unmeasured parts may have, µm; absent when every disc was measured whole.
    pub hidden_um: Option<f64>,
    /// Least wear that is told from none with 5 % errors of both kinds, µm.
    pub detection_limit_um: f64,
    /// Standard uncertainty of the wear by source, µm.
    pub budget_um: BTreeMap<&'static str, f64>,
}

impl FlankDetail {
    /// The sources of uncertainty that are not nothing at the precision of a report.
    #[must_use]
    pub fn shown_budget(&self) -> Vec<(&'static str, f64)> {
        let shown = self.budget_um.iter().filter(|(_, um)| **um >= 0.005);
        shown.map(|(name, um)| (*name, *um)).collect()
    }
}

/// A figure with its expanded uncertainty (95 %), same unit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Expanded {
    /// Value.
    pub value: f64,
    /// Expanded uncertainty.
    pub u95: f64,
}

/// Where the time went, ms.
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
    /// The latest that a trigger or a frame was against the clock of who told of it, ms; absent where that clock is not real
    /// time.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub late_ms: Option<f64>,
    /// From hand-over by the camera process to sight by the host.
    pub handover_us: Handover,
}

/// How long frames were on their way, µs.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Handover {
    /// Half of the frames were faster.
    pub median: f64,
    /// 99 of 100 frames were faster.
    pub p99: f64,
}

impl Handover {
    /// From the times of all frames; zeros where there are none. Sorts them.
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

/// Whether a view was laid on the CAD.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum ViewStatus {
    /// It was.
    Registered,
    /// A view of a check was not.
    Indeterminate,
    /// A view of a scan was not.
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

/// How one view was laid on the CAD.
#[derive(Clone, Debug, Serialize)]
pub struct ViewRegistration {
    /// Tooth in the middle of the view.
    pub tooth: u32,
    /// Whether it was.
    pub status: ViewStatus,
    /// Why it is indeterminate.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// Points decoded.
    pub points: usize,
    /// Part of the cells with fringes whose frames do not follow one.
    pub inconsistent_ratio: f64,
    /// What the view says of its light; absent where it was not decoded.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub light: Option<Light>,
    /// Points that the fit used.
    pub inliers: usize,
    /// Robust rms distance of the inliers, mm.
    pub rms_mm: f64,
    /// Iterations.
    pub iterations: usize,
    /// How far the pose moved from the stage's: along x, y, z of the tool, mm.
    pub shift_mm: [f64; 3],
    /// And about x, y, z, rad.
    pub turn_rad: [f64; 3],
    /// By flank: the part of the wear that the pose would hide, for three shapes of wear on the judged flank, and for wear
    /// that all teeth in view share.
    pub leakage: BTreeMap<&'static str, Leakage>,
    /// Directions that the surface does not fix: unit 6-vectors (rotation, translation) and the prior's share.
    pub weak_directions: Vec<WeakDirection>,
    /// Decoding, registration and evaluation, ms.
    pub elapsed_ms: BTreeMap<&'static str, f64>,
}

/// What a view says of its light: whether it came from the projector alone, by one way.
#[derive(Clone, Debug, Serialize)]
pub struct Light {
    /// Cells without a point, by the first reason found.
    pub rejected: Rejected,
    /// Median contrast of each frequency over the cells with a point: what it lacks of one is indirect light, or the optics.
    pub contrast: Vec<f64>,
    /// Direct and global light, medians over the points; absent without any.
    #[serde(flatten)]
    pub medians: Option<LightMedians>,
    /// What two projectors made of the view; absent of a head with one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub projectors: Option<Projectors>,
    /// Part of the points whose fringe order is another than the drawing's at the pose found: damage deeper than half a fringe,
    /// another die, light over a second surface. It is told and changes nothing: the frequencies alone say which order it is.
    pub other_order_ratio: f64,
}

/// A direction of motion that the measured surface says little about.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct WeakDirection {
    /// Rotation (3) and translation (3), unit length in scaled units.
    pub direction: [f64; 6],
    /// Part of the knowledge that comes from the stage, 0..1.
    pub prior_share: f64,
}

/// The whole result: serialised as the `--json` document.
#[derive(Clone, Debug, Serialize)]
pub struct Inspection {
    /// Number of the check in the history that it was stored in; null where it is in none.
    pub id: Option<i64>,
    /// Where it comes from.
    #[serde(flatten)]
    pub origin: Origin,
    /// When it ended: ISO 8601, UTC, by the host's clock.
    pub date: String,
    /// The verdict.
    pub verdict: Word,
    /// Why, in one sentence.
    pub reason: String,
    /// One entry per inspected flank.
    pub features: Vec<Feature>,
    /// One entry per flank that was in view and not asked for.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub in_view: Vec<FlankInView>,
    /// Teeth in view that do not stand.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub missing_teeth: Vec<MissingTooth>,
    /// Which tooth is which, and by whose word; absent of a tool without teeth.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tooth_identity: Option<ToothIdentity>,
    /// Where the time went.
    pub timing_ms: Timing,
    /// Frame bookkeeping.
    pub frames: FrameCount,
    /// Cycles of the press, since the controller's power-up, when the die was looked at.
    pub press_cycles: u32,
    /// Most memory that this process held at once, MB; absent where the system does not say.
    pub peak_memory_mb: Option<f64>,
    /// One entry per view.
    pub registration: Vec<ViewRegistration>,
    /// Tool name.
    pub tool: String,
    /// What the die is known by.
    pub die: DieKey,
    /// Temperature of the tool that the scale was corrected for, degrees C; absent when it is not known.
    pub temperature_degc: Option<f64>,
    /// Host, protocol, firmware.
    pub versions: BTreeMap<&'static str, String>,
    /// BLAKE3 of what went in: CAD, tool file, head file, core map, baseline, recipe.
    pub hashes: BTreeMap<&'static str, String>,
    /// How the check looked at the tool, beside what the files say.
    pub recipe: Recipe,
    /// What the verdict on each view was computed from.
    pub evidence: Vec<Evidence>,
    /// Why the check ended early, if it did.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stopped: Option<String>,
    /// What kind of reason that was.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stopped_code: Option<Code>,
    /// From the simulated bench alone: what was true.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub truth: Option<serde_json::Value>,
    /// The sums of every capture, to be stored.
    #[serde(skip)]
    pub phasors: Vec<Phasors>,
    /// Deviation from CAD of every measured flank, cell by cell: what a baseline is made of.
    #[serde(skip)]
    pub fields: Vec<Reference>,
    /// What every view showed beside its tooth: part of a baseline, too.
    #[serde(skip)]
    pub neighbours: Vec<ViewReference>,
    /// What every view said of its own pose about the axis: part of a baseline, too.
    #[serde(skip)]
    pub poses: Vec<PoseEvidence>,
    /// What only the report draws.
    #[serde(skip)]
    pub pictures: Pictures,
}

impl Inspection {
    /// What a check of a new tool says of it.
    ///
    /// # Errors
    /// The check did not end in go.
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
        })
    }

    /// The verdict and its reason.
    #[must_use]
    pub fn sentence(&self) -> String {
        format!("{}: {}", self.verdict, self.reason)
    }

    /// Something speaks against the verdict: damage that was found stays found, everything else is indeterminate.
    pub fn withhold(&mut self, why: &Reason) {
        self.verdict = self.verdict.withheld();
        self.reason = match self.verdict {
            Word::NoGo => format!("{}; {why}", self.reason),
            Word::Go | Word::Warn | Word::Indeterminate => why.to_string(),
        };
    }
}

/// Raw material of the report's pictures.
#[derive(Clone, Debug, Default)]
pub struct Pictures {
    /// Deviation maps, one per inspected flank.
    pub maps: Vec<FlankMap>,
    /// Signed deviations in the inspected zones, µm.
    pub deviations_um: Vec<f64>,
    /// Activity of the devices.
    pub activities: Vec<Activity>,
    /// What their rotary stage turned.
    pub moves: Moves,
    /// One raw frame.
    pub frame: Option<Picture>,
    /// The toothing around the flanks; absent where the tool is none.
    pub toothing: Option<Toothing>,
}

/// A toothing as reports draw it.
#[derive(Clone, Debug)]
pub struct Toothing {
    /// Its drawing.
    pub gear: GearData,
    /// Lower and upper end of the judged zone's profile, as radii, mm.
    pub zone_radius_mm: [f64; 2],
}

impl Toothing {
    /// That of a tool.
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
}
