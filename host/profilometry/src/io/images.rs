//! Grey frames of other people's cameras: PNG, TIFF, and binary PGM (Netpbm's P5).

use std::io::{BufRead, BufReader, Cursor, Read, Seek};
use std::path::{Path, PathBuf};

use flankscope_foundation::files::open_regular;
use tiff::decoder::DecodingResult;
use tiff::tags::Tag;

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
    /// Bits of a stored number, 8 or 16.
    pub bits: u32,
    /// Largest count of the camera, where the file states one below the end of its numbers: the largest value of a PGM, 2^n - 1 of n
    /// significant bits (`sBIT`) of a PNG or in the tag `MaxSampleValue` of a TIFF.
    pub stated_largest_dn: Option<u16>,
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
    /// Truncated, damaged, or stored in a way that is not read.
    #[error("{} is not a whole TIFF image, uncompressed or by deflate, LZW or PackBits: {source}", path.display())]
    Tiff {
        /// The file.
        path: PathBuf,
        /// The decoder's reason.
        source: tiff::TiffError,
    },
    /// A TIFF file that stores something else than one upright image of counts.
    #[error("{} {reason}: frames must be one image of unsigned counts each, black at zero, first row first", path.display())]
    TiffLayout {
        /// The file.
        path: PathBuf,
        /// Reason.
        reason: String,
    },
    /// None of the formats that are read.
    #[error("{} is neither a PNG nor a TIFF nor a binary PGM (P5) image", path.display())]
    Format {
        /// The file.
        path: PathBuf,
    },
    /// A PGM file that does not hold what its header says.
    #[error("{} is not a whole PGM image: {reason}", path.display())]
    Pgm {
        /// The file.
        path: PathBuf,
        /// Reason.
        reason: &'static str,
    },
    /// Colour, palette, alpha or fewer bits.
    #[error("{} is {layout}: frames must be grey with 8 or 16 bits", path.display())]
    NotGrey {
        /// The file.
        path: PathBuf,
        /// Channels, and bits of each.
        layout: String,
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
    /// Names whose order is not that of the numbers in them.
    #[error(
        "{} comes before {} by its name and after it by its number: write all numbers with the same digits, or list the frames \
         in the plan",
        first.display(),
        second.display()
    )]
    Order {
        /// First by name.
        first: PathBuf,
        /// First by number.
        second: PathBuf,
    },
    /// Too few or too many images for the plan.
    #[error("{} holds {got} images, the plan has {expected} frames: list them in the plan, or keep exactly the frames of one view there", folder.display())]
    Count {
        /// The folder.
        folder: PathBuf,
        /// Images found.
        got: usize,
        /// Frames planned.
        expected: usize,
    },
    /// A plan's list of images is of one pass.
    #[error(
        "the plan lists the images of one pass, the frames are of {passes}: leave frames out of its tables, the images are taken in the order of their names"
    )]
    Passes {
        /// Passes of the capture.
        passes: usize,
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

/// Size and sample depth of an image, from its header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ImageHeader {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Bits of a stored number, 8 or 16.
    pub bits: u32,
    /// Largest count that the file states, see [`GreyImage::stated_largest_dn`].
    pub stated_largest_dn: Option<u16>,
}

impl ImageHeader {
    /// Reads the first bytes of a file.
    ///
    /// # Errors
    /// [`ImageError`]: no file, neither PNG nor PGM, not grey.
    pub fn read(path: &Path) -> Result<Self, ImageError> {
        let opened = |source| ImageError::Open {
            path: path.to_owned(),
            source,
        };
        let file = open_regular(path).map_err(opened)?;
        Ok(Opened::new(path, BufReader::new(file))?.header())
    }

    /// Whether it has the size of the calibrated camera.
    ///
    /// # Errors
    /// [`ImageError::Size`].
    pub fn check(&self, path: &Path, [width, height]: [u32; 2]) -> Result<(), ImageError> {
        if (self.width, self.height) == (width, height) {
            return Ok(());
        }
        Err(ImageError::Size {
            path: path.to_owned(),
            got_width: self.width,
            got_height: self.height,
            width,
            height,
        })
    }
}

/// Loads one grey image of exactly `size_px` (columns, rows).
///
/// # Errors
/// [`ImageError`]; the size in the header is checked before memory is taken.
pub fn load_grey(path: &Path, size_px: [u32; 2]) -> Result<GreyImage, ImageError> {
    let opened = |source| ImageError::Open {
        path: path.to_owned(),
        source,
    };
    let file = open_regular(path).map_err(opened)?;
    Opened::new(path, BufReader::new(file))?.read_image(path, size_px)
}

