//! The camera ray of every cell, and which fringes the measuring volume allows along it.

use std::f64::consts::{PI, TAU};

use rayon::prelude::*;

use super::DecodeError;
use crate::cells::Grid;
use crate::head::HeadModel;
use crate::pattern::{Axis, PatternSet};
use crate::triangulate::Triangulator;

/// Along any ray the volume may span this part of the orders that the frequencies tell apart. The rest is for noise: of a
/// coarse frequency 0.16 rad at either end, three standard deviations of the noisiest phase that a ratio of 12 accepts.
const MAX_SPANNED: f64 = 0.95;
/// A surface at the volume's end may be measured this far beyond it.
const BEYOND_VOLUME_RAD: f64 = PI;

/// A camera ray and what the volume says about it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ray {
    /// Camera pixel: column, row.
    pub pixel: [f64; 2],
    /// x and y at z = 1.
    pub direction: [f64; 2],
    /// Phase of the finest frequency in the middle of the volume.
    pub middle_rad: f64,
    /// Phase from the middle of the volume to its end, and a little more.
    pub expected_rad: f64,
}

/// The projector's pixels across the fringes.
pub(crate) fn projector_size_px(head: &HeadModel, axis: Axis) -> f64 {
    f64::from(match axis {
        Axis::Columns => head.projector.width_px,
        Axis::Rows => head.projector.height_px,
    })
}

/// The ray of every cell.
///
/// # Errors
/// A distortion without inverse, or a volume that the frequencies cannot tell apart.
pub(crate) fn rays(
    head: &HeadModel,
    patterns: &PatternSet,
    orders: usize,
    grid: &Grid,
    triangulator: &Triangulator,
) -> Result<Vec<Ray>, DecodeError> {
    let finest = patterns.finest();
    let width_px = projector_size_px(head, patterns.axis);
    // Periods of one frequency that would tell apart as many columns.
    let periods = finest.periods / orders as f64;
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
                        expected: "must have an inverse everywhere in the image".into(),
                    })?;
                let Some(volume) = head.volume else {
                    // The frequencies tell all columns apart: the middle of the projector.
                    return Ok(Ray {
                        pixel,
                        direction,
                        middle_rad: PI * finest.periods,
                        expected_rad: f64::INFINITY,
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
                let spanned = (far - near).abs() * periods / width_px;
                if spanned > MAX_SPANNED {
                    return Err(DecodeError::VolumeTooDeep {
                        periods,
                        spanned,
                        limit: MAX_SPANNED,
                        usable: periods * MAX_SPANNED / spanned,
                    });
                }
                Ok(Ray {
                    pixel,
                    direction,
                    middle_rad: finest.phase_rad(0.5 * (near + far), width_px),
                    expected_rad: 0.5 * TAU * finest.periods * (far - near).abs() / width_px
                        + BEYOND_VOLUME_RAD,
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
