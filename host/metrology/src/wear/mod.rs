//! Wear of tooth flanks from signed deviations.
//!
//! ```text
//!  points on CAD ──► discs: largest mean loss over a stated area (the measurand) ──► depth and its noise ─┐
//!        │           └─ since a baseline's cells                                                          ├─► FlankWear
//!        ├──► cells: what is drawn, recorded, and where nothing was measured                              │   with budget
//!        ├──► edge: rounding of the tip                                                                   │
//!        └──► all flanks in view: what a turn of the pose may hide (shared) ──────────────────────────────┘
//!  points of many views ──► parts of cells (gather) ──► the same
//! ```
//!
//! Wear is minus the deviation. **Wear depth of a zone is the largest mean loss over any disc of a stated area in it**: no
//! shape of damage is presumed. What is said of a flank is in [`Figures`], where the uncertainty comes from in [`Budget`].

mod budget;
mod disc;
mod edge;
mod evaluate;
mod field;
mod figures;
mod gather;
pub mod leakage;
mod shared;
mod sight;
pub mod standing;
mod unseen;
#[cfg(test)]
pub(crate) use unseen::tests as looked;

use std::sync::Arc;

use flankscope_foundation::normal::{COVERAGE_95, guard_factor};
use flankscope_foundation::order::median_of;

pub use budget::Budget;
pub use edge::{TipLoss, tip_loss_mm2};
pub use evaluate::{evaluate, evaluate_placed, places};
use field::Sample;
pub use field::{Field, Mismatch};
pub use figures::{DETECTION_FACTOR, Figure, Figures};
pub use gather::{FlankPoint, FlankView, Gathered};
pub use shared::{PoseEvidence, SeenFlank, Turn};
pub use sight::Sight;
use sight::Visibility;

use crate::gear::Flank;
use crate::surface::Closest;
use crate::wear::leakage::Leakage;

/// The part of each flank that is judged, or of a patch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Zone {
    /// Least and largest radius, mm; of a patch, length along it from its origin.
    pub radius_mm: [f64; 2],
    /// Least and largest height, mm; of a patch, up from its origin.
    pub height_mm: [f64; 2],
}

impl Zone {
    /// Whether a place on a flank lies in it.
    pub fn holds(&self, radius_mm: f64, height_mm: f64) -> bool {
        (self.radius_mm[0]..self.radius_mm[1]).contains(&radius_mm)
            && (self.height_mm[0]..self.height_mm[1]).contains(&height_mm)
    }
}

/// Area of the disc over which the largest mean loss is sought, unless the tool file says otherwise, mm2.
pub const AREA_MM2: f64 = 0.25;

/// How wear is computed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// Area of the disc over which the largest mean loss is sought, mm2.
    pub area_mm2: f64,
    /// Loss that is supposed wherever nothing was measured, mm: what a hole may hide is judged by it.
    pub hidden_depth_mm: f64,
    /// Standard uncertainty of the calibration, mm.
    pub calibration_mm: f64,
    /// Standard uncertainty of what is left of calibration and CAD in a difference to a baseline, mm: drift of the head.
    pub drift_mm: f64,
    /// Standard uncertainty of the CAD surface (chord error), mm.
    pub cad_mm: f64,
    /// Standard uncertainty of a flank's form as built against CAD, mm.
    pub as_built_mm: f64,
    /// Thickest film of oil or spray that may lie on a flank, mm.
    pub film_mm: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            area_mm2: AREA_MM2,
            hidden_depth_mm: 0.3,
            calibration_mm: 2e-3,
            drift_mm: 0.5e-3,
            cad_mm: 1e-3,
            as_built_mm: 0.0,
            film_mm: 0.0,
        }
    }
}

impl Settings {
    /// Edge of a cell, mm: a fifth of the disc's diameter.
    pub fn cell_mm(&self) -> f64 {
        2.0 * disc::radius_mm(self.area_mm2) / disc::CELLS_ACROSS
    }

