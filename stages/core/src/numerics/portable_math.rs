//! Elementary functions that give the same bits on every machine: the platform's own differ in the last digit.

pub use libm::{acos, asin, atan, atan2, cbrt, cos, erfc, exp, lgamma, log, log10, pow, sin, sincos, tan};

use crate::numerics::simd::Lanes;

/// The angles from which on an angle is taken back by another quarter turn: about 1, 3, 5 and 7 eighths of a turn.
const EIGHTHS: [f64; 4] = [
    f64::from_bits(0x3fe9_21fc << 32),
    f64::from_bits(0x4002_d97d << 32),
    f64::from_bits(0x400f_6a7b << 32),
    f64::from_bits(0x4015_fdbd << 32),
];
/// Angles nearer than this to a whole quarter are not reduced in one step.
const DELICATE: f64 = 1e-5;
/// Bits of the mantissa.
const MANTISSA: u64 = (1 << 52) - 1;
/// Upper half of the square root of 1/2, where the exponent of a logarithm's argument steps.
const HALF_ROOT: u64 = 0x3fe6_a09e << 32;
/// Upper and lower part of the logarithm of 2.
const LN2: [f64; 2] = [0.693_147_180_369_123_8, 1.908_214_929_270_587_7e-10];
/// Coefficients of the logarithm (2 artanh s - 2 s) / s in s^2.
const LOG: [f64; 7] = [
    0.666_666_666_666_673_5,
    0.399_999_999_994_094_2,
    0.285_714_287_436_623_9,
    0.222_221_984_321_497_84,
    0.181_835_721_616_180_5,
    0.153_138_376_992_093_73,
    0.147_981_986_051_165_86,
];
/// About half of the logarithm of 2: from here on an argument of the exponential function has one of it taken off.
const HALF_LN2: f64 = f64::from_bits(0x3fd6_2e43 << 32);
/// About one and a half of it: from here on, as many as fit.
const ONE_AND_A_HALF_LN2: f64 = f64::from_bits(0x3ff0_a2b2 << 32);
/// Below this the exponential is one more than its argument.
const NEAR_ZERO: f64 = f64::from_bits(0x3e30_0001 << 32);
/// Coefficients of x (exp x + 1) / (exp x - 1) - 2 from that of x^2 on, by even powers.
const EXP: [f64; 5] = [
    0.166_666_666_666_666_02,
    -0.002_777_777_777_701_559_3,
    6.613_756_321_437_934e-5,
    -1.653_390_220_546_525_2e-6,
    4.138_136_797_057_238_5e-8,
];
/// Coefficients of (sin x - x) / x^3 in x^2.
const SIN: [f64; 6] = [
    -0.166_666_666_666_666_32,
    0.008_333_333_333_322_49,
    -0.000_198_412_698_298_579_5,
    2.755_731_370_707_006_8e-6,
    -2.505_076_025_340_686_3e-8,
    1.589_690_995_211_55e-10,
];
/// Coefficients of (cos x - 1 + x^2 / 2) / x^4 in x^2.
const COS: [f64; 6] = [
    0.041_666_666_666_666_6,
    -0.001_388_888_888_887_411,
    2.480_158_728_947_673e-5,
    -2.755_731_435_139_066_3e-7,
    2.087_572_321_298_175e-9,
    -1.135_964_755_778_819_5e-11,
];
/// A quarter turn: its first 33 bits, and what is left of it.
const QUARTER: [f64; 2] = [1.570_796_326_734_125_6, 6.077_100_506_506_192e-11];

/// [`log`] of several positive numbers that are neither subnormal nor infinite: the same bits.
#[inline(always)]
pub fn log_lanes<const N: usize>(x: Lanes<N>) -> Lanes<N> {
    let shifted = |x: f64| x.to_bits() + ((0x3ff0_0000 << 32) - HALF_ROOT);
    let exponent = Lanes::<N>::of_whole(|i| shifted(x[i]) >> 52) - 1023.0;
    let f = x.map(|x| f64::from_bits((shifted(x) & MANTISSA) + HALF_ROOT)) - 1.0;
    let half = f * 0.5 * f;
    let s = f / (f + 2.0);
    let z = s * s;
    let w = z * z;
    let even = w * (w * (w * LOG[5] + LOG[3]) + LOG[1]);
    let odd = z * (w * (w * (w * LOG[6] + LOG[4]) + LOG[2]) + LOG[0]);
    s * (half + (odd + even)) + exponent * LN2[1] - half + f + exponent * LN2[0]
}

/// [`exp`] of several numbers from -700 to 700: the same bits.
#[inline(always)]
pub fn exp_lanes<const N: usize>(x: Lanes<N>) -> Lanes<N> {
    // The multiple of the logarithm of 2 that is taken off; none from half of it downwards.
    let steps = |x: f64| {
        let many = (x * std::f64::consts::LOG2_E + if x < 0.0 { -0.5 } else { 0.5 }).trunc();
        let one = if x < 0.0 { -1.0 } else { 1.0 };
        let some = if x.abs() >= ONE_AND_A_HALF_LN2 { many } else { one };
        if x.abs() >= HALF_LN2 { some } else { 0.0 }
    };
    let k = x.map(steps);
    let (high, low) = (x - k * LN2[0], k * LN2[1]);
    let rest = high - low;
    let z = rest * rest;
    let c = rest - z * (z * (z * (z * (z * EXP[4] + EXP[3]) + EXP[2]) + EXP[1]) + EXP[0]);
    let found = rest * c / (-c + 2.0) - low + high + 1.0;
    let near = x + 1.0;
    let found = Lanes::of(|i| if x[i].abs() < NEAR_ZERO { near[i] } else { found[i] });
    // Added to 2^52, the biased exponent of 2^k is in the lowest bits, from where it is shifted to its place.
    found * (k + 1023.0 + 4_503_599_627_370_496.0).map(|k| f64::from_bits(k.to_bits() << 52))
}

