//! Patches: any parts of the CAD that a tool file names, each with a frame of its own.
//!
//! ```text
//!            up                 normal: mean of the facets', out of the material
//!             │  ┌─────────┐    up: the direction that the file names, as far as it lies across the normal
//!             │  │  zone   │    along = up x normal
//!   normal ⊙──┼──│─ along  │    origin: where the file says, else the middle of the patch
//!             │  └─────────┘    zone: the judged rectangle, wholly on the patch
//! ```
//!
//! A patch is laid out by projection along its normal, so its facets must not lean away from it by more than
//! [`MOST_LEAN_RAD`]: areas are then at most 15 % larger than they count.
//!
//! Wear that is the same all over a patch looks like a patch that has moved, and its own points cannot tell which. So the pose
//! of a view never rests on a patch that is judged, but on its **datum**: other patches, which the press does not touch.

mod chord;
mod clip;
mod pick;

use nalgebra::Vector3;

use crate::io::mesh::TriMesh;
use crate::surface::Surface;
pub use pick::{ON_CAD_MM, Pick, SEED_ANGLE_DEG};

/// A facet leans at most so far from the normal of its patch, rad.
pub const MOST_LEAN_RAD: f64 = std::f64::consts::FRAC_PI_6;
/// Between the rim of a patch and a zone that is not stated, mm: stages do not place a view along a plane to better than that.
pub const RIM_MM: f64 = 0.25;
/// A zone lies on its patch when so little of it does not: chords of round outlines, slivers.
const MOST_OFF_PATCH: f64 = 1e-4;
/// Patches that share less than this touch, mm2.
const TOUCHING_MM2: f64 = 1e-6;
/// The direction that is up across a normal is at least so far from it: the sine.
const LEAST_ACROSS: f64 = 0.1;
/// Coordinates beyond this are a slip of the pen, mm.
const FARTHEST_MM: f64 = 1e5;

/// A patch as a tool file names it.
#[derive(Debug, Clone, PartialEq)]
pub struct PatchSpec {
    /// Its name.
    pub name: String,
    /// Selection of the facets.
    pub pick: Pick,
    /// Of them, what lies in this box: least and largest x, y, z, mm.
    pub box_mm: Option<[[f64; 3]; 2]>,
    /// Origin of its frame, mm.
    pub origin_mm: Option<[f64; 3]>,
    /// Direction of its height; the tool's z, or y where the patch faces along z.
    pub up: Option<[f64; 3]>,
    /// The judged rectangle along and up from the origin, mm: least and largest of each.
    pub zone_mm: Option<[[f64; 2]; 2]>,
    /// Names of the patches that the pose rests on when this one is judged; without any, it is not judged.
    pub datum: Vec<String>,
}

