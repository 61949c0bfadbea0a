//! Clouds by themselves, without CAD: distances between neighbours, outliers and overlapping views merged.

pub mod merge;
mod neighbours;
pub mod outlier;
