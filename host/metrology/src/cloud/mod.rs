//! Clouds by themselves, without CAD: distances between neighbours, outliers, overlapping views merged, a cloud as a surface.

pub mod merge;
mod neighbours;
pub mod outlier;
pub mod surface;
