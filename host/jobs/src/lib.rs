//! The jobs of the instrument, each from connecting to its result.
//!
//! ```text
//!  sources: live frames, recorded frames,          ┌─ inspection ── verdict ──┐
//!           recorded clouds, stored phasors  ──────┼─ scan ─────── map ───────┼──► record, then report
//!                                                  └─ calibration ─ head ─────┘
//! ```
//!
//! | module | holds |
//! |---|---|
//! | [`subject`] | tool and head of a job |
//! | [`plan`] | plans views, patterns and exposures from tool and head; tests what the head sees of them |
//! | [`job`] | common parts of all jobs: threads, live or recorded frames as their source, recordings |
//! | [`inspection`] | the check of a few critical teeth |
//! | [`watch`] | a check every N cycles of the press |
//! | [`scan`] | the whole die, view by view |
//! | [`calibration`] | from captures of plates to a head file, and its self-test |
//! | [`setup_view`] | live view of one tooth for setting up the head; exposures that suit it |
//! | [`replay`] | a stored verdict, computed again from its phasors |
//! | [`readiness`] | findings on the station's key, tool, head and history |

mod bookkeeping;
pub mod calibration;
pub mod inspection;
pub mod job;
pub mod plan;
pub mod readiness;
pub mod replay;
pub mod scan;
pub mod setup_view;
pub mod subject;
pub mod watch;
