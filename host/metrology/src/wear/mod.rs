//! Wear of tooth flanks from signed deviations.
//!
//! ```text
//!  points on CAD ──► discs: largest mean loss over a stated area (the measurand) ──► depth and its noise ─┐
//!        │           └─ since a baseline's cells                                                          ├─► FlankWear
//!        ├──► cells: what is drawn, recorded, and where nothing was measured                              │   with budget
//!        ├──► edge: rounding of the tip                                                                   │
//!        └──► all flanks in view: turn of the pose that looks like wear (shared, sensitivity) ────────────┘
//!  points of many views ──► parts of cells (gather) ──► the same
//! ```
//!
//! Wear is minus the deviation. **Wear depth of a zone is the largest mean loss over any disc of a stated area in it**: no
//! shape of damage is presumed. The figures of a flank are in [`JudgedFigures`], their sources of uncertainty in [`Budget`].

mod approaches;
mod brightness;
mod budget;
mod disc;
mod edge;
mod evaluate;
mod field;
mod figures;
mod further;
mod gather;
pub mod leakage;
pub mod mount;
mod one_sided;
mod scratches;
pub mod sensitivity;
mod shared;
mod sight;
pub mod standing;
mod texture;
mod unseen;
#[cfg(test)]
pub(crate) use unseen::tests as looked;

use std::borrow::Cow;
use std::sync::Arc;

use flankscope_foundation::normal::{COVERAGE_95, guard_factor};
use flankscope_foundation::order::median_of;

pub use approaches::Approaches;
pub use budget::Budget;
pub use edge::{TipLoss, tip_loss_mm2};
pub use evaluate::{evaluate, evaluate_placed, places};
use field::WearSample;
pub use field::{Field, Mismatch};
pub use figures::{DETECTION_FACTOR, Figure, Figures};
pub use gather::{FlankPoint, FlankView, Gathered};
pub use mount::MountPose;
pub use sensitivity::PoseSensitivity;
pub use shared::{
    ANY_POSE_MM, OppositeChange, PoseEvidence, SameMount, SeenFlank, Statement, Turn,
};
pub use sight::Sight;
use sight::Visibility;

use crate::gear::Flank;
use crate::surface::Closest;

/// The part of each flank that is judged, or of a patch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Zone {
    /// Least and largest radius, mm; of a patch, length along it from its origin.
    pub radius_mm: [f64; 2],
    /// Least and largest height, mm; of a patch, up from its origin.
    pub height_mm: [f64; 2],
}

impl Zone {
    /// Whether a place on a flank lies in the zone.
    pub fn holds(&self, radius_mm: f64, height_mm: f64) -> bool {
        (self.radius_mm[0]..self.radius_mm[1]).contains(&radius_mm)
            && (self.height_mm[0]..self.height_mm[1]).contains(&height_mm)
    }
}

/// Area of the disc over which the largest mean loss is sought, unless the tool file says otherwise, mm2.
pub const AREA_MM2: f64 = 0.25;

/// Settings of the wear evaluation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WearSettings {
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

impl Default for WearSettings {
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

/// Standard uncertainties of the stages within which equal and opposite changes are held for possible beside a local loss, against the
/// CAD and since a baseline. The second is the 95 % quantile; against the CAD, where mount and form as built count, too, as much would
/// refuse one light local loss in five.
const OPPOSITE_SIGMAS: [f64; 2] = [1.0, 1.645];

impl WearSettings {
    /// Edge of a cell, mm: a fifth of the disc's diameter.
    pub fn cell_mm(&self) -> f64 {
        2.0 * disc::radius_mm(self.area_mm2) / disc::CELLS_ACROSS
    }

