//! Every fault at every phase of a capture, in stepped time: each run ends in its declared safe state within its
//! declared time, each injection proves that it fired, and the same seed has the same trace.
//!
//! `FAULT_SEEDS=50 cargo test -p flankscope-bench --test faults -- --nocapture` runs more of them.

mod common;

use common::{Host, Notebook, plan};
use flankscope_bench::devices::{DeviceConfig, DeviceFault, World, spawn_all};
use flankscope_controller::sequence::Config;
use flankscope_controller::stage::esp301::Axes;
use flankscope_controller::vitals::Task;
use flankscope_protocol::message::Boot;
use flankscope_protocol::*;
use flankscope_sim::{Clock, Controller, Edge, Line, PressLines, Sim, Wiring, now_us};
use rand::{Rng, RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::rc::Rc;

const PHASES: u64 = 20;
/// A capture of the campaign's plan takes about this long; phases are spread over it.
const CAPTURE_MS: u64 = 3_200;
/// After this the run is judged as it stands.
const PATIENCE_US: u64 = 60_000_000;

#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
enum PressLine {
    OpenA,
    OpenB,
    DieClear,
    Guard,
    Cycle,
}

/// What goes wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
enum Injection {
    Device(DeviceFault),
    /// The LED goes out while it should be on.
    LedLost,
    /// The LED comes on while it should be off.
    LedGhost,
    /// A line of the press goes to this level.
    Press(PressLine, bool),
    /// Both press-open channels change as when the ram closes.
    PressCloses,
    /// The retract switch stays at this level.
    Switch(bool),
    /// The host sends nothing more.
    HostDead,
    /// Junk between the host's frames.
    Noise,
    /// Every frame of the host comes three times.
    Echo,
    /// Another host's frames come in between.
    Stranger,
    /// Power fails for a moment.
    Reset,
    /// A task hangs.
    Hang(Task),
}

/// How a run must end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Safe {
    /// Dark, faulted, the head proven out.
    Retracted,
    /// As above, or, where it only disturbed a retract, overcome by trying that again.
    RetractedOrOvercome,
    /// Dark, faulted, head-clear low: the head cannot be brought out, or not be proven to be.
    Held,
    /// Restarted for this reason: dark, nothing moves, head-clear low.
    Restarted(Boot),
    /// Nothing at all: the capture is completed.
    Unharmed,
}

/// A fault with its promise: dark and safe within these times of its showing.
struct Promise {
    injection: Injection,
    safe: Safe,
    faults: &'static [Fault],
    dark_ms: u64,
    safe_ms: u64,
}

/// A retract from the lowest view: 67 mm at 100 mm/s with ramps, and its questions.
const RETRACT_MS: u64 = 1_500;

/// The contradiction's time, or what is left of one capture and that of the next.
const SWITCH_MS: u64 = CAPTURE_MS + 1_021;

