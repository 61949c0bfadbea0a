//! A head whose focus is driven, between the settings at which it was calibrated: `focus.toml` and its heads.
//!
//! Every parameter of lenses and poses is the Lagrange polynomial through all settings' values, over the focal power: setting and
//! drift with temperature. All parameters of a setting get one weight. So what an adjustment left correlated (focal length and
//! distance, say) stays together, and a measured point is, to first order, the same weighted mean of the points that the settings'
//! calibrations would measure. Rotations are turned from the first setting's by a weighted vector.
//!
//! The error of that interpolation is measured: each inner setting is computed from the others alone and compared with its own calibration
//! over the measuring volume. The largest error counts in full between the settings, and less towards them as the polynomial's
//! remainder does: the other settings alone have one order less and twice the spacing, and the noise of both calibrations is included.
//! Where a straight line between the two neighbouring settings differs from the polynomial by more than that, the difference counts
//! instead, since orders that cancel in a symmetric set would hide from the first figure. Variations between two settings that show at
//! neither of them are not detected: such a lens needs more settings.

use std::path::{Path, PathBuf};

use flankscope_foundation::rigid::nearest_rotation;
use flankscope_foundation::textfile::{self, BadValue, TextFileError};
use nalgebra::{Rotation3, UnitQuaternion, Vector3};
use serde::Deserialize;

use super::uncertainty::{samples, seen_point};
use crate::head::residual::ResidualField;
use crate::head::{
    CalibrationRecord, CoreMapError, DepthRange, FocusRecord, HeadModel, LensDrive, Pinhole,
    RigidTransform,
};
use crate::pattern::Axis;
use crate::triangulate::Triangulator;

/// Fewest settings: of two none can be left out.
const MIN_SETTINGS: usize = 3;
/// Most: a polynomial through many evenly spaced points swings between them.
const MAX_SETTINGS: usize = 5;
/// Settings that lie closer tell nothing of what is between others, dpt.
const MIN_STEP_DPT: f64 = 0.1;
/// Steps in which the range is searched for the largest remainder.
const REMAINDER_STEPS: usize = 400;
/// Step by which the points' shift with power is found, dpt.
const SMALL_STEP_DPT: f64 = 0.02;

/// Settings of one head with the file of each one's calibration, and how its lens drifts.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FocusSeries {
    /// Free text.
    pub name: String,
    /// Focal power gained per kelvin.
    pub drift_dpt_per_kelvin: f64,
    /// Standard uncertainty of that.
    pub drift_sigma_dpt_per_kelvin: f64,
    /// Standard uncertainty of every temperature of the lens, K.
    pub celsius_sigma: f64,
    /// The settings.
    pub focus: Vec<Focus>,
}

/// One of them.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Focus {
    /// Setting of the lens driver, dpt.
    pub setting_dpt: f64,
    /// Temperature of the lens, °C.
    pub celsius: f64,
    /// The head's file as `calibrate` wrote it; relative to this one.
    pub file: PathBuf,
}

/// Why there is no head at a setting.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FocusError {
    /// The series' own file.
    #[error(transparent)]
    File(#[from] TextFileError),
    /// A head of it.
    #[error(transparent)]
    Head(#[from] CoreMapError),
    /// A head that cannot take part.
    #[error("{}: {why}", file.display())]
    Unfit {
        /// Its file.
        file: PathBuf,
        /// Why not, and what would be right.
        why: &'static str,
    },
    /// A number that is none.
    #[error(
        "a lens of {celsius} °C at {setting_dpt} dpt: both must be finite, and the temperature -50 to 100 °C"
    )]
    State {
        /// Setting asked for.
        setting_dpt: f64,
        /// Setting asked for.
        celsius: f64,
    },
    /// Beyond what was calibrated: nothing is extrapolated.
    #[error(
        "{setting_dpt} dpt at {celsius} °C lies outside what was calibrated: at that temperature {} to {} dpt; choose a setting within, or calibrate the head beyond",
        range_dpt[0], range_dpt[1]
    )]
    OutOfRange {
        /// Setting asked for.
        setting_dpt: f64,
        /// Setting asked for.
        celsius: f64,
        /// Least and most setting at that temperature.
        range_dpt: [f64; 2],
    },
    /// Beyond what the lens is driven to.
    #[error("{} dpt: {}", .0.got, .0.expected)]
    Beyond(BadValue),
    /// A ray of one setting meets no sheet of light of another.
    #[error("{}: its rays do not meet the other settings' light: is it another head?", file.display())]
    Strange {
        /// The head's file.
        file: PathBuf,
    },
    /// The interpolated values are not a valid head.
    #[error("between the settings, {} = {}: {}: do they lie close enough?", .0.key, .0.got, .0.expected)]
    NoHead(BadValue),
}

