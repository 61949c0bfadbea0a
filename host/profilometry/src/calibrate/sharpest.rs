//! Autofocus: the setting of a lens at which the camera is sharp on the middle of a plate, by the contrast of fringes on it.
//!
//! Blur of a standard deviation `s` leaves `exp(-2 (pi f s)^2)` of fringes of frequency `f`, and its square grows with that of the
//! distance from best focus: over the focal power the logarithm of the contrast is a parabola, with small terms of higher order
//! over a few dioptres. Coarse steps over the whole range find the highest place, fine ones about it give the parabola its vertex.
//!
//! The vertex is not yet best focus of the camera. Camera and projector both blur, from pinholes that are not equally far from the plate
//! unless it stands where their axes cross: the sum of two parabolas has its vertex between theirs, at an unknown place unless it is known
//! which lens blurs more. So half the distance is corrected, and the whole of it is the width of a uniform distribution. Best focus is curved, too: the
//! mean over a disc has half the curvature at its rim, which a disc of twice the radius shows fourfold, so a third of the difference of
//! their vertices is corrected, and counts as the half width of what a field that is no parabola may leave. That both objectives are
//! in focus at equal distances from their pinholes is assumed, as pairs on one driver are made; it cannot be tested here.

use std::f64::consts::SQRT_2;

use nalgebra::{Matrix3, Vector3};

use crate::cloud::CellColumn;
use crate::head::{HeadModel, LensDrive};
use crate::pattern::Axis;
use crate::triangulate::Triangulator;

/// Settings over the whole range.
const COARSE: u16 = 9;
/// Settings about the highest of them, from neighbour to neighbour.
const FINE: u16 = 9;
/// Share of the field's radius that is looked at, and that of the disc which tells how curved best focus is.
const MIDDLE: f64 = 0.25;
const WIDER: f64 = 2.0 * MIDDLE;
/// A drawing says where a pinhole is to this, mm along its axis: as far as a calibration believes the drawing.
const DRAWN_SIGMA_MM: f64 = 0.1;
/// Fewest cells whose mean is a contrast.
const MIN_CELLS: usize = 200;
/// A vertex that is less sure than this share of a coarse step found nothing.
const MAX_SIGMA_RATIO: f64 = 0.2;

/// Lens driver counts and the fringe contrast measured there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sharpness {
    /// Lens driver counts.
    pub counts: u16,
    /// Mean contrast of the finest fringes in the middle of the field.
    pub contrast: f64,
    /// The same of twice that radius.
    pub wider_contrast: f64,
    /// Distances of the middle, if it was triangulated by fringes of known order.
    pub place: Option<AxialDistance>,
}

/// Distances of a point from both pinholes, each along its own axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxialDistance {
    /// From the camera's.
    pub distance_mm: f64,
    /// From the projector's, minus that.
    pub farther_mm: f64,
}

/// Lens setting at which the camera is in focus on the middle of a plate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sharpest {
    /// The setting: best focus of the camera in the middle of its field.
    pub setting_dpt: f64,
    /// Setting at which the fringes there have most contrast.
    pub vertex_dpt: f64,
    /// Contrast there.
    pub contrast: f64,
    /// Distances of the plate's middle.
    pub place: AxialDistance,
    /// Correction added to the vertex because the projector is farther away than the camera.
    pub projector_dpt: f64,
    /// Correction added because the surface of best focus is curved.
    pub curvature_dpt: f64,
    /// Standard uncertainty of the setting.
    pub sigma: Components,
}

/// Lens setting at which the fringes in the middle of the field have most contrast.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MostContrast {
    /// The setting.
    pub setting_dpt: f64,
    /// Standard uncertainty due to deviations of the contrasts from a parabola.
    pub sigma_dpt: f64,
    /// Contrast there.
    pub contrast: f64,
}

