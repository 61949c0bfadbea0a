//! Fringes that are not straight.
//!
//! Fringes appear wide on a steep face and narrow on one that faces the projector. For a known face the projector shows them denser on
//! the first and farther apart on the second (inverse fringe projection: Pösch, Vynnyk and Reithmeier, Proc. SPIE 8500, 2012). All
//! frequencies are bent alike, so phases and orders are decoded as for straight fringes; only the sheet of light that a ray is
//! intersected with is no longer that of a column.

use serde::{Deserialize, Serialize};

/// A place of the projector shows what straight fringes show `shift_px` further along.
///
/// `shown = column + shift(column, row)`, columns and rows counted at pixel centres; where fringes count rows, rows take the place of
/// columns. The shift is a uniform bicubic B-spline, twice continuously differentiable; beyond its nodes it stays as at the last.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Bend {
    /// Distance of the nodes along what the fringes count and across it, px.
    pub spacing_px: [f64; 2],
    /// Coefficients, px: one list for each node across, from one spacing before 0 on; in it one for each node along, from one spacing
    /// before 0 on.
    pub shift_px: Vec<Vec<f64>>,
}

/// The shift at a place, px, and its slope along and across.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FringeShift {
    /// Shift along, px, after which straight fringes show the same.
    pub shift_px: f64,
    /// Its change by one pixel along.
    pub along: f64,
    /// Its change by one pixel across.
    pub across: f64,
}

/// Why a bend is refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum BendError {
    /// Nodes that are no grid.
    #[error("nodes {got:?} px apart: each must be {} to {} px", SPACING_PX[0], SPACING_PX[1])]
    Spacing {
        /// As given.
        got: [f64; 2],
    },
    /// Too few nodes for a spline, or lists of different lengths.
    #[error(
        "{got} coefficients in list {list} of {lists}: every list must be as long as the first, lists and entries 4 to {MAX_NODES} each"
    )]
    Nodes {
        /// Entries.
        got: usize,
        /// Where.
        list: usize,
        /// Values given.
        lists: usize,
    },
    /// Not a number, or beyond any projector.
    #[error("a coefficient of {got} px: must be within {MAX_SHIFT_PX} px")]
    FringeShift {
        /// As given.
        got: f64,
    },
    /// Fringes would run backwards, stand still, or crowd.
    #[error(
        "fringes {got:.3} times as dense as straight ones: must be {} to {} times", DENSITY[0], DENSITY[1]
    )]
    Density {
        /// Largest or smallest that the coefficients allow.
        got: f64,
    },
    /// The projector is larger.
    #[error("nodes reach {got:.1} px {of}: the projector has {expected} px")]
    Reach {
        /// Last place that nodes stand around, px.
        got: f64,
        /// Along or across.
        of: &'static str,
        /// The projector's.
        expected: u32,
    },
}

/// Finer nodes than mirrors make no sense.
const SPACING_PX: [f64; 2] = [4.0, 1024.0];
const MAX_NODES: usize = 1024;
/// Wider than any projector.
const MAX_SHIFT_PX: f64 = 16384.0;
/// Allowed density of bent fringes relative to straight ones.
pub const DENSITY: [f64; 2] = [0.2, 5.0];

impl Bend {
    /// Looks whether it can be shown.
    ///
    /// # Errors
    /// [`BendError`].
    pub fn check(&self) -> Result<(), BendError> {
        let [least, most] = SPACING_PX;
        let bad_spacing = |px: &f64| !(*px >= least && *px <= most);
        if self.spacing_px.iter().any(bad_spacing) {
            let got = self.spacing_px;
            return Err(BendError::Spacing { got });
        }
        let lists = self.shift_px.len();
        let length = self.shift_px.first().map_or(0, Vec::len);
        for (list, of) in self.shift_px.iter().enumerate() {
            let got = of.len();
            if got != length || !(4..=MAX_NODES).contains(&got) || !(4..=MAX_NODES).contains(&lists)
            {
                return Err(BendError::Nodes { got, list, lists });
            }
        }
        if lists == 0 {
            let (got, list) = (0, 0);
            return Err(BendError::Nodes { got, list, lists });
        }
        for &got in self.shift_px.iter().flatten() {
            // Written so that a NaN fails.
            if !(got.abs() <= MAX_SHIFT_PX) {
                return Err(BendError::FringeShift { got });
            }
        }
        // The slope of a B-spline is a weighted mean of those between its coefficients.
        let slopes = self.shift_px.iter().flat_map(|list| list.windows(2));
        for pair in slopes {
            let got = 1.0 + (pair[1] - pair[0]) / self.spacing_px[0];
            if !(DENSITY[0]..=DENSITY[1]).contains(&got) {
                return Err(BendError::Density { got });
            }
        }
        Ok(())
    }

