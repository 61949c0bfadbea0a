//! The demo's calibration target: six plates with printed dots, three blank ones and three bars of two spheres on a carrier that sits
//! where the die does, and the head as its drawing shows it.

use std::path::Path;

use flankscope_bench::demo::carrier;
use flankscope_bench::files::{self, MadeHead, Placement, TargetFile};
use flankscope_bench::world::{HeadDesign, WorldConfig};
use flankscope_foundation::files::write_whole;
use flankscope_profilometry::HeadModel;
use flankscope_profilometry::calibrate::{
    Dots, Partner, Plate, Sphere, StageOffset, Target, TestPlace,
};
use flankscope_profilometry::head::Limits;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

use crate::files::write_optics;
use crate::head::{head_of, transform_file, transform_of};

/// Where the head clears the target: as far up as above the die.
const RETRACT_MM: f64 = 86.0;
/// Where the stages stand beside facing a plate, in thousandths of the field around and up.
const BESIDE: [[f64; 2]; 3] = [[207.5, 80.0], [-207.5, -80.0], [83.0, -40.0]];
/// The same of the self-test, with the number of plate and bar: in the middle, and towards corners of the field. VDI/VDE 2634, part 2,
/// asks for seven arrangements of a bar, six of a plate and ten of a sphere.
const TEST_PLACES: [([f64; 2], [usize; 2]); 7] = [
    ([0.0, 0.0], [1, 1]),
    ([145.25, 150.0], [1, 1]),
    ([-145.25, -150.0], [1, 1]),
    ([145.25, -150.0], [2, 2]),
    ([-145.25, 150.0], [2, 2]),
    ([0.0, 150.0], [3, 3]),
    ([0.0, -150.0], [3, 3]),
];

/// The demo's target as its certificate describes it.
#[must_use]
pub fn target() -> Target {
    target_of(&HeadDesign::demo())
}

/// The target for a head: dots, sphere and steps of the stages are in proportion to its field.
#[must_use]
pub fn target_of(made: &HeadDesign) -> Target {
    let of_field = |thousandths: f64| made.field_mm * thousandths / 1000.0;
    let file = |pose: Isometry3<f64>| Plate {
        tool_from_plate: transform_file(&pose),
    };
    let turned_rad = |around: f64| of_field(around) / made.focus_radius_mm;
    let carrier = carrier(made);
    let bar = |[first_mm, second_mm]: [[f64; 3]; 2]| Sphere {
        centre_mm: first_mm,
        diameter_mm: carrier.sphere_diameter_mm,
        partner: Some(Partner {
            centre_mm: second_mm,
            diameter_mm: carrier.sphere_diameter_mm,
            spacing_mm: (Vector3::from(second_mm) - Vector3::from(first_mm)).norm(),
        }),
    };
    let [sphere, test_sphere @ ..] = carrier.bars_mm.map(bar);
    let [blank, test_blank @ ..] = carrier.blanks.map(file);
    Target {
        name: "six dot plates, three blank ones and three bars of two spheres".into(),
        exposure_us: made.white_exposure_us,
        retract_mm: RETRACT_MM,
        pose_sigma_mm: 2e-3,
        pose_sigma_rad: 50e-6,
        test_place: TEST_PLACES
            .map(|([around, up], [blank, sphere])| TestPlace {
                turned_rad: turned_rad(around),
                raised_mm: of_field(up),
                blank,
                sphere,
            })
            .to_vec(),
        dots: Dots {
            pitch_mm: of_field(50.0),
            diameter_mm: of_field(25.0),
            key_diameter_mm: of_field(35.0),
        },
        blank,
        test_blank: test_blank.to_vec(),
        plate: carrier.printed.into_iter().map(file).collect(),
        sphere: Some(sphere),
        test_sphere: test_sphere.to_vec(),
        beside: BESIDE
            .map(|[around, up]| StageOffset {
                turned_rad: turned_rad(around),
                raised_mm: of_field(up),
            })
            .to_vec(),
        limits: Some(Limits {
            flatness_um: 45.0,
            probing_form_um: 45.0,
            probing_size_um: 8.0,
            flatness_cells_um: Some(8.0),
            probing_form_cells_um: Some(8.0),
            sphere_spacing_um: Some(8.0),
            every_days: 7,
        }),
    }
}

