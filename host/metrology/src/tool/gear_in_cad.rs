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

use flankscope_foundation::order::quantile;
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
/// Share of the flanks' corners, by area, to which the involute is fitted first: those that lie nearest.
const NEAREST_SHARE: f64 = 0.5;
/// Share of the flanks' corners, by area, whose scatter gives the gate: fewer, since fillets may be among the nearest half.
const GATE_SHARE: f64 = 0.25;
/// Fits to the nearest corners, after each of which they are chosen anew, and then to all within the gate.
const NEAREST_FITS: usize = 30;
const GATED_FITS: usize = 15;
/// Ratio of the gate to the root mean square of the nearest quarter: 1.8 standard deviations of normally distributed ones.
const GATE_RATIO: f64 = 10.0;
/// Least width of the gate, mm: coordinates of single precision are rounded by less.
const LEAST_GATE_MM: f64 = 1e-4;
/// Halvings of the range of normals' lever arms to where they are densest.
const ARM_HALVINGS: usize = 3;
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
        "only {facets} facets face around the axis found, at least {least} are needed: this is no toothing, a very coarse one, or a helical one, which is not supported because flanks must be parallel to the axis"
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
        "half of the flanks' corners, by area, lie more than {off_mm:.3} mm from the involute of base radius {base_mm:.4} mm that fits best, at most \
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
        let base_mm = base_of_arms(&on_flanks);
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

/// Base radius of a toothing by the lever arms of its normals: where they are densest by area. Fillets have many facets and little area,
/// and their arms lie on one side.
fn base_of_arms(arms: &[(f64, &MeshFacet)]) -> f64 {
    let mut sizes: Vec<[f64; 2]> = arms
        .iter()
        .map(|(arm, facet)| [arm.abs(), facet.area_mm2])
        .collect();
    sizes.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let mut densest = &sizes[..];
    for _ in 0..ARM_HALVINGS {
        densest = densest_half(densest);
    }
    weighted_median(densest)
}

/// The narrowest run of sorted values with half of their weight.
fn densest_half(sorted: &[[f64; 2]]) -> &[[f64; 2]] {
    let half = 0.5 * sorted.iter().map(|[_, weight]| weight).sum::<f64>();
    let (mut best, mut width) = (sorted, f64::INFINITY);
    let (mut end, mut weight) = (0, 0.0);
    for start in 0..sorted.len() {
        while end < sorted.len() && weight < half {
            weight += sorted[end][1];
            end += 1;
        }
        if weight < half {
            break;
        }
        if sorted[end - 1][0] - sorted[start][0] < width {
            width = sorted[end - 1][0] - sorted[start][0];
            best = &sorted[start..end];
        }
        weight -= sorted[start][1];
    }
    best
}

/// Median of sorted values with weights; NaN of none.
fn weighted_median(sorted: &[[f64; 2]]) -> f64 {
    let half = 0.5 * sorted.iter().map(|[_, weight]| weight).sum::<f64>();
    let mut weight = 0.0;
    let at = sorted.iter().find(|value| {
        weight += value[1];
        weight >= half
    });
    at.map_or(f64::NAN, |value| value[0])
}

/// Lever arm of a facet's normal about an axis along z; none of a land or an end face.
fn across(facet: &MeshFacet, [x, y]: [f64; 2]) -> Option<f64> {
    let n = facet.normal;
    let [px, py] = [facet.middle.x - x, facet.middle.y - y];
    let radius = px.hypot(py);
    let arm = px * n.y - py * n.x;
    (n.z.abs() < 0.1 && radius > 0.0 && arm.abs() >= FRAC_1_SQRT_2 * radius).then_some(arm)
}

/// Flanks and lands, and the involutes of the flanks.
struct Toothing {
    kind: GearKind,
    teeth: u32,
    base_mm: f64,
    /// Angles at which the involutes of left and right flanks begin, modulo the pitch, rad.
    begins_rad: [f64; 2],
    /// Corners within this distance lie on the involutes, mm.
    gate_mm: f64,
    flanks: Vec<FlankFacet>,
    /// Corners of lands: radius, angle.
    lands: Vec<[f64; 2]>,
}

