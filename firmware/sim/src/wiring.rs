//! All lines and ports between the controller and the devices around it, and the controller on its side of them.

use crate::clock::Transaction;
use crate::executor::Sim;
use crate::i2c::I2cBus;
use crate::line::Line;
use crate::uart::Port;
use core::cell::Cell;
use core::pin::Pin;
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use embassy_sync::channel::Channel;
use flankscope_controller::devices::{
    CurrentSetting, NotSelected, PatternPort, PinCamera, PinDmd, PinLed,
};
use flankscope_controller::lens::{Lens, LensFault};
use flankscope_controller::liveness::Task;
use flankscope_controller::max14574::Max14574;
use flankscope_controller::stage::esp301::Esp301;
use flankscope_controller::{
    CommandHandler, LightEngine, Mailboxes, Optics, PinPress, Sequence, link, press_sequencer,
    sequence, serve_stage,
};
use flankscope_protocol::message::Boot;
use flankscope_protocol::{LensCounts, Milliamps};
use std::rc::Rc;

/// The lens driver's outputs that have a lens: the camera's on the first, the projector's on the second.
const LENS_OUTPUTS: u8 = 0b0011;

/// The LED's current setting, a converter's output in real life.
#[derive(Debug, Clone, Default)]
pub struct CurrentCell(Rc<Cell<u16>>);

impl CurrentCell {
    /// The current set.
    pub fn get(&self) -> Milliamps {
        Milliamps(self.0.get())
    }
}

impl CurrentSetting for CurrentCell {
    fn set(&mut self, current: Milliamps) {
        self.0.set(current.get());
    }
}

/// A lens driver; whatever it is asked to do is one transaction.
struct DrivenLens(Max14574<I2cBus>);

impl Lens for DrivenLens {
    async fn off(&mut self) -> bool {
        let _transaction = Transaction::begin();
        self.0.off().await
    }
    async fn set(&mut self, counts: LensCounts) -> Result<(), LensFault> {
        let _transaction = Transaction::begin();
        self.0.set(counts).await
    }
    async fn check(&mut self, counts: LensCounts) -> Result<(), LensFault> {
        let _transaction = Transaction::begin();
        self.0.check(counts).await
    }
}

type Exchange<T> = Rc<Channel<NoopRawMutex, T, 1>>;

/// The bus over which the controller selects a pattern. Clones are the same bus.
#[derive(Clone)]
pub struct PatternBus {
    requests: Exchange<u16>,
    answers: Exchange<bool>,
}

impl PatternBus {
    fn new() -> Self {
        Self {
            requests: Rc::new(Channel::new()),
            answers: Rc::new(Channel::new()),
        }
    }

    /// Device side: the next pattern asked for.
    pub async fn requested(&self) -> u16 {
        self.requests.receive().await
    }

    /// Device side: takes the selection, or refuses it.
    pub fn answer(&self, taken: bool) {
        self.answers.clear();
        let _room = self.answers.try_send(taken);
    }
}

impl PatternPort for PatternBus {
    async fn select(&mut self, pattern: u16) -> Result<(), NotSelected> {
        let _transaction = Transaction::begin();
        // What is left of a transaction that was given up.
        self.requests.clear();
        self.answers.clear();
        self.requests.send(pattern).await;
        if self.answers.receive().await {
            Ok(())
        } else {
            Err(NotSelected)
        }
    }
}

#[derive(Clone)]
pub struct ProjectorLines {
    /// Controller -> LED driver.
    pub led_enable: Line,
    /// LED driver -> controller: current flows.
    pub led_sense: Line,
    /// Controller -> LED driver.
    pub led_current: CurrentCell,
    /// Controller -> DMD.
    pub dmd_trigger: Line,
    /// DMD -> controller: the selected pattern stands.
    pub dmd_ready: Line,
    /// Controller <-> DMD.
    pub pattern_bus: PatternBus,
}

/// Every line once. Both sides hold a clone.
#[derive(Clone)]
pub struct Board {
    /// LED driver and DMD of each projector.
    pub projectors: [ProjectorLines; 2],
    /// High where the second projector is plugged in.
    pub second_fitted: Line,
    /// Controller -> camera: exposed while high.
    pub camera_trigger: Line,
    /// Camera -> controller: a trigger would be obeyed.
    pub camera_ready: Line,
    /// Camera -> controller: strobe.
    pub camera_exposing: Line,
    /// Controller <-> liquid lens driver, where one is attached.
    pub lens_bus: I2cBus,
    /// Press <-> controller.
    pub press: PressLines,
}

/// The press's lines; [`flankscope_controller::press`] has their meanings.
#[derive(Clone)]
pub struct PressLines {
    pub press_open_a: Line,
    pub press_open_b: Line,
    pub die_clear: Line,
    pub guard_closed: Line,
    pub cycle: Line,
    pub retract_switch: Line,
    pub head_clear_1: Line,
    pub head_clear_2: Line,
    pub go: Line,
    pub no_go: Line,
    pub beat: Line,
}

impl Board {
    /// What the pins do when the controller is reset: its outputs fall.
    pub(crate) fn release_outputs(&self) {
        let press = &self.press;
        for lines in &self.projectors {
            lines.led_enable.set(false);
            lines.dmd_trigger.set(false);
        }
        for line in [
            &self.camera_trigger,
            &press.head_clear_1,
            &press.head_clear_2,
            &press.go,
            &press.no_go,
            &press.beat,
        ] {
            line.set(false);
        }
    }
}

