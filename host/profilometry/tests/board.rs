//! A head from an ordinary board, of pictures drawn by a renderer of its own: rays from every pixel through a lens that is inverted by
//! fixed-point iteration to a plane in space, and from there into a projector by the formula of OpenCV's manual.

// `!(value > limit)` is meant: a NaN must fail every check.
#![allow(clippy::neg_cmp_op_on_partial_ord)]

use std::sync::OnceLock;

use flankscope_profilometry::calibrate::board::{
    Board, BoardAdjusted, BoardError, BoardFrames, BoardKind, BoardView, adjust, find,
};
use flankscope_profilometry::cloud::CellColumn;
use flankscope_test_requisites::Random;

type V = [f64; 3];

fn dot(a: V, b: V) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Turns about x, then y, then z: rows of the matrix.
fn turned([a, b, c]: V) -> [V; 3] {
    let ((sa, ca), (sb, cb), (sc, cc)) = (a.sin_cos(), b.sin_cos(), c.sin_cos());
    [
        [cc * cb, cc * sb * sa - sc * ca, cc * sb * ca + sc * sa],
        [sc * cb, sc * sb * sa + cc * ca, sc * sb * ca - cc * sa],
        [-sb, cb * sa, cb * ca],
    ]
}

struct Lens {
    size: [usize; 2],
    focal: [f64; 2],
    principal: [f64; 2],
    k: [f64; 4],
}

impl Lens {
    fn bent(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [k1, k2, p1, p2] = self.k;
        let r2 = x * x + y * y;
        let radial = 1.0 + k1 * r2 + k2 * r2 * r2;
        [
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        ]
    }

    fn ray(&self, pixel: [f64; 2]) -> [f64; 2] {
        let at = [0, 1].map(|i| (pixel[i] - self.principal[i]) / self.focal[i]);
        let mut ray = at;
        for _ in 0..20 {
            let bent = self.bent(ray);
            ray = [0, 1].map(|i| ray[i] + at[i] - bent[i]);
        }
        ray
    }

    fn pixel(&self, p: V) -> [f64; 2] {
        let bent = self.bent([p[0] / p[2], p[1] / p[2]]);
        [0, 1].map(|i| self.focal[i] * bent[i] + self.principal[i])
    }
}

const CAMERA: Lens = Lens {
    size: [480, 360],
    focal: [605.0, 603.0],
    principal: [233.0, 185.0],
    k: [-0.08, 0.05, 0.0008, -0.0005],
};
/// It throws upwards, as projectors do: the principal point lies near the lower edge.
const PROJECTOR: Lens = Lens {
    size: [800, 600],
    focal: [1120.0, 1123.0],
    principal: [410.0, 540.0],
    k: [-0.03, 0.02, -0.0006, 0.0004],
};
const PITCH_MM: f64 = 18.0;
const TURN: V = [0.17, 0.26, 0.05];
const SHIFT_MM: V = [-118.0, -30.0, 40.0];

/// Poses of the board: turns, and the place of its middle.
const POSES: [(V, V); 6] = [
    ([0.35, 0.10, 0.05], [-8.0, 5.0, 330.0]),
    ([-0.30, 0.25, -0.10], [10.0, -6.0, 350.0]),
    ([0.10, -0.40, 0.20], [4.0, 8.0, 300.0]),
    ([-0.15, -0.20, 1.45], [-6.0, 0.0, 380.0]),
    ([0.40, -0.35, 0.60], [0.0, 4.0, 360.0]),
    ([-0.45, 0.05, 3.00], [6.0, 0.0, 340.0]),
];

fn board(kind: BoardKind) -> Board {
    Board {
        kind,
        points: [7, 9],
        pitch_mm: PITCH_MM,
        diameter_mm: Some(0.5 * PITCH_MM),
        bright: false,
    }
}

/// A fixed scramble of two whole numbers.
fn scramble(a: i64, b: i64) -> u64 {
    let mut x = (a as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15)
        ^ (b as u64).wrapping_mul(0xd1b5_4a32_d192_ed03);
    x ^= x >> 29;
    x = x.wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x ^ (x >> 32)
}

