//! The tool file: which CAD, which gear, what to inspect, which limits.

mod as_built;
mod check;
pub mod gear_in_cad;
mod patch_file;

use std::path::{Path, PathBuf};

pub use as_built::AsBuiltError;
use patch_file::PatchFile;

use crate::feature::Features;
use crate::gear::{Flank, GearData, GearError};
use crate::io::Unit;
use crate::io::mesh::{self, MeshError, TriMesh};
use crate::patch::{PatchError, Patches};
use crate::surface::Surface;
use crate::surface::orientation::{Unsigned, orient};
use crate::verdict::flank::{FlankLimits, TipLimits};
use crate::verdict::{Reason, Rule, Undecided};
use crate::wear::sensitivity::ExpansionUncertainty;
use crate::wear::{AREA_MM2, WearSettings, Zone, tip_loss_mm2};

/// Name of the file inside a tool folder.
pub const FILE_NAME: &str = "tool.toml";
/// Limits of a single cell over those of a disc, which has some twenty cells.
const CELL_PER_DISC: f64 = 2.0;
/// A loss so many times the warning limit is supposed wherever nothing was measured.
const HIDDEN_DEPTH_PER_WARN: f64 = 10.0;
/// Warning and stop limit of the tip edge's rounding in modules: a die's tip forms the workpiece's root, whose fillet ISO 53
/// gives a radius of 0.25 modules (profile C) to 0.38 (profiles A, B).
const TIP_PER_MODULE: [f64; 2] = [0.25, 0.38];

/// A tool, ready to inspect.
#[derive(Debug, Clone)]
pub struct Tool {
    /// Name.
    pub name: String,
    /// Serial number of the die, where the file names one.
    pub serial: Option<String>,
    /// The tool file.
    pub path: PathBuf,
    /// CAD.
    pub cad: Cad,
    /// CAD mesh, mm.
    pub mesh: TriMesh,
    /// CAD surface, prepared.
    pub surface: Surface,
    /// Gear data, checked against the mesh.
    pub gear: Option<GearData>,
    /// Patches of the CAD, of a tool that is no gear.
    pub patches: Patches,
    /// Teeth, zone and limits of an inspection.
    pub inspect: Option<Inspect>,
    /// Standard uncertainty of a flank's form as built, µm; none when nothing is said of it.
    pub as_built_um: Option<f64>,
    /// Thermal expansion; without it, the tool is taken to be measured at the temperature of its CAD.
    pub temperature: Option<Temperature>,
}

/// The `[cad]` table.
#[derive(Debug, Clone, PartialEq, serde::Deserialize, serde::Serialize)]
#[serde(deny_unknown_fields)]
pub struct Cad {
    /// Mesh file, absolute or relative to the tool file.
    pub file: PathBuf,
    /// Its unit.
    #[serde(default)]
    pub unit: Unit,
    /// Largest distance of the facets from the true surface, micrometres.
    #[serde(default)]
    pub chord_error_um: f64,
}

