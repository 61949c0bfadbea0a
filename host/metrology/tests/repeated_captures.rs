//! A flank measured several times: independent noise averages, what is the same in every capture stays.

mod support;

use flankscope_metrology::gear::Flank;
use flankscope_metrology::wear::{Budget, Field, FlankWear, Settings};
use support::Random;

const COLUMNS: usize = 8;
const ROWS: usize = 32;
const NOISE_MM: f64 = 1e-3;

/// A flank that lost 30 µm, with `pattern` in every capture of it and noise of its own.
fn capture(pattern: &[f64], seed: u64) -> FlankWear {
    let mut random = Random::new(seed);
    let cells = COLUMNS * ROWS;
    FlankWear {
        tooth: 40,
        flank: Flank::Left,
        wear_mm: f64::NAN,
        u_mm: f64::NAN,
        mean_mm: f64::NAN,
        figures: None,
        tip_radius_mm: None,
        coverage: 1.0,
        points: 10 * cells,
        budget: Budget {
            registration_mm: seed as f64 * 1e-4,
            calibration_mm: 5e-4,
            ..Budget::default()
        },
        leakage: None,
        shared_mm: 0.0,
        field: Field {
            columns: COLUMNS,
            rows: ROWS,
            cell_mm: [0.25, 0.25],
            wear_mm: (0..cells)
                .map(|cell| 0.030 + pattern[cell] + NOISE_MM * random.normal())
                .collect(),
            variance_mm2: vec![NOISE_MM * NOISE_MM; cells],
        },
    }
}

/// Noise of the mean loss from one, two and four captures with a fixed pattern of a standard deviation.
fn noise_of(pattern_mm: f64) -> [f64; 3] {
    let mut random = Random::new(99);
    let pattern: Vec<f64> = (0..COLUMNS * ROWS)
        .map(|_| pattern_mm * random.normal())
        .collect();
    let captures: Vec<FlankWear> = (1..5).map(|seed| capture(&pattern, seed)).collect();
    let settings = Settings::default();
    [1, 2, 4].map(|count| {
        // The first twice is what one capture's figures are computed from.
        let of: Vec<&FlankWear> = match count {
            1 => vec![&captures[0]; 2],
            _ => captures.iter().take(count).collect(),
        };
        let together = FlankWear::together(&of, &settings).unwrap();
        assert!((together.wear_mm - 0.030).abs() < 4.0 * together.u_mm);
        let worst = if count == 1 {
            1e-4
        } else {
            count as f64 * 1e-4
        };
        assert!((together.budget.registration_mm - worst).abs() < 1e-12);
        together.figures.unwrap().mean_mm.u
    })
}

#[test]
fn noise_falls_with_the_root_of_the_captures_and_a_fixed_pattern_does_not() {
    // The scatter of 256 cells is known to about 8 %.
    let [_, two, four] = noise_of(0.0);
    assert!((four / two - 0.5_f64.sqrt()).abs() < 0.15, "{two} {four}");
    let [one, two, four] = noise_of(5e-3);
    assert!(
        (two / one - 1.0).abs() < 0.1 && (four / one - 1.0).abs() < 0.1,
        "{one} {two} {four}"
    );
}

#[test]
fn one_capture_stays_as_it_is_and_none_is_none() {
    let captured = capture(&[0.0; COLUMNS * ROWS], 1);
    let settings = Settings::default();
    let same = FlankWear::together(&[&captured], &settings).unwrap();
    assert_eq!(same.field, captured.field);
    assert!(FlankWear::together(&[], &settings).is_none());
}
