//! Form error of a die: errors of the whole bore from heat treatment and use, and individual manufacturing errors of the flanks.

use super::WorldError;
use super::die::in_toothing;
use super::random::{Normals, Purpose, stream};
use flankscope_gear_cad::{GearSpec, Mesh};

/// Largest form deviation that the model describes, µm.
const MAX_FORM_UM: f64 = 200.0;
/// Largest standard deviation of the flanks' individual errors, µm.
const MAX_FLANKS_UM: f64 = 20.0;

/// Form error of a bore and its flanks.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Form {
    /// Largest minus smallest radius around the bore, µm: the radius grows by half of it towards ±x and shrinks by half
    /// of it towards ±y.
    pub ovality_um: f64,
    /// Growth of the radius from the bottom to the top, µm; mid-height keeps its radius.
    pub taper_um: f64,
    /// Largest minus smallest radius of three lobes, µm: the radius grows by half of it towards +x.
    pub three_lobe_um: f64,
    /// Growth of the radius from the ends to mid-height, µm, as a parabola; both ends keep their radius.
    pub barrel_um: f64,
    /// Growth of the radius at the upper end, µm, as a parabola over the last quarter of the height.
    pub bell_mouth_um: f64,
    /// Standard deviation of the flanks' individual errors along the pitch circle, µm: positive makes the tooth thicker.
    pub flanks_um: f64,
    /// Seed of these errors: one seed is one die.
    pub flanks_seed: u64,
}

impl Form {
    /// Radial displacement of the surface at an angle and a fraction of the height (0 bottom, 1 top), mm.
    pub fn radial_mm(&self, angle_rad: f64, height_share: f64) -> f64 {
        let from_middle = 2.0 * height_share - 1.0;
        let in_mouth = (4.0 * height_share - 3.0).max(0.0);
        1e-3 * (0.5 * self.ovality_um * (2.0 * angle_rad).cos()
            + self.taper_um * (height_share - 0.5)
            + 0.5 * self.three_lobe_um * (3.0 * angle_rad).cos()
            + self.barrel_um * (1.0 - from_middle * from_middle)
            + self.bell_mouth_um * in_mouth * in_mouth)
    }

    /// Individual errors of the right and the left flank of every tooth, mm.
    fn flanks_mm(&self, teeth: u32) -> Vec<[f64; 2]> {
        let mut random = Normals::new(stream(self.flanks_seed, Purpose::Flanks));
        let mut flank = || 1e-3 * self.flanks_um * random.next().clamp(-3.0, 3.0);
        (0..teeth).map(|_| [flank(), flank()]).collect()
    }

    /// Moves the toothing of a mesh of the gear; the outer wall stays.
    pub(crate) fn apply(&self, mesh: &mut Mesh, gear: &GearSpec) {
        if *self == Self::default() {
            return;
        }
        let [bottom, top] = gear.height_mm;
        let pitch_radius_mm = 0.5 * gear.module_mm * f64::from(gear.teeth);
        let flanks_mm = self.flanks_mm(gear.teeth);
        for p in &mut mesh.vertices {
            let radius = p[0].hypot(p[1]);
            if in_toothing(gear, radius) && radius > 0.0 {
                let angle = p[1].atan2(p[0]);
                let by = self.radial_mm(angle, (p[2] - bottom) / (top - bottom));
                // Half teeth from the middle of the space before tooth 1 on: right, left, right ...
                let half = (2.0 * (angle - gear.turned_rad) / gear.pitch_angle_rad())
                    .floor()
                    .rem_euclid(2.0 * f64::from(gear.teeth)) as usize;
                let [right, left] = flanks_mm[(half / 2).min(flanks_mm.len() - 1)];
                let along_mm = if half.is_multiple_of(2) { -right } else { left };
                let (sin, cos) = (angle + along_mm / pitch_radius_mm).sin_cos();
                p[0] = (radius + by) * cos;
                p[1] = (radius + by) * sin;
            }
        }
    }

