//! The report of a scan: the unrolled map, its views, histograms, and the estimated errors of die, head and stages.

use std::fmt::Write as _;

use askama::Template;
use flankscope_foundation::order::quantile;
use flankscope_metrology::deviation::Statistics;
use flankscope_metrology::multiview::cylinder::Cell;
use flankscope_metrology::verdict::Word;

use super::plot::{Axes, Scale, Series, binned};
use super::{Fact, bars, chart, colour, facts, figure, limits_um, ring};
use flankscope_record::document::scan::{
    Adjustment, Metrics, OppositeTeeth, Scan, ScanRegistration, StageErrors, percent,
};
use flankscope_record::document::{Feature, ViewStatus};

/// Smallest full scale of the pictures, µm.
const LEAST_FULL_UM: f64 = 20.0;
/// Width of the wide pictures, px.
const WIDE: f64 = 1150.0;
/// Number of flanks in the table, those with the largest loss.
const WORST_FLANKS: usize = 10;
/// Number of distances across the bore in the table, those with the largest deviation.
const WORST_SPACINGS: usize = 6;
/// Colour of a line without a verdict.
const LINE: &str = "#2b6cb0";

#[derive(Template)]
#[template(path = "scan.html")]
struct Page<'a> {
    scan: &'a Scan,
    simulated: bool,
    facts: Vec<Fact>,
    percent: String,
    registered: usize,
    summary: Vec<Fact>,
    ring: Option<String>,
    bars: String,
    deviation: String,
    colour_bar: String,
    rms_picture: String,
    rms_bar: String,
    rms_lines: Vec<String>,
    histograms: Vec<Histogram>,
    joint: Option<Joint<'a>>,
    coverage: String,
    coverage_bar: String,
    quality: Option<Quality>,
    worst: Vec<&'a Feature>,
    spacing: Vec<&'a OppositeTeeth>,
    lost: Vec<(usize, &'a str)>,
}

/// Estimated errors of die, head and stages, with pictures.
struct Joint<'a> {
    adjustment: &'a Adjustment,
    axis: String,
    harmonics: String,
    /// Residual of the views' angles after the harmonics, root mean square, millidegrees, and the number of views.
    residual: Option<(f64, usize)>,
}

/// Calibration error over the field of view: a picture, and its largest value, µm.
struct Quality {
    picture: String,
    bar: String,
}

/// A histogram with its caption.
struct Histogram {
    name: String,
    svg: String,
    caption: String,
}

/// Writes the page of a scan.
///
/// # Errors
/// Errors of the template engine; none occur when formatting to memory.
pub fn scan_html(scan: &Scan) -> Result<String, askama::Error> {
    let full_um = full_scale_um(scan);
    let most_views = scan.map.cells().map(|cell| cell.views).max().unwrap_or(0);
    let lost = scan
        .registration
        .iter()
        .filter(|r| r.status != ViewStatus::Registered);
    let mut worst: Vec<&Feature> = scan.features.iter().collect();
    let loss = |feature: &Feature| feature.wear_um.unwrap_or(f64::NEG_INFINITY);
    worst.sort_by(|a, b| loss(b).total_cmp(&loss(a)));
    worst.truncate(WORST_FLANKS);
    let mut spacing: Vec<&OppositeTeeth> = scan.spacing.iter().collect();
    let off = |of: &OppositeTeeth| of.deviation_um.abs();
    spacing.sort_by(|a, b| off(b).total_cmp(&off(a)));
    spacing.truncate(WORST_SPACINGS);
    let limits_um = limits_um(&scan.features);
    let deviation = |cell: &Cell| colour::diverging(cell.deviation_mm * 1e3 / full_um);
    let seen =
        |cell: &Cell| colour::sequential(f64::from(cell.views) / f64::from(most_views.max(1)));
    let page = Page {
        scan,
        simulated: scan.origin.simulated,
        facts: facts_of(scan),
        percent: percent(scan.coverage_ratio),
        registered: scan.registration.len() - lost.clone().count(),
        summary: summary(scan),
        ring: scan
            .toothing
            .as_ref()
            .map(|of| ring::ring(of, &scan.features)),
        bars: bars::flanks(&scan.features, scan.coverage.of_teeth),
        deviation: of_cells(
            scan,
            "Deviation over the unrolled bore",
            Scale::Deviation(full_um),
            deviation,
        ),
        colour_bar: chart::colour_bar(full_um, limits_um),
        rms_picture: rms_picture(scan),
        rms_bar: chart::amount_bar(rms_full_um(scan), "RMS of a view / µm"),
        rms_lines: rms_lines(scan),
        histograms: histograms(scan, full_um),
        joint: scan
            .adjustment
            .as_ref()
            .map(|adjustment| joint(scan, adjustment)),
        coverage: of_cells(
            scan,
            "Views of every cell",
            Scale::Amount(most_views.max(1).into()),
            seen,
        ),
        coverage_bar: chart::amount_bar(most_views.max(1).into(), "views of a cell"),
        quality: quality(scan),
        worst,
        spacing,
        lost: lost
            .map(|r| (r.view, r.reason.as_deref().unwrap_or("not captured")))
            .collect(),
    };
    page.render()
}

