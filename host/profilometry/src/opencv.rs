//! OpenCV FileStorage calibrations (XML and YAML) as heads: `Kc kc Kp kp Rp Tp`, millimetres.
//!
//! Kc, Kp: 3x3 camera matrices of camera and projector; kc, kp: distortion (4 or 5 values, OpenCV order); Rp, Tp:
//! `X_projector = Rp X_camera + Tp`. Sizes: frameWidth, frameHeight, screenResX, screenResY.

use std::path::Path;

use crate::calibration::{HeadModel, RigidTransform};
use crate::camera::Pinhole;
use crate::textfile::{TextFileError, line_of_offset};

/// One named node: its numbers, in row order, and the line it starts on.
struct Node {
    name: String,
    shape: Option<[usize; 2]>,
    numbers: Result<Vec<f64>, String>,
    line: usize,
}

struct Storage<'a> {
    path: &'a Path,
    nodes: Vec<Node>,
}

/// Camera, projector and their pose from a FileStorage text. The sensor, the volume and the stage stay unknown.
pub(crate) fn head_from_file_storage(path: &Path, text: &str) -> Result<HeadModel, TextFileError> {
    let nodes = if text
        .trim_start_matches('\u{feff}')
        .trim_start()
        .starts_with('<')
    {
        xml_nodes(path, text)?
    } else {
        yaml_nodes(text)
    };
    let storage = Storage { path, nodes };
    let pinhole = |matrix: &str,
                   distortion: &str,
                   width: &str,
                   height: &str|
     -> Result<Pinhole, TextFileError> {
        let k = storage.matrix::<9>(matrix, "3 x 3 numbers [fx 0 cx; 0 fy cy; 0 0 1]")?;
        if k[1] != 0.0 || k[3] != 0.0 || k[6] != 0.0 || k[7] != 0.0 || k[8] != 1.0 {
            return Err(storage.wrong(
                matrix,
                format!("{k:?}"),
                "[fx 0 cx; 0 fy cy; 0 0 1] without skew",
            ));
        }
        Ok(Pinhole {
            width_px: storage.pixels(width)?,
            height_px: storage.pixels(height)?,
            focal_px: [k[0], k[4]],
            principal_px: [k[2], k[5]],
            distortion: storage.distortion(distortion)?,
            residual: None,
        })
    };
    let camera = pinhole("Kc", "kc", "frameWidth", "frameHeight")?;
    let projector = pinhole("Kp", "kp", "screenResX", "screenResY")?;
    let r = storage.matrix::<9>("Rp", "a 3 x 3 rotation matrix")?;
    let projector_from_camera = RigidTransform {
        rotation: [[r[0], r[1], r[2]], [r[3], r[4], r[5]], [r[6], r[7], r[8]]],
        translation_mm: storage.matrix::<3>("Tp", "3 numbers in mm")?,
    };
    Ok(HeadModel {
        name: path
            .file_stem()
            .map_or_else(String::new, |stem| stem.to_string_lossy().into_owned()),
        working_distance_mm: None,
        pattern_set: None,
        exposures_us: Vec::new(),
        binning: 1,
        camera,
        projector,
        projector_from_camera,
        stage_from_camera: None,
        sensor: None,
        volume: None,
        image_circle: None,
        cores: None,
        calibration: None,
        self_test: None,
        core_map: None,
    })
}

impl Storage<'_> {
    fn node(&self, name: &str) -> Result<&Node, TextFileError> {
        self.nodes.iter().find(|node| node.name == name).ok_or_else(|| TextFileError::Value {
            path: self.path.to_owned(),
            line: 1,
            key: name.to_owned(),
            got: "nothing".to_owned(),
            expected: "must be present: a calibration has Kc, kc, Kp, kp, Rp, Tp, frameWidth, frameHeight, screenResX and screenResY",
        })
    }

    fn wrong(&self, name: &str, got: String, expected: &'static str) -> TextFileError {
        let line = self
            .nodes
            .iter()
            .find(|node| node.name == name)
            .map_or(1, |node| node.line);
        TextFileError::Value {
            path: self.path.to_owned(),
            line,
            key: name.to_owned(),
            got,
            expected,
        }
    }

    fn numbers(&self, name: &str) -> Result<&[f64], TextFileError> {
        let node = self.node(name)?;
        let numbers = node
            .numbers
            .as_ref()
            .map_err(|bad| self.wrong(name, bad.clone(), "must be numbers"))?;
        if let Some(bad) = numbers.iter().find(|value| !value.is_finite()) {
            return Err(self.wrong(name, bad.to_string(), "must be finite"));
        }
        if let Some([rows, columns]) = node.shape
            && rows.checked_mul(columns) != Some(numbers.len())
        {
            let got = format!(
                "{} numbers for {rows} rows x {columns} columns",
                numbers.len()
            );
            return Err(self.wrong(name, got, "must have rows x cols numbers"));
        }
        Ok(numbers)
    }

    fn matrix<const N: usize>(
        &self,
        name: &str,
        expected: &'static str,
    ) -> Result<[f64; N], TextFileError> {
        let numbers = self.numbers(name)?;
        numbers
            .try_into()
            .map_err(|_| self.wrong(name, format!("{} numbers", numbers.len()), expected))
    }

    fn distortion(&self, name: &str) -> Result<[f64; 5], TextFileError> {
        match *self.numbers(name)? {
            [k1, k2, p1, p2] => Ok([k1, k2, p1, p2, 0.0]),
            [k1, k2, p1, p2, k3] => Ok([k1, k2, p1, p2, k3]),
            ref other => Err(self.wrong(
                name,
                format!("{} numbers", other.len()),
                "must be 4 or 5: k1, k2, p1, p2 and k3",
            )),
        }
    }

    fn pixels(&self, name: &str) -> Result<u32, TextFileError> {
        let [value] = self.matrix::<1>(name, "one whole number of pixels")?;
        if value.fract() != 0.0 || !(1.0..=1e6).contains(&value) {
            return Err(self.wrong(name, value.to_string(), "must be a whole number of pixels"));
        }
        Ok(value as u32)
    }
}