fn promises() -> Vec<Promise> {
    use Injection::{
        Device, Echo, Hang, HostDead, LedGhost, LedLost, Noise, Press, PressCloses, Reset,
        Stranger, Switch,
    };
    let promise = |injection, safe, faults, dark_ms, safe_ms| Promise {
        injection,
        safe,
        faults,
        dark_ms,
        safe_ms,
    };
    let out = |injection, faults, detect_ms| {
        promise(
            injection,
            Safe::Retracted,
            faults,
            detect_ms,
            detect_ms + RETRACT_MS,
        )
    };
    let once = |injection, faults, detect_ms| {
        let safe_ms = detect_ms + RETRACT_MS;
        promise(
            injection,
            Safe::RetractedOrOvercome,
            faults,
            detect_ms,
            safe_ms,
        )
    };
    let held = |injection, faults, detect_ms, safe_ms| {
        promise(injection, Safe::Held, faults, detect_ms, safe_ms)
    };
    let timeouts = Timeouts::default();
    let ms = |time: Microseconds| u64::from(time.get()) / 1_000;
    let motion_ms = ms(timeouts.motion);
    let stuck = promise(
        Device(DeviceFault::LedStuckOn),
        Safe::Retracted,
        &[Fault::LedStuckOn],
        // The enable is low before the fault shows; the current stays, which is what is reported.
        0,
        ms(timeouts.led) + RETRACT_MS,
    );
    let mut all = vec![
        out(
            Device(DeviceFault::LedOpen),
            &[Fault::LedNotOn],
            ms(timeouts.led),
        ),
        stuck,
        out(LedLost, &[Fault::LedLost], 1),
        out(LedGhost, &[Fault::LedStuckOn], 1),
        out(
            Device(DeviceFault::DmdNotReady),
            &[Fault::DmdNotReady],
            ms(timeouts.dmd),
        ),
        out(Device(DeviceFault::DmdRefuses), &[Fault::DmdSelect], 1),
        out(Device(DeviceFault::DmdSilent), &[Fault::DmdSelect], 21),
        out(
            Device(DeviceFault::CameraNotReady),
            &[Fault::CameraNotReady],
            // After the frame it is missed at once, or at the first frame of the next capture.
            ms(timeouts.camera) + 50,
        ),
        out(
            Device(DeviceFault::CameraDeaf),
            &[Fault::CameraNoExposure],
            ms(timeouts.camera),
        ),
        out(
            Device(DeviceFault::CameraStuck),
            &[Fault::CameraStuck],
            ms(timeouts.camera),
        ),
        // The head comes out, but the stages never say that they stand: not proven.
        held(
            Device(DeviceFault::RotationStalls),
            &[Fault::MotionTimeout, Fault::RetractFailed],
            motion_ms,
            motion_ms + 5_100,
        ),
        held(
            Device(DeviceFault::VerticalStalls),
            &[
                Fault::MotionTimeout,
                Fault::RetractFailed,
                Fault::HeadSwitch,
            ],
            motion_ms,
            motion_ms + 5_100,
        ),
        held(
            Device(DeviceFault::StageSilent),
            &[Fault::StageSilent, Fault::RetractFailed, Fault::HeadSwitch],
            250,
            6_000,
        ),
        once(Device(DeviceFault::StageGarbage), &[Fault::StageReply], 250),
        once(
            Device(DeviceFault::StageLate),
            &[Fault::StageSilent, Fault::StageReply],
            600,
        ),
        once(Device(DeviceFault::StageError), &[Fault::StageError], 250),
        once(Device(DeviceFault::StageBeside), &[Fault::OffPosition], 250),
        out(
            Press(PressLine::OpenA, false),
            &[Fault::PressNotOpen, Fault::PressSignal],
            21,
        ),
        out(
            Press(PressLine::OpenB, true),
            &[Fault::PressNotOpen, Fault::PressSignal],
            21,
        ),
        out(PressCloses, &[Fault::PressNotOpen], 21),
        out(Press(PressLine::DieClear, false), &[Fault::DieNotClear], 21),
        out(Press(PressLine::Guard, false), &[Fault::GuardOpen], 21),
        out(Press(PressLine::Cycle, true), &[Fault::PressCycled], 21),
        promise(
            // Late in a capture it is not contradicted for long enough: seen in the next.
            Switch(true),
            Safe::Retracted,
            &[Fault::HeadSwitch],
            SWITCH_MS,
            SWITCH_MS + RETRACT_MS,
        ),
        // Nobody knows before the head is back that the switch does not say so.
        held(
            Switch(false),
            &[Fault::HeadSwitch, Fault::RetractFailed],
            6_100,
            6_100 + RETRACT_MS,
        ),
        out(HostDead, &[Fault::HostSilent], 121),
        promise(Noise, Safe::Unharmed, &[], 0, 0),
        promise(Echo, Safe::Unharmed, &[], 0, 0),
        promise(Stranger, Safe::Unharmed, &[], 0, 0),
        promise(Reset, Safe::Restarted(Boot::Requested), &[], 0, 150),
    ];
    for task in Task::ALL {
        all.push(promise(
            Hang(task),
            Safe::Restarted(Boot::Watchdog),
            &[],
            300,
            450,
        ));
    }
    all
}

fn line(press: &PressLines, line: PressLine) -> &Line {
    match line {
        PressLine::OpenA => &press.press_open_a,
        PressLine::OpenB => &press.press_open_b,
        PressLine::DieClear => &press.die_clear,
        PressLine::Guard => &press.guard_closed,
        PressLine::Cycle => &press.cycle,
    }
}

/// What a run left behind.
struct Record {
    fired_us: Option<u64>,
    edges: Vec<Edge>,
    events: Vec<Event>,
    resets_us: Vec<u64>,
    boot: Option<Boot>,
    vertical_mm: f64,
    standing: bool,
    captures: usize,
    trace: u64,
}

