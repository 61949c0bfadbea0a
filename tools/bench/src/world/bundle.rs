//! A fibre bundle: a disturbed hexagonal lattice of cores, each with its own transmission.

use super::WorldError;
use super::random::{Normals, Purpose, stream};
use std::f64::consts::PI;

/// Properties of a bundle and its image.
#[derive(Clone, Debug, PartialEq)]
pub struct BundleSpec {
    /// Number of cores.
    pub cores: usize,
    /// Diameter of the bundle's image, px of the camera or of the DMD.
    pub diameter_px: f64,
    /// Centre of the bundle's image, px.
    pub centre_px: [f64; 2],
    /// Rotation of the lattice relative to the pixel rows, rad.
    pub rotation_rad: f64,
    /// Standard deviation of a core's position in each direction, in core pitches.
    pub jitter_ratio: f64,
    /// Standard deviation of the core transmission.
    pub gain_spread_ratio: f64,
    /// Fraction of cores without light.
    pub dead_ratio: f64,
    /// Fraction of its light that a core loses to its six neighbours together.
    pub crosstalk_ratio: f64,
}

impl BundleSpec {
    /// Distance between neighbouring cores: a hexagonal cell has the area `√3/2 pitch²`, px.
    pub fn pitch_px(&self) -> f64 {
        self.diameter_px * (PI / (2.0 * 3f64.sqrt() * self.cores as f64)).sqrt()
    }

    fn validate(&self) -> Result<(), WorldError> {
        const CORES: [usize; 2] = [7, 2_000_000];
        if self.cores < CORES[0] || self.cores > CORES[1] {
            return Err(WorldError::Cores {
                got: self.cores,
                min: CORES[0],
                max: CORES[1],
            });
        }
        let ranges = [
            ("diameter_px", self.diameter_px, 1.0, 1e5),
            ("centre_px[0]", self.centre_px[0], -1e5, 1e5),
            ("centre_px[1]", self.centre_px[1], -1e5, 1e5),
            ("rotation_rad", self.rotation_rad, -10.0, 10.0),
            ("jitter_ratio", self.jitter_ratio, 0.0, 0.3),
            ("gain_spread_ratio", self.gain_spread_ratio, 0.0, 0.5),
            ("dead_ratio", self.dead_ratio, 0.0, 1.0),
            ("crosstalk_ratio", self.crosstalk_ratio, 0.0, 0.5),
        ];
        for (name, got, min, max) in ranges {
            WorldError::check(name, got, min, max)?;
        }
        Ok(())
    }
}

/// A bundle's cores, sorted into rows of one pitch so that a neighbourhood is a few contiguous runs.
#[derive(Clone, Debug)]
pub struct Bundle {
    spec: BundleSpec,
    positions_px: Vec<[f64; 2]>,
    gains: Vec<f32>,
    /// Lattice neighbours; the core itself replaces a neighbour beyond the rim.
    neighbours: Vec<[u32; 6]>,
    grid: Grid,
}

impl Bundle {
    /// The camera's bundle of `seed`.
    pub fn camera(spec: &BundleSpec, seed: u64) -> Result<Self, WorldError> {
        Self::drawn(spec, seed, Purpose::CameraBundle)
    }

    /// The projector's bundle of `seed`: independent of the camera's.
    pub fn projector(spec: &BundleSpec, seed: u64) -> Result<Self, WorldError> {
        Self::drawn(spec, seed, Purpose::ProjectorBundle)
    }

    fn drawn(spec: &BundleSpec, seed: u64, purpose: Purpose) -> Result<Self, WorldError> {
        spec.validate()?;
        let pitch = spec.pitch_px();
        let lattice = lattice_disc(spec.cores);
        let mut random = Normals::new(stream(seed, purpose));
        let (sin, cos) = spec.rotation_rad.sin_cos();
        let drawn: Vec<([f64; 2], f32)> = lattice
            .iter()
            .map(|&cell| {
                let [x, y] = cartesian(cell);
                let at = [0, 1].map(|axis| {
                    let turned = if axis == 0 {
                        cos * x - sin * y
                    } else {
                        sin * x + cos * y
                    };
                    spec.centre_px[axis] + pitch * (turned + spec.jitter_ratio * random.next())
                });
                // Limited to three standard deviations, so that no core amplifies or becomes dark.
                let gain = 1.0 + spec.gain_spread_ratio * random.next().clamp(-3.0, 3.0);
                let dead = random.uniform() < spec.dead_ratio;
                (at, if dead { 0.0 } else { gain.max(0.0) as f32 })
            })
            .collect();

        let positions: Vec<[f64; 2]> = drawn.iter().map(|d| d.0).collect();
        let (grid, order) = Grid::sorted(&positions, spec, pitch);
        // A table over all axial coordinates and their neighbours: each core asks for six of them.
        let side = lattice.iter().flatten().map(|i| i.abs()).max().unwrap_or(0) + 1;
        let width = 2 * side as usize + 1;
        let cell = |[i, j]: [i32; 2]| (i + side) as usize * width + (j + side) as usize;
        let mut place: Vec<Option<u32>> = vec![None; width * width];
        for (new, &old) in order.iter().enumerate() {
            place[cell(lattice[old as usize])] = Some(new as u32);
        }
        const RING: [[i32; 2]; 6] = [[1, 0], [0, 1], [-1, 1], [-1, 0], [0, -1], [1, -1]];
        let neighbours = order
            .iter()
            .enumerate()
            .map(|(new, &old)| {
                let [i, j] = lattice[old as usize];
                RING.map(|[di, dj]| place[cell([i + di, j + dj])].unwrap_or(new as u32))
            })
            .collect();
        Ok(Self {
            spec: spec.clone(),
            positions_px: order.iter().map(|&old| positions[old as usize]).collect(),
            gains: order.iter().map(|&old| drawn[old as usize].1).collect(),
            neighbours,
            grid,
        })
    }