    /// Looks whether its nodes stand around all of a projector of this size along and across.
    ///
    /// # Errors
    /// [`BendError::Reach`].
    pub fn check_reach(&self, size_px: [u32; 2]) -> Result<(), BendError> {
        let nodes = [self.shift_px[0].len(), self.shift_px.len()];
        for (way, of) in ["along the fringes' count", "across it"]
            .into_iter()
            .enumerate()
        {
            let got = self.spacing_px[way] * (nodes[way] - 3) as f64;
            if got < f64::from(size_px[way]) - 1.0 {
                let expected = size_px[way];
                return Err(BendError::Reach { got, of, expected });
            }
        }
        Ok(())
    }

    /// Nodes that stand around all of a projector of this size along and across, `shift_px` of each by its place along and across.
    ///
    /// A spline with the values at its nodes for coefficients is the variation-diminishing one (Schoenberg 1967): nowhere denser or
    /// less dense than those values are from node to node.
    pub fn with_nodes(
        spacing_px: [f64; 2],
        size_px: [u32; 2],
        shift_px: impl Fn([f64; 2]) -> f64,
    ) -> Self {
        let nodes = |way: usize, size: u32| {
            let last = ((f64::from(size) - 1.0) / spacing_px[way]).ceil() as i32 + 1;
            (-1..=last).map(move |node| spacing_px[way] * f64::from(node))
        };
        let list = |across_px: f64| {
            let places = nodes(0, size_px[0]);
            places
                .map(|along_px| shift_px([along_px, across_px]))
                .collect()
        };
        Self {
            spacing_px,
            shift_px: nodes(1, size_px[1]).map(list).collect(),
        }
    }

    /// The shift at a place: along, across, px.
    #[must_use]
    pub fn at(&self, place_px: [f64; 2]) -> FringeShift {
        let nodes = [self.shift_px[0].len(), self.shift_px.len()];
        let [along, across] = [0, 1].map(|way| {
            let reach = (nodes[way] - 3) as f64;
            let at = place_px[way] / self.spacing_px[way];
            // Written so that a NaN is a place, too.
            let inside = at.max(0.0).min(reach);
            let cell = (inside.floor() as usize).min(nodes[way] - 4);
            (cell, basis(inside - cell as f64), at == inside)
        });
        let mut shift = FringeShift {
            shift_px: 0.0,
            along: 0.0,
            across: 0.0,
        };
        for (list, [value, slope]) in self.shift_px[across.0..].iter().zip(across.1) {
            let mut of_list = [0.0; 2];
            for (px, [value, slope]) in list[along.0..].iter().zip(along.1) {
                of_list[0] += value * px;
                of_list[1] += slope * px;
            }
            shift.shift_px += value * of_list[0];
            shift.along += value * of_list[1];
            shift.across += slope * of_list[0];
        }
        let slope = |slope: f64, way: usize, inside| match inside {
            true => slope / self.spacing_px[way],
            false => 0.0,
        };
        FringeShift {
            along: slope(shift.along, 0, along.2),
            across: slope(shift.across, 1, across.2),
            ..shift
        }
    }

    /// Coordinate of straight fringes, px, whose phase the bent fringes have at this place (along, across).
    #[must_use]
    pub fn shown_px(&self, place_px: [f64; 2]) -> f64 {
        place_px[0] + self.at(place_px).shift_px
    }
}