/// Parts of a standard uncertainty, dpt.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Components {
    /// Part due to deviations of the contrasts from a parabola.
    pub scatter_dpt: f64,
    /// Part due to the unknown shares of camera and projector in the blur.
    pub projector_dpt: f64,
    /// Part due to the calibrated distances of both pinholes.
    pub head_dpt: f64,
    /// Part of the uncertainty due to field curvature that a parabola does not describe.
    pub curvature_dpt: f64,
}

impl Components {
    /// All together.
    #[must_use]
    pub fn combined_dpt(&self) -> f64 {
        let Self {
            scatter_dpt,
            projector_dpt,
            head_dpt,
            curvature_dpt,
        } = self;
        scatter_dpt
            .hypot(*projector_dpt)
            .hypot(*head_dpt)
            .hypot(*curvature_dpt)
    }
}

/// Vertex of a parabola.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Vertex {
    /// Counts, and parts of one.
    counts: f64,
    /// Standard uncertainty of that, by how far the contrasts lie from the parabola.
    sigma_counts: f64,
    /// Contrast there.
    contrast: f64,
}

/// Why no setting is the sharpest.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum NotSharp {
    /// Too little of the field shows fringes.
    #[error(
        "at {counts} counts {got} cells in the middle of the field show fringes, at least {limit} are needed: is the surface there, and lit?"
    )]
    Dark {
        /// Lens driver counts.
        counts: u16,
        /// Cells with fringes.
        got: usize,
        /// Fewest.
        limit: usize,
    },
    /// Nobody knows how far the plate is.
    #[error(
        "the order of the fringes is known in fewer than {limit} cells in the middle of the field at every setting about the sharpest: nothing says how far the plate is from camera and projector"
    )]
    NoPlace {
        /// Fewest.
        limit: usize,
    },
    /// It goes on getting sharper.
    #[error(
        "the fringes are sharpest at {counts} counts, the end of the lens' range ({} to {}): bring the surface nearer to where the middle of the range is sharp",
        range[0], range[1]
    )]
    AtTheEnd {
        /// The sharpest of the coarse settings.
        counts: u16,
        /// All of them: least and most.
        range: [u16; 2],
    },
    /// No vertex, or a vague one.
    #[error(
        "the contrast of the fringes has no vertex between {} and {} counts: does the lens move, and do the fringes have contrast?",
        between[0], between[1]
    )]
    NoVertex {
        /// Counts between which it was searched.
        between: [u16; 2],
    },
}

impl Sharpness {
    /// Evaluates a view of a white plate, taken with the lens driver at `counts`.
    ///
    /// # Errors
    /// [`NotSharp::Dark`].
    pub fn from_view(
        counts: u16,
        cells: &[CellColumn],
        head: &HeadModel,
    ) -> Result<Self, NotSharp> {
        let size_px = [head.camera.width_px, head.camera.height_px].map(f64::from);
        let (centre_px, radius_px) = match &head.image_circle {
            Some(circle) => (circle.centre_px, circle.radius_px),
            None => (size_px.map(|px| 0.5 * px), 0.5 * size_px[0].min(size_px[1])),
        };
        let within = |share: f64| {
            cells.iter().filter(move |cell| {
                let [x, y] = [0, 1].map(|k| cell.pixel[k] - centre_px[k]);
                x.hypot(y) <= share * radius_px && cell.contrast > 0.0
            })
        };
        let contrast = |share| {
            let (got, sum) =
                within(share).fold((0, 0.0), |(got, sum), cell| (got + 1, sum + cell.contrast));
            match got >= MIN_CELLS {
                true => Ok(sum / got as f64),
                false => Err(NotSharp::Dark {
                    counts,
                    got,
                    limit: MIN_CELLS,
                }),
            }
        };
        let light = Triangulator::new(head, Axis::Columns);
        let places: Vec<AxialDistance> = within(MIDDLE)
            .filter_map(|cell| {
                AxialDistance::triangulate(head, &light, cell.pixel, cell.column_px?)
            })
            .collect();
        Ok(Self {
            counts,
            contrast: contrast(MIDDLE)?,
            wider_contrast: contrast(WIDER)?,
            place: AxialDistance::mean(&places).filter(|_| places.len() >= MIN_CELLS),
        })
    }
}

