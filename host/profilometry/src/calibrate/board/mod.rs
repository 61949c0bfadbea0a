//! A head from an ordinary board, seen by the camera and lit by the projector: no certified pose, no blank plate.
//!
//! ```text
//!  mean of a view's frames ──► candidates (saddle | circles) ──► lattice ──► points of the board in the camera's image
//!  its decoded columns and rows ─────────────────────────────────► lit ──► and in the projector's
//!                                                                             │
//!                   closed form ──► bundle of all poses ──► adjust ◄──────────┘  ──► head, and what each pose says without itself
//! ```
//!
//! | file | holds |
//! |---|---|
//! | `image` | a grey image, smoothed and between pixels |
//! | `saddle`, `circles` | places that may be points of the board |
//! | `lattice` | which point each is |
//! | `lit` | the projector's coordinates there |
//! | `closed_form` | lenses and poses without any guess |
//! | `model` | the observation model of a board, for the bundle adjustment |
//! | `adjust` | from all poses to a head |
//! | `left_out` | a pose measured by the head of the others |
//! | `uncertainty` | uncertainties of head and points by leaving out poses |
//!
//! The projector is calibrated as a camera that sees the board by its fringes (Zhang and Huang 2006; Moreno and Taubin 2012). Nothing is
//! known of the poses, so which point of the board is called the first does not matter: markers of a ChArUco board are not read.
//! Not determined by such a calibration: the pose of the head on its stage, and the scale if the board's pitch is not certified.

mod adjust;
mod circles;
mod closed_form;
mod image;
mod lattice;
mod left_out;
mod lit;
mod model;
mod saddle;
mod uncertainty;

use serde::{Deserialize, Serialize};

use crate::cloud::CellColumn;
use flankscope_foundation::textfile::BadValue;
use image::Grey;
use lattice::{Candidate, LatticePoint};
use lit::Coordinates;

pub use adjust::{BoardAdjusted, LEAST_POSES, PoseReport, adjust};
pub use left_out::LeftOut;
pub use uncertainty::Parameter;

/// Pattern printed on a board.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum BoardKind {
    /// Black and white squares.
    Checkerboard,
    /// The same with markers in its white squares, which are not read.
    Charuco,
    /// A square grid of circles.
    Circles,
}

/// A board: kind, points along its sides and their distance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Board {
    /// Printed pattern.
    pub kind: BoardKind,
    /// Points (inner crossings of squares, or circles) along one side and along the other; which is which does not matter.
    pub points: [usize; 2],
    /// From point to point.
    pub pitch_mm: f64,
    /// Diameter of circles.
    pub diameter_mm: Option<f64>,
    /// Whether circles are brighter than their background.
    pub bright: bool,
}

impl BoardKind {
    /// Rule by which the points of a board are counted.
    fn counting(self) -> &'static str {
        match self {
            Self::Checkerboard | Self::Charuco => "inner crossings are counted, not squares",
            Self::Circles => {
                "circles are counted along the sides of a square grid, pitch_mm from centre to nearest centre; a staggered (asymmetric) grid is \
                 not read: print a square one"
            }
        }
    }
}

impl std::fmt::Display for BoardKind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Checkerboard => "checkerboard",
            Self::Charuco => "charuco",
            Self::Circles => "circles",
        })
    }
}

impl std::fmt::Display for Board {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [columns, rows] = self.points;
        write!(
            f,
            "{}, {columns} x {rows} points, {} mm apart",
            self.kind, self.pitch_mm
        )
    }
}

/// Dimensions of a board that the adjustment needs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Geometry {
    /// From point to point.
    pub pitch_mm: f64,
    /// Radius of the circles; 0 for crossings.
    pub radius_mm: f64,
    /// Standard uncertainty of the pitch as a part of it, if it is known.
    pub scale_sigma_ratio: Option<f64>,
}

impl Board {
    /// Dimensions for the adjustment; `pitch_sigma_mm` is the standard uncertainty of a certified pitch.
    #[must_use]
    pub fn geometry(&self, pitch_sigma_mm: Option<f64>) -> Geometry {
        let diameter_mm = match self.kind {
            BoardKind::Circles => self.diameter_mm.unwrap_or(0.0),
            BoardKind::Checkerboard | BoardKind::Charuco => 0.0,
        };
        Geometry {
            pitch_mm: self.pitch_mm,
            radius_mm: 0.5 * diameter_mm,
            scale_sigma_ratio: pitch_sigma_mm.map(|sigma| sigma / self.pitch_mm),
        }
    }
}

/// One point of a board, seen and lit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoardMark {
    /// Its column and row in the lattice, from the first one seen.
    pub place: [i32; 2],
    /// Column and row of the camera.
    pub pixel: [f64; 2],
    /// Column and row of the projector that light it.
    pub lit_px: [f64; 2],
}

impl BoardMark {
    fn at_mm(&self, pitch_mm: f64) -> [f64; 2] {
        self.place.map(|n| f64::from(n) * pitch_mm)
    }