/// Values and slopes of the four cubic B-splines over a cell, at `t` of its way.
fn basis(t: f64) -> [[f64; 2]; 4] {
    let u = 1.0 - t;
    [
        [u * u * u / 6.0, -0.5 * u * u],
        [
            (3.0 * t * t * t - 6.0 * t * t + 4.0) / 6.0,
            0.5 * (3.0 * t * t - 4.0 * t),
        ],
        [
            (3.0 * u * u * u - 6.0 * u * u + 4.0) / 6.0,
            -0.5 * (3.0 * u * u - 4.0 * u),
        ],
        [t * t * t / 6.0, 0.5 * t * t],
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wavy() -> Bend {
        Bend::with_nodes([16.0, 64.0], [1024, 768], |[x, y]| {
            5.0 * (x / 40.0).sin() * (1.0 + y / 1000.0)
        })
    }

    #[test]
    fn slopes_are_those_of_the_shift() {
        let bend = wavy();
        bend.check().unwrap();
        bend.check_reach([1024, 768]).unwrap();
        for place in [[0.3, 0.0], [16.0, 64.0], [511.7, 300.2], [1022.9, 766.5]] {
            let here = bend.at(place);
            let step = 1e-5;
            for (way, slope) in [here.along, here.across].into_iter().enumerate() {
                let [mut before, mut after] = [place; 2];
                before[way] -= step;
                after[way] += step;
                let by_steps = (bend.at(after).shift_px - bend.at(before).shift_px) / (2.0 * step);
                // Beyond its nodes the shift stays.
                if place[way] > step {
                    assert!(
                        (slope - by_steps).abs() < 1e-8,
                        "{place:?}: {slope} {by_steps}"
                    );
                }
            }
        }
    }

    /// Uniform B-splines reproduce what is linear, and are never denser than from node to node.
    #[test]
    fn a_spline_is_no_denser_than_its_nodes() {
        let linear = Bend::with_nodes([16.0, 64.0], [1024, 768], |[x, y]| 0.25 * x - 0.01 * y);
        for place in [[0.0, 0.0], [100.3, 50.5], [1023.0, 767.0]] {
            let expected = 0.25 * place[0] - 0.01 * place[1];
            assert!((linear.at(place).shift_px - expected).abs() < 1e-9);
        }
        let bend = wavy();
        let between = bend.shift_px.iter().flat_map(|list| list.windows(2));
        let steepest = between.map(|pair| (pair[1] - pair[0]).abs() / 16.0);
        let steepest = steepest.fold(0.0, f64::max);
        for x in 0..10_230 {
            let slope = bend.at([0.1 * f64::from(x), 123.4]).along;
            assert!(slope.abs() <= steepest + 1e-12);
        }
    }

    #[test]
    fn what_cannot_be_shown_is_refused_by_name() {
        let refused = |change: &dyn Fn(&mut Bend)| {
            let mut bend = wavy();
            change(&mut bend);
            bend.check().unwrap_err()
        };
        let spacing = refused(&|bend| bend.spacing_px[1] = f64::NAN);
        assert!(matches!(spacing, BendError::Spacing { .. }));
        let nodes = refused(&|bend| bend.shift_px[2].truncate(7));
        assert!(matches!(
            nodes,
            BendError::Nodes {
                got: 7,
                list: 2,
                ..
            }
        ));
        let none = refused(&|bend| bend.shift_px.clear());
        assert!(matches!(none, BendError::Nodes { lists: 0, .. }));
        let shift = refused(&|bend| bend.shift_px[1][3] = f64::INFINITY);
        assert!(matches!(shift, BendError::FringeShift { .. }));
        // Fringes that run backwards.
        let density = refused(&|bend| bend.shift_px[1][3] -= 40.0);
        assert!(matches!(density, BendError::Density { .. }), "{density}");
        let reach = wavy().check_reach([768, 1024]).unwrap_err();
        assert!(
            matches!(reach, BendError::Reach { expected: 1024, .. }),
            "{reach}"
        );
    }
}
