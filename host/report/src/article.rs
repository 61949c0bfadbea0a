//! The article's figures and tables as one page, with our results for comparison.

use askama::Template;

use super::colour;
use super::plot::{Axes, Scale, Series, binned};
use super::scenes::Scenes;
use super::{Fact, chart};
use flankscope_article::{
    Alignment, Article, DrawingSteps, Left, MethodResult, Overlay, Sections, Spread,
};

/// Width of the wide pictures, px.
const WIDE: f64 = 1150.0;
/// Width of pictures that are placed side by side, px.
const HALF: f64 = 560.0;
/// Upper end of the maps' scale, µm: the article's.
const MAP_UM: f64 = 200.0;
/// Colours of lines and points.
const BLUE: &str = "#2b6cb0";
const ORANGE: &str = "#e0862b";
const GREEN: &str = "#1b7f5c";
const RED: &str = "#a3142a";

#[derive(Template)]
#[template(path = "article.html")]
struct Page<'a> {
    article: &'a Article,
    simulated: bool,
    facts: Vec<Fact>,
    rows: Vec<Row>,
    totals: DrawingSteps,
    mask: Vec<String>,
    mask_bar: String,
    threshold: String,
    alignments: Vec<Map<'a>>,
    map_bar: String,
    serial: Option<String>,
    scenes: Option<Scenes>,
    overlays: Vec<String>,
    rms: String,
    iterations: String,
    histograms: Vec<String>,
    sections: Option<Cuts>,
}

/// Cross-sections of the fringes.
struct Cuts {
    counts: String,
    spread: String,
    /// The centre of the image at every phase step, as `data:` addresses.
    crops: Vec<String>,
}

/// A value that the article reports, the result of its method here, and ours.
struct Row {
    what: &'static str,
    reported: &'static str,
    theirs: String,
    ours: String,
}

/// A method of alignment with its map.
struct Map<'a> {
    of: &'a Alignment,
    title: &'static str,
    svg: String,
}

/// Writes the page.
///
/// # Errors
/// Errors of the template engine; none occur when formatting to memory.
pub fn article_html(article: &Article) -> Result<String, askama::Error> {
    let mut facts: Vec<Fact> = vec![
        (crate::DATE, article.date.clone()),
        ("tool", article.tool.clone()),
    ];
    let named = |key: &str| article.of.get(key).cloned();
    facts.extend(named("views").map(|views| ("views", views)));
    facts.extend(named("bench").map(|bench| ("on the bench", bench)));
    facts.extend(named("recording").map(|recording| ("recording", recording)));
    let add = |sum: DrawingSteps, of: &DrawingSteps| DrawingSteps {
        view: sum.view + 1,
        measured: sum.measured + of.measured,
        masked: sum.masked + of.masked,
        denoised: sum.denoised + of.denoised,
        drawn: sum.drawn + of.drawn,
    };
    let none = DrawingSteps {
        view: 0,
        measured: 0,
        masked: 0,
        denoised: 0,
        drawn: 0,
    };
    let map = |of: &'static str| {
        article
            .alignments
            .iter()
            .find(|alignment| alignment.name == of)
    };
    let titled = [
        (
            "positions",
            "by the positions of the stages alone (figure 4a)",
        ),
        (
            "serial",
            "each view on the one before, without CAD (figure 4b)",
        ),
        (
            "article",
            "each view on the CAD, the article's way (figure 20)",
        ),
        ("surface", "all views on the CAD together: ours"),
    ];
    let page = Page {
        article,
        simulated: article.is_simulated(),
        facts,
        rows: rows(article),
        totals: article.steps.iter().fold(none, add),
        mask: mask(article),
        mask_bar: chart::amount_bar(most_dn(article), "fringes' standard deviation / counts"),
        threshold: threshold(&article.threshold, article.settings.mask_dn),
        alignments: titled
            .into_iter()
            .filter_map(|(name, title)| {
                let of = map(name)?;
                Some(Map {
                    of,
                    title,
                    svg: unrolled(article, of, title),
                })
            })
            .collect(),
        map_bar: chart::amount_bar(MAP_UM, "mean distance to the nearest reference point / µm"),
        serial: (!article.serial.is_empty()).then(|| serial(article)),
        scenes: article
            .in_space
            .as_ref()
            .map(|space| Scenes::of(space, MAP_UM)),
        overlays: article.overlays.iter().map(overlay).collect(),
        rms: rms(article, map("article")),
        iterations: iterations(article),
        histograms: histograms(article, map("article")),
        sections: article.sections.as_ref().map(cuts),
    };
    page.render()
}

fn of_method<'a>(article: &'a Article, name: &str) -> Option<&'a MethodResult> {
    article.methods.iter().find(|of| of.method == name)
}

