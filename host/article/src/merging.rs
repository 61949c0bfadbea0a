//! One point per voxel: the centre of mass as in the article, the best by the mask's map as it proposes, and by uncertainty.

use std::collections::BTreeMap;

use flankscope_metrology::cloud::merge::{MergeError, voxel_groups};
use flankscope_metrology::deviation::statistics;
use flankscope_metrology::surface::Surface;
use nalgebra::Isometry3;
use serde::Serialize;

use crate::comparison::Spread;
use crate::drawn::{Drawn, laid};

/// A merged cloud.
#[derive(Clone, Debug, Serialize)]
pub struct Merging {
    /// Whose poses: `article` or `surface`.
    pub poses: &'static str,
    /// `centre of mass` (the article's), `best by mask` (its section 10), `best by sigma`, `weighted by sigma` (ours).
    pub way: &'static str,
    /// Points before.
    pub of_points: usize,
    /// Points after: voxels in use.
    pub points: usize,
    /// Their signed distances to the surface.
    pub exact: Option<Spread>,
}

/// Points of all views with what speaks for each.
struct Cloud {
    points: Vec<[f64; 3]>,
    sigma_mm: Vec<f32>,
    fringes_dn: Vec<f32>,
}

impl Cloud {
    /// The point of a voxel that is largest by a measure; of equals the first.
    fn best(&self, voxel: &[u32], measure: impl Fn(usize) -> f32) -> [f64; 3] {
        let better = |best: usize, i: usize| if measure(i) > measure(best) { i } else { best };
        let numbers = voxel.iter().map(|&i| i as usize);
        self.points[numbers.reduce(better).unwrap_or(0)]
    }

    /// Mean of a voxel's points by their weights.
    fn mean(&self, voxel: &[u32], weight: impl Fn(usize) -> f64) -> [f64; 3] {
        let (mut sum, mut total) = ([0.0; 3], 0.0);
        for i in voxel.iter().map(|&i| i as usize) {
            let weight = weight(i);
            total += weight;
            for (sum, c) in sum.iter_mut().zip(self.points[i]) {
                *sum += weight * c;
            }
        }
        sum.map(|sum| sum / total)
    }

    fn by_fringes(&self, voxel: &[u32]) -> [f64; 3] {
        self.best(voxel, |i| self.fringes_dn[i])
    }

    fn by_sigma(&self, voxel: &[u32]) -> [f64; 3] {
        self.best(voxel, |i| -self.sigma_mm[i])
    }

    fn weighted(&self, voxel: &[u32]) -> [f64; 3] {
        self.mean(voxel, |i| f64::from(self.sigma_mm[i]).powi(-2))
    }

    fn centre(&self, voxel: &[u32]) -> [f64; 3] {
        self.mean(voxel, |_| 1.0)
    }
}

/// Merges the drawn points of all views in every way.
pub(crate) fn ways(
    name: &'static str,
    views: &BTreeMap<usize, Drawn>,
    poses: &BTreeMap<usize, Isometry3<f64>>,
    voxel_mm: f64,
    surface: &Surface,
) -> Result<Vec<Merging>, MergeError> {
    let mut cloud = Cloud {
        points: Vec::new(),
        sigma_mm: Vec::new(),
        fringes_dn: Vec::new(),
    };
    for (view, pose) in poses {
        if let Some(drawn) = views.get(view) {
            cloud.points.extend(laid(&drawn.xyz, pose));
            cloud.sigma_mm.extend(&drawn.sigma_mm);
            cloud.fringes_dn.extend(&drawn.fringes_dn);
        }
    }
    let voxels = voxel_groups(&cloud.points, voxel_mm)?;
    type Way = fn(&Cloud, &[u32]) -> [f64; 3];
    let ways: [(&str, Way); 4] = [
        ("centre of mass", Cloud::centre),
        ("best by mask", Cloud::by_fringes),
        ("best by sigma", Cloud::by_sigma),
        ("weighted by sigma", Cloud::weighted),
    ];
    let merged = |(way, of): (&'static str, Way)| {
        let points: Vec<[f64; 3]> = voxels.iter().map(|voxel| of(&cloud, voxel)).collect();
        let closest = surface.closest_many(&points);
        let exact_mm: Vec<f64> = closest.iter().map(|c| c.signed_distance_mm).collect();
        Merging {
            poses: name,
            way,
            of_points: cloud.points.len(),
            points: points.len(),
            exact: statistics(&exact_mm).map(Spread::from),
        }
    };
    Ok(ways.into_iter().map(merged).collect())
}

#[cfg(test)]
mod tests {
    use std::collections::HashMap;

    use super::*;

    #[test]
    fn every_voxel_has_the_point_that_a_map_of_voxels_finds() {
        let mixed = |i: u32, k: u32| (i * 3 + k).wrapping_mul(2_654_435_761) >> 8;
        let unit = |i: u32, k: u32| f64::from(mixed(i, k)) / f64::from(1 << 24);
        let cloud = Cloud {
            // The first point is the corner that voxels are counted from.
            points: std::iter::once([0.0; 3])
                .chain((1..4000).map(|i| [0, 1, 2].map(|k| unit(i, k))))
                .collect(),
            sigma_mm: (0..4000).map(|i| 1e-3 + unit(i, 7) as f32).collect(),
            fringes_dn: (0..4000).map(|i| 100.0 * unit(i, 11) as f32).collect(),
        };
        let mut plain: HashMap<[i64; 3], Vec<usize>> = HashMap::new();
        for (i, p) in cloud.points.iter().enumerate() {
            let key = p.map(|c| (c / 0.1).floor() as i64);
            plain.entry(key).or_default().push(i);
        }
        let voxels = voxel_groups(&cloud.points, 0.1).unwrap();
        assert_eq!(voxels.len(), plain.len());
        for voxel in &voxels {
            let key = cloud.points[voxel[0] as usize].map(|c| (c / 0.1).floor() as i64);
            let all = &plain[&key];
            let most = |of: &Vec<f32>, sign: f32| {
                let best = all.iter().map(|&i| sign * of[i]).fold(f32::MIN, f32::max);
                let i = all.iter().find(|&&i| sign * of[i] == best).unwrap();
                cloud.points[*i]
            };
            assert_eq!(cloud.by_fringes(voxel), most(&cloud.fringes_dn, 1.0));
            assert_eq!(cloud.by_sigma(voxel), most(&cloud.sigma_mm, -1.0));
            for k in 0..3 {
                let mean = all.iter().map(|&i| cloud.points[i][k]).sum::<f64>() / all.len() as f64;
                assert!((cloud.centre(voxel)[k] - mean).abs() < 1e-12);
                let weight = |i: usize| 1.0 / f64::from(cloud.sigma_mm[i]).powi(2);
                let total: f64 = all.iter().map(|&i| weight(i)).sum();
                let sum: f64 = all.iter().map(|&i| weight(i) * cloud.points[i][k]).sum();
                assert!((cloud.weighted(voxel)[k] - sum / total).abs() < 1e-9);
            }
        }
    }
}
