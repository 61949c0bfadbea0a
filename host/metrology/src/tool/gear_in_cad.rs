//! Gear data read from a CAD mesh: axis, teeth, involute, radii, heights.
//!
//! ```text
//!  normals of all facets  ──► direction of the axis: their covariance has one eigenvalue unlike the other two
//!  flank facets           ──► its place and the base radius: every normal of an involute touches the base circle
//!  symmetry under turns   ──► number of teeth, internal or external
//!  flank corners          ──► where left and right involutes begin: tooth centre and thickness
//! ```
//!
//! An involute has no pressure angle of its own. The data state the circle on which teeth and spaces are equally wide as pitch circle,
//! so a gear with profile shift comes out with another module and pressure angle than its drawing, and the same flanks.

use std::f64::consts::{FRAC_1_SQRT_2, PI, TAU};

use flankscope_foundation::order::{median, quantile};
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

use crate::gear::{Flank, GearData, GearKind, involute};
use crate::io::mesh::TriMesh;
use crate::registration::detect_teeth;
use crate::space::unit_normal;
use crate::surface::Surface;

/// Distance within which a turn by one pitch must bring the mesh onto itself, mm.
const REPEAT_TOLERANCE_MM: f64 = 0.02;
/// An axis this near to z counts as z: direction, rad, and place, mm.
const ON_AXIS_RAD: f64 = 1e-6;
const ON_AXIS_MM: f64 = 1e-4;
/// Least ratio by which the axis's eigenvalue differs from the others more than these do from each other.
const LEAST_DISTINCT: f64 = 3.0;
/// Corners farther from their involute are fillets, edges, or no flank, mm.
const OFF_FLANK_MM: f64 = 0.05;
/// Steps of the fit of the base radius, each of which squares what is left.
const REFINEMENTS: usize = 5;
/// Pressure angles that gear data may have, rad.
const PRESSURE_ANGLES: [f64; 2] = [5.0 * PI / 180.0, 45.0 * PI / 180.0];

/// A gear found in a mesh.
#[derive(Debug, Clone)]
pub struct FoundGear {
    /// Its data, in the tool frame.
    pub gear: GearData,
    /// The tool frame from that of the file: identity where the axis is z already.
    pub tool_from_file: Isometry3<f64>,
    /// Largest distance of the middles of 99 of 100 flank facets from the involute, mm.
    pub chord_error_mm: f64,
}

impl FoundGear {
    /// Whether the file's frame is another than the tool's.
    pub fn is_moved(&self) -> bool {
        self.tool_from_file != Isometry3::identity()
    }

    /// The tool frame from that of the file, row by row, mm.
    pub fn rows(&self) -> [[f64; 4]; 4] {
        let matrix = self.tool_from_file.to_homogeneous();
        std::array::from_fn(|row| std::array::from_fn(|column| matrix[(row, column)]))
    }
}

/// Reasons for which no gear is found.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum NoGear {
    /// No direction stands out.
    #[error(
        "no axis stands out among the directions of the surface: this is no gear with an axis of symmetry"
    )]
    NoAxis,
    /// Too little of the surface faces around the axis.
    #[error(
        "only {facets} facets face around the axis found, at least {least} are needed: this is no toothing, or a very coarse one"
    )]
    NoFlanks {
        /// Such facets.
        facets: usize,
        /// Least number.
        least: usize,
    },
    /// No turn brings the toothing onto itself.
    #[error(
        "no turn by one pitch about the axis found ({axis}) brings the surface onto itself to {tolerance_mm} mm: the teeth are not alike, \
         or the mesh is coarser than that"
    )]
    NoTeeth {
        /// Direction and place of the axis, in words.
        axis: String,
        /// Tolerance, mm.
        tolerance_mm: f64,
    },
    /// The flanks are no involutes.
    #[error(
        "half of the flank corners lie more than {off_mm:.3} mm from the involute of base radius {base_mm:.4} mm that fits best, at most \
         {most_mm} mm may: the flanks are no involutes of a spur gear"
    )]
    NoInvolute {
        /// Median distance, mm.
        off_mm: f64,
        /// Base radius, mm.
        base_mm: f64,
        /// Limit, mm.
        most_mm: f64,
    },
    /// No circle with equal teeth and spaces.
    #[error(
        "teeth and spaces are equally wide on no circle between 5 and 45 degrees of pressure angle: the profile shift is too large"
    )]
    ProfileShift,
    /// The mesh is unusable.
    #[error(transparent)]
    Mesh(#[from] crate::io::mesh::MeshError),
}

