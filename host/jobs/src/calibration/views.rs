//! Stage positions from which a target's plates are seen.

use flankscope_profilometry::calibrate::{Plate, StagePose, Target};

/// A view of a printed plate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PlateView {
    pub plate: usize,
    pub at: StagePose,
    /// Whether it is withheld from the adjustment as a test.
    pub kept_aside: bool,
}

/// The position of the stages that centres a plate in the field.
pub(super) fn facing(plate: &Plate) -> StagePose {
    StagePose::before(plate.tool_from_plate.translation_mm)
}

/// Every plate from each of its surrounding positions, in the order in which the target passes the head.
pub(super) fn of_target(target: &Target) -> Vec<PlateView> {
    let mut views: Vec<PlateView> = target
        .plate
        .iter()
        .enumerate()
        .flat_map(|(plate, place)| {
            let from = facing(place);
            let beside = target.beside.iter().enumerate();
            beside.map(move |(number, beside)| PlateView {
                plate,
                at: from.beside(*beside),
                kept_aside: number + 1 == target.beside.len(),
            })
        })
        .collect();
    views.sort_by(|a, b| a.at.rotation_rad.total_cmp(&b.at.rotation_rad));
    views
}