/// Values that the article reports, with the corresponding ones here.
fn rows(article: &Article) -> Vec<Row> {
    let [ours, theirs] = ["surface", "article"].map(|name| of_method(article, name));
    let spread = |of: Option<Spread>| {
        of.map_or_else(
            || "–".into(),
            |s| format!("{:.1} ± {:.1} µm", s.mean_um + 0.0, s.std_um),
        )
    };
    let of = |result: Option<&MethodResult>, value: fn(&MethodResult) -> Option<Spread>| {
        spread(result.and_then(value))
    };
    let count = |of: Option<&MethodResult>| {
        of.map_or_else(|| "–".into(), |of| of.registered_views.to_string())
    };
    let seconds = |of: Option<&MethodResult>| {
        of.map_or_else(
            || "–".into(),
            |of| format!("{:.1} s", of.stitching_ms / 1e3),
        )
    };
    let merged = |way: &str| {
        let found = article
            .merging
            .iter()
            .find(|of| of.poses == "article" && of.way == way);
        found.map_or_else(|| "–".into(), |of| of.points.to_string())
    };
    vec![
        Row {
            what: "views laid on the CAD",
            reported: "588",
            theirs: count(theirs),
            ours: count(ours),
        },
        Row {
            what: "steps of a registration, mean",
            reported: "5",
            theirs: article
                .mean_iterations
                .map_or_else(|| "–".into(), |mean| format!("{mean:.1}")),
            ours: "all views together".into(),
        },
        Row {
            what: "distance of one view's points",
            reported: "35.6 ± 18.8 µm",
            theirs: of(theirs, |of| of.one_view),
            ours: of(ours, |of| of.one_view) + ", signed",
        },
        Row {
            what: "distance of all views' points",
            reported: "74.1 ± 37.1 µm",
            theirs: of(theirs, |of| of.merged),
            ours: of(ours, |of| of.merged) + ", signed",
        },
        Row {
            what: "points of the merged cloud",
            reported: "42.1 million",
            theirs: merged("centre of mass"),
            ours: "cells of the map, or every point".into(),
        },
        Row {
            what: "registration and merging",
            reported: "about 2 h, measuring included",
            theirs: seconds(theirs),
            ours: seconds(ours),
        },
    ]
}

fn most_dn(article: &Article) -> f64 {
    let all = article.mask.fringes_dn.iter().flatten();
    f64::from(all.copied().fold(1.0, f32::max)).ceil()
}

/// Amplitude of the fringes over a view, and the resulting mask.
fn mask(article: &Article) -> Vec<String> {
    let mask = &article.mask;
    let full = most_dn(article);
    let [columns, rows] = mask.size;
    let draw = |title: &str, colour_of: &dyn Fn(f64) -> [u8; 3]| {
        let pixels: Vec<[u8; 3]> = mask
            .fringes_dn
            .iter()
            .enumerate()
            .map(|(at, dn)| match dn {
                Some(dn) => colour_of(f64::from(*dn)),
                None => colour::unmeasured(at % columns, at / columns),
            })
            .collect();
        Axes {
            title,
            size: [420.0, 400.0],
            x: (mask.range_mm[0], "x in the camera's frame / mm"),
            y: (mask.range_mm[1], "y / mm"),
        }
        .draw(&[Series::Picture(
            colour::rgb_data_uri(columns, rows, &pixels),
            Scale::Amount(full),
        )])
    };
    let threshold = article.settings.mask_dn;
    vec![
        draw("Smoothed standard deviation of the finest fringes", &|dn| {
            colour::sequential(dn / full)
        }),
        draw("What the mask leaves", &|dn| {
            if dn >= threshold {
                [120, 160, 205]
            } else {
                [224, 134, 43]
            }
        }),
    ]
}

/// Points, cells and noise as functions of the threshold.
fn threshold(curve: &[Left], used_dn: f64) -> String {
    let Some(last) = curve.last() else {
        return String::new();
    };
    let noise_full = curve.iter().map(|of| of.noise_um).fold(1.0, f64::max);
    let line = |value: &dyn Fn(&Left) -> f64| -> OverPlaces {
        let points = curve.iter().map(|of| (of.threshold_dn, Some(value(of))));
        points.collect()
    };
    let axes = |title: &'static str, y: ([f64; 2], &'static str)| {
        move |series: &[Series<'_>]| {
            Axes {
                title,
                size: [HALF, 240.0],
                x: ([0.0, last.threshold_dn.max(1.0)], "threshold / counts"),
                y,
            }
            .draw(series)
        }
    };
    let left = axes("Share left by the threshold", ([0.0, 105.0], "left / %"))(&[
        Series::Line(&line(&|of| 100.0 * of.points_ratio), BLUE.into()),
        Series::Line(&line(&|of| 100.0 * of.cells_ratio), GREEN.into()),
        Series::Mark(used_dn, "used"),
    ]);
    let noise = axes(
        "Noise of what the threshold leaves",
        ([0.0, 1.1 * noise_full], "standard deviation / µm"),
    )(&[
        Series::Line(&line(&|of| of.noise_um), RED.into()),
        Series::Mark(used_dn, "used"),
    ]);
    format!("<figure>{left}</figure><figure>{noise}</figure>")
}

