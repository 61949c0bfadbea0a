//! Form deviation of a die: what heat treatment and years in a press do to its bore as a whole.

use super::WorldError;
use flankscope_gear_cad::Mesh;

/// Largest form deviation that the model describes, µm.
const MAX_FORM_UM: f64 = 200.0;

/// A bore that is neither round nor straight.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Form {
    /// Largest minus smallest radius around the bore, µm: the radius grows by half of it towards ±x and shrinks by half
    /// of it towards ±y.
    pub ovality_um: f64,
    /// Growth of the radius from the bottom to the top, µm; mid-height keeps its radius.
    pub taper_um: f64,
}

impl Form {
    /// Radial displacement of the surface at an angle and a share of the height (0 bottom, 1 top), mm.
    pub fn radial_mm(&self, angle_rad: f64, height_share: f64) -> f64 {
        1e-3 * (0.5 * self.ovality_um * (2.0 * angle_rad).cos()
            + self.taper_um * (height_share - 0.5))
    }

    /// Moves the toothing of a mesh whose body ends at `body_radius_mm`; the outer wall stays.
    pub(crate) fn apply(&self, mesh: &mut Mesh, body_radius_mm: f64, height_mm: [f64; 2]) {
        if *self == Self::default() {
            return;
        }
        let [bottom, top] = height_mm;
        for p in &mut mesh.vertices {
            let radius = p[0].hypot(p[1]);
            if radius < 0.75 * body_radius_mm && radius > 0.0 {
                let by = self.radial_mm(p[1].atan2(p[0]), (p[2] - bottom) / (top - bottom));
                p[0] *= 1.0 + by / radius;
                p[1] *= 1.0 + by / radius;
            }
        }
    }

    pub(crate) fn validate(&self) -> Result<(), WorldError> {
        WorldError::check("ovality_um", self.ovality_um, -MAX_FORM_UM, MAX_FORM_UM)?;
        WorldError::check("taper_um", self.taper_um, -MAX_FORM_UM, MAX_FORM_UM)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bore_is_as_oval_and_conical_as_asked_and_the_wall_stays() {
        let gear = crate::demo::gear();
        let cad = gear.mesh(&Default::default()).expect("the demo gear");
        let mut mesh = cad.clone();
        let form = Form {
            ovality_um: 20.0,
            taper_um: 15.0,
        };
        form.apply(&mut mesh, gear.body_radius_mm, gear.height_mm);
        let radius = |p: &[f64; 3]| p[0].hypot(p[1]);
        for (was, is) in cad.vertices.iter().zip(&mesh.vertices) {
            let grown_um = 1e3 * (radius(is) - radius(was));
            if radius(was) > 80.0 {
                assert_eq!(was, is);
                continue;
            }
            let (x, y) = (was[0] / radius(was), was[1] / radius(was));
            let expected_um = 10.0 * (x * x - y * y) + 15.0 * (was[2] / 66.0 - 0.5);
            assert!((grown_um - expected_um).abs() < 1e-6, "at {was:?}");
        }
    }
}
