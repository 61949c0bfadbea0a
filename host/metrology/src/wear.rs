//! Wear of tooth flanks from signed deviations.
//!
//! The zone of a flank is cut into cells of profile length by height. Each cell's wear is minus the mean deviation of its
//! points; averaging removes the points' noise. The flank's figure is a high percentile over the cells, which a single bad
//! cell cannot make. A percentile of noisy cells lies above the truth even on a perfect flank, so the cells are first
//! shrunk towards their mean by the share of their spread that noise explains (James and Stein 1961): a flank without
//! structure reports its mean, a flank with a pit ten times the noise keeps it to 1 %.

use nalgebra::{Matrix6, Vector3, Vector6};

use crate::gear::{Flank, GearData};
use crate::registration::Registration;
use crate::surface::Closest;

/// The part of each flank that is judged.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Zone {
    /// Least and largest radius, mm.
    pub radius_mm: [f64; 2],
    /// Least and largest height, mm.
    pub height_mm: [f64; 2],
}

/// How wear is computed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// Edge of a cell, mm.
    pub cell_mm: f64,
    /// A cell with fewer points is not measured.
    pub least_points: usize,
    /// Percentile over the cells, percent.
    pub percentile: f64,
    /// Standard uncertainty of the calibration, mm.
    pub calibration_mm: f64,
    /// Standard uncertainty of the CAD surface (chord error, as-built), mm.
    pub cad_mm: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            cell_mm: 0.25,
            least_points: 5,
            percentile: 99.5,
            calibration_mm: 2e-3,
            cad_mm: 1e-3,
        }
    }
}

/// Points laid on CAD: where they are, what they hit, how sure each is.
#[derive(Debug, Clone, Copy)]
pub struct Measured<'a> {
    /// Points in tool coordinates, mm.
    pub points: &'a [[f64; 3]],
    /// Their closest surface points, in the same order.
    pub closest: &'a [Closest],
    /// Their standard uncertainties, mm; without them the scatter inside the cells is used.
    pub sigma_mm: Option<&'a [f32]>,
}

/// Wear of one flank. Positive is loss. A flank without measured cells has NaN figures and coverage 0, which no verdict
/// takes for go.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct FlankWear {
    /// Tooth, from 1.
    pub tooth: u32,
    /// Side.
    pub flank: Flank,
    /// The figure: percentile over the cells, mm.
    pub wear_mm: f64,
    /// Its standard uncertainty, mm.
    pub u_mm: f64,
    /// Mean over the cells, mm.
    pub mean_mm: f64,
    /// Measured cells worn beyond 3.3 standard uncertainties (limit of detection at 5 % errors of both kinds).
    pub worn_cells: usize,
    /// Measured cells.
    pub cells: usize,
    /// Measured share of the zone.
    pub coverage: f64,
    /// Points in the zone.
    pub points: usize,
    /// Shares of the uncertainty, mm: noise, registration, calibration, CAD.
    pub budget_mm: [f64; 4],
}

impl FlankWear {
    /// Expanded uncertainty (95 %), mm.
    pub fn u95_mm(&self) -> f64 {
        1.96 * self.u_mm
    }
}

#[derive(Clone, Default)]
struct Cell {
    points: usize,
    sum: f64,
    sum2: f64,
    variance_sum: f64,
}

/// The grid over one flank's zone.
struct Grid {
    tooth: u32,
    flank: Flank,
    profile_from_mm: f64,
    columns: usize,
    rows: usize,
    cells: Vec<Cell>,
    /// Sum of the points' effect of a small motion on their deviation, for the registration's share.
    motion: Vector6<f64>,
    points: usize,
}