/// Brightness of the print; the middle of the board is at the origin, its points about it.
fn print(kind: BoardKind, [x, y]: [f64; 2]) -> f64 {
    let (white, black) = (180.0, 40.0);
    let at = [x / PITCH_MM + 3.0, y / PITCH_MM + 4.0];
    match kind {
        BoardKind::Circles => {
            let near = [at[0].round().clamp(0.0, 6.0), at[1].round().clamp(0.0, 8.0)];
            let off = (at[0] - near[0]).hypot(at[1] - near[1]);
            if off < 0.25 { black } else { white }
        }
        BoardKind::Checkerboard | BoardKind::Charuco => {
            let square = at.map(|v| v.floor() as i64);
            let inside = (-1..7).contains(&square[0]) && (-1..9).contains(&square[1]);
            let dark = inside && (square[0] + square[1]).rem_euclid(2) == 0;
            // A marker of 6 x 6 bits with a black rim fills 70 % of a white square.
            let bit = [0, 1].map(|i| ((at[i] - at[i].floor() - 0.15) / 0.7 * 6.0).floor() as i64);
            let marker =
                kind == BoardKind::Charuco && inside && bit.iter().all(|b| (0..6).contains(b));
            let rim = bit.iter().any(|b| *b == 0 || *b == 5);
            let own = scramble(square[0] * 100 + bit[0], square[1] * 100 + bit[1]);
            if dark || marker && (rim || own.is_multiple_of(2)) {
                black
            } else {
                white
            }
        }
    }
}

struct Picture {
    mean: Vec<f32>,
    columns: Vec<CellColumn>,
    rows: Vec<CellColumn>,
}

/// A pose as camera and projector show it. `moved_px`: by how much the light moved before its fringes were shown.
fn picture(kind: BoardKind, (turns, middle): (V, V), noise: f64, moved_px: f64) -> Picture {
    let axes = turned(turns);
    // Columns of the matrix are the board's axes.
    let axis = |k: usize| [axes[0][k], axes[1][k], axes[2][k]];
    let (along, across, normal) = (axis(0), axis(1), axis(2));
    let hit = |pixel: [f64; 2]| -> V {
        let [x, y] = CAMERA.ray(pixel);
        let depth = dot(normal, middle) / dot(normal, [x, y, 1.0]);
        [x * depth, y * depth, depth]
    };
    let turn = turned(TURN);
    let (mut mean, mut columns, mut rows) = (Vec::new(), Vec::new(), Vec::new());
    let mut random = Random(1);
    for row in 0..CAMERA.size[1] {
        for column in 0..CAMERA.size[0] {
            let mut light = 0.0;
            for part in 0..9 {
                let sub = [part % 3, part / 3].map(|i| (f64::from(i) - 1.0) / 3.0);
                let p = hit([column as f64 + sub[0], row as f64 + sub[1]]);
                let away = [0, 1, 2].map(|i| p[i] - middle[i]);
                light += print(kind, [dot(along, away), dot(across, away)]) / 9.0;
            }
            mean.push((light + noise * random.normal()) as f32);
            let p = hit([column as f64, row as f64]);
            let q = [0, 1, 2].map(|i| dot(turn[i], p) + SHIFT_MM[i]);
            let lit = PROJECTOR.pixel(q);
            let pixel = [column as f64, row as f64];
            let cell = |at: f64, off: f64| CellColumn {
                pixel,
                mean_e: light,
                contrast: 0.5,
                column_px: Some(at + off),
            };
            columns.push(cell(lit[0], moved_px + 0.05 * noise * random.normal()));
            rows.push(cell(lit[1], 0.05 * noise * random.normal()));
        }
    }
    Picture {
        mean,
        columns,
        rows,
    }
}

fn seen(name: &str, kind: BoardKind, picture: &Picture) -> Result<BoardView, BoardError> {
    let frames = BoardFrames {
        size_px: CAMERA.size.map(|px| px as u32),
        mean: &picture.mean,
        columns: &picture.columns,
        rows: &picture.rows,
        fringe_px: [50.0, 50.0],
    };
    find(name, &board(kind), &frames)
}

/// All poses of a board of this kind, drawn once.
fn views(kind: BoardKind) -> Vec<BoardView> {
    static DRAWN: [OnceLock<Vec<BoardView>>; 3] = [const { OnceLock::new() }; 3];
    let of_pose = |(number, pose): (usize, &(V, V))| {
        let name = format!("pose {}", number + 1);
        seen(&name, kind, &picture(kind, *pose, 1.0, 0.0)).unwrap()
    };
    let draw = || POSES.iter().enumerate().map(of_pose).collect();
    DRAWN[kind as usize].get_or_init(draw).clone()
}

