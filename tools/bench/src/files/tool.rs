//! `tool.toml`: CAD, gear data, and judged zones.

use std::path::{Path, PathBuf};

use serde::Deserialize;

use super::{FileError, read};

/// The part of a tool file that the bench uses.
#[derive(Clone, Debug, Deserialize)]
pub struct ToolFile {
    /// The drawing.
    pub cad: Cad,
    /// Gear data of its flanks.
    pub gear: Option<Gear>,
    /// Judged zones.
    pub inspect: Option<Inspect>,
}

/// The `[cad]` table.
#[derive(Clone, Debug, Deserialize)]
pub struct Cad {
    /// Mesh file, absolute or relative to the tool file.
    pub file: PathBuf,
    #[serde(default)]
    pub unit: Unit,
}

/// Length unit of a mesh file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Unit {
    /// Millimetres.
    #[default]
    Mm,
    /// Metres.
    M,
    /// Micrometres.
    Um,
    /// Inches.
    Inch,
}

impl Unit {
    /// Millimetres per unit.
    #[must_use]
    pub fn mm(self) -> f64 {
        match self {
            Self::Mm => 1.0,
            Self::M => 1000.0,
            Self::Um => 1e-3,
            Self::Inch => 25.4,
        }
    }
}

/// Whether the teeth point inwards or outwards from the pitch circle.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// Inwards.
    Internal,
    /// Outwards.
    External,
}

/// The `[gear]` table.
#[derive(Clone, Debug, Deserialize)]
pub struct Gear {
    /// Internal or external.
    pub kind: Kind,
    /// Number of teeth.
    pub teeth: u32,
    pub module_mm: f64,
    /// Pressure angle at the pitch circle.
    pub pressure_angle_deg: f64,
    /// Radius of the tooth tips.
    pub tip_radius_mm: f64,
    pub root_radius_mm: f64,
    /// Angle of the centre of tooth 1.
    pub first_tooth_centre_deg: f64,
    /// Lower and upper end of the toothing.
    pub height_mm: [f64; 2],
}

/// The `[inspect]` table.
#[derive(Clone, Debug, Deserialize)]
pub struct Inspect {
    /// Judged teeth, from 1.
    #[serde(default)]
    pub teeth: Vec<u32>,
    /// Height that the head views.
    #[serde(default)]
    pub height_mm: f64,
    /// Least and largest radius of the judged zone.
    pub zone_radius_mm: Option<[f64; 2]>,
    /// Its lower and upper end relative to `height_mm`.
    #[serde(default = "zone_height_mm")]
    pub zone_height_mm: [f64; 2],
    /// Area of the disc whose mean loss is the wear of a zone.
    #[serde(default = "wear_area_mm2")]
    pub wear_area_mm2: f64,
}

fn zone_height_mm() -> [f64; 2] {
    [-4.0, 4.0]
}

fn wear_area_mm2() -> f64 {
    0.25
}

impl ToolFile {
    /// Reads a tool file, or the `tool.toml` of a folder; also returns its path.
    pub fn load(file_or_folder: &Path) -> Result<(Self, PathBuf), FileError> {
        let path = if file_or_folder.is_dir() {
            file_or_folder.join("tool.toml")
        } else {
            file_or_folder.to_path_buf()
        };
        Ok((read(&path)?, path))
    }
}

impl Gear {
    /// Radii of the working flank: from a tenth of a module behind the tip to three quarters of a module beyond the pitch circle.
    pub fn working_mm(&self) -> [f64; 2] {
        let pitch_mm = 0.5 * self.module_mm * f64::from(self.teeth);
        let (behind, beyond) = (0.1 * self.module_mm, 0.75 * self.module_mm);
        match self.kind {
            Kind::Internal => [self.tip_radius_mm + behind, pitch_mm + beyond],
            Kind::External => [pitch_mm - beyond, self.tip_radius_mm - behind],
        }
    }
}