    /// To what a flank's form is known, mm: calibration, CAD and as-built form, or what is left of them since a baseline.
    pub fn form_mm(&self, since_baseline: bool) -> f64 {
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

/// Wear of one flank in three stages: what was measured of its zone, the figures read from that ([`Figures`]), and the figures
/// that are judged ([`JudgedFigures`]). Positive is loss.
#[derive(Debug, Clone, PartialEq)]
pub struct FlankWear {
    /// Tooth or patch, from 1.
    pub tooth: u32,
    /// Side.
    pub flank: Flank,
    /// Number of points in the zone.
    pub points: usize,
    /// Cells of the zone with mean wear and noise; since a baseline, their difference to it.
    pub field: Field,
    /// Measured share of the zone's cells, 0 to 1.
    pub coverage: f64,
    /// Material lost at the tip edge; none when the edge was not seen.
    pub tip: Option<TipLoss>,
    /// Standard uncertainties by source, mm.
    pub budget: Budget,
    /// Effect of pose and temperature, computed from the fit; none until [`FlankWear::with`] adds it.
    pub sensitivity: Option<PoseSensitivity>,
    /// Figures that are judged; none when no disc could be measured, which no verdict takes for go.
    pub judged: Option<JudgedFigures>,
    measured: MeasuredZone,
}

/// Measurements of a zone, kept so that figures can be computed again: from several captures together, or since a baseline.
#[derive(Debug, Clone, PartialEq)]
struct MeasuredZone {
    /// The view that has the flank's tooth in its middle, and further views of it from elsewhere.
    views: Vec<ZoneView>,
    /// Whether the samples are differences to a baseline.
    since_baseline: bool,
}

/// What the captures from one place measured of a zone.
#[derive(Debug, Clone, Default, PartialEq)]
struct ZoneView {
    /// Points in the zone; since a baseline, their wear less that of the baseline's cells.
    samples: Vec<WearSample>,
    /// Rays and points per cell; none where the camera's position is not known.
    visibility: Option<Visibility>,
    /// Evidence of each capture about its pose's turn about the axis.
    evidence: Vec<Arc<PoseEvidence>>,
}

/// Figures of one flank after correction for the turn of its pose and for a film on it, with all uncertainties included.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JudgedFigures {
    /// The figures as read, their `u` from noise alone.
    pub read: Figures,
    /// Wear depth: largest mean loss over a disc of the stated area, less the bias that noise gives a maximum, mm.
    pub wear_mm: Figure,
    /// The same with that bias, mm.
    pub raw_mm: f64,
    /// Mean loss over the zone, mm. Noise averages over the cells, all other uncertainty does not.
    pub mean_mm: Figure,
    /// Largest mean height of proud material over a disc, mm.
    pub proud_mm: Figure,
    /// Largest loss of a single cell, mm; none when no cell holds enough points.
    pub cell_mm: Option<Figure>,
    /// Largest mean loss that a disc with unmeasured parts may have, mm; none when every disc was measured whole.
    pub hidden_mm: Option<f64>,
    /// Turn about the axis that the pose leaves open; none where no evidence was given.
    pub turn: Option<Turn>,
    /// Largest loss if equal and opposite changes of both sides of all teeth add to a local one, as far as the stages allow; none
    /// where no local loss is seen.
    pub with_opposite: Option<OppositeChange>,
}

impl JudgedFigures {
    /// Lower bound of the wear depth with 95 % probability, mm: given where walls may hide so much that an interval about the
    /// figure would claim too much. None where the interval holds.
    pub fn at_least_mm(&self) -> Option<f64> {
        let holds = self.read.behind_walls_mm? <= self.read.raw_mm + self.wear_mm.u95();
        (!holds).then(|| self.wear_mm.value - guard_factor(0.95) * self.wear_mm.u)
    }
}

impl FlankWear {
    /// Wear depth; none when no disc could be measured.
    pub fn wear_mm(&self) -> Option<Figure> {
        self.judged.map(|judged| judged.wear_mm)
    }

