//! Wear of tooth flanks from signed deviations.
//!
//! ```text
//!  points on CAD ──► field (cells of profile by height) ──► figures ──► with influences: budget, corrected depth
//!                      └─ since a baseline's field             └─ edge (rounding of the tip)
//! ```
//!
//! Each cell's wear is minus the deviation of its points, averaged over the cell; averaging removes their noise. What is said of a flank
//! is in [`Figures`], where the uncertainty comes from in [`Budget`].

mod budget;
mod cell;
mod edge;
mod field;
mod figures;
mod likely;

use nalgebra::{Vector3, Vector6};

pub use budget::Budget;
use cell::Cell;
pub use field::{Field, Mismatch};
pub use figures::{DETECTION_FACTOR, Figure, Figures};

use crate::gear::{Flank, FlankPlace, GearData};
use crate::leakage::{Leakage, Recovery};
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

impl Zone {
    /// Whether a place on a flank lies in it.
    pub fn holds(&self, radius_mm: f64, height_mm: f64) -> bool {
        (self.radius_mm[0]..self.radius_mm[1]).contains(&radius_mm)
            && (self.height_mm[0]..self.height_mm[1]).contains(&height_mm)
    }
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
    /// Standard uncertainty of what is left of calibration and CAD in a difference to a baseline, mm: drift of the head.
    pub drift_mm: f64,
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
            drift_mm: 0.5e-3,
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
#[derive(Debug, Clone, PartialEq)]
pub struct FlankWear {
    /// Tooth, from 1.
    pub tooth: u32,
    /// Side.
    pub flank: Flank,
    /// The figure that is judged: percentile over the cells, corrected for bias and leakage, mm.
    pub wear_mm: f64,
    /// Its standard uncertainty, mm.
    pub u_mm: f64,
    /// Mean over the cells, mm.
    pub mean_mm: f64,
    /// All figures, their `u` from noise alone; none when no cell was measured.
    pub figures: Option<Figures>,
    /// Radius of the tip edge's rounding, mm; none when the edge was not seen whole.
    pub tip_radius_mm: Option<Figure>,
    /// Measured share of the zone.
    pub coverage: f64,
    /// Points in the zone.
    pub points: usize,
    /// Where the uncertainty comes from.
    pub budget: Budget,
    /// Leakage of the pose, where it was computed.
    pub leakage: Option<Leakage>,
    /// Wear that the same side of the other teeth in view shows, mm.
    pub shared_mm: f64,
    /// The cells themselves.
    pub field: Field,
}

impl FlankWear {
    /// Expanded uncertainty (95 %), mm.
    pub fn u95_mm(&self) -> f64 {
        1.96 * self.u_mm
    }

