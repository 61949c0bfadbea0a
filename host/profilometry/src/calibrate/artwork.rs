//! What is to be printed for a calibration: the dots of a target's plates, or the squares or circles of a board.
//!
//! x points right and y up, seen from the printed side, with the origin in the middle. The three larger dots of a plate tell its axes,
//! so a mirrored print is another plate.

use super::board::{Board, BoardKind};
use super::target::Target;

/// Relative tolerance of diameters. With a dot's radius r, tilt t and distance z the centre of its image is off by about r² t / z: 0.14 µm
/// for 0.125 mm, 0.2 rad and 22 mm, of which a tenth more diameter adds a fifth.
const DIAMETER_TOLERANCE: f64 = 0.1;

/// One printed mark, mm from the middle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PrintedMark {
    /// A dot.
    Circle {
        /// Its centre.
        centre_mm: [f64; 2],
        /// Its radius.
        radius_mm: f64,
    },
    /// A square with sides along x and y.
    Square {
        /// Its centre.
        centre_mm: [f64; 2],
        /// Its side.
        side_mm: f64,
    },
}

/// A print with its dimensions.
#[derive(Clone, Debug, PartialEq)]
pub struct Artwork {
    /// What it is.
    pub title: String,
    /// Sides of the plate or board along x and y.
    pub size_mm: [f64; 2],
    /// Whether the ground is dark and the marks are left bare.
    pub dark_ground: bool,
    /// The marks.
    pub marks: Vec<PrintedMark>,
    /// Steps of `pitch_mm` from the first to the last point along x and y.
    pub steps: [usize; 2],
    /// From point to point.
    pub pitch_mm: f64,
    /// Largest distance of a point from its place; unknown where the file states no uncertainty.
    pub tolerance_mm: Option<f64>,
    /// What the drawing says in words, one line each.
    pub notes: Vec<String>,
}

/// Numbers in drawings: micrometres, without trailing zeros.
fn mm(length_mm: f64) -> f64 {
    (1e4 * length_mm).round() / 1e4
}

impl Target {
    /// The print of one of its plates, for a field of this width. It fills the field in every view: the stages move it across by
    /// `beside`.
    #[must_use]
    pub fn artwork(&self, field_mm: f64) -> Artwork {
        let dots = &self.dots;
        let from_axis = |plate: &super::target::Plate| {
            let [x, y, _] = plate.tool_from_plate.translation_mm;
            x.hypot(y)
        };
        let axis_mm = self.plate.iter().map(from_axis).fold(0.0, f64::max);
        let moved = self
            .beside
            .iter()
            .map(|of| (of.turned_rad.abs() * axis_mm).max(of.raised_mm.abs()));
        let half_mm = 0.5 * field_mm + moved.fold(0.0, f64::max);
        let reach = (half_mm / dots.pitch_mm).ceil() as i32;
        let centre = |place: [i32; 2]| place.map(|n| f64::from(n) * dots.pitch_mm);
        let row = |y: i32| (-reach..=reach).map(move |x| [x, y]);
        let marks = (-reach..=reach)
            .flat_map(row)
            .map(|place| PrintedMark::Circle {
                centre_mm: centre(place),
                radius_mm: dots.radius_mm(place),
            });
        let side_mm = f64::from(2 * reach + 2) * dots.pitch_mm;
        let tolerance_mm = self.pose_sigma_mm;
        Artwork {
            title: self.name.clone(),
            size_mm: [side_mm; 2],
            dark_ground: false,
            marks: marks.collect(),
            steps: [2 * reach as usize; 2],
            pitch_mm: dots.pitch_mm,
            tolerance_mm: Some(tolerance_mm),
            notes: vec![
                format!(
                    "{} pieces with this print, {} of this size without",
                    self.plate.len(),
                    1 + self.test_blank.len()
                ),
                format!(
                    "dots: diameter {} mm, three of {} mm, each +-{:.0} %; matt dark on matt white",
                    mm(dots.diameter_mm),
                    mm(dots.key_diameter_mm),
                    100.0 * DIAMETER_TOLERANCE
                ),
                format!(
                    "centre of every dot within {} mm of its place in the grid",
                    mm(tolerance_mm)
                ),
                format!(
                    "flat within {} mm; the grid's middle is the origin of tool_from_plate",
                    mm(tolerance_mm)
                ),
                format!(
                    "certificate: pitch, and place and orientation of each plate to {} mm and {} mrad (standard uncertainty)",
                    mm(self.pose_sigma_mm),
                    mm(1e3 * self.pose_sigma_rad)
                ),
                "seen from the printed side; x to the right, y up: not mirrored".into(),
            ],
        }
    }
}

impl Board {
    /// Its print. A ChArUco board is drawn without its markers, which are not read.
    #[must_use]
    pub fn artwork(&self, pitch_sigma_mm: Option<f64>) -> Artwork {
        let [columns, rows] = self.points;
        let pitch_mm = self.pitch_mm;
        let circles = self.kind == BoardKind::Circles;
        // Squares stand one beyond the crossings.
        let [across, up] = self.points.map(|n| if circles { n } else { n + 1 });
        let at = |n: usize, of: usize| (n as f64 - 0.5 * (of - 1) as f64) * pitch_mm;
        let places = (0..up).flat_map(|y| (0..across).map(move |x| [x, y]));
        let marks = places.filter_map(|[x, y]| {
            let centre_mm = [at(x, across), at(y, up)];
            match self.diameter_mm.filter(|_| circles) {
                Some(diameter_mm) => Some(PrintedMark::Circle {
                    centre_mm,
                    radius_mm: 0.5 * diameter_mm,
                }),
                None => ((x + y) % 2 == 0).then_some(PrintedMark::Square {
                    centre_mm,
                    side_mm: pitch_mm,
                }),
            }
        });
        let what = match (self.kind, self.diameter_mm) {
            (BoardKind::Circles, Some(diameter_mm)) => format!("circles of {} mm", mm(diameter_mm)),
            (BoardKind::Charuco, _) => {
                "squares; markers of a ChArUco board are not read, so none is drawn".into()
            }
            _ => "squares".into(),
        };
        let sure = match pitch_sigma_mm {
            Some(sigma_mm) => format!("pitch known to {} mm (pitch_sigma_mm): every length to {:.2} %", mm(sigma_mm), 100.0 * sigma_mm / pitch_mm),
            None => "pitch not certified: measure it over many points, and state it as pitch_mm with pitch_sigma_mm; else the scale is unknown".into(),
        };
        Artwork {
            title: self.to_string(),
            size_mm: [across, up].map(|n| (n + 2) as f64 * pitch_mm),
            dark_ground: circles && self.bright,
            marks: marks.collect(),
            steps: [columns - 1, rows - 1],
            pitch_mm,
            tolerance_mm: pitch_sigma_mm,
            notes: vec![
                what,
                sure,
                "print at 100 %, measure the ruler, mount flat: a bend is not modelled".into(),
            ],
        }
    }
}
