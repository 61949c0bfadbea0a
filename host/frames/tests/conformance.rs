//! The suite on the example camera, and on cameras with one fault each: it must find every one.
//!
//! The camera process is this test binary started again (`camera_process` below, asleep unless it is told to).

use std::io::BufRead as _;
use std::path::Path;
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::Duration;

use flankscope_frames::conformance::{CommandRig, Failure, Settings, Violation, run};
use flankscope_frames::{
    FrameHeader, FrameLabel, FrameSender, FrameSink, FrameSlot, Labels, Overflow, Ready,
    SharedRoot, monotonic_ns,
};

#[path = "../examples/camera.rs"]
#[allow(dead_code)] // its `main`
mod example;

const FAULT_VARIABLE: &str = "FLANKSCOPE_TEST_CAMERA_FAULT";

/// The example camera, or one with a fault.
#[test]
fn camera_process() {
    let Ok(fault) = std::env::var(FAULT_VARIABLE) else {
        return;
    };
    // The root's folder comes last; to the test harness it is a filter that fits no test.
    let root = std::env::args_os().next_back().unwrap();
    match fault.as_str() {
        "" => example::camera(root.as_ref()).unwrap(),
        fault => faulty(root.as_ref(), fault),
    }
}

/// A camera with one fault.
fn faulty(root: &Path, fault: &str) {
    let is = |name: &str| fault == name;
    let overflow = match fault {
        "waits" => Overflow::Wait,
        _ => Overflow::Drop,
    };
    let mut sink = FrameSender::open(&SharedRoot::of_owner(root).unwrap(), overflow).unwrap();
    let (trigger, triggers) = mpsc::channel();
    std::thread::spawn(move || {
        for line in std::io::stdin().lock().lines().map_while(Result::ok) {
            let _ = trigger.send(line);
        }
    });
    let (mut labels, mut delivered, mut clock_us) = (Labels::default(), 0, 0);
    let word = Ready {
        width_px: if is("announces another size") { 32 } else { 64 },
        height_px: 48,
        ..Ready::default()
    };
    sink.ready(word).unwrap();
    let mut exposed = 0_u32;
    loop {
        if let Some(arm) = sink.armed() {
            if !(is("arms once") && exposed > 0) {
                labels.arm(arm);
            }
            let counter = exposed + u32::from(is("counts ahead"));
            let session = arm.session;
            if !is("never ready") {
                sink.ready(Ready {
                    session,
                    counter,
                    ..word
                })
                .unwrap();
            }
        }
        let line = match triggers.recv_timeout(Duration::from_millis(1)) {
            Ok(line) => line,
            Err(RecvTimeoutError::Timeout) => continue,
            Err(RecvTimeoutError::Disconnected) => break,
        };
        let exposure_us: u64 = line.trim().parse().unwrap();
        std::thread::sleep(Duration::from_micros(exposure_us));
        let ended_ns = monotonic_ns();
        let (session, mut label) = labels.take();
        match fault {
            "swaps" => (label.exposure, label.pattern) = (label.pattern, label.exposure),
            "wraps round" if label == FrameLabel::BEYOND => label = FrameLabel::default(),
            _ => {}
        }
        let header = FrameHeader {
            session,
            counter: if is("skips") { delivered } else { exposed },
            label,
            width_px: if is("shrinks") && exposed > 5 { 32 } else { 64 },
            height_px: 48,
            stride_px: 64,
            measured: 8 * u32::from(is("scribbles")),
            exposure_start_us: clock_us,
            exposure_end_us: clock_us + exposure_us + if is("dawdles") { 150 } else { 0 },
            exposure_end_monotonic_ns: if is("has no clock") { 0 } else { ended_ns },
            ..FrameHeader::default()
        };
        clock_us += exposure_us + 100;
        let times = if is("repeats") && exposed == 13 { 2 } else { 1 };
        for _ in 0..times {
            let Ok(slot) = sink.loan(64 * 48, exposed) else {
                continue;
            };
            delivered += u32::from(sink.send(slot.seal(header)).is_ok());
        }
        exposed += 1;
    }
    while is("outlives") {
        std::thread::sleep(Duration::from_secs(1));
    }
}

fn suite(fault: &'static str, settings: &Settings) -> Result<usize, Failure> {
    let base = tempfile::tempdir().unwrap();
    let mut passed = 0;
    let itself = std::env::current_exe().unwrap();
    let mut rig = CommandRig::new(itself, ["--exact", "--nocapture", "camera_process"])
        .with(FAULT_VARIABLE, fault);
    run(&mut rig, base.path(), settings, |_| passed += 1)?;
    Ok(passed)
}

#[test]
fn the_example_camera_conforms() {
    assert_eq!(suite("", &Settings::default()).unwrap(), 8);
}

#[test]
fn a_camera_that_waits_for_its_host_conforms_where_it_may() {
    let waiting = Settings {
        waits: true,
        ..Settings::default()
    };
    assert_eq!(suite("waits", &waiting).unwrap(), 8);
    let failure = suite("waits", &Settings::default()).unwrap_err();
    assert!(
        matches!(failure.violation, Violation::NothingLost { .. }),
        "{failure}"
    );
}

#[test]
fn every_fault_of_a_camera_is_found() {
    type Found = fn(&Violation) -> bool;
    let faults: [(&'static str, Found); 11] = [
        ("arms once", |v| matches!(v, Violation::Session { .. })),
        ("swaps", |v| matches!(v, Violation::Label { .. })),
        ("wraps round", |v| matches!(v, Violation::Label { .. })),
        ("skips", |v| matches!(v, Violation::Counter { .. })),
        ("shrinks", |v| matches!(v, Violation::Size { .. })),
        ("scribbles", |v| matches!(v, Violation::Measured { .. })),
        ("counts ahead", |v| matches!(v, Violation::NextFrame { .. })),
        ("announces another size", |v| {
            matches!(v, Violation::Announced { .. })
        }),
        ("dawdles", |v| matches!(v, Violation::Exposure { .. })),
        ("has no clock", |v| matches!(v, Violation::Time { .. })),
        ("repeats", |v| matches!(v, Violation::Untriggered { .. })),
    ];
    for (fault, found) in faults {
        let failure = suite(fault, &Settings::default()).unwrap_err();
        assert!(found(&failure.violation), "{fault}: {failure}");
    }
    let impatient = Settings {
        patience: Duration::from_secs(5),
        ..Settings::default()
    };
    let failure = suite("never ready", &impatient).unwrap_err();
    assert!(
        matches!(failure.violation, Violation::NotReady { .. }),
        "{failure}"
    );
    let failure = suite("outlives", &impatient).unwrap_err();
    assert!(
        matches!(failure.violation, Violation::Outlives { .. }),
        "{failure}"
    );
}

#[test]
fn what_is_no_camera_is_found() {
    let brief = Settings {
        patience: Duration::from_millis(200),
        ..Settings::default()
    };
    let base = tempfile::tempdir().unwrap();
    let mut rig = CommandRig::new("true", [""; 0]);
    let failure = run(&mut rig, base.path(), &brief, |_| {}).unwrap_err();
    assert!(
        matches!(failure.violation, Violation::NoCamera { .. }),
        "{failure}"
    );
}
