//! Design of a head: the maker's data, and the optics that follow.

use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use serde::Deserialize;

use super::liquid::{Driven, LiquidLens, Refracted};
use super::optics::SecondProjector;
use super::pattern::Fringes;
use super::{BundleSpec, HeadOptics, Objective, Pinhole, SensorSpec, WorldConfig};

/// Built-in heads: name and text of their `optics.toml`.
pub const AT_HAND: [(&str, &str); 5] = [
    ("10mm", include_str!("../../heads/10mm.toml")),
    ("20mm", include_str!("../../heads/20mm.toml")),
    ("liquid", include_str!("../../heads/liquid.toml")),
    ("small", include_str!("../../heads/small.toml")),
    ("twin", include_str!("../../heads/twin.toml")),
];
/// Index of the one in front of the demo die.
const DEMO: usize = 1;

/// Design of a head: the axes of camera and projector intersect at an angle in best focus. Camera columns are parallel to the
/// axis of the die, and the projector is rotated about the camera's y axis through the focus.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HeadDesign {
    /// Free text.
    pub name: String,
    /// Distance from the front of the head to best focus.
    pub working_distance_mm: f64,
    /// Distance from the pinholes of camera and projector to best focus.
    pub stand_off_mm: f64,
    /// Distance of best focus from the axis of the rotary stage; the head looks outwards.
    pub focus_radius_mm: f64,
    /// Diameter of the field in best focus, equal to the image of either bundle.
    pub field_mm: f64,
    /// Angle between camera and projector.
    pub angle_deg: f64,
    /// Angle between the camera and a second projector on its other side, if there is one; its parts equal the first one's.
    pub second_angle_deg: Option<f64>,
    /// Range of depths that the head measures, from the camera's pinhole.
    pub volume_mm: [f64; 2],
    /// Modulation of a coarse pattern at the centre of the field; the remainder is stray light.
    pub contrast_centre: f64,
    /// Modulation of a coarse pattern at the edge of the field.
    pub contrast_edge: f64,
    /// Light of the DMD with all mirrors off, relative to all on.
    pub dmd_leak_ratio: f64,
    /// Pattern set of the DMD unless the head file names another.
    pub pattern_set: String,
    /// Frequencies of that set, ascending, if it is specific to the head.
    #[serde(default)]
    pub fringes: Vec<Fringes>,
    /// Exposures for a sprayed die.
    pub exposures_us: Vec<u32>,
    /// Exposure for a white plate.
    pub white_exposure_us: u32,
    /// Pixels along the side of a measuring cell.
    pub binning: u32,
    /// Optics between bundle and sensor, and the objective in front of the bundle.
    pub camera: Side,
    /// Optics between DMD and bundle, and the objective behind it.
    pub projector: Side,
    /// A liquid lens in front of each objective, if present: all distances above are for the lens without current.
    pub lens: Option<LiquidLens>,
    /// Setting and temperature of the liquid lenses; absent: without current, at the temperature of the drawing.
    pub driven: Option<Driven>,
    /// Properties of both bundles.
    pub bundle: Fibres,
    /// The camera's sensor and the lamp.
    pub sensor: SensorSpec,
}

/// A head whose liquid lenses are driven by the controller during captures.
#[derive(Clone, Debug, PartialEq)]
pub struct DrivenHead {
    pub made: HeadDesign,
    /// As [`HeadOptics::make_uneven`].
    pub lens_error_um: f64,
}

impl DrivenHead {
    /// Optics at the given counts of the driver; by default at the setting in its file.
    pub(super) fn optics(&self, counts: Option<u16>, head_seed: u64) -> HeadOptics {
        let mut optics = match counts {
            Some(counts) => self.made.commanded(counts).optics(),
            None => self.made.optics(),
        };
        if self.lens_error_um > 0.0 {
            optics.make_uneven(self.lens_error_um, head_seed);
        }
        optics
    }
}

/// One of the two light paths: camera or projector.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Side {
    /// Columns and rows of sensor or DMD; the bundle's image is centred.
    pub size_px: [usize; 2],
    /// Diameter of the bundle's image.
    pub circle_px: f64,
    /// Rotation of the bundle's lattice relative to the rows.
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

/// Common properties of both bundles, as in [`BundleSpec`].
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fibres {
    /// Number of cores.
    pub cores: usize,
    /// Standard deviation of a core's position, in pitches.
    pub jitter_ratio: f64,
    /// Standard deviation of the transmission.
    pub gain_spread_ratio: f64,
    /// Fraction of cores without light.
    pub dead_ratio: f64,
    /// Fraction of its light that a core loses to its neighbours.
    pub crosstalk_ratio: f64,
}

impl HeadDesign {
    /// The head of the built-in demo.
    #[must_use]
    pub fn demo() -> Self {
        toml::from_str(AT_HAND[DEMO].1).expect("a head that comes along")
    }

    /// Focal power of its liquid lenses at their setting, 1/mm; 0 without lenses.
    fn power_per_mm(&self) -> f64 {
        self.lens
            .as_ref()
            .map_or(0.0, |lens| lens.power_per_mm(self.driven))
    }

    /// The same head with its lenses driven to these counts, at their present temperature.
    fn commanded(&self, counts: u16) -> Self {
        let setting_dpt = self.lens.as_ref().map(|lens| lens.asked_dpt(counts));
        Self {
            driven: setting_dpt.map(|setting_dpt| Driven {
                setting_dpt,
                celsius: self.driven.and_then(|driven| driven.celsius),
            }),
            ..self.clone()
        }
    }

