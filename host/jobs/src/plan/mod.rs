//! Plans views from the tool's critical teeth and the head's geometry.

mod field;
mod further;
mod patch_view;

use flankscope_foundation::rigid::{Camera, Projector, Rigid, Stage};
use flankscope_metrology::gear::{Flank, GearKind};
use flankscope_metrology::tool::Tool;
use flankscope_profilometry::decode::MaskOptions;
use flankscope_profilometry::head::{LensDrive, Sensor};
use flankscope_profilometry::{DecodeError, DecodeOptions, Decoder, HeadModel, PatternSet};

pub(crate) use field::FieldOfView;
pub use field::NoVolume;
pub(crate) use further::further_views;
pub use patch_view::PatchViewError;
pub(crate) use patch_view::check_seen;

use flankscope_instrument::acquisition::{Program, Recording, StagePosition};
use flankscope_instrument::patterns::PatternLight;
use flankscope_instrument::poses::{PoseError, PoseTable, StatedPoses, Wanted};
use flankscope_instrument::settings::StationSettings;
use flankscope_metrology::kinematics::{Moves, SweptVolume};
use flankscope_metrology::view::{FurtherView, PlannedView};
use flankscope_record::document::{Recipe, RecordedRecipe};

/// All views of a check, with patterns and exposures.
#[derive(Clone, Debug, PartialEq)]
pub struct ViewPlan {
    /// The views, in the tool file's order.
    pub views: Vec<PlannedView>,
    /// Further views of their teeth, captured only if those leave something unseen; they are numbered after all others.
    pub further: Vec<FurtherView>,
    /// Fringe pattern set.
    pub patterns: PatternSet,
    /// Fraction of the light of all mirrors that each pass gives, if the patterns are shown in passes; empty: shown once by all mirrors.
    pub lit_ratios: Vec<f64>,
    /// Exposure times, ascending, µs.
    pub exposures_us: Vec<u32>,
    /// The head's liquid lens, if frames are captured through it.
    pub lens: Option<LensDrive>,
    /// The head's projectors, which show the patterns one after the other.
    pub projectors: usize,
    /// Whether a dark frame precedes each view.
    pub dark_frame: bool,
    /// The sensor, if it is not the one in the head file.
    pub sensor: Option<Sensor>,
    /// Height of the die's upper face, mm.
    pub top_mm: f64,
    /// Poses stated by a pose table or pose program, used instead of the stages'.
    pub stated: StatedPoses,
}

