//! A white matt tile before the demo head: for the flat-field capture that shows the bundle's cores.

use std::path::{Path, PathBuf};

use anyhow::Context;
use flankscope_bench::demo::{gear, tile};
use flankscope_bench::world::{HeadDesign, PatternSpec, World, WorldConfig};
use flankscope_foundation::date::Date;
use flankscope_foundation::files::{hash, write_whole};
use flankscope_profilometry::FrameView;
use flankscope_profilometry::calibrate::cores::{self, FlatField};
use flankscope_profilometry::head::{CoreMap, CoreMapFile};

use crate::head::head_of;

/// Evenly lit at full brightness, a tile fills the well as a white plate under fringes does in one and a half times the time.
const WHITE_SHARE: f64 = 2.0 / 3.0;
/// Averaged, they leave 0.2 % of photon noise per pixel.
const FRAMES: u32 = 8;

/// The demo head's core map, found in a photograph of the tile in best focus as a calibration does it.
///
/// # Errors
/// The bench refuses the tile, or no cores are found.
pub fn core_map() -> anyhow::Result<CoreMap> {
    core_map_of(&HeadDesign::demo())
}

/// The same of any head.
pub fn core_map_of(made: &HeadDesign) -> anyhow::Result<CoreMap> {
    let world = World::new(&tile_in_focus(made))?;
    let flat = flat_field(&world, made)?;
    Ok(cores::find(&flat)?)
}

/// The map's file and the head file's reference to it, kept from run to run in the user's cache: the capture and the
/// search take longer than all else that a demo prepares.
///
/// # Errors
/// As [`core_map`]. A cache that cannot be read or written is no error: the map is then found anew.
pub(super) fn core_map_file(made: &HeadDesign) -> anyhow::Result<(String, CoreMapFile)> {
    let cache = cache_folder(made);
    if let Some(found) = cache.as_deref().and_then(cached) {
        return Ok(found);
    }
    let (csv, reference) = core_map_of(made)?.to_csv(Path::new(MAP_FILE), Date::today());
    if let Some(cache) = cache {
        let _ = keep(&cache, &csv, &reference);
    }
    Ok((csv, reference))
}

const MAP_FILE: &str = "cores.csv";
const REFERENCE_FILE: &str = "cores.toml";
/// Characters that stand for a build in the name of a folder.
const BUILD_KEY: usize = 16;

/// One per tile and head, its name begun by the build of this program: another finder may find otherwise.
fn cache_folder(made: &HeadDesign) -> Option<PathBuf> {
    let program = std::fs::metadata(std::env::current_exe().ok()?).ok()?;
    let build = (program.len(), program.modified().ok()?);
    let key = |of: String| hash(of.as_bytes())[..BUILD_KEY].to_owned();
    let head = key(format!("{:?} {made:?} {FRAMES}", tile_in_focus(made)));
    let build = key(format!("{build:?}"));
    let caches = std::env::var_os("XDG_CACHE_HOME")
        .map(PathBuf::from)
        .or_else(|| Some(PathBuf::from(std::env::var_os("HOME")?).join(".cache")))
        .filter(|path| path.is_absolute())?;
    Some(
        caches
            .join("flankscope")
            .join("demo-cores")
            .join(build + &head),
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
    let build = |folder: &Path| {
        let name = folder.file_name().and_then(|name| name.to_str());
        name.and_then(|name| name.get(..BUILD_KEY))
            .map(str::to_owned)
    };
    if let Some(siblings) = folder.parent().and_then(|parent| parent.read_dir().ok()) {
        for old in siblings.flatten().map(|old| old.path()) {
            if build(&old) != build(folder) {
                let _ = std::fs::remove_dir_all(old);
            }
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

fn tile_in_focus(made: &HeadDesign) -> WorldConfig {
    let mut config = WorldConfig::new(tile(made.driven_radius_mm(), [0.0; 2]), gear());
    made.impose(&mut config);
    config
}

/// Photographs whatever lies before the head of `world`, evenly lit.
///
/// # Errors
/// The head's file says nothing about its sensor, or the bench refuses the capture.
pub fn flat_field(world: &World, made: &HeadDesign) -> anyhow::Result<FlatField> {
    let exposure_us = (WHITE_SHARE * f64::from(made.white_exposure_us)).round() as u32;
    let sensor = head_of(made).sensor.context("a sensor")?;
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
        world.render(&view, 1, exposure_us, true, frame, &mut pixels)?;
        flat.add(FrameView::packed(&pixels, width, height))?;
    }
    Ok(flat)
}
