//! From the tool's critical teeth and the head's geometry to a plan of views.

use flankscope_foundation::rigid::{Camera, Rigid, Stage, Tool as ToolFrame};
use flankscope_metrology::gear::GearData;
use flankscope_metrology::tool::Tool;
use flankscope_profilometry::decode::MaskOptions;
use flankscope_profilometry::head::Sensor;
use flankscope_profilometry::{DecodeError, DecodeOptions, Decoder, HeadModel, PatternSet};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use super::evidence::{Recipe, RecordedRecipe};
use crate::acquisition::{Program, Recording, StagePosition};
use crate::settings::StationSettings;

/// One view: which tooth is in its middle, and where the stages must stand.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlannedView {
    /// Tooth in the middle of the field.
    pub tooth: u32,
    /// Commanded angle of the rotary stage, rad.
    pub rotation_rad: f64,
    /// Commanded position of the vertical stage, mm.
    pub vertical_mm: f64,
}

impl PlannedView {
    /// The views of these teeth, as the tool file has them.
    ///
    /// # Errors
    /// Teeth that are not there, or a tool without gear.
    pub fn of_teeth(tool: &Tool, teeth: &[u32]) -> Result<Vec<Self>, PlanningError> {
        ViewPlan::nominal(tool, teeth)
    }

    /// Where the camera stands when the stages are where they were told.
    pub(crate) fn tool_from_camera(
        &self,
        stage_from_camera: Rigid<Stage, Camera>,
    ) -> Rigid<ToolFrame, Camera> {
        tool_from_stage(self.rotation_rad) * lifted(self.vertical_mm, stage_from_camera)
    }
}

/// All views of a check and how each is exposed.
#[derive(Clone, Debug, PartialEq)]
pub struct ViewPlan {
    /// The views, in the tool file's order.
    pub views: Vec<PlannedView>,
    /// Fringe patterns.
    pub patterns: PatternSet,
    /// Exposure times, ascending, µs.
    pub exposures_us: Vec<u32>,
    /// Whether a dark frame precedes each view.
    pub dark_frame: bool,
    /// The sensor that counted, where it is not the one of the head's file.
    pub sensor: Option<Sensor>,
    /// Upper face of the die, mm.
    pub top_mm: f64,
}

/// Why no plan can be made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PlanningError {
    /// The tool file says nothing about teeth.
    #[error(
        "the tool has no [gear] and [inspect] section; a check needs both (see docs/formats.md)"
    )]
    NoGear,
    /// No teeth to inspect.
    #[error(
        "no tooth is to be inspected; name some with --teeth or in the tool file's inspect.teeth"
    )]
    NoTeeth,
    /// A tooth that the gear does not have.
    #[error("tooth {got} is not on this gear; it has teeth 1 to {teeth}")]
    NoSuchTooth {
        /// Asked for.
        got: u32,
        /// Teeth of the gear.
        teeth: u32,
    },
    /// A tooth was named twice.
    #[error("tooth {got} is named twice; once is enough")]
    Twice {
        /// The tooth.
        got: u32,
    },
    /// Index and drawing differ.
    #[error(
        "view {view} of the recording is of tooth {said}, but its angle has tooth {seen} in the middle; leave one of the two out, \
         or correct it"
    )]
    OtherTooth {
        /// View, from 1.
        view: usize,
        /// As the index says.
        said: u32,
        /// By its angle.
        seen: u32,
    },
    /// Two captures of a tooth that are no repetition.
    #[error(
        "tooth {tooth} is in the recording twice, from two places; a second capture of a view is taken from the place of the first"
    )]
    Elsewhere {
        /// The tooth.
        tooth: u32,
    },
    /// Too many views for one plan.
    #[error("{got} teeth are too many for one check; at most {limit}")]
    TooMany {
        /// Asked for.
        got: usize,
        /// Most views of a plan.
        limit: usize,
    },
    /// The head file names no patterns or exposures.
    #[error("the head file has no {what}; a check needs it (see docs/formats.md)")]
    HeadLacks {
        /// What is missing.
        what: &'static str,
    },
    /// The pattern set's name is unknown.
    #[error(transparent)]
    Pattern(#[from] flankscope_profilometry::pattern::PatternError),
}

