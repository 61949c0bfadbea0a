//! A start pose from picked point pairs (Kabsch 1976, Umeyama 1991).

use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

use flankscope_foundation::rigid::{Cloud, Rigid, Tool};

/// A picked pair: a cloud point and the CAD point that it shows, mm.
pub type Pair = ([f64; 3], [f64; 3]);

/// Reasons for which point pairs determine no pose.
#[derive(Debug, thiserror::Error, PartialEq)]
#[non_exhaustive]
pub enum PairsError {
    /// A line that is no pair.
    #[error(
        "line {line}: {text:?} is not a pair; right would be six finite numbers: cloud x, y, z, CAD x, y, z in mm"
    )]
    Line {
        /// Line number, from 1.
        line: usize,
        /// The line, shortened.
        text: String,
    },
    /// Not enough pairs.
    #[error("{pairs} pairs, at least 3 are needed")]
    TooFew {
        /// Pairs given.
        pairs: usize,
    },
    /// All on one line: the turn about it stays open.
    #[error(
        "the picked {side} points lie on a line (spread across it {across_mm:.6} mm, along it {along_mm:.3} mm); pick points that span a plane"
    )]
    Collinear {
        /// `cloud` or `CAD`.
        side: &'static str,
        /// Second largest spread.
        across_mm: f64,
        /// Largest spread.
        along_mm: f64,
    },
}

/// Reads pairs from text: per line cloud x, y, z, then CAD x, y, z, mm, separated by commas, semicolons or blanks. `#`
/// comments, blank lines and one heading line are skipped.
///
/// # Errors
/// [`PairsError::Line`].
pub fn parse_pairs(text: &str) -> Result<Vec<Pair>, PairsError> {
    let mut pairs = Vec::new();
    let mut first = true;
    for (number, line) in text.lines().enumerate() {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let words: Vec<&str> = line
            .split(|c: char| c.is_whitespace() || c == ',' || c == ';')
            .filter(|word| !word.is_empty())
            .collect();
        let numbers: Vec<f64> = words
            .iter()
            .filter_map(|word| word.parse().ok())
            .filter(|value: &f64| value.is_finite())
            .collect();
        let heading = first && words.iter().all(|word| word.parse::<f64>().is_err());
        first = false;
        if heading {
            continue;
        }
        let [a, b, c, d, e, f] = numbers[..] else {
            return Err(PairsError::Line {
                line: number + 1,
                text: line.chars().take(60).collect(),
            });
        };
        if words.len() != 6 {
            return Err(PairsError::Line {
                line: number + 1,
                text: line.chars().take(60).collect(),
            });
        }
        pairs.push(([a, b, c], [d, e, f]));
    }
    Ok(pairs)
}

/// The rigid motion with the least squared distance between the moved cloud points and their CAD partners.
///
/// With the centred sums H = sum p q^T = U S V^T the best rotation is V diag(1, 1, det(V U^T)) U^T: when the best
/// orthogonal matrix mirrors, the direction of the *smallest* singular value is turned over, which costs least.
///
/// # Errors
/// [`PairsError`] for fewer than three pairs or points on a line.
pub fn fit_pairs(pairs: &[Pair]) -> Result<Rigid<Tool, Cloud>, PairsError> {
    if pairs.len() < 3 {
        return Err(PairsError::TooFew { pairs: pairs.len() });
    }
    let n = pairs.len() as f64;
    let (mut mean_p, mut mean_q) = (Vector3::zeros(), Vector3::zeros());
    for (p, q) in pairs {
        mean_p += Vector3::from(*p) / n;
        mean_q += Vector3::from(*q) / n;
    }
    let mut h = Matrix3::zeros();
    let (mut scatter_p, mut scatter_q) = (Matrix3::zeros(), Matrix3::zeros());
    for (p, q) in pairs {
        let (p, q) = (Vector3::from(*p) - mean_p, Vector3::from(*q) - mean_q);
        h += p * q.transpose();
        scatter_p += p * p.transpose() / n;
        scatter_q += q * q.transpose() / n;
    }
    check_spread("cloud", scatter_p)?;
    check_spread("CAD", scatter_q)?;
    let svd = h.svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else {
        return Err(PairsError::TooFew { pairs: pairs.len() });
    };
    let v = v_t.transpose();
    let mirror = (v * u.transpose()).determinant().signum();
    let turn = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, mirror));
    let rotation = Rotation3::from_matrix_unchecked(v * turn * u.transpose());
    let rotation = UnitQuaternion::from_rotation_matrix(&rotation);
    let translation = mean_q - rotation * mean_p;
    Ok(Rigid::from_isometry(Isometry3::from_parts(
        Translation3::from(translation),
        rotation,
    )))
}