    fn refracted(&self, decentre_mm: impl Fn(&LiquidLens) -> [f64; 2]) -> Refracted {
        self.lens.as_ref().map_or_else(Refracted::default, |lens| {
            lens.refracted(self.power_per_mm(), decentre_mm(lens))
        })
    }

    /// Distance from the pinholes (without current) to best focus at the lenses' setting.
    pub fn best_focus_mm(&self) -> f64 {
        self.lens.as_ref().map_or(self.stand_off_mm, |lens| {
            lens.best_focus_mm(self.stand_off_mm, self.power_per_mm())
        })
    }

    /// Distance of best focus at the lenses' setting from the axis of the rotary stage.
    pub fn driven_radius_mm(&self) -> f64 {
        self.focus_radius_mm + self.best_focus_mm() - self.stand_off_mm
    }

    /// Range of depths that the head measures at the lenses' setting, from the apparent pinhole of the camera.
    pub fn driven_volume_mm(&self) -> [f64; 2] {
        let moved_mm = self.best_focus_mm() - self.stand_off_mm;
        let pinhole_mm = self.refracted(|lens| lens.camera_decentre_mm).pinhole_mm[2];
        self.volume_mm
            .map(|depth_mm| depth_mm + moved_mm - pinhole_mm)
    }

    pub fn optics(&self) -> HeadOptics {
        // Columns along +z of the stage, rows along -y, viewing direction along +x.
        let axes = Matrix3::from_columns(&[Vector3::z(), -Vector3::y(), Vector3::x()]);
        let stage_from_camera = Isometry3::from_parts(
            Translation3::new(self.focus_radius_mm - self.stand_off_mm, 0.0, 0.0),
            UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes)),
        );
        let focus = Vector3::new(0.0, 0.0, self.stand_off_mm);
        // A positive rotation about y turns the viewing direction towards +x, so the projector itself is at negative x.
        let projector_at = |angle_deg: f64| {
            let camera_from_projector =
                Rotation3::from_axis_angle(&Vector3::y_axis(), angle_deg.to_radians());
            let rotation = camera_from_projector.inverse();
            Isometry3::from_parts(
                Translation3::from(focus - rotation * focus),
                UnitQuaternion::from(rotation),
            )
        };
        let seen = self.refracted(|lens| lens.camera_decentre_mm);
        let shone = self.refracted(|lens| lens.projector_decentre_mm);
        // Poses refer to the apparent pinholes, as seen from outside.
        let [camera_from_seen, projector_from_shone] =
            [&seen, &shone].map(|through| Translation3::from(Vector3::from(through.pinhole_mm)));
        let appearing_at = |angle_deg: f64| {
            projector_from_shone.inverse() * projector_at(angle_deg) * camera_from_seen
        };
        HeadOptics {
            camera: self.pinhole(&self.camera, &seen),
            camera_size_px: self.camera.size_px,
            camera_objective: self.objective(&self.camera, &seen),
            projector: self.pinhole(&self.projector, &shone),
            projector_size_px: self.projector.size_px,
            projector_objective: self.objective(&self.projector, &shone),
            projector_from_camera: appearing_at(self.angle_deg),
            second_projector: self.second_angle_deg.map(|angle_deg| SecondProjector {
                projector: self.pinhole(&self.projector, &shone),
                projector_from_camera: appearing_at(-angle_deg),
            }),
            stage_from_camera: stage_from_camera * camera_from_seen,
            contrast_centre: self.contrast_centre,
            contrast_edge: self.contrast_edge,
            dmd_leak_ratio: self.dmd_leak_ratio,
        }
    }

    fn pinhole(&self, side: &Side, through: &Refracted) -> Pinhole {
        let [k1, k2, p1, p2, k3] = side.distortion;
        // The objective's distortion applies to the slope behind the liquid lens, which is `stretch` times that in front of it.
        let stretch = through.stretch;
        let radial = stretch * stretch;
        let focal_px = stretch * side.circle_px * self.stand_off_mm / self.field_mm;
        let centre_px = side.centre_px();
        Pinhole {
            focal_px: [focal_px; 2],
            centre_px: [0, 1].map(|axis| centre_px[axis] - focal_px * through.bent_rad[axis]),
            distortion: [
                k1 * radial,
                k2 * radial * radial,
                p1 * stretch,
                p2 * stretch,
                k3 * radial * radial * radial,
            ],
            uneven: None,
        }
    }

    fn objective(&self, side: &Side, through: &Refracted) -> Objective {
        let focus_mm = self.best_focus_mm() - through.pinhole_mm[2];
        // Ratio of the field's width to its design value, seen from the apparent pinhole.
        let wider = focus_mm / (self.stand_off_mm * through.stretch);
        Objective {
            focus_mm,
            field_curvature_per_mm: side.field_curvature_per_mm,
            field_radius_mm: 0.5 * self.field_mm * wider,
            focus_sigma_pitch: side.focus_sigma_pitch,
            // Circle of confusion: the cone narrows in proportion to the focal distance, and the image of a core grows.
            defocus_sigma_pitch_per_mm: side.defocus_sigma_pitch_per_mm / (wider * wider),
            edge_loss_ratio: side.edge_loss_ratio,
        }
    }

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

    /// Sets a world to this head.
    pub fn impose(&self, config: &mut WorldConfig) {
        config.optics = self.optics();
        config.driven_head = self.lens.is_some().then(|| {
            Box::new(DrivenHead {
                made: self.clone(),
                lens_error_um: 0.0,
            })
        });
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
