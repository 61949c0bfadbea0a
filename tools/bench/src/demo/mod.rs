//! The built-in demo: an 84-tooth die, a calibration target, a white tile.

mod other;
mod target;

pub use other::{OtherDie, OtherDieError};
pub use target::{Carrier, StageErrors, carrier, target_world};

use crate::world::WorldConfig;
use flankscope_gear_cad::{GearKind, GearSpec, Mesh, MeshError, Meshing};

/// Radius of the demo die's pitch circle, mm.
const PITCH_RADIUS_MM: f64 = 41.45;
/// Height at which the demo's head views the die: its middle, mm.
pub const HEIGHT_MM: f64 = 33.0;
/// Chord error of the demo die's flanks, mm.
pub const CHORD_ERROR_MM: f64 = 0.2e-3;

/// Gear data of the demo die: 84 internal teeth on 82.9 mm, 66 mm high, about 10 kg of steel.
pub fn gear() -> GearSpec {
    let teeth = 84;
    let module_mm = 2.0 * PITCH_RADIUS_MM / f64::from(teeth);
    GearSpec {
        kind: GearKind::Internal,
        teeth,
        module_mm,
        pressure_angle_rad: 20f64.to_radians(),
        tip_radius_mm: PITCH_RADIUS_MM - module_mm,
        root_radius_mm: PITCH_RADIUS_MM + 1.25 * module_mm,
        root_fillet_radius_mm: 0.0,
        turned_rad: 0.0,
        body_radius_mm: 88.5,
        height_mm: [0.0, 66.0],
    }
}

/// The undamaged demo die in front of the demo head.
pub fn world_config() -> Result<WorldConfig, MeshError> {
    let gear = gear();
    let cad = gear.mesh(&Meshing {
        chord_error_mm: CHORD_ERROR_MM,
        ..Meshing::default()
    })?;
    Ok(WorldConfig::new(cad, gear))
}

/// Half of the tile's side, mm: much larger than the field.
const TILE_HALF_MM: f64 = 20.0;

/// A plane tile across the view, `radius_mm` from the stage's axis, facing the head; `tilt` is the change of x along y and z.
#[must_use]
pub fn tile(radius_mm: f64, tilt: [f64; 2]) -> Mesh {
    let corner = |y: f64, z: f64| [radius_mm + tilt[0] * y + tilt[1] * z, y, z];
    let half = TILE_HALF_MM;
    Mesh {
        vertices: vec![
            corner(-half, -half),
            corner(half, -half),
            corner(half, half),
            corner(-half, half),
        ],
        triangles: vec![[0, 2, 1], [0, 3, 2]],
    }
}
