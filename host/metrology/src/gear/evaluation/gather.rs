//! Points by the flank that they lie on, cloud after cloud: a whole die at full density need not be in memory as one.

use std::collections::BTreeMap;

use rayon::prelude::*;

use super::limits::EvaluationRange;
use super::not_told::{NotTold, split};
use super::{
    EvaluationSettings, FlankFigures, GearEvaluation, GearEvaluationError, PointNearFlank, axis,
    check, flank, pitch, ratings, runout,
};
use crate::gear::{Flank, GearData};

/// Clouds of one gear on their way to its evaluation.
#[derive(Debug)]
pub struct Gathering<'a> {
    gear: &'a GearData,
    settings: &'a EvaluationSettings,
    limits: EvaluationRange,
    flanks: BTreeMap<(u32, Flank), Vec<[f32; 3]>>,
    /// Points that were handed over, on flanks or not.
    offered: usize,
}

/// Points gathered on one flank.
pub(super) struct OwnPoints {
    pub tooth: u32,
    pub flank: Flank,
    /// Roll length, height, and deviation from the involute, mm. The last is short, so single precision keeps it to 1e-8 mm;
    /// of the other two it keeps where on the flank it is, which is asked for to some µm.
    kept: Vec<[f32; 3]>,
}

impl OwnPoints {
    pub fn len(&self) -> usize {
        self.kept.len()
    }

    pub fn points(&self) -> impl Iterator<Item = PointNearFlank> + '_ {
        self.kept.iter().map(|kept| {
            let [roll_mm, height_mm, deviation_mm] = kept.map(f64::from);
            PointNearFlank {
                roll_mm,
                height_mm,
                deviation_mm,
            }
        })
    }

    /// Takes a share out of every deviation, mm.
    pub fn take_out(&mut self, share_mm: impl Fn(&PointNearFlank) -> f64) {
        let shares: Vec<f64> = self.points().map(|point| share_mm(&point)).collect();
        for (kept, share) in self.kept.iter_mut().zip(shares) {
            kept[2] = (f64::from(kept[2]) - share) as f32;
        }
    }
}

impl<'a> Gathering<'a> {
    /// Begins without a point.
    ///
    /// # Errors
    /// [`GearEvaluationError`]: a gear or settings out of scope.
    pub fn new(
        gear: &'a GearData,
        settings: &'a EvaluationSettings,
    ) -> Result<Self, GearEvaluationError> {
        check(gear, settings)?;
        Ok(Self {
            gear,
            settings,
            limits: EvaluationRange::new(gear, settings),
            flanks: BTreeMap::new(),
            offered: 0,
        })
    }

    /// Adds a cloud in tool coordinates (finite points, mm).
    pub fn add(&mut self, points: &[[f64; 3]]) {
        self.offered += points.len();
        let (gear, capture_mm) = (self.gear, self.settings.capture_mm);
        let on_flanks: Vec<_> = points
            .par_iter()
            .filter_map(|&point| self.limits.flank_point(gear, point, capture_mm))
            .collect();
        for (key, point) in on_flanks {
            let kept = [point.roll_mm, point.height_mm, point.deviation_mm];
            let of_flank = self.flanks.entry(key).or_default();
            of_flank.push(kept.map(|value| value as f32));
        }
    }

    /// Evaluates all that was added.
    ///
    /// # Errors
    /// [`GearEvaluationError`]: clouds that are not on the flanks, an axis that is not fixed.
    pub fn evaluated(self) -> Result<GearEvaluation, GearEvaluationError> {
        let (gear, settings, limits) = (self.gear, self.settings, self.limits);
        let mut own: Vec<OwnPoints> = self
            .flanks
            .into_iter()
            .map(|((tooth, flank), kept)| OwnPoints { tooth, flank, kept })
            .collect();
        let points = own.iter().map(OwnPoints::len).sum();
        if 10 * points < self.offered || points == 0 {
            return Err(GearEvaluationError::NotOnFlanks {
                near: points,
                points: self.offered,
                capture_mm: settings.capture_mm,
            });
        }
        let axis = axis::fit(gear, &own);
        if settings.best_fit_axis {
            let motion = axis.as_ref().ok_or(GearEvaluationError::AxisNotFixed)?;
            own.par_iter_mut()
                .for_each(|own| motion.take_out(gear, own));
        }
        let figures = |own: &OwnPoints| flank::figures(gear, own, &limits, settings);
        let flanks: Vec<FlankFigures> = own.par_iter().map(figures).collect();
        let [left, right] = Flank::BOTH.map(|side| pitch(gear, &flanks, side));
        let (runout_um, runout_not_told) = split(runout(gear, &flanks, [&left, &right]));
        let mut evaluation = GearEvaluation {
            limits,
            axis_not_told: axis.is_none().then_some(NotTold::Axis),
            axis,
            about_best_fit_axis: settings.best_fit_axis,
            points,
            flanks,
            left,
            right,
            runout_um,
            runout_not_told,
            ratings: Vec::new(),
        };
        evaluation.ratings = ratings(gear, &evaluation, settings);
        Ok(evaluation)
    }
}