/// The `[inspect]` table.
#[derive(Debug, Clone, PartialEq, serde::Deserialize, serde::Serialize)]
#[serde(deny_unknown_fields)]
pub struct Inspect {
    /// Teeth to look at, from 1; empty where patches are looked at.
    #[serde(default)]
    pub teeth: Vec<u32>,
    /// Height at which the head looks, mm; not a number where patches say it.
    #[serde(default = "unsaid")]
    pub height_mm: f64,
    /// Least and largest radius of the judged zone, mm; without it, the flank without the outermost tenth of a module at
    /// the tip and the root's rounding.
    pub zone_radius_mm: Option<[f64; 2]>,
    /// Lower and upper end of the judged zone relative to `height_mm`, mm.
    #[serde(default = "default_zone_height")]
    pub zone_height_mm: [f64; 2],
    /// Warning limit, micrometres.
    pub warn_um: f64,
    /// Stop limit, micrometres.
    pub limit_um: f64,
    /// Limits of proud material, micrometres; without them those of wear.
    #[serde(default)]
    pub proud_warn_um: Option<f64>,
    /// See [`Self::proud_warn_um`].
    #[serde(default)]
    pub proud_limit_um: Option<f64>,
    /// Limits of the loss of a single cell, micrometres; without them twice those of wear.
    #[serde(default)]
    pub cell_warn_um: Option<f64>,
    /// See [`Self::cell_warn_um`].
    #[serde(default)]
    pub cell_limit_um: Option<f64>,
    /// Limits of the radius of the tip edge's rounding, mm; without them 0.25 and 0.38 of the module.
    #[serde(default)]
    pub tip_warn_mm: Option<f64>,
    /// See [`Self::tip_warn_mm`].
    #[serde(default)]
    pub tip_limit_mm: Option<f64>,
    /// Area of the disc over which the largest mean loss is sought, mm2.
    #[serde(default = "default_area")]
    pub wear_area_mm2: f64,
    /// Loss that is supposed wherever nothing was measured, micrometres; without it ten times `warn_um`, at least `limit_um`.
    #[serde(default)]
    pub hidden_depth_um: Option<f64>,
    /// Standard uncertainty of a flank's form as built against CAD, micrometres; without it the CAD is taken as true, and
    /// verdicts against CAD say so.
    #[serde(default)]
    pub as_built_um: Option<f64>,
    /// Instead of [`Self::as_built_um`]: the class of ISO 1328-1 that the die keeps.
    #[serde(default)]
    pub as_built_class: Option<u32>,
    /// Instead of [`Self::as_built_um`]: the JSON of a scan of the die when it was new, relative to the tool file.
    #[serde(default)]
    pub as_built_scan: Option<PathBuf>,
    /// Thickest film of oil or spray that may lie on a flank, micrometres.
    #[serde(default)]
    pub film_um: f64,
    /// Least measured share of a zone.
    #[serde(default = "default_coverage")]
    pub least_coverage: f64,
    /// Least standard uncertainty that a head's calibration counts with, micrometres; all of it where the head does not say.
    #[serde(default)]
    pub calibration_um: Option<f64>,
    /// Standard uncertainty of the head's drift since the baseline, micrometres.
    #[serde(default = "default_drift")]
    pub drift_um: f64,
    /// Surfaces that the pose may rest on.
    #[serde(default)]
    pub datum: Datum,
    /// Instead of [`Self::datum`]: bands of height, mm, in which the workpiece never touches the flanks. The pose then rests on
    /// the flanks there alone.
    #[serde(default)]
    pub datum_height_mm: Vec<[f64; 2]>,
    /// Probability with which a limit must be kept or exceeded.
    #[serde(default = "default_probability")]
    pub probability: f64,
    /// Verdict on a figure whose guard band holds the limit.
    #[serde(default)]
    pub undecided: Undecided,
    /// Number of repeated measurements of a view with such a figure, or of looks from the side at a flank of which too little was
    /// seen, if there is time.
    #[serde(default = "default_remeasure")]
    pub remeasure: u32,
}

impl Inspect {
    /// Rule by which wear is judged.
    pub fn rule(&self) -> Rule {
        Rule {
            warn_um: self.warn_um,
            limit_um: self.limit_um,
            probability: self.probability,
            undecided: self.undecided,
            looks: 1 + self.remeasure,
        }
    }

    /// Loss that is supposed wherever nothing was measured, micrometres.
    pub fn hidden_depth_um(&self) -> f64 {
        self.hidden_depth_um
            .unwrap_or((HIDDEN_DEPTH_PER_WARN * self.warn_um).max(self.limit_um))
    }

    /// Limits of the loss of a single cell, micrometres.
    fn cell_um(&self) -> [f64; 2] {
        [
            self.cell_warn_um.unwrap_or(CELL_PER_DISC * self.warn_um),
            self.cell_limit_um.unwrap_or(CELL_PER_DISC * self.limit_um),
        ]
    }

    /// Limits of the height of proud material, micrometres.
    fn proud_um(&self) -> [f64; 2] {
        [
            self.proud_warn_um.unwrap_or(self.warn_um),
            self.proud_limit_um.unwrap_or(self.limit_um),
        ]
    }

    /// Limits of the radius of the tip edge's rounding, mm.
    fn tip_mm(&self, gear: &GearData) -> [f64; 2] {
        let [warn, limit] = TIP_PER_MODULE.map(|share| share * gear.module_mm);
        [
            self.tip_warn_mm.unwrap_or(warn),
            self.tip_limit_mm.unwrap_or(limit),
        ]
    }
}