    /// The same with the projector for the camera.
    fn by_projector(&self) -> Self {
        Self {
            pixel: self.lit_px,
            lit_px: self.pixel,
            ..*self
        }
    }
}

/// One pose of the board.
#[derive(Clone, Debug, PartialEq)]
pub struct BoardView {
    /// Name in messages.
    pub name: String,
    /// Its points.
    pub marks: Vec<BoardMark>,
}

/// Mean image and decoded coordinates of one view, pixel by pixel.
#[derive(Clone, Copy, Debug)]
pub struct BoardFrames<'a> {
    /// Columns and rows of the camera.
    pub size_px: [u32; 2],
    /// Mean of all frames, row by row.
    pub mean: &'a [f32],
    /// The projector's columns.
    pub columns: &'a [CellColumn],
    /// The projector's rows.
    pub rows: &'a [CellColumn],
    /// Period of the finest fringes in the projector, columns and rows, px.
    pub fringe_px: [f64; 2],
}

/// Why an ordinary board gives no head.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum BoardError {
    /// No lattice of the board's kind, or one of too few points.
    #[error(
        "{view}: {got} {points} of the board were found, at least {limit} are needed: is the board of this kind, in focus, lit, and not over-exposed?"
    )]
    FewPoints {
        /// The view.
        view: String,
        /// Found.
        got: usize,
        /// Crossings or circles.
        points: &'static str,
        /// Least.
        limit: usize,
    },
    /// More than there should be.
    #[error(
        "{view}: the board has {} x {} points, the board file says {} x {}: {}", got[0], got[1], expected[0], expected[1], kind.counting()
    )]
    OtherBoard {
        /// Kind of the board.
        kind: BoardKind,
        /// The view.
        view: String,
        /// Seen.
        got: [usize; 2],
        /// Points given by the board file.
        expected: [usize; 2],
    },
    /// The fringes are not decoded where the points are.
    #[error(
        "{view}: at {got} of {of} points the projector's columns and rows are known, at least {limit} are needed: do the plans tell which image shows what, and does the light reach all of the board?"
    )]
    FewLit {
        /// The view.
        view: String,
        /// With both coordinates.
        got: usize,
        /// Points found.
        of: usize,
        /// Least.
        limit: usize,
    },
    /// Too few poses, or too few that agree.
    #[error("{got} of {of} poses of the board agree, at least {limit} are needed")]
    FewPoses {
        /// Poses that agree.
        got: usize,
        /// All.
        of: usize,
        /// Least.
        limit: usize,
    },
    /// The head depends on one pose.
    #[error(
        "without {pose} the other poses do not determine the head, so its uncertainty cannot be told: add poses that are tilted about different axes"
    )]
    Hinges {
        /// Which.
        pose: String,
    },
    /// No lens explains the board even roughly.
    #[error(
        "no {what} sees the board like this: tilt it differently in each pose, and check the sizes and, for the projector, the plans"
    )]
    NoStart {
        /// Camera or projector.
        what: &'static str,
    },
    /// The poses do not determine an unknown.
    #[error(
        "the poses leave the {what}'s {unknown} uncertain by {:.1} % (standard uncertainty), at most {:.1} % is allowed: add poses that are tilted about different axes, and fill the image with them", 100.0 * sigma, 100.0 * limit
    )]
    Degenerate {
        /// Camera or projector.
        what: &'static str,
        /// Which.
        unknown: &'static str,
        /// Standard uncertainty, as a part.
        sigma: f64,
        /// Largest.
        limit: f64,
    },
    /// No solution at all.
    #[error(
        "the poses do not determine the head (the normal equations are singular): add poses that are tilted about different axes"
    )]
    Singular,
    /// The search did not come to an end.
    #[error("the adjustment still moves after {limit} steps: are the images of one head at rest?")]
    NotSettled {
        /// Steps done.
        limit: usize,
    },
    /// Residuals larger than noise explains.
    #[error(
        "after the adjustment points are off by {got_px:.2} px rms per axis in the {what}'s image, at most {limit_px} px are allowed: is the board flat, and was it at rest?"
    )]
    Residual {
        /// Camera or projector.
        what: &'static str,
        /// Root mean square per axis.
        got_px: f64,
        /// Limit.
        limit_px: f64,
    },
    /// A lens that no head file may have.
    #[error("the adjustment ends beyond what a head may be: {} = {}: {}", .0.key, .0.got, .0.expected)]
    Head(BadValue),
}

/// With fewer points a pose says too little.
const LEAST_POINTS: usize = 12;
/// Blurs by which crossings are looked for, for boards from a few to a hundred pixels per square, with or without the dots of a printer.
const BLURS_PX: [f64; 4] = [1.5, 2.5, 4.0, 6.5];

