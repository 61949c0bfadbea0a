//! Random damage of any shape: a depth at every position of a zone, cut into the mesh of a die.
//!
//! The shapes differ from those of [`crate::world::WearKind`], so that an instrument tuned to these is tested with others.

use std::f64::consts::{PI, TAU};
use std::sync::Arc;

use flankscope_gear_cad::{Flank, GearSpec, Mesh};
use rand::RngExt;
use rand_pcg::rand_core::SeedableRng;

use crate::world::{DieMesh, FlankId, MAX_DEPTH_UM, WorldError, flank_of_facet};

/// Longest mesh edge where damage is cut in, mm; no shape has an edge or a groove narrower than this.
const MESH_EDGE_MM: f64 = 0.05;
/// Distance beyond the zone's ends to which damage has full depth, mm; it fades out over the same distance again.
const BEYOND_MM: f64 = 0.6;
/// The corresponding distance along the profile, mm: damage ends within a tenth of a module of the zone, at edges that stay.
const ASIDE_MM: f64 = 0.045;
/// Tolerance for the distance of a drawing's flank vertices from the involute, mm.
const ON_INVOLUTE_MM: f64 = 0.01;
/// Points nearer to each other than this are the same, mm.
const SAME_MM: f64 = 1e-6;
/// Raster of the search for the largest mean, mm: a disc of 0.25 mm² has 600 points.
pub const RASTER_MM: f64 = 0.02;
/// Number of waves in a random field, and ratio of their longest wavelength to the shortest, 0.1 mm.
const WAVES: usize = 12;
const SHORTEST_MM: f64 = 0.1;
const LENGTH_RATIO: f64 = 30.0;

/// A random number generator for one purpose.
#[derive(Clone)]
pub struct Random(rand_pcg::Pcg64);

impl Random {
    /// Generator for a seed and a purpose below 64.
    #[must_use]
    pub fn new(seed: u64, purpose: u64) -> Self {
        Self(rand_pcg::Pcg64::seed_from_u64(
            seed.wrapping_mul(64).wrapping_add(purpose),
        ))
    }

    /// Uniform from 0 to 1.
    pub fn uniform(&mut self) -> f64 {
        self.0.random()
    }

    /// Uniform between two numbers.
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    fn below(&mut self, count: usize) -> usize {
        self.0.random_range(0..count)
    }

    /// Standard normal (Box and Muller 1958).
    pub fn normal(&mut self) -> f64 {
        let (a, b) = (1.0 - self.uniform(), self.uniform());
        (-2.0 * a.ln()).sqrt() * (TAU * b).cos()
    }
}

/// The judged rectangle: profile length from the base circle by height, mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rectangle {
    /// Smallest and largest profile length, mm.
    pub profile_mm: [f64; 2],
    /// Smallest and largest height, mm.
    pub height_mm: [f64; 2],
}

impl Rectangle {
    fn size_mm(&self) -> [f64; 2] {
        [self.profile_mm, self.height_mm].map(|[low, high]| high - low)
    }
}

/// A shape of unit depth; positions in mm from the rectangle's corner.
#[derive(Clone, Debug, PartialEq)]
enum Shape {
    /// Half-plane beyond a line, with a slope of this width.
    Step(Line, f64),
    /// Ramp that rises from a line over this length.
    Ramp(Line, f64),
    /// Ridge that falls off to both sides of a line with this length.
    Edge(Line, f64),
    /// Round, with a flat bottom or bowl-shaped.
    Spall {
        at: [f64; 2],
        radius: f64,
        flat: bool,
    },
    /// A groove along a line, of this width and length.
    Scratch(Line, [f64; 2]),
    /// A band-limited random field: waves with their phase and amplitude. It is as proud as it is deep.
    Field(Vec<([f64; 2], f64, f64)>),
    /// Weighted sum of shapes.
    Sum(Vec<(f64, Shape)>),
}

/// A line through a point, and the unit vector across it.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Line {
    at: [f64; 2],
    across: [f64; 2],
}

impl Line {
    /// Distance of a point across and along the line.
    fn from(&self, p: [f64; 2]) -> [f64; 2] {
        let [x, y] = [0, 1].map(|k| p[k] - self.at[k]);
        let [nx, ny] = self.across;
        [x * nx + y * ny, x * ny - y * nx]
    }
}

/// Number of shapes other than sums.
const SIMPLE: usize = 6;

