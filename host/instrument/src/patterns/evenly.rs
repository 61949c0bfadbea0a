//! Fringes bent so that they are evenly wide on the flanks: where there are how many of them, by drawing and pose.
//!
//! Straight fringes are wide on a face that turns away from the projector and crowd on lands, which nobody measures. Here every row of
//! mirrors shares its fringes out: on flanks in proportion to how wide one column is there, at most `densest` times as many as straight
//! ones, and what is left over on lands, faces and nothing. Where stripes cross the teeth, as those of this instrument do along a
//! spur gear's axis, a row lies wholly on one face, and what is evened out is perspective. The pose is known to a tenth of a millimetre only, and
//! need not be better: how fringes are bent is known to every mirror, whatever they fall on.

use flankscope_profilometry::Bend;
use flankscope_profilometry::bend::DENSITY;
use flankscope_profilometry::head::HeadModel;
use serde::Serialize;

use super::passes::{Passes, PassesError};

/// Distance of a bend's nodes along rows and columns of mirrors, px: finer than a flank, coarser than a block.
const SPACING_PX: [f64; 2] = [16.0, 64.0];
/// What is not measured keeps so many fringes at least, in those of straight ones: views are laid on it.
const REST_DENSITY: f64 = 0.4;
/// Contrast of a head that does not say its own.
const USUAL_CONTRAST: f64 = 0.8;
/// Of the widest columns this part may be wider on a flank than fringes are dense: edges of the view.
const WIDEST_RATIO: f64 = 0.95;

/// How dense fringes are best: twice the frequency halves what a phase's noise does to a depth, and costs the contrast that a
/// Gaussian blur leaves. With contrast C of straight fringes the product is best at `1 / sqrt(-2 ln C)` times as many.
#[must_use]
pub fn best_density(head: &HeadModel) -> f64 {
    best_of_contrast(head.fringe_contrast.unwrap_or(USUAL_CONTRAST))
}

fn best_of_contrast(contrast: f64) -> f64 {
    let best = 1.0 / (-2.0 * contrast.min(1.0).ln()).sqrt();
    best.clamp(1.0, DENSITY[1])
}

/// How wide the finest fringes are on the flanks of a view, all but a twentieth at either end: narrowest and widest, mm.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct FringeWidths {
    /// As they are shown.
    pub shown_mm: [f64; 2],
    /// As straight ones would be.
    pub straight_mm: [f64; 2],
}

impl Passes {
    /// Fringes that count columns, evenly wide on the flanks of these passes and at most `densest` times as dense as straight ones.
    ///
    /// # Errors
    /// [`PassesError::Density`].
    pub fn bend(&self, densest: f64) -> Result<Bend, PassesError> {
        if !(1.0..=DENSITY[1]).contains(&densest) {
            return Err(PassesError::Density { got: densest });
        }
        let mirrors = self.mirrors();
        let ([columns, rows], side) = self.blocks();
        let columns_mm = self.flank_columns_mm();
        let mut widths: Vec<f64> = columns_mm.iter().copied().flatten().collect();
        widths.sort_by(f64::total_cmp);
        let widest = at_ratio(&widths, WIDEST_RATIO).unwrap_or(1.0);
        let wanted = |width: f64| (densest * width / widest).clamp(REST_DENSITY, densest);
        // Of every row of blocks, by how much fringes are ahead of straight ones at each block's left edge, px.
        let ahead: Vec<Vec<f64>> = columns_mm
            .chunks(columns)
            .map(|row| {
                let row: Vec<Option<f64>> = row.iter().map(|width| width.map(wanted)).collect();
                ahead_px(&row, f64::from(side))
            })
            .collect();
        let shift_px = |[along_px, across_px]: [f64; 2]| {
            let block = ((along_px + 0.5) / f64::from(side)).clamp(0.0, columns as f64);
            let before = (block as usize).min(columns - 1);
            let share = block - before as f64;
            // The mean of the rows about a node.
            let reach = 0.5 * SPACING_PX[1];
            let near = |edge_px: f64| {
                let row = (edge_px + 0.5) / f64::from(side);
                (row.max(0.0) as usize).min(rows - 1)
            };
            let about = &ahead[near(across_px - reach)..=near(across_px + reach)];
            let of_row = |row: &Vec<f64>| (1.0 - share) * row[before] + share * row[before + 1];
            about.iter().map(of_row).sum::<f64>() / about.len() as f64
        };
        let size_px = [mirrors.columns, mirrors.rows];
        Ok(Bend::with_nodes(SPACING_PX, size_px, shift_px))
    }

