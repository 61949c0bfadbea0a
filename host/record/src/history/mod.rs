//! The permanent record of a press: checks, baselines and acknowledgements in one file, and the analyses based on them.
//!
//! ```text
//!  check ──► writer ──► store (SQLite, on the disk before it counts) ──► verdict at the press
//!                         └──► series of each flank ──► change ──► trend ──► remaining cycles ──► table, page, CSV
//! ```
//!
//! | file | holds |
//! |---|---|
//! | `store` | creates, opens and writes the file in transactions |
//! | `row_differences` | compares the row of a check with its document |
//! | `rows` | reads the file |
//! | `schema` | tables, their version, and detection of foreign definitions |
//! | `chain` | a keyed digest over every row and the one before it |
//! | `linked` | checks with their links, from a position on |
//! | `same_die` | which checks are of one die |
//! | `hold` | allows one watch at a time per die, by device and inode of the file |
//! | `writer` | the sink that a verdict waits for: stores checks, and revokes a verdict that cannot be stored |
//! | `series` | wear of each flank against cycles, over the tool's present life |
//! | `change` | detects where the wear left its line |
//! | `trend` | a robust line since the last change |
//! | `remaining` | number of remaining cycles |
//! | `forecast` | all of these for one flank |
//! | `dates` | detects that the clock was set back |
//! | `export` | export as CSV |
//! | `parquet` | export as Apache Parquet, behind a feature |
//! | `phasors` | data of verdicts, in files beside the store |
//! | `retention` | which phasor files are kept |

mod chain;
mod change;
mod dates;
mod error;
mod export;
mod forecast;
mod hold;
mod linked;
#[cfg(feature = "parquet")]
mod parquet;
mod phasors;
mod remaining;
mod retention;
mod row_differences;
mod rows;
mod same_die;
mod schema;
mod series;
mod store;
mod trend;
mod writer;

pub use change::changes;
pub use dates::clock_set_back;
pub use error::HistoryError;
pub use export::csv;
pub use forecast::Forecast;
pub use hold::Hold;
pub use linked::{LinkedCheck, Whereabouts};
#[cfg(feature = "parquet")]
pub use parquet::parquet;
pub use remaining::Passage;
pub use retention::Retention;
pub use row_differences::{Difference, row_differences};
pub use rows::{Acknowledgement, Check, FlankRow, LastChecks};
pub use series::{Point, Series, series, sides};
pub use store::History;
pub use trend::{LEAST_POINTS, Trend};
pub use writer::HistoryWriter;