/// A facet in the frame at hand.
struct MeshFacet {
    corners: [[f64; 3]; 3],
    middle: Vector3<f64>,
    normal: Vector3<f64>,
    area_mm2: f64,
}

/// The facets with an area.
fn facets(mesh: &TriMesh) -> Vec<MeshFacet> {
    let all = (0..mesh.triangles.len()).filter_map(|index| {
        let corners = mesh.corners(index);
        let [a, b, c] = corners.map(Vector3::from);
        Some(MeshFacet {
            corners,
            middle: (a + b + c) / 3.0,
            normal: unit_normal(corners)?.into(),
            area_mm2: 0.5 * (b - a).cross(&(c - a)).norm(),
        })
    });
    all.collect()
}

/// Finds the gear that a closed, outwards oriented mesh in mm shows.
///
/// # Errors
/// [`NoGear`] with what was found instead.
pub fn find_gear(mesh: &TriMesh) -> Result<(FoundGear, TriMesh), NoGear> {
    let file_facets = facets(mesh);
    let direction = axis_direction(&file_facets)?;
    let upright = if direction.angle(&Vector3::z()) < ON_AXIS_RAD {
        UnitQuaternion::identity()
    } else {
        let turn = Rotation3::rotation_between(&direction, &Vector3::z());
        UnitQuaternion::from_rotation_matrix(
            &turn.unwrap_or_else(|| Rotation3::from_axis_angle(&Vector3::x_axis(), PI)),
        )
    };
    let turned = moved(
        mesh,
        &Isometry3::from_parts(Translation3::identity(), upright),
    );
    let [x, y] = axis_place(&facets(&turned))?;
    let shift = if x.hypot(y) < ON_AXIS_MM {
        Translation3::identity()
    } else {
        Translation3::new(-x, -y, 0.0)
    };
    let tool_from_file = Isometry3::from_parts(shift, upright);
    let mesh = moved(mesh, &tool_from_file);
    let axis = || {
        let [a, b, c]: [f64; 3] = direction.into();
        let at: Point3<f64> = tool_from_file.inverse() * Point3::origin();
        format!(
            "direction {a:.4} {b:.4} {c:.4} through {:.3} {:.3} {:.3} mm",
            at.x, at.y, at.z
        )
    };
    let surface = Surface::new(&mesh)?;
    let file_facets = facets(&mesh);
    let flanks = OnFlanks::of(&file_facets);
    let kind = flanks.kind(&file_facets);
    let teeth = detect_teeth(&mesh, &surface, REPEAT_TOLERANCE_MM);
    let teeth = teeth.ok_or_else(|| NoGear::NoTeeth {
        axis: axis(),
        tolerance_mm: REPEAT_TOLERANCE_MM,
    })?;
    let mut toothing = Toothing::of(&file_facets, &flanks, kind, teeth);
    toothing.refine();
    let (gear, chord_error_mm) = toothing.gear()?;
    let found = FoundGear {
        gear,
        tool_from_file,
        chord_error_mm,
    };
    Ok((found, mesh))
}