/// The target before the demo head: its plates lie as well as the certificate says, drawn from `seed`.
#[must_use]
pub fn target_world(target: &Target, seed: u64) -> WorldConfig {
    let placed = |plate: &Plate| files::Plate {
        tool_from_plate: Placement {
            rotation: plate.tool_from_plate.rotation,
            translation_mm: plate.tool_from_plate.translation_mm,
        },
    };
    let artefact = |sphere: &Sphere| files::Sphere {
        centre_mm: sphere.centre_mm,
        diameter_mm: sphere.diameter_mm,
        partner: sphere.partner.map(|partner| files::Partner {
            centre_mm: partner.centre_mm,
            diameter_mm: partner.diameter_mm,
        }),
    };
    let file = TargetFile {
        pose_sigma_mm: target.pose_sigma_mm,
        pose_sigma_rad: target.pose_sigma_rad,
        dots: files::Dots {
            pitch_mm: target.dots.pitch_mm,
            diameter_mm: target.dots.diameter_mm,
            key_diameter_mm: target.dots.key_diameter_mm,
        },
        blank: placed(&target.blank),
        plate: target.plate.iter().map(placed).collect(),
        test_blank: target.test_blank.iter().map(placed).collect(),
        sphere: target.sphere.as_ref().map(artefact),
        test_sphere: target.test_sphere.iter().map(artefact).collect(),
    };
    flankscope_bench::demo::target_world(&file, seed)
}

/// The demo head as its drawing shows it: no distortion, lenses and poses off by what assembly leaves.
#[must_use]
pub fn drawn_head() -> HeadModel {
    drawn_head_of(&HeadDesign::demo())
}

/// The same of any head.
#[must_use]
pub fn drawn_head_of(made: &HeadDesign) -> HeadModel {
    let mut head = head_of(made);
    head.name += ", drawing values";
    for (lens, stretch, shift_px) in [
        (&mut head.camera, 1.006, [3.0, -2.0]),
        (&mut head.projector, 0.995, [-2.0, 0.0]),
    ] {
        lens.distortion = [0.0; 5];
        lens.focal_px = lens.focal_px.map(|focal| stretch * focal);
        lens.principal_px = [0, 1].map(|k| lens.principal_px[k] + shift_px[k]);
    }
    let moved = |pose: &Isometry3<f64>, turn: Vector3<f64>, shift: Vector3<f64>| {
        let rotation = UnitQuaternion::from_scaled_axis(turn) * pose.rotation;
        Isometry3::from_parts(
            Translation3::from(pose.translation.vector + shift),
            rotation,
        )
    };
    let projector = transform_of(&head.projector_from_camera);
    let turn = Vector3::new(1.5e-3, -2e-3, 1e-3);
    let shift = Vector3::new(0.04, 0.03, -0.05);
    head.projector_from_camera = transform_file(&moved(&projector, turn, shift));
    head.stage_from_camera = head.stage_from_camera.map(|hand_eye| {
        let turn = Vector3::new(5e-3, -4e-3, 6e-3);
        let shift = Vector3::new(0.25, -0.3, 0.2);
        transform_file(&moved(&transform_of(&hand_eye), turn, shift))
    });
    head
}

/// Writes `target.toml` and the drawing's `head.toml` into a folder, which is made if it is not there; `optics.toml`, too, for any
/// head but the demo's.
///
/// # Errors
/// The files cannot be written.
pub fn write_target(folder: &Path, made: Option<&MadeHead>) -> anyhow::Result<()> {
    std::fs::create_dir_all(folder)?;
    let optics = write_optics(folder, made)?;
    let (target, head) = (target_of(&optics), drawn_head_of(&optics));
    write_whole(&folder.join("target.toml"), target.to_toml()?.as_bytes())?;
    write_whole(&folder.join("head.toml"), head.to_toml()?.as_bytes())?;
    Ok(())
}