fn adjusted(views: &[BoardView], kind: BoardKind) -> Result<BoardAdjusted, BoardError> {
    let sizes = [CAMERA.size, PROJECTOR.size].map(|size| size.map(|px| px as u32));
    adjust(views, board(kind).geometry(None), "synthetic", sizes)
}

/// Every value of the head within its own stated uncertainty of the truth, and the whole near it.
fn is_the_truth(adjusted: &BoardAdjusted) {
    let lens = |lens: &Lens| {
        [
            lens.focal.to_vec(),
            lens.principal.to_vec(),
            lens.k.to_vec(),
        ]
        .concat()
    };
    let lenses = [lens(&CAMERA), lens(&PROJECTOR)].concat();
    let truth = lenses
        .into_iter()
        .map(Some)
        .chain([None; 3])
        .chain(SHIFT_MM.map(Some));
    assert_eq!(adjusted.parameters.len(), 22);
    for (parameter, truth) in adjusted.parameters.iter().zip(truth) {
        let Some(truth) = truth else { continue };
        // A jackknife of six poses has five degrees of freedom; of twenty values one may be four of them off.
        let sigma = parameter.sigma.max(parameter.sigma_by_poses);
        let off = (parameter.value - truth).abs();
        assert!(off < 5.0 * sigma, "{parameter:?}, right is {truth}");
        if parameter.name.ends_with("px[0]") || parameter.name.ends_with("px[1]") {
            assert!(sigma < 0.01 * f64::from(480), "{parameter:?}");
        }
    }
    let rotation = adjusted.head.projector_from_camera.rotation;
    for (got, right) in rotation.iter().flatten().zip(turned(TURN).iter().flatten()) {
        assert!((got - right).abs() < 2e-3, "{rotation:?}");
    }
}

#[test]
fn a_checkerboard_gives_the_head_that_drew_it() {
    let views = views(BoardKind::Checkerboard);
    assert!(views.iter().all(|view| view.marks.len() == 63));
    let adjusted = adjusted(&views, BoardKind::Checkerboard).unwrap();
    assert!(
        adjusted.camera_rms_px[0] < 0.05,
        "{:?}",
        adjusted.camera_rms_px
    );
    assert!(
        adjusted.projector_rms_px[0] < 0.05,
        "{:?}",
        adjusted.projector_rms_px
    );
    is_the_truth(&adjusted);
    // A pose that the others had no part in lies on a plane, and its points a pitch apart.
    for pose in &adjusted.poses {
        let left_out = pose.left_out.unwrap();
        assert!(left_out.points_rms_um < 60.0, "{pose:?}");
        assert!(left_out.projector_rms_px < 0.3, "{pose:?}");
    }
    // Covariance and uncertainties are of one piece.
    for (index, parameter) in adjusted.parameters.iter().enumerate() {
        assert!((adjusted.covariance[index][index].sqrt() - parameter.sigma).abs() < 1e-12);
    }
}

#[test]
fn markers_in_white_squares_do_no_harm() {
    let views = views(BoardKind::Charuco);
    assert!(
        views.iter().all(|view| view.marks.len() >= 60),
        "{:?}",
        views.iter().map(|v| v.marks.len()).collect::<Vec<_>>()
    );
    is_the_truth(&adjusted(&views, BoardKind::Charuco).unwrap());
}

/// Circles of half the pitch in perspective: the middles of their images lie beside the images of their middles.
#[test]
fn circles_are_seen_as_ellipses() {
    let views = views(BoardKind::Circles);
    // One of the third pose lies too near to the image's border to see the ground about it.
    let found: Vec<usize> = views.iter().map(|view| view.marks.len()).collect();
    assert!(
        found.iter().all(|found| (62..=63).contains(found)),
        "{found:?}"
    );
    let by_circles = adjusted(&views, BoardKind::Circles).unwrap();
    assert!(
        by_circles.camera_rms_px[0] < 0.05,
        "{:?}",
        by_circles.camera_rms_px
    );
    is_the_truth(&by_circles);
}

#[test]
fn a_pose_that_does_not_fit_is_left_out_by_name() {
    let kind = BoardKind::Checkerboard;
    let mut views = views(kind);
    views[2] = seen("pose 3", kind, &picture(kind, POSES[2], 1.0, 12.0)).unwrap();
    let adjusted = adjusted(&views, kind).unwrap();
    let used: Vec<bool> = adjusted.poses.iter().map(|pose| pose.used).collect();
    assert_eq!(used, [true, true, false, true, true, true]);
    let out = adjusted.poses[2].left_out.unwrap();
    assert!(
        out.projector_rms_px > 5.0 && out.camera_rms_px < 0.1,
        "{out:?}"
    );
    is_the_truth(&adjusted);
}

