//! Plates that took no part in the adjustment, measured with its result.

use super::form;
use super::sighting::{Mark, Sighting};
use super::target::Target;
use crate::cloud::CellColumn;
use crate::head::{HeadModel, HoldOut};
use crate::triangulate::HeadTriangulator;

/// Measures the plates of some views with a head. `None` if there is none, or one cannot be measured at all.
pub fn hold_out(
    head: &HeadModel,
    target: &Target,
    views: &[(Sighting, Vec<CellColumn>)],
) -> Option<HoldOut> {
    let triangulator = HeadTriangulator::new(head);
    let (mut points, mut squares, mut worst) = (0.0, 0.0, 0.0_f64);
    let (mut dots, mut dot_squares) = (0.0, 0.0);
    for (sighting, cells) in views {
        let cloud = triangulator.points(cells);
        let off = form::plane(&cloud)?;
        points += cloud.len() as f64;
        squares += off.rms_mm().powi(2) * cloud.len() as f64;
        worst = worst.max(off.range_mm());
        let printed = |mark: &Mark| {
            let [x, y] = mark.place.map(|n| f64::from(n) * target.dots.pitch_mm);
            Some((triangulator.point(mark.pixel, mark.column_px)?, [x, y, 0.0]))
        };
        let pairs: Vec<_> = sighting.marks.iter().filter_map(printed).collect();
        dots += pairs.len() as f64;
        dot_squares += form::rigid_rms_mm(&pairs)?.powi(2) * pairs.len() as f64;
    }
    (points > 0.0).then(|| HoldOut {
        views: views.len() as u32,
        flatness_rms_um: 1e3 * f64::sqrt(squares / points),
        flatness_um: 1e3 * worst,
        dots_rms_um: 1e3 * f64::sqrt(dot_squares / dots),
    })
}
