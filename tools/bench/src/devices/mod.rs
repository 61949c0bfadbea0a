//! The devices around the controller, each a task in virtual time on the simulator's executor.
//!
//! ```text
//!  controller ──led_enable──► led ──led_sense──►            host     an LED and a DMD for each projector
//!             ──pattern bus, dmd_trigger──► dmd ──ready──►   │ pseudo-terminal
//!             ──camera_trigger──► camera ──ready, exposing──►│
//!             ──I2C──► lens driver                           │
//!             ◄──UART, ESP301 text──► stage                  ▼
//!             ◄──press open, guard, ..──► press ◄──head clear
//!                                     camera ──► ExposureSink: what was exposed, under which pattern, at which pose
//! ```
//! The models share only the state that light and mechanics carry between them: [`World`].

pub mod axis;
pub mod camera;
pub mod dmd;
pub mod esp301;
pub mod faults;
pub mod instrument;
pub mod led;
pub mod max14574;
pub mod motion;
pub mod press;
pub mod stage;

pub use axis::AxisModel;
pub use camera::{CameraTiming, Exposure, ExposureSink, Lost};
pub use dmd::DmdTiming;
pub use faults::{DeviceFault, Faults};
pub use instrument::{Controller, Instrument, InstrumentConfig, Outcome, run, run_with};
pub use led::LedTiming;
pub use press::PressModel;
pub use stage::{StageModel, TruePose};

use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use embassy_sync::signal::Signal;
use flankscope_protocol::Projector;
use flankscope_sim::{Sim, Wiring};
use std::cell::{Cell, RefCell};
use std::rc::Rc;

/// State that light and mechanics carry between the devices.
pub struct World {
    /// DMD pattern index displayed by each projector: 0 is black.
    pub displayed: [Cell<u16>; 2],
    /// Whether each projector's LED emits light.
    pub lit: [Cell<bool>; 2],
    /// True state of both axes.
    pub stage: RefCell<StageModel>,
    /// Injected faults.
    pub faults: Faults,
    /// Fixed state of the retract switch, independent of the stage (fault).
    pub switch_stuck: Cell<Option<bool>>,
    /// Signals that a stage has a new trajectory.
    course: Signal<NoopRawMutex, ()>,
}

/// How the devices behave.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct DeviceConfig {
    /// LED driver.
    pub led: LedTiming,
    /// DMD controller.
    pub dmd: DmdTiming,
    pub camera: CameraTiming,
    /// Both axes.
    pub axes: stage::AxisModels,
    /// Press around the die.
    pub press: PressModel,
    /// Whether the head has a liquid lens, and the controller a driver for it.
    pub lens: bool,
    /// Whether the head has a second projector, and the controller its light engine.
    pub second_projector: bool,
    /// Seed of the stage errors.
    pub seed: u64,
}

/// Connects all devices to the controller's pins.
pub fn spawn_all(
    sim: &Sim,
    wiring: &Wiring,
    config: &DeviceConfig,
    sink: impl ExposureSink + 'static,
) -> Rc<World> {
    let world = Rc::new(World {
        displayed: Default::default(),
        lit: Default::default(),
        stage: RefCell::new(StageModel::new(config.axes, config.seed)),
        faults: Faults::default(),
        switch_stuck: Cell::new(None),
        course: Signal::new(),
    });
    let sink = Rc::new(RefCell::new(sink));
    let board = || wiring.board.clone();
    if config.lens {
        let (troubled, focused) = (Rc::clone(&world), Rc::clone(&sink));
        let chip = max14574::Chip::new(
            move |fault| troubled.faults.spoils(fault),
            move |counts| focused.borrow_mut().focused(counts),
        );
        wiring.board.lens_bus.attach(max14574::ADDRESS, chip);
    }
    wiring.board.second_fitted.set(config.second_projector);
    let fitted = 1 + usize::from(config.second_projector);
    for (of, lines) in Projector::ALL
        .into_iter()
        .zip(board().projectors)
        .take(fitted)
    {
        let world = || Rc::clone(&world);
        sim.spawn(led::run(lines.clone(), of, config.led, world()));
        sim.spawn(dmd::run(lines, of, config.dmd, world()));
    }
    sim.spawn(camera::run(
        board(),
        config.camera,
        Rc::clone(&world),
        Rc::clone(&sink),
    ));
    sim.spawn(press::ram(board(), config.press, Rc::clone(&sink)));
    sim.spawn(press::retract_switch(
        board(),
        config.press,
        Rc::clone(&world),
    ));
    sim.spawn(stage::run(wiring.stage.clone(), Rc::clone(&world), sink));
    world
}
