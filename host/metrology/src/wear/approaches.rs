//! Repeatability of the rotary stage, measured by approaching the same views again and again while nothing else changed.

use flankscope_foundation::normal::{COVERAGE_95, student_factor};
use serde::{Deserialize, Serialize};

use super::{MountPose, PoseEvidence};

/// Scatter of the rotary stage's angle over approaches of the same views.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Approaches {
    /// Least number of approaches of a view.
    pub count: u32,
    /// Degrees of freedom of the standard deviation.
    pub degrees_of_freedom: u32,
    /// Standard deviation of the angle after an approach, from the mean of all of the same view, rad.
    pub rotation_sigma_rad: f64,
}

impl Approaches {
    /// From the evidence of each view's approaches, on a die whose flanks did not change meanwhile. `rotation_sigma_rad` is what
    /// that evidence takes for the standard uncertainty of the angle. None unless a view was approached twice.
    pub fn from_views(views: &[Vec<PoseEvidence>], rotation_sigma_rad: f64) -> Option<Self> {
        let (mut degrees_of_freedom, mut squares) = (0, 0.0);
        let repeated = || views.iter().filter(|view| view.len() > 1);
        for view in repeated() {
            let count = view.len();
            let mean_mm = view.iter().map(|at| at.stages_mm).sum::<f64>() / count as f64;
            let deviation = |at: &PoseEvidence| (at.stages_mm - mean_mm) / at.approach_sigma_mm;
            squares += view.iter().map(|at| deviation(at).powi(2)).sum::<f64>();
            degrees_of_freedom += count - 1;
        }
        let count = repeated().map(Vec::len).min()?;
        let ratio = (squares / degrees_of_freedom as f64).sqrt();
        ratio.is_finite().then_some(Self {
            count: count as u32,
            degrees_of_freedom: degrees_of_freedom as u32,
            rotation_sigma_rad: ratio * rotation_sigma_rad,
        })
    }

    /// Whether the scatter is larger than this standard deviation allows: by three standard deviations of its estimate.
    pub fn exceeds(&self, rotation_sigma_rad: f64) -> bool {
        let estimate = 1.0 / (2.0 * f64::from(self.degrees_of_freedom)).sqrt();
        self.rotation_sigma_rad > (1.0 + 3.0 * estimate) * rotation_sigma_rad
    }

    /// Standard uncertainty that gives 95 % with the normal factor where so few degrees of freedom need Student's.
    pub fn rotation_u_rad(&self) -> f64 {
        self.rotation_sigma_rad * student_factor(self.degrees_of_freedom) / COVERAGE_95
    }
}

impl PoseEvidence {
    /// Evidence of a view that was approached several times: the first one's, in the mean mounting.
    pub fn of_approaches(approaches: &[Self]) -> Option<Self> {
        let mounts: Vec<MountPose> = approaches.iter().filter_map(|at| at.mount).collect();
        Some(Self {
            mount: MountPose::mean(&mounts),
            ..approaches.first()?.clone()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flankscope_foundation::random::normal;

    /// Views of one stage that stands differently at each.
    fn views(views: u64, approaches: u64, sigma_mm: f64, seed: u64) -> Vec<Vec<PoseEvidence>> {
        let evidence = |view: u64, n: u64| PoseEvidence {
            tooth: Some(view as u32 + 1),
            flanks: Vec::new(),
            stages_mm: 0.02 * normal(seed + 1, view) + sigma_mm * normal(seed, 100 * view + n),
            approach_sigma_mm: 6e-3,
            mount_sigma_mm: 0.01,
            stages_both_mm: 0.0,
            both_sigma_mm: 0.01,
            mount: None,
            same_mount: None,
        };
        let of_view = |view| (0..approaches).map(|n| evidence(view, n)).collect();
        (0..views).map(of_view).collect()
    }

    #[test]
    fn scatter_about_each_view_s_own_mean_is_the_repeatability() {
        let found = Approaches::from_views(&views(40, 26, 1.5e-3, 3), 2e-4).expect("approaches");
        assert_eq!((found.count, found.degrees_of_freedom), (26, 1000));
        // A quarter of what was taken for it, known to 1 / root 2000 from 1 000 degrees of freedom; four times that.
        assert!((found.rotation_sigma_rad / 0.5e-4 - 1.0).abs() < 4.0 * 0.022);
        assert!((found.rotation_u_rad() / found.rotation_sigma_rad - 1.0).abs() < 0.002);
    }

    #[test]
    fn few_approaches_cover_the_next_one_as_often_as_stated() {
        let (mut covered, draws) = (0, 4000);
        for seed in 0..draws {
            let views = views(1, 6, 1.5e-3, 1_000 + 7 * seed);
            let (next, before) = views[0].split_last().expect("six");
            let found = Approaches::from_views(&[before.to_vec()], 2e-4).expect("five approaches");
            let u_mm = found.rotation_u_rad() * 6e-3 / 2e-4 * (1.0_f64 + 0.2).sqrt();
            let mean_mm = before.iter().map(|at| at.stages_mm).sum::<f64>() / 5.0;
            covered += u32::from((next.stages_mm - mean_mm).abs() <= COVERAGE_95 * u_mm);
        }
        // 95 % of 4 000, standard deviation 0.34 %; four times that.
        let share = f64::from(covered) / draws as f64;
        assert!((share - 0.95).abs() < 4.0 * 0.0034, "{share}");
    }

    #[test]
    fn one_approach_tells_nothing() {
        assert_eq!(Approaches::from_views(&views(3, 1, 1e-3, 1), 2e-4), None);
        assert_eq!(Approaches::from_views(&[], 2e-4), None);
    }
}
