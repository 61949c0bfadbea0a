//! OpenCV calibrations as heads: `Kc kc Kp kp Rp Tp`, or the names that other programs write, millimetres.
//!
//! Kc, Kp: 3x3 camera matrices of camera and projector; kc, kp: distortion (4 or 5 values, OpenCV order); Rp, Tp:
//! `X_projector = Rp X_camera + Tp`. Sizes: frameWidth, frameHeight, screenResX, screenResY.

use std::path::Path;

use super::{HeadModel, Pinhole, RigidTransform};
use crate::io::opencv::Storage;
use flankscope_foundation::textfile::TextFileError;

/// Names of one thing: ours first, then those of OpenCV's `stereo_calib` sample and of `stereoCalibrate`'s arguments (camera
/// first, projector second), then those of Moreno and Taubin's calibration of projectors (3DIMPVT 2012).
type Names = &'static [&'static str];
const CAMERA_MATRIX: Names = &["Kc", "M1", "cameraMatrix1", "cam_K"];
const CAMERA_DISTORTION: Names = &["kc", "D1", "distCoeffs1", "cam_kc"];
const CAMERA_SIZE: [Names; 2] = [
    &["frameWidth", "image_width", "cam_width"],
    &["frameHeight", "image_height", "cam_height"],
];
const PROJECTOR_MATRIX: Names = &["Kp", "M2", "cameraMatrix2", "proj_K"];
const PROJECTOR_DISTORTION: Names = &["kp", "D2", "distCoeffs2", "proj_kc"];
const PROJECTOR_SIZE: [Names; 2] = [
    &["screenResX", "proj_width"],
    &["screenResY", "proj_height"],
];
const ROTATION: Names = &["Rp", "R"];
const TRANSLATION: Names = &["Tp", "T"];

