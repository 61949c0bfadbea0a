//! Every flank of a die as a bar, tooth by tooth, with its uncertainty and the limits.

use std::fmt::Write as _;

use flankscope_metrology::gear::Flank;
use flankscope_metrology::verdict::Word;

use super::ring::in_words;
use super::svg::{about, open, sign};
use flankscope_record::document::Feature;

const WIDTH: f64 = 1150.0;
const LEFT: f64 = 46.0;
const RIGHT: f64 = 40.0;
/// Height of one row of teeth, and of the horizontal axis within it, px.
const ROW: f64 = 190.0;
const AXIS: f64 = 132.0;
/// Number of teeth in a row.
const PER_ROW: u32 = 42;

/// Two bars for every tooth from 1 to `teeth`, left flank before right: wear, whiskers of U95, a symbol for each verdict other
/// than "go", and hatching where a flank was not measured or not requested.
pub(super) fn flanks(features: &[Feature], teeth: u32) -> String {
    let limit = |of: fn(&Feature) -> f64| features.iter().map(of).fold(0.0, f64::max);
    let (warn_um, limit_um) = (limit(|f| f.warn_um), limit(|f| f.limit_um));
    let ends = features
        .iter()
        .filter_map(|f| Some(f.wear_um? + f.u95_um.unwrap_or(0.0)));
    let top_um = ends.fold(1.15 * limit_um, f64::max).max(1.0);
    let rows = teeth.div_ceil(PER_ROW).max(1);
    let per_row = teeth.div_ceil(rows).max(1);
    let mut svg = open(WIDTH, ROW * f64::from(rows), "Wear of every flank");
    svg += r##"<defs><pattern id="hatch" width="5" height="5" patternUnits="userSpaceOnUse" patternTransform="rotate(45)"><rect width="5" height="5" fill="#fff"/><rect width="2" height="5" fill="#8a9097"/></pattern></defs>"##;
    let each = (WIDTH - LEFT - RIGHT) / f64::from(per_row);
    for row in 0..rows {
        let zero = ROW * f64::from(row) + AXIS + 22.0;
        let y = |um: f64| zero - (um.clamp(0.0, top_um)) / top_um * AXIS;
        for tick in about(5.0, 0.0, top_um) {
            let at = y(tick);
            let _ = write!(
                svg,
                r#"<line x1="{LEFT}" y1="{at:.1}" x2="{:.1}" y2="{at:.1}" class="grid"/><text x="{:.1}" y="{:.1}" text-anchor="end">{tick}</text>"#,
                WIDTH - RIGHT,
                LEFT - 6.0,
                at + 4.0
            );
        }
        for (um, name) in [(warn_um, "warn"), (limit_um, "stop")] {
            let at = y(um);
            let _ = write!(
                svg,
                r#"<line x1="{LEFT}" y1="{at:.1}" x2="{:.1}" y2="{at:.1}" class="mark {name}"/><text x="{:.1}" y="{:.1}" class="mark {name}">{name}</text>"#,
                WIDTH - RIGHT,
                WIDTH - RIGHT + 4.0,
                at + 4.0
            );
        }
        let first = row * per_row + 1;
        for tooth in first..(first + per_row).min(teeth + 1) {
            let begin = LEFT + f64::from(tooth - first) * each;
            let _ = write!(
                svg,
                r#"<text x="{:.1}" y="{:.1}" text-anchor="middle">{tooth}</text>"#,
                begin + 0.5 * each,
                zero + 14.0
            );
            for (side, flank) in Flank::BOTH.into_iter().enumerate() {
                let of = features
                    .iter()
                    .find(|f| f.id.tooth == tooth && f.id.flank == flank);
                let from = begin + (0.08 + 0.43 * side as f64) * each;
                bar(
                    &mut svg,
                    of,
                    &format!("tooth {tooth} {flank}"),
                    [from, 0.4 * each],
                    zero,
                    &y,
                );
            }
        }
        let _ = write!(
            svg,
            r#"<text x="{LEFT}" y="{:.1}">wear / µm</text><text x="{:.1}" y="{:.1}" text-anchor="end">tooth: left bar, right bar = left flank, right flank</text>"#,
            zero - AXIS - 8.0,
            WIDTH - RIGHT,
            zero + 28.0
        );
    }
    svg + "</svg>"
}