/// Why no plan can be made.
#[derive(Debug, thiserror::Error)]
pub enum PlanningError {
    /// The tool file has no teeth.
    #[error(
        "the tool has no [gear] and [inspect] section; a check of flanks and a scan need both, and [[patch]] tables are for inspect \
         (see docs/formats/tool.md)"
    )]
    NoGear,
    /// The head cannot see a patch.
    #[error(transparent)]
    Patch(#[from] PatchViewError),
    /// No teeth to inspect are named.
    #[error(
        "no tooth is to be inspected; name some with --teeth or in the tool file's inspect.teeth"
    )]
    NoTeeth,
    /// The gear has no tooth of this number.
    #[error("tooth {got} is not on this gear; it has teeth 1 to {teeth}")]
    NoSuchTooth {
        /// Requested number.
        got: u32,
        teeth: u32,
    },
    #[error("tooth {got} is named twice; once is enough")]
    Twice { got: u32 },
    #[error(
        "view {view} of the recording does not say which patch it shows; give the patch's place in the tool file as its `tooth`"
    )]
    Unnamed {
        /// Number of the view in the index.
        view: usize,
    },
    /// The index and the drawing disagree on the tooth in the middle of a view.
    #[error(
        "view {view} of the recording is of tooth {said}, but its angle has tooth {seen} in the middle; leave one of the two out, \
         or correct it"
    )]
    OtherTooth {
        /// View, from 1.
        view: usize,
        /// Tooth in the index.
        said: u32,
        seen: u32,
    },
    /// Two captures of a tooth are from different positions, so the second is no repetition.
    #[error(
        "tooth {tooth} is in the recording twice, from two places; a second capture of a view is taken from the place of the first"
    )]
    Elsewhere { tooth: u32 },
    #[error(
        "the head's window comes as near as {nearest_mm:.1} mm to the axis and the teeth reach out to {tip_mm:.1} mm: it would touch \
         them between {} and {} mm of height; an external gear is looked at from outside: correct stage_from_camera of the head file, \
         or gear.kind and tip_radius_mm of the tool file", heights_mm[0], heights_mm[1]
    )]
    TouchesOutside {
        /// Smallest distance of the window from the axis, mm.
        nearest_mm: f64,
        /// Radius of the tooth tips, mm.
        tip_mm: f64,
        /// Heights that the head passes, mm.
        heights_mm: [f64; 2],
    },
    #[error(
        "the head's window reaches {reach_mm:.1} mm from the axis and the bore is open to {bore_mm:.1} mm: it would touch the teeth \
         between {} and {} mm of height; correct stage_from_camera of the head file or tip_radius_mm of the tool file", heights_mm[0], heights_mm[1]
    )]
    Touches {
        /// Largest distance of the window from the axis, mm.
        reach_mm: f64,
        /// Radius of the tooth tips, mm.
        bore_mm: f64,
        /// Heights that the head passes, mm.
        heights_mm: [f64; 2],
    },
    /// Too many views for one plan.
    #[error("{got} teeth are too many for one check; at most {limit}")]
    TooMany {
        /// Number of views.
        got: usize,
        /// Most views of a plan.
        limit: usize,
    },
    /// The head file has no patterns or exposures.
    #[error("the head file has no {what}; a check needs it (see docs/formats/head.md)")]
    HeadLacks {
        /// The missing entry.
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
    /// A tooth does not exist, or the tool or head file lacks an entry.
    pub fn new(
        tool: &Tool,
        head: &HeadModel,
        teeth: Option<&[u32]>,
    ) -> Result<Self, PlanningError> {
        let inspected = tool.inspected();
        let teeth = teeth.unwrap_or(&inspected);
        let limit = flankscope_protocol::plan::MAX_VIEWS;
        if teeth.len() > limit {
            return Err(PlanningError::TooMany {
                got: teeth.len(),
                limit,
            });
        }
        let views = Self::looking_at(tool, head, teeth)?;
        let lacks = |what| PlanningError::HeadLacks { what };
        let patterns = head.patterns()?.ok_or(lacks("pattern_set"))?;
        if head.exposures_us.is_empty() {
            return Err(lacks("exposures_us"));
        }
        if head.stage_from_camera.is_none() {
            return Err(lacks("stage_from_camera"));
        }
        Ok(Self {
            further: further_views(tool, head, &views),
            views,
            patterns,
            lit_ratios: PatternLight::of(head).lit_ratios,
            exposures_us: head.exposures_us.clone(),
            lens: head.lens,
            projectors: head.projectors(),
            dark_frame: true,
            sensor: None,
            top_mm: tool.top_mm(),
            stated: StatedPoses::default(),
        })
    }

    /// All views by number: the planned ones, then the further ones.
    pub fn all_views(&self) -> impl Iterator<Item = &PlannedView> {
        self.views
            .iter()
            .chain(self.further.iter().map(|further| &further.view))
    }

    /// Numbers of the further views of a tooth that are for one of these flanks.
    pub fn further_of(&self, tooth: u32, flanks: &[Flank]) -> Vec<usize> {
        let is_for = |of: &FurtherView| {
            let of_flank = of.flank.is_none_or(|flank| flanks.contains(&flank));
            of.view.tooth == tooth && of_flank && !flanks.is_empty()
        };
        let further = self.further.iter().enumerate();
        let further = further.filter(|(_, of)| is_for(of));
        further.map(|(at, _)| self.views.len() + at).collect()
    }

    /// The view of one tooth or patch, with a way there that touches nothing: of the given one, else of the tool file's first.
    ///
    /// # Errors
    /// As [`Self::new`], or the head would touch the die on its way.
    pub(crate) fn of_one(
        tool: &Tool,
        head: &HeadModel,
        station: &StationSettings,
        tooth: Option<u32>,
    ) -> Result<Self, PlanningError> {
        let first = tool.inspected().first().copied();
        let teeth: Vec<u32> = tooth.or(first).into_iter().collect();
        let plan = Self::new(tool, head, Some(&teeth))?;
        plan.check_way(tool, head, station)?;
        Ok(plan)
    }

    /// The same plan with the patterns shown in other light.
    pub(crate) fn lit(mut self, light: PatternLight) -> Self {
        self.lit_ratios = light.lit_ratios;
        self
    }

    pub(crate) fn light(&self) -> PatternLight {
        PatternLight {
            lit_ratios: self.lit_ratios.clone(),
        }
    }

    /// Positions of the stages that centre each of these teeth or patches in a view.
    ///
    /// # Errors
    /// None are named, or some do not exist or are not visible to the head.
    pub(crate) fn looking_at(
        tool: &Tool,
        head: &HeadModel,
        numbers: &[u32],
    ) -> Result<Vec<PlannedView>, PlanningError> {
        match &tool.gear {
            None if !tool.patches.is_empty() => Self::of_patches(tool, head, numbers),
            _ => Self::nominal(tool, numbers),
        }
    }

    /// Positions of the stages that centre each of these teeth in a view.
    ///
    /// # Errors
    /// No teeth are named, or some do not exist.
    pub fn nominal(tool: &Tool, teeth: &[u32]) -> Result<Vec<PlannedView>, PlanningError> {
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
        close_ranks(&mut angles_of(&mut views));
        Ok(views)
    }

    /// Positions of the stages that centre each of these patches in a view.
    fn of_patches(
        tool: &Tool,
        head: &HeadModel,
        numbers: &[u32],
    ) -> Result<Vec<PlannedView>, PlanningError> {
        if numbers.is_empty() {
            return Err(PlanningError::NoTeeth);
        }
        for (i, &got) in numbers.iter().enumerate() {
            if numbers.iter().take(i).any(|&earlier| earlier == got) {
                return Err(PlanningError::Twice { got });
            }
        }
        let mut views = patch_view::nominal(tool, head, numbers)?;
        for view in &mut views {
            view.rotation_rad = wrapped(view.rotation_rad);
        }
        close_ranks(&mut angles_of(&mut views));
        Ok(views)
    }

    /// Views of a recording, with patterns and exposures of its plan.
    pub(crate) fn of_recording(
        recording: &Recording,
        (views, further): (Vec<PlannedView>, Vec<FurtherView>),
        tool: &Tool,
        head: &HeadModel,
    ) -> Self {
        let plan = &recording.plan;
        Self {
            views,
            further,
            patterns: plan.patterns.clone(),
            lit_ratios: recording.index.lit_ratios.clone(),
            exposures_us: plan.exposures_us.clone(),
            lens: None,
            projectors: head.projectors(),
            dark_frame: plan.dark_frame,
            sensor: plan.sensor.filter(|of| head.sensor != Some(*of)),
            top_mm: tool.top_mm(),
            stated: StatedPoses::default(),
        }
    }

    /// The views of a check that was stored with this recipe.
    pub(crate) fn of_recipe(
        tool: &Tool,
        head: &HeadModel,
        recipe: &Recipe,
    ) -> Result<Self, PlanningError> {
        let Some(recorded) = &recipe.recorded else {
            let light = PatternLight {
                lit_ratios: recipe.lit_ratios.clone(),
            };
            return Ok(Self::new(tool, head, Some(&recipe.teeth))?.lit(light));
        };
        let RecordedRecipe {
            views,
            further,
            patterns,
            dark_frame,
            sensor,
            poses,
        } = recorded.clone();
        Ok(Self {
            views,
            further,
            patterns: patterns.checked()?,
            lit_ratios: recipe.lit_ratios.clone(),
            exposures_us: recipe.exposures_us.clone(),
            lens: None,
            projectors: head.projectors(),
            dark_frame,
            sensor,
            top_mm: tool.top_mm(),
            stated: poses.into_iter().collect(),
        })
    }

    /// Checks that the head has enough space on its way through the views.
    ///
    /// # Errors
    /// The head would touch the teeth (of an internal gear from inside, of an external one from outside) or the CAD with the patches.
    pub(crate) fn check_way(
        &self,
        tool: &Tool,
        head: &HeadModel,
        settings: &StationSettings,
    ) -> Result<(), PlanningError> {
        let Some(hand_eye) = &head.stage_from_camera else {
            return Ok(());
        };
        let second = head.second_projector.as_ref();
        let projectors = [head.projector_from_camera].into_iter();
        let projectors = projectors.chain(second.map(|second| second.projector_from_camera));
        let projectors = projectors.map(|pose| pose.rigid::<Projector, Camera>());
        let (Ok(hand_eye), Ok(projectors)) = (
            hand_eye.rigid::<Stage, Camera>(),
            projectors.collect::<Result<Vec<_>, _>>(),
        ) else {
            return Ok(());
        };
        let views = self.all_views().map(|v| (v.rotation_rad, v.vertical_mm));
        let out_mm = self.top_mm + settings.stages.clearance_mm;
        let moves = settings.stages.moves;
        let Some(gear) = &tool.gear else {
            return match moves {
                // The external positioner is responsible for a free way.
                Moves::Outside => Ok(()),
                Moves::Die | Moves::Head => Ok(patch_view::check_way(
                    tool,
                    &self.views,
                    out_mm,
                    hand_eye,
                    &projectors,
                )?),
            };
        };
        let swept = SweptVolume::of(moves, views, out_mm, hand_eye, &projectors);
        if swept.heights_mm[0] >= gear.height_mm[1] {
            return Ok(());
        }
        let SweptVolume {
            reach_mm,
            nearest_mm,
            heights_mm,
            ..
        } = swept;
        let tip_mm = gear.tip_radius_mm;
        match gear.kind {
            GearKind::Internal if reach_mm >= tip_mm => Err(PlanningError::Touches {
                reach_mm,
                bore_mm: tip_mm,
                heights_mm,
            }),
            GearKind::External if nearest_mm <= tip_mm => Err(PlanningError::TouchesOutside {
                nearest_mm,
                tip_mm,
                heights_mm,
            }),
            GearKind::Internal | GearKind::External => Ok(()),
        }
    }

    /// Decoder of its frames; with a mask, every point has the fringe modulation of its neighbourhood.
    ///
    /// # Errors
    /// The head file does not fit these patterns.
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

    /// Request to the pose program for a view.
    pub(crate) fn wanted(&self, view: usize, stage_from_camera: Rigid<Stage, Camera>) -> Wanted {
        let planned = &self.views[view];
        Wanted {
            view: view + 1,
            tooth: planned.tooth,
            tool_from_camera: planned.tool_from_camera(stage_from_camera),
        }
    }

    /// Takes the poses of all views from a table.
    ///
    /// # Errors
    /// A pose is missing or cannot be used.
    pub(crate) fn take_poses(
        &self,
        table: &PoseTable,
        stage_from_camera: Rigid<Stage, Camera>,
    ) -> Result<(), PoseError> {
        for view in 0..self.views.len() {
            let pose = table.reach(&self.wanted(view, stage_from_camera))?;
            self.stated.insert(view, pose);
        }
        Ok(())
    }

    /// The acquisition program: stage positions, patterns and exposures.
    pub(crate) fn program(&self, settings: &StationSettings) -> Program {
        let position = |view: &PlannedView| {
            StagePosition::of(view.rotation_rad, view.vertical_mm, &settings.stages)
        };
        Program {
            positions: self.all_views().map(position).collect(),
            patterns: self.patterns.clone(),
            lit_ratios: self.lit_ratios.clone(),
            exposures_us: self.exposures_us.clone(),
            retract_mm: match settings.stages.moves {
                Moves::Outside => settings.stages.vertical.home_mm,
                Moves::Die | Moves::Head => self.top_mm + settings.stages.clearance_mm,
            },
            timing: settings.timing.clone(),
            light: settings.light.clone(),
            stage: settings.stages.config(),
            lens: self.lens,
            projectors: self.projectors,
        }
    }
}