/// Reads one grey image of exactly `size_px` (columns, rows) from the content of the file at `path`.
///
/// # Errors
/// As [`load_grey`].
pub fn read_grey(path: &Path, content: &[u8], size_px: [u32; 2]) -> Result<GreyImage, ImageError> {
    Opened::new(path, Cursor::new(content))?.read_image(path, size_px)
}

/// An image whose header was read.
enum Opened<R: BufRead + Seek> {
    Png(Box<png::Reader<R>>, ImageHeader),
    Pgm(R, ImageHeader),
    Tiff(Box<tiff::decoder::Decoder<R>>, ImageHeader),
}

impl<R: BufRead + Seek> Opened<R> {
    fn new(path: &Path, mut file: R) -> Result<Self, ImageError> {
        let start = file.fill_buf().map_err(|source| ImageError::Open {
            path: path.to_owned(),
            source,
        })?;
        // A file named .png is read as PNG, so that the error names the defect of the PNG.
        let named_png = has_extension(path, "png");
        if start.starts_with(b"P5") && !named_png {
            let header = pgm_header(&mut file).map_err(|reason| ImageError::Pgm {
                path: path.to_owned(),
                reason,
            })?;
            return Ok(Self::Pgm(file, header));
        }
        let tiff = start.starts_with(b"II*\0") || start.starts_with(b"MM\0*");
        if tiff && !named_png {
            return Self::tiff(path, file);
        }
        if !start.starts_with(b"\x89PNG") && !named_png {
            return Err(ImageError::Format {
                path: path.to_owned(),
            });
        }
        let reader = png::Decoder::new(file)
            .read_info()
            .map_err(|source| ImageError::Png {
                path: path.to_owned(),
                source,
            })?;
        let info = reader.info();
        let bits = match (info.color_type, info.bit_depth) {
            (png::ColorType::Grayscale, png::BitDepth::Eight) => 8,
            (png::ColorType::Grayscale, png::BitDepth::Sixteen) => 16,
            (colour, depth) => {
                return Err(ImageError::NotGrey {
                    path: path.to_owned(),
                    layout: format!("{colour:?} with {} bits", depth as u32),
                });
            }
        };
        let significant = info.sbit.as_ref().and_then(|bits| bits.first());
        let significant = significant.map(|&bits| u32::from(bits));
        let header = ImageHeader {
            width: info.width,
            height: info.height,
            bits,
            stated_largest_dn: significant
                .filter(|significant| (1..bits).contains(significant))
                .map(|significant| ((1u32 << significant) - 1) as u16),
        };
        Ok(Self::Png(Box::new(reader), header))
    }

    fn tiff(path: &Path, file: R) -> Result<Self, ImageError> {
        let broken = broken_tiff(path);
        let mut reader = tiff::decoder::Decoder::new(file).map_err(&broken)?;
        let (width, height) = reader.dimensions().map_err(&broken)?;
        let bits = match reader.colortype().map_err(&broken)? {
            tiff::ColorType::Gray(bits @ (8 | 16)) => bits,
            other => {
                return Err(ImageError::NotGrey {
                    path: path.to_owned(),
                    layout: format!("{other:?}"),
                });
            }
        };
        // Default of the TIFF specification where a tag is missing, and the only value supported.
        for (tag, usual) in [
            (Tag::PhotometricInterpretation, 1),
            (Tag::Orientation, 1),
            (Tag::SampleFormat, 1),
        ] {
            let found = reader.find_tag_unsigned::<u32>(tag).map_err(&broken)?;
            let found = found.unwrap_or(usual);
            if found != usual {
                return Err(ImageError::TiffLayout {
                    path: path.to_owned(),
                    reason: format!("has {tag:?} = {found}"),
                });
            }
        }
        if reader.more_images() {
            return Err(ImageError::TiffLayout {
                path: path.to_owned(),
                reason: "holds several images".into(),
            });
        }
        // Some programs write the largest count of the image there; that of a camera is 2^n - 1.
        let largest = reader.find_tag_unsigned::<u32>(Tag::MaxSampleValue);
        let largest = largest.map_err(&broken)?.unwrap_or(0);
        let ends_a_number = |largest: u32| largest.checked_add(1).is_some_and(u32::is_power_of_two);
        let is_of_camera = ends_a_number(largest) && (1 << 8..(1 << bits) - 1).contains(&largest);
        let header = ImageHeader {
            width,
            height,
            bits: bits.into(),
            stated_largest_dn: is_of_camera.then_some(largest as u16),
        };
        Ok(Self::Tiff(Box::new(reader), header))
    }