/// Dirt over a corner of the board, and a board that is partly outside the image: what is seen is used.
#[test]
fn points_may_be_missing() {
    let kind = BoardKind::Checkerboard;
    let mut views = views(kind);
    let mut dirty = picture(kind, POSES[0], 1.0, 0.0);
    for (at, value) in dirty.mean.iter_mut().enumerate() {
        let (x, y) = ((at % CAMERA.size[0]) as f64, (at / CAMERA.size[0]) as f64);
        if (x - 226.0).hypot(y - 180.0) < 25.0 {
            *value = 30.0;
        }
    }
    views[0] = seen("dirty", kind, &dirty).unwrap();
    assert!((45..63).contains(&views[0].marks.len()));
    let beside = (POSES[1].0, [110.0, 10.0, 330.0]);
    views[1] = seen("beside", kind, &picture(kind, beside, 1.0, 0.0)).unwrap();
    assert!(
        (20..63).contains(&views[1].marks.len()),
        "{}",
        views[1].marks.len()
    );
    is_the_truth(&adjusted(&views, kind).unwrap());
}

#[test]
fn what_is_wrong_is_named() {
    let kind = BoardKind::Checkerboard;
    let good = picture(kind, POSES[0], 1.0, 0.0);
    // Another board than the file says.
    let smaller = Board {
        points: [7, 8],
        ..board(kind)
    };
    let frames = |picture: &'static Picture| BoardFrames {
        size_px: CAMERA.size.map(|px| px as u32),
        mean: &picture.mean,
        columns: &picture.columns,
        rows: &picture.rows,
        fringe_px: [50.0, 50.0],
    };
    let good: &'static Picture = Box::leak(Box::new(good));
    let other = find("pose", &smaller, &frames(good)).unwrap_err();
    assert!(
        matches!(
            other,
            BoardError::OtherBoard {
                expected: [7, 8],
                ..
            }
        ),
        "{other}"
    );
    let is_of_squares = kind != BoardKind::Circles;
    assert_eq!(
        other.to_string().contains("not squares"),
        is_of_squares,
        "{other}"
    );
    // No board at all.
    let blank = Picture {
        mean: vec![120.0; good.mean.len()],
        columns: good.columns.clone(),
        rows: good.rows.clone(),
    };
    let none = seen("blank", kind, &blank).unwrap_err();
    assert!(
        matches!(none, BoardError::FewPoints { got: 0, .. }),
        "{none}"
    );
    // No fringes on it.
    let unlit = Picture {
        mean: good.mean.clone(),
        columns: good.columns.clone(),
        rows: good
            .rows
            .iter()
            .map(|cell| CellColumn {
                column_px: None,
                ..*cell
            })
            .collect(),
    };
    let unlit = seen("unlit", kind, &unlit).unwrap_err();
    assert!(
        matches!(unlit, BoardError::FewLit { got: 0, of: 63, .. }),
        "{unlit}"
    );
}

/// Boards that all face the camera tell no focal length (Zhang 2000, 4: parallel planes add nothing).
#[test]
fn parallel_poses_determine_nothing() {
    let kind = BoardKind::Checkerboard;
    let facing = |index: usize| {
        let middle = [
            3.0 * index as f64,
            -2.0 * index as f64,
            320.0 + 12.0 * index as f64,
        ];
        let pose = ([0.0, 0.0, 0.3 * index as f64], middle);
        seen(
            &format!("pose {index}"),
            kind,
            &picture(kind, pose, 1.0, 0.0),
        )
        .unwrap()
    };
    let views: Vec<BoardView> = (0..4).map(facing).collect();
    let refused = adjusted(&views, kind).unwrap_err();
    assert!(
        matches!(
            refused,
            BoardError::Degenerate { .. }
                | BoardError::Hinges { .. }
                | BoardError::NoStart { .. }
                | BoardError::Singular
                | BoardError::NotSettled { .. }
        ),
        "{refused}"
    );
    let few = adjusted(&views[..3], kind).unwrap_err();
    assert_eq!(
        few,
        BoardError::FewPoses {
            got: 3,
            of: 3,
            limit: 4
        }
    );
}