/// What the lines of a projector are called.
const PROJECTOR_LINES: [[&str; 4]; 2] = [
    ["led_enable", "led_sense", "dmd_trigger", "dmd_ready"],
    [
        "led_enable_2",
        "led_sense_2",
        "dmd_trigger_2",
        "dmd_ready_2",
    ],
];

impl ProjectorLines {
    fn new(sim: &Sim, names: [&'static str; 4]) -> Self {
        let [led_enable, led_sense, dmd_trigger, dmd_ready] = names.map(|name| sim.line(name));
        Self {
            led_enable,
            led_sense,
            led_current: CurrentCell::default(),
            dmd_trigger,
            dmd_ready,
            pattern_bus: PatternBus::new(),
        }
    }

    fn pins(self) -> Engine {
        LightEngine {
            led: PinLed {
                enable: self.led_enable,
                sense: self.led_sense,
                current: self.led_current,
            },
            dmd: PinDmd {
                trigger: self.dmd_trigger,
                ready: self.dmd_ready,
                port: self.pattern_bus,
            },
        }
    }
}

type Engine = LightEngine<PinLed<Line, Line, CurrentCell>, PinDmd<Line, Line, PatternBus>>;

impl PressLines {
    fn new(sim: &Sim) -> Self {
        Self {
            press_open_a: sim.line("press_open_a"),
            press_open_b: sim.line("press_open_b"),
            die_clear: sim.line("die_clear"),
            guard_closed: sim.line("guard_closed"),
            cycle: sim.line("cycle"),
            retract_switch: sim.line("retract_switch"),
            head_clear_1: sim.line("head_clear_1"),
            head_clear_2: sim.line("head_clear_2"),
            go: sim.line("go"),
            no_go: sim.line("no_go"),
            beat: sim.line("beat"),
        }
    }

    fn pins(self) -> PinPress<Line, Line> {
        PinPress {
            press_open_a: self.press_open_a,
            press_open_b: self.press_open_b,
            die_clear: self.die_clear,
            guard_closed: self.guard_closed,
            cycle: self.cycle,
            retract_switch: self.retract_switch,
            head_clear: [self.head_clear_1, self.head_clear_2],
            go: self.go,
            no_go: self.no_go,
            beat: self.beat,
        }
    }
}

/// The board and both ends of its two UARTs.
pub struct Wiring {
    /// Lines.
    pub board: Board,
    /// The host's end of the link.
    pub host: Port,
    /// The stage controller's end of its UART.
    pub stage: Port,
    /// The controller's end of the link.
    pub controller_link: Port,
    /// The controller's end of the stages' UART.
    pub controller_stage: Port,
}

impl Wiring {
    /// All lines low, all ports empty.
    #[must_use]
    pub fn new(sim: &Sim) -> Self {
        let (host, controller_link) = Port::pair();
        let (stage, controller_stage) = Port::pair();
        let board = Board {
            projectors: PROJECTOR_LINES.map(|names| ProjectorLines::new(sim, names)),
            second_fitted: sim.line("second_fitted"),
            camera_trigger: sim.line("camera_trigger"),
            camera_ready: sim.line("camera_ready"),
            camera_exposing: sim.line("camera_exposing"),
            lens_bus: I2cBus::default(),
            press: PressLines::new(sim),
        };
        Self {
            board,
            host,
            stage,
            controller_link,
            controller_stage,
        }
    }
}

/// Puts the controller on its side of the wiring, without a watchdog.
pub fn spawn_controller(sim: &Sim, wiring: &Wiring, config: sequence::Config) {
    let mail: &'static Mailboxes = Box::leak(Box::default());
    for (_, task) in tasks(wiring, config, Boot::PowerUp, mail) {
        sim.spawn(task);
    }
}

/// The tasks of a controller that has just started.
pub(crate) fn tasks(
    wiring: &Wiring,
    config: sequence::Config,
    boot: Boot,
    mail: &'static Mailboxes,
) -> [(Task, BoxedTask); 4] {
    let board = wiring.board.clone();
    let [first, second] = board.projectors.map(ProjectorLines::pins);
    let optics = Optics {
        first,
        second: board.second_fitted.level().then_some(second),
        camera: PinCamera {
            trigger: board.camera_trigger,
            ready: board.camera_ready,
            exposing: board.camera_exposing,
        },
        lens: DrivenLens(Max14574::new(board.lens_bus, LENS_OUTPUTS)),
    };
    let press = board.press.pins();
    let handler = CommandHandler::new(Sequence::new(config), boot);
    let stages = Esp301::new(wiring.controller_stage.clone());
    let (rx, tx) = (
        wiring.controller_link.clone(),
        wiring.controller_link.clone(),
    );
    [
        (
            Task::Receive,
            Box::pin(async move { link::receive(rx, mail).await }),
        ),
        (
            Task::Transmit,
            Box::pin(async move { link::transmit(tx, mail).await }),
        ),
        (
            Task::Stage,
            Box::pin(async move { serve_stage(stages, mail).await }),
        ),
        (
            Task::Sequencer,
            Box::pin(async move { press_sequencer(handler, optics, press, mail).await }),
        ),
    ]
}

/// A task before it is spawned.
pub(crate) type BoxedTask = Pin<Box<dyn Future<Output = ()>>>;