fn moved(mesh: &TriMesh, by: &Isometry3<f64>) -> TriMesh {
    if *by == Isometry3::identity() {
        return mesh.clone();
    }
    TriMesh {
        vertices: mesh
            .vertices
            .iter()
            .map(|&v| (by * Point3::from(v)).into())
            .collect(),
        triangles: mesh.triangles.clone(),
    }
}

/// Direction of the axis: normals of flanks and lands spread evenly around it, those of end faces lie along it.
fn axis_direction(facets: &[MeshFacet]) -> Result<Vector3<f64>, NoGear> {
    let covariance: Matrix3<f64> = facets
        .iter()
        .map(|f| f.area_mm2 * f.normal * f.normal.transpose())
        .sum();
    let eigen = covariance.symmetric_eigen();
    let value = |k: usize| eigen.eigenvalues[k % 3];
    // Of the axis's value the two others lie nearest together.
    let apart = |k: usize| (value(k + 1) - value(k + 2)).abs();
    let axis = (0..3)
        .min_by(|&a, &b| apart(a).total_cmp(&apart(b)))
        .unwrap_or(0);
    let other = 0.5 * (value(axis + 1) + value(axis + 2));
    if (value(axis) - other).abs() < LEAST_DISTINCT * apart(axis) {
        return Err(NoGear::NoAxis);
    }
    let direction: Vector3<f64> = eigen.eigenvectors.column(axis).into();
    let largest = direction[direction.iamax()];
    Ok(direction * largest.signum())
}

/// Least number of flank facets.
const LEAST_FLANKS: usize = 12;

/// Place of the axis along z: every flank normal passes it at the base radius.
fn axis_place(facets: &[MeshFacet]) -> Result<[f64; 2], NoGear> {
    let total: f64 = facets.iter().map(|f| f.area_mm2).sum();
    let mut at: Vector3<f64> = facets
        .iter()
        .map(|f| f.middle * f.area_mm2)
        .sum::<Vector3<f64>>()
        / total;
    let mut within_mm = f64::INFINITY;
    for _ in 0..8 {
        let on_flanks: Vec<(f64, &MeshFacet)> = facets
            .iter()
            .filter_map(|facet| Some((across(facet, [at.x, at.y])?, facet)))
            .collect();
        if on_flanks.len() < LEAST_FLANKS {
            return Err(NoGear::NoFlanks {
                facets: on_flanks.len(),
                least: LEAST_FLANKS,
            });
        }
        let mut arms: Vec<f64> = on_flanks.iter().map(|(arm, _)| arm.abs()).collect();
        let base_mm = median(&mut arms).unwrap_or(0.0);
        // Least squares of place and base radius, of flanks near the median.
        let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
        for (arm, facet) in on_flanks
            .iter()
            .filter(|(arm, _)| (arm.abs() - base_mm).abs() < within_mm)
        {
            let n = facet.normal;
            let row = Vector3::new(n.y, -n.x, arm.signum());
            let absolute = facet.middle.x * n.y - facet.middle.y * n.x;
            normal += facet.area_mm2 * row * row.transpose();
            right += facet.area_mm2 * absolute * row;
        }
        let Some(fit) = normal.cholesky().map(|of| of.solve(&right)) else {
            break;
        };
        (at.x, at.y) = (fit.x, fit.y);
        within_mm = (0.3 * within_mm).min(0.2 * base_mm).max(OFF_FLANK_MM);
    }
    Ok([at.x, at.y])
}

/// Lever arm of a facet's normal about an axis along z; none of a land or an end face.
fn across(facet: &MeshFacet, [x, y]: [f64; 2]) -> Option<f64> {
    let n = facet.normal;
    let [px, py] = [facet.middle.x - x, facet.middle.y - y];
    let radius = px.hypot(py);
    let arm = px * n.y - py * n.x;
    (n.z.abs() < 0.1 && radius > 0.0 && arm.abs() >= FRAC_1_SQRT_2 * radius).then_some(arm)
}