fn run(injection: Injection, phase: u64, seed: u64) -> Record {
    let mut random = Pcg64Mcg::seed_from_u64(seed * 1_000 + phase);
    let inject_ms = (phase * CAPTURE_MS + random.random_range(0..CAPTURE_MS)) / PHASES;
    let sim = Sim::new(Clock::Stepped);
    let wiring = Rc::new(Wiring::new(&sim));
    let devices = DeviceConfig {
        seed,
        ..DeviceConfig::default()
    };
    let world = spawn_all(&sim, &wiring, &devices, Notebook::default());
    let controller = Controller::power_up(&sim, Rc::clone(&wiring), Config::DEFAULT, Axes::DEFAULT);
    let finished = Rc::new(RefCell::new(None));
    let fired = Rc::new(Cell::new(None));
    let host = Host::new(wiring.host.clone());
    let script = script(
        host,
        Rc::clone(&wiring),
        Rc::clone(&world),
        controller.clone(),
        injection,
        inject_ms,
        random,
        Rc::clone(&fired),
    );
    let result = Rc::clone(&finished);
    sim.spawn(async move {
        let end = script.await;
        *result.borrow_mut() = Some(end);
    });
    sim.run_until(|| finished.borrow().is_some() || now_us() > 2 * PATIENCE_US);
    let (host, boot) = finished
        .take()
        .unwrap_or_else(|| panic!("{injection:?} at {inject_ms} ms hangs"));
    let events: Vec<Event> = host.events.into_iter().map(|(_, event)| event).collect();
    let edges = sim.edges();
    let mut hasher = DefaultHasher::new();
    for edge in &edges {
        (edge.at_us, edge.line, edge.level).hash(&mut hasher);
    }
    format!("{events:?}").hash(&mut hasher);
    let (now, end) = (
        world.stage.borrow().true_pose(now_us()),
        world.stage.borrow().true_destination(),
    );
    let done = |event: &&Event| matches!(event, Event::CaptureDone { .. });
    Record {
        fired_us: fired.get().or(world.faults.fired_us()),
        captures: events.iter().filter(done).count(),
        edges,
        events,
        resets_us: controller.resets_us(),
        boot,
        vertical_mm: now.vertical_mm,
        standing: now == end,
        trace: hasher.finish(),
    }
}

