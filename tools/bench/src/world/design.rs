//! A head as it was made: what its maker states, and the optics that come of it.

use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use serde::Deserialize;

use super::{BundleSpec, HeadOptics, Objective, Pinhole, SensorSpec, WorldConfig};

/// The heads that come along: name and text of their `optics.toml`.
pub const AT_HAND: [(&str, &str); 2] = [
    ("10mm", include_str!("../../heads/10mm.toml")),
    ("20mm", include_str!("../../heads/20mm.toml")),
];
/// The one of them that stands before the demo die.
const DEMO: usize = 1;

/// A head as it was made: camera and projector meet under an angle in best focus. Camera columns lie along the axis of the die,
/// and the projector is turned about the camera's y axis through the focus.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HeadDesign {
    /// Free text.
    pub name: String,
    /// From the front to best focus.
    pub working_distance_mm: f64,
    /// From the pinholes of camera and projector to best focus.
    pub stand_off_mm: f64,
    /// Best focus lies this far from the axis of the rotary stage, the head looks outwards.
    pub focus_radius_mm: f64,
    /// Diameter of the field in best focus: as wide as either bundle's image.
    pub field_mm: f64,
    /// Between camera and projector.
    pub angle_deg: f64,
    /// Depths that the head measures, from the camera's pinhole.
    pub volume_mm: [f64; 2],
    /// Modulation of a coarse pattern at the centre of the field: the rest is stray light.
    pub contrast_centre: f64,
    /// The same at the edge of the field.
    pub contrast_edge: f64,
    /// Light that the DMD still sends when all mirrors are off, relative to all on.
    pub dmd_leak_ratio: f64,
    /// What the DMD shows unless the head file says otherwise.
    pub pattern_set: String,
    /// Exposures for a sprayed die.
    pub exposures_us: Vec<u32>,
    /// Exposure for a white plate.
    pub white_exposure_us: u32,
    /// Pixels along a measuring cell.
    pub binning: u32,
    /// Between bundle and sensor, and the objective before the bundle.
    pub camera: Side,
    /// Between DMD and bundle, and the objective after it.
    pub projector: Side,
    /// Both bundles.
    pub bundle: Fibres,
    /// The camera's sensor and the lamp.
    pub sensor: SensorSpec,
}

/// One of the two ways of light.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Side {
    /// Columns and rows of sensor or DMD; the bundle's image lies in its middle.
    pub size_px: [usize; 2],
    /// Diameter of the bundle's image.
    pub circle_px: f64,
    /// Rotation of the bundle's lattice against the rows.
    pub bundle_turn_rad: f64,
    /// k1, k2, p1, p2, k3.
    pub distortion: [f64; 5],
    /// As [`Objective::field_curvature_per_mm`].
    pub field_curvature_per_mm: f64,
    /// As [`Objective::focus_sigma_pitch`].
    pub focus_sigma_pitch: f64,
    /// As [`Objective::defocus_sigma_pitch_per_mm`].
    pub defocus_sigma_pitch_per_mm: f64,
    /// As [`Objective::edge_loss_ratio`].
    pub edge_loss_ratio: f64,
}

/// What both bundles are made of, as in [`BundleSpec`].
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fibres {
    /// Number of cores.
    pub cores: usize,
    /// Standard deviation of a core's place, in pitches.
    pub jitter_ratio: f64,
    /// Standard deviation of the transmission.
    pub gain_spread_ratio: f64,
    /// Share of cores without light.
    pub dead_ratio: f64,
    /// Share of its light that a core loses to its neighbours.
    pub crosstalk_ratio: f64,
}

impl HeadDesign {
    /// The head of the built-in demo.
    #[must_use]
    pub fn demo() -> Self {
        toml::from_str(AT_HAND[DEMO].1).expect("a head that comes along")
    }

    /// Where light goes in it.
    #[must_use]
    pub fn optics(&self) -> HeadOptics {
        // Columns along +z of the stage, rows along -y, view along +x.
        let axes = Matrix3::from_columns(&[Vector3::z(), -Vector3::y(), Vector3::x()]);
        let stage_from_camera = Isometry3::from_parts(
            Translation3::new(self.focus_radius_mm - self.stand_off_mm, 0.0, 0.0),
            UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes)),
        );
        let focus = Vector3::new(0.0, 0.0, self.stand_off_mm);
        // A positive turn about y moves the view towards +x, so the projector itself sits at negative x.
        let camera_from_projector =
            Rotation3::from_axis_angle(&Vector3::y_axis(), self.angle_deg.to_radians());
        let rotation = camera_from_projector.inverse();
        let projector_from_camera = Isometry3::from_parts(
            Translation3::from(focus - rotation * focus),
            UnitQuaternion::from(rotation),
        );
        HeadOptics {
            camera: self.pinhole(&self.camera),
            camera_size_px: self.camera.size_px,
            camera_objective: self.objective(&self.camera),
            projector: self.pinhole(&self.projector),
            projector_size_px: self.projector.size_px,
            projector_objective: self.objective(&self.projector),
            projector_from_camera,
            stage_from_camera,
            contrast_centre: self.contrast_centre,
            contrast_edge: self.contrast_edge,
            dmd_leak_ratio: self.dmd_leak_ratio,
        }
    }

    fn pinhole(&self, side: &Side) -> Pinhole {
        Pinhole {
            focal_px: [side.circle_px * self.stand_off_mm / self.field_mm; 2],
            centre_px: side.centre_px(),
            distortion: side.distortion,
            uneven: None,
        }
    }

    fn objective(&self, side: &Side) -> Objective {
        Objective {
            focus_mm: self.stand_off_mm,
            field_curvature_per_mm: side.field_curvature_per_mm,
            field_radius_mm: 0.5 * self.field_mm,
            focus_sigma_pitch: side.focus_sigma_pitch,
            defocus_sigma_pitch_per_mm: side.defocus_sigma_pitch_per_mm,
            edge_loss_ratio: side.edge_loss_ratio,
        }
    }

    /// The bundle of one side.
    #[must_use]
    pub fn bundle(&self, side: &Side) -> BundleSpec {
        let fibres = &self.bundle;
        BundleSpec {
            cores: fibres.cores,
            diameter_px: side.circle_px,
            centre_px: side.centre_px(),
            rotation_rad: side.bundle_turn_rad,
            jitter_ratio: fibres.jitter_ratio,
            gain_spread_ratio: fibres.gain_spread_ratio,
            dead_ratio: fibres.dead_ratio,
            crosstalk_ratio: fibres.crosstalk_ratio,
        }
    }

    /// Puts the head into a world.
    pub fn impose(&self, config: &mut WorldConfig) {
        config.optics = self.optics();
        config.camera_bundle = self.bundle(&self.camera);
        config.projector_bundle = self.bundle(&self.projector);
        config.sensor = self.sensor.clone();
    }
}

impl Side {
    fn centre_px(&self) -> [f64; 2] {
        self.size_px.map(|n| 0.5 * (n as f64 - 1.0))
    }
}
