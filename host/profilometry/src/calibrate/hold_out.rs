//! Plates that took no part in the adjustment, measured with its result: by each projector alone, and both compared.

use super::adjust::Adjusted;
use super::form;
use super::sighting::{Mark, Sighting};
use super::target::Target;
use crate::cloud::CellColumn;
use crate::head::{ApartRecord, HeadModel, HoldOut};
use crate::triangulate::HeadTriangulator;
use flankscope_foundation::order::quantile;

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

impl ApartRecord {
    /// Agreement of the two projectors of an adjusted head, by views that both light; `None` for a head with one, or without views.
    #[must_use]
    pub fn from_views(
        adjusted: &Adjusted,
        target: &Target,
        views: &[(Sighting, Vec<Vec<CellColumn>>)],
    ) -> Option<Self> {
        let second = adjusted.head.with_projector(2)?;
        let by_second: Vec<_> = views
            .iter()
            .filter_map(|(sighting, cells)| {
                Some((sighting.by_second_projector(), cells.get(1)?.clone()))
            })
            .collect();
        let [one, two] = [&adjusted.head, &second].map(HeadTriangulator::new);
        let apart_um = |[first, second]: [&CellColumn; 2]| {
            let [_, _, near] = one.point(first.pixel, first.column_px?)?;
            let [_, _, far] = two.point(second.pixel, second.column_px?)?;
            Some(1e3 * (far - near).abs())
        };
        let mut seen_um: Vec<f64> = views
            .iter()
            .filter_map(|(_, cells)| Some([cells.first()?, cells.get(1)?]))
            .flat_map(|[first, second]| first.iter().zip(second).map(|(a, b)| [a, b]))
            .filter_map(apart_um)
            .collect();
        Some(Self {
            apart_sigma_um: 1e3 * adjusted.apart_sigma_mm?,
            apart_um: quantile(&mut seen_um, 0.95)?,
            hold_out: hold_out(&second, target, &by_second),
        })
    }
}
