//! Whole numbers from coordinates without a call into the mathematics library, for inner loops.

/// The largest whole number not above `x`; for |x| below 2^31.
#[inline(always)]
pub fn floor(x: f64) -> i32 {
    let cut = x as i32;
    cut - i32::from(x < f64::from(cut))
}

/// The nearest whole number, halves away from zero; for |x| below 2^31.
#[inline(always)]
pub fn nearest(x: f64) -> i32 {
    let cut = x as i32;
    let rest = x - f64::from(cut);
    cut + i32::from(rest >= 0.5) - i32::from(rest <= -0.5)
}

/// The whole number that `x` is, from 0 to below 2^32; of anything else some whole number.
#[inline(always)]
pub fn whole(x: f64) -> usize {
    // In the sum with 2^52 the last bits of the mantissa are the number.
    (x + 4_503_599_627_370_496.0).to_bits() as u32 as usize
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn they_are_the_librarys(x in -1e6..1e6f64, start in -1000i32..1000, half in 0u8..3) {
            for x in [x, f64::from(start) + 0.5 * f64::from(half), f64::from(start) + 0.499_999_999_999_99] {
                prop_assert_eq!(floor(x), x.floor() as i32);
                prop_assert_eq!(nearest(x), x.round() as i32);
                prop_assert_eq!(whole(x.abs().floor()), x.abs() as usize);
            }
        }
    }
}