/// Reasons for which the patches of a tool file are refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PatchError {
    /// A number that is no place or length.
    #[error("patch {name:?}: {key} has {got}; right would be a finite number within ±{limit}")]
    Number {
        /// Patch.
        name: String,
        /// Key in the tool file.
        key: &'static str,
        /// The number.
        got: f64,
        /// Largest magnitude.
        limit: f64,
    },
    /// Ends in the wrong order.
    #[error(
        "patch {name:?}: {key} goes from {from} to {to}; right would be from the lower to the higher end"
    )]
    Order {
        /// Patch.
        name: String,
        /// Key in the tool file.
        key: &'static str,
        /// First end.
        from: f64,
        /// Second end.
        to: f64,
    },
    /// Two patches have one name.
    #[error("two patches are called {name:?}; each needs a name of its own, not empty")]
    Name {
        /// The name.
        name: String,
    },
    /// A triangle that the CAD does not have.
    #[error("patch {name:?}: facet {got} is not in the CAD, whose facets are 0 to {}", count - 1)]
    NoFacet {
        /// Patch.
        name: String,
        /// The facet.
        got: u32,
        /// Facets there are.
        count: usize,
    },
    /// A point that should lie on the CAD does not.
    #[error(
        "patch {name:?}: {key} is {off_mm:.3} mm off the CAD, at most {limit_mm} mm are allowed; take a point of the mesh, in mm"
    )]
    OffCad {
        /// Patch.
        name: String,
        /// Key in the tool file.
        key: &'static str,
        /// Distance.
        off_mm: f64,
        /// Limit.
        limit_mm: f64,
    },
    /// No surface at all.
    #[error(
        "patch {name:?} is empty: no facet of the CAD with area lies in it; check seed_mm, facets and box_mm"
    )]
    Empty {
        /// Patch.
        name: String,
    },
    /// Facets that lean away from the rest.
    #[error(
        "patch {name:?}: facet {facet} leans {lean_deg:.0} degrees from the patch's normal, at most {limit_deg:.0} are allowed; name a smaller patch"
    )]
    Lean {
        /// Patch.
        name: String,
        /// Facet.
        facet: u32,
        /// Angle.
        lean_deg: f64,
        /// Largest.
        limit_deg: f64,
    },
    /// Up is nowhere across the patch.
    #[error("patch {name:?}: up lies along its normal; right would be a direction across it, such as [{}, {}, {}]", try_instead[0], try_instead[1], try_instead[2])]
    Up {
        /// Patch.
        name: String,
        /// A direction that would do.
        try_instead: [f64; 3],
    },
    /// The judged rectangle reaches over the patch's rim.
    #[error(
        "patch {name:?}: only {:.1} % of its zone of {:.2} x {:.2} mm lie on the patch; state a zone_mm that lies on it wholly (the patch reaches from {:.2} to {:.2} mm along and from {:.2} to {:.2} mm up from its origin)",
        100.0 * share, size_mm[0], size_mm[1], reach_mm[0][0], reach_mm[0][1], reach_mm[1][0], reach_mm[1][1]
    )]
    ZoneOffPatch {
        /// Patch.
        name: String,
        /// Share on the patch.
        share: f64,
        /// Size of the zone.
        size_mm: [f64; 2],
        /// The patch's rectangle.
        reach_mm: [[f64; 2]; 2],
    },
    /// The disc of the measurand does not fit.
    #[error("patch {name:?}: a disc of {area_mm2} mm2 (inspect.wear_area_mm2) does not fit into its zone of {:.2} x {:.2} mm; at most {most_mm2:.3} mm2 would", size_mm[0], size_mm[1])]
    NoDisc {
        /// Patch.
        name: String,
        /// Area of the disc.
        area_mm2: f64,
        /// Size of the zone.
        size_mm: [f64; 2],
        /// Largest disc.
        most_mm2: f64,
    },
    /// Two patches share some surface.
    #[error("patches {:?} and {:?} share {area_mm2:.4} mm2 of facet {facet}; a point belongs to one of them: part them by box_mm", names[0], names[1])]
    Overlap {
        /// Both.
        names: [String; 2],
        /// A facet of both.
        facet: u32,
        /// Share of it that they have in common.
        area_mm2: f64,
    },
    /// A datum that does not determine the pose.
    #[error("patch {name:?}: datum {datum:?} {why}")]
    Datum {
        /// Patch.
        name: String,
        /// Its datum.
        datum: String,
        /// The error.
        why: &'static str,
    },
    /// Nothing is judged, or something stands for nothing.
    #[error(
        "patch {name:?} has no datum and is none: wear that is the same all over a patch cannot be told from a patch that has moved; name in datum the patches that the press does not touch"
    )]
    NoDatum {
        /// Patch.
        name: String,
    },
}

/// A part of the CAD with its frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Patch {
    /// Its name.
    pub name: String,
    /// Origin of its frame, mm.
    pub origin_mm: [f64; 3],
    /// Unit vectors along, up and out of the material.
    pub axes: [[f64; 3]; 3],
    /// Judged rectangle along and up from the origin, mm.
    pub zone_mm: [[f64; 2]; 2],
    /// Its surface, mm2.
    pub area_mm2: f64,
    low: [f64; 3],
    high: [f64; 3],
    /// Its triangles, ascending.
    triangles: Vec<u32>,
    /// Patches that the pose rests on, from 1; none when it is not judged.
    datum: Vec<u32>,
}

impl Patch {
    /// A place along and up from its origin, mm.
    pub fn place_mm(&self, point: [f64; 3]) -> [f64; 2] {
        let from = Vector3::from(point) - Vector3::from(self.origin_mm);
        [0, 1].map(|k| from.dot(&Vector3::from(self.axes[k])))
    }

    /// The point of its reference plane at such a place, mm.
    pub fn point_mm(&self, [along, up]: [f64; 2]) -> [f64; 3] {
        let [a, u] = [0, 1].map(|k| Vector3::from(self.axes[k]));
        (Vector3::from(self.origin_mm) + a * along + u * up).into()
    }