impl AxialDistance {
    /// The point that a pixel sees in the light of a projector column.
    pub(super) fn triangulate(
        head: &HeadModel,
        light: &Triangulator,
        pixel: [f64; 2],
        column_px: f64,
    ) -> Option<Self> {
        let [x, y] = head.camera.undistort(pixel)?;
        let distance_mm = light.intersect([x, y], column_px)?.depth_mm;
        let seen_mm = [x, y, 1.0].map(|by| by * distance_mm);
        let [_, _, from_projector_mm] = head.projector_from_camera.point(seen_mm);
        Some(Self {
            distance_mm,
            farther_mm: from_projector_mm - distance_mm,
        })
    }

    /// Mean over points on all sides of a middle, so that the tilt of a plate cancels.
    fn mean(places: &[Self]) -> Option<Self> {
        let mean = |of: fn(&Self) -> f64| {
            let mean = places.iter().map(of).sum::<f64>() / places.len() as f64;
            Some(mean).filter(|mm| mm.is_finite())
        };
        Some(Self {
            distance_mm: mean(|place| place.distance_mm)?,
            farther_mm: mean(|place| place.farther_mm)?,
        })
    }

    /// Standard uncertainty of how much farther the projector is, by what the head's file says of itself.
    fn farther_sigma_mm(head: &HeadModel) -> f64 {
        let calibrated = head.calibration.as_ref();
        calibrated
            .and_then(|record| record.farther_sigma_um)
            .map_or(SQRT_2 * DRAWN_SIGMA_MM, |um| 1e-3 * um)
    }
}

fn steps([from, to]: [u16; 2], number: u16) -> Vec<u16> {
    let at = |step: u16| {
        let way = f64::from(step) / f64::from(number - 1);
        (f64::from(from) + way * (f64::from(to) - f64::from(from))).round() as u16
    };
    let mut steps: Vec<u16> = (0..number).map(at).collect();
    steps.dedup();
    steps
}

/// Settings to look at first.
#[must_use]
pub fn coarse(range: [u16; 2]) -> Vec<u16> {
    steps(range, COARSE)
}

/// Settings to look at next.
///
/// # Errors
/// [`NotSharp::AtTheEnd`].
pub fn fine(coarse: &[Sharpness]) -> Result<Vec<u16>, NotSharp> {
    let highest = (0..coarse.len())
        .max_by(|&a, &b| coarse[a].contrast.total_cmp(&coarse[b].contrast))
        .unwrap_or(0);
    let beside = highest
        .checked_sub(1)
        .and_then(|before| Some([coarse.get(before)?, coarse.get(highest + 1)?]));
    match (beside, coarse) {
        (Some(beside), _) => Ok(steps(beside.map(|beside| beside.counts), FINE)),
        (None, [first, .., last]) => Err(NotSharp::AtTheEnd {
            counts: coarse[highest].counts,
            range: [first.counts, last.counts],
        }),
        (None, _) => Err(NotSharp::NoVertex { between: [0, 0] }),
    }
}

