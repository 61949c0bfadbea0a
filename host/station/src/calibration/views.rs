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
    before(plate.tool_from_plate.translation_mm)
}

/// The stages' position that puts a place of the target in the middle of the field.
pub(super) fn before([x, y, z]: [f64; 3]) -> StagePose {
    StagePose {
        rotation_rad: -y.atan2(x),
        vertical_mm: z,
    }
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
                at: StagePose {
                    rotation_rad: from.rotation_rad + beside.turned_rad,
                    vertical_mm: from.vertical_mm + beside.raised_mm,
                },
                kept_aside: number + 1 == target.beside.len(),
            })
        })
        .collect();
    views.sort_by(|a, b| a.at.rotation_rad.total_cmp(&b.at.rotation_rad));
    views
}
