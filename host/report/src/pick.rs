//! A page on which corresponding points of a cloud and a CAD are picked: the start of a registration whose pose nobody knows.

use askama::Template;
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;

/// Most points shown of either side, evenly spread over the file: a page stays below 1.1 MB.
pub const MOST_PICK_POINTS: usize = 30_000;

/// What the page shows beside each other.
pub struct PickSides<'a> {
    /// File of the cloud.
    pub cloud: &'a str,
    /// Its points, mm.
    pub cloud_mm: &'a [[f64; 3]],
    /// File of the CAD, or of the reference cloud.
    pub cad: &'a str,
    /// Points on it, mm.
    pub cad_mm: &'a [[f64; 3]],
}

#[derive(Template)]
#[template(path = "pick.html")]
struct Page<'a> {
    of: &'a PickSides<'a>,
    cloud: String,
    cad: String,
    shares: [[usize; 2]; 2],
}

/// The points that are shown.
fn shown(points_mm: &[[f64; 3]]) -> impl ExactSizeIterator<Item = &[f64; 3]> {
    let every = points_mm.len().div_ceil(MOST_PICK_POINTS).max(1);
    points_mm.iter().step_by(every)
}

/// Points as base64 of f32, little-endian: x, y, z of one after another; 4 nm are told apart within 50 mm of the origin.
fn base64_of(points_mm: &[[f64; 3]]) -> String {
    let coordinates = shown(points_mm).flatten();
    let bytes: Vec<u8> = coordinates
        .flat_map(|&mm| (mm as f32).to_le_bytes())
        .collect();
    STANDARD.encode(bytes)
}

/// The page: one file that needs no network.
///
/// # Errors
/// Errors of the template; none occur.
pub fn pick_html(of: &PickSides<'_>) -> Result<String, askama::Error> {
    let share = |points_mm: &[[f64; 3]]| [shown(points_mm).len(), points_mm.len()];
    let page = Page {
        of,
        cloud: base64_of(of.cloud_mm),
        cad: base64_of(of.cad_mm),
        shares: [share(of.cloud_mm), share(of.cad_mm)],
    };
    page.render()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_text_and_large_clouds_are_thinned_evenly() {
        let many: Vec<[f64; 3]> = (0..90_001).map(|i| [f64::from(i), 0.0, 0.5]).collect();
        let sides = PickSides {
            cloud: "<b>.ply",
            cloud_mm: &many,
            cad: "die.stl",
            cad_mm: &many[..3],
        };
        let page = pick_html(&sides).unwrap();
        assert!(!page.contains("<b>.ply") && page.contains("die.stl"));
        assert!(page.contains("22501 of 90001") && page.contains("3 of 3"));
        let all = STANDARD.decode(base64_of(&many)).unwrap();
        assert_eq!(all.len(), 12 * 22_501);
        // Every fourth.
        assert_eq!(all[12..16], 4f32.to_le_bytes());
    }
}
