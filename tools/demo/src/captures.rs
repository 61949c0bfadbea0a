//! The demo target photographed to files, as a head on somebody else's bench would be.

use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use flankscope_foundation::files::write_whole;
use flankscope_profilometry::calibrate::{
    CapturedView, Captures, Plate, StageOffset, StagePose, Target,
};

use crate::target::target;
use flankscope_bench::demo::StageErrors;
use flankscope_bench::world::{PatternSpec, World, WorldConfig};

/// Half widths of the stages' errors: rad, mm.
const STAGE_ERRORS: [f64; 2] = [15e-3 * std::f64::consts::PI / 180.0, 5e-3];
const PLAN: &str = "\
# The dark frame, then 4 periods in 4 steps and 48 periods in 8 steps, in the order of the images' names.
pattern_set = \"insitu12\"
dark_first = true
";

#[derive(Clone, Debug)]
pub struct TargetView {
    /// Its folder of images.
    pub folder: PathBuf,
    /// The printed plate, from 0; neither of blank plate and sphere.
    pub plate: Option<usize>,
    /// What the stages were told.
    pub told: StagePose,
    /// Where they stood: rotation (rad), height (mm).
    pub true_pose: [f64; 2],
    /// Number of its dark frame; it seeds the noise.
    pub first_frame: u32,
    /// Whether an adjustment shall leave it out.
    pub kept_aside: bool,
}

/// The blank plate, every printed plate from each place of `around`, and the spheres at every place of a self-test.
#[must_use]
pub fn target_views(target: &Target, seed: u64, around: &[StageOffset]) -> Vec<TargetView> {
    let mut errors = StageErrors::new(seed);
    let mut views = Vec::new();
    let mut add = |name: String, plate: Option<usize>, told: StagePose, kept_aside: bool| {
        views.push(TargetView {
            folder: name.into(),
            plate,
            told,
            true_pose: [
                told.rotation_rad + errors.draw(STAGE_ERRORS[0]),
                told.vertical_mm + errors.draw(STAGE_ERRORS[1]),
            ],
            first_frame: 100 * views.len() as u32,
            kept_aside,
        });
    };
    let facing = |plate: &Plate| StagePose::before(plate.tool_from_plate.translation_mm);
    add("blank".into(), None, facing(&target.blank), false);
    for (number, plate) in target.plate.iter().enumerate() {
        for (beside, &place) in around.iter().enumerate() {
            let name = format!("plate-{}-{}", number + 1, beside + 1);
            let kept_aside = beside + 1 == target.beside.len();
            add(name, Some(number), facing(plate).beside(place), kept_aside);
        }
    }
    for (number, at) in target.spheres().into_iter().enumerate() {
        add(format!("spheres-{}", number + 1), None, at.stood, false);
    }
    views
}

/// Writes `captures.toml`, `PLAN.toml`, the images of every view, and the target's own files beside them.
///
/// # Errors
/// The bench refuses a view, or something cannot be written.
pub fn write_captures(
    out: &Path,
    config: &WorldConfig,
    views: &[TargetView],
) -> anyhow::Result<()> {
    let target = target();
    let world = World::new(config)?;
    let [width, height] = world.size_px();
    let mut pixels = vec![0; width * height];
    let patterns = PatternSpec::insitu12();
    for view in views {
        let folder = out.join(&view.folder);
        std::fs::create_dir_all(&folder)?;
        let [rotation_rad, vertical_mm] = view.true_pose;
        let state = world.prepare(rotation_rad, vertical_mm, &patterns)?;
        for index in 0..=patterns.len() as u16 {
            let counter = view.first_frame + u32::from(index);
            world.render(
                &state,
                index,
                target.exposure_us,
                true,
                counter,
                &mut pixels,
            )?;
            write_png(
                &folder.join(format!("frame-{index:02}.png")),
                &pixels,
                [width, height],
            )?;
        }
    }
    let blank = Path::new("blank");
    let spheres = views
        .iter()
        .filter(|view| view.plate.is_none() && view.folder != blank);
    let captures = Captures {
        plan: "PLAN.toml".into(),
        blank: blank.into(),
        sphere: spheres.map(|view| view.folder.clone()).collect(),
        view: views
            .iter()
            .filter_map(|view| {
                Some(CapturedView {
                    folder: view.folder.clone(),
                    plate: view.plate? + 1,
                    rotation_rad: view.told.rotation_rad,
                    vertical_mm: view.told.vertical_mm,
                    kept_aside: view.kept_aside,
                })
            })
            .collect(),
    };
    write_whole(&out.join("PLAN.toml"), PLAN.as_bytes())?;
    write_whole(&out.join(Captures::FILE), captures.to_toml()?.as_bytes())?;
    crate::write_target(out, None)
}

/// Counts as they are, in 16 bits.
fn write_png(path: &Path, counts: &[u16], [width, height]: [usize; 2]) -> anyhow::Result<()> {
    let mut encoder = png::Encoder::new(
        BufWriter::new(File::create(path)?),
        width as u32,
        height as u32,
    );
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Sixteen);
    encoder.set_compression(png::Compression::Fast);
    let bytes: Vec<u8> = counts.iter().flat_map(|dn| dn.to_be_bytes()).collect();
    encoder.write_header()?.write_image_data(&bytes)?;
    Ok(())
}
