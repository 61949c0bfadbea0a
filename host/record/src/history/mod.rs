//! What was found, for good: checks, baselines and acknowledgements of a press in one file, and what follows from them.
//!
//! ```text
//!  check ──► writer ──► store (SQLite, on the disk before it counts) ──► verdict at the press
//!                         └──► series of each flank ──► change ──► trend ──► remaining cycles ──► table, page, CSV
//! ```
//!
//! | file | holds |
//! |---|---|
//! | `store` | the file: made, opened, written in whole transactions |
//! | `row_differences` | the row of a check against its document |
//! | `rows` | what is read of it |
//! | `schema` | its tables, which version of them this is, and what a file has beside them |
//! | `chain` | a keyed digest over every row and the one before it |
//! | `same_die` | which checks are of one die |
//! | `hold` | one watch at a time holds a die in a file, by device and inode |
//! | `writer` | the sink that a verdict waits for: stores checks, and takes back a verdict that cannot be stored |
//! | `series` | wear of each flank against cycles, over the tool's present life |
//! | `change` | where the wear left its line |
//! | `trend` | a robust line since then |
//! | `remaining` | how many cycles are left |
//! | `forecast` | all of that for one flank |
//! | `export` | CSV |
//! | `parquet` | the same as Apache Parquet, behind a feature |
//! | `phasors` | what verdicts were computed from, in files beside the store |
//! | `retention` | which of these are kept |

mod chain;
mod change;
mod error;
mod export;
mod forecast;
mod hold;
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
pub use error::HistoryError;
pub use export::csv;
pub use forecast::Forecast;
pub use hold::Hold;
#[cfg(feature = "parquet")]
pub use parquet::parquet;
pub use remaining::Passage;
pub use retention::Retention;
pub use row_differences::{Difference, row_differences};
pub use rows::{Acknowledgement, Check, FlankRow};
pub use series::{Point, Series, series};
pub use store::History;
pub use trend::{LEAST_POINTS, Trend};
pub use writer::HistoryWriter;
