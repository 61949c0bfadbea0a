//! The pictures that the DMD has to show, one pixel per mirror, and a manifest that assigns pictures to patterns.
//!
//! Brightness is the fraction of the exposure in which a mirror is on: no gamma, no scaling. Patterns are numbered as in a
//! capture plan, from 1; number 0 is black, which every DMD controller can show without a picture.

mod adaptive;
mod light;
mod loading;
mod passes;

use std::io::Write;
use std::path::{Path, PathBuf};

use flankscope_profilometry::PatternSet;
use flankscope_profilometry::head::{Arrangement, Mirrors};
use flankscope_profilometry::pattern::{Axis, Shown};
use flankscope_protocol::pattern_memory::{Place, Plane};
use serde::Serialize;

use flankscope_foundation::files::{hash, write_whole};

pub use adaptive::{Adaptive, AdaptiveError, CaptureTime, Pass, write_adaptive};
pub use light::PatternLight;
pub use loading::Loading;
pub use passes::{Passes, PassesError, Region};

/// How pictures are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Packing {
    /// A grey PNG for each pattern.
    Grey,
    /// Three patterns in the channels of a 24 bit BMP, as a DLPC350's flash takes them.
    Dlpc350,
    /// A grey BMP of 24 bit for each pattern, behind a black one: image n of a DLPC900's flash is pattern n.
    Dlpc900,
}

impl Packing {
    /// Packing for a layout of mirrors: DMDs with diamond layout are driven by a DLPC350.
    #[must_use]
    pub fn of(mirrors: Mirrors) -> Self {
        match mirrors.arrangement {
            Arrangement::Diamond => Self::Dlpc350,
            Arrangement::Orthogonal => Self::Grey,
        }
    }
}

/// `patterns.json`: the pictures that were written, in the order of a view's frames.
#[derive(Clone, Debug, Serialize)]
pub struct Manifest {
    /// Format of this document.
    pub format: &'static str,
    /// Name of the set.
    pub set: String,
    /// Layout of the mirrors.
    pub mirrors: Mirrors,
    /// Storage of the pictures.
    pub packing: Packing,
    /// Which device drives the LED.
    pub led: &'static str,
    /// How pattern 0 is shown.
    pub black: &'static str,
    /// The patterns, from number 1 on.
    pub patterns: Vec<Pattern>,
    pub files: Vec<Picture>,
}

#[derive(Clone, Debug, Serialize)]
pub struct Pattern {
    /// Its number in a capture plan.
    pub number: u16,
    /// Picture file that contains it.
    pub file: String,
    /// Number of the picture, from 0: the image in flash.
    pub image: u16,
    /// Number of the pattern within the picture, as in the pattern table of a DLPC350.
    pub pattern_in_image: u8,
    /// Its bit planes in the picture, most significant first.
    pub bit_planes: &'static str,
    /// Bit depth of the brightness.
    pub bits: u8,
    /// Content: fringes or stripes.
    #[serde(flatten)]
    pub shows: Content,
}

/// What a pattern shows.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(untagged)]
pub enum Content {
    /// A phase step.
    Fringe {
        /// Periods over all columns, or rows.
        periods: f64,
        /// Phase step, from 0.
        step: u32,
        /// Phase steps per period.
        steps: u32,
    },
    /// A bit of a Gray code.
    Code {
        /// Index of the bit, 0 is the most significant.
        code_bit: u32,
        /// Whether dark and bright are exchanged.
        complement: bool,
    },
}

impl Content {
    fn of(set: &PatternSet, picture: Shown) -> Self {
        match picture {
            Shown::Fringe { set: of, step } => Self::Fringe {
                periods: set.sets[of].periods,
                step,
                steps: set.sets[of].steps,
            },
            Shown::Code { bit, complement } => Self::Code {
                code_bit: bit,
                complement,
            },
        }
    }
}

#[derive(Clone, Debug, Serialize)]
pub struct Picture {
    /// File name.
    pub file: String,
    /// BLAKE3 of the file.
    pub blake3: String,
}

/// Why pictures could not be made.
#[derive(Debug, thiserror::Error)]
pub enum PatternsError {
    /// A file cannot be written.
    #[error("{}: {source}", path.display())]
    Write {
        /// Path of the file.
        path: PathBuf,
        /// Cause.
        source: std::io::Error,
    },
    /// A picture could not be encoded.
    #[error("a picture of {columns} x {rows} mirrors cannot be encoded: {reason}")]
    Encode {
        /// Mirrors per row.
        columns: u32,
        rows: u32,
        reason: String,
    },
}

