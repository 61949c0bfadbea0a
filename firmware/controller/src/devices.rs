//! What the controller needs of LED, DMD, camera and lens, and the plain-pin versions of them.
//!
//! | line             | direction | meaning                                                                    |
//! |------------------|-----------|----------------------------------------------------------------------------|
//! | LED enable       | out       | high = current flows                                                       |
//! | LED sense        | in        | high = current is flowing                                                  |
//! | DMD trigger      | out       | rising edge = show the selected pattern                                    |
//! | DMD ready        | in        | high = the selected pattern stands; low from its selection on              |
//! | camera trigger   | out       | trigger-width mode: exposed while high                                     |
//! | camera ready     | in        | high = a trigger would be obeyed                                           |
//! | camera exposing  | in        | high while the sensor is exposed (strobe)                                  |
//!
//! All inputs are levels, never edges, so a wait may be dropped and begun again without losing anything.

use crate::sequence::{Awaiting, CameraWait, Input};
use core::convert::Infallible;
use core::future::pending;
use embassy_futures::select::{Either3, select3};
use embedded_hal::digital::{OutputPin, PinState};
use embedded_hal_async::digital::Wait;
use flankscope_protocol::Milliamps;

/// The LED driver.
pub trait Led {
    /// Enables the LED at this current.
    fn on(&mut self, current: Milliamps);
    /// Disables the LED.
    fn off(&mut self);
    /// Completes when the current sense has this level.
    async fn sense(&mut self, level: bool);
}

/// The DMD refused to select a pattern.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NotSelected;

/// The DMD controller.
pub trait Dmd {
    /// Selects the pattern that the next trigger shows, and makes ready fall: 0 is black.
    async fn select(&mut self, pattern: u16) -> Result<(), NotSelected>;
    /// Drives the trigger; its rising edge shows the selected pattern.
    fn trigger(&mut self, level: bool);
    /// Completes when ready is high.
    async fn ready(&mut self);
}

/// The camera, in trigger-width mode.
pub trait Camera {
    /// Drives the trigger; exposed while high.
    fn trigger(&mut self, level: bool);
    /// Completes when the line awaited has its level.
    async fn wait(&mut self, what: CameraWait);
}

/// All devices that work with light.
#[derive(Debug)]
pub struct Optics<L, D, C, N> {
    /// The LED.
    pub led: L,
    /// The DMD.
    pub dmd: D,
    /// The camera.
    pub camera: C,
    /// The liquid lens.
    pub lens: N,
}

impl<L: Led, D: Dmd, C: Camera, N> Optics<L, D, C, N> {
    /// Completes when a line awaited has its level. May be dropped at any time.
    pub async fn wait(&mut self, awaiting: Awaiting) -> Input {
        let Self {
            led, dmd, camera, ..
        } = self;
        let led = async {
            match awaiting.led_sense {
                Some(level) => {
                    led.sense(level).await;
                    Input::LedSense(level)
                }
                None => pending().await,
            }
        };
        let dmd = async {
            if !awaiting.dmd_ready {
                pending::<()>().await;
            }
            dmd.ready().await;
            Input::DmdReady
        };
        let camera = async {
            let Some(what) = awaiting.camera else {
                return pending().await;
            };
            camera.wait(what).await;
            match what {
                CameraWait::Ready => Input::CameraReady,
                CameraWait::Exposing(level) => Input::CameraExposing(level),
            }
        };
        match select3(led, dmd, camera).await {
            Either3::First(input) | Either3::Second(input) | Either3::Third(input) => input,
        }
    }
}

/// Selects patterns over whatever bus the DMD controller is on.
pub trait PatternPort {
    /// Makes `pattern` the next to be shown; ready must be low when this completes.
    async fn select(&mut self, pattern: u16) -> Result<(), NotSelected>;
}

/// Sets the LED's current, for instance through a converter.
pub trait CurrentSetting {
    /// Takes effect when the LED is next enabled.
    fn set(&mut self, current: Milliamps);
}

/// Completes when `pin` has this level.
async fn level(pin: &mut impl Wait<Error = Infallible>, level: bool) {
    let Ok(()) = if level {
        pin.wait_for_high().await
    } else {
        pin.wait_for_low().await
    };
}

fn drive(pin: &mut impl OutputPin<Error = Infallible>, level: bool) {
    let Ok(()) = pin.set_state(PinState::from(level));
}

/// An LED driver with an enable and a sense pin.
#[derive(Debug)]
pub struct PinLed<E, S, I> {
    /// Output: enable.
    pub enable: E,
    /// Input: current sense.
    pub sense: S,
    /// Current setting.
    pub current: I,
}

impl<E, S, I> Led for PinLed<E, S, I>
where
    E: OutputPin<Error = Infallible>,
    S: Wait<Error = Infallible>,
    I: CurrentSetting,
{
    fn on(&mut self, current: Milliamps) {
        self.current.set(current);
        drive(&mut self.enable, true);
    }
    fn off(&mut self) {
        drive(&mut self.enable, false);
    }
    async fn sense(&mut self, sense: bool) {
        level(&mut self.sense, sense).await;
    }
}

/// A DMD controller with trigger and ready pins and a port for selecting patterns.
#[derive(Debug)]
pub struct PinDmd<T, R, P> {
    /// Output: trigger.
    pub trigger: T,
    /// Input: ready.
    pub ready: R,
    /// Pattern selection.
    pub port: P,
}

impl<T, R, P> Dmd for PinDmd<T, R, P>
where
    T: OutputPin<Error = Infallible>,
    R: Wait<Error = Infallible>,
    P: PatternPort,
{
    async fn select(&mut self, pattern: u16) -> Result<(), NotSelected> {
        self.port.select(pattern).await
    }
    fn trigger(&mut self, level: bool) {
        drive(&mut self.trigger, level);
    }
    async fn ready(&mut self) {
        level(&mut self.ready, true).await;
    }
}

/// A camera on three pins.
#[derive(Debug)]
pub struct PinCamera<T, R, E> {
    /// Output: trigger.
    pub trigger: T,
    /// Input: ready.
    pub ready: R,
    /// Input: exposing.
    pub exposing: E,
}

impl<T, R, E> Camera for PinCamera<T, R, E>
where
    T: OutputPin<Error = Infallible>,
    R: Wait<Error = Infallible>,
    E: Wait<Error = Infallible>,
{
    fn trigger(&mut self, level: bool) {
        drive(&mut self.trigger, level);
    }
    async fn wait(&mut self, what: CameraWait) {
        match what {
            CameraWait::Ready => level(&mut self.ready, true).await,
            CameraWait::Exposing(exposing) => level(&mut self.exposing, exposing).await,
        }
    }
}