    /// Its specification.
    pub fn spec(&self) -> &BundleSpec {
        &self.spec
    }

    /// Centre of each core, px.
    pub fn positions_px(&self) -> &[[f64; 2]] {
        &self.positions_px
    }

    /// Transmission of each core relative to the mean; 0 is a dead core.
    pub fn gains(&self) -> &[f32] {
        &self.gains
    }

    /// The six lattice neighbours of each core; the core itself replaces a neighbour beyond the rim.
    pub fn neighbours(&self) -> &[[u32; 6]] {
        &self.neighbours
    }

    /// Light per core after the exchange of crosstalk with its six neighbours.
    pub fn with_crosstalk<const N: usize>(&self, light: &[[f32; N]]) -> Vec<[f32; N]> {
        let own = 1.0 - self.spec.crosstalk_ratio as f32;
        let from_each = self.spec.crosstalk_ratio as f32 / 6.0;
        let mix = |(core, ring): (usize, &[u32; 6])| {
            std::array::from_fn(|k| {
                own * light[core][k]
                    + from_each * ring.iter().map(|&n| light[n as usize][k]).sum::<f32>()
            })
        };
        self.neighbours.iter().enumerate().map(mix).collect()
    }

    /// Runs of core indices that cover every core within `reach_px` of `at_px` (and some further away).
    pub fn near(
        &self,
        at_px: [f64; 2],
        reach_px: f64,
    ) -> impl Iterator<Item = std::ops::Range<usize>> + '_ {
        self.grid.near(at_px, reach_px)
    }
}

/// Axial coordinates of the `count` lattice points nearest to the origin.
fn lattice_disc(count: usize) -> Vec<[i32; 2]> {
    // Radius of a disc with that many cells, plus a margin for the ragged rim.
    let reach = ((count as f64 * 3f64.sqrt() / (2.0 * PI)).sqrt() + 2.0).ceil() as i32;
    let side = (f64::from(reach) * 2.0 / 3f64.sqrt()).ceil() as i32;
    let squared = |[i, j]: [i32; 2]| i * i + i * j + j * j;
    let mut cells: Vec<[i32; 2]> = (-side..=side)
        .flat_map(|i| (-side..=side).map(move |j| [i, j]))
        .filter(|&c| squared(c) <= reach * reach)
        .collect();
    cells.sort_by_key(|&c| (squared(c), c));
    cells.truncate(count);
    cells
}

/// Axial to Cartesian coordinates in pitches.
fn cartesian([i, j]: [i32; 2]) -> [f64; 2] {
    [
        f64::from(i) + 0.5 * f64::from(j),
        0.5 * 3f64.sqrt() * f64::from(j),
    ]
}

/// Square cells of one pitch over the bundle, row by row.
#[derive(Clone, Debug)]
struct Grid {
    origin_px: [f64; 2],
    cell_px: f64,
    size: [usize; 2],
    /// First core of each cell; the last entry is the total.
    starts: Vec<u32>,
}

impl Grid {
    /// The grid, and the old index of each core in the new order.
    fn sorted(positions: &[[f64; 2]], spec: &BundleSpec, cell_px: f64) -> (Self, Vec<u32>) {
        let half = 0.5 * spec.diameter_px + 4.0 * cell_px;
        let origin_px = spec.centre_px.map(|c| c - half);
        let side = (2.0 * half / cell_px).ceil() as usize;
        let mut grid = Self {
            origin_px,
            cell_px,
            size: [side, side],
            starts: Vec::new(),
        };
        let mut order: Vec<(usize, u32)> = positions
            .iter()
            .enumerate()
            .map(|(i, &p)| (grid.cell_of(p), i as u32))
            .collect();
        order.sort_unstable();
        let mut starts = vec![0u32; side * side + 1];
        for &(cell, _) in &order {
            starts[cell + 1] += 1;
        }
        for cell in 0..side * side {
            starts[cell + 1] += starts[cell];
        }
        grid.starts = starts;
        (grid, order.into_iter().map(|(_, i)| i).collect())
    }

    fn clamped(&self, value_px: f64, axis: usize) -> usize {
        let cell = ((value_px - self.origin_px[axis]) / self.cell_px).floor();
        cell.clamp(0.0, (self.size[axis] - 1) as f64) as usize
    }

    fn cell_of(&self, [x, y]: [f64; 2]) -> usize {
        self.clamped(y, 1) * self.size[0] + self.clamped(x, 0)
    }

    fn near(
        &self,
        [x, y]: [f64; 2],
        reach: f64,
    ) -> impl Iterator<Item = std::ops::Range<usize>> + '_ {
        let columns = [self.clamped(x - reach, 0), self.clamped(x + reach, 0)];
        let rows = self.clamped(y - reach, 1)..=self.clamped(y + reach, 1);
        rows.map(move |row| {
            let first = row * self.size[0];
            self.starts[first + columns[0]] as usize..self.starts[first + columns[1] + 1] as usize
        })
    }
}
