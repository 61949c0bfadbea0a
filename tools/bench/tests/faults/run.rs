//! One run: captures until the fault has shown and its end is reached.

use crate::common::{Host, Notebook, plan};
use crate::frames::{self, Received};
use crate::promises::{Injection, PressLine};
use crate::{CAPTURE_MS, PHASES};
use flankscope_bench::devices::{DeviceConfig, World, spawn_all};
use flankscope_controller::sequence::Config;
use flankscope_protocol::message::Boot;
use flankscope_protocol::*;
use flankscope_sim::{Clock, Controller, Edge, Line, PressLines, Sim, Wiring, now_us};
use rand::{Rng, RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use std::cell::{Cell, RefCell};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::rc::Rc;

/// After this the run is judged as it stands.
const PATIENCE_US: u64 = 60_000_000;

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
pub struct Record {
    pub fired_us: Option<u64>,
    pub edges: Vec<Edge>,
    pub events: Vec<Event>,
    pub resets_us: Vec<u64>,
    pub boot: Option<Boot>,
    pub vertical_mm: f64,
    pub standing: bool,
    pub captures: usize,
    pub trace: u64,
    /// The host's side of every completed capture.
    pub received: Vec<Received>,
}

pub fn run(injection: Injection, phase: u64, seed: u64) -> Record {
    let mut random = Pcg64Mcg::seed_from_u64(seed * 1_000 + phase);
    let inject_ms = (phase * CAPTURE_MS + random.random_range(0..CAPTURE_MS)) / PHASES;
    let sim = Sim::new(Clock::Stepped);
    let wiring = Rc::new(Wiring::new(&sim));
    let devices = DeviceConfig {
        seed,
        ..DeviceConfig::default()
    };
    let notebook = Notebook::default();
    let world = spawn_all(&sim, &wiring, &devices, notebook.clone());
    let controller = Controller::power_up(&sim, Rc::clone(&wiring), Config::DEFAULT);
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
        notebook.clone(),
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
    let spoil = match injection {
        Injection::Frame(fault) => fired.get().map(|at_us| (fault, at_us)),
        _ => None,
    };
    let received = frames::receive(
        &short_plan(),
        &events,
        &notebook.0.borrow().exposures,
        spoil,
        &mut Pcg64Mcg::seed_from_u64(seed),
    );
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
        received,
    }
}

/// Two views at one exposure.
fn short_plan() -> CapturePlan {
    let mut plan = plan();
    plan.views.truncate(2);
    plan.exposures.truncate(1);
    plan
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
    notebook: Notebook,
) -> (Host, Option<Boot>) {
    host.prepare(short_plan()).await;
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
                Injection::LedLost
                    if board.projectors[0].led_sense.level()
                        && board.projectors[0].led_enable.level() =>
                {
                    fire();
                    world.lit[0].set(false);
                    board.projectors[0].led_sense.set(false);
                }
                Injection::LedGhost
                    if !board.projectors[0].led_sense.level()
                        && !board.projectors[0].led_enable.level()
                        && capturing =>
                {
                    fire();
                    board.projectors[0].led_sense.set(true);
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
                Injection::CablePulled if capturing => {
                    fire();
                    dead = true;
                    host.tell_in_part(&Command::Heartbeat).await;
                }
                // The frame that is struck is the first from here on.
                Injection::Frame(_) => {
                    let notes = notebook.0.borrow();
                    let mut exposures = notes.exposures.iter();
                    if let Some(frame) = exposures.find(|frame| frame.start_us >= inject_us) {
                        fired.set(Some(frame.start_us));
                    }
                }
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
                    Injection::Noise | Injection::Echo | Injection::Stranger | Injection::Frame(_)
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
