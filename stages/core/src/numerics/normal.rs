//! The standard normal distribution and its inverse.

use super::portable_math;

/// The value below which 97.5 % of a standard normal lies: half the width of a 95 % interval, in standard deviations.
pub const NORMAL_975: f64 = 1.959_963_984_540_054;

/// The same as limits of detection have it, which the literature rounds (Lague, Brodu and Leroux 2013; paper 2.4.1).
pub const NORMAL_95: f64 = 1.96;

/// Share of a standard normal below `z`.
pub fn normal_cdf(z: f64) -> f64 {
    0.5 * portable_math::erfc(-z * std::f64::consts::FRAC_1_SQRT_2)
}

const CENTRE: ([f64; 8], [f64; 8]) = (
    [
        3.387_132_872_796_366_5,
        133.141_667_891_784_38,
        1_971.590_950_306_551_3,
        13_731.693_765_509_46,
        45_921.953_931_549_87,
        67_265.770_927_008_7,
        33_430.575_583_588_13,
        2_509.080_928_730_122_7,
    ],
    [
        1.0,
        42.313_330_701_600_91,
        687.187_007_492_057_9,
        5_394.196_021_424_751,
        21_213.794_301_586_597,
        39_307.895_800_092_71,
        28_729.085_735_721_943,
        5_226.495_278_852_855,
    ],
);
const SHOULDER: ([f64; 8], [f64; 8]) = (
    [
        1.423_437_110_749_683_5,
        4.630_337_846_156_546,
        5.769_497_221_460_691,
        3.647_848_324_763_204_5,
        1.270_458_252_452_368_4,
        0.241_780_725_177_450_6,
        0.022_723_844_989_269_184,
        7.745_450_142_783_414e-4,
    ],
    [
        1.0,
        2.053_191_626_637_759,
        1.676_384_830_183_803_8,
        0.689_767_334_985_1,
        0.148_103_976_427_480_08,
        0.015_198_666_563_616_457,
        5.475_938_084_995_345e-4,
        1.050_750_071_644_416_9e-9,
    ],
);
const TAIL: ([f64; 8], [f64; 8]) = (
    [
        6.657_904_643_501_103,
        5.463_784_911_164_114,
        1.784_826_539_917_291_3,
        0.296_560_571_828_504_87,
        0.026_532_189_526_576_124,
        1.242_660_947_388_078_4e-3,
        2.711_555_568_743_487_6e-5,
        2.010_334_399_292_288_1e-7,
    ],
    [
        1.0,
        0.599_832_206_555_888,
        0.136_929_880_922_735_8,
        0.014_875_361_290_850_615,
        7.868_691_311_456_133e-4,
        1.846_318_317_510_054_8e-5,
        1.421_511_758_316_446e-7,
        2.044_263_103_389_939_8e-15,
    ],
);

fn ratio((above, below): &([f64; 8], [f64; 8]), x: f64) -> f64 {
    let polynomial = |c: &[f64; 8]| c.iter().rev().fold(0.0, |sum, c| sum * x + c);
    polynomial(above) / polynomial(below)
}

/// The value below which a share `u` of a standard normal lies (Wichura 1988, algorithm AS 241, to 16 digits).
///
/// 0 and 1 give the infinities.
pub fn normal_quantile(u: f64) -> f64 {
    let q = u - 0.5;
    if q.abs() <= 0.425 {
        return q * ratio(&CENTRE, 0.180_625 - q * q);
    }
    let smaller = if q < 0.0 { u } else { 1.0 - u };
    if smaller <= 0.0 {
        return if q < 0.0 { f64::NEG_INFINITY } else { f64::INFINITY };
    }
    let r = (-portable_math::log(smaller)).sqrt();
    let z = if r <= 5.0 { ratio(&SHOULDER, r - 1.6) } else { ratio(&TAIL, r - 5.0) };
    if q < 0.0 { -z } else { z }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_inverse_undoes_the_distribution_down_to_its_far_tail() {
        for i in -370..=60 {
            let z = f64::from(i) * 0.1;
            let back = normal_quantile(normal_cdf(z));
            assert!((back - z).abs() < 2e-9 * (1.0 + z.abs()), "{z}: {back}");
        }
        for i in -200..=10 {
            let z = f64::from(i) * 0.1;
            let back = normal_quantile(normal_cdf(z));
            assert!((back - z).abs() < 5e-14 * (1.0 + z.abs()), "{z}: {back}");
        }
    }

    #[test]
    fn published_values_come_out() {
        assert!((normal_quantile(0.975) - NORMAL_975).abs() < 1e-15);
        assert!((normal_quantile(0.25) + 0.674_489_750_196_081_7).abs() < 1e-15);
        assert!((normal_quantile(0.001) + 3.090_232_306_167_813_5).abs() < 1e-14);
        assert!((normal_quantile(1e-20) + 9.262_340_089_798_408).abs() < 1e-13);
    }
}
