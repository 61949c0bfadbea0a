//! Time to load new pictures into a DMD controller.
//!
//! | controller | bound | source |
//! |---|---|---|
//! | DLPC350 | shows pictures of its flash only, 24 bit planes in at most 0.2 s each; writing the flash is no part of a check | LightCrafter 4500 user's guide, "Pattern Sequence Background" |
//! | DLPC900 | 18 pictures of 24 bit planes over USB, in packets of 504 bytes; not compressed 3 bytes a mirror. Full-speed HID carries at most 64 bytes a millisecond | DLPU018, "Pattern BMP Load", "Initialize Pattern BMP Load"; USB 2.0, 5.7.3 |
//! | DLPC410 | bit planes by LVDS: 1024 x 768 mirrors with global reset in 43.22 µs each | TI E2E 594673 (DLP7000); DLPS024, table "row load" |

use serde::Serialize;

use flankscope_profilometry::head::Mirrors;

/// Bit planes of a pattern.
const BITS: u32 = 8;
/// Bit planes of a picture.
const PICTURE_BITS: u32 = 24;

/// Loading time of one controller for some patterns.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Loading {
    /// Name of the controller.
    pub controller: &'static str,
    /// Number of pictures or bit planes to load.
    pub loads: usize,
    /// Upper limit of the time, s; `None` if loading within a check is impossible, or no source states the time.
    pub at_most_s: Option<f64>,
    /// Assumptions of the limit.
    pub note: &'static str,
}

/// Longest time in which a DLPC350 loads a picture from its flash, s.
const DLPC350_PICTURE_S: f64 = 0.2;
/// Number of pictures that a DLPC900 holds.
const DLPC900_PICTURES: usize = 18;
/// Header of a picture's data, bytes.
const DLPC900_HEADER: f64 = 48.0;
/// Bytes of picture data in a packet, and the size of the packet with its length and command.
const DLPC900_PACKET: [f64; 2] = [504.0, 512.0];
/// Full-speed HID: one transfer of 64 bytes each millisecond.
const HID_BYTES_PER_S: f64 = 64_000.0;
/// Time in which a DLP7000 takes a bit plane, s.
const DLPC410_PLANE_S: f64 = 43.22e-6;

/// Loading times of the known controllers for a number of 8-bit patterns.
#[must_use]
pub fn loading(mirrors: Mirrors, patterns: usize) -> [Loading; 3] {
    let pictures = (patterns * BITS as usize).div_ceil(PICTURE_BITS as usize);
    let content = 3.0 * f64::from(mirrors.columns) * f64::from(mirrors.rows) + DLPC900_HEADER;
    let packets = (content / DLPC900_PACKET[0]).ceil();
    let is_dlp7000 = (mirrors.columns, mirrors.rows) == (1024, 768);
    let planes = patterns * BITS as usize;
    [
        Loading {
            controller: "DLPC350",
            loads: pictures,
            at_most_s: Some(pictures as f64 * DLPC350_PICTURE_S),
            note: "the pictures of every view lie in its flash before: it takes none during a check",
        },
        Loading {
            controller: "DLPC900",
            loads: pictures,
            at_most_s: (pictures <= DLPC900_PICTURES)
                .then(|| pictures as f64 * packets * DLPC900_PACKET[1] / HID_BYTES_PER_S),
            note: "over USB as full-speed HID, not compressed; at most 18 pictures at once",
        },
        Loading {
            controller: "DLPC410",
            loads: planes,
            at_most_s: is_dlp7000.then_some(planes as f64 * DLPC410_PLANE_S),
            note: "bit planes from the memory of the board that drives it, 1024 x 768 mirrors",
        },
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use flankscope_profilometry::head::Arrangement;

    /// By hand: 12 patterns are 4 pictures or 96 bit planes.
    #[test]
    fn twelve_patterns_on_a_xga_chip() {
        let mirrors = Mirrors {
            arrangement: Arrangement::Orthogonal,
            columns: 1024,
            rows: 768,
        };
        let [flash, usb, lvds] = loading(mirrors, 12);
        assert_eq!((flash.loads, usb.loads, lvds.loads), (4, 4, 96));
        assert_eq!(flash.at_most_s, Some(0.8));
        // 2 359 344 bytes are 4682 packets; 4 of them 9 588 736 bytes at 64 000 a second.
        let seconds = usb.at_most_s.unwrap();
        assert!((seconds - 149.824).abs() < 1e-9, "{seconds}");
        assert!((lvds.at_most_s.unwrap() - 4.14912e-3).abs() < 1e-12);
        // More than 18 pictures do not fit.
        assert_eq!(loading(mirrors, 55)[1].at_most_s, None);
        let other = Mirrors {
            columns: 912,
            rows: 1140,
            arrangement: Arrangement::Diamond,
        };
        assert_eq!(loading(other, 12)[2].at_most_s, None);
    }
}