fn parse_numbers<'a>(words: impl Iterator<Item = &'a str>) -> Result<Vec<f64>, String> {
    words
        .map(|word| word.parse().map_err(|_| format!("{word:?}")))
        .collect()
}

fn xml_nodes(path: &Path, text: &str) -> Result<Vec<Node>, TextFileError> {
    let syntax = |line: usize, message: String| TextFileError::Syntax {
        path: path.to_owned(),
        line,
        message,
    };
    let document = roxmltree::Document::parse(text).map_err(|error| {
        syntax(
            error.pos().row as usize,
            format!("{error}; expected an OpenCV FileStorage document"),
        )
    })?;
    let root = document.root_element();
    if !root.has_tag_name("opencv_storage") {
        return Err(syntax(
            1,
            format!(
                "<{}> is not an OpenCV calibration: expected <opencv_storage>",
                root.tag_name().name()
            ),
        ));
    }
    let child_text = |node: roxmltree::Node<'_, '_>, name: &str| {
        node.children()
            .find(|child| child.has_tag_name(name))
            .and_then(|child| child.text().map(str::to_owned))
    };
    let nodes = root
        .children()
        .filter(roxmltree::Node::is_element)
        .map(|element| {
            let line = line_of_offset(text, element.range().start);
            let side = |name| child_text(element, name).and_then(|words| words.trim().parse().ok());
            let shape = side("rows")
                .zip(side("cols"))
                .map(|(rows, columns)| [rows, columns]);
            let words = child_text(element, "data")
                .or_else(|| element.text().map(str::to_owned))
                .unwrap_or_default();
            Node {
                name: element.tag_name().name().to_owned(),
                shape,
                numbers: parse_numbers(words.split_ascii_whitespace()),
                line,
            }
        });
    Ok(nodes.collect())
}

/// The subset of YAML that FileStorage writes: `name: number`, and `name: !!opencv-matrix` with indented rows, cols, dt
/// and `data: [ ... ]` over one or more lines.
fn yaml_nodes(text: &str) -> Vec<Node> {
    let mut nodes: Vec<Node> = Vec::new();
    let mut data: Option<String> = None;
    for (number, line) in text.lines().enumerate() {
        let indented = line.starts_with([' ', '\t']);
        if let Some(open) = &mut data {
            open.push(' ');
            open.push_str(line.trim());
        } else if let Some((key, value)) = line.split_once(':') {
            let (key, value) = (key.trim(), value.trim());
            if !indented && !line.starts_with(['%', '-', '#']) {
                nodes.push(Node {
                    name: key.to_owned(),
                    shape: None,
                    numbers: parse_numbers(value.split_ascii_whitespace()),
                    line: number + 1,
                });
            } else if indented && let Some(node) = nodes.last_mut() {
                match key {
                    "rows" => {
                        node.shape = Some([
                            value.parse().unwrap_or(0),
                            node.shape.map_or(0, |shape| shape[1]),
                        ])
                    }
                    "cols" => {
                        node.shape = Some([
                            node.shape.map_or(0, |shape| shape[0]),
                            value.parse().unwrap_or(0),
                        ])
                    }
                    "data" => data = Some(value.to_owned()),
                    _ => {}
                }
            }
        }
        // A list ends with its bracket, wherever that stands.
        if let Some(open) = data.take() {
            if !open.contains(']') {
                data = Some(open);
            } else if let Some(node) = nodes.last_mut() {
                let inside = open.trim_start_matches('[').split(']').next().unwrap_or("");
                node.numbers = parse_numbers(
                    inside
                        .split(',')
                        .map(str::trim)
                        .filter(|word| !word.is_empty()),
                );
            }
        }
    }
    nodes
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
        let text = YAML.replace("1500., 0., 512.", "1500., 0., .Nan");
        let error = head_from_file_storage(Path::new("c.yml"), &text)
            .unwrap_err()
            .to_string();
        assert!(error.contains("Kp = "), "{error}");
    }
}