/// Camera, projector and their pose from a FileStorage text. The sensor, the volume and the stage stay unknown.
pub(super) fn head_from_file_storage(path: &Path, text: &str) -> Result<HeadModel, TextFileError> {
    let storage = Storage::parse(path, text)?;
    let pinhole = |matrix: Names,
                   distortion: Names,
                   [width, height]: [Names; 2]|
     -> Result<Pinhole, TextFileError> {
        let matrix = storage.which(matrix)?;
        let k = storage.matrix::<9>(matrix, "3 x 3 numbers [fx 0 cx; 0 fy cy; 0 0 1]")?;
        if k[1] != 0.0 || k[3] != 0.0 || k[6] != 0.0 || k[7] != 0.0 || k[8] != 1.0 {
            return Err(storage.wrong(
                matrix,
                format!("{k:?}"),
                "[fx 0 cx; 0 fy cy; 0 0 1] without skew",
            ));
        }
        Ok(Pinhole {
            width_px: storage.pixels(storage.which(width)?)?,
            height_px: storage.pixels(storage.which(height)?)?,
            focal_px: [k[0], k[4]],
            principal_px: [k[2], k[5]],
            distortion: storage.distortion(storage.which(distortion)?)?,
            residual: None,
        })
    };
    let camera = pinhole(CAMERA_MATRIX, CAMERA_DISTORTION, CAMERA_SIZE)?;
    let projector = pinhole(PROJECTOR_MATRIX, PROJECTOR_DISTORTION, PROJECTOR_SIZE)?;
    let r = storage.matrix::<9>(storage.which(ROTATION)?, "a 3 x 3 rotation matrix")?;
    let projector_from_camera = RigidTransform {
        rotation: [[r[0], r[1], r[2]], [r[3], r[4], r[5]], [r[6], r[7], r[8]]],
        translation_mm: storage.matrix::<3>(storage.which(TRANSLATION)?, "3 numbers in mm")?,
    };
    let name = path.file_stem().unwrap_or_default().to_string_lossy();
    Ok(HeadModel::from_lenses(
        &name,
        camera,
        projector,
        projector_from_camera,
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    const YAML: &str = "%YAML:1.0\n---\nKc: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: f\n   data: [ 2000., 0., 640., 0., 2001., 480., 0., 0., 1. ]\nkc: !!opencv-matrix\n   rows: 1\n   cols: 5\n   dt: d\n   data: [ -1.0e-01, 2.0e-02, 0., 1.0e-03,\n       3.0e-03 ]\nKp: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: f\n   data: [ 1500., 0., 512., 0., 1500., 384., 0., 0., 1. ]\nkp: !!opencv-matrix\n   rows: 5\n   cols: 1\n   dt: f\n   data: [ 0., 0., 0., 0., 0. ]\nRp: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: f\n   data: [ 1., 0., 0., 0., 1., 0., 0., 0., 1. ]\nTp: !!opencv-matrix\n   rows: 3\n   cols: 1\n   dt: f\n   data: [ -100., 0., 0. ]\nframeWidth: 1280\nframeHeight: 960\nscreenResX: 1024\nscreenResY: 768\n";

    #[test]
    fn yaml_is_read() {
        let head = head_from_file_storage(Path::new("calibration.yml"), YAML).unwrap();
        assert_eq!(head.camera.focal_px, [2000.0, 2001.0]);
        assert_eq!(head.camera.distortion, [-0.1, 0.02, 0.0, 1e-3, 3e-3]);
        assert_eq!(head.projector.width_px, 1024);
        assert_eq!(
            head.projector_from_camera.translation_mm,
            [-100.0, 0.0, 0.0]
        );
    }

    #[test]
    fn other_programs_names_are_read_and_never_two_for_one_thing() {
        let ours = head_from_file_storage(Path::new("c.yml"), YAML).unwrap();
        let keys = ["Kc:", "kc:", "Kp:", "kp:", "Rp:", "Tp:"];
        for names in [
            ["M1:", "D1:", "M2:", "D2:", "R:", "T:"],
            ["cam_K:", "cam_kc:", "proj_K:", "proj_kc:", "R:", "T:"],
        ] {
            let mut text = YAML.to_owned();
            for (ours, theirs) in keys.into_iter().zip(names) {
                text = text.replace(ours, theirs);
            }
            let theirs = head_from_file_storage(Path::new("c.yml"), &text).unwrap();
            assert_eq!(format!("{theirs:?}"), format!("{ours:?}"));
        }
        let both = format!("{YAML}M1: !!opencv-matrix\n   rows: 1\n");
        let error = head_from_file_storage(Path::new("c.yml"), &both)
            .unwrap_err()
            .to_string();
        assert!(error.contains("M1 = a second value beside Kc"), "{error}");
    }

    #[test]
    fn what_is_missing_or_misshapen_is_named_with_its_line() {
        let missing = YAML.replace("Tp:", "Xp:");
        let error = head_from_file_storage(Path::new("c.yml"), &missing)
            .unwrap_err()
            .to_string();
        assert!(error.contains("Tp = nothing"), "{error}");
        let short = YAML.replace("data: [ -100., 0., 0. ]", "data: [ -100., 0. ]");
        let error = head_from_file_storage(Path::new("c.yml"), &short)
            .unwrap_err()
            .to_string();
        assert!(
            error.contains("c.yml:29: Tp = 2 numbers for 3 rows x 1 columns"),
            "{error}"
        );
        // Rows and columns are read as they are, and a focal length of nothing is none.
        for (from, to, named) in [
            (
                "rows: 3\n   cols: 1\n",
                "rows: -7\n   cols: 1\n",
                "Tp = 3 numbers for -7 rows",
            ),
            (
                "rows: 3\n   cols: 1\n",
                "rows: 3\n   cols: 1000000000\n",
                "1000000000 columns",
            ),
            ("rows: 3\n   cols: 1\n", "rows: 3\n", "3 rows x  columns"),
        ] {
            let text = YAML.replace(from, to);
            assert_ne!(text, YAML);
            let error = head_from_file_storage(Path::new("c.yml"), &text)
                .unwrap_err()
                .to_string();
            assert!(error.contains(named), "{error}");
        }
        let flat = YAML.replace("0., 1500., 384.", "0., 1e-12, 384.");
        let head = head_from_file_storage(Path::new("c.yml"), &flat).unwrap();
        let error = head.check().unwrap_err();
        assert!(
            format!("{error:?}").contains("projector.focal_px"),
            "{error:?}"
        );
        let text = YAML.replace("1500., 0., 512.", "1500., 0., .Nan");
        let error = head_from_file_storage(Path::new("c.yml"), &text)
            .unwrap_err()
            .to_string();
        assert!(error.contains("Kp = "), "{error}");
    }
}