/// A facet that may lie on a flank. Places are radius, angle and height.
struct FlankFacet {
    side: Flank,
    corners: [[f64; 3]; 3],
    middle: [f64; 3],
    area_mm2: f64,
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
        let base_mm = base_of_arms(&arms);
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
        let on_flank = |&(side, facet): &(Flank, &MeshFacet)| FlankFacet {
            side,
            corners: facet.corners.map(place),
            middle: place(facet.middle.into()),
            area_mm2: facet.area_mm2,
        };
        let mut toothing = Self {
            kind,
            teeth,
            base_mm: flanks.base_mm,
            begins_rad: [f64::NAN; 2],
            gate_mm: OFF_FLANK_MM,
            lands: lands.map(|[radius, angle, _]| [radius, angle]).collect(),
            flanks: flanks.facets.iter().map(on_flank).collect(),
        };
        toothing.begins_rad = [Flank::Left, Flank::Right].map(|side| toothing.begin_rad(side));
        toothing
    }

    fn pitch_rad(&self) -> f64 {
        TAU / f64::from(self.teeth)
    }

    /// Angle between the involute's beginning and its point at a radius, with the sign that it has in the tooth's half angle.
    fn roll_rad(&self, radius_mm: f64) -> Option<f64> {
        Some(self.outwards() * involute(self.base_mm / radius_mm)?)
    }

    /// Corners of the facets, with a third of the facet's area each.
    fn corners(&self) -> impl Iterator<Item = (Flank, [f64; 3], f64)> {
        self.flanks.iter().flat_map(|facet| {
            let weight_mm2 = facet.area_mm2 / 3.0;
            facet.corners.map(|corner| (facet.side, corner, weight_mm2))
        })
    }

    /// Angle at which the involutes of one side begin, modulo the pitch, by the base radius of the normals: the densest by area.
    fn begin_rad(&self, side: Flank) -> f64 {
        let pitch = self.pitch_rad();
        let begins = || {
            let of_side = self.corners().filter(move |(flank, ..)| *flank == side);
            of_side.filter_map(|(_, [radius, angle, _], weight_mm2)| {
                Some([angle - side.sign() * self.roll_rad(radius)?, weight_mm2])
            })
        };
        // A mean on the circle first, then the densest about it, which fillets do not move.
        let rough = mean_modulo(begins(), pitch);
        let mut off: Vec<[f64; 2]> = begins()
            .map(|[begin, weight_mm2]| [modulo(begin - rough, pitch), weight_mm2])
            .collect();
        off.sort_by(|a, b| a[0].total_cmp(&b[0]));
        rough + weighted_median(densest_half(&off))
    }

    /// Distance of a place from the involute of its side, along the normal, mm; none within the base circle.
    fn off_mm(&self, side: Flank, [radius, angle, _]: [f64; 3]) -> Option<f64> {
        let begin = self.begins_rad[usize::from(side != Flank::Left)];
        let off = angle - side.sign() * self.roll_rad(radius)? - begin;
        Some(self.base_mm * modulo(off, self.pitch_rad()))
    }

    /// Fits the involutes to the corners, which lie on them where the facets' normals only nearly do: first to that half of the area
    /// which lies nearest, chosen anew after every fit (least trimmed squares, Rousseeuw and Van Driessen 2006), then to all within a
    /// gate that follows from its scatter. Fillets tangent to the flanks, chamfers, rounded tips and tip relief are outside the gate.
    ///
    /// The trimmed fit is begun with all corners and with those of parts of the flank's height; the best of these counts.
    fn refine(&mut self) {
        let start = (self.base_mm, self.begins_rad);
        let mut best = (f64::INFINITY, start);
        for [low_mm, high_mm] in self.start_radii_mm() {
            (self.base_mm, self.begins_rad) = start;
            let mut is_fitted = self.fit(OFF_FLANK_MM, [low_mm, high_mm]);
            for _ in 0..NEAREST_FITS {
                is_fitted =
                    is_fitted && self.fit(self.nearest_mm(NEAREST_SHARE), [0.0, f64::INFINITY]);
            }
            let rms_mm = self.rms_mm(self.nearest_mm(NEAREST_SHARE));
            if is_fitted && rms_mm < best.0 {
                best = (rms_mm, (self.base_mm, self.begins_rad));
            }
        }
        (self.base_mm, self.begins_rad) = best.1;
        for _ in 0..GATED_FITS {
            let rms_mm = self.rms_mm(self.nearest_mm(GATE_SHARE));
            self.gate_mm = (GATE_RATIO * rms_mm).clamp(LEAST_GATE_MM, OFF_FLANK_MM);
            self.fit(self.gate_mm, [0.0, f64::INFINITY]);
        }
    }

    /// All radii, and parts of those on the flanks.
    fn start_radii_mm(&self) -> [[f64; 2]; 4] {
        let mut radii: Vec<f64> = self.corners().map(|(_, [radius, ..], _)| radius).collect();
        let at = |share| quantile(&mut radii, share).unwrap_or(f64::NAN);
        let [low, first, second, high] = [0.0, 0.35, 0.65, 1.0].map(at);
        [[low, high], [low, second], [first, high], [first, second]]
    }

    /// Root mean square distance of corners within a distance, weighted by area, mm.
    fn rms_mm(&self, within_mm: f64) -> f64 {
        let (mut squares, mut weight) = (0.0, 0.0);
        for (side, corner, weight_mm2) in self.corners() {
            let off = self.off_mm(side, corner);
            if let Some(off) = off.filter(|off| off.abs() <= within_mm) {
                squares += weight_mm2 * off * off;
                weight += weight_mm2;
            }
        }
        (squares / weight).sqrt()
    }

    /// Distance within which a share of the corners lies, by area, mm.
    fn nearest_mm(&self, share: f64) -> f64 {
        let mut off: Vec<[f64; 2]> = self
            .corners()
            .map(|(side, corner, weight_mm2)| {
                let off = self.off_mm(side, corner);
                [off.map_or(f64::INFINITY, f64::abs), weight_mm2]
            })
            .collect();
        off.sort_by(|a, b| a[0].total_cmp(&b[0]));
        let most = share * off.iter().map(|[_, weight]| weight).sum::<f64>();
        let mut weight = 0.0;
        let last = off.iter().find(|value| {
            weight += value[1];
            weight >= most
        });
        last.map_or(f64::NAN, |value| value[0])
    }

    /// Linear least squares of where both sides begin and of the base radius, of corners within a distance and between two radii,
    /// weighted by area. Returns whether there was a solution.
    fn fit(&mut self, within_mm: f64, [low_mm, high_mm]: [f64; 2]) -> bool {
        let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
        for (side, corner, weight_mm2) in self.corners() {
            let is_used =
                |off: &f64| off.abs() <= within_mm && (low_mm..=high_mm).contains(&corner[0]);
            let Some(off) = self.off_mm(side, corner).filter(is_used) else {
                continue;
            };
            // The involute function of the angle with cosine b / r falls with b by tan(angle) / b, so its beginning moves on.
            let [radius, ..] = corner;
            let tangent = (radius * radius - self.base_mm * self.base_mm).sqrt() / self.base_mm;
            let per_base = side.sign() * self.outwards() * tangent / self.base_mm;
            let is_left = side == Flank::Left;
            let row = Vector3::new(f64::from(is_left), f64::from(!is_left), -per_base);
            normal += weight_mm2 * row * row.transpose();
            right += weight_mm2 * off / self.base_mm * row;
        }
        let Some(step) = normal.cholesky().map(|factor| factor.solve(&right)) else {
            return false;
        };
        self.begins_rad[0] += step.x;
        self.begins_rad[1] += step.y;
        self.base_mm += step.z;
        true
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
        let [left, right] = self.begins_rad;
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
            .map(|[_, angle]| [*angle, 1.0]);
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
        // A tooth's half angle is below half a pitch on the flank. At the base circle it may be above.
        let middle_mm = (0.5 * (tip_mm + root_mm)).max(self.base_mm);
        let roll = self.roll_rad(middle_mm).unwrap_or(f64::NAN);
        let begin = modulo(Flank::Left.sign() * (left - centre) + roll, pitch) - roll;
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
        let mut off: Vec<[f64; 2]> = self
            .corners()
            .filter_map(|(side, corner, weight_mm2)| {
                Some([self.off_mm(side, corner)?.abs(), weight_mm2])
            })
            .collect();
        off.sort_by(|a, b| a[0].total_cmp(&b[0]));
        let off_mm = weighted_median(&off);
        if off_mm.is_nan() || off_mm > OFF_FLANK_MM {
            return Err(NoGear::NoInvolute {
                off_mm,
                base_mm: self.base_mm,
                most_mm: OFF_FLANK_MM,
            });
        }
        let is_within = |side: Flank, corner: [f64; 3], most_mm: f64| {
            self.off_mm(side, corner)
                .is_some_and(|off| off.abs() <= most_mm)
        };
        let on_flank = self
            .corners()
            .filter(|&(side, corner, _)| is_within(side, corner, OFF_FLANK_MM));
        let height_mm = on_flank
            .map(|(_, [.., z], _)| z)
            .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], z| {
                [low.min(z), high.max(z)]
            });
        let chords = self.flanks.iter().filter(|facet| {
            let mut corners = facet.corners.iter();
            corners.all(|corner| is_within(facet.side, *corner, self.gate_mm))
        });
        let chords = chords.filter_map(|facet| Some(self.off_mm(facet.side, facet.middle)?.abs()));
        let chord_error_mm = quantile(&mut chords.collect::<Vec<_>>(), 0.99).unwrap_or(f64::NAN);
        gear.height_mm = height_mm;
        Ok((gear, chord_error_mm))
    }
}

/// The angle from -half to half a pitch that differs by whole pitches.
fn modulo(angle: f64, pitch: f64) -> f64 {
    angle - pitch * (angle / pitch).round()
}

/// Mean of angles that are known up to whole pitches, each with a weight.
fn mean_modulo(angles: impl Iterator<Item = [f64; 2]>, pitch: f64) -> f64 {
    let (x, y) = angles.fold((0.0, 0.0), |(x, y), [angle, weight]| {
        let phase = TAU * angle / pitch;
        (x + weight * phase.cos(), y + weight * phase.sin())
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
