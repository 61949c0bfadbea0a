//! A lake of Parquet files that many stations write, without a server.
//!
//! ```text
//!  history of a station ──► ship ──► lake (folder or object store) ──► DuckDB, polars, any reader of Parquet
//!                                     │   ▲
//!                                 verify  compact, query, serve
//! ```
//!
//! | module | holds |
//! |---|---|
//! | [`rows`] | the table: columns, version, what digests are made of |
//! | [`file`](mod@file) | a file: Parquet, digest, seals |
//! | [`name`] | names of files, and the rule which files count |
//! | [`lake`] | the folder or object store |
//! | [`ship`] | copies the checks of a history into the lake |
//! | [`verify`] | names what is missing, edited or there twice |
//! | [`compact`](mod@compact) | joins small files, gives up old days |
//! | [`retired`] | marks of what was given up |
//! | [`sums`] | names of daily sums, and for which files they stand |
//! | `query` | answers questions in SQL, behind a feature |
//! | `serve` | a page of all presses, behind a feature |
//!
//! It opens histories through `flankscope-record`, without an instrument.

pub mod compact;
pub mod file;
pub mod lake;
pub mod name;
#[cfg(feature = "query")]
pub mod query;
pub mod retired;
pub mod rows;
#[cfg(feature = "serve")]
pub mod serve;
pub mod ship;
pub mod sums;
pub mod verify;
