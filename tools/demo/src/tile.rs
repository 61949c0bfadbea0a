//! A white matt tile before the demo head: for the flat-field capture that shows the bundle's cores.

use std::path::{Path, PathBuf};

use flankscope_bench::demo::{gear, tile};
use flankscope_bench::world::{PatternSpec, World, WorldConfig};
use flankscope_profilometry::calibrate::cores::{self, FlatField};
use flankscope_profilometry::date::Date;
use flankscope_profilometry::head::{CoreMap, CoreMapFile};
use flankscope_profilometry::{FrameView, HeadModel};
use flankscope_station::files::{hash, write_whole};

/// Evenly lit at full brightness, the brightest pixels reach half the full well.
const EXPOSURE_US: u32 = 8_000;
/// Averaged, they leave 0.2 % of photon noise per pixel.
const FRAMES: u32 = 8;
/// The head's best focus lies this far from the stage's axis, mm.
const FOCUS_RADIUS_MM: f64 = 41.5;
/// The demo head's core map, found in a photograph of the tile in best focus as a calibration does it.
///
/// # Errors
/// The bench refuses the tile, or no cores are found.
pub fn core_map(head: &HeadModel) -> anyhow::Result<CoreMap> {
    let world = World::new(&tile_in_focus())?;
    let flat = flat_field(&world, head)?;
    Ok(cores::find(&flat)?)
}

/// The map's file and the head file's reference to it, kept from run to run in the user's cache: the capture and the
/// search take longer than all else that a demo prepares.
///
/// # Errors
/// As [`core_map`]. A cache that cannot be read or written is no error: the map is then found anew.
pub(super) fn core_map_file(head: &HeadModel) -> anyhow::Result<(String, CoreMapFile)> {
    let cache = cache_folder();
    if let Some(found) = cache.as_deref().and_then(cached) {
        return Ok(found);
    }
    let (csv, reference) = core_map(head)?.to_csv(Path::new(MAP_FILE), Date::today());
    if let Some(cache) = cache {
        let _ = keep(&cache, &csv, &reference);
    }
    Ok((csv, reference))
}

const MAP_FILE: &str = "cores.csv";
const REFERENCE_FILE: &str = "cores.toml";

/// One per tile, head and build of this program: another finder may find otherwise.
fn cache_folder() -> Option<PathBuf> {
    let program = std::fs::metadata(std::env::current_exe().ok()?).ok()?;
    let build = (program.len(), program.modified().ok()?);
    let key = hash(format!("{:?} {EXPOSURE_US} {FRAMES} {build:?}", tile_in_focus()).as_bytes());
    let caches = std::env::var_os("XDG_CACHE_HOME")
        .map(PathBuf::from)
        .or_else(|| Some(PathBuf::from(std::env::var_os("HOME")?).join(".cache")))
        .filter(|path| path.is_absolute())?;
    Some(
        caches
            .join("flankscope")
            .join("demo-cores")
            .join(&key[..16]),
    )
}

fn cached(folder: &Path) -> Option<(String, CoreMapFile)> {
    let csv = std::fs::read_to_string(folder.join(MAP_FILE)).ok()?;
    let reference = std::fs::read_to_string(folder.join(REFERENCE_FILE)).ok()?;
    let reference: CoreMapFile = toml::from_str(&reference).ok()?;
    (hash(csv.as_bytes()) == reference.blake3).then_some((csv, reference))
}

fn keep(folder: &Path, csv: &str, reference: &CoreMapFile) -> anyhow::Result<()> {
    // Maps of earlier builds serve nobody.
    if let Some(siblings) = folder.parent().and_then(|parent| parent.read_dir().ok()) {
        for old in siblings.flatten().filter(|old| old.path() != folder) {
            let _ = std::fs::remove_dir_all(old.path());
        }
    }
    std::fs::create_dir_all(folder)?;
    write_whole(&folder.join(MAP_FILE), csv.as_bytes())?;
    write_whole(
        &folder.join(REFERENCE_FILE),
        toml::to_string(reference)?.as_bytes(),
    )?;
    Ok(())
}

fn tile_in_focus() -> WorldConfig {
    WorldConfig::new(tile(FOCUS_RADIUS_MM, [0.0; 2]), gear())
}

/// Photographs whatever lies before the head of `world`, evenly lit.
///
/// # Errors
/// The head has no sensor, or the bench refuses the capture.
pub fn flat_field(world: &World, head: &HeadModel) -> anyhow::Result<FlatField> {
    let Some(sensor) = head.sensor else {
        anyhow::bail!("the head says nothing about its sensor: give [sensor] in head.toml")
    };
    let lit = PatternSpec {
        periods: 0.0,
        step: 0,
        steps: 1,
    };
    let view = world.prepare(0.0, 0.0, &[lit])?;
    let [width, height] = world.size_px();
    let mut flat = FlatField::new(
        width,
        height,
        sensor.offset_dn,
        sensor.saturation_limit_dn(),
    );
    let mut pixels = vec![0; width * height];
    for frame in 0..FRAMES {
        world.render(&view, 1, EXPOSURE_US, true, frame, &mut pixels)?;
        flat.add(FrameView::packed(&pixels, width, height))?;
    }
    Ok(flat)
}