/// One setting with its calibration.
#[derive(Clone, Debug)]
struct CalibratedSetting {
    setting_dpt: f64,
    power_dpt: f64,
    celsius: f64,
    file: PathBuf,
    head: HeadModel,
    record: CalibrationRecord,
}

/// A series with its heads, the least focal power first.
#[derive(Clone, Debug)]
pub struct FocusedHeads {
    series: FocusSeries,
    nodes: Vec<CalibratedSetting>,
    /// Worst of the inner settings computed from the others: along the view and across, mm.
    left_out_mm: [f64; 2],
}

impl FocusSeries {
    /// Reads `focus.toml`.
    ///
    /// # Errors
    /// [`TextFileError`] with file, line and what would be right.
    pub fn load(path: &Path) -> Result<Self, TextFileError> {
        let (series, _) = textfile::load_toml(path, textfile::MAX_BYTES, Self::check)?;
        Ok(series)
    }

    #[rustfmt::skip]
    fn check(&self) -> Result<(), BadValue> {
        let (drift, drift_sigma) = (&self.drift_dpt_per_kelvin, &self.drift_sigma_dpt_per_kelvin);
        let (sigmas, of_sigma) = (0.0..10.0, "must be 0 or more, and below 10");
        let count = self.focus.len();
        textfile::require(&[
            ((-1.0..=1.0).contains(drift), "drift_dpt_per_kelvin", drift, "must be at most a dioptre per kelvin either way"),
            (sigmas.contains(drift_sigma), "drift_sigma_dpt_per_kelvin", drift_sigma, of_sigma),
            (sigmas.contains(&self.celsius_sigma), "celsius_sigma", &self.celsius_sigma, of_sigma),
            ((MIN_SETTINGS..=MAX_SETTINGS).contains(&count), "focus", &count, "must be 3 to 5 calibrated settings"),
        ])?;
        for Focus { setting_dpt, celsius, .. } in &self.focus {
            textfile::require(&[
                ((-30.0..=30.0).contains(setting_dpt), "focus.setting_dpt", setting_dpt, "must be within 30 dpt of nothing"),
                (is_temperature(*celsius), "focus.celsius", celsius, "must be -50 to 100 degrees"),
            ])?;
        }
        let mut powers: Vec<f64> = self.focus.iter().map(|focus| self.power_of(focus)).collect();
        powers.sort_by(f64::total_cmp);
        let close = powers.windows(2).find(|pair| pair[1] - pair[0] < MIN_STEP_DPT);
        textfile::require(&[(close.is_none(), "focus.setting_dpt", &close.map_or(0.0, |pair| pair[1]), "must be 0.1 dpt from the others, drift included")])
    }

    fn power_dpt(&self, setting_dpt: f64, celsius: f64) -> f64 {
        setting_dpt + self.drift_dpt_per_kelvin * celsius
    }

    fn power_of(&self, focus: &Focus) -> f64 {
        self.power_dpt(focus.setting_dpt, focus.celsius)
    }

    /// Reads the heads that stand in the file `path`, and compares them.
    ///
    /// # Errors
    /// [`FocusError`]: a head cannot be read, is not calibrated, or is another one than the first.
    pub fn heads(self, path: &Path) -> Result<FocusedHeads, FocusError> {
        let mut nodes = Vec::with_capacity(self.focus.len());
        for focus in &self.focus {
            let file = path.with_file_name("").join(&focus.file);
            let head = HeadModel::load(&file)?;
            nodes.push((focus.clone(), file, head));
        }
        FocusedHeads::new(self, nodes)
    }
}

fn is_temperature(celsius: f64) -> bool {
    (-50.0..=100.0).contains(&celsius)
}