    fn header(&self) -> ImageHeader {
        let (Self::Png(_, header) | Self::Pgm(_, header) | Self::Tiff(_, header)) = self;
        *header
    }

    fn read_image(self, path: &Path, size_px: [u32; 2]) -> Result<GreyImage, ImageError> {
        self.header().check(path, size_px)?;
        let ImageHeader {
            width,
            height,
            bits,
            stated_largest_dn,
        } = self.header();
        let (width, height) = (width as usize, height as usize);
        let byte_count = width * height * (bits as usize / 8);
        let pixels = match self {
            Self::Tiff(mut reader, _) => match reader.read_image().map_err(broken_tiff(path))? {
                DecodingResult::U8(counts) => counts.into_iter().map(u16::from).collect(),
                DecodingResult::U16(counts) => counts,
                _ => {
                    return Err(ImageError::TiffLayout {
                        path: path.to_owned(),
                        reason: "has no unsigned counts".into(),
                    });
                }
            },
            Self::Png(mut reader, _) => {
                let mut bytes = vec![0; byte_count];
                let read = reader.next_frame(&mut bytes);
                read.map_err(|source| ImageError::Png {
                    path: path.to_owned(),
                    source,
                })?;
                counts_of_bytes(bytes, bits)
            }
            Self::Pgm(mut file, _) => {
                let mut bytes = vec![0; byte_count];
                let whole = file.read_exact(&mut bytes).is_ok();
                let more = file.fill_buf().is_ok_and(|rest| !rest.is_empty());
                let wrong = match (whole, more) {
                    (true, false) => None,
                    (false, _) => Some("it ends before its last pixel"),
                    (true, true) => Some("it goes on after its last pixel"),
                };
                if let Some(reason) = wrong {
                    return Err(ImageError::Pgm {
                        path: path.to_owned(),
                        reason,
                    });
                }
                let counts = counts_of_bytes(bytes, bits);
                if stated_largest_dn.is_some_and(|largest| counts.iter().any(|&c| c > largest)) {
                    return Err(ImageError::Pgm {
                        path: path.to_owned(),
                        reason: "a pixel is above the largest value of its header",
                    });
                }
                counts
            }
        };
        Ok(GreyImage {
            pixels,
            width,
            height,
            bits,
            stated_largest_dn,
        })
    }
}

fn broken_tiff(path: &Path) -> impl Fn(tiff::TiffError) -> ImageError {
    |source| ImageError::Tiff {
        path: path.to_owned(),
        source,
    }
}

/// PNG and PGM are big endian.
fn counts_of_bytes(bytes: Vec<u8>, bits: u32) -> Vec<u16> {
    if bits == 8 {
        return bytes.into_iter().map(u16::from).collect();
    }
    let pairs = bytes.as_chunks::<2>().0.iter();
    pairs.map(|&pair| u16::from_be_bytes(pair)).collect()
}

/// Reads `P5`, width, height and largest value, with comments between, and the single blank after them.
fn pgm_header(file: &mut impl Read) -> Result<ImageHeader, &'static str> {
    let mut next = || {
        let mut byte = [0];
        let read = file.read_exact(&mut byte);
        read.map(|()| byte[0])
            .map_err(|_| "it ends within its header")
    };
    next()?;
    next()?;
    let mut byte = next()?;
    let mut number = || {
        while byte.is_ascii_whitespace() || byte == b'#' {
            if byte == b'#' {
                while byte != b'\n' {
                    byte = next()?;
                }
            }
            byte = next()?;
        }
        let mut value: u32 = 0;
        let mut digits = 0;
        while byte.is_ascii_digit() && digits < 6 {
            value = 10 * value + u32::from(byte - b'0');
            digits += 1;
            byte = next()?;
        }
        if digits == 0 || !byte.is_ascii_whitespace() {
            return Err("its header is not P5, width, height and largest value");
        }
        Ok(value)
    };
    let [width, height, largest] = [number()?, number()?, number()?];
    let bits = match largest {
        1..256 => 8,
        256..65536 => 16,
        _ => return Err("its largest value is not 1 to 65535"),
    };
    Ok(ImageHeader {
        width,
        height,
        bits,
        stated_largest_dn: (largest + 1 < 1 << bits).then_some(largest as u16),
    })
}