/// Lens setting at which the camera is in focus, from the fine settings of the lens of `head`.
///
/// # Errors
/// [`NotSharp::NoVertex`], [`NotSharp::NoPlace`].
pub fn sharpest(
    fine: &[Sharpness],
    lens: &LensDrive,
    head: &HeadModel,
) -> Result<Sharpest, NotSharp> {
    let ends = || fine.iter().map(|of| of.counts);
    let between = [ends().min().unwrap_or(0), ends().max().unwrap_or(0)];
    let of = |contrast: fn(&Sharpness) -> f64| {
        vertex(fine, between, contrast).ok_or(NotSharp::NoVertex { between })
    };
    let (middle, wider) = (of(|of| of.contrast)?, of(|of| of.wider_contrast)?);
    let places: Vec<AxialDistance> = fine.iter().filter_map(|of| of.place).collect();
    let place = AxialDistance::mean(&places).ok_or(NotSharp::NoPlace { limit: MIN_CELLS })?;

    let vertex_dpt = (middle.counts - lens.zero_counts) * lens.dpt_per_count;
    let curvature_dpt = (middle.counts - wider.counts) * lens.dpt_per_count / 3.0;
    // Focus and power are reciprocal: 1 / mm² is 1000 dpt / mm.
    let dpt_per_mm = 1e3 / (place.distance_mm * place.distance_mm);
    let farther_dpt = place.farther_mm * dpt_per_mm;
    let farther_sigma_dpt = AxialDistance::farther_sigma_mm(head) * dpt_per_mm;
    let [of_middle, of_wider] = [middle, wider].map(|of| of.sigma_counts * lens.dpt_per_count);
    Ok(Sharpest {
        setting_dpt: vertex_dpt + 0.5 * farther_dpt + curvature_dpt,
        vertex_dpt,
        contrast: middle.contrast,
        place,
        projector_dpt: 0.5 * farther_dpt,
        curvature_dpt,
        sigma: Components {
            scatter_dpt: (of_middle * 4.0 / 3.0).hypot(of_wider / 3.0),
            // Share and way are both uncertain: their product is by all of the way's mean square.
            projector_dpt: farther_dpt.hypot(farther_sigma_dpt) / 12f64.sqrt(),
            head_dpt: 0.5 * farther_sigma_dpt,
            curvature_dpt: curvature_dpt.abs() / 3f64.sqrt(),
        },
    })
}

/// Lens setting at which the fringes in the middle have most contrast, from the fine settings: of a surface of any shape, without the
/// corrections that need a plate.
///
/// # Errors
/// [`NotSharp::NoVertex`].
pub fn most_contrast(fine: &[Sharpness], lens: &LensDrive) -> Result<MostContrast, NotSharp> {
    let ends = || fine.iter().map(|of| of.counts);
    let between = [ends().min().unwrap_or(0), ends().max().unwrap_or(0)];
    let middle = vertex(fine, between, |of| of.contrast).ok_or(NotSharp::NoVertex { between })?;
    Ok(MostContrast {
        setting_dpt: (middle.counts - lens.zero_counts) * lens.dpt_per_count,
        sigma_dpt: middle.sigma_counts * lens.dpt_per_count.abs(),
        contrast: middle.contrast,
    })
}

/// Least squares of a parabola to the logarithms, over counts from -1 to 1.
fn vertex(
    fine: &[Sharpness],
    between: [u16; 2],
    contrast: fn(&Sharpness) -> f64,
) -> Option<Vertex> {
    let [least, most] = between.map(f64::from);
    let (middle, half) = (0.5 * (least + most), 0.5 * (most - least));
    let row = |of: &Sharpness| {
        let x = (f64::from(of.counts) - middle) / half;
        Vector3::new(1.0, x, x * x)
    };
    let mut normal = Matrix3::zeros();
    let mut right = Vector3::zeros();
    for of in fine {
        normal += row(of) * row(of).transpose();
        right += contrast(of).ln() * row(of);
    }
    let inverse = normal.try_inverse()?;
    let [c, b, a]: [f64; 3] = (inverse * right).into();
    let freedom = fine.len().checked_sub(3).filter(|&freedom| freedom > 0)?;
    let left_over = |of: &Sharpness| contrast(of).ln() - Vector3::new(c, b, a).dot(&row(of));
    let variance = fine.iter().map(|of| left_over(of).powi(2)).sum::<f64>() / freedom as f64;
    let x = -b / (2.0 * a);
    let by = Vector3::new(0.0, -1.0 / (2.0 * a), b / (2.0 * a * a));
    let sigma = (variance * by.dot(&(inverse * by))).sqrt();
    // Written so that a NaN fails.
    let found = a < 0.0 && x.abs() <= 1.0 && sigma <= MAX_SIGMA_RATIO;
    found.then(|| Vertex {
        counts: middle + half * x,
        sigma_counts: half * sigma,
        contrast: (c + 0.5 * b * x).exp(),
    })
}

