//! Residual calibration error over the head's field of view, estimated from the scan itself.
//!
//! A cell that several views saw was each time at another place in the field. What the views disagree by, beyond their noise,
//! is what the calibration leaves there: distortion that the model does not describe is largest at the edge of the field. A
//! form deviation of the piece is the same in all views and cancels.

use super::{CellObservation, CylinderMap};

/// Tiles along a side of the field.
const SIDE: usize = 16;

#[derive(Debug, Clone, Copy, Default)]
struct Tile {
    /// Squared disagreement beyond what noise explains, mm².
    excess_mm2: f64,
    /// Share of each disagreement that is the observation's own: its leverage left out.
    freedom: f64,
}

/// Variance that the calibration leaves, per tile of the field of view.
#[derive(Debug, Clone)]
pub struct FieldQuality {
    slope: f64,
    tiles: Vec<Tile>,
}

impl FieldQuality {
    /// For a field that reaches from `-slope` to `slope` in x/z and y/z of the camera frame.
    pub fn new(slope: f64) -> Self {
        Self {
            slope,
            tiles: vec![Tile::default(); SIDE * SIDE],
        }
    }

    /// Tiles along a side.
    pub fn side(&self) -> usize {
        SIDE
    }

    fn tile_of(&self, [x, y, z]: [f64; 3]) -> usize {
        let place = |along: f64| {
            let share = 0.5 * (along / z / self.slope + 1.0);
            (share * SIDE as f64).clamp(0.0, (SIDE - 1) as f64) as usize
        };
        place(y) * SIDE + place(x)
    }

    /// Learns from a view what it disagrees with the others by. `camera` gives a observation's place in the camera frame, mm.
    pub fn add_view(
        &mut self,
        map: &CylinderMap,
        view: &[CellObservation],
        camera: impl Fn(&CellObservation) -> [f64; 3],
    ) {
        for observation in view {
            let Some((mean_mm, leverage)) = map.mean_and_leverage(observation) else {
                continue;
            };
            let freedom = 1.0 - leverage;
            let off_mm = f64::from(observation.deviation_mm) - mean_mm;
            let place = self.tile_of(camera(observation));
            let tile = &mut self.tiles[place];
            tile.excess_mm2 += off_mm * off_mm - freedom * observation.variance_mm2();
            tile.freedom += freedom;
        }
    }

    /// Variance that the calibration leaves at a place in the camera frame, mm²; none where nothing was learnt.
    pub fn variance_mm2(&self, place: [f64; 3]) -> f64 {
        self.tile_variance_mm2(self.tile_of(place)).unwrap_or(0.0)
    }

    /// Standard deviation of every tile, mm, row by row from the top of the image; `None` where no two views met.
    pub fn sigma_mm(&self) -> impl Iterator<Item = Option<f64>> + '_ {
        (0..self.tiles.len()).map(|tile| self.tile_variance_mm2(tile).map(f64::sqrt))
    }

    fn tile_variance_mm2(&self, tile: usize) -> Option<f64> {
        let Tile {
            excess_mm2,
            freedom,
        } = *self.tiles.get(tile)?;
        // Too few for an estimate of a variance.
        (freedom > 10.0).then(|| (excess_mm2 / freedom).max(0.0))
    }
}

#[cfg(test)]
mod tests {
    use super::super::Layout;
    use super::*;
    use flankscope_foundation::random::uniform;

    /// Nearly normal: the sum of twelve uniforms.
    fn normal(seed: u64, i: u64) -> f64 {
        (0..12).map(|k| uniform(seed, 12 * i + k)).sum::<f64>() - 6.0
    }

    #[test]
    fn what_the_edge_of_the_field_adds_is_found_there() {
        let layout = Layout {
            columns: 100,
            rows: 40,
            height_mm: [0.0, 40.0],
            around: crate::multiview::cylinder::Around::Angle,
        };
        // Every cell is seen by three views, each time at another x in the field; beyond x/z = 0.5 the calibration is 6 µm
        // off, and the noise is 2 µm everywhere.
        let (noise_mm, edge_mm) = (2e-3, 6e-3);
        let place = |observation: &CellObservation| [f64::from(observation.normal[0]), 0.0, 1.0];
        let views: Vec<Vec<CellObservation>> = (0..3_u64)
            .map(|view| {
                let cell = |cell: u64| {
                    let x = 2.0 * uniform(9, 3 * cell + view) - 1.0;
                    let sigma = if x > 0.5 {
                        f64::hypot(noise_mm, edge_mm)
                    } else {
                        noise_mm
                    };
                    let form = 0.05 * uniform(5, cell);
                    CellObservation {
                        cell: cell as u32,
                        weight: (1.0 / (noise_mm * noise_mm - 1e-6)) as f32,
                        deviation_mm: (form + sigma * normal(view + 20, cell)) as f32,
                        point: [1.0, 0.0, 0.0],
                        normal: [x as f32, 0.0, 0.0],
                    }
                };
                (0..4000).map(cell).collect()
            })
            .collect();
        let mut map = CylinderMap::new(layout);
        views.iter().for_each(|view| map.add_view(view, |_| 0.0));
        let mut quality = FieldQuality::new(1.0);
        let learn = |view: &Vec<CellObservation>| quality.add_view(&map, view, place);
        views.iter().for_each(learn);
        let sigma_um = |x: f64| 1e3 * quality.variance_mm2([x, 0.0, 1.0]).sqrt();
        // 750 cell_observations per tile: a variance to 5 %, of which the neighbours' own share takes a part.
        assert!((sigma_um(0.8) - 6.0).abs() < 1.0, "{}", sigma_um(0.8));
        assert!(sigma_um(-0.5) < 3.0, "{}", sigma_um(-0.5));
        assert_eq!(quality.variance_mm2([0.0, 0.9, 1.0]), 0.0, "nobody looked");
    }
}
