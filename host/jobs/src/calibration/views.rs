//! Where the stages go to see a target's plates.

use flankscope_profilometry::calibrate::{Plate, StagePose, Target};

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

/// Every plate from each place beside it, in the order in which the target turns by.
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
