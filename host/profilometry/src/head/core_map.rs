//! The core map: a table beside `head.toml`.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use flankscope_foundation::date::Date;
use flankscope_foundation::textfile::{self, BadValue, TextFileError};

/// Cores of a bundle in the camera's image.
#[derive(Clone, Debug, PartialEq)]
pub struct CoreMap {
    /// Columns of the camera that saw them.
    pub width_px: u32,
    /// Rows of that camera.
    pub height_px: u32,
    /// Standard deviation of one core's image, taken as Gaussian.
    pub core_sigma_px: f64,
    /// Centre of each core: column, row; pixel centres at integers.
    pub positions_px: Vec<[f64; 2]>,
    /// Brightness of each core in the flat field, relative to the median core.
    pub gains: Vec<f32>,
}

/// File of a head's core map: `[cores]` in `head.toml`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CoreMapFile {
    /// CSV, absolute or relative to the head's file.
    pub file: PathBuf,
    /// BLAKE3 of that file, in hexadecimal: a map belongs to one head and one calibration.
    pub blake3: String,
    /// Unit of its positions: `px`.
    pub unit: String,
    /// Day of the flat-field capture.
    pub date: Date,
    /// Standard deviation of one core's image.
    pub core_sigma_px: f64,
}

/// Why a core map cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CoreMapError {
    /// Not readable as text.
    #[error(transparent)]
    File(#[from] TextFileError),
    /// Not the file that the head was calibrated with.
    #[error("{}: BLAKE3 is {got}, head.toml says {expected}: this is not the core map that the head was calibrated with", path.display())]
    Hash {
        /// The map.
        path: PathBuf,
        /// Hash of the file.
        got: String,
        /// Hash in the head's file.
        expected: String,
    },
    /// A line that is none of a core map.
    #[error("{}:{line}: '{got}': expected {expected}", path.display())]
    Line {
        /// The map.
        path: PathBuf,
        /// Its line.
        line: usize,
        /// Text found there.
        got: String,
        /// Allowed values.
        expected: &'static str,
    },
}

const HEADER: &str = "column_px,row_px,gain";
/// 16 MB of text are half a million cores.
const MAX_BYTES: u64 = 16 << 20;

impl CoreMapFile {
    #[rustfmt::skip]
    pub(crate) fn check(&self) -> Result<(), BadValue> {
        textfile::require(&[
            (self.unit == "px", "cores.unit", &self.unit, "must be \"px\", camera pixels with centres at integers"),
            ((0.3..=5.0).contains(&self.core_sigma_px), "cores.core_sigma_px", &self.core_sigma_px, "must be 0.3 to 5 pixels"),
        ])
    }

    /// Reads the map; `head_file` is where the reference stands, the sensor is `width_px` x `height_px`.
    ///
    /// # Errors
    /// [`CoreMapError`] with file, line and what would be right.
    pub fn load(
        &self,
        head_file: &Path,
        width_px: u32,
        height_px: u32,
    ) -> Result<CoreMap, CoreMapError> {
        let path = head_file.with_file_name("").join(&self.file);
        let text = textfile::read_up_to(&path, MAX_BYTES)?;
        let got = blake3::hash(text.as_bytes()).to_hex().to_string();
        if got != self.blake3 {
            return Err(CoreMapError::Hash {
                path,
                got,
                expected: self.blake3.clone(),
            });
        }
        let bad = |line: usize, got: &str, expected| CoreMapError::Line {
            path: path.clone(),
            line: line + 1,
            got: got.chars().take(60).collect(),
            expected,
        };
        let mut lines = text.lines().enumerate();
        match lines.next() {
            Some((_, HEADER)) => {}
            other => return Err(bad(0, other.map_or("", |(_, line)| line), HEADER)),
        }
        let mut map = CoreMap {
            width_px,
            height_px,
            core_sigma_px: self.core_sigma_px,
            positions_px: Vec::new(),
            gains: Vec::new(),
        };
        for (number, line) in lines {
            let numbers = || -> Option<[f64; 3]> {
                let mut fields = line.split(',').map(|field| field.parse().ok());
                let row = [fields.next()??, fields.next()??, fields.next()??];
                fields.next().is_none().then_some(row)
            };
            let [column, row, gain] = numbers()
                .ok_or_else(|| bad(number, line, "three numbers: column_px,row_px,gain"))?;
            let inside = (0.0..f64::from(width_px)).contains(&column)
                && (0.0..f64::from(height_px)).contains(&row);
            if !(inside && gain > 0.0 && gain < 1e3) {
                return Err(bad(
                    number,
                    line,
                    "a place on the camera's sensor and a positive gain",
                ));
            }
            map.positions_px.push([column, row]);
            map.gains.push(gain as f32);
        }
        Ok(map)
    }
}

impl CoreMap {
    /// The file's content, and the reference to it under `file` in a head's file. Positions keep 0.1 mpx.
    pub fn to_csv(&self, file: &Path, date: Date) -> (String, CoreMapFile) {
        let mut text = format!("{HEADER}\n");
        for ([column, row], gain) in self.positions_px.iter().zip(&self.gains) {
            // Writing to a string cannot fail.
            let _ = writeln!(text, "{column:.4},{row:.4},{gain:.4}");
        }
        let reference = CoreMapFile {
            file: file.to_owned(),
            blake3: blake3::hash(text.as_bytes()).to_hex().to_string(),
            unit: "px".to_owned(),
            date,
            core_sigma_px: self.core_sigma_px,
        };
        (text, reference)
    }

    /// Distance between neighbouring cores: `sqrt(2 / sqrt(3) area per core)` of the inner half of the bundle; `None`
    /// for fewer than seven cores.
    pub fn pitch_px(&self) -> Option<f64> {
        let count = self.positions_px.len();
        if count < 7 {
            return None;
        }
        let mean: [f64; 2] = std::array::from_fn(|axis| {
            self.positions_px.iter().map(|p| p[axis]).sum::<f64>() / count as f64
        });
        let mut squares: Vec<f64> = self
            .positions_px
            .iter()
            .map(|p| (p[0] - mean[0]).powi(2) + (p[1] - mean[1]).powi(2))
            .collect();
        let inner = count / 2;
        let (_, radius2, _) = squares.select_nth_unstable_by(inner, f64::total_cmp);
        let area_by_core = std::f64::consts::PI * *radius2 / (inner as f64 + 0.5);
        Some((2.0 / 3f64.sqrt() * area_by_core).sqrt())
    }
}
