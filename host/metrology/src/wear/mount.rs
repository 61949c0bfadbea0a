//! Pose of a view as far as the mounting of die and head determines it: the same at every check until one of them is taken out.
//!
//! A pose that rests on flanks follows their wear. A baseline therefore records the motion from where the stages put a view to the
//! pose that its flanks were read at, and how the middles of tip and root lands lie in that pose. Where the lands lie the same at a
//! later check, in the pose that the stages then give, the mounting is the same: that pose is the view's, whatever the flanks lost.
//! Tips and roots are compared each for themselves, since a die is not built as drawn, and its tips may wear. Lands determine the
//! distance from the axis and the tilt along the height, and, by their slope along the circumference, a shift along it as well as their
//! form allows. A rotation about the axis they do not show, nor a tilt about the line of sight. How far the mounting drifted is not
//! known beforehand: every scale has a probability by what the lands show ([`Drift`]), and that bounds what they do not show.

use flankscope_foundation::order::{SIGMA_PER_MAD, median_of};
use flankscope_foundation::rigid::{Cloud, Rigid, Tool};
use nalgebra::{Isometry3, Matrix3, Matrix6, Translation3, UnitQuaternion, Vector2, Vector3};
use serde::{Deserialize, Serialize};

use super::Zone;
use super::sensitivity::{LEAST_POINTS, motion_row};
use crate::gear::{GearData, Land};
use crate::registration::{Registration, Status};
use crate::surface::Closest;

/// Largest motion of the lands within one mounting, in standard uncertainties of a flank's form: three, of a difference of two.
const SAME_MOUNT: f64 = 3.0 * std::f64::consts::SQRT_2;
/// Stands for a direction that the mounting keeps, rad and mm.
const KEPT: f64 = 1e-6;
/// Steps of the robust fit.
const STEPS: usize = 10;

/// Scales of drift that are thought as likely as one another where none is stated, mm: octaves from the half of a flank's form up to the
/// uncertainty of a new mounting.
const DRIFTS_MM: [f64; 6] = [0.25e-3, 0.5e-3, 1e-3, 2e-3, 4e-3, 8e-3];
/// Motion of the rim by a turn about any axis, per drift along an axis: what expands or bends is at least twice as long as the die's
/// radius.
const TURN_OF_DRIFT: f64 = 0.5;
/// Probability, before anything is seen, that die or head was taken out since the baseline although that asks for a new one.
const REMOUNTED: f64 = 0.05;

/// A rigid motion in tool coordinates: rotation vector (rad), then translation (mm).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct Motion([f64; 6]);

impl Motion {
    fn between(from: &Isometry3<f64>, to: &Isometry3<f64>) -> Self {
        let motion = to * from.inverse();
        let (turn, shift) = (motion.rotation.scaled_axis(), motion.translation.vector);
        Self([turn.x, turn.y, turn.z, shift.x, shift.y, shift.z])
    }

    fn isometry(&self) -> Isometry3<f64> {
        let [a, b, c, x, y, z] = self.0;
        let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(a, b, c));
        Isometry3::from_parts(Translation3::new(x, y, z), rotation)
    }
}

/// Mounting of die and head as one view shows it, recorded in a baseline.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MountPose {
    /// From the stages' pose to the one at which the flanks were read.
    from_stages: Motion,
    /// Motion from there that would bring the roots onto the CAD: towards the axis, tilt over half of the zone's height, and along the
    /// circumference, mm. None where too little was seen of them.
    roots_mm: Option<[f64; 3]>,
    /// Motion that would bring the tips onto the CAD, in the same way.
    tips_mm: Option<[f64; 3]>,
}

/// Place of a view on a gear: middle of the judged zone of its tooth.
#[derive(Debug, Clone, Copy)]
pub struct Seat<'a> {
    gear: &'a GearData,
    at_mm: Vector3<f64>,
    half_height_mm: f64,
}

/// A view in the mounting of its baseline.
#[derive(Debug)]
pub struct InMount {
    /// Its pose. The covariance leaves out the approach of the stages, and all of what moves the view along the circumference.
    pub registration: Registration,
    /// Scales of its drift, each with its probability.
    pub drifts: Vec<Drift>,
    /// Probability that it is another mounting, whose lands lie alike by chance.
    pub remounted: f64,
}

