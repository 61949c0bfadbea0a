//! The report of a scan: the unrolled map, what saw it, how it is spread, and every point as PLY.

use std::io::{self, Write};

use askama::Template;
use flankscope_metrology::cloud::write_ply;

use super::{chart, colour};
use crate::scan::Scan;

/// Smallest full scale of the pictures, µm.
const LEAST_FULL_UM: f64 = 20.0;

#[derive(Template)]
#[template(path = "scan.html")]
struct Page<'a> {
    scan: &'a Scan,
    registered: usize,
    deviation: String,
    coverage: String,
    most_views: u32,
    colour_bar: String,
    histogram: String,
    rms: String,
    lost: Vec<(usize, &'a str)>,
}

/// Writes the page of a scan.
///
/// # Errors
/// The template engine's, which formatting into memory never raises.
pub fn scan_html(scan: &Scan) -> Result<String, askama::Error> {
    let mut deviations_um: Vec<f64> = scan.map.cells().map(|c| c.deviation_mm * 1e3).collect();
    let full_um = full_scale_um(&mut deviations_um);
    let layout = scan.map.layout();
    let most_views = scan.map.cells().map(|cell| cell.views).max().unwrap_or(0);
    let picture = |colour_of: &dyn Fn(flankscope_metrology::cylinder::Cell) -> [u8; 3]| {
        let pixels: Vec<[u8; 3]> = (0..layout.rows)
            .rev()
            .flat_map(|row| (0..layout.columns).map(move |column| (row, column)))
            .map(|(row, column)| {
                scan.map
                    .cell(row, column)
                    .map_or(colour::NO_DATA, colour_of)
            })
            .collect();
        colour::rgb_data_uri(layout.columns, layout.rows, &pixels)
    };
    let lost = scan
        .registration
        .iter()
        .filter(|r| r.status != "registered");
    let page = Page {
        scan,
        registered: scan.registration.len() - lost.clone().count(),
        deviation: picture(&|cell| colour::diverging(cell.deviation_mm * 1e3 / full_um)),
        coverage: picture(&|cell| {
            let share = f64::from(cell.views) / f64::from(most_views.max(1));
            let grey = (240.0 - 200.0 * share) as u8;
            [grey, grey, 255]
        }),
        most_views,
        colour_bar: chart::colour_bar(full_um),
        histogram: chart::histogram(&deviations_um, full_um, &[]),
        rms: rms_table(scan),
        lost: lost
            .map(|r| (r.view, r.reason.as_deref().unwrap_or("not captured")))
            .collect(),
    };
    page.render()
}

/// Half of the pictures' range: what 99 of 100 cells stay within, on a round number.
fn full_scale_um(deviations_um: &mut [f64]) -> f64 {
    let at = deviations_um.len() * 99 / 100;
    let mut sizes: Vec<f64> = deviations_um.iter().map(|d| d.abs()).collect();
    if sizes.is_empty() {
        return LEAST_FULL_UM;
    }
    let (_, size, _) = sizes.select_nth_unstable_by(at, f64::total_cmp);
    (*size / 10.0).ceil().max(LEAST_FULL_UM / 10.0) * 10.0
}

/// Root mean square distance of every view, layer by layer: a picture of one pixel per view.
fn rms_table(scan: &Scan) -> String {
    let full_um = 20.0;
    let mut heights: Vec<f64> = scan.registration.iter().map(|r| r.vertical_mm).collect();
    heights.sort_by(f64::total_cmp);
    heights.dedup();
    let mut rows = String::new();
    for height in heights.iter().rev() {
        let mut layer: Vec<_> = scan
            .registration
            .iter()
            .filter(|r| r.vertical_mm == *height)
            .collect();
        layer.sort_by(|a, b| a.rotation_deg.total_cmp(&b.rotation_deg));
        rows.push_str(&format!("<tr><th>{height:.1} mm</th>"));
        for view in layer {
            let [r, g, b] = view
                .rms_um
                .map_or(colour::NO_DATA, |rms| colour::diverging(rms / full_um));
            let title = view
                .rms_um
                .map_or("lost".into(), |rms| format!("{rms:.1} µm"));
            rows.push_str(&format!(
                r#"<td title="{:.1}°: {title}" style="background:rgb({r},{g},{b})"></td>"#,
                view.rotation_deg
            ));
        }
        rows.push_str("</tr>");
    }
    rows
}

/// Writes every cell of the map as a point: deviation and standard uncertainty in mm, number of views, normal.
///
/// # Errors
/// Those of `out`.
pub fn scan_ply(scan: &Scan, out: &mut dyn Write) -> io::Result<()> {
    let cells: Vec<_> = scan.map.cells().collect();
    let points: Vec<[f64; 3]> = cells.iter().map(|cell| cell.point).collect();
    let column = |of: fn(&flankscope_metrology::cylinder::Cell) -> f64| -> Vec<f64> {
        cells.iter().map(of).collect()
    };
    write_ply(
        out,
        &points,
        &[
            ("nx", &column(|c| c.normal[0])),
            ("ny", &column(|c| c.normal[1])),
            ("nz", &column(|c| c.normal[2])),
            ("deviation", &column(|c| c.deviation_mm)),
            ("sigma", &column(|c| c.sigma_mm)),
            ("views", &column(|c| f64::from(c.views))),
        ],
    )
}