impl FocusedHeads {
    fn new(
        series: FocusSeries,
        heads: Vec<(Focus, PathBuf, HeadModel)>,
    ) -> Result<Self, FocusError> {
        let mut nodes: Vec<CalibratedSetting> = Vec::with_capacity(heads.len());
        for (focus, file, head) in heads {
            let unfit = |why| FocusError::Unfit {
                file: file.clone(),
                why,
            };
            let record = head
                .calibration
                .clone()
                .filter(|record| record.board.is_none());
            let record = record.ok_or_else(|| {
                unfit("has no [calibration] by a target of certified plates: calibrate it at its setting")
            })?;
            if record.focus.is_some() {
                return Err(unfit(
                    "was itself computed between settings: name the calibrated ones",
                ));
            }
            if head
                .lens
                .is_some_and(|lens| !is_told(&lens, focus.setting_dpt))
            {
                return Err(unfit(
                    "drives its lens to another setting: [lens] counts must be those nearest to setting_dpt",
                ));
            }
            if head.volume.is_none() || head.stage_from_camera.is_none() {
                return Err(unfit("must have [volume] and [stage_from_camera]"));
            }
            if head.second_projector.is_some() {
                return Err(unfit(
                    "has a [second_projector], which is not followed from setting to setting: calibrate at the setting itself",
                ));
            }
            if nodes
                .first()
                .is_some_and(|first| !is_same(&first.head, &head))
            {
                return Err(unfit(
                    "is another head than the first setting's: pixels, patterns, exposures, binning, sensor, image circle and lens driver must be the same",
                ));
            }
            if nodes
                .first()
                .is_some_and(|first| !is_made_alike(&first.record, &record))
            {
                return Err(unfit(
                    "was calibrated by another target or at another place than the first setting's: calibrate all by one",
                ));
            }
            // Told in steps, it had what its counts give.
            let setting_dpt = head
                .lens
                .map_or(focus.setting_dpt, |lens| lens.setting_dpt());
            nodes.push(CalibratedSetting {
                setting_dpt,
                power_dpt: series.power_dpt(setting_dpt, focus.celsius),
                celsius: focus.celsius,
                file,
                head,
                record,
            });
        }
        nodes.sort_by(|a, b| a.power_dpt.total_cmp(&b.power_dpt));
        let mut left_out_mm = [0.0f64; 2];
        for (k, node) in nodes.iter().enumerate().take(nodes.len() - 1).skip(1) {
            let others: Vec<&CalibratedSetting> = nodes
                .iter()
                .enumerate()
                .filter_map(|(i, other)| (i != k).then_some(other))
                .collect();
            let computed = mean(&others, &weights(&others, node.power_dpt));
            let apart_mm = apart_mm(&computed, &node.head).ok_or_else(|| FocusError::Strange {
                file: node.file.clone(),
            })?;
            for (worst, mm) in left_out_mm.iter_mut().zip(apart_mm) {
                *worst = worst.max(mm);
            }
        }
        Ok(Self {
            series,
            nodes,
            left_out_mm,
        })
    }

    /// Files of the heads.
    pub fn files(&self) -> impl Iterator<Item = &Path> {
        self.nodes.iter().map(|node| node.file.as_path())
    }