/// The points of a board in one view, with the projector's coordinates there.
///
/// # Errors
/// [`BoardError`]: no board, another one, or no fringes on it.
pub fn find(name: &str, board: &Board, frames: &BoardFrames<'_>) -> Result<BoardView, BoardError> {
    let [columns, rows] = frames.size_px.map(|px| px as usize);
    let image = Grey {
        columns,
        rows,
        values: frames.mean.to_vec(),
    };
    let labelled = locate(&image, board);
    if labelled.len() < LEAST_POINTS {
        return Err(BoardError::FewPoints {
            view: name.to_owned(),
            got: labelled.len(),
            points: match board.kind {
                BoardKind::Circles => "circles",
                BoardKind::Checkerboard | BoardKind::Charuco => "crossings",
            },
            limit: LEAST_POINTS,
        });
    }
    let got = lattice::extent(&labelled);
    if !fits(got, board) {
        return Err(BoardError::OtherBoard {
            kind: board.kind,
            view: name.to_owned(),
            got,
            expected: board.points,
        });
    }
    let [of_columns, of_rows] =
        [(frames.columns, 0), (frames.rows, 1)].map(|(cells, axis)| Coordinates {
            cells,
            fringe_px: frames.fringe_px[axis],
        });
    let spacings = lattice::spacings_px(&labelled);
    let marks: Vec<BoardMark> = labelled
        .iter()
        .zip(&spacings)
        .filter_map(|(point, &spacing)| {
            let lit = |of: &Coordinates<'_>| of.at(&image, point.at_px, spacing);
            Some(BoardMark {
                place: point.place,
                pixel: point.at_px,
                lit_px: [lit(&of_columns)?, lit(&of_rows)?],
            })
        })
        .collect();
    if marks.len() < LEAST_POINTS {
        return Err(BoardError::FewLit {
            view: name.to_owned(),
            got: marks.len(),
            of: labelled.len(),
            limit: LEAST_POINTS,
        });
    }
    Ok(BoardView {
        name: name.to_owned(),
        marks,
    })
}

/// The points of the board in an image, to fractions of a pixel.
fn locate(image: &Grey, board: &Board) -> Vec<LatticePoint> {
    let all = board.points[0] * board.points[1];
    let mut best: Vec<LatticePoint> = Vec::new();
    match board.kind {
        BoardKind::Checkerboard | BoardKind::Charuco => {
            for blur_px in BLURS_PX {
                let grown = largest(&saddle::candidates(image, blur_px), image);
                if grown.len() > best.len() {
                    best = grown;
                }
                if best.len() == all {
                    break;
                }
            }
            let slopes = saddle::Slopes::new(image);
            let spacings = lattice::spacings_px(&best);
            let refined = best.iter().zip(&spacings).filter_map(|(point, &spacing)| {
                let at_px = slopes.crossing(point.at_px, spacing)?;
                Some(LatticePoint { at_px, ..*point })
            });
            completed(refined.collect(), &slopes, board)
        }
        BoardKind::Circles => {
            for reach in circles::REACHES {
                let grown = largest(&circles::candidates(image, reach, board.bright), image);
                if grown.len() > best.len() {
                    best = grown;
                }
                if best.len() == all {
                    break;
                }
            }
            best
        }
    }
}

/// A crossing lies this near to where those about it put it, in distances of crossings.
const EXPECTED: f64 = 0.15;

/// With crossings that no candidate was at, in poor light or under dirt, where those about them put them.
fn completed(
    mut points: Vec<LatticePoint>,
    slopes: &saddle::Slopes,
    board: &Board,
) -> Vec<LatticePoint> {
    loop {
        let before = points.len();
        for expected in lattice::expected_beside(&points) {
            let away = |to: [f64; 2]| {
                let [x, y] = [0, 1].map(|axis| to[axis] - expected.at_px[axis]);
                x.hypot(y)
            };
            let beside = |point: &&LatticePoint| {
                let apart = [0, 1].map(|axis| (point.place[axis] - expected.place[axis]).abs());
                apart[0] + apart[1] == 1
            };
            let Some(neighbour_px) = points.iter().find(beside).map(|point| point.at_px) else {
                continue;
            };
            let spacing = away(neighbour_px);
            let Some(at_px) = slopes.crossing(expected.at_px, spacing) else {
                continue;
            };
            let found = LatticePoint { at_px, ..expected };
            let more = [points.as_slice(), &[found]].concat();
            if away(at_px) < EXPECTED * spacing
                && slopes.is_crossing(at_px, spacing, neighbour_px)
                && fits(lattice::extent(&more), board)
            {
                points = more;
            }
        }
        if points.len() == before {
            return lattice::from_zero(points);
        }
    }
}

/// Whether a lattice of this extent fits on the board, either way round.
fn fits(extent: [usize; 2], board: &Board) -> bool {
    let sorted = |[a, b]: [usize; 2]| [a.min(b), a.max(b)];
    let ([short, long], [least, most]) = (sorted(extent), sorted(board.points));
    short <= least && long <= most
}

fn largest(candidates: &[Candidate], image: &Grey) -> Vec<LatticePoint> {
    lattice::grow(candidates, image.columns as f64)
}
