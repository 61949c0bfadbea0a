//! Activity of each device over time, from the controller's events.

use std::time::Duration;

use flankscope_foundation::activity::{Activity, Device, Span};
use flankscope_protocol::{Event, State, Timestamp, Trigger};

/// Collects a capture's events.
#[derive(Debug, Default)]
pub struct Timeline {
    start: Option<Timestamp>,
    moving: Vec<Span>,
    settling: Vec<Span>,
    led: Vec<Span>,
    dmd: Vec<Span>,
    camera: Vec<Span>,
    held: Vec<Span>,
    held_since: Option<Timestamp>,
    state_since: Timestamp,
    latest: Timestamp,
    led_since: Option<Timestamp>,
    /// Time between two captures of one check in which the press was not held, ms.
    free_ms: f64,
}

impl Timeline {
    /// Takes one event.
    pub fn note(&mut self, event: &Event) {
        match *event {
            Event::StateChanged { prev, next, at, .. } => {
                self.note_hold(next, at);
                let since = self.state_since.max(*self.start.get_or_insert(at));
                let span = self.span(since, at);
                match prev {
                    State::Moving | State::Retracting => self.moving.push(span),
                    State::Settling => self.settling.push(span),
                    State::Ready => self.free_ms += length(&span),
                    _ => {}
                }
                self.state_since = at;
                self.latest = at;
            }
            Event::Led { on: true, at, .. } => self.led_since = Some(at),
            Event::Led { on: false, at, .. } => {
                if let Some(since) = self.led_since.take() {
                    let span = self.span(since, at);
                    self.led.push(span);
                }
            }
            Event::Triggered(Trigger {
                dmd_at,
                camera_at,
                end_at,
                ..
            }) => {
                let (dmd, camera) = (self.span(dmd_at, camera_at), self.span(camera_at, end_at));
                self.latest = end_at;
                self.dmd.push(dmd);
                self.camera.push(camera);
            }
            _ => {}
        }
    }

    /// Records whether the press is held in a state: it is from leaving `Ready` until `Ready` again, because after a fault the
    /// die is not known to be clear.
    fn note_hold(&mut self, next: State, at: Timestamp) {
        if next != State::Ready {
            self.held_since.get_or_insert(at);
        } else if let Some(since) = self.held_since.take() {
            let span = self.span(since, at);
            self.held.push(span);
        }
    }

    fn span(&mut self, from: Timestamp, to: Timestamp) -> Span {
        let start = *self.start.get_or_insert(from);
        let ms = |at: Timestamp| at.since_us(start) as f64 / 1000.0;
        Span {
            start_ms: ms(from),
            end_ms: ms(to),
        }
    }

    /// Time from the first event to the latest by the controller's clock, without the time in which the press was not held.
    pub fn elapsed(&self) -> Duration {
        let all = Duration::from_micros(self.start.map_or(0, |start| self.latest.since_us(start)));
        all.saturating_sub(Duration::from_secs_f64(self.free_ms / 1e3))
    }

    /// Time spent moving and settling, ms.
    pub fn positioning_ms(&self) -> f64 {
        sum(self.moving.iter().chain(&self.settling))
    }

    /// Sum of the exposures, ms.
    pub fn exposure_ms(&self) -> f64 {
        sum(self.camera.iter())
    }

    /// When each device was active.
    #[must_use]
    pub fn activities(mut self) -> Vec<Activity> {
        // The press was not released before the last event.
        if let Some(since) = self.held_since.take() {
            let span = self.span(since, self.latest);
            self.held.push(span);
        }
        let of = |device, spans| Activity { device, spans };
        vec![
            of(Device::Stages, self.moving),
            of(Device::Settling, self.settling),
            of(Device::Led, self.led),
            of(Device::Dmd, self.dmd),
            of(Device::Camera, self.camera),
            of(Device::Held, self.held),
        ]
    }
}

/// Sum of the spans; 0 without any, because Rust's sum of no numbers is −0.
fn sum<'a>(spans: impl Iterator<Item = &'a Span>) -> f64 {
    spans.map(length).fold(0.0, |sum, length| sum + length)
}

fn length(span: &Span) -> f64 {
    span.end_ms - span.start_ms
}