impl Manifest {
    /// File name.
    pub const FILE: &'static str = "patterns.json";
}

/// Brightness of every mirror, row by row, 0 dark to 255 bright.
#[must_use]
pub fn brightness(set: &PatternSet, picture: Shown, mirrors: Mirrors) -> Vec<u8> {
    let shown = |at_px: f64, width_px: u32| {
        let share = set.intensity(picture, at_px, f64::from(width_px));
        (255.0 * share).round() as u8
    };
    let columns = mirrors.columns as usize;
    if set.axis == Axis::Rows {
        return (0..mirrors.rows)
            .flat_map(|row| std::iter::repeat_n(shown(f64::from(row), mirrors.rows), columns))
            .collect();
    }
    // Fringes are vertical: rows differ only by where they begin.
    let rows = [0, 1].map(|row| {
        (0..mirrors.columns)
            .map(|column| shown(mirrors.column_px(column, row), mirrors.columns))
            .collect::<Vec<u8>>()
    });
    (0..mirrors.rows as usize)
        .flat_map(|row| &rows[row % 2])
        .copied()
        .collect()
}

/// Writes the pictures of a set and `patterns.json` into a folder, which is created.
pub fn write(
    folder: &Path,
    set: &PatternSet,
    mirrors: Mirrors,
    packing: Packing,
) -> Result<Manifest, PatternsError> {
    write_lit(folder, set, mirrors, packing, |_| ())
}

/// Like `write`, with `light` applied to the brightness of each pattern's mirrors, to light only some of them.
fn write_lit(
    folder: &Path,
    set: &PatternSet,
    mirrors: Mirrors,
    packing: Packing,
    light: impl Fn(&mut [u8]),
) -> Result<Manifest, PatternsError> {
    let failed = |path: &Path| {
        let path = path.to_owned();
        move |source| PatternsError::Write { path, source }
    };
    std::fs::create_dir_all(folder).map_err(failed(folder))?;
    let mut manifest = Manifest {
        format: "flankscope/patterns/1",
        set: set.name.clone(),
        mirrors,
        packing,
        led: "driven by the controller board, not by the DMD's: LED select 0 (none) in the table of a DLPC350 or DLPC900",
        black: match packing {
            Packing::Dlpc900 => "image 0",
            _ => "needs no picture: a DLPC350 shows its white fill (pattern 24 at 1 bit), inverted",
        },
        patterns: Vec::new(),
        files: Vec::new(),
    };
    let mut pictures: Vec<Vec<Vec<u8>>> = Vec::new();
    if packing == Packing::Dlpc900 {
        let mirrors = mirrors.columns as usize * mirrors.rows as usize;
        pictures.push(vec![vec![0; mirrors]]);
    }
    for (number, shows) in (1_u16..).zip(set.pictures()) {
        let mut shown = brightness(set, shows, mirrors);
        light(&mut shown);
        let (image, pattern_in_image, bit_planes) = match (packing, Place::of(number)) {
            (Packing::Dlpc350, Some(Place { image, plane })) => {
                let bits = match plane {
                    Plane::Green => "G7..G0",
                    Plane::Red => "R7..R0",
                    Plane::Blue => "B7..B0",
                };
                (image, plane as u8, bits)
            }
            (Packing::Dlpc900, _) => (number, 0, "7..0"),
            _ => (number - 1, 0, "7..0"),
        };
        match pictures.get_mut(usize::from(image)) {
            Some(planes) => planes.push(shown),
            None => pictures.push(vec![shown]),
        }
        manifest.patterns.push(Pattern {
            number,
            file: file_name(packing, image),
            image,
            pattern_in_image,
            bit_planes,
            bits: 8,
            shows: Content::of(set, shows),
        });
    }
    for (image, planes) in (0_u16..).zip(&pictures) {
        let content = match packing {
            Packing::Grey => grey_png(&planes[0], mirrors)?,
            Packing::Dlpc350 => bmp(planes, mirrors),
            Packing::Dlpc900 => bmp(&vec![planes[0].clone(); 3], mirrors),
        };
        let file = file_name(packing, image);
        let path = folder.join(&file);
        write_whole(&path, &content).map_err(failed(&path))?;
        let blake3 = hash(&content);
        manifest.files.push(Picture { file, blake3 });
    }
    let path = folder.join(Manifest::FILE);
    let mut text = serde_json::to_vec_pretty(&manifest).unwrap_or_default();
    text.push(b'\n');
    write_whole(&path, &text).map_err(failed(&path))?;
    Ok(manifest)
}