    /// The least wear that is distinguished from none with an error probability of 5 % either way, mm.
    pub fn detection_limit_mm(&self) -> f64 {
        DETECTION_FACTOR * self.budget.without_wear_mm()
    }
}

/// Computes the tables that all evaluations share in advance, which shortens the first one.
pub fn prepare() {
    disc::prepare();
}

impl FlankWear {
    /// Wear of the points of an empty field.
    fn new(
        (tooth, flank): (u32, Flank),
        empty: Field,
        mut samples: Vec<WearSample>,
        visibility: Option<Visibility>,
        registration_mm: f64,
        settings: &WearSettings,
    ) -> Self {
        state_noise(&empty, &mut samples);
        let mut wear = Self {
            tooth,
            flank,
            points: samples.len(),
            field: empty,
            coverage: 0.0,
            tip: None,
            budget: Budget {
                registration_mm,
                calibration_mm: settings.calibration_mm,
                cad_mm: settings.cad_mm,
                as_built_mm: settings.as_built_mm,
                film_mm: settings.film_mm / 12f64.sqrt(),
                ..Budget::default()
            },
            sensitivity: None,
            judged: None,
            measured: MeasuredZone {
                views: vec![ZoneView {
                    samples,
                    visibility,
                    evidence: Vec::new(),
                }],
                since_baseline: false,
            },
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
        settings: &WearSettings,
    ) -> Self {
        let sample = |&(at_mm, wear_mm, sigma_mm): &([f64; 2], f64, f64)| {
            WearSample::of_point(at_mm, wear_mm, sigma_mm * sigma_mm)
        };
        let samples = points.iter().map(sample).collect();
        let empty = Field::unmeasured(size_mm, settings.cell_mm());
        Self::new(key, empty, samples, None, 0.0, settings)
    }
}

/// Points that state no noise get what they scatter by in their cells: of all cells with enough points the median, which
/// damage of less than half of the zone does not reach.
fn state_noise(cells: &Field, samples: &mut [WearSample]) {
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
    /// Computes cells, figures and budget from the points. The noise variance of `reference`'s cells is added to that of the own
    /// ones; `before` is the evidence about the pose of the reference's view.
    fn refigure(
        &mut self,
        reference: Option<&Field>,
        before: Option<&PoseEvidence>,
        settings: &WearSettings,
    ) {
        let views = &self.measured.views;
        let main = &views[0];
        let joined = (views.len() > 1)
            .then(|| further::join(&self.field, views, reference, settings.area_mm2));
        let (samples, unseen) = match joined {
            Some(joined) => {
                self.field = joined.field;
                (Cow::from(joined.samples), Some(joined.unseen))
            }
            None => {
                self.field.average(&main.samples, reference);
                (Cow::from(&main.samples), None)
            }
        };
        self.coverage = self.field.coverage();
        let scale = self.field.noise_scale();
        let visibility = main.visibility.as_ref();
        let read = figures::evaluate(
            &self.field,
            &samples,
            scale,
            |discs| unseen.unwrap_or_else(|| unseen::of_cells(discs, visibility, scale)),
            settings,
            self.budget.systematic_mm(),
        );
        self.judged = read.map(|read| self.judge(read, before, settings));
    }

    /// Completes the budget by pose and temperature and corrects the figures as read for them; `before` is the evidence about
    /// the pose of the baseline's view.
    fn judge(
        &mut self,
        read: Figures,
        before: Option<&PoseEvidence>,
        settings: &WearSettings,
    ) -> JudgedFigures {
        let MeasuredZone {
            views,
            since_baseline,
        } = &self.measured;
        let main = &views[0];
        let is_alone = views.len() == 1;
        let budget = &mut self.budget;
        budget.noise_mm = read.depth_mm.u;
        // Anything between what was seen and that: rectangular, of which the figure is the lower end.
        budget.unmeasured_mm = read.in_holes_mm / 3f64.sqrt();
        let (mut shift_mm, mut turn) = (0.0, None);
        if let Some(sensitivity) = &self.sensitivity {
            let forms = [*since_baseline, false]
                .map(|since| settings.form_mm(since).hypot(sensitivity.form_scatter_mm));
            if !main.evidence.is_empty() {
                let turns = main.evidence.iter();
                let turns: Vec<Turn> = turns
                    .map(|view| view.turn(before, forms[0], forms[1]))
                    .collect();
                // The baseline has no evidence of a further view: it shows the flanks that the main view shows, or stands alone.
                let main_turn = main.evidence.iter().zip(&turns).next();
                let main_turn =
                    main_turn.filter(|(view, _)| before.is_some() && view.same_mount.is_some());
                let further = views.iter().skip(1).flat_map(|view| &view.evidence);
                let further = further.map(|view| {
                    let beside =
                        main_turn.and_then(|(main, turn)| view.beside(main, turn, forms[1]));
                    beside.unwrap_or_else(|| view.turn(None, forms[1], forms[1]))
                });
                let mean = Turn::of_all(turns.iter().copied().chain(further));
                shift_mm = self.flank.sign() * mean.mean_mm;
                // f64::min passes over the NaN of a pose that hides everything: then the stages alone say how much.
                let both_mm = sensitivity
                    .leakage
                    .u_of_all_mm(mean.both_sides_mm)
                    .min(mean.both_hidden_mm);
                budget.shared_mm = mean.u_mm.hypot(both_mm);
                turn = Some(mean);
            }
            budget.shared_mm = budget.shared_mm.hypot(sensitivity.datum_hides_mm);
            budget.temperature_mm = sensitivity.temperature_mm;
            let passed_on = 1f64.hypot(sensitivity.others_form);
            if !since_baseline {
                budget.as_built_mm = settings.as_built_mm * passed_on;
            }
            // From a datum, loss is a distance, of which calibration knows either end no better.
            if main.evidence.is_empty() {
                let one_end_mm = match *since_baseline && is_alone {
                    true => settings.drift_mm,
                    false => settings.calibration_mm,
                };
                budget.calibration_mm = one_end_mm * passed_on;
            }
            budget.leakage_mm = sensitivity.leakage.u_mm(read.depth_mm.value + shift_mm);
        }
        // A film only ever hides wear; since a baseline, one may have been there before as well as now.
        let over_mm = if *since_baseline {
            0.0
        } else {
            0.5 * settings.film_mm
        };
        let moved_mm = shift_mm + over_mm;
        let systematic_mm = budget.systematic_mm();
        let with_systematic = |value: f64, noise_mm: f64| Figure {
            value,
            u: noise_mm.hypot(systematic_mm),
        };
        JudgedFigures {
            read,
            wear_mm: Figure {
                value: read.depth_mm.value + moved_mm,
                u: budget.total_mm(),
            },
            raw_mm: read.raw_mm + moved_mm,
            mean_mm: with_systematic(read.mean_mm.value + moved_mm, read.mean_mm.u),
            proud_mm: with_systematic(read.proud_mm.value - moved_mm, read.proud_mm.u),
            cell_mm: read
                .cell_mm
                .map(|cell| with_systematic(cell.value + moved_mm, cell.u)),
            hidden_mm: read.hidden_mm.map(|hidden| hidden + moved_mm),
            with_opposite: turn.and_then(|turn: Turn| {
                let depth_mm = [read.depth_mm.value, COVERAGE_95 * budget.total_mm()];
                turn.with_opposite_mm(
                    self.flank,
                    depth_mm,
                    OPPOSITE_SIGMAS[usize::from(*since_baseline)],
                )
            }),
            turn,
        }
    }

    /// Wear since `reference` was captured by the same instrument: depth figures become differences, the tip edge
    /// stays as it is. Calibration, CAD and as-built form cancel but for the head's drift; the pose of the reference counts
    /// as well. `before` is what the reference's view said of its pose.
    ///
    /// # Errors
    /// The reference has other cells.
    pub fn since(
        mut self,
        reference: &Field,
        before: Option<&PoseEvidence>,
        settings: &WearSettings,
    ) -> Result<Self, Mismatch> {
        self.field.same_grid(reference)?;
        let views = &mut self.measured.views;
        // Elsewhere in the field the calibration errs otherwise than where the baseline was measured.
        let is_alone = views.len() == 1;
        for view in views {
            view.samples.retain_mut(|sample| {
                let cell = self.field.cell_at(sample.at_mm);
                let then = cell.map_or(f64::NAN, |cell| reference.wear_mm[cell]);
                sample.wear_mm -= then;
                then.is_finite()
            });
        }
        self.measured.since_baseline = true;
        if is_alone {
            self.budget.calibration_mm = settings.drift_mm;
        }
        self.budget.cad_mm = 0.0;
        self.budget.as_built_mm = 0.0;
        self.budget.film_mm = settings.film_mm / 6f64.sqrt();
        // In the mounting of the baseline the pose is stated relative to the baseline's.
        let evidence = self.measured.views.iter().flat_map(|view| &view.evidence);
        self.budget.reference_mm = match evidence.clone().next() {
            Some(_) if evidence.clone().all(|view| view.same_mount.is_some()) => 0.0,
            _ => self.budget.registration_mm,
        };
        self.refigure(Some(reference), before, settings);
        Ok(self)
    }

    /// Several captures of one flank as one: noise averages, whatever else is uncertain stays as it is in the worst of
    /// them. None without a capture, or when their zones differ.
    #[must_use]
    pub fn together(captures: &[&Self], settings: &WearSettings) -> Option<Self> {
        let (&first, others) = captures.split_first()?;
        let mut wear = first.clone();
        if others.is_empty() {
            return Some(wear);
        }
        for other in others {
            wear.field.same_grid(&other.field).ok()?;
            let (view, again) = (&mut wear.measured.views[0], &other.measured.views[0]);
            view.samples.extend_from_slice(&again.samples);
            match (&mut view.visibility, &again.visibility) {
                (Some(seen), Some(more)) => seen.add(more),
                (mine, _) => *mine = None,
            }
            view.evidence.extend(again.evidence.iter().cloned());
            wear.take_worse_pose(other);
        }
        wear.refigure(None, None, settings);
        Some(wear)
    }

    /// The same flank with a further view of it from elsewhere: in every cell the view that hides least counts, and of equal ones
    /// the first. A view of another zone changes nothing.
    #[must_use]
    pub fn with_further(mut self, further: &Self, settings: &WearSettings) -> Self {
        if self.field.same_grid(&further.field).is_err() {
            return self;
        }
        let views = &mut self.measured.views;
        views.push(further.measured.views[0].clone());
        self.take_worse_pose(further);
        self.refigure(None, None, settings);
        self
    }

    /// Takes the uncertainty of the less certain pose; the tip if only the other one saw it.
    fn take_worse_pose(&mut self, other: &Self) {
        let budget = &mut self.budget;
        budget.registration_mm = budget.registration_mm.max(other.budget.registration_mm);
        let leaks = |wear: &Self| wear.sensitivity.as_ref().map(|i| i.leakage.worst());
        if leaks(other) > leaks(self) {
            self.sensitivity.clone_from(&other.sensitivity);
        }
        self.points += other.points;
        self.tip = self.tip.or(other.tip);
    }

    /// The same flank with the fit's leakage, the pose's evidence and the temperature's share counted in.
    #[must_use]
    pub fn with(mut self, sensitivity: PoseSensitivity, settings: &WearSettings) -> Self {
        self.measured.views[0].evidence = sensitivity.evidence.iter().cloned().collect();
        self.sensitivity = Some(sensitivity);
        self.judged = self
            .judged
            .map(|judged| self.judge(judged.read, None, settings));
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flankscope_foundation::random::normal;

    const SIZE_MM: [f64; 2] = [1.6, 4.0];
    const NOISE_MM: f64 = 2e-3;

    /// Four points a cell of a flank that lost 30 µm, with a pattern of this size that is the same in every capture, and noise
    /// of the capture's own.
    fn capture(pattern_mm: f64, seed: u64) -> FlankWear {
        let settings = WearSettings {
            calibration_mm: 5e-4,
            cad_mm: 0.0,
            ..WearSettings::default()
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
            let together = FlankWear::together(&of, &WearSettings::default()).unwrap();
            let worst = count as f64 * 1e-4;
            assert!((together.budget.registration_mm - worst).abs() < 1e-12);
            together.judged.unwrap().read.mean_mm.u
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
        let same = FlankWear::together(&[&captured], &WearSettings::default()).unwrap();
        assert_eq!(same, captured);
        assert!(FlankWear::together(&[], &WearSettings::default()).is_none());
    }

    #[test]
    fn a_difference_to_a_baseline_takes_off_what_was_there() {
        let (new, now) = (capture(20e-3, 1), capture(20e-3, 2));
        let settings = WearSettings::default();
        let since = now.since(&new.field, None, &settings).unwrap();
        // 30 µm and the pattern were there before; cells of four points of 2 µm in both captures, twenty to a disc.
        let cell_mm = NOISE_MM * (2.0f64 / 4.0).sqrt();
        assert!(
            since.wear_mm().unwrap().value.abs() < 4.0 * cell_mm / 20f64.sqrt(),
            "{since:?}"
        );
        assert_eq!(since.budget.calibration_mm, settings.drift_mm);
        assert!(since.budget.noise_mm < cell_mm / 4.0);
    }

    #[test]
    fn since_a_baseline_that_saw_nothing_there_is_no_figure() {
        let now = capture(0.0, 1);
        assert!(now.judged.is_some());
        let settings = WearSettings::default();
        let unseen = Field::unmeasured(SIZE_MM, settings.cell_mm());
        let since = now.since(&unseen, None, &settings).unwrap();
        assert_eq!((since.judged, since.coverage), (None, 0.0));
    }

    #[test]
    fn a_film_hides_wear_and_counts_as_what_it_may_hide() {
        let plain = capture(0.0, 1);
        let settings = WearSettings {
            film_mm: 12e-3,
            ..WearSettings::default()
        };
        let mut oiled = plain.clone();
        oiled.budget.film_mm = settings.film_mm / 12f64.sqrt();
        oiled.refigure(None, None, &settings);
        let (plain, oiled) = (plain.judged.unwrap(), oiled.judged.unwrap());
        assert!((oiled.wear_mm.value - plain.wear_mm.value - 6e-3).abs() < 1e-12);
        assert!((oiled.proud_mm.value - plain.proud_mm.value + 6e-3).abs() < 1e-12);
        // Between nothing and all of it, evenly: its standard deviation is a twelfth's root.
        let added = oiled.wear_mm.u.powi(2) - plain.wear_mm.u.powi(2);
        assert!(
            (added.sqrt() - 12e-3 / 12f64.sqrt()).abs() < 1e-5,
            "{added}"
        );
    }
}
