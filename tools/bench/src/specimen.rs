//! The object in front of the head, by the files of a tool or target.

use std::path::Path;

use anyhow::Context;
use flankscope_gear_cad::{Flank, GearKind, GearSpec, Mesh};

use crate::demo;
use crate::files::{Gear, HeadFile, Kind, TargetFile, ToolFile, made_head_beside, mesh};
use crate::world::{FlankId, HeadDesign, PatternSpec, WorldConfig};
use crate::zones::Judged;

/// The object in front of a head.
pub struct Specimen {
    /// The world: geometry by the files; light, blur and noise by the head's design.
    pub config: WorldConfig,
    /// Patterns of the DMD after black.
    pub patterns: Vec<PatternSpec>,
    /// Height of its upper end, mm.
    pub top_mm: Option<f64>,
    /// Its judged zones.
    pub judged: Option<Judged>,
    /// Whether it is a gear; any other object has no flanks.
    pub has_flanks: bool,
}

impl Specimen {
    /// The target of a folder in front of a head by its design, independent of the lenses in the folder's head.toml; the DMD
    /// shows the patterns that the head.toml names. `seed` draws the deviations of the plates.
    ///
    /// # Errors
    /// A file cannot be read, or names patterns that the bench does not have.
    pub fn target(folder: &Path, seed: u64) -> anyhow::Result<Self> {
        let target = folder.join("target.toml");
        let made = made_head_beside(&target)?;
        let target = TargetFile::load(&target)?;
        let head = folder.join("head.toml");
        let head = match head.exists() {
            true => HeadFile::load(&head)?,
            false => HeadFile::of(&made),
        };
        let mut config = demo::target_world(&target, seed);
        made.impose(&mut config);
        Ok(Self {
            config,
            patterns: shown(&head, &made)?,
            top_mm: None,
            judged: None,
            // Not used for a target.
            has_flanks: true,
        })
    }

    /// The die of a tool file or its folder, in front of the head beside it (by the design in its `optics.toml`, with the lenses
    /// of its `head.toml` unless a liquid lens determines them), else of the demo head. `teeth` replace the judged teeth of the
    /// file.
    ///
    /// # Errors
    /// The files cannot be read, or describe an object that the bench cannot model.
    pub fn tool(path: &Path, teeth: Option<&[u32]>) -> anyhow::Result<Self> {
        let (tool, path) = ToolFile::load(path)?;
        let beside = path.with_file_name("head.toml");
        let made = made_head_beside(&path)?;
        let head = if beside.exists() {
            HeadFile::load(&beside)?
        } else {
            HeadFile::of(&made)
        };
        let cad = path.with_file_name("").join(&tool.cad.file);
        let cad = mesh::load(&cad, tool.cad.unit.mm())
            .with_context(|| format!("cannot use CAD file {}", cad.display()))?;
        let top_mm = match &tool.gear {
            Some(gear) => gear.height_mm[1],
            None => top_of(&cad),
        };
        let gear_spec = match &tool.gear {
            Some(gear) => gear_of(gear, &cad)?,
            // As for a calibration target: no facet lies on its flanks.
            None => demo::gear(),
        };
        let mut config = WorldConfig::new(cad, gear_spec);
        made.impose(&mut config);
        // The liquid lens determines the lenses of its head.
        if config.driven_head.is_none() {
            head.impose(&mut config.optics);
        }
        Ok(Self {
            judged: tool
                .gear
                .as_ref()
                .and_then(|gear| judged(&tool, gear, &config, teeth)),
            config,
            patterns: shown(&head, &made)?,
            top_mm: Some(top_mm),
            has_flanks: tool.gear.is_some(),
        })
    }
}

/// Height of the upper end of an object that is not a gear, mm.
fn top_of(cad: &Mesh) -> f64 {
    let heights = cad.vertices.iter().map(|vertex| vertex[2]);
    heights.fold(f64::NEG_INFINITY, f64::max)
}

/// Patterns that the DMD of a head shows.
fn shown(head: &HeadFile, made: &HeadDesign) -> anyhow::Result<Vec<PatternSpec>> {
    let (name, fringes) = match &head.pattern_set {
        Some(name) => (name, &head.fringes),
        None => (&made.pattern_set, &made.fringes),
    };
    PatternSpec::of_head(name, fringes)
        .with_context(|| format!("the bench's DMD has no pattern set {name:?}"))
}

fn gear_of(gear: &Gear, cad: &Mesh) -> anyhow::Result<GearSpec> {
    Ok(GearSpec {
        kind: match gear.kind {
            Kind::Internal => GearKind::Internal,
            Kind::External => GearKind::External,
        },
        teeth: gear.teeth,
        module_mm: gear.module_mm,
        pressure_angle_rad: gear.pressure_angle_deg.to_radians(),
        tip_radius_mm: gear.tip_radius_mm,
        root_radius_mm: gear.root_radius_mm,
        root_fillet_radius_mm: 0.0,
        // Of a die with a space on +x exactly zero.
        turned_rad: (gear.first_tooth_centre_deg - 180.0 / f64::from(gear.teeth)).to_radians(),
        body_radius_mm: cad
            .vertices
            .iter()
            .map(|vertex| vertex[0])
            .fold(0.0, f64::max),
        height_mm: gear.height_mm,
    })
}

/// The zones that a check of the tool judges, on its drawing; teeth that do not exist are left out.
fn judged(
    tool: &ToolFile,
    gear: &Gear,
    config: &WorldConfig,
    teeth: Option<&[u32]>,
) -> Option<Judged> {
    let inspect = tool.inspect.as_ref()?;
    let mut teeth = teeth.unwrap_or(&inspect.teeth).to_vec();
    teeth.sort_unstable();
    teeth.dedup();
    let flanks = teeth
        .into_iter()
        .filter(|tooth| (1..=config.gear.teeth).contains(tooth))
        .flat_map(|tooth| [Flank::Left, Flank::Right].map(|flank| FlankId { tooth, flank }))
        .collect();
    Some(Judged {
        cad: config.cad.clone(),
        gear: config.gear.clone(),
        flanks,
        radius_mm: inspect.zone_radius_mm.unwrap_or_else(|| gear.working_mm()),
        height_mm: inspect.zone_height_mm.map(|to| inspect.height_mm + to),
        disc_area_mm2: inspect.wear_area_mm2,
    })
}