/// The main results, each with its expanded uncertainty.
fn summary(scan: &Scan) -> Vec<Fact> {
    let plus_minus =
        |value: f64, u95: Option<f64>| format!("{} ± {} µm", figure(Some(value)), figure(u95));
    let mut found = Vec::new();
    if let Some(worst) = ring::deepest(&scan.features) {
        found.push(("most lost", ring::in_words(worst)));
    }
    let flanks = scan.features.len();
    let go = scan
        .features
        .iter()
        .filter(|f| f.verdict == Word::Go)
        .count();
    found.push(("flanks", format!("{go} of {flanks} go")));
    if let Some(form) = &scan.form {
        let at = format!(", largest radius at {:.0}°", form.ovality_deg);
        found.push((
            "ovality",
            plus_minus(form.ovality_um, form.ovality_u95_um) + &at,
        ));
        found.push((
            "taper",
            plus_minus(form.taper_um, form.taper_u95_um) + " over the height",
        ));
    }
    found
}

fn joint<'a>(scan: &Scan, adjustment: &'a Adjustment) -> Joint<'a> {
    let left = scan
        .registration
        .iter()
        .filter_map(|r| r.residual_turn_mdeg);
    let (sum, count) = left.fold((0.0, 0_usize), |(sum, count), mdeg| {
        (sum + mdeg * mdeg, count + 1)
    });
    Joint {
        adjustment,
        axis: axis(&adjustment.found),
        harmonics: harmonics(scan, &adjustment.found),
        residual: (count > 0).then(|| ((sum / count as f64).sqrt(), count)),
    }
}

/// Entries below the title of a scan.
pub(super) fn facts_of(scan: &Scan) -> Vec<Fact> {
    facts(
        &scan.date,
        &scan.tool,
        "in no history, as all scans".into(),
        None,
        &scan.origin,
    )
}

/// Half of the pictures' range: contains 99 of 100 cells and the stop limits, rounded.
pub(super) fn full_scale_um(scan: &Scan) -> f64 {
    let mut sizes: Vec<f64> = scan
        .map
        .cells()
        .map(|cell| (cell.deviation_mm * 1e3).abs())
        .collect();
    // The stop limit must lie below the end of the scale.
    let limits = scan.features.iter().map(|f| 1.2 * f.limit_um);
    let size = limits.fold(quantile(&mut sizes, 0.99).unwrap_or(0.0), f64::max);
    (size / 10.0).ceil().max(LEAST_FULL_UM / 10.0) * 10.0
}

/// The unrolled bore with axes, one pixel per cell.
fn of_cells(
    scan: &Scan,
    title: &str,
    scale: Scale,
    colour_of: impl Fn(&Cell) -> [u8; 3],
) -> String {
    let columns = scan.map.layout().columns;
    let of = |index: usize| scan.map.cell(index / columns, index % columns);
    unrolled(scan, title, scale, |index| {
        of(index).map(|cell| colour_of(&cell))
    })
}

fn unrolled(
    scan: &Scan,
    title: &str,
    scale: Scale,
    colour_of: impl Fn(usize) -> Option<[u8; 3]>,
) -> String {
    let layout = scan.map.layout();
    let pixels: Vec<[u8; 3]> = (0..layout.rows)
        .rev()
        .flat_map(|row| (0..layout.columns).map(move |column| row * layout.columns + column))
        .map(|index| {
            let [column, row] = [index % layout.columns, index / layout.columns];
            colour_of(index).unwrap_or_else(|| colour::unmeasured(column, row))
        })
        .collect();
    let picture = colour::rgb_data_uri(layout.columns, layout.rows, &pixels);
    Axes {
        title,
        size: [WIDE, 260.0],
        x: ([-180.0, 180.0], "angle in the die / °"),
        y: (layout.height_mm, "height / mm"),
    }
    .draw(&[Series::Picture(picture, scale)])
}

/// A value over the angle in the die, in order.
type OverAngle = Vec<(f64, Option<f64>)>;

/// Layers from the bottom: height, and the RMS of their views.
fn layers(scan: &Scan) -> Vec<(f64, OverAngle)> {
    let mut heights: Vec<f64> = scan.registration.iter().map(|r| r.vertical_mm).collect();
    heights.sort_by(f64::total_cmp);
    heights.dedup();
    let of_layer = |height: f64| {
        let mut layer: OverAngle = scan
            .registration
            .iter()
            .filter(|r| r.vertical_mm == height)
            // The die turns by the commanded angle, so relative to it the head turns in the opposite direction.
            .map(|r| (-r.rotation_deg, r.rms_about_form_um.or(r.rms_um)))
            .collect();
        layer.sort_by(|a, b| a.0.total_cmp(&b.0));
        (height, layer)
    };
    heights.into_iter().map(of_layer).collect()
}