#[cfg(test)]
mod tests {
    use flankscope_test_requisites::Random;

    use super::*;

    const RANGE: [u16; 2] = [416, 616];

    /// Contrast through a lens that is sharp at `best` counts, by the blur of two objectives.
    fn shown(counts: u16, best: f64) -> f64 {
        let defocus_mm = 0.017 * (f64::from(counts) - best);
        let blur = |focused: f64| {
            2.0 * (std::f64::consts::PI * 0.19).powi(2) * {
                focused * focused + (0.13 * defocus_mm).powi(2)
            }
        };
        0.6 * (-blur(0.22) - blur(0.28)).exp()
    }

    fn seen(at: Vec<u16>, contrast: impl FnMut(u16) -> f64) -> Vec<Sharpness> {
        let mut contrast = contrast;
        let of = |counts| {
            let contrast = contrast(counts);
            Sharpness {
                counts,
                contrast,
                wider_contrast: contrast,
                place: None,
            }
        };
        at.into_iter().map(of).collect()
    }

    fn middle(near: &[Sharpness]) -> Vertex {
        let counts = || near.iter().map(|of| of.counts);
        let between = [counts().min().unwrap(), counts().max().unwrap()];
        vertex(near, between, |of| of.contrast).unwrap()
    }

    #[test]
    fn the_vertex_of_a_blurred_fringe_is_found_over_the_range() {
        for best in [445.3, 500.0, 516.0, 590.9] {
            let rough = seen(coarse(RANGE), |counts| shown(counts, best));
            let near = seen(fine(&rough).unwrap(), |counts| shown(counts, best));
            let found = middle(&near);
            assert!((found.counts - best).abs() < 1e-6, "{best}: {found:?}");
            let most = most_contrast(&near, &LENS).unwrap();
            assert!((most.setting_dpt - 0.0399 * (best - 516.0)).abs() < 1e-6);
            assert!((found.contrast - shown(0, 0.0)).abs() < 1e-9);
        }
    }

    const ANGLE_RAD: f64 = 30.0 * std::f64::consts::PI / 180.0;
    const CROSSING_MM: f64 = 22.0;
    const LENS: LensDrive = LensDrive {
        zero_counts: 516.0,
        dpt_per_count: 0.0399,
        range: RANGE,
        settle_ms: 150,
        counts: 516,
    };

    /// Axes that cross under 30 degrees, 22 mm before both pinholes.
    fn head() -> HeadModel {
        let (sin, cos) = ANGLE_RAD.sin_cos();
        let shift = [CROSSING_MM * sin, 0.0, CROSSING_MM * (1.0 - cos)];
        let text = format!(
            "name = 'test'\nworking_distance_mm = 20.0\n\
             [camera]\nwidth_px = 1920\nheight_px = 1200\nfocal_px = [2811.0, 2811.0]\nprincipal_px = [960.0, 600.0]\n\
             [image_circle]\ncentre_px = [960.0, 600.0]\nradius_px = 575.0\n\
             [projector]\nwidth_px = 1024\nheight_px = 768\nfocal_px = [2503.0, 2503.0]\nprincipal_px = [512.0, 384.0]\n\
             [projector_from_camera]\nrotation = [[{cos}, 0.0, {}], [0.0, 1.0, 0.0], [{sin}, 0.0, {cos}]]\n\
             translation_mm = [{}, {}, {}]\n",
            -sin, shift[0], shift[1], shift[2]
        );
        toml::from_str(&text).unwrap()
    }

