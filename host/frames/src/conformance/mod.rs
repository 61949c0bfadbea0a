//! The checks that every camera process must pass, whoever wrote it.
//!
//! [`run`] plays the host against a camera process that a [`Rig`] starts, triggers and kills. For a camera with a
//! software trigger, [`CommandRig`] does it by a command: the root's folder is its last argument, each line on its
//! standard input fires one exposure of so many microseconds, and it ends when its standard input does.
//!
//! ```sh
//! cargo run -p flankscope-frames --example conformance -- target/debug/examples/camera
//! ```

mod checks;
mod rig;

use std::io;
use std::path::Path;
use std::time::Duration;

pub use rig::{CommandRig, Rig};

use crate::header::FrameLabel;
use crate::link::{ReceiveError, SendError};
use crate::node::ServiceError;
use crate::root_error::RootError;

/// What the suite may expect of a camera.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    /// An exposure that the camera takes, µs.
    pub exposure_us: u32,
    /// From trigger to frame, and from the end of standard input to the end of the process, at most.
    pub patience: Duration,
    /// The camera's time stands still while the host has no room (a simulated one): it loses no frame.
    pub waits: bool,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            exposure_us: 2_000,
            patience: Duration::from_secs(10),
            waits: false,
        }
    }
}

/// What a camera process does wrong.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Violation {
    /// The rig cannot start, trigger or end the process.
    #[error("the camera process cannot be run: {0}")]
    Rig(#[from] io::Error),
    /// The host's own end cannot be made.
    #[error(transparent)]
    Root(#[from] RootError),
    /// The host's own end cannot be made.
    #[error(transparent)]
    Services(#[from] ServiceError),
    /// A frame's header or checksum does not fit its pixels.
    #[error(transparent)]
    Frame(#[from] ReceiveError),
    /// The contract's own limits.
    #[error(transparent)]
    Send(#[from] SendError),
    /// It never opened its end of the services.
    #[error("no camera opened the services within {patience:?}")]
    NoCamera {
        /// How long was waited.
        patience: Duration,
    },
    /// It did not say that it is armed and drained.
    #[error("armed for session {session}, the camera did not say so within {patience:?}")]
    NotReady {
        /// The session, 0 for its first word.
        session: u32,
        /// How long was waited.
        patience: Duration,
    },
    /// It announces another next frame than the count of exposures.
    #[error("the camera announces frame {got} as its next; {expected} exposures were triggered")]
    NextFrame {
        /// Announced.
        got: u32,
        /// Exposures since the process started.
        expected: u32,
    },
    /// Its frames have another size than it announced.
    #[error("the camera announced {announced_px:?} px, its frame {counter} has {got_px:?}")]
    Announced {
        /// The frame's number.
        counter: u32,
        /// Width and height announced.
        announced_px: [u32; 2],
        /// Those of the frame.
        got_px: [u32; 2],
    },
    /// A trigger without a frame.
    #[error("exposure {nth} was triggered, but no frame came within {patience:?}")]
    NoFrame {
        /// Triggers before it.
        nth: u32,
        /// How long was waited.
        patience: Duration,
    },
    /// More frames than triggers.
    #[error("frame {counter} came without a trigger")]
    Untriggered {
        /// Its number.
        counter: u32,
    },
    /// Another number than the count of exposures.
    #[error("a frame came with counter {got}; it is exposure {expected} since the process started")]
    Counter {
        /// Counter that came.
        got: u32,
        /// Counter expected.
        expected: u32,
    },
    /// Another session than the armed one.
    #[error("frame {counter} carries session {got}; armed is {expected}")]
    Session {
        /// Its number.
        counter: u32,
        /// Session that came.
        got: u32,
        /// Session armed.
        expected: u32,
    },
    /// Another place in the plan than its count since arming.
    #[error("frame {counter} is labelled {got:?}; by its count since arming it is {expected:?}")]
    Label {
        /// Its number.
        counter: u32,
        /// Label that came.
        got: FrameLabel,
        /// Label expected.
        expected: FrameLabel,
    },
    /// Frames of several sizes, or of none.
    #[error("frame {counter} has {got_px:?} px; the first had {expected_px:?}")]
    Size {
        /// Its number.
        counter: u32,
        /// Width, height and stride that came.
        got_px: [u32; 3],
        /// Those of the first frame.
        expected_px: [u32; 3],
    },
    /// An exposure of another length than commanded.
    #[error("frame {counter} was exposed for {got_us} us; {commanded_us} us were commanded")]
    Exposure {
        /// Its number.
        counter: u32,
        /// By its header.
        got_us: u64,
        /// Commanded.
        commanded_us: u64,
    },
    /// Times that cannot be.
    #[error("frame {counter}: {what} lies at {later_ns} ns, before {before} at {earlier_ns} ns")]
    Time {
        /// Its number.
        counter: u32,
        /// What comes too early.
        what: &'static str,
        /// When, ns.
        later_ns: u64,
        /// What it must follow.
        before: &'static str,
        /// When, ns.
        earlier_ns: u64,
    },
    /// Bits of `measured` that mean nothing.
    #[error("frame {counter}: measured is {got:#x}; bits 0 and 1 have a meaning, all others are 0")]
    Measured {
        /// Its number.
        counter: u32,
        /// Its value.
        got: u32,
    },
    /// Shared memory grew after the first frame.
    #[error("the shared memory grew from {before_bytes} to {after_bytes} bytes during a capture")]
    Grown {
        /// After the first frame.
        before_bytes: u64,
        /// At the end.
        after_bytes: u64,
    },
    /// A host that takes nothing was not noticed.
    #[error("{fired} exposures were fired at a host that takes none, yet no frame was lost")]
    NothingLost {
        /// Exposures fired.
        fired: u32,
    },
    /// It outlives its host.
    #[error("the camera process still runs {patience:?} after its standard input ended")]
    Outlives {
        /// How long was waited.
        patience: Duration,
    },
}

/// The check that a camera process failed, and how.
#[derive(Debug, thiserror::Error)]
#[error("{check}: {violation}")]
pub struct Failure {
    /// Name of the check.
    pub check: &'static str,
    /// What was wrong.
    #[source]
    pub violation: Violation,
}

/// Runs every check on the camera process of `rig`, with roots below `base`; `passed` hears of each that passed.
///
/// # Errors
/// The first check that failed.
pub fn run(
    rig: &mut dyn Rig,
    base: &Path,
    settings: &Settings,
    mut passed: impl FnMut(&'static str),
) -> Result<(), Failure> {
    for &(name, check) in checks::ALL {
        let outcome = check(rig, base, settings);
        // Whatever a failed check left running must not disturb whoever comes next.
        let ended = rig.kill();
        outcome
            .and(ended.map_err(Violation::from))
            .map_err(|violation| Failure {
                check: name,
                violation,
            })?;
        passed(name);
    }
    Ok(())
}
