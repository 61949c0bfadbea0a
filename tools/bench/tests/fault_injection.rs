//! The Cortex-M image itself goes wrong, in the middle of a capture: reset into the safe state, and the first hello says why.

mod common;

use common::{Host, Notebook, plan};
use embassy_time::Timer;
use flankscope_bench::devices::{DeviceConfig, spawn_all};
use flankscope_bench::qemu::pin_wire::Subject;
use flankscope_bench::qemu::{FaultInjection, Machine, join};
use flankscope_controller::liveness::Task;
use flankscope_protocol::message::Boot;
use flankscope_protocol::*;
use flankscope_sim::{Clock, Sim, Wiring, now_us};
use flankscope_test_requisites::emulated_image;
use std::cell::Cell;
use std::path::Path;
use std::rc::Rc;

/// What `cargo xtask firmware` builds for this test alone.
const IMAGE: &str = "flankscope-mps2-an386-fault-injection";

#[test]
fn a_hung_spinning_panicking_or_faulting_image_ends_in_a_reset_and_the_safe_state() {
    let Some(image) = emulated_image(IMAGE) else {
        return;
    };
    let hangs = Task::ALL.map(|task| (FaultInjection::Hang(task), Boot::Watchdog));
    let others = [
        (FaultInjection::Spin(Task::Sequencer), Boot::Watchdog),
        (FaultInjection::Spin(Task::Stage), Boot::Watchdog),
        (FaultInjection::Panic, Boot::Panic),
        (FaultInjection::Fault, Boot::Panic),
    ];
    std::thread::scope(|scope| {
        for (fault, boot) in hangs.into_iter().chain(others) {
            let image = &image;
            scope.spawn(move || inject(image, fault, boot));
        }
    });
}

fn inject(image: &Path, fault: FaultInjection, expected: Boot) {
    let sim = Sim::new(Clock::Paced { speed: 1.0 });
    let wiring = Wiring::new(&sim);
    spawn_all(&sim, &wiring, &DeviceConfig::default(), Notebook::default());
    let machine = Machine::start(image).expect("an emulator");
    let emulated = Rc::new(join(&sim, &wiring, &machine).expect("joined"));
    let mut host = Host::new(wiring.host.clone());
    let finished = Rc::new(Cell::new(None));
    let (result, watched) = (Rc::clone(&finished), Rc::clone(&emulated));
    sim.spawn(async move {
        let starts = || {
            let trace = watched.trace();
            trace
                .iter()
                .filter(|told| told.subject == Subject::Started)
                .count()
        };
        while starts() == 0 {
            Timer::after_millis(5).await;
        }
        host.prepare(plan()).await;
        let start = Command::Start { session: 5 };
        assert_eq!(host.order(start.clone()).await, Reply::Accepted);
        // The light is on.
        let lit = |told: &flankscope_bench::qemu::pin_wire::PinMessage| {
            told.subject == Subject::LedEnable && told.value == 1
        };
        while !watched.trace().iter().any(lit) {
            host.keep_company(10).await;
        }
        let ordered_at = watched.trace().len();
        watched.inject(fault);
        while starts() == 1 {
            host.listen(10).await;
        }
        host.forget();
        let hello = Command::Hello {
            protocol: PROTOCOL_VERSION,
            schema: SCHEMA_HASH,
        };
        let Reply::Hello(identity) = host.order(hello).await else {
            panic!("no hello")
        };
        let Reply::Status(status) = host.order(Command::Status).await else {
            panic!("no status")
        };
        let again = host.order(start).await;
        result.set(Some((ordered_at, identity, status, again)));
    });
    sim.run_until(|| {
        let outcome = finished.take();
        let done = outcome.is_some() || now_us() > 120_000_000;
        finished.set(outcome);
        done
    });
    let (ordered_at, identity, status, again) = finished
        .take()
        .unwrap_or_else(|| panic!("{fault:?}: not finished in two minutes"));
    assert_eq!(identity.boot, expected, "{fault:?}");
    assert_eq!(status.state, State::Unhomed, "{fault:?}: {status:?}");
    assert!(!status.homed && !status.led_on && !status.press.head_clear && !status.press.go);
    assert_eq!(again, Reply::Refused(Refusal::NotConfigured), "{fault:?}");
    let after = emulated.trace().split_off(ordered_at);
    let restart = after
        .iter()
        .position(|told| told.subject == Subject::Started)
        .expect("started again");
    // Where the machine had no time for the interrupt, the watchdog reset by itself.
    let by_itself = expected == Boot::Watchdog && after[restart].value == 1;
    for output in [
        Subject::LedEnable,
        Subject::CameraTrigger,
        Subject::HeadClear1,
        Subject::HeadClear2,
    ] {
        // Dropped before the reset, not only by the start after it.
        let before = after[..restart].iter().rfind(|told| told.subject == output);
        assert!(
            by_itself || before.is_some_and(|told| told.value == 0),
            "{fault:?}: {output:?}"
        );
        let last = after.iter().rfind(|told| told.subject == output);
        assert_eq!(
            last.map(|told| told.value),
            Some(0),
            "{fault:?}: {output:?}"
        );
    }
    let causes: Vec<u16> = after
        .iter()
        .filter(|told| told.subject == Subject::Started)
        .map(|told| told.value)
        .collect();
    assert_eq!(causes.len(), 1, "{fault:?}: it started again once");
    if matches!(fault, FaultInjection::Panic | FaultInjection::Fault) {
        assert_ne!(causes, [0], "{fault:?}: line or address kept");
    }
}