/// Map of the unrolled bore for one method of alignment.
fn unrolled(article: &Article, of: &Alignment, title: &str) -> String {
    let layout = article.layout;
    let pixels: Vec<[u8; 3]> = (0..layout.rows)
        .rev()
        .flat_map(|row| (0..layout.columns).map(move |column| (row, column)))
        .map(|(row, column)| {
            match of
                .map_um
                .get(row * layout.columns + column)
                .copied()
                .flatten()
            {
                Some(um) => colour::sequential(um / MAP_UM),
                None => colour::unmeasured(column, row),
            }
        })
        .collect();
    let picture = colour::rgb_data_uri(layout.columns, layout.rows, &pixels);
    Axes {
        title,
        size: [WIDE, 210.0],
        x: ([-180.0, 180.0], "angle in the die / °"),
        y: (layout.height_mm, "height / mm"),
    }
    .draw(&[Series::Picture(picture, Scale::Amount(MAP_UM))])
}

/// Counts along the cut, their spread, and the centres of the images.
fn cuts(of: &Sections) -> Cuts {
    let length = of.std_dn.len().max(2) as f64;
    let line = |values: &mut dyn Iterator<Item = f64>| -> OverPlaces {
        values
            .enumerate()
            .map(|(at, dn)| (at as f64, Some(dn)))
            .collect()
    };
    let most = of.counts.iter().flatten().copied().max().unwrap_or(1);
    let steps: Vec<OverPlaces> = of
        .counts
        .iter()
        .map(|counts| line(&mut counts.iter().map(|&dn| f64::from(dn))))
        .collect();
    let colours = [BLUE, RED, GREEN, ORANGE];
    let lines: Vec<Series<'_>> = steps
        .iter()
        .zip(colours.into_iter().cycle())
        .map(|(points, colour)| Series::Line(points, colour.into()))
        .collect();
    let axes = |title: &'static str, most: f64, label: &'static str| Axes {
        title,
        size: [WIDE, 240.0],
        x: ([0.0, length - 1.0], "along the cut / pixels"),
        y: ([0.0, 1.05 * most.max(1.0)], label),
    };
    let widest = of.std_dn.iter().copied().fold(1.0, f64::max);
    let (raw, smoothed) = (
        line(&mut of.std_dn.iter().copied()),
        line(&mut of.smoothed_dn.iter().copied()),
    );
    Cuts {
        counts: axes("Counts across the finest fringes", most.into(), "counts").draw(&lines),
        spread: axes(
            "Their standard deviation",
            widest,
            "standard deviation / counts",
        )
        .draw(&[
            Series::Line(&raw, "#c3ccd6".into()),
            Series::Line(&smoothed, RED.into()),
        ]),
        crops: of
            .crops
            .iter()
            .map(|crop| colour::grey_data_uri(Sections::CROP_PX, Sections::CROP_PX, crop))
            .collect(),
    }
}

/// Pose errors of serially registered views along the first layer.
fn serial(article: &Article) -> String {
    let Some(layer) = article.serial.first() else {
        return String::new();
    };
    let line = |axis: usize| -> OverPlaces {
        let off = layer.off_um.iter().enumerate();
        off.map(|(at, um)| (at as f64, Some(um[axis]))).collect()
    };
    let all = layer.off_um.iter().flatten();
    let [low, high] = all.fold([-10.0_f64, 10.0_f64], |[low, high], &um| {
        [low.min(um), high.max(um)]
    });
    Axes {
        title: "How far a view lies off when each is laid on the one before",
        size: [WIDE, 240.0],
        x: ([0.0, (layer.off_um.len().max(2) - 1) as f64], "views laid"),
        y: ([1.1 * low, 1.1 * high], "off / µm"),
    }
    .draw(&[
        Series::Line(&line(0), BLUE.into()),
        Series::Line(&line(1), RED.into()),
        Series::Line(&line(2), GREEN.into()),
    ])
}