impl ViewPlan {
    /// The views for the tool's critical teeth, or for `teeth` instead.
    ///
    /// # Errors
    /// Teeth that are not there, or a tool or head file without what a check needs.
    pub fn new(
        tool: &Tool,
        head: &HeadModel,
        teeth: Option<&[u32]>,
    ) -> Result<Self, PlanningError> {
        let (Some(gear), Some(inspect)) = (&tool.gear, &tool.inspect) else {
            return Err(PlanningError::NoGear);
        };
        let teeth = teeth.unwrap_or(&inspect.teeth);
        let limit = flankscope_protocol::plan::MAX_VIEWS;
        if teeth.len() > limit {
            return Err(PlanningError::TooMany {
                got: teeth.len(),
                limit,
            });
        }
        let views = Self::nominal(tool, teeth)?;
        let lacks = |what| PlanningError::HeadLacks { what };
        let patterns = PatternSet::named(head.pattern_set.as_deref().ok_or(lacks("pattern_set"))?)?;
        if head.exposures_us.is_empty() {
            return Err(lacks("exposures_us"));
        }
        if head.stage_from_camera.is_none() {
            return Err(lacks("stage_from_camera"));
        }
        let top_mm = gear.height_mm[1];
        Ok(Self {
            views,
            patterns,
            exposures_us: head.exposures_us.clone(),
            dark_frame: true,
            sensor: None,
            top_mm,
        })
    }

    /// Where the stages stand to have each of these teeth in the middle of a view.
    ///
    /// # Errors
    /// No teeth, or such that are not there.
    pub(crate) fn nominal(tool: &Tool, teeth: &[u32]) -> Result<Vec<PlannedView>, PlanningError> {
        let (Some(gear), Some(inspect)) = (&tool.gear, &tool.inspect) else {
            return Err(PlanningError::NoGear);
        };
        if teeth.is_empty() {
            return Err(PlanningError::NoTeeth);
        }
        let mut views = Vec::with_capacity(teeth.len());
        for (i, &tooth) in teeth.iter().enumerate() {
            if tooth == 0 || tooth > gear.teeth {
                return Err(PlanningError::NoSuchTooth {
                    got: tooth,
                    teeth: gear.teeth,
                });
            }
            if teeth.iter().take(i).any(|&earlier| earlier == tooth) {
                return Err(PlanningError::Twice { got: tooth });
            }
            // The die is turned until the tooth's centre lies on the stage's +x axis, where the camera looks.
            let rotation_rad = wrapped(-gear.tooth_centre_rad(tooth));
            views.push(PlannedView {
                tooth,
                rotation_rad,
                vertical_mm: inspect.height_mm,
            });
        }
        let mut angles_rad: Vec<&mut f64> = views.iter_mut().map(|v| &mut v.rotation_rad).collect();
        close_ranks(&mut angles_rad);
        Ok(views)
    }

    /// Views of a recording, exposed as its plan says.
    pub(crate) fn of_recording(
        recording: &Recording,
        views: Vec<PlannedView>,
        gear: &GearData,
        head: &HeadModel,
    ) -> Self {
        let plan = &recording.plan;
        Self {
            views,
            patterns: plan.patterns.clone(),
            exposures_us: plan.exposures_us.clone(),
            dark_frame: plan.dark_frame,
            sensor: plan.sensor.filter(|of| head.sensor != Some(*of)),
            top_mm: gear.height_mm[1],
        }
    }

