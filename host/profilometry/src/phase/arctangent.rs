//! The arctangent of a phasor as plain arithmetic, which the compiler takes for several cells at once: a call of the mathematical
//! library per cell and frequency cost a tenth of a view.

use std::f64::consts::{FRAC_PI_2, PI};

/// `atan(q) / q` for q from 0 to 1 as a polynomial of `q^2`: the Chebyshev series up to degree 13, in powers.
const POWERS: [f64; 14] = [
    0.999_999_999_998_446_5,
    -0.333_333_332_706_839_96,
    0.199_999_957_891_126_5,
    -0.142_856_020_716_234_4,
    0.111_095_370_923_245_47,
    -0.090_775_273_803_345_78,
    0.076_173_882_607_422_06,
    -0.063_751_608_305_166_8,
    0.050_635_114_998_640_61,
    -0.035_511_911_152_212_2,
    0.020_161_791_812_967_414,
    -0.008_374_934_094_950_647,
    0.002_208_755_207_894_017_3,
    -0.000_273_629_264_667_848_7,
];

/// [`f64::atan2`] of finite numbers to 3e-12 rad; NaN of infinite ones.
///
/// A phasor's sums are f32: that alone leaves 1e-7 rad.
#[inline(always)]
pub(crate) fn atan2(y: f64, x: f64) -> f64 {
    let (up, along) = (y.abs(), x.abs());
    let steep = up > along;
    let (less, more) = if steep { (along, up) } else { (up, along) };
    // Nothing has the phase of zero; to any other number this adds nothing.
    let q = less / (more + f64::MIN_POSITIVE);
    let q2 = q * q;
    let mut sum = POWERS[POWERS.len() - 1];
    for power in POWERS.iter().rev().skip(1) {
        sum = sum * q2 + power;
    }
    let eighth = q * sum;
    let quarter = if steep { FRAC_PI_2 - eighth } else { eighth };
    let half = if x < 0.0 { PI - quarter } else { quarter };
    half.copysign(y)
}

#[cfg(test)]
mod tests {
    use flankscope_test_requisites::Random;

    use super::*;

    #[test]
    fn is_that_of_the_mathematical_library() {
        let mut worst = 0.0_f64;
        let mut compare = |y: f64, x: f64| {
            let off = (atan2(y, x) - y.atan2(x)).abs();
            assert!(off < 3e-12, "{y} {x}: {off}");
            worst = worst.max(off);
        };
        for step in 0..200_000 {
            let turned = PI * f64::from(step) / 1e5 - PI;
            compare(turned.sin(), turned.cos());
        }
        let mut random = Random(3);
        for exponent in -40..40 {
            for _ in 0..2_000 {
                let size = 2f64.powi(exponent);
                compare(size * random.normal(), random.normal());
            }
        }
        for x in [-1.0, -0.5, 0.0, 0.5, 1.0, 1e30, -1e30, 1e-30] {
            for y in [-1.0, -0.5, 0.0, -0.0, 0.5, 1.0, 1e30, -1e30, 1e-30] {
                compare(y, x);
            }
        }
        // The series is no better than this, so that the bound is no idle one.
        assert!(worst > 5e-13, "{worst}");
        for [y, x] in [
            [f64::NAN, 1.0],
            [1.0, f64::NAN],
            [f64::NAN, 0.0],
            [0.0, f64::NAN],
        ] {
            assert!(atan2(y, x).is_nan());
        }
        assert!(atan2(f64::INFINITY, f64::INFINITY).is_nan());
    }
}
