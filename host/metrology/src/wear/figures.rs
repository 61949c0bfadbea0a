//! Figures of one flank's zone as read from its points: wear depth, mean, areas, volumes, and hidden wear.

use flankscope_foundation::normal::COVERAGE_95;
use flankscope_foundation::order::median_of;
use serde::Serialize;

use super::WearSettings;
use super::disc::Discs;
use super::field::{Field, WearSample};
use super::unseen::Unseen;

/// Detection threshold in standard uncertainties: 1.645 for errors of the first kind and as much for the second (5 % each).
pub const DETECTION_FACTOR: f64 = 3.3;
/// Least number of connected cells of a worn area: of a thousand cells 0.5 exceed 3.3 standard deviations by chance.
const LEAST_CLUSTER: usize = 2;
/// Least number of points of a cell that is judged by itself: their median tolerates one outlier.
const LEAST_IN_CELL: usize = 3;
/// Standard deviation of a median over that of the mean, for normal noise.
const MEDIAN_OVER_MEAN: f64 = 1.253_314_137_315_500_3;

/// A figure with its standard uncertainty.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Figure {
    /// Value.
    pub value: f64,
    /// Standard uncertainty, same unit.
    pub u: f64,
}

impl Figure {
    /// Expanded uncertainty (95 %, coverage factor 1.96), same unit.
    pub fn u95(&self) -> f64 {
        COVERAGE_95 * self.u
    }
}

/// Wear figures of one zone; every `u` from noise alone.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Figures {
    /// Largest mean loss over any disc of the stated area in the zone, mm: the bias of a maximum by noise is taken off.
    pub depth_mm: Figure,
    /// The same as read, mm.
    pub raw_mm: f64,
    /// Middle of that disc, from the zone's corner along profile and height, mm.
    pub at_mm: [f64; 2],
    /// Largest mean height of proud material over any disc of that area, mm; negative where the whole zone has lost.
    pub proud_mm: Figure,
    /// Loss of the cell that lost most, by the median of its points, mm; none when no cell holds enough points.
    pub cell_mm: Option<Figure>,
    /// Mean loss, mm.
    pub mean_mm: Figure,
    /// Area of connected cells beyond the threshold of detection, mm2.
    pub worn_area_mm2: Figure,
    /// Volume lost there, mm3.
    pub lost_volume_mm3: Figure,
    /// Volume of material that stands proud beyond the threshold of detection, mm3.
    pub proud_volume_mm3: Figure,
    /// The largest mean loss that any disc can have when whatever was not measured of it lost as much as the settings
    /// suppose, mm; none when every disc was measured whole.
    pub hidden_mm: Option<f64>,
    /// The same where holes are as deep as their rims, and what walls hide is as the settings suppose, mm.
    pub behind_walls_mm: Option<f64>,
    /// By how much the depth would be larger if every hole were as deep as the deepest cell at its rim, mm.
    pub in_holes_mm: f64,
}

/// Evaluates the points of a zone; `field` holds their cells, `scale` says how many times larger than stated their noise is,
/// `unseen` which part of each cell was not seen. None when nothing was measured or no disc fits.
pub(super) fn evaluate(
    field: &Field,
    samples: &[WearSample],
    scale: f64,
    unseen: impl FnOnce(&Discs<'_>) -> Vec<Unseen>,
    settings: &WearSettings,
    systematic_mm: f64,
) -> Option<Figures> {
    let measured: Vec<usize> = field.measured().collect();
    if measured.is_empty() {
        return None;
    }
    let discs = Discs::new(field, samples, settings.area_mm2);
    let unseen = unseen(&discs);
    let discs = discs.with_unseen(unseen);
    let [loss, proud] = discs.largest(scale)?;

    let n = measured.len() as f64;
    let sigma = |i: usize| scale * field.variance_mm2[i].sqrt();
    let noise = (measured.iter().map(|&i| sigma(i).powi(2)).sum::<f64>() / n).sqrt();
    let mean = measured.iter().map(|&i| field.wear_mm[i]).sum::<f64>() / n;
    let cell_mm = measured
        .iter()
        .filter(|&&i| discs.of_cell(i).count() >= LEAST_IN_CELL)
        .map(|&i| Figure {
            value: median_of(discs.of_cell(i).map(|sample| sample.wear_mm)).unwrap_or(f64::NAN),
            u: MEDIAN_OVER_MEAN * sigma(i),
        })
        .max_by(|a, b| a.value.total_cmp(&b.value));

    let cell_area = field.cell_area_mm2();
    let threshold = |i: usize| DETECTION_FACTOR * sigma(i).hypot(systematic_mm);
    let beyond = |sign: f64| {
        let groups = field.groups(|i| sign * field.wear_mm[i] >= threshold(i));
        let large = groups
            .into_iter()
            .filter(|group| group.len() >= LEAST_CLUSTER);
        large.flatten().collect::<Vec<usize>>()
    };
    let volume = |sign: f64, cells: &[usize]| {
        let count = cells.len() as f64;
        Figure {
            value: cells
                .iter()
                .fold(0.0, |sum, &i| sum + cell_area * sign * field.wear_mm[i]),
            u: cell_area * (count.sqrt() * noise).hypot(count * systematic_mm),
        }
    };
    let (lost, gained) = (beyond(1.0), beyond(-1.0));
    let worn = lost.len() as f64 * cell_area;
    Some(Figures {
        depth_mm: Figure {
            value: loss.raw_mm - loss.bias_mm,
            u: loss.u_mm,
        },
        raw_mm: loss.raw_mm,
        at_mm: loss.at_mm,
        proud_mm: Figure {
            value: proud.raw_mm - proud.bias_mm,
            u: proud.u_mm,
        },
        cell_mm,
        mean_mm: Figure {
            value: mean,
            u: noise / n.sqrt(),
        },
        worn_area_mm2: Figure {
            value: worn,
            // A rim of cells that are in or out as a whole.
            u: cell_area * (4.0 * (worn / cell_area).sqrt() / 12.0).sqrt(),
        },
        lost_volume_mm3: volume(1.0, &lost),
        proud_volume_mm3: volume(-1.0, &gained),
        hidden_mm: discs.hidden_mm(settings.hidden_depth_mm),
        behind_walls_mm: discs.behind_walls_mm(settings.hidden_depth_mm),
        in_holes_mm: discs
            .as_rims_mm()
            .map_or(0.0, |deepest| (deepest - loss.raw_mm).max(0.0)),
    })
}
