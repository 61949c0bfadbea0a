//! What stands before which head, by the files of a tool or a target.

use std::path::Path;

use anyhow::Context;
use flankscope_gear_cad::{Flank, GearKind, GearSpec, Mesh};

use crate::demo;
use crate::files::{Gear, HeadFile, Kind, TargetFile, ToolFile, made_head_beside, mesh};
use crate::world::{FlankId, HeadDesign, PatternSpec, WorldConfig};
use crate::zones::Judged;

/// What stands before which head.
pub struct Specimen {
    /// The world: geometry by the files, light, blur and noise of the head as it was made.
    pub config: WorldConfig,
    /// What the DMD shows after black.
    pub patterns: Vec<PatternSpec>,
    /// How high it reaches, mm.
    pub top_mm: Option<f64>,
    /// What is judged of it.
    pub judged: Option<Judged>,
    /// Whether it is a gear: what is none has no flanks, wherever its surface lies.
    pub has_flanks: bool,
}

impl Specimen {
    /// The target of a folder before a head as it was made, whatever the folder's head.toml says of its lenses; its DMD shows the
    /// patterns that the head.toml names. `seed` draws how the plates lie.
    ///
    /// # Errors
    /// A file cannot be read, or names patterns that the bench has not.
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
            // Nobody asks for a target's.
            has_flanks: true,
        })
    }

    /// The die of a tool file or its folder before the head beside it (made as the `optics.toml` there says, with the lenses of the
    /// `head.toml` unless a liquid lens makes them), else before the demo head; judged are `teeth` instead of the file's.
    ///
    /// # Errors
    /// The files cannot be read, or describe what cannot stand on the bench.
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
            // As before a calibration target: no facet lies on its flanks.
            None => demo::gear(),
        };
        let mut config = WorldConfig::new(cad, gear_spec);
        made.impose(&mut config);
        // A liquid lens makes the lenses of its head what they are.
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

/// Height of the upper end of what is no gear, mm.
fn top_of(cad: &Mesh) -> f64 {
    let heights = cad.vertices.iter().map(|vertex| vertex[2]);
    heights.fold(f64::NEG_INFINITY, f64::max)
}

/// What the DMD of a head shows.
fn shown(head: &HeadFile, made: &HeadDesign) -> anyhow::Result<Vec<PatternSpec>> {
    let (name, fringes) = match &head.pattern_set {
        Some(name) => (name, &head.fringes),
        None => (&made.pattern_set, &made.fringes),
    };
    PatternSpec::of_head(name, fringes)
        .with_context(|| format!("the bench's DMD has no pattern set {name:?}"))
}

fn gear_of(gear: &Gear, cad: &Mesh) -> anyhow::Result<GearSpec> {
    // The bench's gear has its first tooth half a pitch behind +x.
    let half_pitch_deg = 180.0 / f64::from(gear.teeth);
    let off_deg = (gear.first_tooth_centre_deg - half_pitch_deg).rem_euclid(2.0 * half_pitch_deg);
    anyhow::ensure!(
        off_deg.min(2.0 * half_pitch_deg - off_deg) < 1e-6
            && gear.first_tooth_centre_deg < 2.0 * half_pitch_deg,
        "first_tooth_centre_deg = {} cannot be put on the bench; {half_pitch_deg} (a tooth space on +x) can",
        gear.first_tooth_centre_deg,
    );
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
        body_radius_mm: cad
            .vertices
            .iter()
            .map(|vertex| vertex[0])
            .fold(0.0, f64::max),
        height_mm: gear.height_mm,
    })
}

/// The zones that a check of the tool judges, on its drawing; teeth that it does not have are left out.
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