impl Shape {
    fn draw(random: &mut Random, size_mm: [f64; 2], kinds: usize) -> Self {
        let at = size_mm.map(|size| size * random.uniform());
        let angle = random.between(0.0, TAU);
        let line = Line {
            at,
            across: [angle.cos(), angle.sin()],
        };
        match random.below(kinds) {
            0 => Self::Step(line, random.between(MESH_EDGE_MM, 0.3)),
            1 => Self::Ramp(line, random.between(0.2, 4.0)),
            2 => Self::Edge(line, random.between(0.1, 3.0)),
            3 => Self::Spall {
                at,
                radius: random.between(0.15, 1.5),
                flat: random.below(2) == 0,
            },
            4 => Self::Scratch(line, [random.between(0.1, 0.5), random.between(0.3, 6.0)]),
            5 => {
                let length = SHORTEST_MM * LENGTH_RATIO.powf(random.uniform());
                let wave = |random: &mut Random| {
                    let number = [random.normal() / length, random.normal() / length];
                    (number, random.between(0.0, TAU), random.normal())
                };
                Self::Field((0..WAVES).map(|_| wave(random)).collect())
            }
            _ => {
                let parts = (0..2 + random.below(3)).map(|_| {
                    let share = random.between(0.1, 1.0);
                    (share, Self::draw(random, size_mm, SIMPLE))
                });
                Self::Sum(parts.collect())
            }
        }
    }

    fn name(&self) -> &'static str {
        match self {
            Self::Step(..) => "step",
            Self::Ramp(..) => "ramp",
            Self::Edge(..) => "edge",
            Self::Spall { flat: true, .. } => "spall",
            Self::Spall { .. } => "bowl",
            Self::Scratch(..) => "scratch",
            Self::Field(_) => "field",
            Self::Sum(_) => "sum",
        }
    }

    fn at(&self, p: [f64; 2]) -> f64 {
        match self {
            Self::Step(line, width) => (line.from(p)[0] / width + 0.5).clamp(0.0, 1.0),
            Self::Ramp(line, length) => (line.from(p)[0] / length).clamp(0.0, 1.0),
            Self::Edge(line, length) => (-line.from(p)[0].abs() / length).exp(),
            Self::Spall { at, radius, flat } => {
                let away_mm = (p[0] - at[0]).hypot(p[1] - at[1]);
                if *flat {
                    // A rim as wide as the mesh's edges.
                    ((radius - away_mm) / MESH_EDGE_MM + 0.5).clamp(0.0, 1.0)
                } else {
                    (1.0 - (away_mm / radius).powi(2)).max(0.0).powi(2)
                }
            }
            Self::Scratch(line, [width, length]) => {
                let [across, along] = line.from(p).map(f64::abs);
                let inside =
                    |half: f64, at: f64| ((half - at) / MESH_EDGE_MM + 0.5).clamp(0.0, 1.0);
                inside(0.5 * width, across) * inside(0.5 * length, along)
            }
            Self::Field(waves) => waves
                .iter()
                .map(|([x, y], phase, height)| height * (x * p[0] + y * p[1] + phase).cos())
                .sum(),
            Self::Sum(parts) => parts.iter().map(|(part, shape)| part * shape.at(p)).sum(),
        }
    }
}

/// A damage with its depth in the judged rectangle.
#[derive(Clone, Debug, PartialEq)]
pub struct Damage {
    shape: Shape,
    scale_mm: f64,
    judged: Rectangle,
}

impl Damage {
    /// A random shape in the rectangle, scaled so that its largest mean loss over a disc is `target_um`, unless it would then be
    /// deeper or more proud somewhere than a die allows.
    #[must_use]
    pub fn draw(seed: u64, judged: Rectangle, disc_area_mm2: f64, target_um: f64) -> Self {
        let mut random = Random::new(seed, 3);
        let shape = Shape::draw(&mut random, judged.size_mm(), SIMPLE + 1);
        Self::scaled(shape, judged, disc_area_mm2, target_um)
    }

    /// A round hole with a flat bottom of this area at a random position, completely inside the rectangle.
    #[must_use]
    pub fn spot(seed: u64, judged: Rectangle, area_mm2: f64, depth_um: f64) -> Self {
        let mut random = Random::new(seed, 4);
        let radius = (area_mm2 / PI).sqrt();
        let margin = radius + 0.5 * MESH_EDGE_MM;
        let at = judged
            .size_mm()
            .map(|size| random.between(margin.min(0.5 * size), (size - margin).max(0.5 * size)));
        Self {
            shape: Shape::Spall {
                at,
                radius,
                flat: true,
            },
            scale_mm: 1e-3 * depth_um,
            judged,
        }
    }

