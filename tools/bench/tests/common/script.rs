//! A host's script in stepped time, against a controller and its devices: orders in, pin edges, exposures and events out.

use super::{Host, Notebook, Notes};
use flankscope_bench::devices::{DeviceConfig, DeviceFault, TruePose, World, spawn_all};
use flankscope_controller::sequence::Config;
use flankscope_protocol::*;
use flankscope_sim::{Board, Clock, Edge, Sim, Wiring, now_us, spawn_controller};
use std::cell::RefCell;
use std::rc::Rc;

/// A script that waits for what never comes would keep the controller company for ever.
const LONGEST_US: u64 = 600_000_000;

/// What a script runs against.
#[derive(Default)]
pub struct Setup {
    pub devices: DeviceConfig,
    /// The controller's own, where it is another than its default.
    pub controller: Option<Config>,
    /// How the stage controller's port is set, where it is otherwise than the controller's.
    pub stage_line: Option<Line>,
}

impl From<DeviceConfig> for Setup {
    fn from(devices: DeviceConfig) -> Self {
        Self {
            devices,
            ..Self::default()
        }
    }
}

/// What a script can reach beside its host.
pub struct Hands {
    pub board: Board,
    pub world: Rc<World>,
}

/// What a script leaves behind.
pub struct Record {
    pub edges: Vec<Edge>,
    pub notes: Notes,
    /// Every event received.
    pub events: Vec<Event>,
    /// Their sequence numbers.
    pub numbers: Vec<u16>,
    pub end_us: u64,
    /// Where the stages stand at the end.
    pub pose: TruePose,
}

impl Record {
    /// When a line went to this level, us.
    pub fn times(&self, line: &str, level: bool) -> Vec<u64> {
        let edges = self.edges.iter();
        edges
            .filter(|edge| edge.line == line && edge.level == level)
            .map(|edge| edge.at_us)
            .collect()
    }

    /// Faults that were told, with their detail.
    pub fn faults(&self) -> Vec<(Fault, u32)> {
        let known = self.events.iter().filter_map(|event| match event {
            Event::Fault { fault, detail, .. } => fault.known().zip(Some(*detail)),
            _ => None,
        });
        known.collect()
    }
}

/// Runs a host's script against controller and devices until it ends.
pub fn run<F: Future<Output = Host> + 'static>(
    setup: impl Into<Setup>,
    script: impl FnOnce(Host, Hands) -> F,
) -> Record {
    let setup = setup.into();
    let sim = Sim::new(Clock::Stepped);
    let wiring = Wiring::new(&sim);
    if let Some(line) = setup.stage_line {
        wiring.stage.set(line);
    }
    let notebook = Notebook::default();
    let world = spawn_all(&sim, &wiring, &setup.devices, notebook.clone());
    let config = setup.controller.unwrap_or(Config::DEFAULT);
    spawn_controller(&sim, &wiring, config);
    let hands = Hands {
        board: wiring.board.clone(),
        world: Rc::clone(&world),
    };
    let script = script(Host::new(wiring.host.clone()), hands);
    let finished = Rc::new(RefCell::new(None));
    let result = Rc::clone(&finished);
    sim.spawn(async move { *result.borrow_mut() = Some(script.await) });
    sim.run_until(|| finished.borrow().is_some() || now_us() > LONGEST_US);
    let host = finished.take().expect("the script came to its end");
    let (numbers, events) = host.events.into_iter().unzip();
    let pose = world.stage.borrow().true_pose(now_us());
    Record {
        edges: sim.edges(),
        notes: notebook.0.borrow().clone(),
        events,
        numbers,
        end_us: now_us(),
        pose,
    }
}

/// Runs a plan until the head retracts; the fault is given at the first event that `spoils`.
pub fn capture_until_retract(
    devices: DeviceConfig,
    plan: CapturePlan,
    spoils: fn(&Event) -> bool,
    fault: Option<DeviceFault>,
) -> Record {
    run(devices, |mut host, hands| async move {
        let session = plan.session;
        host.prepare(plan).await;
        let start = Command::Start { session };
        assert_eq!(host.order(start).await, Reply::Accepted);
        if let Some(fault) = fault {
            host.until(spoils).await;
            hands.world.faults.give(fault);
        }
        host.until(|event| {
            let Event::StateChanged { prev, .. } = event else {
                return false;
            };
            *prev == State::Retracting
        })
        .await;
        host
    })
}
