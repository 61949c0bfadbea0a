//! The camera ray of every cell, and which fringe of the lowest frequency the measuring volume allows along it.

use rayon::prelude::*;

use super::DecodeError;
use crate::cells::Grid;
use crate::head::HeadModel;
use crate::pattern::PatternSet;
use crate::triangulate::Triangulator;

/// Along any ray the volume may span this part of the lowest frequency's period. The rest is for noise: 0.16 rad at
/// either end, three standard deviations of the noisiest phase that unwrapping over a ratio of 12 accepts.
const MAX_SPANNED_PERIODS: f64 = 0.95;

/// A camera ray and what the volume says about it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ray {
    /// Camera pixel: column, row.
    pub pixel: [f64; 2],
    /// x and y at z = 1.
    pub direction: [f64; 2],
    /// Phase of the lowest frequency in the middle of the volume.
    pub expected_low_rad: f64,
}

/// The ray of every cell.
///
/// # Errors
/// A distortion without inverse, or a volume that the lowest frequency cannot tell apart.
pub(crate) fn rays(
    head: &HeadModel,
    patterns: &PatternSet,
    grid: &Grid,
    triangulator: &Triangulator,
) -> Result<Vec<Ray>, DecodeError> {
    let periods = patterns.sets[0].periods;
    let radians_by_column = std::f64::consts::TAU * periods / f64::from(head.projector.width_px);
    let row_rays = |row: usize| -> Result<Vec<Ray>, DecodeError> {
        grid.places(row)
            .into_iter()
            .map(|(_, pixel)| {
                let direction = head
                    .camera
                    .undistort(pixel)
                    .ok_or_else(|| DecodeError::Head {
                        key: "camera.distortion".to_owned(),
                        got: format!("{:?} at pixel {pixel:?}", head.camera.distortion),
                        expected: "must have an inverse everywhere in the image",
                    })?;
                let Some(volume) = head.volume else {
                    // A single period: the middle of the projector.
                    return Ok(Ray {
                        pixel,
                        direction,
                        expected_low_rad: std::f64::consts::PI * periods,
                    });
                };
                let behind = || DecodeError::VolumeBehindProjector {
                    near_mm: volume.near_mm,
                    far_mm: volume.far_mm,
                };
                let (near, _) = triangulator
                    .column(direction, volume.near_mm)
                    .ok_or_else(behind)?;
                let (far, _) = triangulator
                    .column(direction, volume.far_mm)
                    .ok_or_else(behind)?;
                let spanned = (far - near).abs() * periods / f64::from(head.projector.width_px);
                if spanned > MAX_SPANNED_PERIODS {
                    return Err(DecodeError::VolumeTooDeep {
                        periods,
                        spanned,
                        limit: MAX_SPANNED_PERIODS,
                        usable: periods * MAX_SPANNED_PERIODS / spanned,
                    });
                }
                Ok(Ray {
                    pixel,
                    direction,
                    expected_low_rad: radians_by_column
                        * (0.5 * (near + far) - patterns.phase_origin_px),
                })
            })
            .collect()
    };
    let rows: Vec<Vec<Ray>> = (0..grid.rows())
        .into_par_iter()
        .map(row_rays)
        .collect::<Result<_, _>>()?;
    Ok(rows.into_iter().flatten().collect())
}
