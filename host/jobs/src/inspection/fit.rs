//! Registration of one view to the CAD, on the surfaces that the tool file selects.

use flankscope_metrology::registration::{Options, Prior, Registration, register};
use flankscope_metrology::tool::Tool;
use flankscope_metrology::wear::sensitivity::FoundMount;
use nalgebra::Matrix6;
use rayon::prelude::*;

use super::datum;
use super::place::Place;

/// A view before its registration.
pub(super) struct View<'a> {
    pub place: &'a Place,
    pub tool: &'a Tool,
    /// Points in the camera frame, mm.
    pub points: &'a [[f64; 3]],
    /// Expected pose with its covariance, from the stages.
    pub stages: Prior,
    /// The part of that covariance that is drawn anew at every approach.
    pub approach: Matrix6<f64>,
    /// Number of approaches of the same view by which the baseline knows its mounting.
    pub approached: f64,
    /// Standard uncertainty of a flank's form since a baseline, mm.
    pub form_mm: f64,
    /// Standard uncertainty of the mounting's position since a baseline, along each axis, mm; none where it is not stated.
    pub mount_drift_mm: Option<f64>,
    /// Standard uncertainty of a new mounting's position, along each axis, mm.
    pub mount_mm: f64,
}

/// A view registered to the CAD.
pub(super) struct Fit {
    pub registration: Registration,
    /// For every point, whether the fit used it.
    pub used: Vec<bool>,
    /// Expected pose with its covariance that the fit was given.
    pub prior: Prior,
    pub options: Options,
    /// The baseline's mounting, where the pose rests on it.
    pub same_mount: Option<FoundMount>,
}

impl View<'_> {
    /// On the surfaces that the tool file selects, beginning at the stages' pose.
    pub fn fit_on_datum(&self) -> Fit {
        let (place, prior) = (self.place, &self.stages);
        // By the stages' pose, which is off by hundredths of a millimetre.
        let pose = &prior.tool_from_cloud;
        let expected = self.points.par_iter().map(|&point| pose.apply(point));
        let expected: Vec<[f64; 3]> = expected.collect();
        let used = datum::used(self.tool, &[place.tooth], &place.surface, &expected);
        let points = self.points.iter().zip(&used);
        let points = points.filter(|(_, used)| **used).map(|(point, _)| *point);
        let points: Vec<[f64; 3]> = points.collect();
        let options = Options {
            initial: prior.tool_from_cloud,
            prior: Some(prior.clone()),
            teeth: self.tool.features().gear().map(|gear| gear.teeth),
            ..Options::default()
        };
        Fit {
            registration: register(&*place.surface, &points, None, &options),
            used,
            prior: prior.clone(),
            options,
            same_mount: None,
        }
    }
}