/// Corners of flanks and lands.
struct Toothing {
    kind: GearKind,
    teeth: u32,
    base_mm: f64,
    /// Corners of flank facets: side, radius, angle, height.
    flanks: Vec<(Flank, [f64; 3])>,
    /// Middles of flank facets, likewise.
    middles: Vec<(Flank, [f64; 3])>,
    /// Corners of lands: radius, angle.
    lands: Vec<[f64; 2]>,
}

/// Facets of flanks: those whose normals pass the axis at the base radius.
struct OnFlanks<'a> {
    base_mm: f64,
    /// With the side on which they lie.
    facets: Vec<(Flank, &'a MeshFacet)>,
    /// Radii that they cover, mm.
    radii_mm: [f64; 2],
}

impl<'a> OnFlanks<'a> {
    fn of(facets: &'a [MeshFacet]) -> Self {
        let arms = facets
            .iter()
            .filter_map(|facet| Some((across(facet, [0.0; 2])?, facet)));
        let arms: Vec<(f64, &MeshFacet)> = arms.collect();
        let mut sizes: Vec<f64> = arms.iter().map(|(arm, _)| arm.abs()).collect();
        let base_mm = median(&mut sizes).unwrap_or(f64::NAN);
        let is_flank = |(arm, _): &&(f64, &MeshFacet)| (arm.abs() - base_mm).abs() < 0.05 * base_mm;
        let side = |arm: f64| match arm * Flank::Left.sign() > 0.0 {
            true => Flank::Left,
            false => Flank::Right,
        };
        let kept = arms.iter().filter(is_flank);
        let kept: Vec<(Flank, &MeshFacet)> =
            kept.map(|(arm, facet)| (side(*arm), *facet)).collect();
        let corners = kept.iter().flat_map(|(_, facet)| facet.corners);
        let mut radii: Vec<f64> = corners.map(|[x, y, _]| x.hypot(y)).collect();
        Self {
            base_mm,
            radii_mm: [0.01, 0.99].map(|share| quantile(&mut radii, share).unwrap_or(f64::NAN)),
            facets: kept,
        }
    }

    /// Lands of the toothing with the cosine of their normals to the radius.
    fn lands<'f>(&self, facets: &'f [MeshFacet]) -> impl Iterator<Item = (f64, &'f MeshFacet)> {
        let [low_mm, high_mm] = self.radii_mm;
        let reach_mm = high_mm - low_mm;
        facets.iter().filter_map(move |facet| {
            let radius = facet.middle.x.hypot(facet.middle.y);
            let radial =
                (facet.middle.x * facet.normal.x + facet.middle.y * facet.normal.y) / radius;
            let is_land = radial.abs() > FRAC_1_SQRT_2
                && (low_mm - reach_mm..high_mm + reach_mm).contains(&radius);
            is_land.then_some((radial, facet))
        })
    }

    /// Lands of internal teeth face the axis, those of external ones face away from it.
    fn kind(&self, facets: &[MeshFacet]) -> GearKind {
        let outwards: f64 = self
            .lands(facets)
            .map(|(radial, facet)| radial * facet.area_mm2)
            .sum();
        match outwards < 0.0 {
            true => GearKind::Internal,
            false => GearKind::External,
        }
    }
}

impl Toothing {
    fn of(facets: &[MeshFacet], flanks: &OnFlanks<'_>, kind: GearKind, teeth: u32) -> Self {
        let place = |[x, y, z]: [f64; 3]| [x.hypot(y), y.atan2(x), z];
        let outwards = match kind {
            GearKind::Internal => -1.0,
            GearKind::External => 1.0,
        };
        let lands = flanks
            .lands(facets)
            .filter(|(radial, _)| outwards * radial > 0.0);
        let lands = lands.flat_map(|(_, facet)| facet.corners.map(place));
        let corners = |&(side, facet): &(Flank, &MeshFacet)| {
            facet.corners.map(|corner| (side, place(corner)))
        };
        let middle = |&(side, facet): &(Flank, &MeshFacet)| (side, place(facet.middle.into()));
        Self {
            kind,
            teeth,
            base_mm: flanks.base_mm,
            lands: lands.map(|[radius, angle, _]| [radius, angle]).collect(),
            flanks: flanks.facets.iter().flat_map(corners).collect(),
            middles: flanks.facets.iter().map(middle).collect(),
        }
    }

