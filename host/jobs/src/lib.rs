//! The jobs of the instrument, each from hello to result.
//!
//! ```text
//!  sources: live frames, recorded frames,          ┌─ inspection ── verdict ──┐
//!           recorded clouds, stored phasors  ──────┼─ scan ─────── map ───────┼──► record, then report
//!                                                  └─ calibration ─ head ─────┘
//! ```
//!
//! | module | holds |
//! |---|---|
//! | [`subject`] | what a job looks at, and with what |
//! | [`plan`] | which poses, patterns and exposures: from tool and head to a plan of views; what the head sees of them |
//! | [`job`] | what all jobs share: threads, live or recorded frames as their source, recordings |
//! | [`inspection`] | the check of a few critical teeth |
//! | [`watch`] | a check every N cycles of the press |
//! | [`scan`] | the whole die, view by view |
//! | [`calibration`] | plates to a head file, and its self-test |
//! | [`replay`] | a stored verdict, computed again from its phasors |
//! | [`readiness`] | findings on what a station measures with: key, tool, head, history |

mod bookkeeping;
pub mod calibration;
pub mod inspection;
pub mod job;
pub mod plan;
pub mod readiness;
pub mod replay;
pub mod scan;
pub mod subject;
pub mod watch;