/// All PNG, TIFF and PGM files of a folder, sorted by name; there must be exactly `expected`.
///
/// # Errors
/// [`ImageError::Folder`], [`ImageError::Count`], [`ImageError::Order`].
pub fn list_images(folder: &Path, expected: usize) -> Result<Vec<PathBuf>, ImageError> {
    let failed = |source| ImageError::Folder {
        path: folder.to_owned(),
        source,
    };
    let mut paths = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        if ["png", "pgm", "tif", "tiff"]
            .iter()
            .any(|extension| has_extension(&path, extension))
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
    let by_number = paths.windows(2).find(|pair| {
        let [first, second] = [&pair[0], &pair[1]].map(|path| words_and_numbers(path));
        first > second
    });
    match by_number {
        Some([first, second]) => Err(ImageError::Order {
            first: first.clone(),
            second: second.clone(),
        }),
        _ => Ok(paths),
    }
}

fn has_extension(path: &Path, wanted: &str) -> bool {
    path.extension()
        .is_some_and(|extension| extension.eq_ignore_ascii_case(wanted))
}

/// A file's name cut into its text and its numbers, so that 10 comes after 9.
fn words_and_numbers(path: &Path) -> Vec<(String, u128)> {
    let name = path.file_stem().unwrap_or_default().to_string_lossy();
    let mut parts = vec![(String::new(), 0)];
    let mut in_number = false;
    for letter in name.chars() {
        let last = parts.len() - 1;
        match letter.to_digit(10) {
            Some(digit) => {
                in_number = true;
                let number: &mut u128 = &mut parts[last].1;
                *number = number.saturating_mul(10).saturating_add(digit.into());
            }
            None if in_number => {
                in_number = false;
                parts.push((letter.into(), 0));
            }
            None => parts[last].0.push(letter),
        }
    }
    parts
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(folder: &Path, name: &str, bytes: &[u8]) -> PathBuf {
        let path = folder.join(name);
        std::fs::write(&path, bytes).unwrap();
        path
    }

    /// Both depths, a comment in every place that Netpbm allows.
    #[test]
    fn a_pgm_is_read_as_netpbm_writes_it() {
        let folder = tempfile::tempdir().unwrap();
        let eight = file(
            folder.path(),
            "a.pgm",
            b"P5\n# by hand\n3 2\n255\n\x00\x01\x02\x03\x04\xff",
        );
        let image = load_grey(&eight, [3, 2]).unwrap();
        assert_eq!(
            (image.bits, &image.pixels[..]),
            (8, &[0, 1, 2, 3, 4, 255][..])
        );
        let sixteen = file(
            folder.path(),
            "b.pgm",
            b"P5 2 #w\n1 # h\n4095\n\x0f\xff\x01\x02",
        );
        let image = load_grey(&sixteen, [2, 1]).unwrap();
        assert_eq!((image.bits, &image.pixels[..]), (16, &[4095, 258][..]));
        assert_eq!(image.stated_largest_dn, Some(4095));
    }

    /// A TIFF of one strip, as TIFF 6.0 (Adobe, 1992) lays it out.
    fn tiff(
        big_endian: bool,
        [width, height]: [u32; 2],
        bits: u32,
        tags: &[(u16, u32)],
    ) -> Vec<u8> {
        let short = |value: u16| match big_endian {
            true => value.to_be_bytes(),
            false => value.to_le_bytes(),
        };
        let long = |value: u32| match big_endian {
            true => value.to_be_bytes(),
            false => value.to_le_bytes(),
        };
        let counts = (0..width * height).map(|i| 257 * i as u16);
        let strip: Vec<u8> = counts
            .flat_map(|count| match bits {
                8 => vec![count as u8],
                _ => short(count).to_vec(),
            })
            .collect();
        let mut entries = vec![
            (256, width),
            (257, height),
            (258, bits),
            (259, 1),
            (262, 1),
            (273, 8),
            (277, 1),
            (278, height),
            (279, strip.len() as u32),
        ];
        for &(tag, value) in tags {
            entries.retain(|&(known, _)| known != tag);
            entries.push((tag, value));
        }
        entries.sort_unstable();
        let mut file = if big_endian { b"MM\0*" } else { b"II*\0" }.to_vec();
        file.extend(long(8 + strip.len() as u32));
        file.extend(&strip);
        file.extend(short(entries.len() as u16));
        for (tag, value) in entries {
            // All as LONG, which every reader takes.
            file.extend([short(tag), short(4)].concat());
            file.extend([long(1), long(value)].concat());
        }
        file.extend(long(0));
        file
    }

    #[test]
    fn a_tiff_is_read_in_both_byte_orders_and_depths() {
        let folder = tempfile::tempdir().unwrap();
        for (big_endian, bits) in [(false, 8), (true, 8), (false, 16), (true, 16)] {
            let path = file(folder.path(), "a.tif", &tiff(big_endian, [3, 2], bits, &[]));
            let image = load_grey(&path, [3, 2]).unwrap();
            let step = if bits == 8 { 1 } else { 257 };
            let expected: Vec<u16> = (0..6).map(|i| step * i).collect();
            assert_eq!((image.bits, image.pixels), (bits, expected));
            assert_eq!(image.stated_largest_dn, None);
        }
        for (largest, expected) in [
            (4095, Some(4095)),
            (65_535, None),
            (3017, None),
            (u32::MAX, None),
        ] {
            let path = file(
                folder.path(),
                "a.tif",
                &tiff(false, [3, 2], 16, &[(281, largest)]),
            );
            let image = load_grey(&path, [3, 2]).unwrap();
            assert_eq!(image.stated_largest_dn, expected);
        }
    }

    #[test]
    fn what_a_tiff_stores_otherwise_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let whole = tiff(false, [3, 2], 16, &[]);
        for (bytes, word) in [
            (
                tiff(false, [3, 2], 16, &[(262, 0)]),
                "PhotometricInterpretation = 0",
            ),
            (tiff(true, [3, 2], 16, &[(274, 3)]), "Orientation = 3"),
            (tiff(false, [3, 2], 16, &[(339, 2)]), "SampleFormat = 2"),
            (tiff(false, [3, 2], 32, &[]), "Gray(32)"),
            (tiff(false, [4, 2], 16, &[]), "4 x 2"),
            (tiff(false, [3, 2], 16, &[(259, 7)]), "not a whole TIFF"),
            (tiff(false, [3, 2], 16, &[(273, 4_000)]), "not a whole TIFF"),
            (whole[..20].to_vec(), "not a whole TIFF"),
        ] {
            let path = file(folder.path(), "a.tiff", &bytes);
            let error = load_grey(&path, [3, 2]).unwrap_err().to_string();
            assert!(error.contains(word), "{word}: {error}");
        }
        // Two images behind each other: the first directory points to itself.
        let mut pair = whole;
        let end = pair.len() - 4;
        pair[end..].copy_from_slice(&(8 + 12_u32).to_le_bytes());
        let path = file(folder.path(), "a.tiff", &pair);
        assert!(load_grey(&path, [3, 2]).is_err());
    }

    #[test]
    fn what_is_no_whole_image_of_the_camera_is_named() {
        let folder = tempfile::tempdir().unwrap();
        for (name, bytes, word) in [
            (
                "short.pgm",
                &b"P5 2 1 4095\n\x0f\xff\x01"[..],
                "ends before",
            ),
            ("long.pgm", b"P5 2 1 255\n\x0f\xff\x01", "goes on"),
            ("wide.pgm", b"P5 3 1 255\n\x0f\xff\x01", "3 x 1"),
            ("deep.pgm", b"P5 2 1 65536\n\x0f\xff\x01\x02", "65535"),
            (
                "above.pgm",
                b"P5 2 1 4095\n\x10\x00\x01\x02",
                "above the largest value",
            ),
            ("none.pgm", b"P5 2 one 255\n\x0f\xff", "header"),
            ("text.pgm", b"P2 2 1 255\n1 2\n", "neither"),
            ("cut.png", b"\x89PNG\r\n\x1a\n\x00\x00", "not a whole PNG"),
            ("empty.png", b"", "not a whole PNG"),
            ("renamed.png", b"P5 2 1 255\n\x0f\xff", "not a whole PNG"),
        ] {
            let path = file(folder.path(), name, bytes);
            let error = load_grey(&path, [2, 1]).unwrap_err().to_string();
            assert!(
                error.contains(word) && error.contains(name),
                "{name}: {error}"
            );
        }
    }

    /// frame_10 sorts before frame_2: the order that was meant is not the one that names have.
    #[test]
    fn an_order_of_names_that_is_not_the_numbers_order_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        for name in [
            "view2_frame_1.png",
            "view2_frame_2.png",
            "view2_frame_10.png",
        ] {
            file(folder.path(), name, b"");
        }
        let error = list_images(folder.path(), 3).unwrap_err();
        assert!(matches!(error, ImageError::Order { .. }), "{error}");
        std::fs::remove_file(folder.path().join("view2_frame_10.png")).unwrap();
        file(folder.path(), "view2_frame_3.pgm", b"");
        assert_eq!(list_images(folder.path(), 3).unwrap().len(), 3);
    }
}
