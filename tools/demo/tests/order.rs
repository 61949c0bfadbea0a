//! Bench, decoder and protocol know the order of a view's frames, and the pattern sets, each by itself: they must agree.

use flankscope_bench::world::PatternSpec;
use flankscope_profilometry::{DecodeOptions, Decoder, FrameKind, PatternSet};
use flankscope_protocol::FrameOrder;

const SETS: [&str; 5] = ["article8", "insitu12", "scan16", "high12", "high16"];

#[test]
fn the_decoder_takes_frames_in_the_order_in_which_they_are_triggered() {
    let head = flankscope_demo::head();
    for name in SETS {
        let patterns = PatternSet::named(name).unwrap();
        for exposures_us in [&[20_000][..], &[10_000, 20_000, 40_000]] {
            let options = DecodeOptions::for_head(&head);
            let decoder = Decoder::new(&head, &patterns, exposures_us, options).unwrap();
            let order = FrameOrder {
                exposures: exposures_us.len() as u16,
                patterns: patterns.frames_per_exposure() as u16,
            };
            // DMD index by set and step, as a capture plan numbers them.
            let steps = patterns.sets.iter().enumerate();
            let shown: Vec<(usize, u32)> = steps
                .flat_map(|(set, fringes)| (0..fringes.steps).map(move |step| (set, step)))
                .collect();
            let triggered: Vec<FrameKind> = (0..)
                .map_while(|index| order.place(index))
                .map(|place| match usize::from(place.pattern).checked_sub(1) {
                    None => FrameKind::Dark,
                    Some(pattern) => FrameKind::Fringe {
                        exposure: usize::from(place.exposure),
                        set: shown[pattern].0,
                        step: shown[pattern].1,
                    },
                })
                .collect();
            assert_eq!(triggered.len(), usize::from(order.frames()));
            assert_eq!(
                decoder.capture_order().collect::<Vec<_>>(),
                triggered,
                "{name}"
            );
        }
    }
}

#[test]
fn the_bench_shows_the_patterns_that_a_set_names() {
    for name in SETS {
        let sets = PatternSet::named(name).unwrap().sets;
        let expected = sets.iter().flat_map(|set| {
            (0..set.steps).map(|step| PatternSpec {
                periods: set.periods,
                step,
                steps: set.steps,
            })
        });
        assert_eq!(
            PatternSpec::named(name).unwrap(),
            expected.collect::<Vec<_>>(),
            "{name}"
        );
    }
}