/// Surfaces that a view's pose rests on.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Deserialize, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Datum {
    /// All but the judged tooth: sharp, but blind to wear that all teeth in view share.
    #[default]
    Neighbours,
    /// Tip and root lands only: no wear on any flank moves the pose, the stages hold it about the axis.
    Lands,
    /// Everything, the judged flanks included.
    All,
}

/// The `[temperature]` table: the tool is measured at any temperature in its range and judged at the reference.
#[derive(Debug, Clone, Copy, PartialEq, serde::Deserialize, serde::Serialize)]
#[serde(deny_unknown_fields)]
pub struct Temperature {
    /// Temperature at which the CAD holds, degrees C.
    #[serde(default = "default_reference")]
    pub reference_degc: f64,
    /// Lowest and highest temperature at which the tool may be judged, degrees C.
    pub range_degc: [f64; 2],
    /// Thermal expansion, 1/K.
    #[serde(default = "default_expansion")]
    pub expansion_per_k: f64,
    /// Standard uncertainty of the measured temperature, K.
    #[serde(default = "default_u_k")]
    pub u_k: f64,
}

impl Temperature {
    /// Expansion with the uncertainty of the measured temperature.
    pub fn expansion(&self) -> ExpansionUncertainty {
        ExpansionUncertainty {
            per_k: self.expansion_per_k,
            u_k: self.u_k,
        }
    }

    /// Size of the tool at a temperature relative to its CAD.
    ///
    /// # Errors
    /// The temperature is missing or out of range: the tool cannot be judged.
    pub fn scale(&self, measured_degc: Option<f64>) -> Result<f64, Reason> {
        let degc = measured_degc.ok_or(Reason::TemperatureMissing)?;
        let [low, high] = self.range_degc;
        if (low..=high).contains(&degc) {
            Ok(1.0 + self.expansion_per_k * (degc - self.reference_degc))
        } else {
            Err(Reason::TemperatureRange { degc, low, high })
        }
    }
}

fn unsaid() -> f64 {
    f64::NAN
}

fn default_area() -> f64 {
    AREA_MM2
}

fn default_drift() -> f64 {
    0.5
}

fn default_remeasure() -> u32 {
    1
}

fn default_probability() -> f64 {
    crate::verdict::PROBABILITY
}

fn default_reference() -> f64 {
    20.0
}

/// Expansion of steel per kelvin.
pub const STEEL_PER_K: f64 = 11.5e-6;

fn default_expansion() -> f64 {
    STEEL_PER_K
}

fn default_u_k() -> f64 {
    1.0
}

fn default_zone_height() -> [f64; 2] {
    [-4.0, 4.0]
}

fn default_coverage() -> f64 {
    0.8
}

#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    #[serde(deserialize_with = "flankscope_foundation::display::name")]
    name: String,
    #[serde(
        default,
        deserialize_with = "flankscope_foundation::display::some_name"
    )]
    serial: Option<String>,
    cad: Cad,
    gear: Option<GearData>,
    #[serde(default)]
    patch: Vec<PatchFile>,
    inspect: Option<Inspect>,
    temperature: Option<Temperature>,
}

