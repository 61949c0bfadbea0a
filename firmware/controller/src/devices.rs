//! What the controller needs of LEDs, DMDs, camera and lens, and the plain-pin versions of them.
//!
//! Each projector has an LED and a DMD of its own, on lines of their own.
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
use embassy_futures::select::{Either4, select4};
use embedded_hal::digital::{OutputPin, PinState};
use embedded_hal_async::digital::Wait;
use flankscope_protocol::{Milliamps, Projector};

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
    /// Whether the selected pattern has been fetched: a trigger before is missed.
    async fn is_loaded(&mut self) -> Result<bool, NotSelected>;
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

/// What a projector's light comes from.
#[derive(Debug)]
pub struct LightEngine<L, D> {
    pub led: L,
    pub dmd: D,
}

/// All devices that work with light.
#[derive(Debug)]
pub struct Optics<L, D, C, N> {
    /// The projector that every head has.
    pub first: LightEngine<L, D>,
    /// The one on the camera's other side, where one is fitted.
    pub second: Option<LightEngine<L, D>>,
    pub camera: C,
    /// The liquid lens.
    pub lens: N,
}

/// Completes when an LED's current sense has the level awaited. Where no LED is fitted none shines.
async fn sensed<L: Led>(led: Option<&mut L>, awaited: Option<bool>) -> bool {
    match (led, awaited) {
        (Some(led), Some(level)) => {
            led.sense(level).await;
            level
        }
        (None, Some(false)) => false,
        _ => pending().await,
    }
}

impl<L: Led, D: Dmd, C: Camera, N> Optics<L, D, C, N> {
    /// Projectors fitted.
    pub fn projectors(&self) -> u8 {
        1 + u8::from(self.second.is_some())
    }

    fn engine(&mut self, projector: Projector) -> Option<&mut LightEngine<L, D>> {
        match projector {
            Projector::First => Some(&mut self.first),
            Projector::Second => self.second.as_mut(),
        }
    }

    fn engines(&mut self) -> impl Iterator<Item = &mut LightEngine<L, D>> {
        core::iter::once(&mut self.first).chain(&mut self.second)
    }

    /// Enables a projector's LED at this current, and no other: those go off first.
    pub fn light(&mut self, projector: Projector, current: Milliamps) {
        self.dark();
        if let Some(engine) = self.engine(projector) {
            engine.led.on(current);
        }
    }

    /// Disables every LED.
    pub fn dark(&mut self) {
        self.engines().for_each(|engine| engine.led.off());
    }

    /// Drives one projector's DMD trigger high and the others low.
    pub fn show(&mut self, whose: Option<Projector>) {
        self.engines().for_each(|engine| engine.dmd.trigger(false));
        if let Some(engine) = whose.and_then(|projector| self.engine(projector)) {
            engine.dmd.trigger(true);
        }
    }

    /// Selects the pattern that a projector shows at its next trigger.
    ///
    /// # Errors
    /// It is refused, or no such projector is fitted.
    pub async fn select(&mut self, projector: Projector, pattern: u16) -> Result<(), NotSelected> {
        match self.engine(projector) {
            Some(engine) => engine.dmd.select(pattern).await,
            None => Err(NotSelected),
        }
    }

    /// Whether a projector's DMD has fetched the selected pattern.
    ///
    /// # Errors
    /// It does not say, or no such projector is fitted.
    pub async fn is_loaded(&mut self, projector: Projector) -> Result<bool, NotSelected> {
        match self.engine(projector) {
            Some(engine) => engine.dmd.is_loaded().await,
            None => Err(NotSelected),
        }
    }

    /// Completes when a line awaited has its level. May be dropped at any time.
    pub async fn wait(&mut self, awaiting: Awaiting) -> Input {
        let Self {
            first,
            second,
            camera,
            ..
        } = self;
        let (led, dmd) = match second {
            Some(LightEngine { led, dmd }) => (Some(led), Some(dmd)),
            None => (None, None),
        };
        let [one, two] = awaiting.led_sense;
        let first_led = async {
            let level = sensed(Some(&mut first.led), one).await;
            Input::LedSense(Projector::First, level)
        };
        let second_led = async {
            let level = sensed(led, two).await;
            Input::LedSense(Projector::Second, level)
        };
        let dmd = async {
            let awaited = match awaiting.dmd_ready {
                Some(Projector::First) => Some(&mut first.dmd),
                Some(Projector::Second) => dmd,
                None => None,
            };
            match awaited {
                Some(dmd) => dmd.ready().await,
                None => pending().await,
            }
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
        match select4(first_led, second_led, dmd, camera).await {
            Either4::First(input)
            | Either4::Second(input)
            | Either4::Third(input)
            | Either4::Fourth(input) => input,
        }
    }
}

/// Selects patterns over whatever bus the DMD controller is on.
pub trait PatternPort {
    /// Makes `pattern` the next to be shown; ready must be low when this completes.
    async fn select(&mut self, pattern: u16) -> Result<(), NotSelected>;
    /// Whether it has been fetched. Of patterns that need not be fetched nobody asks.
    async fn is_loaded(&mut self) -> Result<bool, NotSelected> {
        Ok(true)
    }
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
    async fn is_loaded(&mut self) -> Result<bool, NotSelected> {
        self.port.is_loaded().await
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