    /// Standard uncertainty of the mean: noise averages over the cells, the rest does not, mm.
    pub fn u_mean_mm(&self) -> f64 {
        let noise = self.figures.map_or(f64::NAN, |f| f.mean_mm.u);
        noise.hypot(self.budget.systematic_mm())
    }
}

/// What acts on a flank beside the points: from the fit and the thermometer.
#[derive(Debug, Clone, Copy)]
pub struct Influence {
    /// Leakage of the pose.
    pub leakage: Leakage,
    /// Wear that the same side of the other teeth in view shows, mm.
    pub shared_mm: f64,
    /// Standard uncertainty that the temperature leaves in the flank's deviation, mm.
    pub temperature_mm: f64,
}

/// The grid over one flank's zone.
struct Grid {
    tooth: u32,
    flank: Flank,
    profile_from_mm: f64,
    shape: Field,
    cells: Vec<Cell>,
    /// Sum of the points' effect of a small motion on their deviation, for the registration's share.
    motion: Vector6<f64>,
    points: usize,
    edge: edge::TipBand,
}

/// Where each closest point lies on the gear; none off the flanks.
pub fn places(gear: &GearData, closest: &[Closest]) -> Vec<Option<FlankPlace>> {
    // The CAD point, not the measured one, says where on the flank we are: wear must not move a point out of its zone.
    closest
        .iter()
        .map(|c| gear.place(c.point, c.normal))
        .collect()
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
    let height_mm = zone.height_mm[1] - zone.height_mm[0];
    let cells_in =
        |length_mm: f64| ((length_mm / settings.cell_mm).floor() as usize).clamp(1, 10_000);
    let columns = cells_in(profile_length_mm);
    let rows = cells_in(height_mm);
    let empty = Field {
        columns,
        rows,
        cell_mm: [profile_length_mm / columns as f64, height_mm / rows as f64],
        wear_mm: vec![f64::NAN; columns * rows],
        variance_mm2: vec![f64::NAN; columns * rows],
    };
    let mut grids: Vec<Grid> = teeth
        .iter()
        .flat_map(|&tooth| Flank::BOTH.map(|flank| (tooth, flank)))
        .map(|(tooth, flank)| Grid {
            tooth,
            flank,
            profile_from_mm,
            shape: empty.clone(),
            cells: vec![Cell::default(); columns * rows],
            motion: Vector6::zeros(),
            points: 0,
            edge: edge::TipBand::new(gear),
        })
        .collect();
    let centre = Vector3::from(registration.map_or([0.0; 3], |r| r.centre_mm));

    let points = measured.points.iter().zip(measured.closest);
    for (index, ((point, closest), place)) in points.zip(places(gear, measured.closest)).enumerate()
    {
        let Some(place) = place else {
            continue;
        };
        let wanted = |g: &&mut Grid| g.tooth == place.tooth && g.flank == place.flank;
        let Some(grid) = grids.iter_mut().find(wanted) else {
            continue;
        };
        let (along, up) = (
            (place.profile_mm - grid.profile_from_mm) / profile_length_mm,
            (place.height_mm - zone.height_mm[0]) / height_mm,
        );
        if !(0.0..1.0).contains(&up) || !closest.signed_distance_mm.is_finite() {
            continue;
        }
        let wear_mm = -closest.signed_distance_mm;
        grid.edge.add(&place, wear_mm);
        if !(0.0..1.0).contains(&along) {
            continue;
        }
        let (along, up) = (along * columns as f64, up * rows as f64);
        let cell = up as usize * columns + along as usize;
        let sigma = measured
            .sigma_mm
            .and_then(|s| s.get(index))
            .map_or(f64::NAN, |&s| f64::from(s));
        grid.cells[cell].add([along, up].map(|x| x.fract() - 0.5), wear_mm, sigma);
        grid.points += 1;
        let normal = Vector3::from(closest.normal);
        let turn = (Vector3::from(*point) - centre).cross(&normal);
        grid.motion += Vector6::new(turn.x, turn.y, turn.z, normal.x, normal.y, normal.z);
    }
    grids
        .into_iter()
        .map(|grid| grid.wear(gear, registration, settings))
        .collect()
}

impl Grid {
    fn wear(
        self,
        gear: &GearData,
        registration: Option<&Registration>,
        settings: &Settings,
    ) -> FlankWear {
        let mut field = self.shape;
        for (i, cell) in self.cells.iter().enumerate() {
            if let Some([mean, variance]) = cell.mean(settings.least_points) {
                field.wear_mm[i] = mean;
                field.variance_mm2[i] = variance;
            }
        }
        let registration_mm = registration.map_or(0.0, |registration| {
            let motion = self.motion / self.points.max(1) as f64;
            motion
                .dot(&(registration.covariance * motion))
                .max(0.0)
                .sqrt()
        });
        let mut wear = FlankWear {
            tooth: self.tooth,
            flank: self.flank,
            wear_mm: f64::NAN,
            u_mm: f64::NAN,
            mean_mm: f64::NAN,
            figures: None,
            tip_radius_mm: None,
            coverage: field.coverage(),
            points: self.points,
            budget: Budget {
                registration_mm,
                calibration_mm: settings.calibration_mm,
                cad_mm: settings.cad_mm,
                ..Budget::default()
            },
            leakage: None,
            shared_mm: 0.0,
            field,
        };
        wear.refigure(settings);
        // Pose and temperature move edge and flank alike; calibration does not.
        wear.tip_radius_mm = wear.figures.and_then(|f| {
            self.edge
                .radius_mm(gear, f.mean_mm.value, settings.calibration_mm)
        });
        wear
    }
}

impl FlankWear {
    /// Computes the figures from the field and the budget as they are now.
    fn refigure(&mut self, settings: &Settings) {
        let systematic_mm = self.budget.systematic_mm();
        self.figures = figures::evaluate(&self.field, settings.percentile, systematic_mm);
        let Some(figures) = &mut self.figures else {
            self.budget = Budget::UNKNOWN;
            return;
        };
        self.budget.noise_mm = figures.depth_mm.u;
        if let Some(leakage) = &self.leakage {
            match leakage.recovery() {
                Recovery::Corrected { factor } => {
                    figures.depth_mm.value *= factor;
                    figures.mean_mm.value *= factor;
                    self.budget.noise_mm *= factor;
                }
                Recovery::Accepted | Recovery::Refused => {}
            }
            self.budget.leakage_mm = leakage.u_mm(figures.depth_mm.value);
            let Budget {
                calibration_mm,
                registration_mm,
                cad_mm,
                ..
            } = self.budget;
            // What all teeth may seem to have lost without having done so.
            let feigned_mm = calibration_mm.hypot(registration_mm).hypot(cad_mm);
            if self.shared_mm.abs() > DETECTION_FACTOR * feigned_mm {
                let u_shared_mm = leakage.u_shared_mm(self.shared_mm);
                self.budget.leakage_mm = self.budget.leakage_mm.hypot(u_shared_mm);
            }
        }
        self.wear_mm = figures.depth_mm.value;
        self.mean_mm = figures.mean_mm.value;
        self.u_mm = self.budget.total_mm();
    }