    fn scaled(shape: Shape, judged: Rectangle, disc_area_mm2: f64, target_um: f64) -> Self {
        let mut damage = Self {
            shape,
            scale_mm: 1e-3,
            judged,
        };
        let largest_um = damage.largest_mean_um(disc_area_mm2);
        // A shape that hardly touches the rectangle, or is only proud, cannot be scaled to a loss.
        let wanted = if largest_um > 1e-3 {
            target_um / largest_um
        } else {
            target_um
        };
        let [columns, rows] = judged.size_mm().map(|size| (size / RASTER_MM) as usize);
        let extreme = (0..columns * rows)
            .map(|i| {
                let at = [i % columns, i / columns].map(|k| RASTER_MM * k as f64);
                damage.shape.at(at).abs()
            })
            .fold(0.0, f64::max);
        damage.scale_mm = 1e-3 * wanted.min(MAX_DEPTH_UM / extreme);
        damage
    }

    /// Name of the shape.
    pub fn name(&self) -> &'static str {
        self.shape.name()
    }

    /// Depth at a profile length (from the base circle) and height, mm.
    #[must_use]
    pub fn depth_mm(&self, profile_mm: f64, height_mm: f64) -> f64 {
        let Rectangle {
            profile_mm: [from, to],
            height_mm: [low, high],
        } = self.judged;
        let outside_mm = (low - height_mm).max(height_mm - high);
        let aside_mm = (from - profile_mm).max(profile_mm - to);
        let fade = (2.0 - outside_mm / BEYOND_MM).clamp(0.0, 1.0)
            * (2.0 - aside_mm / ASIDE_MM).clamp(0.0, 1.0);
        if fade == 0.0 {
            return 0.0;
        }
        self.scale_mm * fade * self.shape.at([profile_mm - from, height_mm - low])
    }

    /// Its largest mean over any disc of this area in the rectangle, µm.
    #[must_use]
    pub fn largest_mean_um(&self, disc_area_mm2: f64) -> f64 {
        largest_mean_um(self.judged, disc_area_mm2, RASTER_MM, |profile, height| {
            self.depth_mm(profile, height)
        })
    }
}

/// The largest mean of a depth over any disc in the rectangle, µm, by brute force on a raster.
pub fn largest_mean_um(
    judged: Rectangle,
    disc_area_mm2: f64,
    raster_mm: f64,
    depth_mm: impl Fn(f64, f64) -> f64,
) -> f64 {
    let [columns, rows] = judged
        .size_mm()
        .map(|size| (size / raster_mm).round() as usize);
    // Cumulative sums along each row.
    let mut sums = vec![vec![0.0; columns + 1]; rows];
    for (row, sums) in sums.iter_mut().enumerate() {
        let height = judged.height_mm[0] + raster_mm * (row as f64 + 0.5);
        for column in 0..columns {
            let profile = judged.profile_mm[0] + raster_mm * (column as f64 + 0.5);
            sums[column + 1] = sums[column] + depth_mm(profile, height);
        }
    }
    let radius = (disc_area_mm2 / PI).sqrt() / raster_mm;
    let reach = radius.floor() as usize;
    let halves: Vec<usize> = (0..=2 * reach)
        .map(|i| {
            let away = i as f64 - reach as f64;
            (radius * radius - away * away).max(0.0).sqrt() as usize
        })
        .collect();
    let places: usize = halves.iter().map(|half| 2 * half + 1).sum();
    let mut largest = f64::NEG_INFINITY;
    for row in reach..rows.saturating_sub(reach) {
        for column in reach..columns.saturating_sub(reach) {
            let sum: f64 = halves
                .iter()
                .enumerate()
                .map(|(i, &half)| {
                    let sums = &sums[row + i - reach];
                    sums[column + half + 1] - sums[column - half]
                })
                .sum();
            largest = largest.max(sum / places as f64);
        }
    }
    1e3 * largest
}

/// A drawing with some flanks meshed finely enough for any damage; the surface itself is unchanged.
#[derive(Clone, Debug)]
pub struct Workpiece {
    mesh: Mesh,
    gear: GearSpec,
    /// Vertices of the fine flanks: index, flank, profile length and height.
    fine: Vec<(u32, FlankId, [f64; 2])>,
}