/// Reasons for which a tool file is refused.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ToolError {
    /// The file cannot be read.
    #[error("cannot read tool file {}: {source}; right would be a {FILE_NAME} or a folder that holds one", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Cause.
        source: std::io::Error,
    },
    /// Not TOML, an unknown key, a missing key or a wrong type.
    #[error("{}:{line}:{column}: {message}", path.display())]
    Syntax {
        /// The file.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// Column, from 1.
        column: usize,
        /// The error and the expected value, on one line.
        message: String,
    },
    /// A value out of range.
    #[error("{}: {key} = {value} is out of range; right would be {expected}", path.display())]
    Value {
        /// The file.
        path: PathBuf,
        /// Key.
        key: &'static str,
        /// The value.
        value: f64,
        /// Valid values.
        expected: String,
    },
    /// Gear data that contradict themselves.
    #[error("{}: {source}", path.display())]
    Gear {
        /// The file.
        path: PathBuf,
        /// Cause.
        source: GearError,
    },
    /// Facets of a patch are not named, or in more than one way.
    #[error("{}: patch {name:?}: {what}", path.display())]
    PatchFacets {
        /// The file.
        path: PathBuf,
        /// Name of the patch.
        name: String,
        /// The error and the valid values.
        what: String,
    },
    /// A patch that does not exist on this CAD.
    #[error("{}: {source}", path.display())]
    Patch {
        /// The file.
        path: PathBuf,
        /// Cause.
        source: Box<PatchError>,
    },
    /// Flanks and patches in one file.
    #[error("{}: [gear] and [[patch]] in one file; flanks and patches are inspected by a file each, which may name the same CAD", path.display())]
    GearAndPatches {
        /// The file.
        path: PathBuf,
    },
    /// Patches without a word on how they are judged.
    #[error("{}: [[patch]] without [inspect]; its warn_um and limit_um are needed to judge them", path.display())]
    NotInspected {
        /// The file.
        path: PathBuf,
    },
    /// A setting of teeth in a tool file without a gear.
    #[error("{}: inspect.{key} is said of the teeth of a [gear], and this file has patches; leave it out, a [[patch]] has a zone and a datum of its own", path.display())]
    OfTeeth {
        /// The file.
        path: PathBuf,
        /// Key.
        key: &'static str,
    },
    /// The CAD file is unusable.
    #[error("cannot use CAD file {} (cad.file in {}): {source}", cad.display(), path.display())]
    Mesh {
        /// The tool file.
        path: PathBuf,
        /// The CAD file.
        cad: PathBuf,
        /// Cause.
        source: MeshError,
    },
    /// The scan of the new die is unusable.
    #[error("cannot use {} (inspect.as_built_scan in {}): {source}", scan.display(), path.display())]
    AsBuilt {
        /// The tool file.
        path: PathBuf,
        /// The scan's JSON.
        scan: PathBuf,
        /// Cause.
        source: AsBuiltError,
    },
    /// The mesh repeats another number of times than the gear has teeth.
    #[error("{}: gear.teeth = {stated}, but the CAD mesh repeats {found} times about z", path.display())]
    Teeth {
        /// The file.
        path: PathBuf,
        /// In the file.
        stated: u32,
        /// In the mesh.
        found: u32,
    },
    /// The gear's tips, roots or ends are not where the mesh has them.
    #[error("{}: gear.{key} = {stated_mm} mm, but the CAD mesh has it {off_mm:.3} mm off, allowed are {limit_mm} mm; check the drawing, and the unit of the mesh", path.display())]
    Land {
        /// The file.
        path: PathBuf,
        /// Key in the tool file.
        key: &'static str,
        /// In the file.
        stated_mm: f64,
        /// Distance of the mesh from there.
        off_mm: f64,
        /// Limit.
        limit_mm: f64,
    },
    /// Nothing of the mesh is outside.
    #[error("{}: CAD mesh {}: {source}", path.display(), cad.display())]
    Unsigned {
        /// The file.
        path: PathBuf,
        /// The mesh.
        cad: PathBuf,
        /// Reason.
        source: Unsigned,
    },
    /// The mesh has a hole in the toothing: where the CAD has no surface, nothing can be judged.
    #[error("{}: CAD mesh {} is not closed: between the ends of the teeth it has a hole at ({:.3}, {:.3}, {:.3}) mm; right would be the surface of a solid (gaps up to 1 um between faces do not count): export the die as a solid, or repair the mesh", path.display(), cad.display(), hole_mm[0], hole_mm[1], hole_mm[2])]
    Open {
        /// The file.
        path: PathBuf,
        /// The mesh.
        cad: PathBuf,
        /// Middle of an edge beside which nothing lies.
        hole_mm: [f64; 3],
    },
    /// The mesh's material lies on the other side of a flank than the gear's.
    #[error("{}: gear data and CAD mesh disagree: the material of the mesh lies on the other side of the {flank} flank of tooth {tooth}; check gear.kind, and whether the mesh is the die or what is formed in it", path.display())]
    OtherSide {
        /// The file.
        path: PathBuf,
        /// Tooth.
        tooth: u32,
        /// Side.
        flank: Flank,
    },
    /// The gear's flanks are not where the mesh is.
    #[error("{}: gear data and CAD mesh disagree: the {flank} flank of tooth {tooth} at radius {radius_mm:.3} mm is {distance_mm:.3} mm off the mesh, allowed are {limit_mm} mm; check module, pressure angle, first_tooth_centre_deg, height and unit", path.display())]
    Disagree {
        /// The file.
        path: PathBuf,
        /// Tooth.
        tooth: u32,
        /// Side.
        flank: Flank,
        /// Radius.
        radius_mm: f64,
        /// Distance of the involute from the mesh.
        distance_mm: f64,
        /// Limit.
        limit_mm: f64,
    },
}