    /// Whether it is judged, which needs a datum.
    pub fn is_judged(&self) -> bool {
        !self.datum.is_empty()
    }

    /// Whether the pose may rest on patch `number` (from 1) when this one is judged.
    pub fn rests_on(&self, number: u32) -> bool {
        self.datum.contains(&number)
    }

    fn holds(&self, triangle: u32, point: [f64; 3]) -> bool {
        self.triangles.binary_search(&triangle).is_ok()
            && (0..3).all(|k| (self.low[k]..=self.high[k]).contains(&point[k]))
    }
}

/// All patches of a tool; numbers count them from 1 in the order of its file.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Patches(Vec<Patch>);

impl Patches {
    /// Lays them out on the CAD.
    ///
    /// # Errors
    /// [`PatchError`] with name, value, limit, and what would be right.
    pub fn new(
        specs: &[PatchSpec],
        mesh: &TriMesh,
        surface: &Surface,
        disc_mm2: f64,
    ) -> Result<Self, PatchError> {
        let mut patches: Vec<Patch> = Vec::with_capacity(specs.len());
        for spec in specs {
            let same = |other: &Patch| other.name == spec.name;
            if spec.name.trim().is_empty() || patches.iter().any(same) {
                return Err(PatchError::Name {
                    name: spec.name.clone(),
                });
            }
            patches.push(laid_out(spec, mesh, surface)?);
        }
        for (i, patch) in patches.iter().enumerate() {
            for other in &patches[..i] {
                apart(other, patch, mesh)?;
            }
        }
        let datums = specs.iter().map(|spec| numbers_of(spec, specs));
        let datums: Vec<Vec<u32>> = datums.collect::<Result<_, _>>()?;
        for (number, spec) in (1..).zip(specs) {
            if spec.datum.is_empty() && !datums.iter().flatten().any(|&of| of == number) {
                return Err(PatchError::NoDatum {
                    name: spec.name.clone(),
                });
            }
        }
        for (patch, datum) in patches.iter_mut().zip(datums) {
            patch.datum = datum;
            if patch.is_judged() {
                zone_on(patch, mesh)?;
                disc_in(patch, disc_mm2)?;
            }
        }
        Ok(Self(patches))
    }

    /// Whether the tool has no patches.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// One of them; numbers count from 1.
    pub fn get(&self, number: u32) -> Option<&Patch> {
        self.0.get((number as usize).checked_sub(1)?)
    }

    /// Numbers of those that are judged.
    pub fn judged(&self) -> Vec<u32> {
        let numbered = (1..).zip(&self.0);
        let judged = numbered.filter(|(_, patch)| patch.is_judged());
        judged.map(|(number, _)| number).collect()
    }

    /// The patch that a point of a triangle lies on, and its number.
    pub fn at(&self, triangle: u32, point: [f64; 3]) -> Option<(u32, &Patch)> {
        (1..)
            .zip(&self.0)
            .find(|(_, patch)| patch.holds(triangle, point))
    }
}

/// Numbers of the patches that one names as its datum.
fn numbers_of(spec: &PatchSpec, specs: &[PatchSpec]) -> Result<Vec<u32>, PatchError> {
    let number = |datum: &String| {
        let wrong = |why| PatchError::Datum {
            name: spec.name.clone(),
            datum: datum.clone(),
            why,
        };
        let found = specs.iter().position(|other| other.name == *datum);
        let at = found.ok_or(wrong(
            "is no patch of this file; right would be a [[patch]]'s name",
        ))?;
        if specs[at].datum.is_empty() {
            Ok(at as u32 + 1)
        } else {
            Err(wrong(
                "is judged itself: its wear would move the pose; right would be a patch without a datum, which the press does not touch",
            ))
        }
    };
    spec.datum.iter().map(number).collect()
}

