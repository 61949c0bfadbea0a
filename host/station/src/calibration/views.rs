//! Where the stages go to see a target's plates.

use flankscope_profilometry::calibrate::{Plate, StagePose, Target};

/// Beyond facing each plate: turned (rad) and raised (mm), for the adjustment.
const ASKEW: [[f64; 2]; 2] = [[0.05, 0.8], [-0.05, -0.8]];
/// The same for the view that is kept aside.
const ASIDE: [f64; 2] = [0.02, -0.4];

/// A view of a printed plate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PlateView {
    pub plate: usize,
    pub at: StagePose,
    /// Takes no part in the adjustment.
    pub kept_aside: bool,
}

/// The stages' position that puts a plate in the middle of the field.
pub(super) fn facing(plate: &Plate) -> StagePose {
    StagePose::before(plate.tool_from_plate.translation_mm)
}

/// Every plate three times, in the order in which the target turns by.
pub(super) fn of_target(target: &Target) -> Vec<PlateView> {
    let mut views: Vec<PlateView> = target
        .plate
        .iter()
        .enumerate()
        .flat_map(|(plate, place)| {
            let from = facing(place);
            let askew = ASKEW.map(|offset| (offset, false));
            askew.into_iter().chain([(ASIDE, true)]).map(
                move |([turned_rad, raised_mm], kept_aside)| PlateView {
                    plate,
                    at: StagePose {
                        rotation_rad: from.rotation_rad + turned_rad,
                        vertical_mm: from.vertical_mm + raised_mm,
                    },
                    kept_aside,
                },
            )
        })
        .collect();
    views.sort_by(|a, b| a.at.rotation_rad.total_cmp(&b.at.rotation_rad));
    views
}
