//! Cholesky factor of a symmetric matrix of 6x6 blocks: one block row per view, filled where views overlap.
//!
//! Views overlap with their neighbours alone, so in a good order every row's blocks lie near its diagonal. What lies between
//! the first of them and the diagonal (the envelope) is all that a factor fills.

use std::collections::BTreeMap;

use nalgebra::{Matrix6, SMatrix};

/// Blocks between two views (`[i, j]`: row of i, column of j), each pair once.
pub(super) type Between = BTreeMap<[usize; 2], Matrix6<f64>>;

/// The lower factor, row by row.
#[derive(Debug)]
pub(super) struct BlockCholesky {
    /// Block row of every view.
    row_of: Vec<usize>,
    rows: Vec<Row>,
}

/// Blocks of one row, from its first to the diagonal.
#[derive(Debug)]
struct Row {
    first: usize,
    blocks: Vec<Matrix6<f64>>,
}

impl Row {
    /// The blocks left of the diagonal, with their columns.
    fn left(&self) -> impl Iterator<Item = (usize, &Matrix6<f64>)> {
        let diagonal = self.blocks.len() - 1;
        (self.first..).zip(&self.blocks[..diagonal])
    }

    /// The block on the diagonal: there is always one.
    fn diagonal(&self) -> &Matrix6<f64> {
        &self.blocks[self.blocks.len() - 1]
    }

    /// The blocks between two columns.
    fn between(&self, from: usize, to: usize) -> &[Matrix6<f64>] {
        &self.blocks[from - self.first..to - self.first]
    }
}

impl BlockCholesky {
    /// Factors a matrix of its diagonal blocks and of those between two views. `order` lists the views so that neighbours are near each other. `None` unless the matrix is positive.
    pub fn new(diagonal: &[Matrix6<f64>], between: &Between, order: &[usize]) -> Option<Self> {
        let mut row_of = vec![0; diagonal.len()];
        for (row, &view) in order.iter().enumerate() {
            row_of[view] = row;
        }
        let mut rows: Vec<Row> = (0..order.len())
            .map(|row| Row {
                first: row,
                blocks: Vec::new(),
            })
            .collect();
        for [i, j] in between.keys() {
            let [low, high] = sorted([row_of[*i], row_of[*j]]);
            rows[high].first = rows[high].first.min(low);
        }
        for (at, (row, &view)) in rows.iter_mut().zip(order).enumerate() {
            row.blocks = vec![Matrix6::zeros(); at - row.first];
            row.blocks.push(diagonal[view]);
        }
        for ([i, j], block) in between {
            let [low, high] = sorted([row_of[*i], row_of[*j]]);
            let below = if row_of[*i] == high {
                *block
            } else {
                block.transpose()
            };
            let at = low - rows[high].first;
            rows[high].blocks[at] += below;
        }
        for row in 0..rows.len() {
            let (above, rest) = rows.split_at_mut(row);
            let current = rest.first_mut()?;
            factor(above, current)?;
        }
        Some(Self { row_of, rows })
    }

    /// Solves for several right sides at once, in place: six rows per view.
    pub fn solve<const C: usize>(&self, sides: &mut [SMatrix<f64, 6, C>]) {
        let mut x = vec![SMatrix::<f64, 6, C>::zeros(); self.rows.len()];
        for (side, &row) in sides.iter().zip(&self.row_of) {
            x[row] = *side;
        }
        for (row, of) in self.rows.iter().enumerate() {
            let mut value = x[row];
            for (column, block) in of.left() {
                value -= block * x[column];
            }
            // The diagonal of a positive matrix's factor is never zero.
            of.diagonal().solve_lower_triangular_mut(&mut value);
            x[row] = value;
        }
        for (row, of) in self.rows.iter().enumerate().rev() {
            let mut value = x[row];
            of.diagonal().tr_solve_lower_triangular_mut(&mut value);
            x[row] = value;
            for (column, block) in of.left() {
                x[column] -= block.transpose() * value;
            }
        }
        for (side, &row) in sides.iter_mut().zip(&self.row_of) {
            *side = x[row];
        }
    }
}