/// A scale of the mounting's drift since the baseline, in the light of what the lands show.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Drift {
    /// Its probability.
    pub probability: f64,
    /// Standard deviation along each axis, mm.
    pub sigma_mm: f64,
    /// Expected motion along the circumference that brings the view to where the die is, mm.
    pub along_mm: f64,
    /// Its standard uncertainty, mm.
    pub along_u_mm: f64,
}

/// Drift as lands show it: motions that bring the view to where the die is, mm, each with its standard uncertainty.
#[derive(Debug, Clone, Copy)]
struct SeenDrift {
    towards_axis_mm: [f64; 2],
    along_mm: [f64; 2],
}

impl SeenDrift {
    /// Density of what is seen if the drift has this standard deviation along each axis, but for a factor.
    fn likelihood(&self, sigma_mm: f64) -> f64 {
        [self.towards_axis_mm, self.along_mm]
            .into_iter()
            .map(|[seen_mm, u_mm]| {
                let sigma_mm = sigma_mm.hypot(u_mm);
                (-0.5 * (seen_mm / sigma_mm).powi(2)).exp() / sigma_mm
            })
            .product()
    }

    /// Drifts of these scales, one as likely as another before, and the probability of another mounting, known to `mount_mm`.
    fn drifts(&self, scales_mm: &[f64], mount_mm: f64) -> (Vec<Drift>, f64) {
        let prior = (1.0 - REMOUNTED) / scales_mm.len() as f64;
        let remounted = REMOUNTED * self.likelihood(mount_mm);
        let drift = |&sigma_mm: &f64| {
            let [seen_mm, u_mm] = self.along_mm;
            // The shift was measured with this uncertainty; a turn about the axis was not and adds to it.
            let share = sigma_mm.powi(2) / (sigma_mm.powi(2) + u_mm.powi(2));
            Drift {
                probability: prior * self.likelihood(sigma_mm),
                sigma_mm,
                along_mm: share * seen_mm,
                along_u_mm: (share.sqrt() * u_mm).hypot(TURN_OF_DRIFT * sigma_mm),
            }
        };
        let mut drifts: Vec<Drift> = scales_mm.iter().map(drift).collect();
        let whole = remounted + drifts.iter().map(|drift| drift.probability).sum::<f64>();
        for drift in &mut drifts {
            drift.probability /= whole;
        }
        (drifts, remounted / whole)
    }
}

/// Point on a land.
struct LandPoint {
    tooth: u32,
    /// Change of its distance by a shift towards the axis, by a tilt over half of the height and by a shift along the circumference, mm per
    /// mm.
    row: Vector3<f64>,
    /// Signed distance, mm.
    off_mm: f64,
    is_above: bool,
}

/// Tips or roots of a view.
#[derive(Debug, Clone, Copy)]
struct Lands {
    motion_mm: Vector3<f64>,
    /// Root mean square change of the distance by a shift along the circumference, mm per mm.
    slope: f64,
    /// Number of lands.
    count: usize,
    /// Points within three robust standard deviations, and their root mean square distance, mm.
    inliers: usize,
    rms_mm: f64,
    /// Robust standard deviation, mm.
    noise_mm: f64,
}

impl<'a> Seat<'a> {
    /// Place of the view of a tooth.
    pub fn new(gear: &'a GearData, zone: &Zone, tooth: u32) -> Self {
        let [low, high] = zone.height_mm;
        let angle = gear.tooth_centre_rad(tooth);
        let radius = gear.pitch_radius_mm();
        Self {
            gear,
            at_mm: Vector3::new(
                radius * angle.cos(),
                radius * angle.sin(),
                0.5 * (low + high),
            ),
            half_height_mm: 0.5 * (high - low),
        }
    }

    /// Whether a point (tool frame, mm) lies on the middle of a land.
    pub fn is_on_land(&self, point: [f64; 3]) -> bool {
        self.gear.middle_of_land(point).is_some()
    }

    fn towards_axis(&self) -> Vector3<f64> {
        -Vector3::new(self.at_mm.x, self.at_mm.y, 0.0).normalize()
    }

    /// Along the circumference, counter-clockwise.
    fn across(&self) -> Vector3<f64> {
        self.towards_axis().cross(&Vector3::z())
    }

    /// Motion of the cloud by a shift towards the axis and a tilt over half of the height, mm.
    fn motion(&self, mm: Vector2<f64>) -> Isometry3<f64> {
        let across = self.across();
        let turn = UnitQuaternion::from_scaled_axis(across * (mm[1] / self.half_height_mm));
        let about = Isometry3::rotation_wrt_point(turn, self.at_mm.into());
        Translation3::from(self.towards_axis() * mm[0]) * about
    }