impl Tool {
    /// Loads a tool from its file or from a folder that holds `tool.toml`, with its CAD, and checks that all fits together.
    ///
    /// # Errors
    /// [`ToolError`] with file, place, value and what would be right.
    pub fn load(dir_or_file: &Path) -> Result<Self, ToolError> {
        let path = if dir_or_file.is_dir() {
            dir_or_file.join(FILE_NAME)
        } else {
            dir_or_file.to_owned()
        };
        let text =
            flankscope_foundation::files::read_text(&path).map_err(|source| ToolError::Read {
                path: path.clone(),
                source,
            })?;
        let mut file = parse(&path, &text)?;
        check::values(&path, &file)?;
        let specs = std::mem::take(&mut file.patch).into_iter();
        let specs: Vec<_> = specs
            .map(|patch| patch.spec(&path))
            .collect::<Result<_, _>>()?;
        let folder = path.parent().unwrap_or(Path::new("."));
        let cad = folder.join(&file.cad.file);
        let in_mesh = |source| ToolError::Mesh {
            path: path.clone(),
            cad: cad.clone(),
            source,
        };
        let mut mesh = mesh::load(&cad, file.cad.unit).map_err(in_mesh)?;
        let orientation = orient(&mut mesh);
        if let Some(source) = orientation.unsigned {
            return Err(ToolError::Unsigned { path, cad, source });
        }
        let mut surface = Surface::oriented(&mesh, &orientation).map_err(in_mesh)?;
        if let Some(gear) = &file.gear {
            check::against_mesh(&path, gear, &mesh, &surface)?;
            if let Some(hole_mm) = orientation.rim.hole(|place| gear.is_toothing(place)) {
                return Err(ToolError::Open { path, cad, hole_mm });
            }
            let is_closed = orientation.open_edges == 0;
            if check::is_inside_out(&path, gear, &surface, is_closed)? {
                mesh.turn_inside_out();
                surface = Surface::new(&mesh).map_err(in_mesh)?;
            }
        }
        let disc_mm2 = file
            .inspect
            .as_ref()
            .map_or(AREA_MM2, |inspect| inspect.wear_area_mm2);
        let patches = Patches::new(&specs, &mesh, &surface, disc_mm2);
        let patches = patches.map_err(|source| ToolError::Patch {
            path: path.clone(),
            source: Box::new(source),
        })?;
        let as_built_um = match &file.inspect {
            Some(inspect) => as_built::as_built_um(&path, file.gear.as_ref(), inspect)?,
            None => None,
        };
        Ok(Self {
            name: file.name,
            serial: file.serial,
            path,
            cad: file.cad,
            mesh,
            surface,
            gear: file.gear,
            patches,
            inspect: file.inspect,
            as_built_um,
            temperature: file.temperature,
        })
    }

    /// Path of the CAD file.
    pub fn cad_path(&self) -> PathBuf {
        self.path
            .parent()
            .unwrap_or(Path::new("."))
            .join(&self.cad.file)
    }

