//! Places on maps against those of PROJ 9.

use super::*;

/// Code, longitude, latitude, height, geocentric coordinates on the ellipsoid of the system, easting and northing.
type Known = (&'static str, [f64; 3], [f64; 3], [f64; 2]);

/// From `+proj=cart` and the systems themselves, through pyproj.
const KNOWN: [Known; 7] = [
    (
        "EPSG:32632",
        [7.8, 46.0, 870.0],
        [4_397_854.821_261, 602_431.173_876, 4_565_873.366_459],
        [407_081.450_339, 5_094_747.489_603],
    ),
    (
        "EPSG:32632",
        [11.9, 47.3, 1500.0],
        [4_241_105.804_568, 893_741.172_464, 4_665_549.295_706],
        [719_229.644_639, 5_242_581.962_943],
    ),
    (
        "EPSG:25832",
        [6.1, 51.2, 120.0],
        [3_982_114.579_203, 425_565.282_116, 4_947_610.335_404],
        [297_402.773_953, 5_676_063.364_741],
    ),
    (
        "EPSG:32756",
        [151.2, -33.8, 60.0],
        [-4_649_403.939_419, 2_556_031.445_619, -3_528_066.861_921],
        [333_374.815_695, 6_258_562.961_119],
    ),
    (
        "EPSG:2154",
        [4.9, 45.6, 700.0],
        [4_454_343.887_91, 381_871.978_475, 4_534_752.497_39],
        [848_101.155_353, 6_501_835.413_371],
    ),
    (
        "EPSG:3111",
        [145.0, -37.5, 40.0],
        [-4_150_181.804_09, 2_905_988.584_164, -3_861_588.449_163],
        [2_500_000.0, 2_444_516.554_731],
    ),
    (
        "EPSG:31467",
        [9.2, 48.8, 300.0],
        [4_154_738.855_037, 672_920.858_24, 4_775_678.474_108],
        [3_514_691.071_807, 5_406_852.975_942],
    ),
];

fn map(code: &str) -> MapProjection {
    MapProjection::of(&code.parse().unwrap()).unwrap_or_else(|why| panic!("{code}: {why}"))
}

#[test]
fn places_are_those_of_proj() {
    for (code, [.., height], geocentric, plane) in KNOWN {
        let map = map(code);
        let at = map.place(geocentric).unwrap().place_m;
        let off = [at[0] - plane[0], at[1] - plane[1], at[2] - height];
        assert!(off.iter().all(|metres| metres.abs() < 1e-5), "{code}: {off:?}");
    }
}

#[test]
fn the_rotation_is_nearest_to_the_derivatives() {
    for (code, _, geocentric, _) in KNOWN {
        let map = map(code);
        let at = map.place(geocentric).unwrap();
        let moved = |axis: usize, by: f64| {
            let mut there = geocentric;
            there[axis] += by;
            nalgebra::Vector3::from(map.place(there).unwrap().place_m)
        };
        let columns = [0, 1, 2].map(|axis| (moved(axis, 50.0) - moved(axis, -50.0)) / 100.0);
        let svd = Matrix3::from_columns(&columns).svd(true, true);
        let nearest = svd.u.unwrap() * svd.v_t.unwrap();
        assert!((nearest - at.map_from_earth).norm() < 1e-8, "{code}: {:e}", (nearest - at.map_from_earth).norm());
        let values = svd.singular_values;
        // One direction, the height, is not scaled; the other two are scaled alike.
        let (least, most) = (values.min(), values.max());
        assert!(
            (least - at.scale.min(1.0)).abs() < 2e-6 && (most - at.scale.max(1.0)).abs() < 2e-6,
            "{code}: {values}"
        );
    }
}

#[test]
fn other_projections_and_other_places_are_none() {
    assert!(MapProjection::of(&"EPSG:3068".parse().unwrap()).unwrap_err().contains("Cassini"));
    let place = map("EPSG:32632").place([-4_649_403.9, 2_556_031.4, -3_528_066.9]);
    assert!(place.is_none_or(|place| (place.scale - 1.0).abs() > 0.1));
    let found = place_deg([-4_649_403.939_419, 2_556_031.445_619, -3_528_066.861_921]);
    assert!((found[0] - 151.2).abs() < 1e-9 && (found[1] + 33.8).abs() < 1e-9);
}

#[test]
fn datums_are_one_in_every_dialect() {
    let of = |text: &str| Datum::of(&Node::parse(text).unwrap()).unwrap();
    let crs = |code: &str| of(&code.parse::<Crs>().unwrap().wkt());
    let wgs = of(
        "GEOGCS[\"WGS 84\",DATUM[\"World Geodetic System 1984 ensemble\",SPHEROID[\"WGS 84\",6378137,298.257223563]]]",
    );
    let compound = of(
        "COMPD_CS[\"a\",GEOGCS[\"WGS 84\",DATUM[\"D_WGS_1984\",SPHEROID[\"WGS 84\",6378137,298.257223563]]],VERT_CS[\"h\",VERT_DATUM[\"h\",2005]]]",
    );
    assert!(wgs.is(&crs("EPSG:32632")) && compound.is(&wgs));
    assert!(!wgs.is(&crs("EPSG:25832")) && wgs.is_near(&crs("EPSG:25832")) && wgs.is_near(&crs("EPSG:2154")));
    assert!(!wgs.is_near(&crs("EPSG:31467")) && crs("EPSG:31467").is(&crs("EPSG:31468")));
}
