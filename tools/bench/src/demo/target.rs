//! The demo's calibration target: six plates with printed dots, blank plates and spheres, on a carrier at the position of the die.

use flankscope_gear_cad::Mesh;
use nalgebra::{Isometry3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use rand_pcg::Pcg64;

use super::{HEIGHT_MM, gear};
use crate::files::{KEYS, Plate, TargetFile};
use crate::world::random::{Normals, Purpose, stream};
use crate::world::{HeadDesign, Print, Surface, WorldConfig};

/// Half of a plate's side, mm: larger than the field at any position of the stages.
const HALF_MM: f64 = 7.0;
/// Angle between the carrier's stations.
const STATION_RAD: f64 = std::f64::consts::FRAC_PI_4;
/// Printed plates: tilt about their x (along the die axis) and y (along the circumference) in rad, distance beyond best focus in
/// hundredths of the field.
const PRINTED: [([f64; 2], f64); 6] = [
    ([0.0, 0.22], 0.0),
    ([0.0, -0.22], 0.0),
    ([0.20, 0.0], 0.0),
    ([-0.20, 0.0], 0.0),
    ([0.14, 0.14], -5.0),
    ([-0.14, -0.14], 5.0),
];
/// Bars of two spheres: distance beyond best focus, beside and above the middle in hundredths of the field, and diameter. The
/// fronts are nearer than best focus, and the two spheres of a bar are 0.3 of the field's diagonal apart (VDI/VDE 2634, part 2).
/// The bars lie along both diagonals of the field and from its front to its back.
const SPHERE_CENTRES: [[[f64; 3]; 2]; 3] = [
    [[7.0, -12.0, -18.0], [13.0, 12.0, 18.0]],
    [[7.0, 12.0, -18.0], [13.0, -12.0, 18.0]],
    [[4.0, -20.0, 6.0], [18.0, 20.0, -6.0]],
];
const SPHERE_DIAMETER: f64 = 24.0;
const SPHERE_STATION: usize = PRINTED.len() + 1;
/// Blank plates: tilt and distance as of the printed ones.
const BLANK: [([f64; 2], f64); 3] = [
    ([0.0, 0.0], 0.0),
    ([0.10, 0.10], -4.0),
    ([-0.10, 0.10], 4.0),
];
/// Vertical positions of the blank plates of one station, and of the bars, mm: one in the middle, one below, one above.
const ABOVE_MM: [f64; 3] = [0.0, -16.0, 16.0];
/// The spheres are embedded in a matt ground, which keeps the field lit: its distance beyond the mean of their centres, as a
/// fraction of the diameter.
const GROUND_BEYOND_CENTRES: f64 = 5.0 / 24.0;
/// Reflectance of the print relative to the plate.
const INK_RATIO: f64 = 0.25;

/// Pose of a plate on the carrier's station, facing the axis: x along the axis, y along the circumference, z towards the axis.
fn plate(station: usize, above_mm: f64, tilt: [f64; 2], radius_mm: f64) -> Isometry3<f64> {
    let axes = Rotation3::from_basis_unchecked(&[Vector3::z(), Vector3::y(), -Vector3::x()]);
    let facing = UnitQuaternion::from_rotation_matrix(&axes)
        * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), tilt[0])
        * UnitQuaternion::from_axis_angle(&Vector3::y_axis(), tilt[1]);
    let place = Translation3::new(radius_mm, 0.0, HEIGHT_MM + above_mm);
    let turned = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), STATION_RAD * station as f64);
    turned * Isometry3::from_parts(place, facing)
}

/// Design positions of plates and spheres on the carrier.
#[derive(Clone, Debug)]
pub struct Carrier {
    /// The printed plates.
    pub printed: Vec<Isometry3<f64>>,
    /// The plates without print.
    pub blanks: [Isometry3<f64>; 3],
    /// The centres of the two spheres of each bar, mm.
    pub bars_mm: [[[f64; 3]; 2]; 3],
    /// Their diameter, mm.
    pub sphere_diameter_mm: f64,
}

/// The demo's carrier for a head; the blank plate is in best focus.
#[must_use]
pub fn carrier(head: &HeadDesign) -> Carrier {
    let of_field = |hundredths: f64| head.field_mm * hundredths / 100.0;
    let beyond_focus_mm = |hundredths: f64| head.driven_radius_mm() + of_field(hundredths);
    let (sin, cos) = (STATION_RAD * SPHERE_STATION as f64).sin_cos();
    let printed = PRINTED.iter().enumerate();
    Carrier {
        printed: printed
            .map(|(station, &(tilt, beyond))| plate(station, 0.0, tilt, beyond_focus_mm(beyond)))
            .collect(),
        blanks: [0, 1, 2].map(|number| {
            let (tilt, beyond) = BLANK[number];
            let radius_mm = beyond_focus_mm(beyond);
            plate(PRINTED.len(), ABOVE_MM[number], tilt, radius_mm)
        }),
        bars_mm: [0, 1, 2].map(|number| {
            SPHERE_CENTRES[number].map(|[beyond, beside, above]| {
                let (radius_mm, beside_mm) = (beyond_focus_mm(beyond), of_field(beside));
                [
                    radius_mm * cos - beside_mm * sin,
                    radius_mm * sin + beside_mm * cos,
                    HEIGHT_MM + ABOVE_MM[number] + of_field(above),
                ]
            })
        }),
        sphere_diameter_mm: of_field(SPHERE_DIAMETER),
    }
}

