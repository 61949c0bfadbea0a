//! The simulated physical bench: die with wear, fibre optics, camera, stages, and the truth.

pub mod devices;
