//! Poses of the camera at each view from an external source instead of the station's stages, such as a robot arm.
//!
//! | source | what it is |
//! |---|---|
//! | [`PoseTable`] | `poses.csv`: poses known in advance |
//! | [`PoseProgram`] | a program that is asked for one view after the other, moves the arm or whatever carries the head, and
//! answers with the pose of the camera |
//!
//! A pose without a stated uncertainty, or one that arrives too late, is rejected: its view is not measured, and a check with an
//! unmeasured view is never "go".

mod program;
mod table;

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use flankscope_foundation::rigid::{Camera, Rigid, RigidError, Tool};
use flankscope_metrology::view::StatedPose;
use serde::{Deserialize, Serialize};

pub use program::PoseProgram;
pub use table::PoseTable;

/// Largest standard uncertainty of a usable pose, mm and mrad: half a tooth's width, and a degree.
const U_LIMIT: [f64; 2] = [1.0, 20.0];
/// Largest distance from the requested pose, mm: the search for the surface reaches 2 mm beyond the field.
const ELSEWHERE_MM: f64 = 1.0;
/// Largest angle from the requested pose, mrad: 1 mm at the edge of a field of 10 mm.
const ELSEWHERE_MRAD: f64 = 100.0;

/// The poses stated so far in a check, by view from 0; the evaluation of a view reads its pose here.
#[derive(Clone, Debug, Default)]
pub struct StatedPoses(Arc<Mutex<BTreeMap<usize, StatedPose>>>);

impl StatedPoses {
    fn lock(&self) -> MutexGuard<'_, BTreeMap<usize, StatedPose>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Sets the pose of a view.
    pub fn insert(&self, view: usize, pose: StatedPose) {
        self.lock().insert(view, pose);
    }

    /// Discards an earlier pose of a view.
    pub fn remove(&self, view: usize) {
        self.lock().remove(&view);
    }

    pub fn of(&self, view: usize) -> Option<StatedPose> {
        self.lock().get(&view).cloned()
    }

    /// All of them, in order.
    pub fn all(&self) -> Vec<(usize, StatedPose)> {
        let all = self.lock();
        all.iter()
            .map(|(view, pose)| (*view, pose.clone()))
            .collect()
    }
}

impl PartialEq for StatedPoses {
    fn eq(&self, other: &Self) -> bool {
        self.all() == other.all()
    }
}

impl FromIterator<(usize, StatedPose)> for StatedPoses {
    fn from_iter<I: IntoIterator<Item = (usize, StatedPose)>>(poses: I) -> Self {
        Self(Arc::new(Mutex::new(poses.into_iter().collect())))
    }
}

/// Why a view has no pose.
#[derive(Debug, thiserror::Error)]
pub enum PoseError {
    #[error("the pose program {program} could not be started: {source}")]
    Start {
        program: String,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// The program ended, or closed its output.
    #[error("the pose program ended before it answered for view {view}")]
    Ended {
        /// View, from 1.
        view: usize,
    },
    #[error("the pose program did not answer for view {view} within {limit_s} s")]
    Late {
        /// View, from 1.
        view: usize,
        /// Longest wait, s.
        limit_s: f64,
    },
    /// The operator interrupted the run.
    #[error("interrupted while the pose program was asked for view {view}")]
    Interrupted {
        /// View, from 1.
        view: usize,
    },
    /// The answer does not follow the protocol.
    #[error("the pose program answered for view {view} what is no answer: {why}")]
    Unreadable {
        /// View, from 1.
        view: usize,
        /// Reason.
        why: String,
    },
    /// The program answered that it has no pose.
    #[error("the pose program refuses view {view}: {why}")]
    Refused {
        /// View, from 1.
        view: usize,
        /// Reason given by the program.
        why: String,
    },
    /// The answer is for another view.
    #[error("the pose program answered for view {got} when it was asked for view {view}")]
    OtherView {
        /// View asked for, from 1.
        view: usize,
        got: usize,
    },
    /// The matrix is not a pose.
    #[error("the pose of view {view} is none: {source}")]
    NoPose {
        /// View, from 1.
        view: usize,
        /// Reason.
        source: RigidError,
    },
    /// The stated uncertainty is not positive, or too large.
    #[error("the pose of view {view} has {key} = {got}; right is more than 0 and at most {limit}")]
    Uncertainty {
        /// View, from 1.
        view: usize,
        /// `u_mm` or `u_mrad`.
        key: &'static str,
        /// Its value.
        got: f64,
        /// Largest usable value.
        limit: f64,
    },
    /// The pose is too far from the requested one.
    #[error(
        "the pose of view {view} is {off_mm:.3} mm and {off_mrad:.1} mrad from where it was asked for; at most {ELSEWHERE_MM} mm and {ELSEWHERE_MRAD} mrad"
    )]
    Elsewhere {
        /// View, from 1.
        view: usize,
        /// Distance, mm.
        off_mm: f64,
        /// Angle, mrad.
        off_mrad: f64,
    },
    /// A pose table with an arm that has to move from view to view: the table cannot say when the arm has arrived.
    #[error(
        "{}: with stages.moves = \"outside\" a table says nothing of when the arm has come to the next of {views} views; give [stages.poses] a command, or check one view at a time", path.display()
    )]
    NobodyMoves {
        /// The table.
        path: PathBuf,
        views: usize,
    },
    /// The table has no line for a tooth.
    #[error("{} has no pose of tooth {tooth}", path.display())]
    NotListed {
        /// The table.
        path: PathBuf,
        tooth: u32,
    },
    /// The table cannot be read.
    #[error("{}: {why}", path.display())]
    Table {
        /// The table.
        path: PathBuf,
        /// Line, and what is wrong.
        why: String,
    },
}