    /// The views of a check that was stored with this recipe.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub(crate) fn of_recipe(
        tool: &Tool,
        head: &HeadModel,
        recipe: &Recipe,
    ) -> Result<Self, PlanningError> {
        let Some(recorded) = &recipe.recorded else {
            return Self::new(tool, head, Some(&recipe.teeth));
        };
        let gear = tool.gear.as_ref().ok_or(PlanningError::NoGear)?;
        let RecordedRecipe {
            views,
            patterns,
            dark_frame,
            sensor,
        } = recorded.clone();
        Ok(Self {
            views,
            patterns: patterns.checked()?,
            exposures_us: recipe.exposures_us.clone(),
            dark_frame,
            sensor,
            top_mm: gear.height_mm[1],
        })
    }

    /// What makes points of its frames; with a mask, every point says how much the fringes oscillate around it.
    ///
    /// # Errors
    /// The head cannot decode these patterns.
    pub fn decoder(
        &self,
        head: &HeadModel,
        mask: Option<MaskOptions>,
    ) -> Result<Decoder, DecodeError> {
        let head = HeadModel {
            sensor: self.sensor.or(head.sensor),
            ..head.clone()
        };
        let options = DecodeOptions {
            mask,
            dark_frame: self.dark_frame,
            ..DecodeOptions::for_head(&head).with_smoothed_orders()
        };
        Decoder::new(&head, &self.patterns, &self.exposures_us, options)
    }

    /// What it asks of stages, projector and camera.
    pub(crate) fn program(&self, settings: &StationSettings) -> Program {
        let position = |view: &PlannedView| StagePosition {
            rotation_rad: view.rotation_rad,
            vertical_mm: view.vertical_mm,
        };
        Program {
            positions: self.views.iter().map(position).collect(),
            patterns: self.patterns.clone(),
            exposures_us: self.exposures_us.clone(),
            retract_mm: self.top_mm + settings.stages.clearance_mm,
            timing: settings.timing.clone(),
            light: settings.light.clone(),
        }
    }

    /// The views in the order of the shortest way for a rotary stage that stands at `rotation_rad`: from the nearer end
    /// of the sweep to the other.
    #[must_use]
    pub fn order_from(&self, rotation_rad: f64) -> Vec<usize> {
        let mut order: Vec<usize> = (0..self.views.len()).collect();
        let angle = |&view: &usize| self.views[view].rotation_rad;
        order.sort_by(|a, b| angle(a).total_cmp(&angle(b)));
        let (Some(first), Some(last)) = (order.first().map(angle), order.last().map(angle)) else {
            return order;
        };
        if (last - rotation_rad).abs() < (first - rotation_rad).abs() {
            order.reverse();
        }
        order
    }
}

/// The same angle in −π..π.
fn wrapped(angle_rad: f64) -> f64 {
    let turn = std::f64::consts::TAU;
    angle_rad - (angle_rad / turn).round() * turn
}

/// Turns angles within half a turn either way by a whole turn where that takes them nearer to the others: neighbours on both
/// sides of the half turn are then a step apart, not a turn.
fn close_ranks(angles_rad: &mut [&mut f64]) {
    let turn = std::f64::consts::TAU;
    angles_rad.sort_by(|a, b| a.total_cmp(b));
    let (Some(first), Some(last)) = (angles_rad.first(), angles_rad.last()) else {
        return;
    };
    // Where no angle is for longest; across the half turn unless clearly elsewhere.
    let (mut widest, mut after) = (**first + turn - **last + 1e-6, 0);
    for (at, pair) in angles_rad.windows(2).enumerate() {
        let gap = *pair[1] - *pair[0];
        if gap > widest {
            (widest, after) = (gap, at + 1);
        }
    }
    let (below, above) = angles_rad.split_at_mut(after);
    // Those on the side with fewer go round, so that the stage stays about its middle.
    if below.len() < above.len() {
        below.iter_mut().for_each(|angle| **angle += turn);
    } else if after > 0 {
        above.iter_mut().for_each(|angle| **angle -= turn);
    }
}

/// The die turns by the commanded angle; seen from the die, the stage turns the other way.
fn tool_from_stage(rotation_rad: f64) -> Rigid<ToolFrame, Stage> {
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -rotation_rad);
    Rigid::from_isometry(Isometry3::from_parts(Translation3::identity(), turn))
}

/// The vertical stage raises the head.
fn lifted(vertical_mm: f64, stage_from_camera: Rigid<Stage, Camera>) -> Rigid<Stage, Camera> {
    Rigid::from_isometry(Translation3::new(0.0, 0.0, vertical_mm) * stage_from_camera.isometry())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn closed(mut degrees: Vec<f64>) -> Vec<f64> {
        let mut radians: Vec<f64> = degrees.drain(..).map(f64::to_radians).collect();
        close_ranks(&mut radians.iter_mut().collect::<Vec<_>>());
        radians.iter().map(|a| a.to_degrees().round()).collect()
    }

    #[test]
    fn neighbours_across_the_half_turn_are_a_step_apart() {
        assert_eq!(
            closed(vec![-170.0, -175.0, 179.0]),
            [-170.0, -175.0, -181.0]
        );
        assert_eq!(closed(vec![-179.0, 175.0, 170.0]), [181.0, 175.0, 170.0]);
    }

    #[test]
    fn angles_that_stand_well_stay() {
        for well in [
            vec![-49.0, -169.0, 71.0],
            vec![10.0, -10.0],
            vec![180.0],
            vec![],
        ] {
            assert_eq!(closed(well.clone()), well);
        }
    }
}