/// A sphere meshed in rows of latitude about z: chord error of 0.1 µm at a radius of 1.5 mm.
fn sphere(centre: Vector3<f64>, radius_mm: f64, mesh: &mut Mesh) {
    const ROWS: u32 = 136;
    let first = mesh.vertices.len() as u32;
    let step_rad = std::f64::consts::PI / f64::from(ROWS);
    for row in 0..=ROWS {
        let (sin, cos) = (step_rad * f64::from(row)).sin_cos();
        for column in 0..2 * ROWS {
            let (y, x) = (step_rad * f64::from(column)).sin_cos();
            let vertex = centre + radius_mm * Vector3::new(sin * x, sin * y, -cos);
            mesh.vertices.push(vertex.into());
        }
    }
    for row in 0..ROWS {
        for column in 0..2 * ROWS {
            let at = |row: u32, column: u32| first + row * 2 * ROWS + column % (2 * ROWS);
            let [a, b] = [at(row, column), at(row, column + 1)];
            let [c, d] = [at(row + 1, column + 1), at(row + 1, column)];
            mesh.triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
}

/// The target in front of the demo head: its plates deviate as the certificate states, drawn from `seed`.
#[must_use]
pub fn target_world(target: &TargetFile, seed: u64) -> WorldConfig {
    let mut random = Normals::new(stream(seed, Purpose::Target));
    let mut as_built = |plate: &Plate| {
        let mut draw = |sigma: f64| Vector3::from_fn(|_, _| sigma * random.next());
        let turn = UnitQuaternion::from_scaled_axis(draw(target.pose_sigma_rad));
        let shift = draw(target.pose_sigma_mm);
        let mut pose = Isometry3::from(&plate.tool_from_plate);
        pose.rotation = turn * pose.rotation;
        pose.translation.vector += shift;
        pose
    };
    let printed: Vec<Isometry3<f64>> = target.plate.iter().map(&mut as_built).collect();
    let blank = as_built(&target.blank);
    let mut mesh = Mesh {
        vertices: Vec::new(),
        triangles: Vec::new(),
    };
    let further: Vec<Isometry3<f64>> = target.test_blank.iter().map(&mut as_built).collect();
    let artefacts = || target.sphere.iter().chain(&target.test_sphere);
    let ground = artefacts().map(|sphere| {
        let other_mm = sphere.partner.map_or(sphere.centre_mm, |of| of.centre_mm);
        let [x, y, z] = [0, 1, 2].map(|axis| 0.5 * (sphere.centre_mm[axis] + other_mm[axis]));
        let radius_mm = x.hypot(y) + GROUND_BEYOND_CENTRES * sphere.diameter_mm;
        plate(SPHERE_STATION, z - HEIGHT_MM, [0.0; 2], radius_mm)
    });
    let ground: Vec<Isometry3<f64>> = ground.collect();
    let blanks = [&[blank], &further[..], &ground].concat();
    for pose in printed.iter().chain(&blanks) {
        let first = mesh.vertices.len() as u32;
        let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
        for [x, y] in corners {
            let corner = pose * Point3::new(HALF_MM * x, HALF_MM * y, 0.0);
            mesh.vertices.push(corner.coords.into());
        }
        mesh.triangles
            .extend([[0, 1, 2], [0, 2, 3]].map(|t| t.map(|i| first + i)));
    }
    let first = artefacts().map(|of| (of.centre_mm, of.diameter_mm));
    let partner = artefacts().filter_map(|of| of.partner);
    let spheres = first.chain(partner.map(|of| (of.centre_mm, of.diameter_mm)));
    for (centre_mm, diameter_mm) in spheres {
        sphere(centre_mm.into(), 0.5 * diameter_mm, &mut mesh);
    }
    let mut config = WorldConfig::new(mesh, gear());
    // Lithography on ceramic: matt, and uniform to a percent.
    config.surface = Surface {
        roughness_ratio: 0.01,
        gloss_ratio: 0.0,
        ..Surface::sprayed()
    };
    config.print = Some(Print {
        tool_from_plate: printed,
        pitch_mm: target.dots.pitch_mm,
        radius_mm: 0.5 * target.dots.diameter_mm,
        key_radius_mm: 0.5 * target.dots.key_diameter_mm,
        keys: KEYS.to_vec(),
        reach: (HALF_MM / target.dots.pitch_mm) as i32,
        ink_ratio: INK_RATIO,
    });
    config
}

/// Random errors of the stages' positions while the target is captured.
pub struct StageErrors(Normals<Pcg64>);

impl StageErrors {
    /// Errors drawn from `seed`.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self(Normals::new(stream(seed, Purpose::Stages)))
    }

    /// The next error, uniform from `-half_width` to `half_width`.
    pub fn draw(&mut self, half_width: f64) -> f64 {
        half_width * (2.0 * self.0.uniform() - 1.0)
    }
}