    /// How wide fringes of so many periods are on the flanks, bent and straight; none where no flank is lit.
    #[must_use]
    pub fn fringe_widths(&self, periods: f64, bend: Option<&Bend>) -> Option<FringeWidths> {
        let ([columns, _], side) = self.blocks();
        let straight_px = f64::from(self.mirrors().columns) / periods;
        let middle = |at: usize| f64::from(side) * (at as f64 + 0.5) - 0.5;
        let density = |block: usize| {
            let place = [middle(block % columns), middle(block / columns)];
            bend.map_or(1.0, |bend| 1.0 + bend.at(place).along)
        };
        let columns_mm = self.flank_columns_mm();
        let flanks = columns_mm.into_iter().enumerate();
        let (mut shown, mut straight): (Vec<f64>, Vec<f64>) = flanks
            .filter_map(|(block, width)| {
                let straight = straight_px * width?;
                Some((straight / density(block), straight))
            })
            .unzip();
        let range = |widths: &mut Vec<f64>| {
            widths.sort_by(f64::total_cmp);
            Some([at_ratio(widths, 0.05)?, at_ratio(widths, 0.95)?])
        };
        Some(FringeWidths {
            shown_mm: range(&mut shown)?,
            straight_mm: range(&mut straight)?,
        })
    }
}

/// The value below which this part of sorted ones lies.
fn at_ratio(sorted: &[f64], ratio: f64) -> Option<f64> {
    sorted.get((ratio * sorted.len() as f64) as usize).copied()
}

/// Shares the fringes of a row out: blocks of `side` mirrors with a density wanted have it, the others what is left over; by how much
/// that is ahead of straight fringes at the left edge of every block, and at the right edge of the last, px.
fn ahead_px(wanted: &[Option<f64>], side: f64) -> Vec<f64> {
    let blocks = wanted.len() as f64;
    let sum: f64 = wanted.iter().flatten().sum();
    let rest = wanted.iter().filter(|density| density.is_none()).count() as f64;
    // Where flanks want more than there is, all get less.
    let kept = match rest > 0.0 {
        true => ((blocks - REST_DENSITY * rest) / sum).min(1.0),
        false => blocks / sum,
    };
    let of_rest = match sum > 0.0 {
        true => (blocks - kept * sum) / rest,
        false => 1.0,
    };
    let mut ahead = 0.0;
    let mut all = vec![ahead];
    for density in wanted {
        ahead += side * (density.map_or(of_rest, |density| kept * density) - 1.0);
        all.push(ahead);
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_has_as_many_fringes_bent_as_straight() {
        let flank = |density: f64| vec![Some(density); 20];
        let rest = vec![None; 60];
        for row in [
            [
                rest.clone(),
                flank(1.5),
                rest.clone(),
                flank(1.2),
                rest.clone(),
            ]
            .concat(),
            // More than there is.
            [flank(3.0), flank(3.0), vec![None; 5], flank(3.0)].concat(),
            vec![None; 256],
        ] {
            let ahead = ahead_px(&row, 4.0);
            assert_eq!(ahead.len(), row.len() + 1);
            assert!(ahead[row.len()].abs() < 1e-9, "{:?}", ahead[row.len()]);
            let mut densities = ahead.windows(2).map(|pair| 1.0 + (pair[1] - pair[0]) / 4.0);
            assert!(densities.all(|density| (REST_DENSITY - 1e-12..=3.0).contains(&density)));
        }
    }

    /// By hand: at C = exp(-1/2) straight ones are best as they are.
    #[test]
    fn the_best_density_is_that_of_a_gaussian_blur() {
        assert!((best_of_contrast((-0.5_f64).exp()) - 1.0).abs() < 1e-12);
        assert_eq!(
            best_of_contrast(0.1),
            1.0,
            "never less dense than straight ones"
        );
        // By trial, straight fringes having f = 1.
        for contrast in [0.65, 0.8, 0.95] {
            let gain = |f: f64| f * f64::powf(contrast, f * f);
            let best = best_of_contrast(contrast);
            assert!(gain(best) > gain(0.99 * best) && gain(best) > gain(1.01 * best));
        }
    }
}