    /// The head at a setting with its lens as warm as that: geometry, core map of the nearest setting, and what is known of it. Its
    /// record still belongs to no file ([`CalibrationRecord::blake3`] is empty).
    ///
    /// # Errors
    /// [`FocusError::OutOfRange`] beyond the settings, [`FocusError::State`], [`FocusError::NoHead`].
    pub fn at(
        &self,
        setting_dpt: f64,
        celsius: f64,
    ) -> Result<(HeadModel, CalibrationRecord), FocusError> {
        if !setting_dpt.is_finite() || !is_temperature(celsius) {
            return Err(FocusError::State {
                setting_dpt,
                celsius,
            });
        }
        let nodes: Vec<&CalibratedSetting> = self.nodes.iter().collect();
        // The driver's settings are discrete: the head is computed for the nearest one.
        let lens = nodes[0].head.lens.map(|lens| lens.driven_to(setting_dpt));
        let lens = lens.transpose().map_err(FocusError::Beyond)?;
        let setting_dpt = lens.map_or(setting_dpt, |lens| lens.setting_dpt());
        let power_dpt = self.series.power_dpt(setting_dpt, celsius);
        let [first, last] = [&nodes[0], &nodes[nodes.len() - 1]].map(|node| node.power_dpt);
        // A setting that was calibrated is within, whatever the sum of setting and drift is rounded to.
        let rounding_dpt = 1e-9;
        if !(first - rounding_dpt..=last + rounding_dpt).contains(&power_dpt) {
            let setting = |power_dpt: f64| power_dpt - self.series.power_dpt(0.0, celsius);
            return Err(FocusError::OutOfRange {
                setting_dpt,
                celsius,
                range_dpt: [first, last].map(|dpt| (1e3 * setting(dpt)).round() / 1e3),
            });
        }
        let by = weights(&nodes, power_dpt);
        let mut head = mean(&nodes, &by);
        head.lens = lens;
        head.name = format!("{}, {setting_dpt:.3} dpt at {celsius} °C", self.series.name);
        head.check().map_err(FocusError::NoHead)?;

        let strange = || FocusError::Strange {
            file: nodes[0].file.clone(),
        };
        let ratio = remainder_ratio(&nodes, power_dpt);
        let bent_mm = apart_mm(&head, &straight(&nodes, power_dpt)).ok_or_else(strange)?;
        let interpolation_um = [0, 1].map(|k| 1e3 * (self.left_out_mm[k] * ratio).max(bent_mm[k]));
        let near = |step_dpt: f64| mean(&nodes, &weights(&nodes, power_dpt + step_dpt));
        let (nearer, farther) = (near(SMALL_STEP_DPT), near(-SMALL_STEP_DPT));
        let moved_mm = apart_mm(&nearer, &farther).ok_or_else(strange)?;
        let power_sigma_dpt = self.power_sigma_dpt(&by, celsius);
        let drift_um = moved_mm.map(|mm| 1e3 * mm * power_sigma_dpt / (2.0 * SMALL_STEP_DPT));
        // Errors are added linearly, as fully correlated: all settings were calibrated with the same target.
        let own_um = |of: fn(&CalibrationRecord) -> f64| {
            let each = nodes.iter().zip(&by);
            each.map(|(node, by)| by.abs() * of(&node.record))
                .sum::<f64>()
        };
        let own_um = [
            own_um(|record| record.depth_sigma_um),
            own_um(|record| record.lateral_sigma_um),
        ];
        let [depth_sigma_um, lateral_sigma_um] =
            [0, 1].map(|k| own_um[k].hypot(interpolation_um[k]).hypot(drift_um[k]));
        let records = || nodes.iter().map(|node| &node.record);
        let sum = |of: fn(&CalibrationRecord) -> u32| records().map(of).sum();
        let most = |of: fn(&CalibrationRecord) -> f64| records().map(of).fold(0.0, f64::max);
        let first = &nodes[0].record;
        let record = CalibrationRecord {
            date: records()
                .map(|record| record.date)
                .max()
                .unwrap_or(first.date),
            expires: records()
                .map(|record| record.expires)
                .min()
                .unwrap_or(first.expires),
            blake3: String::new(),
            views: sum(|record| record.views),
            dots: sum(|record| record.dots),
            dropped: sum(|record| record.dropped),
            camera_rms_px: most(|record| record.camera_rms_px),
            projector_rms_px: most(|record| record.projector_rms_px),
            depth_sigma_um,
            lateral_sigma_um,
            // The largest uncertainty of the settings, if all state one.
            farther_sigma_um: records()
                .map(|record| record.farther_sigma_um)
                .reduce(|one, other| Some(one?.max(other?)))
                .flatten(),
            hold_out: None,
            without_field: None,
            focus: Some(FocusRecord {
                setting_dpt,
                celsius,
                between_dpt: nodes.iter().map(|node| node.setting_dpt).collect(),
                interpolation_um,
                drift_um,
            }),
            ..first.clone()
        };
        Ok((head, record))
    }

