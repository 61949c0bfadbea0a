//! When each device of the instrument was active during a capture: what a timeline draws.

/// A time in which a device was active, in ms from the first event.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Span {
    /// Start, ms.
    pub start_ms: f64,
    /// End, ms.
    pub end_ms: f64,
}

/// What was active.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Device {
    /// The stages moved.
    Stages,
    /// Everything waited for them to stand still.
    Settling,
    /// The LED was on.
    Led,
    /// The DMD showed a pattern before its exposure.
    Dmd,
    /// The camera exposed.
    Camera,
    /// The press was held: head-clear was low, from the controller's claim until the head was out again.
    Held,
}

/// When a device was active.
#[derive(Clone, Debug, PartialEq)]
pub struct Activity {
    /// Which.
    pub device: Device,
    /// When.
    pub spans: Vec<Span>,
}