/// Root mean square distance of the pairs under a pose, mm.
pub fn pairs_rms(pairs: &[Pair], pose: &Rigid<Tool, Cloud>) -> f64 {
    let sum: f64 = pairs
        .iter()
        .map(|(p, q)| (pose.isometry() * Point3::from(*p) - Point3::from(*q)).norm_squared())
        .sum();
    (sum / pairs.len() as f64).sqrt()
}

fn check_spread(side: &'static str, scatter: Matrix3<f64>) -> Result<(), PairsError> {
    let mut variances: [f64; 3] = scatter.symmetric_eigenvalues().into();
    variances.sort_by(f64::total_cmp);
    let [_, across_mm, along_mm] = variances.map(|v| v.max(0.0).sqrt());
    if across_mm > 1e-3 * along_mm {
        return Ok(());
    }
    Err(PairsError::Collinear {
        side,
        across_mm,
        along_mm,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use flankscope_foundation::random::uniform;

    fn cost(pairs: &[Pair], pose: &Isometry3<f64>) -> f64 {
        pairs_rms(pairs, &Rigid::from_isometry(*pose))
    }

    /// A pattern search over rotations from many starts: slow and independent of any decomposition.
    fn brute_force(pairs: &[Pair]) -> f64 {
        let n = pairs.len() as f64;
        let mean = |side: fn(&Pair) -> [f64; 3]| {
            pairs
                .iter()
                .map(|p| Vector3::from(side(p)))
                .sum::<Vector3<f64>>()
                / n
        };
        let (mean_p, mean_q) = (mean(|p| p.0), mean(|p| p.1));
        let at = |rotation: UnitQuaternion<f64>| {
            let translation = Translation3::from(mean_q - rotation * mean_p);
            cost(pairs, &Isometry3::from_parts(translation, rotation))
        };
        let mut least = f64::INFINITY;
        for start in 0..60u64 {
            let draw = |k: u64| 6.0 * (uniform(99, 3 * start + k) - 0.5);
            let mut rotation =
                UnitQuaternion::from_scaled_axis(Vector3::new(draw(0), draw(1), draw(2)));
            let mut best = at(rotation);
            let mut step = 0.5;
            while step > 1e-9 {
                let mut improved = false;
                for k in 0..6 {
                    let mut axis = Vector3::zeros();
                    axis[k / 2] = if k % 2 == 0 { step } else { -step };
                    let trial = UnitQuaternion::from_scaled_axis(axis) * rotation;
                    if at(trial) < best {
                        (rotation, best, improved) = (trial, at(trial), true);
                    }
                }
                if !improved {
                    step *= 0.5;
                }
            }
            least = least.min(best);
        }
        least
    }

    #[test]
    fn the_fit_is_the_optimum_also_when_the_best_orthogonal_matrix_mirrors() {
        for seed in 0..6u64 {
            let value = |i: u64| uniform(seed, i) * 10.0 - 5.0;
            let mut pairs: Vec<Pair> = (0..5)
                .map(|i| {
                    let p = [value(3 * i), value(3 * i + 1), value(3 * i + 2)];
                    let noise = |k: u64| 0.3 * uniform(seed + 50, 3 * i + k);
                    (p, [p[1] + noise(0), -p[0] + noise(1), p[2] + noise(2)])
                })
                .collect();
            if seed % 2 == 1 {
                // Mirrored partners force the reflection case.
                for pair in &mut pairs {
                    pair.1[2] = -pair.1[2];
                }
            }
            let pose = fit_pairs(&pairs).unwrap();
            let rotation = pose.isometry().rotation.to_rotation_matrix();
            assert!((rotation.matrix().determinant() - 1.0).abs() < 1e-12);
            let (ours, optimum) = (pairs_rms(&pairs, &pose), brute_force(&pairs));
            assert!(
                (ours - optimum).abs() < 1e-7,
                "seed {seed}: {ours} against {optimum}"
            );
        }
    }

    #[test]
    fn points_on_a_line_and_too_few_pairs_are_refused() {
        let line: Vec<_> = (0..5)
            .map(|i| {
                (
                    [f64::from(i), 0.0, 0.0],
                    [f64::from(i), f64::from(i % 2), 0.0],
                )
            })
            .collect();
        assert!(matches!(
            fit_pairs(&line),
            Err(PairsError::Collinear { side: "cloud", .. })
        ));
        assert_eq!(fit_pairs(&line[..2]), Err(PairsError::TooFew { pairs: 2 }));
    }

    #[test]
    fn pairs_are_read_with_a_heading_and_refused_by_line() {
        let text = "x,y,z,X,Y,Z\n1,2,3,4,5,6\n# note\n\n7 8 9 10 11 12\n";
        assert_eq!(parse_pairs(text).unwrap().len(), 2);
        let wrong = parse_pairs("1,2,3,4,5,6\n1,2,nan,4,5,6\n");
        assert!(
            matches!(wrong, Err(PairsError::Line { line: 2, .. })),
            "{wrong:?}"
        );
    }
}