    /// Standard uncertainty of the focal power against those of the settings: the drift's over how much warmer the lens is, and the
    /// temperatures'.
    fn power_sigma_dpt(&self, weights: &[f64], celsius: f64) -> f64 {
        let of_nodes = self.nodes.iter().zip(weights);
        let (mut calibrated, mut squares) = (0.0, 1.0);
        for (node, weight) in of_nodes {
            calibrated += weight * node.celsius;
            squares += weight * weight;
        }
        let warmer = celsius - calibrated;
        let of_drift = self.series.drift_sigma_dpt_per_kelvin * warmer;
        let of_temperature =
            self.series.drift_dpt_per_kelvin * self.series.celsius_sigma * f64::sqrt(squares);
        of_drift.hypot(of_temperature)
    }
}

/// Whether two files may belong to one head: every value that does not depend on the focus is the same.
fn is_same(a: &HeadModel, b: &HeadModel) -> bool {
    let size = |lens: &Pinhole| (lens.width_px, lens.height_px, lens.residual.is_some());
    size(&a.camera) == size(&b.camera)
        && size(&a.projector) == size(&b.projector)
        && a.pattern_set == b.pattern_set
        && a.fringes == b.fringes
        && a.exposures_us == b.exposures_us
        && a.binning == b.binning
        && a.mirrors == b.mirrors
        && a.sensor == b.sensor
        && a.image_circle == b.image_circle
        && driver(a) == driver(b)
        && a.core_map.is_some() == b.core_map.is_some()
}

/// The lens driver without its present setting.
fn driver(head: &HeadModel) -> Option<LensDrive> {
    head.lens.map(|lens| LensDrive { counts: 0, ..lens })
}

/// Whether the driver stands at the count nearest to a setting.
fn is_told(lens: &LensDrive, setting_dpt: f64) -> bool {
    let off_dpt = (lens.setting_dpt() - setting_dpt).abs();
    off_dpt <= (0.5 + 1e-6) * lens.dpt_per_count.abs()
}

fn is_made_alike(a: &CalibrationRecord, b: &CalibrationRecord) -> bool {
    (&a.target, &a.link, a.simulated) == (&b.target, &b.link, b.simulated)
}

/// Lagrange's weights at a power.
fn weights(nodes: &[&CalibratedSetting], power_dpt: f64) -> Vec<f64> {
    let weight = |i: usize| {
        let others = (0..nodes.len()).filter(|&j| j != i);
        others
            .map(|j| (power_dpt - nodes[j].power_dpt) / (nodes[i].power_dpt - nodes[j].power_dpt))
            .product()
    };
    (0..nodes.len()).map(weight).collect()
}

/// The polynomial's remainder at a power against the largest between the settings: 0 at each of them.
fn remainder_ratio(nodes: &[&CalibratedSetting], power_dpt: f64) -> f64 {
    let remainder = |at_dpt: f64| {
        let factors = nodes.iter().map(|node| at_dpt - node.power_dpt);
        factors.product::<f64>().abs()
    };
    let (first, last) = (nodes[0].power_dpt, nodes[nodes.len() - 1].power_dpt);
    let at = |step: usize| first + (last - first) * step as f64 / REMAINDER_STEPS as f64;
    let largest = (0..=REMAINDER_STEPS).map(|step| remainder(at(step)));
    (remainder(power_dpt) / largest.fold(0.0, f64::max)).min(1.0)
}

/// The head on the straight line between the two settings beside a power.
fn straight(nodes: &[&CalibratedSetting], power_dpt: f64) -> HeadModel {
    let above = nodes.partition_point(|node| node.power_dpt < power_dpt);
    let above = above.clamp(1, nodes.len() - 1);
    let beside = &nodes[above - 1..=above];
    mean(beside, &weights(beside, power_dpt))
}

