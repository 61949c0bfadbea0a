//! The bench's camera is a camera process like any other: it passes the suite of the frame contract.
//!
//! The camera process is this test binary started again (`camera_process` below, asleep unless it is told to).

use std::path::Path;
use std::time::Duration;

use flankscope_bench::ageing::Ageing;
use flankscope_bench::camera::{self, Troubles};
use flankscope_bench::demo;
use flankscope_bench::devices::{Exposure, ExposureSink};
use flankscope_bench::world::{PatternSpec, World, WorldConfig};
use flankscope_frames::conformance::{CommandRig, Settings, run};
use flankscope_frames::{FrameSender, Overflow, SharedRoot};

const PROCESS_VARIABLE: &str = "FLANKSCOPE_TEST_CAMERA";

/// Photographs a tile, once per line on standard input.
#[test]
fn camera_process() {
    if std::env::var_os(PROCESS_VARIABLE).is_none() {
        return;
    }
    let root = std::env::args_os().next_back().unwrap();
    let world = World::new(&WorldConfig::new(demo::tile(41.5, [0.0; 2]), demo::gear())).unwrap();
    let (thread, mut camera) = camera::start(
        world,
        PatternSpec::insitu12(),
        Ageing::default(),
        Troubles::default(),
        None,
        move || {
            let root = SharedRoot::of_owner(Path::new(&root))?;
            Ok(FrameSender::open(&root, Overflow::Drop)?)
        },
        false,
    )
    .unwrap();
    let mut now_us = 0;
    for (counter, line) in (0..).zip(std::io::stdin().lines()) {
        let exposure_us: u64 = line.unwrap().trim().parse().unwrap();
        camera.exposed(Exposure {
            counter,
            start_us: now_us,
            end_us: now_us + exposure_us,
            shown: [Some(1), None],
            rotation_rad: 0.0,
            vertical_mm: 0.0,
            readout_done_us: now_us + exposure_us + 12_500,
        });
        camera.read_out(counter);
        now_us += exposure_us + 12_500;
    }
    thread.finish().unwrap();
}

#[test]
fn the_benchs_camera_conforms() {
    let base = tempfile::tempdir().unwrap();
    let itself = std::env::current_exe().unwrap();
    let mut rig = CommandRig::new(itself, ["--exact", "--nocapture", "camera_process"])
        .with(PROCESS_VARIABLE, "1");
    // It renders 2.3 million pixels per frame, and has a world to build first.
    let settings = Settings {
        patience: Duration::from_secs(60),
        ..Settings::default()
    };
    let mut passed = 0;
    run(&mut rig, base.path(), &settings, |_| passed += 1).unwrap();
    assert_eq!(passed, 8);
}
