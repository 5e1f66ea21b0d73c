//! The figure of the Earth: longitudes and latitudes on an ellipsoid, geocentric coordinates, and the shifts of older datums to WGS 84.

use super::Crs;
use super::wkt::Node;
use crate::numerics::portable_math::{atan2, cos, sin};

/// An ellipsoid of revolution.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ellipsoid {
    /// Half axis of the equator, metres.
    pub a: f64,
    /// Square of the eccentricity.
    pub e2: f64,
}

impl Ellipsoid {
    /// That of WGS 84.
    pub const WGS_84: Self = Self { a: 6_378_137.0, e2: 0.006_694_379_990_141_317 };

    /// X, Y and Z from the centre of the Earth, metres, of a longitude and a latitude (radians) and a height above the ellipsoid.
    pub fn geocentric(&self, [lon, lat, height_m]: [f64; 3]) -> [f64; 3] {
        let across_m = self.across_m(lat);
        let around_m = (across_m + height_m) * cos(lat);
        [around_m * cos(lon), around_m * sin(lon), (across_m * (1.0 - self.e2) + height_m) * sin(lat)]
    }

    /// Longitude and latitude (radians) and height above the ellipsoid of geocentric coordinates (Bowring 1976, iterated).
    pub fn geodetic(&self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        let Self { a, e2 } = *self;
        let side = (1.0 - e2).sqrt();
        let axis_m = (x * x + y * y).sqrt();
        let mut reduced = atan2(z, side * axis_m);
        let mut lat = reduced;
        for _ in 0..4 {
            let (s, c) = (sin(reduced), cos(reduced));
            lat = atan2(z + e2 / (1.0 - e2) * a * side * s * s * s, axis_m - e2 * a * c * c * c);
            reduced = atan2(side * sin(lat), cos(lat));
        }
        let height_m = axis_m * cos(lat) + z * sin(lat) - a * (1.0 - e2 * sin(lat) * sin(lat)).sqrt();
        [atan2(y, x), lat, height_m]
    }

    /// Radius of curvature across the meridian, metres.
    fn across_m(&self, lat: f64) -> f64 {
        self.a / (1.0 - self.e2 * sin(lat) * sin(lat)).sqrt()
    }

    /// Mean radius of curvature, metres.
    pub fn mean_radius_m(&self, lat: f64) -> f64 {
        self.a * (1.0 - self.e2).sqrt() / (1.0 - self.e2 * sin(lat) * sin(lat))
    }
}

/// The EPSG code of the UTM zone (WGS 84) of a longitude and a latitude, degrees, without the exceptions around Norway.
pub fn utm_zone([longitude, latitude]: [f64; 2]) -> u32 {
    let zone = (((longitude + 180.0) / 6.0).floor() as u32 % 60) + 1;
    if latitude < 0.0 { 32700 + zone } else { 32600 + zone }
}

/// The shift of geocentric coordinates on an older datum to WGS 84, by three or seven numbers: exact where the datum is defined by it, as the Swiss
/// is, and good to some metres otherwise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DatumShift {
    by_m: [f64; 3],
    /// Small angles about the axes, radians, as the position vector is turned.
    turn: [f64; 3],
    factor: f64,
}

impl DatumShift {
    /// That which goes with the EPSG code of a system.
    pub fn of(crs: &Crs) -> Option<Self> {
        let text = crs_definitions::from_code(u16::try_from(crs.epsg()?).ok()?)?.wkt;
        let node = Node::parse(text).ok()?;
        let shift = node.child(&["GEOGCS"])?.child(&["DATUM"])?.child(&["TOWGS84"])?;
        // Metres, seconds of arc and parts in a million. There is no name in front of them, so they are counted from 0.
        let number = |place: usize| shift.number(place).unwrap_or(0.0);
        let turn = [3, 4, 5].map(|place| (number(place) / 3600.0).to_radians());
        Some(Self { by_m: [0, 1, 2].map(number), turn, factor: 1.0 + number(6) * 1e-6 })
    }

    /// Whether it shifts at all.
    pub fn moves(&self) -> bool {
        self.by_m.iter().chain(&self.turn).chain([&(self.factor - 1.0)]).any(|number| number.abs() > 1e-12)
    }

    /// The small angles about the axes, radians, by which a place on the older datum is turned on its way to WGS 84.
    pub fn angles(&self) -> [f64; 3] {
        self.turn
    }

    /// A place on the older datum in WGS 84.
    pub fn to_wgs_84(&self, place: [f64; 3]) -> [f64; 3] {
        let turned = self.turned(place);
        std::array::from_fn(|axis| self.by_m[axis] + self.factor * turned[axis])
    }

    /// A place in WGS 84 on the older datum.
    pub fn from_wgs_84(&self, place: [f64; 3]) -> [f64; 3] {
        let wanted: [f64; 3] = std::array::from_fn(|axis| (place[axis] - self.by_m[axis]) / self.factor);
        let mut found = wanted;
        // Each round is nearer by the size of the angles, a hundred thousandth.
        for _ in 0..4 {
            let turned = self.turned(found);
            found = std::array::from_fn(|axis| found[axis] + wanted[axis] - turned[axis]);
        }
        found
    }

    fn turned(&self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        let [rx, ry, rz] = self.turn;
        [x - rz * y + ry * z, rz * x + y - rx * z, -ry * x + rx * y + z]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Against PROJ's `+proj=cart` on WGS 84, through pyproj.
    #[test]
    fn geocentric_coordinates_are_those_of_proj() {
        let known = [
            ([7.8, 46.0, 870.0], [4_397_854.821_261, 602_431.173_876, 4_565_873.366_459]),
            ([151.2, -33.8, 60.0], [-4_649_403.939_419, 2_556_031.445_619, -3_528_066.861_921]),
        ];
        for (place, geocentric) in known {
            let [lon, lat, height_m] = Ellipsoid::WGS_84.geodetic(geocentric);
            let found = [lon.to_degrees(), lat.to_degrees(), height_m];
            assert!(found.iter().zip(place).all(|(found, wanted)| (found - wanted).abs() < 1e-5), "{found:?}");
            let back = Ellipsoid::WGS_84.geocentric([lon, lat, height_m]);
            assert!(back.iter().zip(geocentric).all(|(found, wanted)| (found - wanted).abs() < 1e-6), "{back:?}");
        }
    }

    #[test]
    fn a_shift_and_its_way_back_end_where_they_began() {
        for code in ["EPSG:2056", "EPSG:31467", "EPSG:27700", "EPSG:28992"] {
            let shift = DatumShift::of(&code.parse().unwrap()).unwrap();
            let place = [4_154_738.9, 672_920.9, 4_775_678.5];
            let there = shift.to_wgs_84(place);
            let off: f64 = (0..3).map(|axis| (there[axis] - place[axis]).abs()).sum();
            assert!(shift.moves() && (100.0..2000.0).contains(&off), "{code}: {off}");
            let back = shift.from_wgs_84(there);
            assert!(back.iter().zip(place).all(|(back, place)| (back - place).abs() < 1e-6), "{code}: {back:?}");
        }
        assert!(!DatumShift::of(&"EPSG:25832".parse().unwrap()).unwrap().moves());
        assert_eq!(DatumShift::of(&"EPSG:26710".parse().unwrap()), None);
    }
}