    /// All roots, and all tips.
    fn roots_and_tips(&self, closest: &[Closest]) -> [Option<Lands>; 2] {
        let towards_axis = self.towards_axis();
        let across = self.across();
        let (mut roots, mut tips) = (Vec::new(), Vec::new());
        for at in closest {
            if !(at.signed_distance_mm.is_finite() && at.is_smooth()) {
                continue;
            }
            // A root lies half a pitch before the tooth that it is counted with.
            let (points, before_rad) = match self.gear.middle_of_land(at.point) {
                Some(Land::Root) => (&mut roots, 0.5 * self.gear.pitch_rad()),
                Some(Land::Tip) => (&mut tips, 0.0),
                None => continue,
            };
            let row = motion_row(at.point, at.normal, self.at_mm);
            let (turn, shift) = (row.fixed_rows::<3>(0), row.fixed_rows::<3>(3));
            points.push(LandPoint {
                tooth: self
                    .gear
                    .tooth_at(at.point[1].atan2(at.point[0]) + before_rad),
                row: Vector3::new(
                    shift.dot(&towards_axis),
                    turn.dot(&across) / self.half_height_mm,
                    shift.dot(&across),
                ),
                off_mm: at.signed_distance_mm,
                is_above: at.point[2] > self.at_mm.z,
            });
        }
        [roots, tips].map(|points| Lands::fit(&points))
    }
}

impl Lands {
    /// Robust fit; none with too few points below or above the middle of the zone.
    fn fit(points: &[LandPoint]) -> Option<Self> {
        let above = points.iter().filter(|point| point.is_above).count();
        if above.min(points.len() - above) < LEAST_POINTS {
            return None;
        }
        let mut motion_mm = Vector3::zeros();
        let off =
            |motion_mm: &Vector3<f64>, point: &LandPoint| point.off_mm + point.row.dot(motion_mm);
        let mut noise_mm = 0.0;
        for _ in 0..STEPS {
            let sizes = points.iter().map(|point| off(&motion_mm, point).abs());
            noise_mm = SIGMA_PER_MAD * median_of(sizes)?;
            let (mut squares, mut sum) = (Matrix3::zeros(), Vector3::zeros());
            for point in points {
                let off_mm = off(&motion_mm, point);
                let x = off_mm / (3.0 * noise_mm.max(f64::MIN_POSITIVE));
                let weight = (-0.5 * x * x).exp();
                squares += weight * point.row * point.row.transpose();
                sum += weight * off_mm * point.row;
            }
            motion_mm -= squares.try_inverse()? * sum;
        }
        let within = points
            .iter()
            .map(|point| off(&motion_mm, point))
            .filter(|mm| mm.abs() <= 3.0 * noise_mm);
        let inliers = within.clone().count();
        let squares: f64 = within.map(|mm| mm * mm).sum();
        let mut teeth: Vec<u32> = points.iter().map(|point| point.tooth).collect();
        teeth.sort_unstable();
        teeth.dedup();
        let slopes: f64 = points.iter().map(|point| point.row[2].powi(2)).sum();
        motion_mm.iter().all(|mm| mm.is_finite()).then(|| Self {
            motion_mm,
            slope: (slopes / points.len() as f64).sqrt(),
            count: teeth.len(),
            inliers,
            rms_mm: (squares / inliers.max(1) as f64).sqrt(),
            noise_mm,
        })
    }
}

impl MountPose {
    /// From the pose by the stages and that of the view, in which its points have these nearest surface points. None where too
    /// little of the lands was seen.
    pub fn new(
        seat: &Seat<'_>,
        stages: &Rigid<Tool, Cloud>,
        pose: &Rigid<Tool, Cloud>,
        closest: &[Closest],
    ) -> Option<Self> {
        let lands = seat.roots_and_tips(closest);
        let [roots_mm, tips_mm] = lands.map(|lands| Some(lands?.motion_mm.into()));
        (roots_mm.is_some() || tips_mm.is_some()).then(|| Self {
            from_stages: Motion::between(stages.isometry(), pose.isometry()),
            roots_mm,
            tips_mm,
        })
    }