    /// Whose blur counts how much.
    #[derive(Clone, Copy)]
    struct Blurs {
        camera: f64,
        projector: f64,
        /// Best focus comes nearer by this per squared distance from the axis, of both.
        curvature_per_mm: f64,
    }

    /// A plate that faces the camera, at `plate_mm`, through lenses that are sharp at `focus_mm` before their pinholes.
    fn plate(plate_mm: f64, focus_mm: f64, blurs: Blurs) -> Vec<CellColumn> {
        let head = head();
        let (sin, cos) = ANGLE_RAD.sin_cos();
        let mut cells = Vec::new();
        for row in (60..1140).step_by(9) {
            for column in (420..1500).step_by(9) {
                let pixel = [f64::from(column), f64::from(row)];
                let [x_mm, y_mm] = [960.0, 600.0].map(|middle| middle * plate_mm / 2811.0);
                let [x_mm, y_mm] = [
                    plate_mm * pixel[0] / 2811.0 - x_mm,
                    plate_mm * pixel[1] / 2811.0 - y_mm,
                ];
                // By the drawing: turned about the crossing.
                let along = plate_mm - CROSSING_MM;
                let from_projector_mm = CROSSING_MM + along * cos + x_mm * sin;
                let across_mm = x_mm * cos - along * sin;
                let blur = |distance_mm: f64, x_mm: f64, by: f64| {
                    let curved_mm = blurs.curvature_per_mm * (x_mm * x_mm + y_mm * y_mm);
                    by * (distance_mm - focus_mm + curved_mm).powi(2)
                };
                let squares = blur(plate_mm, x_mm, blurs.camera)
                    + blur(from_projector_mm, across_mm, blurs.projector);
                let column_px = head.projector.principal_px[0]
                    + head.projector.focal_px[0] * across_mm / from_projector_mm;
                cells.push(CellColumn {
                    pixel,
                    mean_e: 1e4,
                    contrast: 0.5 * (-squares).exp(),
                    column_px: Some(column_px),
                });
            }
        }
        cells
    }

    /// Focus of a thin lens 1.5 mm before an objective that is sharp at 22 mm.
    fn focus_mm(power_dpt: f64) -> f64 {
        1.5 + 1.0 / (1.0 / 20.5 + 1e-3 * power_dpt)
    }

    fn found(best_dpt: f64, blurs: Blurs) -> Sharpest {
        let look = |at: Vec<u16>| -> Vec<Sharpness> {
            let of = |counts| {
                let cells = plate(focus_mm(best_dpt), focus_mm(LENS.power_dpt(counts)), blurs);
                Sharpness::from_view(counts, &cells, &head()).unwrap()
            };
            at.into_iter().map(of).collect()
        };
        let near = look(fine(&look(coarse(RANGE))).unwrap());
        sharpest(&near, &LENS, &head()).unwrap()
    }

    /// Whoever blurs more: within what the share of both leaves open, of which all but a rounding is one of the two ends.
    #[test]
    fn a_plate_beside_the_crossing_is_sharp_where_the_lens_images_it_whoever_blurs() {
        for best_dpt in [-2.0, 0.0, 1.5] {
            for [camera, projector] in [[0.02, 0.0], [0.01, 0.01], [0.0, 0.02]] {
                let blurs = Blurs {
                    camera,
                    projector,
                    curvature_per_mm: 0.0,
                };
                let found = found(best_dpt, blurs);
                let away_mm = focus_mm(best_dpt) - CROSSING_MM;
                let farther_mm = away_mm * (ANGLE_RAD.cos() - 1.0);
                assert!((found.place.farther_mm - farther_mm).abs() < 1e-6);
                assert!((found.place.distance_mm - focus_mm(best_dpt)).abs() < 1e-6);
                let off_dpt = found.setting_dpt - best_dpt;
                // The third order of focus over power, 0.041 of the second per dpt, moves the vertex by 3/5 of half of that and, as
                // steps lie up to half a coarse one beside it, by as much again. The lens is 1.5 mm nearer than the pinhole that
                // distances are from: (23 / 21.5)² is 1.15, of the whole way.
                let rest_dpt = 0.03 + 0.15 * 2.0 * found.projector_dpt.abs();
                let limit_dpt = found.projector_dpt.abs() + rest_dpt;
                assert!(off_dpt.abs() < limit_dpt, "{best_dpt}: {found:?}");
                if camera == projector {
                    assert!(off_dpt.abs() < rest_dpt, "{best_dpt}: {found:?}");
                }
                let sigma_dpt = found.sigma.combined_dpt();
                assert!(off_dpt.abs() < 2.0 * sigma_dpt, "{best_dpt}: {found:?}");
            }
        }
    }