    fn pitch_rad(&self) -> f64 {
        TAU / f64::from(self.teeth)
    }

    /// Angle between the involute's beginning and its point at a radius, with the sign that it has in the tooth's half angle.
    fn roll_rad(&self, radius_mm: f64) -> Option<f64> {
        Some(self.outwards() * involute(self.base_mm / radius_mm)?)
    }

    /// Where the involutes of one side begin, modulo the pitch.
    fn begin_rad(&self, side: Flank) -> f64 {
        let pitch = self.pitch_rad();
        let begins = || {
            let of_side = self.flanks.iter().filter(move |(flank, _)| *flank == side);
            of_side.filter_map(|(_, [radius, angle, _])| {
                Some(angle - side.sign() * self.roll_rad(*radius)?)
            })
        };
        // A mean on the circle first, then the median about it, which fillets do not move.
        let rough = mean_modulo(begins(), pitch);
        let mut off: Vec<f64> = begins().map(|begin| modulo(begin - rough, pitch)).collect();
        rough + median(&mut off).unwrap_or(f64::NAN)
    }

    /// Fits the base radius to the corners, which lie on the involute where the facets' normals only nearly do: linear least squares
    /// of where both sides begin and of the base radius, repeated.
    fn refine(&mut self) {
        for _ in 0..REFINEMENTS {
            let begins = [Flank::Left, Flank::Right].map(|side| self.begin_rad(side));
            let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
            for (side, [radius, angle, _]) in &self.flanks {
                let is_left = *side == Flank::Left;
                let begin = begins[usize::from(!is_left)];
                let Some(roll) = self.roll_rad(*radius) else {
                    continue;
                };
                let off = modulo(angle - side.sign() * roll - begin, self.pitch_rad());
                if (off * self.base_mm).abs() > OFF_FLANK_MM {
                    continue;
                }
                // The involute function of the angle with cosine b / r falls with b by tan(angle) / b, so its beginning moves on.
                let tangent = (radius * radius - self.base_mm * self.base_mm).sqrt() / self.base_mm;
                let per_base = side.sign() * self.outwards() * tangent / self.base_mm;
                let row = Vector3::new(f64::from(is_left), f64::from(!is_left), -per_base);
                normal += row * row.transpose();
                right += off * row;
            }
            match normal.cholesky() {
                Some(of) => self.base_mm += of.solve(&right).z,
                None => return,
            }
        }
    }

    /// Sign with which the involute function enters a tooth's half angle.
    fn outwards(&self) -> f64 {
        match self.kind {
            GearKind::Internal => 1.0,
            GearKind::External => -1.0,
        }
    }

