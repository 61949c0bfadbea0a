//! Scattered deviations along one coordinate, smoothed as the standard asks, and what is read from them.

use serde::Serialize;

use super::across;

/// Constant of the Gaussian weighting function, which passes half of a wave of its cutoff length: sqrt(ln 2 / pi) (ISO 16610-21).
const ALPHA: f64 = 0.469_718_639_349_825_8;
/// Positions at which a trace is evaluated.
const POSITIONS: usize = 151;
/// Fewer points than this under the weighting function leave a gap.
const LEAST_POINTS: usize = 4;

/// Figures of one trace, um.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct TraceFigures {
    /// Range of the smoothed trace.
    pub total_um: f64,
    /// Range of what is left when the mean line is taken away.
    pub form_um: f64,
    /// Rise of the mean line between the limits that the standard states it for; positive towards the far end.
    pub slope_um: f64,
    /// Rise of the mean line between the ends of the usable flank (profile: control radius to tip form radius; helix: the
    /// evaluated height), um.
    pub slope_usable_um: f64,
    /// Largest standard uncertainty of the smoothed trace by how its points scatter about it; what all of them share is not in it.
    pub noise_um: f64,
    /// Points that went in.
    pub points: usize,
}

#[derive(Debug, Clone, Copy)]
pub(super) struct TracePoint {
    /// Position along the trace, mm.
    pub at: f64,
    /// Distance from the line that the trace follows on the flank, mm.
    pub across: f64,
    /// Deviation, mm.
    pub deviation: f64,
}

/// Range and filter of a trace.
#[derive(Debug, Clone, Copy)]
pub(super) struct Course {
    /// Evaluated range, mm.
    pub range: [f64; 2],
    /// Length between the limits that its slope is stated for, mm.
    pub stated_mm: f64,
    /// Length of the usable flank, mm.
    pub usable_mm: f64,
    /// Cutoff of its filter, mm.
    pub cutoff_mm: f64,
    /// Largest distance of a point from its line, mm.
    pub reach_mm: f64,
    /// Cutoff of the filter for traces across it, mm.
    pub across_cutoff_mm: f64,
}

/// Reasons for which a trace has no figures.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum TraceProblem {
    /// Too few points between two positions, mm.
    Gap([f64; 2]),
    /// Changes across the trace cannot be separated from changes along it.
    Entangled,
}

/// Fewest points under the filter.
pub(super) const LEAST: usize = LEAST_POINTS;

/// Figures of a trace. What the deviations do across it is estimated from the same points and taken away, so that points that
/// lie to one side here and to the other there leave no mark.
///
/// The smoothing is the Gaussian with linear regression (ISO 16610-31, first order), whose ends are as good as its middle.
pub(super) fn figures(
    samples: &[TracePoint],
    course: &Course,
) -> Result<TraceFigures, TraceProblem> {
    let mut points: Vec<(f64, f64)> = across::taken_away(samples, course)?;
    points.sort_by(|a, b| a.0.total_cmp(&b.0));
    let reach = ALPHA * course.cutoff_mm;
    let range = course.range;
    let position = |i: usize| range[0] + (range[1] - range[0]) * i as f64 / (POSITIONS - 1) as f64;
    let smooth: Vec<Option<Smoothed>> = (0..POSITIONS)
        .map(|i| smoothed(&points, position(i), reach))
        .collect();
    if let Some(begin) = smooth.iter().position(Option::is_none) {
        let length = smooth[begin..].iter().take_while(|s| s.is_none()).count();
        return Err(TraceProblem::Gap([
            position(begin),
            position(begin + length - 1),
        ]));
    }
    let noise_mm = smooth.iter().flatten().map(|s| s.u).fold(0.0, f64::max);
    let trace: Vec<(f64, f64)> = smooth
        .into_iter()
        .flatten()
        .enumerate()
        .map(|(i, smoothed)| (position(i), smoothed.deviation))
        .collect();
    let (mean_at, mean) = mean_of(&trace);
    let (mut along, mut rise) = (0.0, 0.0);
    for (at, deviation) in &trace {
        along += (at - mean_at).powi(2);
        rise += (at - mean_at) * (deviation - mean);
    }
    let slope = rise / along;
    let range_of = |of: &dyn Fn(&(f64, f64)) -> f64| {
        let values = || trace.iter().map(of);
        values().fold(f64::NEG_INFINITY, f64::max) - values().fold(f64::INFINITY, f64::min)
    };
    let used = points
        .iter()
        .filter(|(at, _)| (range[0]..=range[1]).contains(at));
    Ok(TraceFigures {
        total_um: 1e3 * range_of(&|point| point.1),
        form_um: 1e3 * range_of(&|point| point.1 - slope * (point.0 - mean_at)),
        slope_um: 1e3 * slope * course.stated_mm,
        slope_usable_um: 1e3 * slope * course.usable_mm,
        noise_um: 1e3 * noise_mm,
        points: used.count(),
    })
}

/// A place of the smoothed trace.
struct Smoothed {
    deviation: f64,
    /// Its standard uncertainty by the scatter of the points about the line.
    u: f64,
}

