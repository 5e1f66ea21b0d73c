//! Places of a map on its ellipsoid, and back.

use super::scale::Map;
use super::wkt::Node;
use super::{Crs, Ellipsoid, Scale, parts, signature};

/// A projected system whose places can be computed, both ways: angles in radians, lengths in metres.
///
/// ```
/// use rockface_core::crs::Plane;
///
/// let plane = Plane::of(&"EPSG:32632".parse().unwrap()).unwrap();
/// let [easting_m, northing_m] = plane.at([9f64.to_radians(), 0.0]).unwrap();
/// assert!((easting_m - 500_000.0).abs() < 1e-6 && northing_m.abs() < 1e-6);
/// ```
#[derive(Debug, Clone)]
pub struct Plane {
    node: Node,
    map: Map,
    false_m: [f64; 2],
}

impl Plane {
    /// Projections that are computed, for messages.
    pub const COMPUTED: &'static str = "transverse Mercator (such as UTM, MGA, Gauss-Krueger), Lambert, Albers, Mercator, polar stereographic, \
                                        Krovak, the Swiss and the Dutch grid";

    /// The horizontal part of a system.
    ///
    /// # Errors
    /// A projection without a formula here, or with one that is an approximation; its name.
    pub fn of(crs: &Crs) -> Result<Self, String> {
        let node = crs.node();
        let node = parts(&node).0.clone();
        match Map::of(&node).filter(|map| map.is_exact(&node)) {
            Some(map) => Ok(Self { map, false_m: signature::false_origin(&node), node }),
            None => Err(signature::method(&node).map_or("unnamed", Node::name).to_owned()),
        }
    }

    /// The name of its datum.
    pub fn datum(&self) -> &str {
        let base = self.node.child(&["GEOGCS", "BASEGEOGCRS", "BASEGEODCRS"]);
        let datum = base.and_then(|base| base.child(&["DATUM", "ENSEMBLE", "GEODETICDATUM", "TRF"]));
        datum.map_or("", Node::name)
    }

    /// Its ellipsoid.
    pub fn ellipsoid(&self) -> Ellipsoid {
        Ellipsoid { a: self.map.a, e2: self.map.e2 }
    }

    /// Longitude from Greenwich and latitude of an easting and a northing, to a millimetre; `None` where the map does not reach.
    pub fn place(&self, [easting_m, northing_m]: [f64; 2]) -> Option<[f64; 2]> {
        let [lon, lat] = self.map.inverse([easting_m - self.false_m[0], northing_m - self.false_m[1]])?;
        Some([self.map.lon0 + lon, lat])
    }

    /// Easting and northing of a longitude from Greenwich and a latitude, to a hundredth of a millimetre; `None` where the map does not reach.
    pub fn at(&self, [lon, lat]: [f64; 2]) -> Option<[f64; 2]> {
        /// What the way back may be off, radians: a few metres. It ends elsewhere, or nowhere, where the map does not reach.
        const SAME: f64 = 1e-6;
        let turn = std::f64::consts::TAU;
        let around = |angle: f64| (angle + turn / 2.0).rem_euclid(turn) - turn / 2.0;
        let [x, y] = self.map.forward([around(lon - self.map.lon0), lat]);
        let found = [x + self.false_m[0], y + self.false_m[1]];
        let [back_lon, back_lat] = self.place(found)?;
        (around(back_lon - lon).abs() < SAME && (back_lat - lat).abs() < SAME).then_some(found)
    }

    /// What the map does to lengths and directions at an easting and a northing; see [`Scale::at`].
    pub fn scale(&self, plane_m: [f64; 2]) -> Option<Scale> {
        Scale::at(&self.node, plane_m)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Against PROJ 9, through pyproj, without a shift of the datum.
    #[test]
    fn places_and_their_way_back_are_those_of_proj() {
        let known: [(u32, [f64; 2], [f64; 2]); 14] = [
            (32632, [451_236.4, 5_512_346.8], [8.322_920_903, 49.761_618_005]),
            (28356, [334_897.2, 6_252_012.9], [151.215_211_844, -33.859_286_215]),
            (2154, [915_123.4, 6_500_321.7], [5.758_564_162, 45.568_574_453]),
            (2056, [2_600_500.5, 1_130_250.25], [7.446_083_002, 46.324_897_463]),
            (28992, [155_000.5, 463_200.25], [5.387_646_197, 52.157_960_599]),
            (5514, [-743_000.5, -1_043_200.25], [14.420_061_184, 50.086_344_84]),
            (3035, [4_321_500.5, 3_210_250.75], [10.007_287_996, 52.002_253_353]),
            (27700, [530_034.5, 180_381.25], [-0.126_110_24, 51.506_898_654]),
            (31287, [400_123.5, 400_456.25], [13.334_973_378, 47.504_105_534]),
            (3006, [674_032.5, 6_580_822.25], [18.059_198_713, 59.330_233_263]),
            (31467, [3_512_345.5, 5_400_123.25], [9.167_866_352, 48.739_528_161]),
            (7855, [600_123.5, 5_800_456.75], [148.139_415_643, -37.937_955_851]),
            (6677, [-5_123.5, -35_012.25], [139.776_727_899, 35.684_404_601]),
            (3031, [1_200_000.5, 800_000.25], [56.309_935_229, -76.782_845_695]),
        ];
        for (code, place, wanted) in known {
            let plane = Plane::of(&format!("EPSG:{code}").parse().unwrap()).unwrap();
            let found = plane.place(place).unwrap();
            for (found, wanted) in found.iter().zip(wanted) {
                assert!((found.to_degrees() - wanted).abs() < 4e-8, "EPSG:{code}: {} {wanted}", found.to_degrees());
            }
            let back = plane.at(found).unwrap();
            assert!((back[0] - place[0]).abs() + (back[1] - place[1]).abs() < 2e-3, "EPSG:{code}: {back:?}");
        }
    }

    #[test]
    fn what_the_map_does_not_reach_is_none() {
        let plane = Plane::of(&"EPSG:32632".parse().unwrap()).unwrap();
        assert_eq!(plane.place([f64::NAN, 5e6]), None);
        assert_eq!(plane.at([f64::NAN, 0.8]), None);
        assert_eq!(plane.at([(-99f64).to_radians(), 0.0]), None);
    }
}