    /// To what a flank's form is known, mm: calibration, CAD and as-built form, or what is left of them since a baseline.
    fn form_mm(&self, since_baseline: bool) -> f64 {
        let film_mm = self.film_mm / 12f64.sqrt();
        if since_baseline {
            self.drift_mm.hypot(film_mm * 2f64.sqrt())
        } else {
            self.calibration_mm
                .hypot(self.cad_mm)
                .hypot(self.as_built_mm)
                .hypot(film_mm)
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
    /// The camera that saw them; without it only a cell without any point counts as not seen.
    pub sight: Option<Sight<'a>>,
}

/// Wear of one flank. Positive is loss. A flank without measured cells has NaN figures and coverage 0, which no verdict
/// takes for go.
#[derive(Debug, Clone, PartialEq)]
pub struct FlankWear {
    /// Tooth or patch, from 1.
    pub tooth: u32,
    /// Side.
    pub flank: Flank,
    /// Wear depth, the figure that is judged: the largest mean loss over a disc, with what the pose and a film hide of it
    /// added as far as that is known, mm.
    pub wear_mm: f64,
    /// Its standard uncertainty, mm.
    pub u_mm: f64,
    /// The largest mean loss as read, in the same pose, mm: without the bias of a maximum taken off.
    pub raw_mm: f64,
    /// Mean loss over the zone, mm.
    pub mean_mm: f64,
    /// Largest mean height of proud material over a disc, mm.
    pub proud_mm: f64,
    /// Loss of the cell that lost most, with its standard uncertainty, mm.
    pub cell_mm: Figure,
    /// The largest mean loss that a disc with unmeasured parts may have, mm; none when every disc was measured whole.
    pub hidden_mm: Option<f64>,
    /// All figures of the zone as read, their `u` from noise alone; none when no disc could be measured.
    pub figures: Option<Figures>,
    /// Rounding of the tip edge; none when the edge was not seen.
    pub tip: Option<TipLoss>,
    /// Measured share of the zone.
    pub coverage: f64,
    /// Points in the zone.
    pub points: usize,
    /// Where the uncertainty comes from.
    pub budget: Budget,
    /// What acts on the flank beside the points, where it is known.
    pub sensitivity: Option<PoseSensitivity>,
    /// The cells.
    pub field: Field,
    /// What the pose leaves open of a turn about the axis, where it is known.
    pub turn: Option<Turn>,
    /// The points.
    samples: Vec<Sample>,
    /// How well the cells were seen, where the rays are known.
    visibility: Option<Visibility>,
    /// What the view of each capture said of its pose about the axis.
    evidence: Vec<Arc<PoseEvidence>>,
    /// Whether it is the difference to a baseline.
    since_baseline: bool,
}

impl FlankWear {
    /// Expanded uncertainty (95 %, coverage factor 1.96), mm.
    pub fn u95_mm(&self) -> f64 {
        COVERAGE_95 * self.u_mm
    }

    /// What the flank has lost at least, with 95 % probability, mm: where walls may hide so much that an interval about the figure
    /// would claim too much. None where the interval holds.
    pub fn at_least_mm(&self) -> Option<f64> {
        let figures = self.figures?;
        let holds = figures.behind_walls_mm? <= figures.raw_mm + self.u95_mm();
        (!holds).then(|| self.wear_mm - guard_factor(0.95) * self.u_mm)
    }

    /// Standard uncertainty of the mean: noise averages over the cells, the rest does not, mm.
    pub fn u_mean_mm(&self) -> f64 {
        let noise = self.figures.map_or(f64::NAN, |f| f.mean_mm.u);
        noise.hypot(self.budget.systematic_mm())
    }

    /// Standard uncertainty of the height of proud material, mm.
    pub fn u_proud_mm(&self) -> f64 {
        let noise = self.figures.map_or(f64::NAN, |f| f.proud_mm.u);
        noise.hypot(self.budget.systematic_mm())
    }

    /// The least wear that is told from none with 5 % errors of both kinds, mm.
    pub fn detection_limit_mm(&self) -> f64 {
        DETECTION_FACTOR * self.budget.without_wear_mm()
    }
}

/// What acts on a flank beside the points: from the fit and the thermometer.
#[derive(Debug, Clone, PartialEq)]
pub struct PoseSensitivity {
    /// Leakage of the pose.
    pub leakage: Leakage,
    /// What the view says of its own pose about the axis; none where the pose rests on a datum that does not wear.
    pub evidence: Option<Arc<PoseEvidence>>,
    /// Standard deviation of the form from flank to flank, mm, where all flanks of a die show it; zero where only what the
    /// settings state is known.
    pub form_scatter_mm: f64,
    /// Root of the sum of squares of what the judged flank reads of a unit error in the form of each other flank.
    pub others_form: f64,
    /// Standard uncertainty that the temperature leaves in the flank's deviation, mm.
    pub temperature_mm: f64,
}

/// Makes ready what all evaluations share, so that the first one need not.
pub fn prepare() {
    disc::prepare();
}

impl FlankWear {
    /// Wear of the points of an empty field.
    fn new(
        (tooth, flank): (u32, Flank),
        empty: Field,
        mut samples: Vec<Sample>,
        visibility: Option<Visibility>,
        registration_mm: f64,
        settings: &Settings,
    ) -> Self {
        state_noise(&empty, &mut samples);
        let mut wear = Self {
            tooth,
            flank,
            wear_mm: f64::NAN,
            u_mm: f64::NAN,
            raw_mm: f64::NAN,
            mean_mm: f64::NAN,
            proud_mm: f64::NAN,
            cell_mm: Figure::UNKNOWN,
            hidden_mm: None,
            figures: None,
            tip: None,
            coverage: 0.0,
            points: samples.len(),
            budget: Budget {
                registration_mm,
                calibration_mm: settings.calibration_mm,
                cad_mm: settings.cad_mm,
                as_built_mm: settings.as_built_mm,
                film_mm: settings.film_mm / 12f64.sqrt(),
                ..Budget::default()
            },
            sensitivity: None,
            field: empty,
            turn: None,
            samples,
            visibility,
            evidence: Vec::new(),
            since_baseline: false,
        };
        wear.refigure(None, None, settings);
        wear
    }

    /// Wear of a zone of `size_mm` from points in it: place, wear, standard uncertainty, mm.
    #[cfg(test)]
    pub(crate) fn of_points(
        key: (u32, Flank),
        size_mm: [f64; 2],
        points: &[([f64; 2], f64, f64)],
        settings: &Settings,
    ) -> Self {
        let sample = |&(at_mm, wear_mm, sigma_mm): &([f64; 2], f64, f64)| {
            Sample::of_point(at_mm, wear_mm, sigma_mm * sigma_mm)
        };
        let samples = points.iter().map(sample).collect();
        let empty = Field::unmeasured(size_mm, settings.cell_mm());
        Self::new(key, empty, samples, None, 0.0, settings)
    }
}

/// Points that state no noise get what they scatter by in their cells: of all cells with enough points the median, which
/// damage of less than half of the zone does not reach.
fn state_noise(cells: &Field, samples: &mut [Sample]) {
    if samples.iter().all(|s| s.variance_mm2.is_finite()) {
        return;
    }
    let mut sums = vec![[0.0_f64; 3]; cells.wear_mm.len()];
    for sample in samples.iter() {
        if let Some(cell) = cells.cell_at(sample.at_mm) {
            let w = sample.wear_mm;
            sums[cell] = [
                sums[cell][0] + 1.0,
                sums[cell][1] + w,
                sums[cell][2] + w * w,
            ];
        }
    }
    let scatter = median_of(
        sums.iter()
            .filter(|s| s[0] >= 3.0)
            .map(|[n, sum, squares]| ((squares - sum * sum / n).max(0.0) / (n - 1.0)).sqrt()),
    )
    .unwrap_or(f64::NAN);
    for sample in samples.iter_mut().filter(|s| !s.variance_mm2.is_finite()) {
        sample.variance_mm2 = scatter * scatter;
    }
}

impl FlankWear {
    /// Computes cells, figures and budget from the points; what the cells of `reference` state as noise is added to theirs,
    /// and `before` is what its view said of its pose.
    fn refigure(
        &mut self,
        reference: Option<&Field>,
        before: Option<&PoseEvidence>,
        settings: &Settings,
    ) {
        let cells = self.field.wear_mm.len();
        let mut sums = vec![[0.0_f64; 3]; cells];
        for sample in &self.samples {
            if let Some(cell) = self.field.cell_at(sample.at_mm) {
                let [n, wear, variance] = sums[cell];
                sums[cell] = [
                    n + 1.0,
                    wear + sample.wear_mm,
                    variance + sample.variance_mm2,
                ];
            }
        }
        for (i, [n, wear, variance]) in sums.into_iter().enumerate() {
            let of_reference = reference.map_or(0.0, |r| r.variance_mm2[i]);
            // 0 / 0: not measured.
            self.field.wear_mm[i] = wear / n;
            self.field.variance_mm2[i] = variance / (n * n) + of_reference;
        }
        self.coverage = self.field.coverage();
        let systematic_mm = self.budget.systematic_mm();
        let noise_scale = self.field.noise_scale();
        self.figures = figures::evaluate(
            &self.field,
            &self.samples,
            noise_scale,
            self.visibility.as_ref(),
            settings,
            systematic_mm,
        );
        self.settle(before, settings);
    }

    /// Computes what is judged from figures, pose sensitivity and settings; `before` is what the baseline's view said of its pose.
    fn settle(&mut self, before: Option<&PoseEvidence>, settings: &Settings) {
        let Some(figures) = self.figures else {
            return;
        };
        self.budget.noise_mm = figures.depth_mm.u;
        // Anything between what was seen and that: rectangular, of which the figure is the lower end.
        self.budget.unmeasured_mm = figures.in_holes_mm / 3f64.sqrt();
        let (mut shift_mm, film_mm) = (0.0, settings.film_mm);
        if let Some(sensitivity) = &self.sensitivity {
            let forms = [self.since_baseline, false]
                .map(|since| settings.form_mm(since).hypot(sensitivity.form_scatter_mm));
            if !self.evidence.is_empty() {
                let turns = self
                    .evidence
                    .iter()
                    .map(|of| of.turn(before, forms[0], forms[1]));
                let turn = Turn::of_all(turns);
                shift_mm = self.flank.sign() * turn.mean_mm;
                // f64::min passes over the NaN of a pose that hides everything: then the stages alone say how much.
                let both_mm = sensitivity
                    .leakage
                    .u_of_all_mm(turn.both_sides_mm)
                    .min(turn.both_hidden_mm);
                self.budget.shared_mm = turn.u_mm.hypot(both_mm);
                self.turn = Some(turn);
            }
            self.budget.temperature_mm = sensitivity.temperature_mm;
            let passed_on = 1f64.hypot(sensitivity.others_form);
            if !self.since_baseline {
                self.budget.as_built_mm = settings.as_built_mm * passed_on;
            }
            // From a datum, loss is a distance, of which calibration knows either end no better.
            if self.evidence.is_empty() {
                let one_end_mm = match self.since_baseline {
                    true => settings.drift_mm,
                    false => settings.calibration_mm,
                };
                self.budget.calibration_mm = one_end_mm * passed_on;
            }
            self.budget.leakage_mm = sensitivity.leakage.u_mm(figures.depth_mm.value + shift_mm);
        }
        // A film only ever hides wear; since a baseline, one may have been there before as well as now.
        let over_mm = if self.since_baseline {
            0.0
        } else {
            0.5 * film_mm
        };
        let moved_mm = shift_mm + over_mm;
        self.wear_mm = figures.depth_mm.value + moved_mm;
        self.raw_mm = figures.raw_mm + moved_mm;
        self.mean_mm = figures.mean_mm.value + moved_mm;
        self.proud_mm = figures.proud_mm.value - moved_mm;
        self.cell_mm = Figure {
            value: figures.cell_mm.value + moved_mm,
            u: figures.cell_mm.u.hypot(self.budget.systematic_mm()),
        };
        self.hidden_mm = figures.hidden_mm.map(|hidden| hidden + moved_mm);
        self.u_mm = self.budget.total_mm();
    }

    /// What was lost since `reference` was captured by the same instrument: depth figures become differences, the tip edge
    /// stays as it is. Calibration, CAD and as-built form cancel but for the head's drift; the pose of the reference counts
    /// as well. `before` is what the reference's view said of its pose.
    ///
    /// # Errors
    /// The reference has other cells.
    pub fn since(
        mut self,
        reference: &Field,
        before: Option<&PoseEvidence>,
        settings: &Settings,
    ) -> Result<Self, Mismatch> {
        self.field.same_grid(reference)?;
        self.samples.retain_mut(|sample| {
            let then = self
                .field
                .cell_at(sample.at_mm)
                .map_or(f64::NAN, |cell| reference.wear_mm[cell]);
            sample.wear_mm -= then;
            then.is_finite()
        });
        self.since_baseline = true;
        self.budget.calibration_mm = settings.drift_mm;
        self.budget.cad_mm = 0.0;
        self.budget.as_built_mm = 0.0;
        self.budget.film_mm = settings.film_mm / 6f64.sqrt();
        self.budget.reference_mm = self.budget.registration_mm;
        self.refigure(Some(reference), before, settings);
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
        for other in others {
            wear.field.same_grid(&other.field).ok()?;
            wear.samples.extend_from_slice(&other.samples);
            wear.points += other.points;
            match (&mut wear.visibility, &other.visibility) {
                (Some(seen), Some(more)) => seen.add(more),
                (mine, _) => *mine = None,
            }
            wear.budget.registration_mm = wear
                .budget
                .registration_mm
                .max(other.budget.registration_mm);
            let leaks = |wear: &Self| wear.sensitivity.as_ref().map(|i| i.leakage.worst());
            if leaks(other) > leaks(&wear) {
                wear.sensitivity.clone_from(&other.sensitivity);
            }
            wear.evidence.extend(other.evidence.iter().cloned());
            wear.tip = wear.tip.or(other.tip);
        }
        wear.refigure(None, None, settings);
        Some(wear)
    }

    /// The same flank with the fit's leakage, the pose's evidence and the temperature's share counted in.
    #[must_use]
    pub fn with(mut self, sensitivity: PoseSensitivity, settings: &Settings) -> Self {
        self.evidence = sensitivity.evidence.iter().cloned().collect();
        self.sensitivity = Some(sensitivity);
        self.settle(None, settings);
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::normal;

    const SIZE_MM: [f64; 2] = [1.6, 4.0];
    const NOISE_MM: f64 = 2e-3;

    /// Four points a cell of a flank that lost 30 µm, with a pattern of this size that is the same in every capture, and noise
    /// of the capture's own.
    fn capture(pattern_mm: f64, seed: u64) -> FlankWear {
        let settings = Settings {
            calibration_mm: 5e-4,
            cad_mm: 0.0,
            ..Settings::default()
        };
        let cells = Field::unmeasured(SIZE_MM, settings.cell_mm());
        let points: Vec<([f64; 2], f64, f64)> = (0..4 * cells.wear_mm.len())
            .map(|i| {
                let (cell, part) = (i / 4, i % 4);
                let [column, row] = [cell % cells.columns, cell / cells.columns];
                let within = [part % 2, part / 2].map(|k| 0.25 + 0.5 * k as f64);
                let at = [
                    (column as f64 + within[0]) * cells.cell_mm[0],
                    (row as f64 + within[1]) * cells.cell_mm[1],
                ];
                let wear = 0.030 + pattern_mm * normal(99, cell as u64);
                (at, wear + NOISE_MM * normal(seed, i as u64), NOISE_MM)
            })
            .collect();
        let mut wear = FlankWear::of_points((40, Flank::Left), SIZE_MM, &points, &settings);
        wear.budget.registration_mm = seed as f64 * 1e-4;
        wear
    }

    /// Noise of the mean loss from one, two and four captures.
    fn noise_of(pattern_mm: f64) -> [f64; 3] {
        let captures: Vec<FlankWear> = (1..5).map(|seed| capture(pattern_mm, seed)).collect();
        [1, 2, 4].map(|count| {
            let of: Vec<&FlankWear> = captures.iter().take(count).collect();
            let together = FlankWear::together(&of, &Settings::default()).unwrap();
            let worst = count as f64 * 1e-4;
            assert!((together.budget.registration_mm - worst).abs() < 1e-12);
            together.figures.unwrap().mean_mm.u
        })
    }

    #[test]
    fn noise_falls_with_the_root_of_the_captures_and_a_fixed_pattern_does_not() {
        // The scatter of some 450 cells is known to about 5 %.
        let [one, two, four] = noise_of(0.0);
        assert!((two / one - 0.5_f64.sqrt()).abs() < 0.1, "{one} {two}");
        assert!((four / two - 0.5_f64.sqrt()).abs() < 0.1, "{two} {four}");
        let [one, two, four] = noise_of(20e-3);
        assert!(
            (two / one - 1.0).abs() < 0.1 && (four / one - 1.0).abs() < 0.1,
            "{one} {two} {four}"
        );
    }

    #[test]
    fn one_capture_stays_as_it_is_and_none_is_none() {
        let captured = capture(0.0, 1);
        let same = FlankWear::together(&[&captured], &Settings::default()).unwrap();
        assert_eq!(same, captured);
        assert!(FlankWear::together(&[], &Settings::default()).is_none());
    }

    #[test]
    fn a_difference_to_a_baseline_takes_off_what_was_there() {
        let (new, now) = (capture(20e-3, 1), capture(20e-3, 2));
        let settings = Settings::default();
        let since = now.since(&new.field, None, &settings).unwrap();
        // 30 µm and the pattern were there before; cells of four points of 2 µm in both captures, twenty to a disc.
        let cell_mm = NOISE_MM * (2.0f64 / 4.0).sqrt();
        assert!(
            since.wear_mm.abs() < 4.0 * cell_mm / 20f64.sqrt(),
            "{}",
            since.wear_mm
        );
        assert_eq!(since.budget.calibration_mm, settings.drift_mm);
        assert!(since.budget.noise_mm < cell_mm / 4.0);
    }

    #[test]
    fn a_film_hides_wear_and_counts_as_what_it_may_hide() {
        let plain = capture(0.0, 1);
        let settings = Settings {
            film_mm: 12e-3,
            ..Settings::default()
        };
        let mut oiled = plain.clone();
        oiled.budget.film_mm = settings.film_mm / 12f64.sqrt();
        oiled.refigure(None, None, &settings);
        assert!((oiled.wear_mm - plain.wear_mm - 6e-3).abs() < 1e-12);
        assert!((oiled.proud_mm - plain.proud_mm + 6e-3).abs() < 1e-12);
        // Between nothing and all of it, evenly: its standard deviation is a twelfth's root.
        let added = oiled.u_mm.powi(2) - plain.u_mm.powi(2);
        assert!(
            (added.sqrt() - 12e-3 / 12f64.sqrt()).abs() < 1e-5,
            "{added}"
        );
    }
}