/// [`sincos`] of several angles from 0 to a whole turn: the same bits.
#[inline(always)]
pub fn sincos_lanes<const N: usize>(x: Lanes<N>) -> [Lanes<N>; 2] {
    let passed = |x: f64, eighth: f64| if x >= eighth { 1.0 } else { 0.0 };
    let [a, b, c, d] = EIGHTHS;
    let quarter = x.map(|x| (passed(x, a) + passed(x, b)) + (passed(x, c) + passed(x, d)));
    let rest = x - quarter * QUARTER[0];
    let tail = quarter * QUARTER[1];
    let y0 = rest - tail;
    let y1 = (rest - y0) - tail;
    let (z, v) = (y0 * y0, y0 * y0 * y0);
    let w = z * z;
    let r = z * (z * SIN[3] + SIN[2]) + SIN[1] + z * w * (z * SIN[5] + SIN[4]);
    let reduced = y0 - ((z * (y1 * 0.5 - v * r) - y1) - v * SIN[0]);
    let first = y0 + v * (z * r + SIN[0]);
    let sin = quarter.choose(|quarter| quarter > 0.0, reduced, first);
    let r = z * (z * (z * COS[2] + COS[1]) + COS[0]) + w * w * (z * (z * COS[5] + COS[4]) + COS[3]);
    let half = z * 0.5;
    let left = -half + 1.0;
    let cos = left + (((-left + 1.0) - half) + (z * r - y0 * y1));
    // The second and the fourth quarter swap sine and cosine.
    let place = quarter.map(|quarter| if quarter > 2.0 { quarter - 2.0 } else { quarter });
    let swaps = |place: f64| (place - 1.0).abs() < 0.5;
    let [sine, cosine] = [place.choose(swaps, cos, sin), place.choose(swaps, sin, cos)];
    let sine_sign =
        quarter.map(|q| if q > 1.0 { -1.0 } else { 1.0 }).with(quarter, |s, q| if q > 3.0 { 1.0 } else { s });
    let cosine_sign =
        quarter.map(|q| if q > 0.0 { -1.0 } else { 1.0 }).with(quarter, |s, q| if q > 2.0 { 1.0 } else { s });
    let found = [sine * sine_sign, cosine * cosine_sign];
    let near = y0.map(|y| if y.abs() < DELICATE { 1.0 } else { 0.0 });
    if near.each().iter().sum::<f64>() > 0.0 { delicate(x, near, found) } else { found }
}

/// Angles near whole quarters are reduced with more digits.
#[cold]
fn delicate<const N: usize>(x: Lanes<N>, near: Lanes<N>, [mut sin, mut cos]: [Lanes<N>; 2]) -> [Lanes<N>; 2] {
    for lane in (0..N).filter(|lane| near[*lane] > 0.0) {
        let (sine, cosine) = sincos(x[lane]);
        sin.set(lane, sine);
        cos.set(lane, cosine);
    }
    [sin, cos]
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn check(u: [f64; 4]) {
        let x = Lanes::from(u.map(|u| 1.0 - u));
        let angle = Lanes::from(u) * std::f64::consts::TAU;
        let (logs, turns) = (log_lanes(x), sincos_lanes(angle));
        for lane in 0..4 {
            assert_eq!(logs[lane].to_bits(), log(x[lane]).to_bits(), "log {}", x[lane]);
            let (sine, cosine) = sincos(angle[lane]);
            let found = turns.map(|turn| turn[lane].to_bits());
            assert_eq!(found, [sine.to_bits(), cosine.to_bits()], "sincos {}", angle[lane]);
        }
    }

    proptest! {
        #[test]
        fn lanes_have_the_bits_of_the_library(u in [0.0..1.0f64, 0.0..1.0f64, 0.0..1e-6f64, 0.9999..1.0f64]) {
            check(u);
        }

        #[test]
        fn exponentials_have_the_bits_of_the_library(
            x in [-700.0..700.0f64, -3.0..3.0f64, -1e-8..1e-8f64, -1.05..1.05f64],
            steps in -1000i32..1000,
        ) {
            let half_steps = 0.5 * f64::from(steps) * std::f64::consts::LN_2;
            for x in [x, [half_steps, x[2] + half_steps, 0.0, -0.0], [HALF_LN2, -HALF_LN2, NEAR_ZERO, ONE_AND_A_HALF_LN2]] {
                let found = exp_lanes(Lanes::from(x));
                (0..4).for_each(|lane| assert_eq!(found[lane].to_bits(), exp(x[lane]).to_bits(), "exp {}", x[lane]));
            }
        }

        #[test]
        fn also_about_every_eighth_of_a_turn(eighth in 0u32..9, off in -1e-6..1e-6f64, tiny in -1e-15..1e-15f64) {
            let about = |off: f64| (f64::from(eighth) / 8.0 + off).clamp(0.0, 1.0 - f64::EPSILON / 2.0);
            check([about(off), about(tiny), about(0.0), about(-off)]);
        }
    }
}