/// Value at `at` of the line fitted to the points about it, weighted by the Gaussian.
fn smoothed(points: &[(f64, f64)], at: f64, reach: f64) -> Option<Smoothed> {
    let begin = points.partition_point(|point| point.0 < at - reach);
    let end = points.partition_point(|point| point.0 <= at + reach);
    let near = &points[begin..end];
    if near.len() < LEAST_POINTS {
        return None;
    }
    let weigh = |position: f64| {
        let x = (position - at) / reach;
        (x, (-std::f64::consts::PI * x * x).exp())
    };
    let (mut s0, mut s1, mut s2, mut t0, mut t1) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for (position, deviation) in near {
        let (x, weight) = weigh(*position);
        s0 += weight;
        s1 += weight * x;
        s2 += weight * x * x;
        t0 += weight * deviation;
        t1 += weight * deviation * x;
    }
    let determinant = s0 * s2 - s1 * s1;
    // All points at one position: no line.
    if determinant <= 1e-9 * s0 * s0 {
        return None;
    }
    let deviation = (t0 * s2 - t1 * s1) / determinant;
    let slope = (t1 * s0 - t0 * s1) / determinant;
    let (mut squares, mut gains) = (0.0, 0.0);
    for (position, of_point) in near {
        let (x, weight) = weigh(*position);
        squares += (of_point - deviation - slope * x).powi(2);
        gains += (weight * (s2 - s1 * x) / determinant).powi(2);
    }
    // Two are spent on the line.
    let variance = squares / (near.len() - 2) as f64;
    Some(Smoothed {
        deviation,
        u: (variance * gains).sqrt(),
    })
}

fn mean_of(trace: &[(f64, f64)]) -> (f64, f64) {
    let n = trace.len() as f64;
    let (at, deviation) = trace
        .iter()
        .fold((0.0, 0.0), |sum, point| (sum.0 + point.0, sum.1 + point.1));
    (at / n, deviation / n)
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use flankscope_test_requisites::Random;

    use super::*;

    fn course(range: [f64; 2], stated_mm: f64, cutoff_mm: f64) -> Course {
        Course {
            range,
            stated_mm,
            usable_mm: range[1] - range[0],
            cutoff_mm,
            reach_mm: 0.5,
            across_cutoff_mm: 0.2,
        }
    }

    /// Samples on the line itself.
    fn on_line(count: u32, deviation: impl Fn(f64) -> f64) -> Vec<TracePoint> {
        (0..count)
            .map(|i| {
                let at = 1e-3 * f64::from(i);
                TracePoint {
                    at,
                    across: 0.0,
                    deviation: deviation(at),
                }
            })
            .collect()
    }

    #[test]
    fn a_line_and_a_wave_are_read_back() {
        // 10 um of slope over 6 mm and a wave of 3 um amplitude, 2 mm long.
        let deviation = |x: f64| 1e-3 * (10.0 * x / 6.0 + 3.0 * (TAU * x / 2.0).cos());
        let cutoff = 0.2;
        let got = figures(&on_line(6_001, deviation), &course([0.0, 6.0], 6.3, cutoff)).unwrap();
        // Amplitude of the wave after the filter (ISO 16610-21): exp(-pi (alpha cutoff / length)^2).
        let left = (-std::f64::consts::PI * (ALPHA * cutoff / 2.0_f64).powi(2)).exp();
        assert!((got.slope_um - 10.0 / 6.0 * 6.3).abs() < 0.02, "{got:?}");
        assert!((got.slope_usable_um - 10.0).abs() < 0.02, "{got:?}");
        assert!((got.form_um - 6.0 * left).abs() < 0.05, "{got:?}");
        assert_eq!(got.points, 6_001);
    }

    #[test]
    fn the_filter_halves_a_wave_of_its_cutoff() {
        let samples = on_line(20_000, |x| 1e-3 * (TAU * x).sin());
        // Truncated at one reach either side, where the weight is 4 %: a few percent off half.
        let got = figures(&samples, &course([5.0, 15.0], 10.0, 1.0)).unwrap();
        assert!((got.total_um - 1.0).abs() < 0.12, "{got:?}");
    }

    #[test]
    fn a_gap_is_no_trace_and_is_named() {
        let mut samples = on_line(1000, |_| 0.0);
        samples.retain(|sample| !(0.4..0.6).contains(&sample.at));
        let Err(TraceProblem::Gap([from, to])) = figures(&samples, &course([0.0, 1.0], 1.0, 0.05))
        else {
            panic!("a gap must be seen");
        };
        // Under the filter, 0.023 mm either side, lie points from beyond the gap's ends.
        assert!(
            (from - 0.42).abs() < 0.01 && (to - 0.58).abs() < 0.01,
            "{from} {to}"
        );
    }

    #[test]
    fn the_noise_of_a_smoothed_place_is_how_far_it_scatters() {
        // 2000 traces of 60 points, uneven along it, each astray by a uniform draw of 1 um standard deviation.
        let mut random = Random(1);
        let mut draw = || random.uniform() - 0.5;
        let count = 2000;
        let (mut squares, mut variance) = (0.0, 0.0);
        for _ in 0..count {
            let points: Vec<(f64, f64)> = (0..60)
                .map(|i| ((f64::from(i) / 60.0).powi(2), 12f64.sqrt() * draw()))
                .collect();
            let place = smoothed(&points, 0.4, 0.3).unwrap();
            squares += place.deviation.powi(2) / f64::from(count);
            variance += place.u.powi(2) / f64::from(count);
        }
        // The standard deviation of 2000 draws is known to 1.6 %; three times that, of squares.
        assert!(
            (squares / variance - 1.0).abs() < 0.095,
            "{squares} {variance}"
        );
    }
}