/// Upper end of the RMS scale, µm.
fn rms_full_um(scan: &Scan) -> f64 {
    let of_view = |r: &ScanRegistration| r.rms_about_form_um.or(r.rms_um);
    let most = scan.registration.iter().filter_map(of_view);
    (most.fold(1.0, f64::max) / 5.0).ceil() * 5.0
}

/// Tooltip of a view.
fn said(height_mm: f64, angle_deg: f64, rms_um: Option<f64>) -> String {
    let rms = rms_um.map_or_else(|| "lost".into(), |um| format!("{um:.1} µm"));
    format!("{angle_deg:.1}°, {height_mm:.1} mm: {rms}")
}

/// RMS distance of every view by layer and position: one cell per view.
fn rms_picture(scan: &Scan) -> String {
    let layers = layers(scan);
    let full_um = rms_full_um(scan);
    let columns = layers.first().map_or(1, |(_, layer)| layer.len()).max(1);
    let views = layers
        .iter()
        .rev()
        .flat_map(|(height, layer)| layer.iter().map(move |view| (*height, *view)));
    let cells: Vec<([u8; 3], String)> = views
        .enumerate()
        .map(|(place, (height, (angle, rms)))| {
            let colour = match rms {
                Some(um) => colour::sequential(um / full_um),
                None => colour::unmeasured(place % columns, place / columns),
            };
            (colour, said(height, angle, rms))
        })
        .collect();
    let rows = cells.len().div_ceil(columns);
    Axes {
        title: "RMS of every view about the form, by layer and position",
        size: [WIDE, 56.0 + (18.0 * rows as f64).max(70.0)],
        x: ([-180.0, 180.0], "angle in the die / °"),
        y: (scan.map.layout().height_mm, "height / mm"),
    }
    .draw(&[Series::Cells(columns, &cells)])
}

/// A small chart per layer, from the top: RMS of its views over the angle, with a common scale.
fn rms_lines(scan: &Scan) -> Vec<String> {
    let full_um = rms_full_um(scan);
    let chart = |(height, points): &(f64, OverAngle)| {
        let dots: Vec<(f64, f64, String, String)> = points
            .iter()
            .filter_map(|&(angle, rms)| Some((angle, rms?, LINE.into(), said(*height, angle, rms))))
            .collect();
        Axes {
            title: &format!("RMS of the views at {height:.1} mm over the angle"),
            size: [370.0, 130.0],
            x: ([-180.0, 180.0], &format!("angle / °, at {height:.1} mm")),
            y: ([0.0, full_um], "RMS / µm"),
        }
        .draw(&[Series::Line(points, LINE.into()), Series::Named(&dots)])
    };
    layers(scan).iter().rev().map(chart).collect()
}

/// One view and the merged map in both metrics; the merged map alone if the metrics were not computed.
fn histograms(scan: &Scan, full_um: f64) -> Vec<Histogram> {
    let Some(metrics) = &scan.metrics else {
        let merged: Vec<f64> = scan.map.cells().map(|c| c.deviation_mm * 1e3).collect();
        return vec![signed("merged, exact".into(), &merged, full_um, None)];
    };
    let Metrics {
        view,
        one_view,
        merged,
        ..
    } = metrics;
    let nearest_um = merged
        .nearest
        .map_or(200.0, |s| 1e3 * (s.mean_mm + 3.5 * s.std_mm));
    vec![
        signed(
            format!("view {view}, exact distance to the surface"),
            &one_view.exact_um,
            full_um,
            one_view.exact,
        ),
        signed(
            "merged, exact distance to the surface".into(),
            &merged.exact_um,
            full_um,
            merged.exact,
        ),
        unsigned(
            format!("view {view}, distance to the nearest random point on the CAD"),
            &one_view.nearest_um,
            nearest_um,
            one_view.nearest,
        ),
        unsigned(
            "merged, distance to the nearest random point on the CAD".into(),
            &merged.nearest_um,
            nearest_um,
            merged.nearest,
        ),
    ]
}

fn signed(name: String, um: &[f64], full_um: f64, of: Option<Statistics>) -> Histogram {
    let tint = |centre: f64| colour::diverging(centre / full_um);
    histogram(name, um, [-full_um, full_um], of, &tint)
}

fn unsigned(name: String, um: &[f64], full_um: f64, of: Option<Statistics>) -> Histogram {
    histogram(name, um, [0.0, full_um], of, &|_| [120, 140, 165])
}