    /// The mounting by several approaches of the stages to one view: their mean motion, and the lands of the first. None without any.
    pub fn mean(approaches: &[Self]) -> Option<Self> {
        let mut motion = [0.0; 6];
        for approach in approaches {
            for (sum, of) in motion.iter_mut().zip(approach.from_stages.0) {
                *sum += of / approaches.len() as f64;
            }
        }
        Some(Self {
            from_stages: Motion(motion),
            ..*approaches.first()?
        })
    }

    /// Pose that the baseline's view would have now if neither mounting nor stages had moved.
    pub fn expected(&self, stages: &Rigid<Tool, Cloud>) -> Rigid<Tool, Cloud> {
        Rigid::from_isometry(self.from_stages.isometry() * stages.isometry())
    }

    /// Pose of a view in the same mounting, corrected by what the lands moved. `closest` belongs to points on lands in the
    /// [expected pose](Self::expected). `form_mm`, `drift_mm` and `mount_mm` are standard uncertainties: of a flank's form, of the
    /// mounting's drift since the baseline along each axis, where it is stated, and of a new mounting. None where neither roots nor tips
    /// lie where they did, as far as form and stated drift allow, where too little of them was seen, and where another mounting is likelier.
    pub fn locate(
        &self,
        seat: &Seat<'_>,
        stages: &Rigid<Tool, Cloud>,
        closest: &[Closest],
        form_mm: f64,
        drift_mm: Option<f64>,
        mount_mm: f64,
    ) -> Option<InMount> {
        let limit_mm = SAME_MOUNT * form_mm.max(drift_mm.unwrap_or(0.0));
        let unmoved = |(lands, recorded_mm): (Option<Lands>, Option<[f64; 3]>)| {
            let lands = lands?;
            let moved_mm = lands.motion_mm - Vector3::from(recorded_mm?);
            let is_same = moved_mm.xy().iter().all(|mm| mm.abs() <= limit_mm);
            is_same.then_some((lands, moved_mm))
        };
        let recorded_mm = [self.roots_mm, self.tips_mm];
        let lands = seat.roots_and_tips(closest).into_iter().zip(recorded_mm);
        let unmoved: Vec<(Lands, Vector3<f64>)> = lands.filter_map(unmoved).collect();
        // Tips wear before roots do.
        let &(lands, moved_mm) = unmoved.first()?;
        // The form of each land is off by itself.
        let weight = |lands: &Lands| lands.slope.powi(2) * lands.count as f64;
        let whole: f64 = unmoved.iter().map(|(lands, _)| weight(lands)).sum();
        let along = unmoved.iter().map(|(lands, mm)| weight(lands) * mm[2]);
        let drift = SeenDrift {
            towards_axis_mm: [moved_mm[0], form_mm],
            along_mm: [along.sum::<f64>() / whole, form_mm / whole.sqrt()],
        };
        let stated = drift_mm.as_slice();
        let scales_mm = if stated.is_empty() {
            &DRIFTS_MM
        } else {
            stated
        };
        let (drifts, remounted) = drift.drifts(scales_mm, mount_mm);
        if remounted.is_nan() || remounted >= 0.5 {
            return None;
        }
        let expected = self.expected(stages);
        let pose = Rigid::from_isometry(seat.motion(moved_mm.xy()) * expected.isometry());
        let drifted = drifts
            .iter()
            .map(|drift| drift.probability * drift.sigma_mm.powi(2));
        let drifted = drifted.sum::<f64>() / (1.0 - remounted);
        let radius_mm = seat.at_mm.xy().norm();
        let turned = drifted * (TURN_OF_DRIFT / radius_mm).powi(2);
        let form = form_mm * form_mm;
        let axes = [seat.towards_axis(), Vector3::z(), seat.across()];
        let [along, up, across] = axes.map(|axis| axis * axis.transpose());
        let kept = KEPT * KEPT * Matrix3::identity();
        let rotation =
            form / seat.half_height_mm.powi(2) * (across + along) + turned * along + kept;
        let shift = form * along + drifted * up + kept;
        let mut covariance = Matrix6::zeros();
        covariance.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
        covariance.fixed_view_mut::<3, 3>(3, 3).copy_from(&shift);
        let registration = Registration {
            tool_from_cloud: pose,
            status: Status::Registered,
            converged: true,
            iterations: STEPS,
            inliers: lands.inliers,
            rms_mm: lands.rms_mm,
            noise_mm: lands.noise_mm,
            weak_directions: Vec::new(),
            covariance,
            centre_mm: seat.at_mm.into(),
            arm_mm: seat.half_height_mm,
        };
        Some(InMount {
            registration,
            drifts,
            remounted,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gear::tests::ring84;
    use flankscope_foundation::random::{normal, uniform};

    const FORM_MM: f64 = 0.5e-3;
    const ZONE: Zone = Zone {
        radius_mm: [41.1, 42.7],
        height_mm: [29.0, 37.0],
    };

    /// Lands of the teeth 39 to 41 as seen in a pose that is off by this motion. The roots of the die are 12 µm too deep, and the
    /// tips lost `tip_mm`.
    fn seen(seat: &Seat<'_>, off: &Isometry3<f64>, tip_mm: f64, seed: u64) -> Vec<Closest> {
        let gear = seat.gear;
        let point = |i: u64| {
            let u = |k: u64| uniform(seed, 4 * i + k);
            let (is_tip, tooth) = (u(0) < 0.6, 39 + (3.0 * u(1)) as u32);
            let (radius, lost_mm) = match is_tip {
                true => (gear.tip_radius_mm, tip_mm),
                false => (gear.root_radius_mm, 12e-3),
            };
            let centre =
                gear.tooth_centre_rad(tooth) + if is_tip { 0.0 } else { 0.5 * gear.pitch_rad() };
            let angle = centre + (u(2) - 0.5) * 5e-3;
            let inwards = -Vector3::new(angle.cos(), angle.sin(), 0.0);
            let on = -radius * inwards + Vector3::z() * (29.0 + 8.0 * u(3));
            let measured = off * nalgebra::Point3::from(on - lost_mm * inwards);
            Closest {
                point: on.into(),
                normal: inwards.into(),
                signed_distance_mm: (measured.coords - on).dot(&inwards)
                    + 2e-3 * normal(seed + 1, i),
                triangle: 0,
                feature: crate::surface::Feature::Face,
                smoothness: 1.0,
            }
        };
        (0..4000).map(point).collect()
    }

    fn pose(angle: f64) -> Rigid<Tool, Cloud> {
        let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.1, -0.2, 0.3) * angle);
        Rigid::from_isometry(Translation3::new(3.0, -2.0, angle) * turn)
    }

    /// Standard uncertainty of a new mounting.
    const MOUNT_MM: f64 = 10e-3;

    /// Two parameters from 4 000 points with 2 µm of noise each: 0.03 µm and 0.06 µm (the height's standard deviation is 0.58 of half
    /// of it), of a difference 1.4 times as much; five standard uncertainties.
    const OFF_MM: f64 = 5.0 * 1.4 * 0.06e-3;

    #[test]
    fn pose_in_the_same_mounting_is_that_of_the_baseline_moved_with_the_lands() {
        let gear = ring84();
        let seat = Seat::new(&gear, &ZONE, 40);
        let (then, now) = (pose(0.2), pose(-0.4));
        for (seed, drift_mm) in [(1, [0.0, 0.0]), (2, [1.2e-3, 0.0]), (3, [-0.6e-3, 1.0e-3])] {
            let mount = Isometry3::rotation(Vector3::new(1e-3, -2e-3, 5e-4));
            let read = Rigid::from_isometry(mount * then.isometry());
            let recorded = seen(&seat, &Isometry3::identity(), 0.0, seed);
            let recorded = MountPose::new(&seat, &then, &read, &recorded).expect("lands");
            // The die moved: in the expected pose its lands lie by so much elsewhere.
            let drift = seat.motion(Vector2::from(drift_mm));
            let lands = seen(&seat, &drift, 0.0, 10 + seed);
            let found = recorded.locate(&seat, &now, &lands, FORM_MM, None, MOUNT_MM);
            let found = found.expect("the same mounting");
            let drifts = found.drifts.iter().map(|drift| drift.probability);
            assert!((drifts.sum::<f64>() + found.remounted - 1.0).abs() < 1e-12);
            assert!(found.remounted < 0.02, "{}", found.remounted);
            let found = found.registration;
            let right = drift.inverse() * mount * now.isometry();
            let off = found.tool_from_cloud.isometry() * right.inverse();
            let at = nalgebra::Point3::from(seat.at_mm);
            assert!((off * at - at).norm() < OFF_MM, "{drift_mm:?}: {off}");
            assert!(4.0 * off.rotation.angle() < OFF_MM, "{drift_mm:?}: {off}");
        }
    }

    #[test]
    fn shift_along_the_circumference_is_seen_by_the_slope_of_the_lands() {
        let gear = ring84();
        let seat = Seat::new(&gear, &ZONE, 40);
        let stages = pose(0.2);
        let recorded = seen(&seat, &Isometry3::identity(), 0.0, 17);
        let recorded = MountPose::new(&seat, &stages, &stages, &recorded).expect("lands");
        for (seed, along_mm) in [(1, -20e-3), (2, 20e-3), (3, -5e-3), (4, 5e-3)] {
            let drift = Isometry3::from(Translation3::from(seat.across() * along_mm));
            let lands = seen(&seat, &drift, 0.0, 20 + seed);
            // Without doubts about the form of the lands the drift is what they say, of the largest scale all but its noise.
            let found = recorded.locate(&seat, &stages, &lands, 0.1 * FORM_MM, None, MOUNT_MM);
            let found = found.expect("the same mounting").drifts[5];
            // 2 µm of noise by 4 000 points with slopes of 0.05: 0.6 µm; of a difference 1.4 times as much.
            assert!(
                (found.along_mm + along_mm).abs() < 4.0 * 0.9e-3,
                "{found:?}"
            );
            let found = recorded.locate(&seat, &stages, &lands, FORM_MM, None, MOUNT_MM);
            let remounted = found.map_or(1.0, |found| found.remounted);
            assert_eq!(
                remounted > 0.1,
                along_mm.abs() > 0.01,
                "{along_mm}: {remounted}"
            );
        }
    }

    /// Drifts are drawn from the same scales: 95 % of them lie within the 95 % that the statements leave.
    #[test]
    fn drifts_along_the_circumference_lie_where_the_lands_let_expect_them() {
        use flankscope_foundation::normal::probability_below;
        let along_u_mm = 3e-3;
        let (mut covered, draws) = (0, 20_000);
        for draw in 0..draws {
            let drawn = |k: u64| normal(99, 8 * draw + k);
            let scale = (6.0 * uniform(98, draw)) as usize;
            let drift_mm = |k: u64| DRIFTS_MM[scale] * drawn(k);
            let along_mm = drift_mm(1);
            let seen = SeenDrift {
                towards_axis_mm: [drift_mm(0) + FORM_MM * drawn(2), FORM_MM],
                along_mm: [along_mm + along_u_mm * drawn(3), along_u_mm],
            };
            let (drifts, remounted) = seen.drifts(&DRIFTS_MM, MOUNT_MM);
            let needed_mm = along_mm + TURN_OF_DRIFT * drift_mm(4);
            let below = |of: &Drift| {
                of.probability * probability_below(needed_mm, of.along_mm, of.along_u_mm)
            };
            let below = drifts.iter().map(below).sum::<f64>() / (1.0 - remounted);
            covered += u32::from((0.025..0.975).contains(&below));
        }
        // 95 % of 20 000, standard deviation 0.15 %; four times that.
        let share = f64::from(covered) / draws as f64;
        assert!((share - 0.95).abs() < 4.0 * 0.0015, "{share}");
    }

    #[test]
    fn lands_that_moved_or_tilted_are_not_those_of_the_baseline() {
        let gear = ring84();
        let seat = Seat::new(&gear, &ZONE, 40);
        let stages = pose(0.2);
        let recorded = seen(&seat, &Isometry3::identity(), 0.0, 7);
        let recorded = MountPose::new(&seat, &stages, &stages, &recorded).expect("lands");
        let is_same = |drift_mm: [f64; 2], tip_mm: f64, stated_mm: Option<f64>| {
            let lands = seen(&seat, &seat.motion(Vector2::from(drift_mm)), tip_mm, 8);
            recorded
                .locate(&seat, &stages, &lands, FORM_MM, stated_mm, MOUNT_MM)
                .is_some()
        };
        for stated_mm in [None, Some(0.1e-3), Some(2e-3)] {
            let limit_mm = SAME_MOUNT * stated_mm.map_or(FORM_MM, |mm: f64| mm.max(FORM_MM));
            for mm in [-limit_mm, limit_mm] {
                for lands in [[mm, 0.0], [0.0, mm]] {
                    for tip_mm in [0.0, 10e-3] {
                        assert!(is_same(lands.map(|mm| 0.6 * mm), tip_mm, stated_mm));
                    }
                    assert!(!is_same(lands.map(|mm| 1.2 * mm), 0.0, stated_mm));
                }
            }
            assert!(!is_same([f64::NAN, 0.0], 0.0, stated_mm));
        }
    }
}
