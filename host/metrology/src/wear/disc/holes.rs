//! What a disc may hide that holds cells without points, or cells that were not seen whole.

use super::Discs;
use crate::wear::unseen::Unseen;

impl Discs<'_> {
    /// The largest mean loss that any disc with unseen parts can have when holes and unseen parts lost what `of_hole` and
    /// `of_part` say of each cell, if that is more than was seen, mm; none when every disc was seen whole.
    fn with_holes(
        &self,
        of_hole: impl Fn(usize) -> f64,
        of_part: impl Fn(usize, Unseen) -> f64,
    ) -> Option<f64> {
        let (kernel, middles) = (self.kernel(), self.middles());
        let mut worst: Option<f64> = None;
        for [column, row] in middles {
            let (mut unseen, mut sum) = (0.0, 0.0);
            for &([dx, dy], share) in &kernel.0 {
                let (x, y) = (column as isize + dx, row as isize + dy);
                if !(0..self.field.columns as isize).contains(&x)
                    || !(0..self.field.rows as isize).contains(&y)
                {
                    continue;
                }
                let cell = y as usize * self.field.columns + x as usize;
                let wear = self.field.wear_mm[cell];
                if wear.is_finite() {
                    let part = self.unseen.get(cell).copied().unwrap_or_default();
                    let hidden = share * part.share;
                    unseen += hidden;
                    sum += share * wear + hidden * (of_part(cell, part) - wear).max(0.0);
                } else {
                    unseen += share;
                    sum += share * of_hole(cell);
                }
            }
            if unseen > 0.0 {
                worst = Some(worst.unwrap_or(f64::NEG_INFINITY).max(sum));
            }
        }
        worst
    }

    /// The largest mean loss that any disc can have when holes lost `depth_mm` and unseen parts of cells what is supposed of
    /// them, at most as much, mm; none when every disc was seen whole.
    pub fn hidden_mm(&self, depth_mm: f64) -> Option<f64> {
        self.with_holes(|_| depth_mm, |_, part| part.depth_mm.min(depth_mm))
    }

    /// The same when every hole is as deep as the deepest cell at its rim.
    pub fn as_rims_mm(&self) -> Option<f64> {
        let rims_mm = self.rims_mm();
        self.with_holes(|cell| rims_mm[cell], |cell, _| rims_mm[cell])
    }

    /// The same, but cells hidden by walls lost the supposed depth, at most `depth_mm`.
    pub fn behind_walls_mm(&self, depth_mm: f64) -> Option<f64> {
        let rims_mm = self.rims_mm();
        let of_part = |cell: usize, part: Unseen| match part.behind_walls {
            true => part.depth_mm.min(depth_mm),
            false => rims_mm[cell],
        };
        self.with_holes(|cell| rims_mm[cell], of_part)
    }

    /// Wear of the deepest cell around each cell, or around the hole that it lies in, mm.
    fn rims_mm(&self) -> Vec<f64> {
        let field = self.field;
        let holes = field.groups(|i| !field.wear_mm[i].is_finite());
        let mut depth = vec![0.0_f64; field.wear_mm.len()];
        for (i, depth) in depth.iter_mut().enumerate() {
            *depth = field
                .around(i)
                .map(|c| field.wear_mm[c])
                .fold(0.0, f64::max);
        }
        for hole in holes {
            let rim = hole.iter().flat_map(|&i| field.around(i));
            // f64::max passes over the cells of the hole itself.
            let deepest = rim.map(|i| field.wear_mm[i]).fold(0.0, f64::max);
            for i in hole {
                depth[i] = deepest;
            }
        }
        depth
    }
}