/// Captures until the fault has shown and its end is reached.
#[allow(clippy::too_many_arguments)]
async fn script(
    mut host: Host,
    wiring: Rc<Wiring>,
    world: Rc<World>,
    controller: Controller,
    injection: Injection,
    inject_ms: u64,
    mut random: Pcg64Mcg,
    fired: Rc<Cell<Option<u64>>>,
) -> (Host, Option<Boot>) {
    let mut plan = plan();
    plan.views.truncate(2);
    plan.exposures.truncate(1);
    host.prepare(plan).await;
    let start = Command::Start { session: 5 };
    assert_eq!(host.order(start.clone()).await, Reply::Accepted);
    let inject_us = now_us() + inject_ms * 1_000;
    let (mut injected, mut dead) = (false, false);
    let fire = || {
        if fired.get().is_none() {
            fired.set(Some(now_us()));
        }
    };
    let mut restart_us = None;
    while now_us() < PATIENCE_US {
        if !injected && now_us() >= inject_us {
            injected = true;
            match injection {
                Injection::Device(fault) => world.faults.give(fault),
                Injection::Reset => {
                    fire();
                    controller.reset(Boot::Requested);
                }
                Injection::Hang(task) => {
                    fire();
                    controller.hang(task);
                }
                Injection::HostDead => dead = true,
                Injection::Switch(made) => world.switch_stuck.set(Some(made)),
                _ => {}
            }
        }
        let capturing = capturing(&host);
        // What needs its moment waits for it.
        if injected && fired.get().is_none() {
            let board = &wiring.board;
            match injection {
                Injection::LedLost if board.led_sense.level() && board.led_enable.level() => {
                    fire();
                    world.lit.set(false);
                    board.led_sense.set(false);
                }
                Injection::LedGhost
                    if !board.led_sense.level() && !board.led_enable.level() && capturing =>
                {
                    fire();
                    board.led_sense.set(true);
                }
                Injection::Press(which, level) if capturing => {
                    fire();
                    line(&board.press, which).set(level);
                }
                Injection::PressCloses if capturing => {
                    fire();
                    board.press.press_open_a.set(false);
                    board.press.press_open_b.set(true);
                }
                Injection::HostDead if capturing => fire(),
                // Wrong from when the head is on the other side of it.
                Injection::Switch(true)
                    if capturing && world.stage.borrow().true_pose(now_us()).vertical_mm < 79.0 =>
                {
                    fire();
                    board.press.retract_switch.set(true);
                }
                Injection::Switch(false)
                    if world.stage.borrow().true_pose(now_us()).vertical_mm < 79.0
                        || !board.press.retract_switch.level() =>
                {
                    fire()
                }
                Injection::Noise | Injection::Echo | Injection::Stranger => fire(),
                _ => {}
            }
        }
        if injected {
            match injection {
                Injection::Noise => {
                    let mut junk = vec![0; random.random_range(1..200)];
                    random.fill_bytes(&mut junk);
                    host.scribble(&junk);
                }
                Injection::Stranger => {
                    host.send(0x0BAD, 1, &Command::Abort).await;
                    host.send(0x0BAD, 2, &Command::Retract).await;
                }
                _ => {}
            }
        }
        if !(dead && capturing) {
            host.tell(&Command::Heartbeat).await;
            if injection == Injection::Echo && injected {
                host.repeat(&Command::Heartbeat, 2).await;
            }
        }
        host.listen(10 + (now_us() / 10) % 3).await;
        if controller.resets_us().len() == 1 && restart_us.is_none() {
            restart_us = Some(now_us());
        }
        if let Some(since) = restart_us {
            if now_us() > since + 500_000 {
                host.forget();
                let hello = Command::Hello {
                    protocol: PROTOCOL_VERSION,
                    schema: SCHEMA_HASH,
                };
                let Reply::Hello(identity) = host.order(hello).await else {
                    panic!("no hello after a restart")
                };
                return (host, Some(identity.boot));
            }
            continue;
        }
        match host.events.iter().rev().find_map(|(_, event)| match event {
            Event::StateChanged { next, .. } => Some(*next),
            _ => None,
        }) {
            // A hung task may be missed by others before the watchdog bites.
            Some(State::Faulted) if !matches!(injection, Injection::Hang(_) | Injection::Reset) => {
                // What the controller says last, and the interlock's own patience with the head.
                host.listen(6_500).await;
                return (host, None);
            }
            Some(State::Ready) => {
                let unharmed = matches!(
                    injection,
                    Injection::Noise | Injection::Echo | Injection::Stranger
                );
                let over = fired.get().or(world.faults.fired_us());
                // What is over did no lasting harm if the instrument is ready.
                let once = matches!(injection, Injection::Device(fault) if fault.once());
                if (unharmed || once) && over.is_some() {
                    return (host, None);
                }
                host.tell(&start).await;
                host.listen(5).await;
            }
            _ => {}
        }
    }
    (host, None)
}

fn capturing(host: &Host) -> bool {
    let last = host.events.iter().rev().find_map(|(_, event)| match event {
        Event::StateChanged { next, .. } => Some(*next),
        _ => None,
    });
    matches!(
        last,
        Some(
            State::Claiming
                | State::Moving
                | State::Settling
                | State::Lighting
                | State::Capturing
                | State::Darkening
        )
    )
}

fn unfaulted(record: &Record) -> bool {
    !record
        .events
        .iter()
        .any(|event| matches!(event, Event::Fault { .. }))
}