/// Every number of a patch's file is one.
fn numbers(spec: &PatchSpec) -> Result<(), PatchError> {
    let seed = match spec.pick {
        Pick::Seed(at, angle) => vec![("seed_mm", at.to_vec()), ("angle_deg", vec![angle])],
        Pick::Facets(_) | Pick::All => Vec::new(),
    };
    let flat = |pairs: &[[f64; 2]; 2]| pairs.as_flattened().to_vec();
    let stated = [
        ("box_mm", spec.box_mm.map(|b| b.as_flattened().to_vec())),
        ("origin_mm", spec.origin_mm.map(|of| of.to_vec())),
        ("up", spec.up.map(|of| of.to_vec())),
        ("zone_mm", spec.zone_mm.as_ref().map(flat)),
    ];
    let stated = stated
        .into_iter()
        .filter_map(|(key, values)| Some((key, values?)));
    for (key, values) in seed.into_iter().chain(stated) {
        let near = |x: &&f64| (-FARTHEST_MM..=FARTHEST_MM).contains(*x);
        // Comparisons with NaN are false: a distance that is not a number is not near.
        if let Some(&got) = values.iter().find(|x| !near(x)) {
            return Err(PatchError::Number {
                name: spec.name.clone(),
                key,
                got,
                limit: FARTHEST_MM,
            });
        }
    }
    let boxes = spec
        .box_mm
        .map(|[low, high]| [0, 1, 2].map(|k| [low[k], high[k]]));
    let ends = boxes.iter().flatten().map(|ends| ("box_mm", ends));
    let zones = spec.zone_mm.iter().flatten().map(|ends| ("zone_mm", ends));
    for (key, &[from, to]) in ends.chain(zones) {
        if from >= to {
            return Err(PatchError::Order {
                name: spec.name.clone(),
                key,
                from,
                to,
            });
        }
    }
    Ok(())
}

/// One patch by itself: its facets, its frame, its rectangle.
fn laid_out(spec: &PatchSpec, mesh: &TriMesh, surface: &Surface) -> Result<Patch, PatchError> {
    numbers(spec)?;
    let name = || spec.name.clone();
    let (low, high) = spec
        .box_mm
        .map_or(([f64::NEG_INFINITY; 3], [f64::INFINITY; 3]), |[a, b]| {
            (a, b)
        });
    let mut parts: Vec<(u32, Vec<Vector3<f64>>, Vector3<f64>)> = Vec::new();
    for triangle in spec.pick.triangles(&spec.name, mesh, surface)? {
        let corners = mesh.corners(triangle as usize).map(Vector3::from);
        let polygon = clip::clipped(&corners, low, high);
        let area = clip::area_vector(&polygon);
        if area.norm() > 0.0 {
            parts.push((triangle, polygon, area));
        }
    }
    let sum: Vector3<f64> = parts.iter().map(|(_, _, area)| area).sum();
    let area_mm2: f64 = parts.iter().map(|(_, _, area)| area.norm()).sum();
    let Some(normal) = sum.try_normalize(0.0) else {
        return Err(PatchError::Empty { name: name() });
    };
    let most = MOST_LEAN_RAD.cos() - 1e-9;
    let steep = |(_, _, area): &&(u32, _, Vector3<f64>)| area.dot(&normal) < most * area.norm();
    if let Some((facet, _, area)) = parts.iter().find(steep) {
        return Err(PatchError::Lean {
            name: name(),
            facet: *facet,
            lean_deg: (area.dot(&normal) / area.norm()).acos().to_degrees(),
            limit_deg: MOST_LEAN_RAD.to_degrees(),
        });
    }
    let axes = frame(spec, normal)?;
    let middle: Vector3<f64> = parts
        .iter()
        .map(|(_, polygon, area)| {
            let corners = polygon.iter().sum::<Vector3<f64>>() / polygon.len() as f64;
            corners * (area.norm() / area_mm2)
        })
        .sum();
    if let Some(origin) = spec.origin_mm {
        let off_mm = surface.closest(origin).signed_distance_mm.abs();
        if off_mm > ON_CAD_MM {
            return Err(PatchError::OffCad {
                name: name(),
                key: "origin_mm",
                off_mm,
                limit_mm: ON_CAD_MM,
            });
        }
    }
    let reach = |from: Vector3<f64>| {
        [0, 1].map(|k| {
            let all = parts.iter().flat_map(|(_, polygon, _)| polygon);
            let along = all.map(|corner| (corner - from).dot(&axes[k]));
            along.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], x| {
                [low.min(x), high.max(x)]
            })
        })
    };
    let origin = spec.origin_mm.map_or_else(
        || {
            let [along, up] = reach(middle).map(|[from, to]| 0.5 * (from + to));
            middle + axes[0] * along + axes[1] * up
        },
        Vector3::from,
    );
    let zone_mm = spec
        .zone_mm
        .unwrap_or_else(|| reach(origin).map(|[from, to]| [from + RIM_MM, to - RIM_MM]));
    Ok(Patch {
        name: name(),
        origin_mm: origin.into(),
        axes: axes.map(Into::into),
        zone_mm,
        area_mm2,
        low,
        high,
        triangles: parts.iter().map(|(triangle, ..)| *triangle).collect(),
        datum: Vec::new(),
    })
}

