//! The toothing seen from above, with every judged flank in the colour of its verdict.

use std::f64::consts::TAU;
use std::fmt::Write as _;

use flankscope_metrology::gear::{Flank, GearData, GearKind};
use flankscope_metrology::verdict::Word;

use super::svg::{open, sign};
use flankscope_record::document::{Feature, Toothing};

const SIZE: f64 = 420.0;
const MIDDLE: f64 = 0.5 * SIZE;
/// Radius of the toothing's outermost circle, px; numbers are placed around it.
const OUTER: f64 = 178.0;
/// Number of points along a flank's profile.
const STEPS: usize = 5;
/// Interval between numbered teeth if all teeth were judged.
const NUMBERED: usize = 6;

/// Points of a flank from tip to root: mm from the axis, and rad from the tooth's centre.
pub(super) fn profile(gear: &GearData, flank: Flank) -> Vec<[f64; 2]> {
    let (tip, root) = (gear.tip_radius_mm, gear.root_radius_mm);
    (0..=STEPS)
        .map(|i| tip + (root - tip) * i as f64 / STEPS as f64)
        .filter_map(|radius| Some([radius, flank.sign() * gear.half_tooth_rad(radius)?]))
        .collect()
}

/// Position of an angle and a radius in the picture: seen from above, angles increase anticlockwise.
fn at(scale: f64, [radius_mm, angle_rad]: [f64; 2]) -> [f64; 2] {
    let (sin, cos) = angle_rad.sin_cos();
    let r = radius_mm * scale;
    [MIDDLE + r * cos, MIDDLE - r * sin]
}

fn path(points: impl Iterator<Item = [f64; 2]>) -> String {
    let mut path = String::new();
    for [x, y] in points {
        let _ = write!(
            path,
            "{}{x:.1} {y:.1}",
            if path.is_empty() { 'M' } else { 'L' }
        );
    }
    path
}

/// Tooltip and label of a flank.
pub(super) fn in_words(of: &Feature) -> String {
    format!("{}: {} µm, {}", of.id, crate::wear_in_words(of), of.verdict)
}

/// The flank with the largest wear.
pub(super) fn deepest(features: &[Feature]) -> Option<&Feature> {
    let measured = features.iter().filter(|f| f.wear_um.is_some());
    measured.max_by(|a, b| {
        a.wear_um
            .unwrap_or(0.0)
            .total_cmp(&b.wear_um.unwrap_or(0.0))
    })
}

