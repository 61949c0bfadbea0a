//! The simulated physical bench: die with wear, fibre optics, camera, stages, and the truth.
//!
//! | module | holds |
//! |---|---|
//! | [`devices`] | LED, DMD, camera and stages as the controller sees them, in virtual time |
//! | [`world`] | die, light and sensor: what a frame shows |
//! | [`ageing`] | how the die wears with press cycles |
//! | [`camera`] | exposures to frames in shared memory |
//! | [`truth`] | what really was photographed |
//! | [`zones`] | how far the die is from its drawing where it is judged |
//! | [`damage`] | random damage, cut into the mesh of a die |
//! | [`die_file`] | a die from anyone's mesh file |
//! | [`demo`] | the built-in die and head |
//! | [`qemu`] | the controller's Cortex-M4 image in an emulator, instead of the in-process controller |
//! | [`study`] | how often the verdict is right, measured on many captures |
//! | [`process`] | all of it as a process of its own |

pub mod ageing;
pub mod camera;
pub mod damage;
pub mod demo;
pub mod devices;
pub mod die_file;
pub mod process;
pub mod qemu;
pub mod study;
pub mod truth;
pub mod world;
pub mod zones;
