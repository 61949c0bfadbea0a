//! The ground floor of the host: what more than one library needs and none should write again.
//!
//! | module | holds |
//! |---|---|
//! | [`activity`] | when each device was active during a capture |
//! | [`clock`] | time since the computer started, which is never set |
//! | [`date`] | calendar days and moments, ISO 8601, UTC |
//! | [`files`] | files that appear whole or not at all, and their digests |
//! | [`textfile`] | files that people write: size limit, TOML, complaints with file and line |
//! | [`order`] | quantiles and medians |
//! | [`random`] | counter-based random numbers |
//! | [`rigid`] | frames of reference and the rigid transforms between them |
//! | [`seal`] | whose word a file is |
//! | [`simd`] | one function for every processor, in the widest vectors it has |
//! | [`display`] | figures in sentences |
//! | [`npz`] | arrays for NumPy |
//! | [`normal`] | normal distribution: coverage and guard factors, probability of conformity |
//!
//! It depends on no room of this workspace; every library and program of the host may depend on it.
//!
//! ```
//! use flankscope_foundation::{date::Date, normal::guard_factor, order::median};
//! let calibrated: Date = "2026-01-31".parse()?;
//! assert_eq!(calibrated.plus_days(30).to_string(), "2026-03-02");
//! assert_eq!(median(&mut [3.0, 1.0, 2.0]), Some(2.0));
//! assert!((guard_factor(0.975) - 1.96).abs() < 1e-4);
//! # Ok::<(), flankscope_foundation::date::NoDate>(())
//! ```
#![warn(missing_docs)]

pub mod activity;
pub mod clock;
pub mod date;
pub mod display;
pub mod files;
pub mod normal;
pub mod npz;
pub mod order;
pub mod random;
pub mod rigid;
pub mod seal;
pub mod simd;
pub mod textfile;
