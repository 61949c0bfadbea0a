//! Circles, dark on bright ground or bright on dark: the middle of each elliptic image.
//!
//! A blob is a connected patch darker than halfway between the darkest and the brightest about it. It is a circle's image if its area is that
//! of the ellipse with its second moments. The middle is the centre of gravity of what it takes away from the ground about it, by which soft rims
//! are weighed as they are.

use nalgebra::{Matrix2, SymmetricEigen, Vector2};

use super::image::Grey;
use super::lattice::Candidate;
use crate::cells::DisjointSets;
use flankscope_foundation::order::median;

/// Radius about a pixel within which minimum and maximum are searched, relative to the image's width: a little more than the grid's pitch.
pub(super) const REACHES: [f64; 4] = [1.0 / 48.0, 1.0 / 24.0, 1.0 / 12.0, 1.0 / 96.0];
/// Least difference of circle and ground, as part of the ground, and in counts.
const LEAST_CONTRAST: f64 = 0.15;
const LEAST_COUNTS: f64 = 4.0;
/// Smallest blob, and largest ratio of its axes.
const LEAST_PIXELS: usize = 20;
const MOST_SLENDER: f64 = 4.0;
/// Largest relative deviation of a circle's area from that of the ellipse with its moments.
const LEAST_ROUND: f64 = 0.9;
const BLUR_PX: f64 = 1.0;
/// The ground begins here and ends there, in radii of the blob.
const GROUND: [f64; 2] = [1.35, 1.6];

/// Blobs that may be circles.
pub(super) fn candidates(image: &Grey, reach: f64, bright: bool) -> Vec<Candidate> {
    let image = match bright {
        true => {
            let most = image.values.iter().copied().fold(0.0, f32::max);
            Grey {
                values: image.values.iter().map(|v| most - v).collect(),
                ..*image
            }
        }
        false => image.clone(),
    };
    let smooth = image.blurred(BLUR_PX);
    let side = (reach * image.columns as f64).round().max(4.0) as usize;
    let dark = dark_pixels(&smooth, side, bright);
    let (columns, rows) = (image.columns, image.rows);
    let mut patches = DisjointSets::new(columns * rows);
    for row in 0..rows {
        for column in 0..columns {
            let at = row * columns + column;
            if dark[at] {
                if column > 0 && dark[at - 1] {
                    patches.join(at, at - 1);
                }
                if row > 0 && dark[at - columns] {
                    patches.join(at, at - columns);
                }
            }
        }
    }
    let mut blobs: std::collections::BTreeMap<usize, Vec<[usize; 2]>> =
        std::collections::BTreeMap::new();
    for at in (0..columns * rows).filter(|&at| dark[at]) {
        blobs
            .entry(patches.root(at))
            .or_default()
            .push([at % columns, at / columns]);
    }
    let most = (side * side) * 4;
    blobs
        .into_values()
        .filter(|blob| (LEAST_PIXELS..most).contains(&blob.len()))
        .filter_map(|blob| middle(&image, &blob))
        .map(|at_px| Candidate {
            at_px,
            white: None,
            edges: None,
        })
        .collect()
}

/// Pixels darker than halfway between darkest and brightest of the squares about them.
fn dark_pixels(smooth: &Grey, side: usize, inverted: bool) -> Vec<bool> {
    let (columns, rows) = (smooth.columns, smooth.rows);
    let (across, down) = (columns.div_ceil(side), rows.div_ceil(side));
    let mut ends = vec![[f32::INFINITY, f32::NEG_INFINITY]; across * down];
    for row in 0..rows {
        for column in 0..columns {
            let value = smooth.values[row * columns + column];
            let [low, high] = &mut ends[(row / side) * across + column / side];
            *low = low.min(value);
            *high = high.max(value);
        }
    }
    let mut wide = ends.clone();
    for row in 0..down {
        for column in 0..across {
            for y in row.saturating_sub(1)..=(row + 1).min(down - 1) {
                for x in column.saturating_sub(1)..=(column + 1).min(across - 1) {
                    let [low, high] = ends[y * across + x];
                    let own = &mut wide[row * across + column];
                    *own = [own[0].min(low), own[1].max(high)];
                }
            }
        }
    }
    let is_dark = |at: usize| {
        let (column, row) = (at % columns, at / columns);
        let [low, high] = wide[(row / side) * across + column / side].map(f64::from);
        let scale = if inverted { high - low } else { high };
        let apart = high - low;
        apart > LEAST_COUNTS
            && apart > LEAST_CONTRAST * scale
            && f64::from(smooth.values[at]) < 0.5 * (low + high)
    };
    (0..columns * rows).map(is_dark).collect()
}

/// The middle of a blob, if it is an ellipse.
fn middle(image: &Grey, blob: &[[usize; 2]]) -> Option<[f64; 2]> {
    let count = blob.len() as f64;
    let points = blob.iter().map(|&[x, y]| Vector2::new(x as f64, y as f64));
    let centre = points.clone().sum::<Vector2<f64>>() / count;
    let spread: Matrix2<f64> = points
        .map(|p| (p - centre) * (p - centre).transpose())
        .sum::<Matrix2<f64>>()
        / count;
    // A pixel has a spread of its own.
    let spread = spread + Matrix2::identity() / 12.0;
    let eigen = SymmetricEigen::new(spread);
    let [a, b] = [eigen.eigenvalues.max(), eigen.eigenvalues.min()].map(|s| 2.0 * s.sqrt());
    let round = count / (std::f64::consts::PI * a * b);
    if !(a < MOST_SLENDER * b && (LEAST_ROUND..1.0 / LEAST_ROUND).contains(&round)) {
        return None;
    }
    let inverse = (spread * 4.0).try_inverse()?;
    let reach = GROUND[1] * a;
    let radius = |p: Vector2<f64>| (p - centre).dot(&(inverse * (p - centre))).sqrt();
    let [x, y] = centre.into();
    let whole = [x - reach, y - reach].iter().all(|&low| low > 1.0)
        && x + reach < (image.columns - 2) as f64
        && y + reach < (image.rows - 2) as f64;
    if !whole {
        return None;
    }
    // The ground rises evenly: a plane through what lies about the circle.
    let mut ground: Vec<(Vector2<f64>, f64)> = Vec::new();
    let mut within: Vec<(Vector2<f64>, f64)> = Vec::new();
    for [column, row] in image.about(centre.into(), reach, 0) {
        let p = Vector2::new(column as f64, row as f64);
        let value = image.at(column, row);
        match radius(p) {
            r if r < GROUND[0] => within.push((p, value)),
            r if r < GROUND[1] => ground.push((p, value)),
            _ => {}
        }
    }
    let mut levels: Vec<f64> = ground.iter().map(|g| g.1).collect();
    let level = median(&mut levels)?;
    let (mut normal, mut right) = (nalgebra::Matrix3::zeros(), nalgebra::Vector3::zeros());
    let least = 0.5 * level;
    for (p, value) in ground.iter().filter(|g| g.1 > least) {
        let row = nalgebra::Vector3::new(1.0, p.x - x, p.y - y);
        normal += row * row.transpose();
        right += *value * row;
    }
    let plane = normal.cholesky()?.solve(&right);
    let (mut weight, mut sum) = (0.0, Vector2::zeros());
    for (p, value) in within {
        let missing = 1.0 - value / (plane[0] + plane[1] * (p.x - x) + plane[2] * (p.y - y));
        weight += missing;
        sum += missing * (p - centre);
    }
    let found = centre + sum / weight;
    ((found - centre).norm() < 0.5 * b).then_some(found.into())
}