/// Along, up, normal.
fn frame(spec: &PatchSpec, normal: Vector3<f64>) -> Result<[Vector3<f64>; 3], PatchError> {
    let usual = if normal.z.abs() > std::f64::consts::FRAC_1_SQRT_2 {
        Vector3::y()
    } else {
        Vector3::z()
    };
    let hint = spec.up.map_or(usual, Vector3::from);
    let across = hint - normal * normal.dot(&hint);
    let too_steep = || PatchError::Up {
        name: spec.name.clone(),
        try_instead: usual.into(),
    };
    // A direction without length lies nowhere.
    let far = across.norm() > LEAST_ACROSS * hint.norm();
    let up = across.try_normalize(0.0).filter(|_| far);
    let up = up.ok_or_else(too_steep)?;
    Ok([up.cross(&normal), up, normal])
}

/// The parts of a patch's triangles in its box.
fn polygons<'a>(
    patch: &'a Patch,
    mesh: &'a TriMesh,
) -> impl Iterator<Item = (u32, Vec<Vector3<f64>>)> + 'a {
    patch.triangles.iter().map(|&triangle| {
        let corners = mesh.corners(triangle as usize).map(Vector3::from);
        (triangle, clip::clipped(&corners, patch.low, patch.high))
    })
}

/// No point belongs to both.
fn apart(one: &Patch, other: &Patch, mesh: &TriMesh) -> Result<(), PatchError> {
    for (facet, polygon) in polygons(one, mesh) {
        if other.triangles.binary_search(&facet).is_err() {
            continue;
        }
        let shared = clip::clipped(&polygon, other.low, other.high);
        let area_mm2 = clip::area_vector(&shared).norm();
        if area_mm2 > TOUCHING_MM2 {
            return Err(PatchError::Overlap {
                names: [one.name.clone(), other.name.clone()],
                facet,
                area_mm2,
            });
        }
    }
    Ok(())
}

/// The judged rectangle lies on the patch: what of the patch projects into it fills it.
fn zone_on(patch: &Patch, mesh: &TriMesh) -> Result<(), PatchError> {
    let [[left, right], [low, high]] = patch.zone_mm;
    let size_mm = [right - left, high - low];
    let far = f64::INFINITY;
    let mut reach_mm = [[far, -far]; 2];
    let mut filled_mm2 = 0.0;
    for (_, polygon) in polygons(patch, mesh) {
        let flat: Vec<Vector3<f64>> = polygon
            .iter()
            .map(|corner| {
                let [along, up] = patch.place_mm((*corner).into());
                Vector3::new(along, up, 0.0)
            })
            .collect();
        for corner in &flat {
            for (k, [least, most]) in reach_mm.iter_mut().enumerate() {
                (*least, *most) = (least.min(corner[k]), most.max(corner[k]));
            }
        }
        let inside = clip::clipped(&flat, [left, low, -far], [right, high, far]);
        filled_mm2 += clip::area_vector(&inside).z;
    }
    let share = filled_mm2 / (size_mm[0] * size_mm[1]);
    // A rectangle without room is filled by nothing; where facets lie one behind the other, more than all of it is.
    let is_filled = size_mm.iter().all(|&mm| mm > 0.0) && (share - 1.0).abs() <= MOST_OFF_PATCH;
    if is_filled {
        return Ok(());
    }
    Err(PatchError::ZoneOffPatch {
        name: patch.name.clone(),
        share,
        size_mm,
        reach_mm,
    })
}

/// The zone has room for the disc of the measurand.
fn disc_in(patch: &Patch, area_mm2: f64) -> Result<(), PatchError> {
    let size_mm = patch.zone_mm.map(|[from, to]| to - from);
    let room_mm = size_mm[0].min(size_mm[1]);
    let most_mm2 = 0.25 * std::f64::consts::PI * room_mm * room_mm;
    if area_mm2 <= most_mm2 {
        return Ok(());
    }
    Err(PatchError::NoDisc {
        name: patch.name.clone(),
        area_mm2,
        size_mm,
        most_mm2,
    })
}

#[cfg(test)]
mod tests;
