//! How fast the host processes the views of a scan by itself: frames of some views are rendered first, then summed, decoded,
//! laid on the CAD and kept as in a running scan, several times over.
//!
//! ```text
//! cargo run --release -p flankscope-demo --example scan_views -- [VIEWS]
//! ```

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context, Result, ensure};
use flankscope_bench::demo as die;
use flankscope_bench::world::{Mount, PatternSpec, World};
use flankscope_demo as demo;
use flankscope_jobs::scan::{Grid, Kept, Processing};
use flankscope_jobs::subject::Subject;
use flankscope_metrology::tool::Tool;
use flankscope_profilometry::{FrameView, HeadModel};

/// Times that every view is processed; the first is not counted.
const PASSES: usize = 4;

fn main() -> Result<()> {
    let views: usize = std::env::args()
        .nth(1)
        .map_or(Ok(8), |views| views.parse())
        .context("VIEWS must be a whole number")?;
    let folder = tempfile::tempdir()?;
    demo::write_tool(folder.path(), None)?;
    let subject = Subject {
        tool: Arc::new(Tool::load(folder.path())?),
        head: Arc::new(HeadModel::load(&folder.path().join("head.toml"))?),
        temperature_degc: None,
        station: Arc::default(),
        baseline: None,
        head_seal: "unsigned".into(),
        seals: flankscope_record::seal::Seals::passing()?,
        hashes: BTreeMap::new(),
    };
    let grid: Grid = "84x7".parse()?;
    let mut processing = Processing::open(&subject, grid, &folder.path().join("session"))?;
    let plan = processing.plan().clone();
    let views = views.min(plan.views.len());

    let mut config = die::world_config()?;
    config.mount = Mount::by_hand(1);
    let world = World::new(&config)?;
    let [width, height] = world.size_px();
    let patterns = PatternSpec::insitu12();
    let mut recorded = Vec::with_capacity(views);
    for at in &plan.views[..views] {
        let view = world.prepare(at.rotation_rad, at.vertical_mm, &patterns)?;
        let mut frames = Vec::new();
        let dark = std::iter::once((0, plan.exposures_us[0]));
        let fringes = plan
            .exposures_us
            .iter()
            .flat_map(|&us| (1..=patterns.len() as u16).map(move |pattern| (pattern, us)));
        for (number, (pattern, exposure_us)) in dark.chain(fringes).enumerate() {
            let mut frame = vec![0_u16; width * height];
            world.render(&view, pattern, exposure_us, true, number as u32, &mut frame)?;
            frames.push(frame);
        }
        recorded.push(frames);
    }

    let (mut begun, mut begun_cpu_s) = (Instant::now(), cpu_s());
    for pass in 0..PASSES {
        if pass == 1 {
            (begun, begun_cpu_s) = (Instant::now(), cpu_s());
        }
        for (view, frames) in recorded.iter().enumerate() {
            let frames: Vec<FrameView<'_>> = frames
                .iter()
                .map(|frame| FrameView::packed(frame, width, height))
                .collect();
            let kept = processing.view(view, &frames)?;
            ensure!(kept == Kept::Kept, "view {view}: {kept:?}");
        }
    }
    let counted = ((PASSES - 1) * views) as f64;
    let per_view_ms = begun.elapsed().as_secs_f64() * 1e3 / counted;
    let cpu_ms = (cpu_s() - begun_cpu_s) * 1e3 / counted;
    println!(
        "{{\"name\": \"scan/view\", \"ms\": {per_view_ms:.1}, \"cpu_ms\": {cpu_ms:.1}, \"views_per_s\": {:.1}, \"threads\": {}}}",
        1e3 / per_view_ms,
        rayon::current_num_threads()
    );
    Ok(())
}

/// Processor time of all threads so far, s: what does not depend on who else wants the machine.
fn cpu_s() -> f64 {
    let spent = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    spent.tv_sec as f64 + spent.tv_nsec as f64 * 1e-9
}
