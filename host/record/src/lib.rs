//! What is kept of measurements and later believed: documents of checks, the history of a die, baselines, and whose word each is.
//!
//! | module | holds |
//! |---|---|
//! | [`document`] | the documents of checks |
//! | [`history`] | checks, baselines and acknowledgements of a press in one SQLite file, and what follows from them |
//! | [`baseline`] | a tool as it was when new |
//! | [`die`] | which die a check is of |
//! | [`origin`] | through which link, by which head, at which station, for whom |
//! | [`seal`] | signatures of files, and which of them are believed |
//! | [`sink`] | where results go once they are there |
//!
//! It opens and shows stored results without an instrument: no controller, no camera, no plots. Jobs write it; reports, a plant's
//! page and analyses read it.

pub mod baseline;
pub mod die;
pub mod document;
pub mod history;
pub mod origin;
pub mod seal;
pub mod sink;