/// One flank between two heights, with its whisker and symbol.
fn bar(
    svg: &mut String,
    of: Option<&Feature>,
    name: &str,
    [from, width]: [f64; 2],
    zero: f64,
    y: &dyn Fn(f64) -> f64,
) {
    let Some((feature, wear_um)) = of.and_then(|f| Some((f, f.wear_um?))) else {
        let why = of.map_or("not asked for", |_| "not measured");
        let _ = write!(
            svg,
            r#"<rect class="flank-bar" x="{from:.1}" y="{:.1}" width="{width:.1}" height="{AXIS}" fill="url(#hatch)"><title>{name}: {why}</title></rect>"#,
            zero - AXIS
        );
        return;
    };
    let top = y(wear_um);
    let said = in_words(feature);
    let _ = write!(
        svg,
        r#"<rect class="flank-bar v-{}" x="{from:.1}" y="{:.1}" width="{width:.1}" height="{:.1}"><title>{said}</title></rect>"#,
        feature.verdict,
        top.min(zero - 1.0),
        (zero - top).max(1.0)
    );
    let middle = from + 0.5 * width;
    let mut end = top;
    if let Some(u95_um) = feature.u95_um {
        end = y(wear_um + u95_um);
        let _ = write!(
            svg,
            r#"<path d="M{middle:.1} {:.1}V{end:.1}" class="whisker"/>"#,
            y(wear_um - u95_um)
        );
    }
    if feature.verdict != Word::Go {
        sign(svg, feature.verdict, [middle, end - 7.0], 4.0, &said);
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use flankscope_metrology::gear::{GearData, GearKind};
    use flankscope_record::document::{FeatureId, Toothing};

    /// An internal gear with a tooth on +x.
    pub fn toothing() -> Toothing {
        Toothing {
            gear: GearData {
                kind: GearKind::Internal,
                teeth: 84,
                module_mm: 1.0,
                pressure_angle_deg: 20.0,
                tip_radius_mm: 41.0,
                root_radius_mm: 43.25,
                first_tooth_centre_deg: 0.0,
                height_mm: [0.0, 66.0],
                radial_threshold_mm: 50.0,
            },
            zone_radius_mm: [41.2, 43.0],
        }
    }

    /// A flank that was judged.
    pub fn feature(tooth: u32, flank: Flank, wear_um: Option<f64>, verdict: Word) -> Feature {
        Feature {
            id: FeatureId {
                tooth,
                flank,
                patch: None,
            },
            wear_um,
            u95_um: wear_um.map(|_| 4.0),
            at_least_um: None,
            mean_um: wear_um,
            coverage_ratio: 1.0,
            warn_um: 30.0,
            limit_um: 50.0,
            conformity: None,
            detail: None,
            measurements: Vec::new(),
            verdict,
            reason: None,
            code: None,
        }
    }

    #[test]
    fn every_flank_has_a_bar_with_its_uncertainty() {
        let mut features: Vec<Feature> = (1..=84)
            .flat_map(|tooth| Flank::BOTH.map(|f| feature(tooth, f, Some(1.0), Word::Go)))
            .collect();
        features[78] = feature(40, Flank::Left, Some(80.0), Word::NoGo);
        features[3] = feature(2, Flank::Right, None, Word::Indeterminate);
        features.remove(0);
        let svg = flanks(&features, 84);
        assert_eq!(svg.matches(r#"class="flank-bar"#).count(), 168);
        assert_eq!(svg.matches(r#"class="whisker""#).count(), 166);
        assert_eq!(
            svg.matches("± 4.0 µm").count(),
            167,
            "each bar, and the sign of the one that is no go"
        );
        assert_eq!(svg.matches("url(#hatch)").count(), 2);
        assert!(
            svg.contains("tooth 1 left: not asked for")
                && svg.contains("tooth 2 right: not measured")
        );
        assert!(svg.contains("tooth 40 left: 80.0 ± 4.0 µm, no-go"));
    }
}
