//! A head of the bench as its calibration file describes it.

use flankscope_bench::world::{HeadDesign, LiquidLens, Pinhole};
use flankscope_profilometry::HeadModel;
use flankscope_profilometry::head::{
    self, DepthRange, Fringes, ImageCircle, LensDrive, RigidTransform, SecondProjector, Sensor,
};
use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};

/// The demo head as its calibration file describes it.
#[must_use]
pub fn head() -> HeadModel {
    head_of(&HeadDesign::demo())
}

/// Cores at the rim of the projector's bundle whose fringes do not count: light falls on what they light from one side only.
const RIM_CORES: f64 = 2.0;

/// The part of a DMD that shines through the bundle, without the rim.
fn projector_circle(made: &HeadDesign) -> ImageCircle {
    let bundle = made.bundle(&made.projector);
    // Hexagons of one pitch, as many as there are cores, fill the circle: their share of it is pi / (2 sqrt 3).
    let across = (bundle.cores as f64 * 2.0 * 3f64.sqrt() / std::f64::consts::PI).sqrt();
    ImageCircle {
        centre_px: bundle.centre_px,
        radius_px: bundle.diameter_px * (0.5 - RIM_CORES / across),
    }
}

/// A head as its calibration file describes it.
#[must_use]
pub fn head_of(made: &HeadDesign) -> HeadModel {
    let optics = made.optics();
    let sensor = &made.sensor;
    let [near_mm, far_mm] = made.driven_volume_mm();
    let camera = pinhole_file(&optics.camera, optics.camera_size_px);
    let projector = pinhole_file(&optics.projector, optics.projector_size_px);
    let projector_from_camera = transform_file(&optics.projector_from_camera);
    HeadModel {
        working_distance_mm: Some(
            made.working_distance_mm + made.best_focus_mm() - made.stand_off_mm,
        ),
        pattern_set: Some(made.pattern_set.clone()),
        fringes: made
            .fringes
            .iter()
            .map(|set| Fringes {
                periods: set.periods,
                steps: set.steps,
            })
            .collect(),
        exposures_us: made.exposures_us.clone(),
        binning: made.binning,
        projector_circle: Some(projector_circle(made)),
        second_projector: optics
            .second_projector
            .as_ref()
            .map(|second| SecondProjector {
                projector: pinhole_file(&second.projector, optics.projector_size_px),
                mirrors: None,
                circle: Some(projector_circle(made)),
                projector_from_camera: transform_file(&second.projector_from_camera),
            }),
        stage_from_camera: Some(transform_file(&optics.stage_from_camera)),
        sensor: Some(Sensor {
            full_well_e: sensor.full_well_e,
            gain_e_per_dn: sensor.gain_e_per_dn(),
            read_noise_e: sensor.read_noise_e,
            offset_dn: sensor.offset_dn,
            bits: sensor.bits,
        }),
        volume: Some(DepthRange { near_mm, far_mm }),
        image_circle: Some(ImageCircle {
            centre_px: made.bundle(&made.camera).centre_px,
            radius_px: 0.5 * made.camera.circle_px,
        }),
        lens: made.lens.as_ref().map(|lens| lens_file(lens, made)),
        ..HeadModel::from_lenses(&made.name, camera, projector, projector_from_camera)
    }
}

/// What the driver of a head's liquid lens is told, at first for the setting that the head is drawn at.
fn lens_file(lens: &LiquidLens, made: &HeadDesign) -> LensDrive {
    let counts = |dpt: f64| (lens.zero_counts + dpt / lens.dpt_per_count).round() as u16;
    let ends = lens.range_dpt.map(counts);
    let [one, other] = ends;
    LensDrive {
        zero_counts: lens.zero_counts,
        dpt_per_count: lens.dpt_per_count,
        range: [one.min(other), one.max(other)],
        settle_ms: lens.settle_ms,
        counts: counts(made.driven.map_or(0.0, |driven| driven.setting_dpt)),
    }
}

fn pinhole_file(pinhole: &Pinhole, [width, height]: [usize; 2]) -> head::Pinhole {
    head::Pinhole {
        width_px: width as u32,
        height_px: height as u32,
        focal_px: pinhole.focal_px,
        principal_px: pinhole.centre_px,
        distortion: pinhole.distortion,
        residual: None,
    }
}

pub(crate) fn transform_file(transform: &Isometry3<f64>) -> RigidTransform {
    let matrix = transform.rotation.to_rotation_matrix();
    RigidTransform {
        rotation: std::array::from_fn(|row| std::array::from_fn(|column| matrix[(row, column)])),
        translation_mm: transform.translation.vector.into(),
    }
}

pub(crate) fn transform_of(file: &RigidTransform) -> Isometry3<f64> {
    let matrix = Matrix3::from_fn(|row, column| file.rotation[row][column]);
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix));
    Isometry3::from_parts(
        Translation3::from(Vector3::from(file.translation_mm)),
        rotation,
    )
}
