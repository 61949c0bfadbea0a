//! Grey PNG frames of other people's cameras.

use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use crate::frame::FrameView;

/// A decoded grey image of 8 or 16 bits.
#[derive(Clone, Debug, PartialEq)]
pub struct GreyImage {
    /// Row after row.
    pub pixels: Vec<u16>,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// 8 or 16.
    pub bits: u32,
}

impl GreyImage {
    /// The image as a frame.
    pub fn view(&self) -> FrameView<'_> {
        FrameView::packed(&self.pixels, self.width, self.height)
    }
}

/// Why an image, or a folder of images, was refused.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ImageError {
    /// No such file, or no permission.
    #[error("cannot read image {}: {source}", path.display())]
    Open {
        /// The file.
        path: PathBuf,
        /// The operating system's reason.
        source: std::io::Error,
    },
    /// Truncated, damaged, or no PNG at all.
    #[error("{} is not a whole PNG image: {source}", path.display())]
    Png {
        /// The file.
        path: PathBuf,
        /// The decoder's reason.
        source: png::DecodingError,
    },
    /// Colour, palette, alpha or fewer bits.
    #[error("{} is {colour:?} with {bits} bits: frames must be grey with 8 or 16 bits", path.display())]
    NotGrey {
        /// The file.
        path: PathBuf,
        /// What it is.
        colour: png::ColorType,
        /// Its bits per channel.
        bits: u32,
    },
    /// Not the size of the head's camera; found before anything is allocated.
    #[error("{} has {got_width} x {got_height} pixels, the calibrated camera {width} x {height}", path.display())]
    Size {
        /// The file.
        path: PathBuf,
        /// Width found.
        got_width: u32,
        /// Height found.
        got_height: u32,
        /// Width of the camera.
        width: u32,
        /// Height of the camera.
        height: u32,
    },
    /// 8 and 16 bits mixed.
    #[error("{} has {got} bits, the frames before it {expected}", path.display())]
    Bits {
        /// The file.
        path: PathBuf,
        /// Bits found.
        got: u32,
        /// Bits of the first frame.
        expected: u32,
    },
    /// Too few or too many images for the plan.
    #[error("{} holds {got} PNG images, the plan has {expected} frames: list them in the plan, or keep exactly the frames of one view there", folder.display())]
    Count {
        /// The folder.
        folder: PathBuf,
        /// Images found.
        got: usize,
        /// Frames planned.
        expected: usize,
    },
    /// The folder cannot be listed.
    #[error("cannot list {}: {source}", path.display())]
    Folder {
        /// The folder.
        path: PathBuf,
        /// The operating system's reason.
        source: std::io::Error,
    },
}

/// Loads one grey PNG of exactly `width` x `height` pixels.
///
/// # Errors
/// [`ImageError`]; the size in the header is checked before memory is taken.
pub fn load_grey_png(path: &Path, width: u32, height: u32) -> Result<GreyImage, ImageError> {
    let broken = |source| ImageError::Png {
        path: path.to_owned(),
        source,
    };
    let file = File::open(path).map_err(|source| ImageError::Open {
        path: path.to_owned(),
        source,
    })?;
    let mut reader = png::Decoder::new(BufReader::new(file))
        .read_info()
        .map_err(broken)?;
    let info = reader.info();
    if (info.width, info.height) != (width, height) {
        return Err(ImageError::Size {
            path: path.to_owned(),
            got_width: info.width,
            got_height: info.height,
            width,
            height,
        });
    }
    let bits = match (info.color_type, info.bit_depth) {
        (png::ColorType::Grayscale, png::BitDepth::Eight) => 8,
        (png::ColorType::Grayscale, png::BitDepth::Sixteen) => 16,
        (colour, depth) => {
            return Err(ImageError::NotGrey {
                path: path.to_owned(),
                colour,
                bits: depth as u32,
            });
        }
    };
    let bytes_per_pixel = bits as usize / 8;
    let mut bytes = vec![0; width as usize * height as usize * bytes_per_pixel];
    reader.next_frame(&mut bytes).map_err(broken)?;
    let pixels = if bits == 8 {
        bytes.into_iter().map(u16::from).collect()
    } else {
        // PNG is big endian.
        bytes
            .as_chunks::<2>()
            .0
            .iter()
            .map(|&pair| u16::from_be_bytes(pair))
            .collect()
    };
    Ok(GreyImage {
        pixels,
        width: width as usize,
        height: height as usize,
        bits,
    })
}

/// All PNG files of a folder, sorted by name; there must be exactly `expected`.
///
/// # Errors
/// [`ImageError::Folder`], [`ImageError::Count`].
pub fn list_pngs(folder: &Path, expected: usize) -> Result<Vec<PathBuf>, ImageError> {
    let failed = |source| ImageError::Folder {
        path: folder.to_owned(),
        source,
    };
    let mut paths = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        if path
            .extension()
            .is_some_and(|extension| extension.eq_ignore_ascii_case("png"))
        {
            paths.push(path);
        }
    }
    if paths.len() != expected {
        return Err(ImageError::Count {
            folder: folder.to_owned(),
            got: paths.len(),
            expected,
        });
    }
    paths.sort();
    Ok(paths)
}
