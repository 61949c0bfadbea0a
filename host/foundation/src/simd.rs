//! One function body for every processor: compiled once for the baseline and once for AVX2, chosen when the program runs.
//!
//! Rust never contracts a product and a sum into one rounding, so both give the same bits.

/// Runs `work` compiled for the widest vectors this processor has. `work` and what it calls must be `#[inline(always)]`,
/// or they keep the baseline's code.
#[inline(always)]
pub fn with_widest<R>(work: impl FnOnce() -> R) -> R {
    #[cfg(target_arch = "x86_64")]
    {
        #[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
        fn avx2<R>(work: impl FnOnce() -> R) -> R {
            work()
        }
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("bmi2") {
            // SAFETY: the processor has just been asked for AVX2 and BMI2; every processor with them has the older ones.
            return unsafe { avx2(work) };
        }
    }
    work()
}
