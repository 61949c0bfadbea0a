//! The colour scale of all pictures: blue for missing material, white for zero, red for proud material.

use png::{BitDepth, ColorType, Encoder};

/// Shades to either side of white.
const STEPS: f64 = 100.0;

/// Colour of a deviation as a fraction of full scale, −1..1: a diverging scale that is suitable for colour-blind readers.
#[must_use]
pub fn diverging(share: f64) -> [u8; 3] {
    // End colours after Moreland's "cool to warm": equal lightness at both ends.
    const COOL: [f64; 3] = [33.0, 80.0, 180.0];
    const MIDDLE: [f64; 3] = [255.0; 3];
    const WARM: [f64; 3] = [178.0, 24.0, 43.0];
    let share = share.clamp(-1.0, 1.0);
    let end = if share < 0.0 { COOL } else { WARM };
    // The square root keeps small deviations visible; a hundred steps on each side fit into a palette.
    let t = (share.abs().sqrt() * STEPS).round() / STEPS;
    std::array::from_fn(|i| (MIDDLE[i] + (end[i] - MIDDLE[i]) * t).round() as u8)
}

/// Colour of an amount as a fraction of full scale, 0..1: lighter for less.
#[must_use]
pub fn sequential(share: f64) -> [u8; 3] {
    const NONE: [f64; 3] = [238.0, 243.0, 248.0];
    const FULL: [f64; 3] = [18.0, 52.0, 110.0];
    let share = share.clamp(0.0, 1.0);
    std::array::from_fn(|i| (NONE[i] + (FULL[i] - NONE[i]) * share).round() as u8)
}

/// Colours of a cell without a measured point.
pub const UNMEASURED: [[u8; 3]; 2] = [[120, 124, 130], [186, 190, 195]];

/// Colour of a cell without a measured point: hatched, to differ from all colours of the scale.
#[must_use]
pub fn unmeasured(column: usize, row: usize) -> [u8; 3] {
    UNMEASURED[usize::from(!(column + row).is_multiple_of(3))]
}

/// A coloured picture as a `data:` address for an `<img>`, with a palette if its colours fit into one.
///
/// `pixels` holds `width * height` colours, row by row.
#[must_use]
pub fn rgb_data_uri(width: usize, height: usize, pixels: &[[u8; 3]]) -> String {
    let mut palette: Vec<[u8; 3]> = pixels.to_vec();
    palette.sort_unstable();
    palette.dedup();
    let number = |pixel: &[u8; 3]| palette.binary_search(pixel).ok()?.try_into().ok();
    let indices: Option<Vec<u8>> = pixels.iter().map(number).collect();
    match indices {
        Some(indices) => data_uri(
            width,
            height,
            ColorType::Indexed,
            &indices,
            palette.as_flattened(),
        ),
        None => data_uri(width, height, ColorType::Rgb, pixels.as_flattened(), &[]),
    }
}

/// A grey picture as a `data:` address for an `<img>`.
#[must_use]
pub fn grey_data_uri(width: usize, height: usize, pixels: &[u8]) -> String {
    data_uri(width, height, ColorType::Grayscale, pixels, &[])
}

fn data_uri(
    width: usize,
    height: usize,
    colour: ColorType,
    bytes: &[u8],
    palette: &[u8],
) -> String {
    use base64::Engine as _;
    let mut file = Vec::new();
    let mut encoder = Encoder::new(&mut file, width as u32, height as u32);
    encoder.set_color(colour);
    encoder.set_depth(BitDepth::Eight);
    encoder.set_compression(png::Compression::High);
    if colour == ColorType::Indexed {
        encoder.set_palette(palette.to_vec());
    }
    let written = encoder
        .write_header()
        .and_then(|mut writer| writer.write_image_data(bytes));
    debug_assert!(
        written.is_ok(),
        "encoding into memory fails only for wrong sizes"
    );
    format!(
        "data:image/png;base64,{}",
        base64::engine::general_purpose::STANDARD.encode(file)
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_scale_is_symmetric_monotonic_and_clamped() {
        assert_eq!(diverging(0.0), [255, 255, 255]);
        assert_eq!(diverging(-7.0), diverging(-1.0));
        assert_eq!(diverging(7.0), diverging(1.0));
        for i in 0..100 {
            let (a, b) = (f64::from(i) / 100.0, f64::from(i + 1) / 100.0);
            assert!(diverging(a)[2] >= diverging(b)[2], "red side loses blue");
            assert!(diverging(-a)[0] >= diverging(-b)[0], "blue side loses red");
        }
    }

    #[test]
    fn pictures_decode_to_what_was_drawn() {
        // Few colours, but more than a palette holds.
        let many: Vec<[u8; 3]> = (0..300_u16).map(|i| [i as u8, (i >> 8) as u8, 7]).collect();
        for pixels in [vec![[1, 2, 3], [4, 5, 6]], many] {
            drawn_and_decoded(&pixels);
        }
    }

    fn drawn_and_decoded(drawn: &[[u8; 3]]) {
        let uri = rgb_data_uri(drawn.len(), 1, drawn);
        let (_, data) = uri.split_once("base64,").unwrap();
        let file =
            base64::Engine::decode(&base64::engine::general_purpose::STANDARD, data).unwrap();
        let mut decoder = png::Decoder::new(std::io::Cursor::new(file));
        decoder.set_transformations(png::Transformations::EXPAND);
        let mut reader = decoder.read_info().unwrap();
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut pixels).unwrap();
        assert_eq!(pixels, drawn.as_flattened());
    }
}
