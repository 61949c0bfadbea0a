//! Stored results: documents of checks, the history of a die, baselines, and signatures that show who wrote each.
//!
//! | module | holds |
//! |---|---|
//! | [`check_request`] | a check that somebody wants before it is due |
//! | [`document`] | the documents of checks |
//! | [`history`] | checks, baselines and acknowledgements of a press in one SQLite file, and analyses of them |
//! | [`baseline`] | the deviations of a tool when new |
//! | [`die`] | identity of the die that a check is of |
//! | [`origin`] | link, head, station and operator of a result |
//! | [`seal`] | signatures of files, and which files are trusted |
//! | [`sink`] | outputs for results |
//!
//! This crate opens stored results without an instrument: no controller, camera or plots. Jobs write them; reports, a plant's
//! page and analyses read them.

pub mod baseline;
mod beside;
pub mod check_request;
pub mod die;
pub mod document;
pub mod history;
pub mod origin;
pub mod seal;
pub mod sink;
