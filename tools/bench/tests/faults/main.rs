//! Every fault at every phase of a capture, in stepped time: each run ends in its declared safe state within its
//! declared time, each injection proves that it fired, and the same seed has the same trace.
//!
//! | file | holds |
//! |---|---|
//! | `promises` | the faults, and what is promised for each |
//! | `run` | one run: captures until the fault has shown and its end is reached |
//! | `frames` | what the host makes of the frames of a run |
//! | `judge` | what a run did not keep of its promise |
//!
//! `FAULT_SEEDS=50 cargo test -p flankscope-bench --test faults -- --nocapture` runs more of them.

#[path = "../common/mod.rs"]
mod common;
mod frames;
mod judge;
mod promises;
mod run;

use judge::broken;
use promises::promises;
use run::run;
use std::collections::BTreeMap;

const PHASES: u64 = 20;
/// A capture of the campaign's plan takes about this long; phases are spread over it.
const CAPTURE_MS: u64 = 3_200;

#[test]
fn every_fault_at_every_phase_ends_in_its_safe_state_in_time() {
    let seeds = std::env::var("FAULT_SEEDS")
        .ok()
        .and_then(|text| text.parse().ok())
        .unwrap_or(5u64);
    let promises = promises();
    let mut failures: BTreeMap<String, u32> = BTreeMap::new();
    let mut runs = 0;
    for promise in &promises {
        for phase in 0..PHASES {
            for seed in 0..seeds {
                runs += 1;
                let record = run(promise.injection, phase, seed);
                if let Some(what) = broken(promise, &record) {
                    println!("{:?} phase {phase} seed {seed}: {what}", promise.injection);
                    *failures
                        .entry(format!("{:?}", promise.injection))
                        .or_default() += 1;
                }
            }
        }
    }
    println!(
        "{} faults x {PHASES} phases x {seeds} seeds = {runs} runs",
        promises.len()
    );
    assert_eq!(failures, BTreeMap::new());
}

#[test]
fn the_same_seed_has_the_same_trace() {
    let mut seeds_differ = 0;
    let promises = promises();
    for promise in &promises {
        let trace = |seed| run(promise.injection, 7, seed).trace;
        let first = trace(3);
        assert_eq!(trace(3), first, "{:?}", promise.injection);
        seeds_differ += usize::from(trace(4) != first);
    }
    // A fault that waits for its occasion may show at the same time whatever the seed; most do not.
    assert!(seeds_differ > promises.len() / 3, "{seeds_differ}");
}