fn sorted([a, b]: [usize; 2]) -> [usize; 2] {
    [a.min(b), a.max(b)]
}

/// Replaces a row of the matrix by that of its factor, the rows above being factored.
fn factor(above: &[Row], current: &mut Row) -> Option<()> {
    let first = current.first;
    for (column, other) in (first..).zip(&above[first..]) {
        let from = first.max(other.first);
        let mut block = current.blocks[column - first];
        let shared = other.between(from, column);
        for (here, there) in current.between(from, column).iter().zip(shared) {
            block -= here * there.transpose();
        }
        // L_ij L_jjᵀ = block.
        let mut turned = block.transpose();
        other.diagonal().solve_lower_triangular_mut(&mut turned);
        current.blocks[column - first] = turned.transpose();
    }
    let mut diagonal = *current.diagonal();
    for (_, block) in current.left() {
        diagonal -= block * block.transpose();
    }
    *current.blocks.last_mut()? = diagonal.cholesky()?.l();
    Some(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use flankscope_foundation::random::uniform;
    use nalgebra::{DMatrix, Vector6};

    const VIEWS: usize = 9;

    /// A ring of views, each tied to the next two; not in the order of the ring.
    fn ring() -> (Vec<Matrix6<f64>>, Between) {
        let noise = |seed: u64| Matrix6::from_fn(|i, j| uniform(seed, (6 * i + j) as u64) - 0.5);
        let diagonal = (0..VIEWS as u64)
            .map(|view| {
                let some = noise(view);
                some * some.transpose() + Matrix6::identity() * 9.0
            })
            .collect();
        let between = (0..VIEWS)
            .flat_map(|i| [1, 2].map(|step| [i, (i + step) % VIEWS]))
            .map(|[i, j]| ([i, j], noise((100 + 10 * i + j) as u64)))
            .collect();
        (diagonal, between)
    }

    #[test]
    fn a_ring_of_views_is_solved_as_by_a_full_matrix_in_any_order() {
        let (diagonal, between) = ring();
        let mut full = DMatrix::zeros(6 * VIEWS, 6 * VIEWS);
        for (view, block) in diagonal.iter().enumerate() {
            full.view_mut((6 * view, 6 * view), (6, 6)).copy_from(block);
        }
        for ([i, j], block) in &between {
            full.view_mut((6 * i, 6 * j), (6, 6)).copy_from(block);
            full.view_mut((6 * j, 6 * i), (6, 6))
                .copy_from(&block.transpose());
        }
        let right: Vec<Vector6<f64>> = (0..VIEWS as u64)
            .map(|view| Vector6::from_fn(|i, _| uniform(77 + view, i as u64)))
            .collect();
        let stacked = DMatrix::from_fn(6 * VIEWS, 1, |i, _| right[i / 6][i % 6]);
        let expected = full.cholesky().unwrap().solve(&stacked);
        for order in [
            [0, 1, 2, 3, 4, 5, 6, 7, 8],
            [0, 8, 1, 7, 2, 6, 3, 5, 4],
            [4, 2, 7, 0, 8, 1, 6, 3, 5],
        ] {
            let mut found = right.clone();
            BlockCholesky::new(&diagonal, &between, &order)
                .unwrap()
                .solve(&mut found);
            for (i, expected) in expected.iter().enumerate() {
                let got = found[i / 6][i % 6];
                assert!(
                    (got - expected).abs() < 1e-12,
                    "{order:?}: {got}, {expected}"
                );
            }
        }
    }

    #[test]
    fn a_matrix_that_is_not_positive_has_no_factor() {
        let (mut diagonal, between) = ring();
        diagonal[3] = -diagonal[3];
        let order: Vec<usize> = (0..VIEWS).collect();
        assert!(BlockCholesky::new(&diagonal, &between, &order).is_none());
    }
}
