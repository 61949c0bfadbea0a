//! The article's figures 5, 10, 15 and 18 as pictures of objects in space: toothing, cameras, the initial transformation and the
//! final cloud.

use std::f64::consts::PI;

use flankscope_metrology::io::mesh::TriMesh;

use super::colour;
use super::space::Canvas;
use flankscope_article::InSpace;

const HALF_PX: [usize; 2] = [570, 480];
const SMALL_PX: [usize; 2] = [380, 400];
/// Elevations of the viewer: into the bore, and along the flanks of a window.
const INTO_BORE_RAD: f64 = 0.62;
const ONTO_WINDOW_RAD: f64 = 0.35;
/// Half of the displayed length at edges and corners, mm.
const CLOSE_MM: f64 = 1.5;
/// Length of the axes of a frame, mm.
const AXIS_MM: f64 = 10.0;
/// Number of colours; few keep the palette small.
const COLOURS: f64 = 48.0;

const BLUE: [u8; 3] = [43, 108, 176];
const ORANGE: [u8; 3] = [224, 134, 43];
const GREEN: [u8; 3] = [27, 127, 92];
const RED: [u8; 3] = [163, 20, 42];
const INK: [u8; 3] = [60, 70, 84];

/// The pictures, as `data:` addresses.
pub(super) struct Scenes {
    /// Camera and field of every view (figure 5).
    pub cameras: String,
    /// The first view in its camera frame and at the initial transformation (figure 10).
    pub initial: String,
    /// Faces, edges and corners of the CAD, and random reference points, in the first view's window (figure 15).
    pub stored: [String; 3],
    /// The final cloud, one half of the bore each (figure 18).
    pub cloud: [String; 2],
}

impl Scenes {
    /// Draws the pictures; distances of the final cloud are coloured up to `full_um`.
    pub(super) fn of(space: &InSpace, full_um: f64) -> Self {
        let [cx, cy, _] = space.window_centre_mm;
        // Opposite to the first view and slightly to the side, so that the wall of that view is the far one.
        let azimuth_rad = cy.atan2(cx) + PI + 0.4;
        Self {
            cameras: cameras(space, azimuth_rad),
            initial: initial(space, azimuth_rad),
            stored: stored(space),
            cloud: [0.0, PI].map(|turn| cloud(space, azimuth_rad + turn, full_um)),
        }
    }
}

/// View from above and the side.
fn into_bore<'a>(points_mm: impl IntoIterator<Item = &'a [f64; 3]>, azimuth_rad: f64) -> Canvas {
    let points_mm = points_mm.into_iter().copied();
    Canvas::fitting(points_mm, HALF_PX, [azimuth_rad, INTO_BORE_RAD])
}

/// The near wall is transparent.
fn is_far(canvas: &Canvas, point_mm: [f64; 3]) -> bool {
    let [x, y, _] = canvas.towards();
    point_mm[0] * x + point_mm[1] * y < 0.0
}

fn draw_far_wall(canvas: &mut Canvas, toothing: &TriMesh) {
    for index in 0..toothing.triangles.len() {
        let corners = toothing.corners(index);
        if corners.into_iter().all(|corner| is_far(canvas, corner)) {
            canvas.face(corners);
        }
    }
}

fn draw_faces(canvas: &mut Canvas, mesh: &TriMesh) {
    for index in 0..mesh.triangles.len() {
        canvas.face(mesh.corners(index));
    }
}

/// The axes of a frame, from its origin to their ends along x, y and z.
fn draw_axes(canvas: &mut Canvas, origin_mm: [f64; 3], ends_mm: [[f64; 3]; 3]) {
    for (end, colour) in ends_mm.into_iter().zip([RED, GREEN, BLUE]) {
        canvas.line([origin_mm, end], colour);
    }
}

fn cameras(space: &InSpace, azimuth_rad: f64) -> String {
    let mut canvas = into_bore(&space.toothing.vertices, azimuth_rad);
    draw_far_wall(&mut canvas, &space.toothing);
    for &[camera_mm, seen_mm] in &space.cameras_mm {
        canvas.line([camera_mm, seen_mm], ORANGE);
        canvas.dot(camera_mm, 4, INK);
    }
    canvas.data_uri()
}

fn initial(space: &InSpace, azimuth_rad: f64) -> String {
    let mut canvas = into_bore(&space.toothing.vertices, azimuth_rad);
    draw_far_wall(&mut canvas, &space.toothing);
    for &point in &space.first_camera_mm {
        canvas.dot(point, 2, ORANGE);
    }
    for &point in &space.first_start_mm {
        canvas.dot(point, 2, BLUE);
    }
    let ends = [0, 1, 2].map(|axis| [0, 1, 2].map(|k| if k == axis { AXIS_MM } else { 0.0 }));
    draw_axes(&mut canvas, [0.0; 3], ends);
    canvas.data_uri()
}

/// Reference data of the window: faces, edges with corners, and random points on the surface.
fn stored(space: &InSpace) -> [String; 3] {
    let [cx, cy, _] = space.window_centre_mm;
    let window = &space.window;
    let direction = [cy.atan2(cx) + PI + ONTO_WINDOW_RAD, ONTO_WINDOW_RAD];
    let canvas = || Canvas::fitting(window.vertices.iter().copied(), SMALL_PX, direction);
    // Faces extend over the die's height, with corners at their ends, so a tooth at the window's upper end is shown.
    let top_mm = window.vertices.iter().map(|p| p[2]).fold(0.0, f64::max);
    let about = [-1.0, 1.0].map(|way| [cx, cy, top_mm - CLOSE_MM].map(|at| at + way * CLOSE_MM));
    let close = Canvas::fitting(about.into_iter(), SMALL_PX, direction);
    let mut faces = canvas();
    draw_faces(&mut faces, window);
    let mut edges = close;
    draw_faces(&mut edges, window);
    for index in 0..window.triangles.len() {
        let [a, b, c] = window.corners(index);
        for ends in [[a, b], [b, c], [c, a]] {
            edges.line(ends, BLUE);
        }
        for corner in [a, b, c] {
            edges.dot(corner, 3, RED);
        }
    }
    let mut points = canvas();
    draw_faces(&mut points, window);
    for &point in &space.window_points_mm {
        points.dot(point, 2, ORANGE);
    }
    [faces, edges, points].map(|canvas| canvas.data_uri())
}

/// The points of the far wall.
fn cloud(space: &InSpace, azimuth_rad: f64, full_um: f64) -> String {
    let mut canvas = into_bore(space.cloud.iter().map(|(point, _)| point), azimuth_rad);
    for &(point, um) in &space.cloud {
        if is_far(&canvas, point) {
            let share = (um / full_um * COLOURS).round() / COLOURS;
            canvas.dot(point, 1, colour::sequential(share));
        }
    }
    canvas.data_uri()
}
