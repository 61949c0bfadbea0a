//! The scene on the simulated bench: die or target, and how often the press is checked.

use std::path::Path;

/// What stands on the simulated bench beside the die of the tool file.
#[cfg_attr(
    not(feature = "bench"),
    expect(dead_code, reason = "without the bench nothing stands on it")
)]
#[derive(Clone, Copy, Default)]
pub struct Scene<'a> {
    /// The press strokes, and a check is made every so many strokes; `None`: it stands open.
    pub checks_every: Option<u32>,
    /// The die is put there by hand, eccentric and tilted; else it stands exactly in place.
    pub by_hand: bool,
    /// A calibration target instead of a die.
    pub target: bool,
    /// Teeth that are judged instead of the tool file's.
    pub teeth: Option<&'a [u32]>,
    /// Pictures that the DMD is loaded with instead of the head file's.
    pub pictures: Option<&'a Path>,
}
