//! The simulated physical bench: a die with wear, fibre optics, camera, stages, and the true values.
//!
//! It shares no parser, formula or type with decoding, registration and evaluation, because otherwise their errors could cancel
//! and agreement would prove nothing.
//!
//! | module | holds |
//! |---|---|
//! | [`devices`] | LED, DMD, camera and stages as the controller sees them, in virtual time |
//! | [`world`] | die, light and sensor: what a frame shows |
//! | [`ageing`] | progress of wear with press cycles |
//! | [`camera`] | exposures to frames in shared memory |
//! | `gige` | the same frames as those of a GigE Vision camera (feature `gige`) |
//! | [`link`] | transport of frames to the host, and its faults |
//! | [`truth`] | true values of everything that was captured |
//! | [`zones`] | true deviation of the die from its drawing in the judged zones |
//! | [`damage`] | random damage, cut into the mesh of a die |
//! | [`die_file`] | reads a die from a mesh file |
//! | [`demo`] | the built-in demo: die, target, tile |
//! | [`files`] | the bench's own parsers of tool, head, target and mesh files |
//! | [`specimen`] | the object in front of the head, by those files |
//! | [`bench_file`] | the bench file: settings without a command-line option |
//! | [`given`] | a value given as text |
//! | [`config`] | configuration of a run: options, bench file, and the document that passes them on |
//! | [`qemu`] | the controller's Cortex-M4 image in an emulator, instead of the in-process controller |
//! | [`process`] | the whole bench as a separate process |

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
