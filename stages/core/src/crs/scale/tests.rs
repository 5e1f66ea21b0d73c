//! Scale and convergence against those that PROJ 9 prints (`proj -V`, here through pyproj 3.7).

use super::*;
use crate::crs::{Stated, parts};

fn scale(code: u32, place: [f64; 2]) -> Option<Scale> {
    let node = Stated::from_epsg(code, None).unwrap().node.unwrap();
    Scale::at(parts(&node).0, place)
}

/// Code, easting and northing, least and greatest scale, convergence and place in degrees.
type Known = (u32, [f64; 2], [f64; 2], f64, [f64; 2]);

#[test]
fn scale_convergence_and_place_are_those_of_proj() {
    let known: [Known; 22] = [
        (32633, [643_636.0, 5_240_253.5], [0.999_853_5, 0.999_853_6], 1.396_58, [16.9, 47.3]),
        (32756, [333_568.9, 6_247_473.3], [0.999_941_5, 0.999_941_5], 1.004_17, [151.2, -33.9]),
        (2056, [2_782_433.0, 1_185_840.3], [1.000_002_5, 1.000_002_5], 1.746_65, [9.83, 46.8]),
        (21781, [566_072.7, 116_462.7], [1.000_085_7, 1.000_085_8], -0.321_27, [7.0, 46.2]),
        (28992, [95_554.0, 568_376.3], [0.999_997_7, 0.999_997_7], -0.705_45, [4.5, 53.1]),
        (2154, [1_203_358.1, 6_152_776.4], [1.001_690_3, 1.001_690_3], 4.426_21, [9.1, 42.3]),
        // Its angles are in grads, but for that of the meridian of Paris.
        (27572, [651_340.8, 2_111_297.7], [0.999_974_1, 0.999_974_1], 0.483_14, [3.0, 46.0]),
        (31370, [231_025.1, 88_197.3], [0.999_956_9, 0.999_956_9], 0.873_90, [5.5, 50.1]),
        (3035, [5_195_270.7, 4_657_258.7], [0.990_944_3, 1.009_138_5], 15.885_98, [28.0, 64.0]),
        (3034, [4_027_315.2, 3_664_644.7], [0.979_045_9, 0.979_045_9], 0.387_69, [10.5, 60.0]),
        (5070, [-776_229.8, 1_935_784.0], [0.991_035_1, 1.009_046_0], -5.546_71, [-105.2, 40.1]),
        (3031, [1_302_938.0, 1_552_781.1], [0.998_561_3, 0.998_561_3], -40.0, [40.0, -71.5]),
        (3413, [-190_690.5, -2_179_601.9], [1.0, 1.0], -5.0, [-50.0, 70.0]),
        (32661, [2_189_977.6, 1_478_040.8], [0.995_894_8, 0.995_894_8], 20.0, [20.0, 85.0]),
        (5514, [-668_905.0, -1_073_749.2], [0.999_913_5, 0.999_913_5], -7.009_78, [15.5, 49.9]),
        (3388, [-82_852.1, 3_819_897.9], [1.0, 1.0], 0.0, [50.0, 42.0]),
        (3832, [0.0, 2_258_423.6], [1.063_761_0, 1.063_761_0], 0.0, [150.0, 20.0]),
        (6933, [964_862.8, 2_501_271.9], [0.922_015_9, 1.084_580_0], 0.0, [10.0, 20.0]),
        (4087, [1_113_194.9, 1_669_792.4], [1.0, 1.035_276_2], 0.0, [10.0, 15.0]),
        (27700, [222_934.6, 771_342.4], [0.999_985_8, 0.999_985_8], -2.427_24, [-4.9, 56.8]),
        (6931, [557_704.5, -965_972.6], [0.996_195_0, 1.003_819_6], 30.0, [30.0, 80.0]),
        (2193, [1_375_509.2, 5_124_315.2], [1.000_219_9, 1.000_219_9], 1.945_85, [170.2, -44.0]),
    ];
    for (code, place, lengths, convergence_deg, place_deg) in known {
        let found = scale(code, place).unwrap_or_else(|| panic!("EPSG:{code}"));
        // PROJ takes the equirectangular projection on the sphere, and so do we: its scale is given for the ellipsoid here.
        let near = if code == 4087 { 0.008 } else { 2e-6 };
        for (found, known) in found.lengths.iter().zip(lengths) {
            assert!((found - known).abs() < near, "EPSG:{code}: {found} {known}");
        }
        assert!((found.convergence_deg - convergence_deg).abs() < 2e-4, "EPSG:{code}: {}", found.convergence_deg);
        for (found, known) in found.place_deg.iter().zip(place_deg) {
            assert!((found - known).abs() < 2e-5, "EPSG:{code}: {found} {known}");
        }
    }
}

#[test]
fn no_place_has_no_scale() {
    assert_eq!(scale(32633, [f64::NAN, 5e6]), None);
    assert_eq!(scale(3035, [1e9, 1e9]), None);
    // Cassini and Soldner's projection has no formula here.
    assert_eq!(scale(3068, [25_000.0, 21_000.0]), None);
    for x in [-1e30, -1e7, 0.0, 1.0, 1e7, f64::INFINITY] {
        for code in [3857, 32661, 3031, 3035, 2154, 5514, 2056, 28992, 6933, 3388, 5070, 32633] {
            let _ = scale(code, [x, -x]);
        }
    }
}

#[test]
fn a_scale_is_told_in_one_number_where_it_is_one() {
    assert_eq!(scale(32633, [500_000.0, 5_240_253.5]).unwrap().to_string(), "0.99960");
    assert_eq!(scale(6933, [964_862.8, 2_501_271.9]).unwrap().to_string(), "0.92202 to 1.08458, by direction,");
}
