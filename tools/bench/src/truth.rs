//! True values of everything in front of the camera: for testing the instrument, never available to it.

use std::collections::BTreeMap;

use flankscope_gear_cad::Flank;
use serde::{Deserialize, Serialize};

use crate::devices::Exposure;
use crate::world::{CoreTruth, FlankId, World};
use crate::zones::{self, Judged, ZoneTruth};

/// True wear of one flank: at the points that the camera's cores saw anywhere on the flank, and in the judged zone.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FlankTruth {
    /// Number of cores that saw this flank, lit, in all views.
    pub cores: usize,
    /// Mean wear at these points, µm; positive for loss.
    pub mean_wear_um: f64,
    /// Largest wear, µm.
    pub max_wear_um: f64,
    /// True values in the judged zone, whether it was seen or not.
    #[serde(default, flatten, skip_serializing_if = "Option::is_none")]
    pub zone: Option<ZoneTruth>,
}

/// Position of the judged zone on the flanks.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ZonePlace {
    /// Smallest and largest radius, mm.
    pub radius_mm: [f64; 2],
    /// Smallest and largest height, mm.
    pub height_mm: [f64; 2],
    /// Area of the disc over which a loss is averaged, mm².
    pub disc_area_mm2: f64,
}

/// The mesh used instead of the CAD.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MeshTruth {
    pub file: String,
    /// Number of triangles with area.
    pub triangles: usize,
    /// Number of triangles without area, which were left out.
    pub degenerate: usize,
    /// Whether it has an inside.
    pub closed: bool,
}

/// The configured shape of a bore.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FormTruth {
    /// Largest minus smallest radius, µm.
    pub ovality_um: f64,
    /// Growth of the radius from bottom to top, µm.
    pub taper_um: f64,
    /// Largest minus smallest radius of three lobes, µm.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub three_lobe_um: f64,
    /// Growth of the radius from the ends to mid-height, µm.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub barrel_um: f64,
    /// Growth of the radius at the upper end, µm.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub bell_mouth_um: f64,
}

/// Zero values are left out.
fn is_zero(um: &f64) -> bool {
    *um == 0.0
}

/// A pose at which frames were captured, including stage errors.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PoseTruth {
    /// True angle of the rotary stage, rad.
    pub rotation_rad: f64,
    /// True position of the vertical stage, mm.
    pub vertical_mm: f64,
    /// Frames exposed there.
    pub frames: usize,
}

/// True values of everything that was captured.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Truth {
    /// Flanks by `TOOTH:flank`.
    pub flanks: BTreeMap<String, FlankTruth>,
    /// Poses in order of capture.
    pub poses: Vec<PoseTruth>,
    /// Zone that the values of the flanks apply to.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub zone: Option<ZonePlace>,
    /// The mesh used instead of the CAD.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub die_mesh: Option<MeshTruth>,
    /// Shape of a die that was placed by hand.
    #[serde(default, flatten, skip_serializing_if = "Option::is_none")]
    pub form: Option<FormTruth>,
}

impl Truth {
    /// Records one exposure of a view.
    pub fn photographed(&mut self, exposure: &Exposure, cores: &[CoreTruth]) {
        let here = |pose: &PoseTruth| {
            (pose.rotation_rad, pose.vertical_mm) == (exposure.rotation_rad, exposure.vertical_mm)
        };
        if let Some(pose) = self.poses.last_mut().filter(|pose| here(pose)) {
            pose.frames += 1;
            return;
        }
        self.poses.push(PoseTruth {
            rotation_rad: exposure.rotation_rad,
            vertical_mm: exposure.vertical_mm,
            frames: 1,
        });
        for core in cores.iter().filter(|core| core.lit) {
            let Some(id) = core.flank else { continue };
            let flank = self.flanks.entry(name(id)).or_default();
            let wear_um = core.wear_mm * 1e3;
            flank.cores += 1;
            flank.mean_wear_um += (wear_um - flank.mean_wear_um) / flank.cores as f64;
            flank.max_wear_um = flank.max_wear_um.max(wear_um);
        }
    }

    /// Adds the true deviation of the die from its drawing in the judged zones.
    pub fn compared(&mut self, world: &World, judged: &Judged) {
        for (id, zone) in zones::compare(world, judged) {
            self.flanks.entry(name(id)).or_default().zone = Some(zone);
        }
        self.zone = Some(ZonePlace {
            radius_mm: judged.radius_mm,
            height_mm: judged.height_mm,
            disc_area_mm2: judged.disc_area_mm2,
        });
    }
}

fn name(id: FlankId) -> String {
    let side = match id.flank {
        Flank::Left => "left",
        Flank::Right => "right",
    };
    format!("{}:{side}", id.tooth)
}