/// What the run did not keep of its promise.
fn broken(promise: &Promise, record: &Record) -> Option<String> {
    let Some(fired_us) = record.fired_us else {
        return Some("never fired".into());
    };
    let level_at_end = |line: &str| {
        let mut edges = record.edges.iter();
        edges
            .rfind(|edge| edge.line == line)
            .is_some_and(|edge| edge.level)
    };
    for line in ["led_enable", "camera_trigger", "dmd_trigger"] {
        if level_at_end(line) {
            return Some(format!("{line} stays high"));
        }
    }
    // Enabled at some time after the fault had its time: not dark.
    let limit_us = fired_us + promise.dark_ms * 1_000;
    let mut lit = false;
    if promise.safe != Safe::Unharmed
        && !(promise.safe == Safe::RetractedOrOvercome && unfaulted(record))
    {
        for edge in record.edges.iter().filter(|edge| edge.line == "led_enable") {
            if edge.at_us > limit_us && (lit || edge.level) {
                return Some(format!(
                    "LED switched {} us after its limit",
                    edge.at_us - limit_us
                ));
            }
            lit = edge.level;
        }
    }
    let first = record.events.iter().find_map(|event| match event {
        Event::Fault { fault, .. } if fault.0 < 96 => fault.known(),
        _ => None,
    });
    let safe_at = record.events.iter().rev().find_map(|event| match event {
        Event::StateChanged {
            next: State::Faulted,
            at,
            ..
        } => Some(at.get()),
        _ => None,
    });
    let (both, out) = (
        (level_at_end("head_clear_1"), level_at_end("head_clear_2")),
        record.vertical_mm >= 79.9 && record.standing,
    );
    let overcome = promise.safe == Safe::RetractedOrOvercome && first.is_none();
    match promise.safe {
        _ if overcome => {
            if record.captures == 0 || !out {
                return Some("neither faulted nor overcome".into());
            }
        }
        Safe::Unharmed => {
            if let Some(fault) = first {
                return Some(format!("harmed: {fault}"));
            }
            if record.captures == 0 {
                return Some("no capture was completed".into());
            }
        }
        Safe::Restarted(want) => {
            if record.boot != Some(want) {
                return Some(format!("says {:?} after the restart", record.boot));
            }
            if record.resets_us.len() != 1
                || record.resets_us[0] > fired_us + promise.safe_ms * 1_000
            {
                return Some(format!(
                    "resets at {:?}, fired at {fired_us}",
                    record.resets_us
                ));
            }
            if both != (false, false) || !record.standing {
                return Some(format!("head-clear {both:?}, standing {}", record.standing));
            }
        }
        Safe::Retracted | Safe::RetractedOrOvercome | Safe::Held => {
            if !first.is_some_and(|fault| promise.faults.contains(&fault)) {
                return Some(format!("first fault {first:?}"));
            }
            match safe_at {
                None => return Some("never faulted".into()),
                Some(at) if at > fired_us + promise.safe_ms * 1_000 => {
                    return Some(format!(
                        "safe {} ms after the fault",
                        (at - fired_us) / 1_000
                    ));
                }
                Some(_) => {}
            }
            if promise.safe != Safe::Held && !out {
                return Some(format!("the head stands at {} mm", record.vertical_mm));
            }
            if promise.safe == Safe::Held && both != (false, false) {
                return Some("head-clear although the head is not proven out".into());
            }
        }
    }
    // Always: both channels alike, and never high while the head is not proven out.
    if both.0 != both.1 || (both.0 && !out) {
        return Some(format!(
            "head-clear {both:?} with the head at {} mm",
            record.vertical_mm
        ));
    }
    None
}

#[test]
fn every_fault_at_every_phase_ends_in_its_safe_state_in_time() {
    let seeds = std::env::var("FAULT_SEEDS")
        .ok()
        .and_then(|text| text.parse().ok())
        .unwrap_or(5u64);
    let promises = promises();
    let mut failures: BTreeMap<String, u32> = BTreeMap::new();
    let mut runs = 0;
    for promise in &promises {
        for phase in 0..PHASES {
            for seed in 0..seeds {
                runs += 1;
                let record = run(promise.injection, phase, seed);
                if let Some(what) = broken(promise, &record) {
                    println!("{:?} phase {phase} seed {seed}: {what}", promise.injection);
                    *failures
                        .entry(format!("{:?}", promise.injection))
                        .or_default() += 1;
                }
            }
        }
    }
    println!(
        "{} faults x {PHASES} phases x {seeds} seeds = {runs} runs",
        promises.len()
    );
    assert_eq!(failures, BTreeMap::new());
}

#[test]
fn the_same_seed_has_the_same_trace() {
    let mut seeds_differ = 0;
    let promises = promises();
    for promise in &promises {
        let trace = |seed| run(promise.injection, 7, seed).trace;
        let first = trace(3);
        assert_eq!(trace(3), first, "{:?}", promise.injection);
        seeds_differ += usize::from(trace(4) != first);
    }
    // A fault that waits for its occasion may show at the same time whatever the seed; most do not.
    assert!(seeds_differ > promises.len() / 3, "{seeds_differ}");
}