/// The rotation angles of views.
fn angles_of(views: &mut [PlannedView]) -> Vec<&mut f64> {
    views.iter_mut().map(|v| &mut v.rotation_rad).collect()
}

/// The same angle in −π..π.
fn wrapped(angle_rad: f64) -> f64 {
    let turn = std::f64::consts::TAU;
    angle_rad - (angle_rad / turn).round() * turn
}

/// Shifts angles within ±π by a whole turn if that brings them nearer to the others: neighbours on both sides of ±π are then one
/// step apart, not a turn.
fn close_ranks(angles_rad: &mut [&mut f64]) {
    let turn = std::f64::consts::TAU;
    angles_rad.sort_by(|a, b| a.total_cmp(b));
    let (Some(first), Some(last)) = (angles_rad.first(), angles_rad.last()) else {
        return;
    };
    // The largest gap between angles; at ±π unless another gap is clearly larger.
    let (mut widest, mut after) = (**first + turn - **last + 1e-6, 0);
    for (at, pair) in angles_rad.windows(2).enumerate() {
        let gap = *pair[1] - *pair[0];
        if gap > widest {
            (widest, after) = (gap, at + 1);
        }
    }
    let (below, above) = angles_rad.split_at_mut(after);
    // The smaller group is shifted, so that the stage stays near its middle.
    if below.len() < above.len() {
        below.iter_mut().for_each(|angle| **angle += turn);
    } else if after > 0 {
        above.iter_mut().for_each(|angle| **angle -= turn);
    }
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