impl Workpiece {
    /// Replaces each of these flanks by a fine grid: within the rectangle and slightly beyond, no edge is longer than 0.05 mm
    /// along profile or height.
    ///
    /// # Errors
    /// The drawing does not have one of the flanks.
    pub fn new(
        drawing: &Mesh,
        gear: &GearSpec,
        flanks: &[FlankId],
        judged: Rectangle,
    ) -> Result<Self, WorldError> {
        let mut mesh = drawing.clone();
        let mut fine = Vec::new();
        for &id in flanks {
            let vertices = &mesh.vertices;
            let on_flank = |t: &[u32; 3]| {
                let corners = t.map(|v| vertices[v as usize]);
                flank_of_facet(gear, corners, ON_INVOLUTE_MM) == Some(id)
            };
            let (old, kept): (Vec<_>, Vec<_>) = mesh.triangles.iter().partition(|t| on_flank(t));
            // The flank is its profile, extruded along the axis.
            let mut profile: Vec<[f64; 2]> = old
                .iter()
                .flatten()
                .map(|&v| [0, 1].map(|k| vertices[v as usize][k]))
                .collect();
            let radius = |p: &[f64; 2]| p[0].hypot(p[1]);
            profile.sort_by(|a, b| radius(a).total_cmp(&radius(b)));
            profile.dedup_by(|a, b| radius(a) - radius(b) < SAME_MM);
            if profile.len() < 2 {
                return Err(WorldError::FlankNotFound {
                    tooth: id.tooth,
                    flank: id.flank,
                    limit_mm: ON_INVOLUTE_MM,
                });
            }
            mesh.triangles = kept;
            let across = divided(&profile);
            let heights = heights_mm(gear.height_mm, judged.height_mm);
            let first = mesh.vertices.len() as u32;
            let base = gear.base_radius_mm();
            for &height in &heights {
                for &[x, y] in &across {
                    let length = (x * x + y * y - base * base).max(0.0) / (2.0 * base);
                    fine.push((mesh.vertices.len() as u32, id, [length, height]));
                    mesh.vertices.push([x, y, height]);
                }
            }
            let columns = across.len() as u32;
            for row in 0..heights.len() as u32 - 1 {
                for column in 0..columns - 1 {
                    let a = first + row * columns + column;
                    let [b, c, d] = [a + 1, a + 1 + columns, a + columns];
                    // Left flanks have the larger angle, so seen from outside the orientation of radius and height is reversed.
                    match id.flank {
                        Flank::Left => mesh.triangles.extend([[a, c, b], [a, d, c]]),
                        Flank::Right => mesh.triangles.extend([[a, b, c], [a, c, d]]),
                    }
                }
            }
        }
        Ok(Self {
            mesh,
            gear: gear.clone(),
            fine,
        })
    }

    /// The die with damage on some of those flanks.
    ///
    /// # Errors
    /// The vertices are not valid for a mesh.
    pub fn cut(&self, damages: &[(FlankId, Damage)]) -> Result<Arc<DieMesh>, WorldError> {
        let mut mesh = self.mesh.clone();
        for &(vertex, id, [profile, height]) in &self.fine {
            let depth: f64 = damages
                .iter()
                .filter(|(of, _)| *of == id)
                .map(|(_, damage)| damage.depth_mm(profile, height))
                .sum();
            let p = &mut mesh.vertices[vertex as usize];
            let [nx, ny] = self.gear.flank_normal(id.tooth, id.flank, p[0].hypot(p[1]));
            p[0] -= depth * nx;
            p[1] -= depth * ny;
        }
        Ok(Arc::new(DieMesh::new(mesh)?))
    }
}

/// A line with intermediate points, so that no segment is longer than a mesh edge.
fn divided(line: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let mut points = Vec::new();
    for ends in line.windows(2) {
        let [dx, dy] = [0, 1].map(|k| ends[1][k] - ends[0][k]);
        let parts = (dx.hypot(dy) / MESH_EDGE_MM).ceil().max(1.0);
        points.extend((0..parts as u32).map(|i| {
            let share = f64::from(i) / parts;
            [ends[0][0] + share * dx, ends[0][1] + share * dy]
        }));
    }
    points.extend(line.last());
    points
}

/// Heights from end to end, closely spaced where damage is possible.
fn heights_mm([bottom, top]: [f64; 2], [low, high]: [f64; 2]) -> Vec<f64> {
    let reach = 2.0 * BEYOND_MM + MESH_EDGE_MM;
    let [from, to] = [(low - reach).max(bottom), (high + reach).min(top)];
    let parts = ((to - from) / MESH_EDGE_MM).ceil().max(1.0);
    let fine = (0..=parts as u32).map(|i| from + (to - from) * f64::from(i) / parts);
    let mut heights: Vec<f64> = std::iter::once(bottom).chain(fine).collect();
    heights.push(top);
    heights.dedup_by(|a, b| *a - *b < SAME_MM);
    heights
}