fn file_name(packing: Packing, image: u16) -> String {
    match packing {
        Packing::Grey => format!("pattern-{:02}.png", image + 1),
        Packing::Dlpc350 | Packing::Dlpc900 => format!("image-{image:02}.bmp"),
    }
}

fn grey_png(shown: &[u8], mirrors: Mirrors) -> Result<Vec<u8>, PatternsError> {
    let mut content = Vec::new();
    let mut encoder = png::Encoder::new(&mut content, mirrors.columns, mirrors.rows);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Eight);
    let written = encoder.write_header().and_then(|mut writer| {
        writer.write_image_data(shown)?;
        writer.finish()
    });
    written.map_err(|error| PatternsError::Encode {
        columns: mirrors.columns,
        rows: mirrors.rows,
        reason: error.to_string(),
    })?;
    Ok(content)
}

/// A 24 bit Windows bitmap, last row first; missing planes are dark.
fn bmp(planes: &[Vec<u8>], mirrors: Mirrors) -> Vec<u8> {
    const HEADERS: u32 = 14 + 40;
    let (columns, rows) = (mirrors.columns as usize, mirrors.rows as usize);
    let row_bytes = (3 * columns).next_multiple_of(4);
    let pixels = (row_bytes * rows) as u32;
    let mut content = Vec::with_capacity(HEADERS as usize + pixels as usize);
    content.extend_from_slice(b"BM");
    for field in [
        HEADERS + pixels,
        0,
        HEADERS,
        40,
        mirrors.columns,
        mirrors.rows,
    ] {
        content.extend_from_slice(&field.to_le_bytes());
    }
    for field in [1_u16, 24] {
        content.extend_from_slice(&field.to_le_bytes());
    }
    for field in [0, pixels, 0, 0, 0, 0_u32] {
        content.extend_from_slice(&field.to_le_bytes());
    }
    let of = |plane: Plane, at: usize| planes.get(plane as usize).map_or(0, |shown| shown[at]);
    for row in (0..rows).rev() {
        let start = content.len();
        for at in row * columns..(row + 1) * columns {
            let _ = content.write_all(&[
                of(Plane::Blue, at),
                of(Plane::Green, at),
                of(Plane::Red, at),
            ]);
        }
        content.resize(start + row_bytes, 0);
    }
    content
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    const DLP4500: Mirrors = Mirrors {
        arrangement: Arrangement::Diamond,
        columns: 912,
        rows: 1140,
    };
    const XGA: Mirrors = Mirrors {
        arrangement: Arrangement::Orthogonal,
        columns: 1024,
        rows: 768,
    };

    /// Brightness of a fringe pattern at a column, by the formula of METROLOGY and of the bench.
    fn fringe(periods: f64, step: u32, steps: u32, at_px: f64, columns: u32) -> u8 {
        let phase = TAU * periods * (at_px + 0.5) / f64::from(columns)
            + TAU * f64::from(step) / f64::from(steps);
        (255.0 * (0.5 + 0.5 * phase.cos())).round() as u8
    }

    fn fringe_picture(set: usize, step: u32) -> Shown {
        Shown::Fringe { set, step }
    }

    fn near(got: u8, expected: u8) -> bool {
        // A rounding at .5 may go either way.
        got.abs_diff(expected) <= 1
    }

    #[test]
    fn every_pattern_is_a_cosine_where_its_mirrors_are() {
        for mirrors in [XGA, DLP4500] {
            for name in ["article8", "insitu12", "scan16"] {
                let set = PatternSet::named(name).unwrap();
                for (frequency, of) in set.sets.iter().enumerate() {
                    for step in 0..of.steps {
                        let shown = brightness(&set, fringe_picture(frequency, step), mirrors);
                        for row in [0, 1, 2, mirrors.rows - 1] {
                            for column in 0..mirrors.columns {
                                let half = match mirrors.arrangement {
                                    Arrangement::Diamond => 0.5 * f64::from(row % 2),
                                    Arrangement::Orthogonal => 0.0,
                                };
                                let at_px = f64::from(column) + half;
                                let got = shown[(row * mirrors.columns + column) as usize];
                                let right =
                                    fringe(of.periods, step, of.steps, at_px, mirrors.columns);
                                assert!(near(got, right), "{name} {row} {column}: {got} {right}");
                            }
                        }
                    }
                }
            }
        }
    }

    /// SLStudio makes a pattern of twice the columns and takes column `2 c + r % 2` of it for mirror c of row r.
    #[test]
    fn diamond_mirrors_are_those_of_slstudio() {
        let set = PatternSet::named("insitu12").unwrap();
        let shown = brightness(&set, fringe_picture(1, 3), DLP4500);
        let twice: Vec<u8> = (0..2 * DLP4500.columns)
            .map(|column| fringe(48.0, 3, 8, f64::from(column) / 2.0, DLP4500.columns))
            .collect();
        for row in 0..4 {
            for column in 0..DLP4500.columns {
                let got = shown[(row * DLP4500.columns + column) as usize];
                let theirs = twice[(2 * column + row % 2) as usize];
                assert!(near(got, theirs), "{row} {column}");
            }
        }
    }

    /// Reads pictures back by the definition of the format, channel by channel, and compares them with the manifest.
    #[test]
    fn pictures_and_manifest_tell_the_same() {
        let folder = tempfile::tempdir().unwrap();
        let set = PatternSet::named("article8").unwrap();
        let manifest = write(folder.path(), &set, DLP4500, Packing::Dlpc350).unwrap();
        assert_eq!(manifest.patterns.len(), 8);
        assert_eq!(manifest.files.len(), 3, "three patterns to a picture");
        for (number, pattern) in (0..).zip(&manifest.patterns) {
            let picture = fringe_picture(number / 4, (number % 4) as u32);
            let content = std::fs::read(folder.path().join(&pattern.file)).unwrap();
            let word = |at: usize| u32::from_le_bytes(content[at..at + 4].try_into().unwrap());
            assert_eq!(&content[..2], b"BM");
            assert_eq!((word(18), word(22)), (912, 1140));
            assert_eq!(word(2) as usize, content.len());
            // Blue, green, red.
            let channel = match &pattern.bit_planes[..1] {
                "B" => 0,
                "G" => 1,
                "R" => 2,
                other => panic!("{other}"),
            };
            let shown = brightness(&set, picture, DLP4500);
            for (row, column) in [(0, 0), (0, 911), (1139, 5), (700, 300)] {
                let at = word(10) as usize + (1139 - row) * 912 * 3 + column * 3 + channel;
                assert_eq!(content[at], shown[row * 912 + column], "{}", pattern.number);
            }
        }
        let order: Vec<u8> = manifest
            .patterns
            .iter()
            .map(|p| p.pattern_in_image)
            .collect();
        assert_eq!(order, [0, 1, 2, 0, 1, 2, 0, 1]);
        // For a DLPC900, image n is pattern n, grey in every channel, and image 0 is black.
        let stored = write(folder.path(), &set, XGA, Packing::Dlpc900).unwrap();
        assert_eq!((stored.files.len(), stored.black), (9, "image 0"));
        for number in 0..9_u16 {
            let path = folder.path().join(format!("image-{number:02}.bmp"));
            let content = std::fs::read(path).unwrap();
            let pixels = &content[54..];
            assert_eq!(pixels.len(), 3 * 1024 * 768);
            let shown = number.checked_sub(1).map(|index| {
                let picture = fringe_picture(usize::from(index / 4), u32::from(index % 4));
                assert_eq!(stored.patterns[usize::from(index)].image, number);
                brightness(&set, picture, XGA)
            });
            for (row, column) in [(0, 0), (0, 1023), (767, 5), (400, 300)] {
                let at = 3 * ((767 - row) * 1024 + column);
                let level = shown.as_ref().map_or(0, |shown| shown[row * 1024 + column]);
                assert_eq!(pixels[at..at + 3], [level; 3], "{number}");
            }
        }
        let grey = write(folder.path(), &set, XGA, Packing::Grey).unwrap();
        let path = folder.path().join(&grey.patterns[7].file);
        let decoder =
            png::Decoder::new(std::io::BufReader::new(std::fs::File::open(path).unwrap()));
        let mut reader = decoder.read_info().unwrap();
        let mut pixels = vec![0; 1024 * 768];
        let info = reader.next_frame(&mut pixels).unwrap();
        assert_eq!((info.width, info.height), (1024, 768));
        assert_eq!(pixels, brightness(&set, fringe_picture(1, 3), XGA));
    }
}