/// The weighted mean of heads; what is no number is the nearest one's.
fn mean(nodes: &[&CalibratedSetting], weights: &[f64]) -> HeadModel {
    let heaviest = (0..nodes.len())
        .max_by(|&a, &b| weights[a].total_cmp(&weights[b]))
        .unwrap_or(0);
    let number = |of: &dyn Fn(&HeadModel) -> f64| -> f64 {
        let each = nodes.iter().zip(weights);
        each.map(|(node, weight)| weight * of(&node.head)).sum()
    };
    let pose = |of: &dyn Fn(&HeadModel) -> RigidTransform| {
        let rotation = |head: &HeadModel| nearest_rotation(&of(head).matrix());
        let first = rotation(&nodes[0].head);
        let turn: Vector3<f64> = nodes
            .iter()
            .zip(weights)
            .map(|(node, weight)| (rotation(&node.head) * first.inverse()).scaled_axis() * *weight)
            .sum();
        let turned: Rotation3<f64> =
            (UnitQuaternion::from_scaled_axis(turn) * first).to_rotation_matrix();
        RigidTransform {
            rotation: std::array::from_fn(|row| {
                std::array::from_fn(|column| turned[(row, column)])
            }),
            translation_mm: std::array::from_fn(|axis| {
                number(&|head| of(head).translation_mm[axis])
            }),
        }
    };
    let lens = |of: fn(&HeadModel) -> &Pinhole| {
        let number = |value: &dyn Fn(&Pinhole) -> f64| number(&|head| value(of(head)));
        let field = |value: &dyn Fn(&ResidualField) -> f64| {
            number(&|lens| lens.residual.as_ref().map_or(0.0, value))
        };
        let own = of(&nodes[heaviest].head);
        Pinhole {
            width_px: own.width_px,
            height_px: own.height_px,
            focal_px: std::array::from_fn(|k| number(&|lens| lens.focal_px[k])),
            principal_px: std::array::from_fn(|k| number(&|lens| lens.principal_px[k])),
            distortion: std::array::from_fn(|k| number(&|lens| lens.distortion[k])),
            // A field is linear in its coefficients, and its square lies alike on the bundle's image at every setting.
            residual: own.residual.as_ref().map(|own| ResidualField {
                centre: std::array::from_fn(|k| field(&|of| of.centre[k])),
                half_side: field(&|of| of.half_side),
                columns_px: std::array::from_fn(|j| {
                    std::array::from_fn(|i| field(&|of| of.columns_px[j][i]))
                }),
                rows_px: own.rows_px.map(|_| {
                    std::array::from_fn(|j| {
                        std::array::from_fn(|i| {
                            field(&|of| of.rows_px.map_or(0.0, |rows| rows[j][i]))
                        })
                    })
                }),
            }),
        }
    };
    let same = &nodes[heaviest].head;
    let depth = |of: fn(&DepthRange) -> f64| number(&|head| head.volume.as_ref().map_or(0.0, of));
    let all_have = |has: fn(&HeadModel) -> bool| nodes.iter().all(|node| has(&node.head));
    let identity = same.projector_from_camera;
    HeadModel {
        working_distance_mm: all_have(|head| head.working_distance_mm.is_some())
            .then(|| number(&|head| head.working_distance_mm.unwrap_or(0.0))),
        camera: lens(|head| &head.camera),
        projector: lens(|head| &head.projector),
        projector_from_camera: pose(&|head| head.projector_from_camera),
        stage_from_camera: same
            .stage_from_camera
            .map(|_| pose(&|head| head.stage_from_camera.unwrap_or(identity))),
        volume: same.volume.map(|_| DepthRange {
            near_mm: depth(|volume| volume.near_mm),
            far_mm: depth(|volume| volume.far_mm),
        }),
        calibration: None,
        seal: None,
        self_test: None,
        ..same.clone()
    }
}

/// Distance of the points of one head from those of another, over the other's measuring volume in the stage frame: root mean square
/// along the view and across, mm.
fn apart_mm(head: &HeadModel, other: &HeadModel) -> Option<[f64; 2]> {
    let view = Vector3::from(other.stage_from_camera?.direction([0.0, 0.0, 1.0]));
    let light = Triangulator::new(other, Axis::Columns);
    let (mut count, mut squares) = (0.0, [0.0; 2]);
    for (pixel, depth_mm) in samples(other)? {
        let ray = other.camera.undistort(pixel)?;
        let (column_px, _) = light.column(ray, depth_mm)?;
        let [one, two] = [head, other].map(|head| seen_point(head, pixel, column_px));
        let between = one? - two?;
        let along = view.dot(&between);
        count += 1.0;
        squares[0] += along * along;
        squares[1] += 0.5 * (between.norm_squared() - along * along);
    }
    Some(squares.map(|sum: f64| (sum / count).sqrt()))
}

#[cfg(test)]
#[path = "focus_tests.rs"]
mod tests;
