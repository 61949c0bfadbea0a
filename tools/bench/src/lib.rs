//! The simulated physical bench: die with wear, fibre optics, camera, stages, and the truth.
//!
//! It shares no reader, formula or type with what decodes, registers and judges: a world that did would prove nothing.
//!
//! | module | holds |
//! |---|---|
//! | [`devices`] | LED, DMD, camera and stages as the controller sees them, in virtual time |
//! | [`world`] | die, light and sensor: what a frame shows |
//! | [`ageing`] | how the die wears with press cycles |
//! | [`camera`] | exposures to frames in shared memory |
//! | `gige` | the same frames as those of a GigE Vision camera (feature `gige`) |
//! | [`link`] | how its frames leave the bench |
//! | [`truth`] | what really was photographed |
//! | [`zones`] | how far the die is from its drawing where it is judged |
//! | [`damage`] | random damage, cut into the mesh of a die |
//! | [`die_file`] | a die from anyone's mesh file |
//! | [`demo`] | what the built-in demo is made of: die, target, tile |
//! | [`files`] | what tool, head, target and mesh files say, by readers of the bench's own |
//! | [`specimen`] | what stands before which head, by those files |
//! | [`bench_file`] | the bench file: what no option says |
//! | [`given`] | a value that is given as text |
//! | [`config`] | what a run of the bench is told: options, bench file, and what they are handed over in |
//! | [`qemu`] | the controller's Cortex-M4 image in an emulator, instead of the in-process controller |
//! | [`process`] | all of it as a process of its own |

pub mod ageing;
pub mod arm;
pub mod bench_file;
pub mod camera;
pub mod config;
pub mod damage;
pub mod demo;
pub mod devices;
pub mod die_file;
pub mod files;
#[cfg(feature = "gige")]
pub mod gige;
pub mod given;
pub mod link;
pub mod process;
pub mod qemu;
pub mod specimen;
pub mod truth;
pub mod world;
pub mod zones;
