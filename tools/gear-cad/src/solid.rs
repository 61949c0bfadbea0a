//! The outline extruded to a closed solid.

use crate::profile::{arc_steps, pitch_outline};
use crate::spec::{GearKind, GearSpec, SpecError};
use crate::triangulate::fill_polygon;

/// How finely a gear is cut into triangles.
#[derive(Clone, Debug, PartialEq)]
pub struct Meshing {
    /// Largest distance between a chord and the toothed outline it replaces, mm.
    pub chord_error_mm: f64,
    /// The same for the body (outer wall or bore), which nobody measures, mm.
    pub body_chord_error_mm: f64,
    /// Layers along the axis; 1 gives the long thin triangles that CAD kernels give.
    pub axial_slices: u32,
}

impl Default for Meshing {
    /// 0.2 µm on the teeth, 20 µm on the body, one layer.
    fn default() -> Self {
        Self {
            chord_error_mm: 0.2e-3,
            body_chord_error_mm: 20e-3,
            axial_slices: 1,
        }
    }
}

/// Triangles that share vertices, counter-clockwise seen from outside the material; millimetres.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Mesh {
    /// Corner positions, mm.
    pub vertices: Vec<[f64; 3]>,
    /// Three indices into `vertices` each.
    pub triangles: Vec<[u32; 3]>,
}

/// Why no mesh was made.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum MeshError {
    /// The gear itself is impossible.
    #[error(transparent)]
    Spec(#[from] SpecError),
    /// A chord error that is not a usable length.
    #[error("{name} is {got_mm} mm; it must lie between {min_mm} and {max_mm} mm")]
    ChordError {
        /// Field at fault.
        name: &'static str,
        /// Its value, mm.
        got_mm: f64,
        /// Smallest, mm.
        min_mm: f64,
        /// Largest, mm.
        max_mm: f64,
    },
    /// Too few or too many layers.
    #[error("axial_slices is {got}; 1 to {max} are possible")]
    Slices {
        /// Number asked for.
        got: u32,
        /// Most.
        max: u32,
    },
    /// More vertices than a 32-bit index addresses.
    #[error(
        "the mesh would have {got} vertices, at most {max} can be indexed: allow a larger chord error or fewer slices"
    )]
    TooLarge {
        /// Vertices needed.
        got: u64,
        max: u64,
    },
    #[error(
        "the outline of a {teeth}-tooth gear crosses itself between root {root_radius_mm} mm and tip {tip_radius_mm} mm"
    )]
    OutlineCrosses {
        teeth: u32,
        root_radius_mm: f64,
        tip_radius_mm: f64,
    },
}

impl Mesh {
    /// Volume enclosed, mm³: positive if the triangles face outwards.
    pub fn volume_mm3(&self) -> f64 {
        let six_volumes: f64 = self
            .triangles
            .iter()
            .map(|t| {
                let [a, b, c] = t.map(|i| self.vertices[i as usize]);
                a[0] * (b[1] * c[2] - b[2] * c[1])
                    + a[1] * (b[2] * c[0] - b[0] * c[2])
                    + a[2] * (b[0] * c[1] - b[1] * c[0])
            })
            .sum();
        six_volumes / 6.0
    }
}

impl GearSpec {
    /// The gear as a closed solid.
    pub fn mesh(&self, meshing: &Meshing) -> Result<Mesh, MeshError> {
        self.validate()?;
        meshing.validate()?;
        let outline = pitch_outline(self, meshing.chord_error_mm);
        let wall_steps = arc_steps(
            self.body_radius_mm,
            self.pitch_angle_rad(),
            meshing.body_chord_error_mm,
        );
        let layout = Layout {
            teeth: self.teeth as usize,
            outline: outline.len(),
            wall: wall_steps,
            slices: meshing.axial_slices as usize,
        };
        layout.check_size()?;

        let mut mesh = Mesh::default();
        let pitch = self.pitch_angle_rad();
        let [low, high] = self.height_mm;
        for slice in 0..=layout.slices {
            let z = if slice == layout.slices {
                high
            } else {
                low + (high - low) * slice as f64 / layout.slices as f64
            };
            for tooth in 0..layout.teeth {
                let start = self.turned_rad + pitch * tooth as f64;
                mesh.vertices.extend(
                    outline
                        .iter()
                        .map(|p| cylindrical(p.radius_mm, start + p.angle_rad, z)),
                );
            }
        }
        for z in [low, high] {
            for step in 0..layout.teeth * wall_steps {
                let angle = self.turned_rad + pitch * step as f64 / wall_steps as f64;
                mesh.vertices
                    .push(cylindrical(self.body_radius_mm, angle, z));
            }
        }

        // Walking by increasing angle, the material of an internal gear is on the outer side of its teeth.
        let internal = self.kind == GearKind::Internal;
        for slice in 0..layout.slices {
            for i in 0..layout.ring() {
                let corner = |slice, i| layout.toothed(slice, i % layout.ring());
                quad(
                    &mut mesh,
                    [
                        corner(slice, i),
                        corner(slice, i + 1),
                        corner(slice + 1, i + 1),
                        corner(slice + 1, i),
                    ],
                    !internal,
                );
            }
        }
        let wall_ring = layout.teeth * layout.wall;
        for i in 0..wall_ring {
            let next = (i + 1) % wall_ring;
            quad(
                &mut mesh,
                [
                    layout.body(0, i),
                    layout.body(0, next),
                    layout.body(1, next),
                    layout.body(1, i),
                ],
                internal,
            );
        }
        self.close_ends(&mut mesh, &layout)?;
        Ok(mesh)
    }

