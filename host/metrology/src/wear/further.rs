//! Joins several views of one zone, each from its own place: every cell is taken from the view that hides least of it.
//!
//! A camera that looks along a flank does not see into narrow openings; from a steeper angle it sees deeper. What a steeper view
//! shows, down to its floor, is not hidden, and the loss there is the one that this view measured, not the mean of both. Light that no
//! slope explains is evidence of openings that no point shows: it counts in whichever view it was found.

use super::ZoneView;
use super::disc::Discs;
use super::field::{Field, WearSample};
use super::unseen::{self, Unseen};

/// A zone by the best view of each cell.
pub(super) struct Joined {
    pub field: Field,
    pub samples: Vec<WearSample>,
    pub unseen: Vec<Unseen>,
}

/// Cells of one view: mean wear, and the part that was not seen.
struct Shown<'a> {
    field: Field,
    samples: &'a [WearSample],
    by_geometry: Vec<Unseen>,
    by_light: Vec<Unseen>,
}

/// Joins the views; `grid` has the zone's cells. The noise variance of `reference`'s cells is added.
pub(super) fn join(
    grid: &Field,
    views: &[ZoneView],
    reference: Option<&Field>,
    area_mm2: f64,
) -> Joined {
    let shown = views.iter().map(|view| {
        let mut field = grid.clone();
        field.average(&view.samples, reference);
        let scale = field.noise_scale();
        let discs = Discs::new(&field, &view.samples, area_mm2);
        let visibility = view.visibility.as_ref();
        Shown {
            by_geometry: unseen::by_geometry(&discs, visibility, scale),
            by_light: unseen::by_light(&discs, visibility),
            samples: &view.samples,
            field,
        }
    });
    let shown: Vec<Shown<'_>> = shown.collect();
    let best: Vec<usize> = (0..grid.wear_mm.len())
        .map(|cell| best_of(&shown, cell))
        .collect();
    let mut field = grid.clone();
    let mut unseen = Vec::with_capacity(best.len());
    for (cell, &view) in best.iter().enumerate() {
        let of = &shown[view];
        field.wear_mm[cell] = of.field.wear_mm[cell];
        field.variance_mm2[cell] = of.field.variance_mm2[cell];
        let by_light = shown.iter().map(|of| of.by_light[cell]);
        unseen.push(by_light.fold(of.by_geometry[cell], Unseen::or));
    }
    let of_best = |view: usize| {
        let (grid, best) = (&field, &best);
        let samples = shown[view].samples.iter().copied();
        samples.filter(move |sample| {
            let cell = grid.cell_at(sample.at_mm);
            cell.is_some_and(|cell| best[cell] == view)
        })
    };
    let samples = (0..shown.len()).flat_map(of_best).collect();
    Joined {
        field,
        samples,
        unseen,
    }
}

/// The view that measured a cell and hides least of it; of equal ones the first.
fn best_of(shown: &[Shown<'_>], cell: usize) -> usize {
    let mut best = 0;
    for (view, of) in shown.iter().enumerate().skip(1) {
        let measured = |of: &Shown<'_>| of.field.wear_mm[cell].is_finite();
        let hides_less = shown[best].by_geometry[cell].hides_more_than(of.by_geometry[cell]);
        if measured(of) && (!measured(&shown[best]) || hides_less) {
            best = view;
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::super::unseen::tests::{hairlines, looked_at};
    use super::super::{FlankWear, WearSettings};

    const SIZE_MM: [f64; 2] = [1.7, 3.0];
    /// Tangents of the angles between rays and normal with the tooth in the middle of the field, and at its side.
    const GRAZING: f64 = 2.9;
    const STEEP: f64 = 1.6;

    fn hidden_mm(wear: &FlankWear) -> f64 {
        let judged = wear.judged.unwrap();
        judged.hidden_mm.unwrap_or(0.0)
    }

    /// Ripple of single points in the model of the view, mm.
    const RIPPLE_MM: f64 = 1e-3;

    #[test]
    fn two_views_together_hide_less_of_a_flank_with_hairlines_than_either() {
        let settings = WearSettings::default();
        for seed in 0..12 {
            let surface = hairlines(11, [0.15, 0.3], [25e-3, 50e-3], 100 + seed);
            let main = looked_at(&surface, SIZE_MM, GRAZING, seed);
            let steep = looked_at(&surface, SIZE_MM, STEEP, 50 + seed);
            let both = main.clone().with_further(&steep, &settings);
            let [alone_mm, steep_mm, both_mm] = [&main, &steep, &both].map(hidden_mm);
            assert!(alone_mm > 0.03, "{seed}: {alone_mm}");
            assert!(
                both_mm < 0.95 * alone_mm && both_mm < steep_mm + 3.0 * RIPPLE_MM,
                "{seed}: {both_mm} of {alone_mm} and {steep_mm}"
            );
            assert!(both.coverage >= main.coverage);
        }
    }

    #[test]
    fn a_crack_that_no_view_sees_into_stays_hidden() {
        let settings = WearSettings::default();
        for (width_mm, seed) in [(0.06, 1), (0.08, 2), (0.1, 3), (0.14, 4)] {
            for along in [0, 1] {
                let from_mm = [0.8, 1.4][along];
                let crack = move |at: [f64; 2]| {
                    let inside = (from_mm..from_mm + width_mm).contains(&at[along]);
                    if inside { 0.25 } else { 0.0 }
                };
                let main = looked_at(crack, SIZE_MM, GRAZING, seed);
                let steep = looked_at(crack, SIZE_MM, STEEP, 10 + seed);
                let both = main.with_further(&steep, &settings);
                // Across the disc's middle the crack takes a strip as long as the disc is wide.
                let radius_mm = (settings.area_mm2 / std::f64::consts::PI).sqrt();
                let true_mm = 0.25 * width_mm * 1.9 * radius_mm / settings.area_mm2;
                let judged = both.judged.unwrap();
                let worst_mm = hidden_mm(&both).max(judged.wear_mm.value);
                assert!(
                    worst_mm > true_mm,
                    "{width_mm} {along}: {worst_mm} of {true_mm}"
                );
            }
        }
    }

    #[test]
    fn cells_of_the_first_view_stay_where_it_hides_nothing() {
        let settings = WearSettings::default();
        let main = looked_at(|_| 0.01, SIZE_MM, GRAZING, 1);
        let steep = looked_at(|_| 0.02, SIZE_MM, STEEP, 2);
        let both = main.clone().with_further(&steep, &settings);
        let unchanged = main
            .field
            .measured()
            .all(|cell| both.field.wear_mm[cell].to_bits() == main.field.wear_mm[cell].to_bits());
        assert!(unchanged);
    }
}