/// The ring of teeth: outlines, judged flanks with numbers, and in its middle the tooth with the largest wear.
pub(super) fn ring(of: &Toothing, features: &[Feature]) -> String {
    let gear = &of.gear;
    let outer_mm = gear.root_radius_mm.max(gear.tip_radius_mm);
    let scale = OUTER / outer_mm;
    let mut svg = open(SIZE, SIZE, "Ring of teeth from above");
    let [left, right] = Flank::BOTH.map(|flank| profile(gear, flank));
    let outline = (1..=gear.teeth).flat_map(|tooth| {
        let centre = gear.tooth_centre_rad(tooth);
        let towards_tip = right.iter().rev().chain(&left);
        towards_tip
            .map(move |&[radius, angle]| at(scale, [radius, centre + angle]))
            .collect::<Vec<_>>()
    });
    let _ = write!(svg, r#"<path d="{}z" class="tooth"/>"#, path(outline));
    let mut teeth: Vec<(u32, Word)> = Vec::new();
    for feature in features {
        let side = match feature.id.flank {
            Flank::Left => &left,
            Flank::Right | Flank::Face => &right,
        };
        let centre = gear.tooth_centre_rad(feature.id.tooth);
        let line = side
            .iter()
            .map(|&[radius, angle]| at(scale, [radius, centre + angle]));
        let _ = write!(
            svg,
            r#"<path d="{}" class="flank s-{}"><title>{}</title></path>"#,
            path(line),
            feature.verdict,
            in_words(feature)
        );
        match teeth.last_mut() {
            Some((tooth, worst)) if *tooth == feature.id.tooth => {
                *worst = (*worst).max(feature.verdict)
            }
            _ => teeth.push((feature.id.tooth, feature.verdict)),
        }
    }
    let few = teeth.len() <= 2 * NUMBERED;
    let outward = match gear.kind {
        GearKind::Internal => 1.0,
        GearKind::External => -1.0,
    };
    for (place, &(tooth, worst)) in teeth.iter().enumerate() {
        let centre = gear.tooth_centre_rad(tooth);
        let mark = at(1.0, [OUTER - outward * 20.0, centre]);
        if worst != Word::Go || few {
            sign(
                &mut svg,
                worst,
                mark,
                5.0,
                &format!("tooth {tooth}: {worst}"),
            );
        }
        if few || worst != Word::Go || place % NUMBERED == 0 {
            let [x, y] = at(1.0, [OUTER + 14.0, centre]);
            let weight = if worst == Word::Go {
                ""
            } else {
                r#" font-weight="700""#
            };
            let _ = write!(
                svg,
                r#"<text x="{x:.1}" y="{:.1}" text-anchor="middle"{weight}>{tooth}</text>"#,
                y + 4.0
            );
        }
    }
    if let Some(worst) = deepest(features) {
        enlarged(&mut svg, of, features, worst);
    }
    svg + "</svg>"
}

/// The toothing of a new tool from above, as a picture of its own: all teeth numbered as far as there is room, tooth 1 and those
/// that are inspected marked, and a line for the tooth at which the clamp has its mark.
#[must_use]
pub fn numbered_ring(gear: &GearData, inspected: &[u32]) -> String {
    let outer_mm = gear.root_radius_mm.max(gear.tip_radius_mm);
    let scale = OUTER / outer_mm;
    let sides = Flank::BOTH.map(|flank| profile(gear, flank));
    let outline_of = |tooth: u32| {
        let centre = gear.tooth_centre_rad(tooth);
        let points = sides[1].iter().rev().chain(&sides[0]);
        points.map(move |&[radius, angle]| at(scale, [radius, centre + angle]))
    };
    let mut svg = format!(
        r#"<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {SIZE} {SIZE}" font-family="sans-serif" font-size="10"><rect width="{SIZE}" height="{SIZE}" fill="white"/><path d="{}z" fill="none" stroke="black" stroke-width="0.6"/>"#,
        path((1..=gear.teeth).flat_map(outline_of))
    );
    // A number takes some 14 px of the circle.
    let every = (14.0 * f64::from(gear.teeth) / (TAU * OUTER))
        .ceil()
        .max(1.0) as u32;
    let every = if every == 1 {
        1
    } else {
        every.next_multiple_of(5)
    };
    for tooth in 1..=gear.teeth {
        let is_inspected = inspected.contains(&tooth);
        if is_inspected || tooth == 1 {
            let colour = if is_inspected { "#d55e00" } else { "#0072b2" };
            let _ = write!(
                svg,
                r#"<path d="{}" fill="none" stroke="{colour}" stroke-width="3"/>"#,
                path(outline_of(tooth))
            );
        }
        if is_inspected || tooth == 1 || tooth % every == 0 {
            let [x, y] = at(1.0, [OUTER + 14.0, gear.tooth_centre_rad(tooth)]);
            let weight = if is_inspected || tooth == 1 { 700 } else { 400 };
            let _ = write!(
                svg,
                r#"<text x="{x:.1}" y="{:.1}" text-anchor="middle" font-weight="{weight}">{tooth}</text>"#,
                y + 4.0
            );
        }
    }
    let [x, y] = at(1.0, [OUTER * 0.72, 0.0]);
    let _ = write!(
        svg,
        r##"<path d="M{MIDDLE} {MIDDLE}H{x:.1}" stroke="#777" stroke-width="0.6"/><text x="{x:.1}" y="{:.1}" text-anchor="end" fill="#555">x</text><text x="{MIDDLE}" y="{:.1}" text-anchor="middle">{} teeth, from above</text><text x="8" y="16"><tspan fill="#0072b2">tooth 1</tspan>{}</text><text x="8" y="{:.1}">mark of the clamp at tooth: ____________</text></svg>"##,
        y - 4.0,
        MIDDLE + 40.0,
        gear.teeth,
        if inspected.is_empty() {
            ""
        } else {
            r##", <tspan fill="#d55e00">inspected teeth</tspan>"##
        },
        SIZE - 8.0
    );
    svg
}

/// One tooth enlarged, in the orientation at the top of the ring: flanks by side, and the position of the largest loss on the profile.
fn enlarged(svg: &mut String, of: &Toothing, features: &[Feature], worst: &Feature) {
    let gear = &of.gear;
    let (inner, outer) = (
        gear.tip_radius_mm.min(gear.root_radius_mm),
        gear.tip_radius_mm.max(gear.root_radius_mm),
    );
    let scale = 95.0 / (outer - inner).max(1e-9);
    // Outwards is up; angles increase to the left.
    let place = |[radius, angle]: [f64; 2]| {
        [
            MIDDLE - scale * radius * angle.sin(),
            MIDDLE + 45.0 - scale * (radius * angle.cos() - inner),
        ]
    };
    let [left, right] = Flank::BOTH.map(|flank| profile(gear, flank));
    let body = right.iter().rev().chain(&left).map(|&p| place(p));
    let _ = write!(svg, r#"<path d="{}" class="tooth"/>"#, path(body));
    for (name, side) in [(Flank::Left, &left), (Flank::Right, &right)] {
        let of_side = features
            .iter()
            .find(|f| f.id.tooth == worst.id.tooth && f.id.flank == name);
        let shown = of_side.map_or_else(|| "none".into(), |f| f.verdict.to_string());
        let said = of_side.map_or_else(|| format!("{name}: not judged"), in_words);
        let _ = write!(
            svg,
            r#"<path d="{}" class="flank large s-{shown}"><title>{said}</title></path>"#,
            path(side.iter().map(|&p| place(p)))
        );
        let Some([x, y]) = side.last().map(|&p| place(p)) else {
            continue;
        };
        let (offset, anchor) = if name == Flank::Left {
            (14.0, "end")
        } else {
            (-14.0, "start")
        };
        let _ = write!(
            svg,
            r#"<text x="{:.1}" y="{:.1}" text-anchor="{anchor}">{name}</text>"#,
            x + offset,
            y - 6.0
        );
    }
    let line = |svg: &mut String, y: f64, weight: u32, text: &str| {
        let _ = write!(
            svg,
            r#"<text x="{MIDDLE}" y="{y}" text-anchor="middle" font-weight="{weight}">{text}</text>"#
        );
    };
    line(
        svg,
        MIDDLE + 66.0,
        700,
        &format!("tooth {}, {}", worst.id.tooth, worst.id.flank),
    );
    line(
        svg,
        MIDDLE + 83.0,
        400,
        &format!("{} µm", crate::wear_in_words(worst)),
    );
    if let Some(detail) = &worst.detail {
        let [along, up] = detail.deepest_at_mm;
        let from = gear.profile_mm(of.zone_radius_mm[0]);
        let radius = gear.radius_mm(from + along);
        if let Some(half) = gear.half_tooth_rad(radius) {
            let side = worst.id.flank.sign();
            let [x, y] = place([radius, side * half]);
            let _ = write!(
                svg,
                r#"<circle cx="{x:.1}" cy="{y:.1}" r="7" class="disc"><title>deepest disc: {along:.2} mm along the profile, {up:.2} mm up</title></circle>"#
            );
        }
        line(
            svg,
            MIDDLE + 100.0,
            400,
            &format!("deepest {along:.1} mm along, {up:.1} mm up"),
        );
    }
}

#[cfg(test)]
mod tests {
    use super::super::bars::tests::{feature, toothing};
    use super::*;

    /// First point of the first path of a class.
    fn begin(svg: &str, class: &str) -> [f64; 2] {
        let end = svg.find(&format!(r#"" class="{class}"#)).unwrap();
        let from = svg[..end].rfind("d=\"M").unwrap() + 4;
        let point = svg[from..end].split('L').next().unwrap();
        let (x, y) = point.split_once(' ').unwrap();
        [x.parse().unwrap(), y.parse().unwrap()]
    }

    /// Tooth 1 is at 3 o'clock; seen from above, angles increase anticlockwise, so its left flank is the upper one.
    #[test]
    fn flanks_lie_where_the_die_has_them() {
        let features = [
            feature(1, Flank::Left, Some(80.0), Word::NoGo),
            feature(1, Flank::Right, Some(1.0), Word::Go),
        ];
        let svg = ring(&toothing(), &features);
        let (left, right) = (begin(&svg, "flank s-no-go"), begin(&svg, "flank s-go"));
        assert!(left[1] < MIDDLE && MIDDLE < right[1], "{left:?} {right:?}");
        let radius = |[x, y]: [f64; 2]| (x - MIDDLE).hypot(y - MIDDLE);
        // Tips of an internal gear point inwards: 41 mm of 43.25 mm.
        assert!((radius(left) - OUTER * 41.0 / 43.25).abs() < 0.2);
        // In the enlarged tooth, the left flank is on the left.
        let (left, right) = (
            begin(&svg, "flank large s-no-go"),
            begin(&svg, "flank large s-go"),
        );
        assert!(left[0] < right[0]);
        assert!(svg.contains(">1</text>") && svg.contains("tooth 1 left: 80.0 ± 4.0 µm, no-go"));
    }

    #[test]
    fn a_whole_die_is_drawn_flank_by_flank() {
        let features: Vec<Feature> = (1..=84)
            .flat_map(|tooth| Flank::BOTH.map(|f| feature(tooth, f, Some(1.0), Word::Go)))
            .collect();
        let svg = ring(&toothing(), &features);
        assert_eq!(svg.matches(r#"class="flank s-go""#).count(), 168);
    }
}