    /// Both end faces. One pitch is filled once and repeated: its sides are shared straight radial edges.
    fn close_ends(&self, mesh: &mut Mesh, layout: &Layout) -> Result<(), MeshError> {
        // Once around one pitch: teeth by increasing angle, then the body back.
        let around = |end: usize, tooth: usize| -> Vec<u32> {
            let slice = if end == 0 { 0 } else { layout.slices };
            let teeth = (0..=layout.outline)
                .map(|i| layout.toothed(slice, (tooth * layout.outline + i) % layout.ring()));
            let wall_ring = layout.teeth * layout.wall;
            let body = (0..=layout.wall)
                .rev()
                .map(|i| layout.body(end, (tooth * layout.wall + i) % wall_ring));
            teeth.chain(body).collect()
        };
        let first = around(0, 0);
        let mut flat: Vec<[f64; 2]> = first
            .iter()
            .map(|&v| {
                let p = mesh.vertices[v as usize];
                [p[0], p[1]]
            })
            .collect();
        // Material outside the teeth makes this walk clockwise.
        let clockwise = self.kind == GearKind::Internal;
        if clockwise {
            flat.reverse();
        }
        let last = flat.len() - 1;
        let filled = fill_polygon(&flat).ok_or(MeshError::OutlineCrosses {
            teeth: self.teeth,
            root_radius_mm: self.root_radius_mm,
            tip_radius_mm: self.tip_radius_mm,
        })?;
        for end in 0..2 {
            for tooth in 0..layout.teeth {
                let ids = around(end, tooth);
                for triangle in &filled {
                    let [a, b, c] = triangle.map(|i| ids[if clockwise { last - i } else { i }]);
                    // Counter-clockwise from above is right for the upper face only.
                    mesh.triangles
                        .push(if end == 0 { [a, c, b] } else { [a, b, c] });
                }
            }
        }
        Ok(())
    }
}

/// Vertex numbering: toothed rings by slice, then the lower and the upper ring of the body.
struct Layout {
    teeth: usize,
    outline: usize,
    wall: usize,
    slices: usize,
}

impl Layout {
    fn ring(&self) -> usize {
        self.teeth * self.outline
    }

    fn toothed(&self, slice: usize, i: usize) -> u32 {
        (slice * self.ring() + i) as u32
    }

    fn body(&self, end: usize, i: usize) -> u32 {
        ((self.slices + 1) * self.ring() + end * self.teeth * self.wall + i) as u32
    }

    fn check_size(&self) -> Result<(), MeshError> {
        let got =
            (self.slices as u64 + 1) * self.ring() as u64 + 2 * (self.teeth * self.wall) as u64;
        let max = u64::from(u32::MAX);
        if got > max {
            Err(MeshError::TooLarge { got, max })
        } else {
            Ok(())
        }
    }
}

impl Meshing {
    fn validate(&self) -> Result<(), MeshError> {
        const CHORD_MM: [f64; 2] = [1e-9, 1.0];
        let chords = [
            ("chord_error_mm", self.chord_error_mm),
            ("body_chord_error_mm", self.body_chord_error_mm),
        ];
        for (name, got_mm) in chords {
            if !(CHORD_MM[0]..=CHORD_MM[1]).contains(&got_mm) {
                return Err(MeshError::ChordError {
                    name,
                    got_mm,
                    min_mm: CHORD_MM[0],
                    max_mm: CHORD_MM[1],
                });
            }
        }
        const MAX_SLICES: u32 = 100_000;
        if self.axial_slices == 0 || self.axial_slices > MAX_SLICES {
            return Err(MeshError::Slices {
                got: self.axial_slices,
                max: MAX_SLICES,
            });
        }
        Ok(())
    }
}

fn cylindrical(radius_mm: f64, angle_rad: f64, z_mm: f64) -> [f64; 3] {
    [
        radius_mm * angle_rad.cos(),
        radius_mm * angle_rad.sin(),
        z_mm,
    ]
}

/// Two triangles over lower-left, lower-right, upper-right, upper-left, where "right" is increasing angle. They face away
/// from the axis if `outwards`.
fn quad(mesh: &mut Mesh, [a, b, c, d]: [u32; 4], outwards: bool) {
    if outwards {
        mesh.triangles.extend([[a, b, c], [a, c, d]]);
    } else {
        mesh.triangles.extend([[a, c, b], [a, d, c]]);
    }
}