    fn gear(&self) -> Result<(GearData, f64), NoGear> {
        let pitch = self.pitch_rad();
        let [left, right] = [Flank::Left, Flank::Right].map(|side| self.begin_rad(side));
        let mut radii: Vec<f64> = self.lands.iter().map(|[radius, _]| *radius).collect();
        let [inner_mm, outer_mm] =
            [0.0, 1.0].map(|share| quantile(&mut radii, share).unwrap_or(f64::NAN));
        let (tip_mm, root_mm) = match self.kind {
            GearKind::Internal => (inner_mm, outer_mm),
            GearKind::External => (outer_mm, inner_mm),
        };
        let near_tip = |radius: f64| (radius - tip_mm).abs() < 0.2 * (tip_mm - root_mm).abs();
        let tips = self
            .lands
            .iter()
            .filter(|[radius, _]| near_tip(*radius))
            .map(|[_, angle]| *angle);
        let tip_centre = mean_modulo(tips, pitch);
        // The mean of both sides is a tooth's centre or that of a space: the tips tell.
        let half = 0.5 * (left + right);
        let centre = [half, half + 0.5 * pitch]
            .into_iter()
            .min_by(|a, b| {
                modulo(a - tip_centre, pitch)
                    .abs()
                    .total_cmp(&modulo(b - tip_centre, pitch).abs())
            })
            .unwrap_or(half);
        let begin = modulo(Flank::Left.sign() * (left - centre), pitch);
        let quarter = PI / (2.0 * f64::from(self.teeth));
        let rise = match self.kind {
            GearKind::Internal => quarter - begin,
            GearKind::External => begin - quarter,
        };
        let angle_rad = angle_of_involute(rise).ok_or(NoGear::ProfileShift)?;
        let module_mm = 2.0 * self.base_mm / (f64::from(self.teeth) * angle_rad.cos());
        let first_tooth_centre_deg = centre.rem_euclid(pitch).to_degrees();
        let mut gear = GearData {
            kind: self.kind,
            teeth: self.teeth,
            module_mm,
            pressure_angle_deg: angle_rad.to_degrees(),
            tip_radius_mm: tip_mm,
            root_radius_mm: root_mm,
            first_tooth_centre_deg,
            height_mm: [0.0; 2],
            radial_threshold_mm: tip_mm.max(root_mm) + module_mm,
        };
        let off = |(flank, [radius, angle, _]): &(Flank, [f64; 3])| {
            let point = [radius * angle.cos(), radius * angle.sin(), 0.0];
            Some(
                gear.involute_deviation_mm(gear.tooth_at(*angle), *flank, point)?
                    .abs(),
            )
        };
        let mut corners: Vec<f64> = self.flanks.iter().filter_map(off).collect();
        let off_mm = median(&mut corners).unwrap_or(f64::INFINITY);
        if off_mm > OFF_FLANK_MM {
            return Err(NoGear::NoInvolute {
                off_mm,
                base_mm: self.base_mm,
                most_mm: OFF_FLANK_MM,
            });
        }
        let is_on = |at: &&(Flank, [f64; 3])| off(at).is_some_and(|mm| mm < OFF_FLANK_MM);
        let heights = self.flanks.iter().filter(is_on).map(|(_, [.., z])| *z);
        let height_mm = heights.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], z| {
            [low.min(z), high.max(z)]
        });
        let on_flank = self.middles.iter().filter(is_on).filter_map(off);
        let chord_error_mm = quantile(&mut on_flank.collect::<Vec<_>>(), 0.99).unwrap_or(f64::NAN);
        gear.height_mm = height_mm;
        Ok((gear, chord_error_mm))
    }
}

/// The angle from -half to half a pitch that differs by whole pitches.
fn modulo(angle: f64, pitch: f64) -> f64 {
    angle - pitch * (angle / pitch).round()
}

/// Mean of angles that are known up to whole pitches.
fn mean_modulo(angles: impl Iterator<Item = f64>, pitch: f64) -> f64 {
    let (x, y) = angles.fold((0.0, 0.0), |(x, y), angle| {
        let phase = TAU * angle / pitch;
        (x + phase.cos(), y + phase.sin())
    });
    y.atan2(x) * pitch / TAU
}

/// The pressure angle whose involute function is that, between the limits of gear data: bisection, since it grows steadily.
fn angle_of_involute(rise: f64) -> Option<f64> {
    let of = |angle: f64| angle.tan() - angle;
    let [mut low, mut high] = PRESSURE_ANGLES;
    if !(of(low)..=of(high)).contains(&rise) {
        return None;
    }
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if of(middle) < rise {
            low = middle;
        } else {
            high = middle;
        }
    }
    Some(0.5 * (low + high))
}