    /// Features that are judged: a gear's flanks, else its patches, of which there may be none.
    pub fn features(&self) -> Features<'_> {
        self.gear
            .as_ref()
            .map_or(Features::Patches(&self.patches), Features::Gear)
    }

    /// Numbers of the teeth or patches that are inspected; none where nothing is.
    pub fn inspected(&self) -> Vec<u32> {
        match (&self.gear, &self.inspect) {
            (_, None) => Vec::new(),
            (Some(_), Some(inspect)) => inspect.teeth.clone(),
            (None, Some(_)) => self.patches.judged(),
        }
    }

    /// Height of its upper end, mm: of the toothing, else of the CAD.
    pub fn top_mm(&self) -> f64 {
        self.gear
            .as_ref()
            .map_or(self.surface.bounds().high[2], |gear| gear.height_mm[1])
    }

    /// The zone to judge of a tooth or a patch; none where there is nothing to inspect.
    pub fn zone_of(&self, number: u32) -> Option<Zone> {
        let patch = || {
            let patch = self.patches.get(number)?;
            let [radius_mm, height_mm] = patch.zone_mm;
            Some(Zone {
                radius_mm,
                height_mm,
            })
        };
        self.zone().or_else(patch)
    }

    /// The zone to judge of every tooth; none without gear data or without anything to inspect.
    pub fn zone(&self) -> Option<Zone> {
        let (gear, inspect) = (self.gear.as_ref()?, self.inspect.as_ref()?);
        let [down, up] = inspect.zone_height_mm;
        Some(Zone {
            radius_mm: inspect
                .zone_radius_mm
                .unwrap_or_else(|| gear.active_flank_mm()),
            height_mm: [inspect.height_mm + down, inspect.height_mm + up],
        })
    }

    /// Limits of a flank; none without a section `inspect`.
    pub fn limits(&self) -> Option<FlankLimits> {
        let inspect = self.inspect.as_ref()?;
        let rule = |[warn_um, limit_um]: [f64; 2]| Rule {
            warn_um,
            limit_um,
            ..inspect.rule()
        };
        let tip = self.gear.as_ref().and_then(|gear| {
            let radius_mm = inspect.tip_mm(gear);
            let [Some(warn), Some(limit)] = radius_mm.map(|radius| tip_loss_mm2(gear, radius))
            else {
                return None;
            };
            Some(TipLimits {
                radius_mm,
                area_mm2: [warn, limit],
            })
        });
        Some(FlankLimits {
            wear: inspect.rule(),
            proud: rule(inspect.proud_um()),
            cell: rule(inspect.cell_um()),
            tip,
            least_coverage: inspect.least_coverage,
            area_mm2: inspect.wear_area_mm2,
            hidden_depth_um: inspect.hidden_depth_um(),
        })
    }

    /// Settings of the wear evaluation for this tool. Facets are chords: their mean offset is 2/3 of the chord error, which
    /// counts as the standard uncertainty of the CAD surface.
    pub fn wear_settings(&self) -> WearSettings {
        let stated_um = self.inspect.as_ref().and_then(|i| i.calibration_um);
        let defaults = WearSettings::default();
        let inspect = self.inspect.as_ref();
        WearSettings {
            area_mm2: inspect.map_or(defaults.area_mm2, |i| i.wear_area_mm2),
            hidden_depth_mm: inspect
                .map_or(defaults.hidden_depth_mm, |i| 1e-3 * i.hidden_depth_um()),
            as_built_mm: 1e-3 * self.as_built_um.unwrap_or(0.0),
            film_mm: 1e-3 * inspect.map_or(0.0, |i| i.film_um),
            calibration_mm: stated_um.map_or(defaults.calibration_mm, |um| 1e-3 * um),
            drift_mm: 1e-3
                * self
                    .inspect
                    .as_ref()
                    .map_or_else(default_drift, |i| i.drift_um),
            cad_mm: 1e-3 * self.cad.chord_error_um * 2.0 / 3.0,
        }
    }
}

fn parse(path: &Path, text: &str) -> Result<File, ToolError> {
    toml::from_str(text).map_err(|error: toml::de::Error| {
        let at = error.span().map_or(0, |span| span.start).min(text.len());
        let before = &text.as_bytes()[..at];
        let line_start = before
            .iter()
            .rposition(|&b| b == b'\n')
            .map_or(0, |i| i + 1);
        ToolError::Syntax {
            path: path.to_owned(),
            line: 1 + before.iter().filter(|&&b| b == b'\n').count(),
            column: 1 + at - line_start,
            message: error.message().replace('\n', ", "),
        }
    })
}
