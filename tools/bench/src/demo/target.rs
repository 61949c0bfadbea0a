//! The demo's calibration target: six plates with printed dots, a blank one and two spheres on a carrier that sits where the die
//! does.

use flankscope_gear_cad::Mesh;
use nalgebra::{Isometry3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use rand_pcg::Pcg64;

use super::{HEIGHT_MM, gear};
use crate::files::{KEYS, Plate, TargetFile};
use crate::world::random::{Normals, Purpose, stream};
use crate::world::{Print, Surface, WorldConfig};

/// The plates reach this far from their middle, mm: beyond the field wherever the stages stand.
const HALF_MM: f64 = 7.0;
/// Angle from station to station of the carrier.
const STATION_RAD: f64 = std::f64::consts::FRAC_PI_4;
/// Printed plates: tilt about their x (along the die axis) and y (along the circumference) in rad, distance from the axis in mm.
const PRINTED: [([f64; 2], f64); 6] = [
    ([0.0, 0.22], 41.5),
    ([0.0, -0.22], 41.5),
    ([0.20, 0.0], 41.5),
    ([-0.20, 0.0], 41.5),
    ([0.14, 0.14], 41.0),
    ([-0.14, -0.14], 42.0),
];
/// The blank plate stands in best focus.
const BLANK_RADIUS_MM: f64 = 41.5;
/// The spheres: distance from the axis, beside and above the middle, mm. Their fronts stand 0.8 and 0.2 mm before best focus, and
/// they are 0.3 of the field's diagonal apart (VDI/VDE 2634, part 2).
const SPHERE_CENTRES_MM: [[f64; 3]; 2] = [[42.2, -1.2, -1.8], [42.8, 1.2, 1.8]];
const SPHERE_STATION: usize = PRINTED.len() + 1;
/// They are sunk into a matt ground, which keeps the picture lit.
const SPHERE_GROUND_RADIUS_MM: f64 = 43.0;
/// Reflectance of the print relative to the plate.
const INK_RATIO: f64 = 0.25;

/// A plate on the carrier's station, facing the axis: x along the axis, y along the circumference, z towards the axis.
fn plate(station: usize, tilt: [f64; 2], radius_mm: f64) -> Isometry3<f64> {
    let axes = Rotation3::from_basis_unchecked(&[Vector3::z(), Vector3::y(), -Vector3::x()]);
    let facing = UnitQuaternion::from_rotation_matrix(&axes)
        * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), tilt[0])
        * UnitQuaternion::from_axis_angle(&Vector3::y_axis(), tilt[1]);
    let place = Translation3::new(radius_mm, 0.0, HEIGHT_MM);
    let turned = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), STATION_RAD * station as f64);
    turned * Isometry3::from_parts(place, facing)
}

/// Where plates and spheres stand on the carrier, by its drawing.
#[derive(Clone, Debug)]
pub struct Carrier {
    /// The printed plates.
    pub printed: Vec<Isometry3<f64>>,
    /// The plate without print.
    pub blank: Isometry3<f64>,
    /// The centres of the two spheres, mm.
    pub sphere_centres_mm: [[f64; 3]; 2],
}

/// The demo's carrier.
#[must_use]
pub fn carrier() -> Carrier {
    let (sin, cos) = (STATION_RAD * SPHERE_STATION as f64).sin_cos();
    let printed = PRINTED.iter().enumerate();
    Carrier {
        printed: printed
            .map(|(station, &(tilt, radius_mm))| plate(station, tilt, radius_mm))
            .collect(),
        blank: plate(PRINTED.len(), [0.0; 2], BLANK_RADIUS_MM),
        sphere_centres_mm: SPHERE_CENTRES_MM.map(|[radius_mm, beside_mm, above_mm]| {
            [
                radius_mm * cos - beside_mm * sin,
                radius_mm * sin + beside_mm * cos,
                HEIGHT_MM + above_mm,
            ]
        }),
    }
}

/// A sphere's facets, rows of latitude about z: chords of 0.1 um on a radius of 1.5 mm.
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

/// The target before the demo head: its plates lie as well as the certificate says, drawn from `seed`.
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
    let ground = plate(SPHERE_STATION, [0.0; 2], SPHERE_GROUND_RADIUS_MM);
    for pose in printed.iter().chain([&blank, &ground]) {
        let first = mesh.vertices.len() as u32;
        let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
        for [x, y] in corners {
            let corner = pose * Point3::new(HALF_MM * x, HALF_MM * y, 0.0);
            mesh.vertices.push(corner.coords.into());
        }
        mesh.triangles
            .extend([[0, 1, 2], [0, 2, 3]].map(|t| t.map(|i| first + i)));
    }
    let first = target
        .sphere
        .iter()
        .map(|of| (of.centre_mm, of.diameter_mm));
    let partner = target.sphere.iter().filter_map(|of| of.partner);
    let spheres = first.chain(partner.map(|of| (of.centre_mm, of.diameter_mm)));
    for (centre_mm, diameter_mm) in spheres {
        sphere(centre_mm.into(), 0.5 * diameter_mm, &mut mesh);
    }
    let mut config = WorldConfig::new(mesh, gear());
    // Lithography on ceramic: matt, and even to a percent.
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

/// Draws how far the stages stand from where they were told, while the target is photographed.
pub struct StageErrors(Normals<Pcg64>);

impl StageErrors {
    /// Drawn from `seed`.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self(Normals::new(stream(seed, Purpose::Stages)))
    }

    /// The next error, evenly from `-half_width` to `half_width`.
    pub fn draw(&mut self, half_width: f64) -> f64 {
        half_width * (2.0 * self.0.uniform() - 1.0)
    }
}
