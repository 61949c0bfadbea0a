//! Pose of a view in the mounting of its baseline.

use flankscope_metrology::registration::{Options, Prior};
use flankscope_metrology::wear::MountPose;
use flankscope_metrology::wear::mount::Seat;
use flankscope_metrology::wear::sensitivity::FoundMount;
use rayon::prelude::*;

use super::fit::{Fit, View};

/// Place of a view whose mounting can be compared; none on tools without a toothing, on those with a datum of their own, and
/// where no stage states the pose.
pub(super) fn seat<'a>(view: &View<'a>) -> Option<Seat<'a>> {
    let gear = view.tool.gear.as_ref()?;
    let inspect = view.tool.inspect.as_ref()?;
    let by_stages = inspect.datum_height_mm.is_empty() && view.place.stated.is_none();
    by_stages.then(|| Seat::new(gear, &view.place.zone, view.place.tooth))
}

/// Lays a view where the `recorded` mounting puts it. `None` where the lands do not confirm that mounting.
pub(super) fn fit_in(view: &View<'_>, recorded: MountPose) -> Option<Fit> {
    let seat = seat(view)?;
    let stages = &view.stages.tool_from_cloud;
    let expected = recorded.expected(stages);
    let located = view.points.par_iter().map(|&point| expected.apply(point));
    let located: Vec<[f64; 3]> = located.collect();
    let used = located.par_iter().map(|&point| seat.is_on_land(point));
    let used: Vec<bool> = used.collect();
    let lands = located.iter().zip(&used).filter(|(_, used)| **used);
    let lands: Vec<[f64; 3]> = lands.map(|(point, _)| *point).collect();
    let closest = view.place.surface.closest_many(&lands);
    let found = recorded.locate(
        &seat,
        stages,
        &closest,
        view.form_mm,
        view.mount_drift_mm,
        view.mount_mm,
    )?;
    let registration = found.registration;
    let prior = Prior {
        tool_from_cloud: registration.tool_from_cloud,
        pivot_mm: registration.centre_mm,
        covariance: registration.covariance,
    };
    Some(Fit {
        options: Options {
            initial: prior.tool_from_cloud,
            prior: Some(prior.clone()),
            ..Options::default()
        },
        registration,
        used,
        prior,
        same_mount: Some(FoundMount {
            recorded,
            approaches: (1.0 + 1.0 / view.approached) * view.approach,
            drifts: found.drifts,
            remounted: found.remounted,
        }),
    })
}