    #[test]
    fn what_curves_best_focus_is_taken_off() {
        let of = |curvature_per_mm| {
            let blurs = Blurs {
                camera: 0.01,
                projector: 0.01,
                curvature_per_mm,
            };
            found(0.0, blurs)
        };
        let (flat, curved) = (of(0.0), of(0.03));
        // The mean of a disc's squared radius is half that of its rim; 22 mm of a pixel's 2811th.
        let rim_mm = MIDDLE * 575.0 * CROSSING_MM / 2811.0;
        let nearer_dpt = 0.5 * 0.03 * rim_mm * rim_mm * 1e3 / (20.5 * 20.5);
        let moved_dpt = flat.vertex_dpt - curved.vertex_dpt;
        assert!(
            (moved_dpt.abs() / nearer_dpt - 1.0).abs() < 0.1,
            "{moved_dpt} {nearer_dpt}"
        );
        let left_dpt = curved.setting_dpt - flat.setting_dpt;
        assert!(left_dpt.abs() < 0.1 * nearer_dpt, "{left_dpt} {nearer_dpt}");
        assert!((curved.sigma.curvature_dpt / nearer_dpt * 3f64.sqrt() - 1.0).abs() < 0.1);
    }

    #[test]
    fn a_plate_whose_fringes_have_no_order_has_no_place() {
        let near = seen(steps([491, 541], FINE), |counts| shown(counts, 512.0));
        let limit = MIN_CELLS;
        assert_eq!(
            sharpest(&near, &LENS, &head()),
            Err(NotSharp::NoPlace { limit })
        );
    }

    #[test]
    fn noise_is_told_as_uncertainty() {
        let mut random = Random(5);
        let mut noise = move || 1e-4 * random.normal();
        let mut pulls = 0.0;
        let draws = 400;
        for _ in 0..draws {
            let near = seen(steps([491, 541], FINE), |counts| {
                shown(counts, 512.0) + noise()
            });
            let found = middle(&near);
            assert!(found.sigma_counts < 2.0, "{found:?}");
            pulls += ((found.counts - 512.0) / found.sigma_counts).powi(2);
        }
        // Student's t of 6 degrees of freedom has a variance of 1.5.
        let pull = pulls / f64::from(draws);
        assert!((1.0..2.2).contains(&pull), "{pull}");
    }

    #[test]
    fn what_has_no_vertex_is_refused() {
        let rough = seen(coarse(RANGE), |counts| shown(counts, 640.0));
        let error = fine(&rough).unwrap_err();
        assert_eq!(
            error,
            NotSharp::AtTheEnd {
                counts: 616,
                range: RANGE
            }
        );
        for contrast in [|_| 0.5, |_| f64::NAN, |c: u16| 1.0 / shown(c, 516.0)] {
            let near = seen(steps([491, 541], FINE), contrast);
            let between = [491, 541];
            let error = sharpest(&near, &LENS, &head());
            assert_eq!(error, Err(NotSharp::NoVertex { between }));
        }
    }
}