    pub(crate) fn validate(&self) -> Result<(), WorldError> {
        WorldError::check("ovality_um", self.ovality_um, -MAX_FORM_UM, MAX_FORM_UM)?;
        for (name, um) in [
            ("taper_um", self.taper_um),
            ("three_lobe_um", self.three_lobe_um),
            ("barrel_um", self.barrel_um),
            ("bell_mouth_um", self.bell_mouth_um),
        ] {
            WorldError::check(name, um, -MAX_FORM_UM, MAX_FORM_UM)?;
        }
        WorldError::check("flanks_um", self.flanks_um, 0.0, MAX_FLANKS_UM)
    }
}

#[cfg(test)]
mod tests {
    use super::super::die::nearest_flank;
    use super::*;
    use flankscope_gear_cad::Flank;
    use std::collections::BTreeMap;

    #[test]
    fn the_bore_is_as_oval_and_conical_as_asked_and_the_wall_stays() {
        let gear = crate::demo::gear();
        let cad = gear.mesh(&Default::default()).expect("the demo gear");
        let mut mesh = cad.clone();
        let form = Form {
            ovality_um: 20.0,
            taper_um: 15.0,
            ..Form::default()
        };
        form.apply(&mut mesh, &gear);
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

    #[test]
    fn lobes_barrel_and_mouth_are_where_they_are_asked_for() {
        let form = Form {
            three_lobe_um: 12.0,
            barrel_um: 7.0,
            bell_mouth_um: 30.0,
            ..Form::default()
        };
        let um = |degrees: f64, share: f64| 1e3 * form.radial_mm(degrees.to_radians(), share);
        // Three lobes: the maximum at every third of a revolution, the minimum between.
        for (at, lobe) in [
            (0.0, 6.0),
            (120.0, 6.0),
            (240.0, 6.0),
            (60.0, -6.0),
            (180.0, -6.0),
            (30.0, 0.0),
        ] {
            assert!((um(at, 0.0) - lobe).abs() < 1e-9, "{at}");
        }
        // On a node of the lobes: only the barrel up to three quarters of the height, plus the bell mouth above.
        for (share, expected) in [
            (0.0, 0.0),
            (0.5, 7.0),
            (0.25, 5.25),
            (0.75, 5.25),
            (1.0, 30.0),
        ] {
            assert!((um(30.0, share) - expected).abs() < 1e-9, "{share}");
        }
        assert!((um(30.0, 0.875) - (7.0 * (1.0 - 0.5625) + 7.5)).abs() < 1e-9);
    }

    #[test]
    fn every_flank_stands_off_as_a_whole_and_one_seed_is_one_die() {
        let gear = crate::demo::gear();
        let cad = gear.mesh(&Default::default()).expect("the demo gear");
        let worn = |flanks_seed| {
            let mut mesh = cad.clone();
            let form = Form {
                flanks_um: 4.0,
                flanks_seed,
                ..Form::default()
            };
            form.apply(&mut mesh, &gear);
            mesh
        };
        let mesh = worn(3);
        assert_eq!(mesh.vertices, worn(3).vertices);
        assert_ne!(mesh.vertices, worn(4).vertices);
        let mut along_um: BTreeMap<(u32, bool), Vec<f64>> = BTreeMap::new();
        for (was, is) in cad.vertices.iter().zip(&mesh.vertices) {
            let Some((id, off_mm)) = nearest_flank(&gear, *was) else {
                continue;
            };
            if off_mm.abs() < 1e-6 {
                let turned =
                    (is[1] * was[0] - is[0] * was[1]).atan2(is[0] * was[0] + is[1] * was[1]);
                let thicker = if id.flank == Flank::Left { 1.0 } else { -1.0 };
                let of_flank = along_um.entry((id.tooth, thicker > 0.0)).or_default();
                of_flank.push(thicker * turned * 41.45e3);
            }
        }
        assert_eq!(along_um.len(), 2 * 84);
        let means: Vec<f64> = along_um.values().map(|um| um[0]).collect();
        for (of_flank, mean) in along_um.values().zip(&means) {
            assert!(of_flank.iter().all(|um| (um - mean).abs() < 1e-6));
        }
        // 168 values: their standard deviation is known to 5.5 %; the tolerance is four times that.
        let std = (means.iter().map(|um| um * um).sum::<f64>() / means.len() as f64).sqrt();
        assert!((std / 4.0 - 1.0).abs() < 0.22, "{std}");
    }
}