/// Evaluates both flanks of each of `teeth`.
///
/// `registration` brings the covariance of the pose into the uncertainty.
pub fn evaluate(
    gear: &GearData,
    zone: &Zone,
    teeth: &[u32],
    measured: Measured<'_>,
    registration: Option<&Registration>,
    settings: &Settings,
) -> Vec<FlankWear> {
    let profile_from_mm = gear.profile_mm(zone.radius_mm[0]);
    let profile_length_mm = gear.profile_mm(zone.radius_mm[1]) - profile_from_mm;
    let cells_in =
        |length_mm: f64| ((length_mm / settings.cell_mm).floor() as usize).clamp(1, 10_000);
    let columns = cells_in(profile_length_mm);
    let rows = cells_in(zone.height_mm[1] - zone.height_mm[0]);
    let mut grids: Vec<Grid> = teeth
        .iter()
        .flat_map(|&tooth| Flank::BOTH.map(|flank| (tooth, flank)))
        .map(|(tooth, flank)| Grid {
            tooth,
            flank,
            profile_from_mm,
            columns,
            rows,
            cells: vec![Cell::default(); columns * rows],
            motion: Vector6::zeros(),
            points: 0,
        })
        .collect();
    let centre = registration.map_or([0.0; 3], |r| r.centre_mm);

    for (index, (point, closest)) in measured.points.iter().zip(measured.closest).enumerate() {
        // The CAD point, not the measured one, says where on the flank we are: wear must not move a point out of its zone.
        let Some(place) = gear.place(closest.point, closest.normal) else {
            continue;
        };
        let wanted = |g: &&mut Grid| g.tooth == place.tooth && g.flank == place.flank;
        let Some(grid) = grids.iter_mut().find(wanted) else {
            continue;
        };
        let (along, up) = (
            (place.profile_mm - grid.profile_from_mm) / profile_length_mm,
            (place.height_mm - zone.height_mm[0]) / (zone.height_mm[1] - zone.height_mm[0]),
        );
        let inside = (0.0..1.0).contains(&along) && (0.0..1.0).contains(&up);
        if !inside || !closest.signed_distance_mm.is_finite() {
            continue;
        }
        let cell = (up * grid.rows as f64) as usize * grid.columns
            + (along * grid.columns as f64) as usize;
        let sigma = measured
            .sigma_mm
            .and_then(|s| s.get(index))
            .map_or(f64::NAN, |&s| f64::from(s));
        grid.cells[cell].add(-closest.signed_distance_mm, sigma);
        grid.points += 1;
        let normal = Vector3::from(closest.normal);
        let turn = (Vector3::from(*point) - Vector3::from(centre)).cross(&normal);
        grid.motion += Vector6::new(turn.x, turn.y, turn.z, normal.x, normal.y, normal.z);
    }
    let covariance = registration.map(|r| &r.covariance);
    grids
        .iter()
        .map(|grid| grid.wear(covariance, settings))
        .collect()
}

impl Cell {
    fn add(&mut self, wear: f64, sigma: f64) {
        self.points += 1;
        self.sum += wear;
        self.sum2 += wear * wear;
        self.variance_sum += sigma * sigma;
    }

    fn mean(&self) -> f64 {
        self.sum / self.points as f64
    }

    /// Variance of the mean: from the points' own uncertainties, or from their scatter when that is larger or alone.
    fn variance_of_mean(&self) -> f64 {
        let n = self.points as f64;
        let scatter = if self.points > 1 {
            (self.sum2 - self.sum * self.sum / n).max(0.0) / (n - 1.0)
        } else {
            f64::INFINITY
        };
        let stated = self.variance_sum / n;
        // f64::max passes over the NaN of unstated uncertainties.
        scatter.max(stated) / n
    }
}

impl Grid {
    fn wear(&self, covariance: Option<&Matrix6<f64>>, settings: &Settings) -> FlankWear {
        let measured: Vec<&Cell> = self
            .cells
            .iter()
            .filter(|cell| cell.points >= settings.least_points.max(2))
            .collect();
        let n = measured.len();
        let mut result = FlankWear {
            tooth: self.tooth,
            flank: self.flank,
            wear_mm: f64::NAN,
            u_mm: f64::NAN,
            mean_mm: f64::NAN,
            worn_cells: 0,
            cells: n,
            coverage: n as f64 / self.cells.len() as f64,
            points: self.points,
            budget_mm: [f64::NAN; 4],
        };
        if n == 0 {
            return result;
        }
        let means: Vec<f64> = measured.iter().map(|cell| cell.mean()).collect();
        let noise_variance = measured.iter().map(|c| c.variance_of_mean()).sum::<f64>() / n as f64;
        let mean = means.iter().sum::<f64>() / n as f64;
        let spread = means.iter().map(|m| (m - mean).powi(2)).sum::<f64>() / (n.max(2) - 1) as f64;
        let keep = if spread > 0.0 {
            (1.0 - noise_variance / spread).max(0.0)
        } else {
            0.0
        };
        let mut shrunk: Vec<f64> = means.iter().map(|m| mean + keep * (m - mean)).collect();
        shrunk.sort_by(f64::total_cmp);
        result.mean_mm = mean;
        result.wear_mm = percentile(&shrunk, settings.percentile);

        // A percentile rests on few cells when they differ, on all of them when they do not.
        let noise = (noise_variance * (keep + (1.0 - keep) / n as f64)).sqrt();
        let registration = covariance.map_or(0.0, |covariance| {
            let motion = self.motion / self.points as f64;
            motion.dot(&(covariance * motion)).max(0.0).sqrt()
        });
        result.budget_mm = [
            noise,
            registration,
            settings.calibration_mm,
            settings.cad_mm,
        ];
        result.u_mm = result.budget_mm.iter().map(|u| u * u).sum::<f64>().sqrt();
        let systematic = result.u_mm * result.u_mm - noise * noise;
        result.worn_cells = measured
            .iter()
            .filter(|c| c.mean() > 3.3 * (c.variance_of_mean() + systematic).sqrt())
            .count();
        result
    }
}

/// Percentile of sorted values by linear interpolation between ranks.
fn percentile(sorted: &[f64], percent: f64) -> f64 {
    let rank = (percent / 100.0).clamp(0.0, 1.0) * (sorted.len() - 1) as f64;
    let (low, share) = (rank.floor() as usize, rank.fract());
    let high = (low + 1).min(sorted.len() - 1);
    sorted[low] + share * (sorted[high] - sorted[low])
}