fn overlay(of: &Overlay) -> String {
    let radii = of.reference.iter().map(|p| p[1]);
    let [low, high] = radii.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], r| {
        [low.min(r), high.max(r)]
    });
    let reference: Vec<(f64, f64)> = of.reference.iter().map(|[x, y]| (*x, *y)).collect();
    let colours = [BLUE, RED, GREEN];
    let measured: Vec<(Vec<(f64, f64)>, &str)> = of
        .measured
        .iter()
        .zip(colours.into_iter().cycle())
        .map(|((_, points), colour)| (points.iter().map(|[x, y]| (*x, *y)).collect(), colour))
        .collect();
    let mut series = vec![Series::Dots(&reference, "#f0b87c".into())];
    series.extend(
        measured
            .iter()
            .map(|(points, colour)| Series::Dots(points, (*colour).into())),
    );
    Axes {
        title: "Measured points on reference points",
        size: [WIDE, 270.0],
        x: ([-7.2, 7.2], "along the bore / mm"),
        y: ([low - 0.15, high + 0.15], "distance from the axis / mm"),
    }
    .draw(&series)
}

/// A value at every position, in order.
type OverPlaces = Vec<(f64, Option<f64>)>;

/// RMS of every view: one line per layer, lighter towards the bottom (figure 19).
fn rms(article: &Article, of: Option<&Alignment>) -> String {
    let Some(of) = of else {
        return String::new();
    };
    let [around, layers] = article.grid.map(|count| count as usize);
    let all = of.rms_um.iter().flatten();
    let [low, high] = all.fold([f64::INFINITY, 0.0_f64], |[low, high], &um| {
        [low.min(um), high.max(um)]
    });
    let lines: Vec<(OverPlaces, String)> = (0..layers)
        .map(|layer| {
            // Odd layers were captured in the opposite direction.
            let view = |place: usize| match layer % 2 {
                0 => layer * around + place,
                _ => layer * around + around - 1 - place,
            };
            let rms_um = |place: usize| of.rms_um.get(view(place)).copied().flatten();
            let points = (0..around).map(|place| (place as f64 + 1.0, rms_um(place)));
            let [r, g, b] = colour::sequential(0.35 + 0.65 * (layer + 1) as f64 / layers as f64);
            (points.collect(), format!("rgb({r},{g},{b})"))
        })
        .collect();
    let series: Vec<Series<'_>> = lines
        .iter()
        .map(|(points, colour)| Series::Line(points, colour.clone()))
        .collect();
    let margin = 0.1 * (high - low).max(1.0);
    Axes {
        title: "RMS of every registration by layer and position",
        size: [WIDE, 240.0],
        x: ([1.0, around.max(2) as f64], "radial position of the stage"),
        y: ([low - margin, high + margin], "RMS / µm"),
    }
    .draw(&series)
}

/// Number of registrations by number of iterations.
fn iterations(article: &Article) -> String {
    let most = article.settings.registration.most_iterations.clamp(1, 60);
    let theirs = of_method(article, "article");
    let steps: Vec<usize> = theirs
        .and_then(|of| of.iterations.as_ref())
        .into_iter()
        .flatten()
        .flatten()
        .copied()
        .collect();
    let bars: Vec<(f64, String)> = (1..=most)
        .map(|n| {
            let count = steps.iter().filter(|&&steps| steps == n).count();
            (count as f64, BLUE.into())
        })
        .collect();
    let highest = bars.iter().map(|(count, _)| *count).fold(1.0, f64::max);
    Axes {
        title: "Steps of the registrations",
        size: [HALF, 210.0],
        x: ([0.5, most as f64 + 0.5], "steps"),
        y: ([0.0, 1.05 * highest], "views"),
    }
    .draw(&[Series::Bars(&bars)])
}

/// Distances to the nearest reference point, of one view and of all (figure 21).
fn histograms(article: &Article, all: Option<&Alignment>) -> Vec<String> {
    const BINS: usize = 60;
    let all = all.map_or(&[][..], |of| &of.nearest_um[..]);
    [
        (
            "One view, to the points of its window",
            &article.one_view_um[..],
        ),
        ("All views, before merging", all),
    ]
    .into_iter()
    .map(|(title, um)| {
        let (counts, _) = binned(um, [0.0, MAP_UM], BINS);
        let total = um.len().max(1) as f64;
        let bars: Vec<(f64, String)> = counts
            .iter()
            .map(|count| (100.0 * count / total, ORANGE.into()))
            .collect();
        let highest = bars.iter().map(|(share, _)| *share).fold(0.1, f64::max);
        let svg = Axes {
            title,
            size: [HALF, 210.0],
            x: ([0.0, MAP_UM], "distance / µm"),
            y: ([0.0, 1.05 * highest], "points / %"),
        }
        .draw(&[Series::Bars(&bars)]);
        format!("<figure><figcaption><b>{title}</b></figcaption>{svg}</figure>")
    })
    .collect()
}