fn histogram(
    name: String,
    um: &[f64],
    range: [f64; 2],
    of: Option<Statistics>,
    colour_of: &dyn Fn(f64) -> [u8; 3],
) -> Histogram {
    const BINS: usize = 60;
    let (counts, beyond) = binned(um, range, BINS);
    let total = um.len().max(1) as f64;
    let width = (range[1] - range[0]) / BINS as f64;
    let bars: Vec<(f64, String)> = counts
        .iter()
        .enumerate()
        .map(|(bin, count)| {
            let [r, g, b] = colour_of(range[0] + (bin as f64 + 0.5) * width);
            (100.0 * count / total, format!("rgb({r},{g},{b})"))
        })
        .collect();
    let most = bars.iter().map(|(share, _)| *share).fold(0.1, f64::max);
    let svg = Axes {
        title: &name,
        size: [0.48 * WIDE, 200.0],
        x: (range, "µm"),
        y: ([0.0, 1.05 * most], "points / %"),
    }
    .draw(&[Series::Bars(&bars)]);
    let mut caption = of.map_or(String::new(), |s| {
        format!(
            "{:.1} ± {:.1} µm, {} points",
            s.mean_mm * 1e3 + 0.0,
            s.std_mm * 1e3,
            s.count
        )
    });
    if beyond > 0 {
        let _ = write!(caption, ", {beyond} beyond the axis");
    }
    Histogram { name, svg, caption }
}

/// Position of the rotation axis in the die, from its lower to its upper end, seen from above.
fn axis(found: &StageErrors) -> String {
    let ends = found.axis_mm;
    let reach = ends.iter().flatten().fold(0.05_f64, |r, c| r.max(c.abs())) * 1.25;
    let line: OverAngle = ends.iter().map(|[x, y]| (*x, Some(*y))).collect();
    let point = |[x, y]: [f64; 2]| [(x, y)];
    let (lower, upper) = (point(ends[0]), point(ends[1]));
    Axes {
        title: "Rotation axis in the die",
        size: [380.0, 300.0],
        x: ([-reach, reach], "x in the die / mm"),
        y: ([-reach, reach], "y in the die / mm"),
    }
    .draw(&[
        Series::Dots(&[(0.0, 0.0)], "var(--muted)".into()),
        Series::Line(&line, "var(--no-go)".into()),
        Series::Dots(&lower, "var(--ink)".into()),
        Series::Dots(&upper, "var(--no-go)".into()),
    ])
}

/// The encoder's error over a revolution: its harmonics as a line, and the value of every view.
fn harmonics(scan: &Scan, found: &StageErrors) -> String {
    let pairs = found.harmonics_mdeg;
    let error_mdeg = |deg: f64| -> f64 {
        (1_u8..)
            .zip(pairs)
            .map(|(order, [cosine, sine])| {
                let (sin, cos) = (f64::from(order) * deg.to_radians()).sin_cos();
                cosine * cos + sine * sin
            })
            .sum()
    };
    let line: OverAngle = (-180..=180)
        .step_by(2)
        .map(|deg| (f64::from(deg), Some(error_mdeg(f64::from(deg)))))
        .collect();
    let views: Vec<(f64, f64)> = scan
        .registration
        .iter()
        .filter_map(|r| {
            let at = r.rotation_deg;
            Some((at, error_mdeg(at) + r.residual_turn_mdeg?))
        })
        .collect();
    let most = views
        .iter()
        .map(|(_, error)| error.abs())
        .fold(5.0, f64::max)
        * 1.1;
    Axes {
        title: "Error of the rotary encoder",
        size: [WIDE - 400.0, 300.0],
        x: ([-180.0, 180.0], "commanded angle / °"),
        y: ([-most, most], "encoder error / millidegrees"),
    }
    .draw(&[
        Series::Dots(&views, "#7a93b8".into()),
        Series::Line(&line, "var(--no-go)".into()),
    ])
}

/// Estimated calibration error over the field of view; `None` without overlapping views.
fn quality(scan: &Scan) -> Option<Quality> {
    let sigma_um: Vec<Option<f64>> = scan
        .quality
        .sigma_mm()
        .map(|sigma| sigma.map(|mm| mm * 1e3))
        .collect();
    let worst_um = sigma_um.iter().flatten().copied().reduce(f64::max)?;
    let side = scan.quality.side();
    let pixels: Vec<[u8; 3]> = sigma_um
        .iter()
        .enumerate()
        .map(|(place, um)| match um {
            Some(um) => colour::sequential(um / worst_um.max(1.0)),
            None => colour::unmeasured(place % side, place / side),
        })
        .collect();
    Some(Quality {
        picture: colour::rgb_data_uri(side, side, &pixels),
        bar: chart::amount_bar(worst_um.max(1.0), "standard uncertainty / µm"),
    })
}