/// A view whose pose is requested.
#[derive(Clone, Debug, PartialEq)]
pub struct Wanted {
    /// View, from 1.
    pub view: usize,
    /// Tooth in its middle.
    pub tooth: u32,
    /// Requested pose of the camera.
    pub tool_from_camera: Rigid<Tool, Camera>,
}

impl Wanted {
    /// The stated pose, if it is valid and belongs to this view.
    fn checked(&self, stated: StatedPose) -> Result<StatedPose, PoseError> {
        let view = self.view;
        for (key, got, limit) in [
            ("u_mm", stated.u_mm, U_LIMIT[0]),
            ("u_mrad", stated.u_mrad, U_LIMIT[1]),
        ] {
            if !(got > 0.0 && got <= limit) {
                return Err(PoseError::Uncertainty {
                    view,
                    key,
                    got,
                    limit,
                });
            }
        }
        let pose = stated.rigid();
        let pose = pose.map_err(|source| PoseError::NoPose { view, source })?;
        let off = self.tool_from_camera.isometry().inverse() * pose.isometry();
        let (off_mm, off_mrad) = (off.translation.vector.norm(), 1e3 * off.rotation.angle());
        if off_mm > ELSEWHERE_MM || off_mrad > ELSEWHERE_MRAD {
            return Err(PoseError::Elsewhere {
                view,
                off_mm,
                off_mrad,
            });
        }
        Ok(stated)
    }
}

/// Source of camera poses, section of the station file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PoseSettings {
    /// Path of `poses.csv`; a relative path starts at the folder of the station file.
    pub file: Option<PathBuf>,
    /// Program and its arguments.
    pub command: Vec<String>,
    /// Longest time for an answer, s.
    pub limit_s: f64,
}

impl Default for PoseSettings {
    fn default() -> Self {
        Self {
            file: None,
            command: Vec::new(),
            limit_s: 10.0,
        }
    }
}

impl PoseSettings {
    /// Whether the poses come from a source other than the stages.
    pub fn is_some(&self) -> bool {
        self.file.is_some() || !self.command.is_empty()
    }

    /// Reads the table or starts the program, if one is configured.
    ///
    /// # Errors
    /// The table cannot be read, or the program not started.
    pub fn open(&self) -> Result<Option<PoseSource>, PoseError> {
        if let Some(path) = &self.file {
            return Ok(Some(PoseSource::Table(PoseTable::load(path)?)));
        }
        if self.command.is_empty() {
            return Ok(None);
        }
        let limit = Duration::from_secs_f64(self.limit_s);
        let program = PoseProgram::start(&self.command, limit)?;
        Ok(Some(PoseSource::Program(program)))
    }
}

/// An open source of camera poses.
#[derive(Debug)]
pub enum PoseSource {
    /// A file.
    Table(PoseTable),
    Program(PoseProgram),
}

#[cfg(test)]
fn wanted(view: usize) -> Wanted {
    Wanted {
        view,
        tooth: 12,
        tool_from_camera: Rigid::from_isometry(nalgebra::Isometry3::identity()),
    }
}
