//! What really was in front of the camera: for the person who judges the instrument, never for the instrument.

use std::collections::BTreeMap;

use flankscope_gear_cad::Flank;
use serde::{Deserialize, Serialize};

use crate::devices::Exposure;
use crate::world::CoreTruth;

/// Wear of one flank as the camera's cores met it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FlankTruth {
    /// Cores that saw this flank, lit, in all views.
    pub cores: usize,
    /// Mean wear over them, µm; positive for loss.
    pub mean_wear_um: f64,
    /// Largest wear, µm.
    pub max_wear_um: f64,
}

/// A pose at which frames were taken, stage errors included.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PoseTruth {
    /// True angle of the rotary stage, rad.
    pub rotation_rad: f64,
    /// True position of the vertical stage, mm.
    pub vertical_mm: f64,
    /// Frames exposed there.
    pub frames: usize,
}

/// Everything photographed.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Truth {
    /// By `TOOTH:flank`.
    pub flanks: BTreeMap<String, FlankTruth>,
    /// In order of capture.
    pub poses: Vec<PoseTruth>,
}

impl Truth {
    /// Notes one exposure of a view.
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
            let side = match id.flank {
                Flank::Left => "left",
                Flank::Right => "right",
            };
            let flank = self
                .flanks
                .entry(format!("{}:{side}", id.tooth))
                .or_default();
            let wear_um = core.wear_mm * 1e3;
            flank.cores += 1;
            flank.mean_wear_um += (wear_um - flank.mean_wear_um) / flank.cores as f64;
            flank.max_wear_um = flank.max_wear_um.max(wear_um);
        }
    }
}
