//! A bore made by a stranger: the demo die's teeth as a mesh whose flanks lie anywhere.
//!
//! ```text
//!  what a flank lost at (tooth, flank, length from the tip edge, height) ──► bore: flanks, lands, roots; no wall, no end faces
//! ```

use std::path::Path;

use flankscope_gear_cad::{Flank, Mesh, write_stl};

use crate::demo_gear;

/// A place on a flank.
#[derive(Clone, Copy, Debug)]
pub struct Place {
    /// Tooth, from 1.
    pub tooth: u32,
    /// Side.
    pub flank: Flank,
    /// Radius less that of the tip, mm.
    pub from_tip_mm: f64,
    pub height_mm: f64,
}

/// A flank that is cut more finely than the others.
#[derive(Clone, Copy, Debug)]
pub struct Fine {
    /// Tooth, from 1.
    pub tooth: u32,
    /// Side.
    pub flank: Flank,
    /// Radius less that of the tip, mm, from and to.
    pub from_tip_mm: [f64; 2],
    pub height_mm: [f64; 2],
    /// Steps along radius and height, mm.
    pub step_mm: [f64; 2],
}

/// Steps of the other flanks along radius and height, mm: a chord of the involute is 0.3 µm off there.
const COARSE_MM: [f64; 2] = [0.1, 2.0];
/// Parts of a land or root along the circumference.
const LAND_PARTS: usize = 8;

/// The demo die's bore: every flank lowered by `loss_mm` along its normal, and tip and root with it; a tooth left out where that is infinite.
///
/// # Panics
/// The drawing is impossible.
#[must_use]
pub fn bore(loss_mm: impl Fn(Place) -> f64, fine: &[Fine]) -> Mesh {
    lowered(loss_mm, fine, false)
}

/// A bore that wears as in a press: flanks recede along the circumference, by `loss_mm` along their normals, and the radii of tip and root
/// stay.
///
/// # Panics
/// The drawing is impossible.
#[must_use]
pub fn worn_bore(loss_mm: impl Fn(Place) -> f64, fine: &[Fine]) -> Mesh {
    lowered(loss_mm, fine, true)
}

fn lowered(loss_mm: impl Fn(Place) -> f64, fine: &[Fine], along_circumference: bool) -> Mesh {
    let gear = demo_gear();
    let mut mesh = Mesh::default();
    let [low, high] = gear.height_mm;
    let depth_mm = (gear.root_radius_mm - gear.tip_radius_mm).abs();
    let point = |place: Place, sunk_mm: f64| {
        let radius = gear.tip_radius_mm + place.from_tip_mm;
        let angle = gear.flank_angle_rad(place.tooth, place.flank, radius);
        let [nx, ny] = gear.flank_normal(place.tooth, place.flank, radius);
        if along_circumference {
            let angle = angle - sunk_mm / (radius * (ny * angle.cos() - nx * angle.sin()));
            return [radius * angle.cos(), radius * angle.sin(), place.height_mm];
        }
        let at = [radius * angle.cos(), radius * angle.sin()];
        [at[0] - sunk_mm * nx, at[1] - sunk_mm * ny, place.height_mm]
    };
    for tooth in 1..=gear.teeth {
        for flank in [Flank::Right, Flank::Left] {
            let cut = fine.iter().find(|f| (f.tooth, f.flank) == (tooth, flank));
            let radii = steps(
                [0.0, depth_mm],
                COARSE_MM[0],
                cut.map(|f| (f.from_tip_mm, f.step_mm[0])),
            );
            let heights = steps(
                [low, high],
                COARSE_MM[1],
                cut.map(|f| (f.height_mm, f.step_mm[1])),
            );
            let at = |i: usize, k: usize| {
                let place = Place {
                    tooth,
                    flank,
                    from_tip_mm: radii[i],
                    height_mm: heights[k],
                };
                point(place, loss_mm(place))
            };
            // Along growing angle: a right flank from the root to the tip, a left one back.
            let order: Vec<usize> = match flank {
                Flank::Right => (0..radii.len()).rev().collect(),
                Flank::Left => (0..radii.len()).collect(),
            };
            strip(&mut mesh, order.len(), heights.len(), |i, k| {
                at(order[i], k)
            });
        }
        // The tip's land between both flanks of a tooth, and the root to the next one.
        let next = tooth % gear.teeth + 1;
        for (from, to, from_tip_mm) in [
            ((tooth, Flank::Right), (tooth, Flank::Left), 0.0),
            ((tooth, Flank::Left), (next, Flank::Right), depth_mm),
        ] {
            let heights = steps([low, high], COARSE_MM[1], None);
            strip(&mut mesh, LAND_PARTS + 1, heights.len(), |i, k| {
                let end = |(tooth, flank)| {
                    let place = Place {
                        tooth,
                        flank,
                        from_tip_mm,
                        height_mm: heights[k],
                    };
                    let [x, y, _] = point(place, loss_mm(place));
                    [x.hypot(y), y.atan2(x)]
                };
                let ([r0, a0], [r1, a1]) = (end(from), end(to));
                let turn = (a1 - a0).rem_euclid(std::f64::consts::TAU);
                let t = i as f64 / LAND_PARTS as f64;
                let (r, a) = (r0 + t * (r1 - r0), a0 + t * turn);
                [r * a.cos(), r * a.sin(), heights[k]]
            });
        }
    }
    mesh.triangles.retain(|t| {
        t.iter()
            .all(|&v| mesh.vertices[v as usize].iter().all(|x| x.is_finite()))
    });
    for vertex in &mut mesh.vertices {
        *vertex = vertex.map(|x| if x.is_finite() { x } else { 0.0 });
    }
    mesh
}

/// Places from low to high, denser within a part.
fn steps([low, high]: [f64; 2], coarse: f64, fine: Option<([f64; 2], f64)>) -> Vec<f64> {
    let mut all = even(low, high, coarse);
    if let Some(([from, to], step)) = fine {
        let (from, to) = (from.max(low), to.min(high));
        all.retain(|x| *x < from - 1e-9 || *x > to + 1e-9);
        all.extend(even(from, to, step));
        all.sort_by(f64::total_cmp);
    }
    all
}

fn even(low: f64, high: f64, step: f64) -> Vec<f64> {
    let count = ((high - low) / step).ceil().max(1.0);
    (0..=count as usize)
        .map(|i| low + (high - low) * i as f64 / count)
        .collect()
}

/// A sheet of `columns` x `rows` vertices, columns along growing angle, facing the axis.
fn strip(mesh: &mut Mesh, columns: usize, rows: usize, at: impl Fn(usize, usize) -> [f64; 3]) {
    let first = mesh.vertices.len() as u32;
    for i in 0..columns {
        for k in 0..rows {
            mesh.vertices.push(at(i, k));
        }
    }
    let rows = rows as u32;
    for i in 0..columns as u32 - 1 {
        for k in 0..rows - 1 {
            let [a, b] = [first + i * rows + k, first + (i + 1) * rows + k];
            mesh.triangles.extend([[a, a + 1, b], [b, a + 1, b + 1]]);
        }
    }
}

/// Writes a bore as `die.stl` into a folder; its path as an argument.
///
/// # Panics
/// It cannot be written.
#[must_use]
pub fn write_bore(folder: &Path, mesh: &Mesh) -> String {
    let path = folder.join("die.stl");
    let mut bytes = Vec::new();
    write_stl(mesh, "die", &mut bytes).expect("a mesh of few triangles");
    std::fs::write(&path, bytes).expect("written");
    path.to_str().expect("UTF-8").to_owned()
}