    /// What was lost since `reference` was captured by the same instrument: the depth figures become differences, the tip
    /// edge stays as it is. Calibration and CAD cancel but for the head's drift; the pose of the reference counts as well.
    ///
    /// # Errors
    /// The reference has other cells.
    pub fn since(mut self, reference: &Field, settings: &Settings) -> Result<Self, Mismatch> {
        self.field = self.field.since(reference)?;
        self.coverage = self.field.coverage();
        self.budget.calibration_mm = settings.drift_mm;
        self.budget.cad_mm = 0.0;
        self.budget.reference_mm = self.budget.registration_mm;
        // What the other teeth showed then is not in the reference.
        self.shared_mm = 0.0;
        self.refigure(settings);
        Ok(self)
    }

    /// Several captures of one flank as one: noise averages, whatever else is uncertain stays as it is in the worst of
    /// them. None without a capture, or when their zones differ.
    #[must_use]
    pub fn together(captures: &[&Self], settings: &Settings) -> Option<Self> {
        let (&first, others) = captures.split_first()?;
        let mut wear = first.clone();
        if others.is_empty() {
            return Some(wear);
        }
        let fields: Vec<&Field> = captures.iter().map(|wear| &wear.field).collect();
        wear.field = Field::mean(&fields)?;
        wear.coverage = wear.field.coverage();
        wear.points = captures.iter().map(|wear| wear.points).sum();
        for other in others {
            wear.budget.registration_mm = wear
                .budget
                .registration_mm
                .max(other.budget.registration_mm);
            let worse = |a: &Leakage, b: &Leakage| a.worst() > b.worst();
            if let (Some(a), Some(b)) = (&other.leakage, &wear.leakage)
                && worse(a, b)
            {
                wear.leakage = other.leakage;
            }
        }
        wear.refigure(settings);
        Some(wear)
    }

    /// The same flank with the fit's leakage and the temperature's share counted in.
    #[must_use]
    pub fn with(mut self, influence: &Influence, settings: &Settings) -> Self {
        self.leakage = Some(influence.leakage);
        self.shared_mm = influence.shared_mm;
        self.budget.temperature_mm = influence.temperature_mm;
        self.refigure(settings);
        self
    }
}
