//! Virtual pins: a line has a level, anyone holding it may drive it or wait for it, and its edges are recorded.

use crate::clock::now_us;
use core::cell::RefCell;
use core::convert::Infallible;
use core::future::poll_fn;
use core::task::{Poll, Waker};
use embedded_hal::digital::{ErrorType, InputPin, OutputPin};
use embedded_hal_async::digital::Wait;
use std::collections::VecDeque;
use std::rc::Rc;

/// One change of one line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Edge {
    /// Virtual time.
    pub at_us: u64,
    /// Name of the line.
    pub line: &'static str,
    /// Level after the change.
    pub level: bool,
}

/// Edges that are kept: a hundred views, in 3 MB. A bench that runs for days records a thousand with every check.
const MOST_EDGES: usize = 100_000;

/// Collects the latest edges of all lines of a simulation.
#[derive(Debug, Clone, Default)]
pub(crate) struct Recorder(Rc<RefCell<VecDeque<Edge>>>);

impl Recorder {
    pub(crate) fn edges(&self) -> Vec<Edge> {
        self.0.borrow().iter().copied().collect()
    }

    fn push(&self, edge: Edge) {
        let mut edges = self.0.borrow_mut();
        if edges.len() == MOST_EDGES {
            edges.pop_front();
        }
        edges.push_back(edge);
    }
}

#[derive(Debug)]
struct State {
    level: bool,
    /// When it last changed, by the clock of whoever drives it.
    changed_us: u64,
    rises: u64,
    falls: u64,
    waiting: Vec<Waker>,
}

/// A line between pins. Clones are the same line.
#[derive(Debug, Clone)]
pub struct Line {
    name: &'static str,
    state: Rc<RefCell<State>>,
    recorder: Recorder,
}

impl Line {
    pub(crate) fn new(name: &'static str, recorder: &Recorder) -> Self {
        let state = State {
            level: false,
            changed_us: 0,
            rises: 0,
            falls: 0,
            waiting: Vec::new(),
        };
        Self {
            name,
            state: Rc::new(RefCell::new(state)),
            recorder: recorder.clone(),
        }
    }

    /// The level now.
    pub fn level(&self) -> bool {
        self.state.borrow().level
    }

    /// When the level last changed, in microseconds: virtual time, or the time named by [`Line::set_at`].
    pub fn changed_us(&self) -> u64 {
        self.state.borrow().changed_us
    }

    /// Drives the line; only a change is an edge.
    pub fn set(&self, level: bool) {
        self.set_at(level, now_us());
    }

    /// Drives the line for somebody who has a clock of his own, by which the edge was at `at_us`.
    pub fn set_at(&self, level: bool, at_us: u64) {
        let mut state = self.state.borrow_mut();
        if state.level == level {
            return;
        }
        state.level = level;
        state.changed_us = at_us;
        *(if level {
            &mut state.rises
        } else {
            &mut state.falls
        }) += 1;
        let waiting = core::mem::take(&mut state.waiting);
        drop(state);
        self.recorder.push(Edge {
            at_us: now_us(),
            line: self.name,
            level,
        });
        waiting.into_iter().for_each(Waker::wake);
    }

    async fn wait(&self, mut over: impl FnMut(&State) -> bool) {
        poll_fn(|context| {
            let mut state = self.state.borrow_mut();
            if over(&state) {
                return Poll::Ready(());
            }
            if !state
                .waiting
                .iter()
                .any(|waker| waker.will_wake(context.waker()))
            {
                state.waiting.push(context.waker().clone());
            }
            Poll::Pending
        })
        .await;
    }

    fn counts(&self) -> (u64, u64) {
        let state = self.state.borrow();
        (state.rises, state.falls)
    }
}

impl ErrorType for Line {
    type Error = Infallible;
}

impl OutputPin for Line {
    fn set_low(&mut self) -> Result<(), Infallible> {
        self.set(false);
        Ok(())
    }
    fn set_high(&mut self) -> Result<(), Infallible> {
        self.set(true);
        Ok(())
    }
}

impl InputPin for Line {
    fn is_high(&mut self) -> Result<bool, Infallible> {
        Ok(self.level())
    }
    fn is_low(&mut self) -> Result<bool, Infallible> {
        Ok(!self.level())
    }
}

impl Wait for Line {
    async fn wait_for_high(&mut self) -> Result<(), Infallible> {
        self.wait(|state| state.level).await;
        Ok(())
    }
    async fn wait_for_low(&mut self) -> Result<(), Infallible> {
        self.wait(|state| !state.level).await;
        Ok(())
    }
    async fn wait_for_rising_edge(&mut self) -> Result<(), Infallible> {
        let (rises, _) = self.counts();
        self.wait(|state| state.rises > rises).await;
        Ok(())
    }
    async fn wait_for_falling_edge(&mut self) -> Result<(), Infallible> {
        let (_, falls) = self.counts();
        self.wait(|state| state.falls > falls).await;
        Ok(())
    }
    async fn wait_for_any_edge(&mut self) -> Result<(), Infallible> {
        let before = self.counts();
        self.wait(|state| (state.rises, state.falls) != before)
            .await;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_latest_edges_are_kept() {
        let recorder = Recorder::default();
        let line = Line::new("pin", &recorder);
        for n in 0..MOST_EDGES as u64 + 3 {
            line.set_at(n.is_multiple_of(2), n);
        }
        let edges = recorder.edges();
        assert_eq!(edges.len(), MOST_EDGES);
        // The first three are gone: up, down, up; the oldest that is left goes down.
        assert!(!edges[0].level && edges[1].level);
    }
}
