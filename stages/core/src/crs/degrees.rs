//! Longitudes and latitudes in WGS 84 of places on a map, as globes and web maps take them.

use super::scale::{self, OnEllipsoid};
use super::wkt::Node;
use super::{Crs, datums, parts};
use crate::numerics::portable_math::{atan2, cos, sin};

/// How places of a system become longitudes and latitudes in WGS 84.
///
/// Datums that are within two metres or so of WGS 84 everywhere, such as ETRS89, GDA94, GDA2020 or NAD83, are taken as it. Older datums are
/// shifted by the three or seven numbers that go with the EPSG code, which is accurate to some metres.
///
/// ```
/// use rockface_core::crs::Degrees;
///
/// let degrees = Degrees::of(&"EPSG:32632".parse().unwrap()).unwrap();
/// let [longitude, latitude] = degrees.at([500_000.0, 0.0, 0.0]).unwrap();
/// assert!((longitude - 9.0).abs() < 1e-9 && latitude.abs() < 1e-9);
/// ```
#[derive(Debug, Clone)]
pub struct Degrees {
    plane: Node,
    datum: String,
    shift: Option<[f64; 7]>,
}

/// What can be converted, for messages.
const CONVERTED: &str = "systems of transverse Mercator (such as UTM, MGA, Gauss-Krueger), Lambert, Albers, Mercator, polar stereographic, Krovak, the Swiss and the Dutch grid are converted, \
                         on WGS 84, ETRS89, GDA94, GDA2020, NAD83, NZGD2000, JGD2011 and their like, and on older datums whose EPSG code has a shift to WGS 84 (CH1903+, DHDN, MGI, OSGB 1936)";

/// Datums that are WGS 84 within two metres or so, as [`datums::known`] calls them.
const ALIKE: [&str; 20] = [
    "wgs1984",
    "europeanterrestrialreferencesystem1989",
    "geocentricdatumofaustralia1994",
    "geocentricdatumofaustralia2020",
    "geocentricdatumofkorea",
    "hartebeesthoek94",
    "irenet95",
    "istitutogeograficomilitaire1995",
    "japanesegeodeticdatum2000",
    "japanesegeodeticdatum2011",
    "marcogeocentriconacionaldereferencia",
    "newzealandgeodeticdatum2000",
    "northamericandatum1983",
    "posicionesgeodesicasargentinas2007",
    "reseaugeodesiquefrancais1993",
    "retedinamicanazionale2008",
    "sirgaschile",
    "sistemadereferenciageocentricoparalasamericas2000",
    "sweref99",
    "taiwandatum1997",
];

/// WGS 84: half axis, metres, and the square of the eccentricity.
const WGS_84: [f64; 2] = [6_378_137.0, 0.006_694_379_990_141_317];

impl Degrees {
    /// The way from a system.
    ///
    /// # Errors
    /// A projection or a datum of which nothing is known here; the message says which systems are converted.
    pub fn of(crs: &Crs) -> Result<Self, String> {
        let node = crs.node();
        let plane = parts(&node).0.clone();
        if !scale::has_places(&plane) {
            let projection = super::signature::method(&plane).map_or("unnamed", Node::name);
            return Err(format!(
                "{crs} has the projection `{projection}`, which has no way back to degrees here; {CONVERTED}"
            ));
        }
        let base = plane.child(&["GEOGCS", "BASEGEOGCRS", "BASEGEODCRS"]);
        let datum = base.and_then(|base| base.child(&["DATUM", "ENSEMBLE", "GEODETICDATUM", "TRF"]));
        let datum = datum.map_or("", Node::name).to_owned();
        let known = datums::known(&datum);
        if ALIKE.contains(&known.as_str()) || known.starts_with("nad83") {
            return Ok(Self { plane, datum, shift: None });
        }
        match crs.epsg().and_then(shift_of_code) {
            Some(shift) => {
                let moves = shift.iter().any(|number| number.abs() > 1e-12);
                Ok(Self { plane, datum, shift: moves.then_some(shift) })
            }
            None => {
                Err(format!("{crs} is on the datum `{datum}`, whose shift to WGS 84 is not known here; {CONVERTED}"))
            }
        }
    }

    /// The name of the datum where it is shifted.
    pub fn shifted(&self) -> Option<&str> {
        self.shift.map(|_| self.datum.as_str())
    }

    /// Longitude and latitude in degrees of an easting, a northing and a height in metres; `None` where the map does not reach.
    pub fn at(&self, [easting_m, northing_m, height_m]: [f64; 3]) -> Option<[f64; 2]> {
        let found = scale::place(&self.plane, [easting_m, northing_m])?;
        let [lon, lat] = self.shift.map_or(found.place, |shift| shifted(found, height_m, &shift));
        let longitude = (lon.to_degrees() + 180.0).rem_euclid(360.0) - 180.0;
        let place = [longitude, lat.to_degrees()];
        place.iter().all(|angle| angle.is_finite()).then_some(place)
    }
}

/// The shift to WGS 84 that goes with a code: metres, seconds of arc (of the position vector) and parts in a million.
fn shift_of_code(code: u32) -> Option<[f64; 7]> {
    let text = crs_definitions::from_code(u16::try_from(code).ok()?)?.wkt;
    let node = Node::parse(text).ok()?;
    let shift = node.child(&["GEOGCS"])?.child(&["DATUM"])?.child(&["TOWGS84"])?;
    let number = |place: usize| shift.number(place).unwrap_or(0.0);
    // Node arguments are counted from 0 here, as there is no name in front.
    Some(std::array::from_fn(number))
}

/// Longitude and latitude in WGS 84, radians, of a place on another ellipsoid.
fn shifted(
    OnEllipsoid { place: [lon, lat], ellipsoid: [a, e2] }: OnEllipsoid,
    height_m: f64,
    shift: &[f64; 7],
) -> [f64; 2] {
    let curvature_m = a / (1.0 - e2 * sin(lat) * sin(lat)).sqrt();
    let around_m = (curvature_m + height_m) * cos(lat);
    let [x, y, z] = [around_m * cos(lon), around_m * sin(lon), (curvature_m * (1.0 - e2) + height_m) * sin(lat)];
    let [dx, dy, dz, rx, ry, rz, millionths] = *shift;
    let [rx, ry, rz] = [rx, ry, rz].map(|seconds| (seconds / 3600.0).to_radians());
    let factor = 1.0 + millionths * 1e-6;
    let x_new = dx + factor * (x - rz * y + ry * z);
    let y_new = dy + factor * (rz * x + y - rx * z);
    let z_new = dz + factor * (-ry * x + rx * y + z);
    let [a, e2] = WGS_84;
    let axis_m = (x_new * x_new + y_new * y_new).sqrt();
    // Each round is nearer by more than a hundredfold.
    let mut latitude = atan2(z_new, axis_m * (1.0 - e2));
    for _ in 0..8 {
        let curvature_m = a / (1.0 - e2 * sin(latitude) * sin(latitude)).sqrt();
        latitude = atan2(z_new + e2 * curvature_m * sin(latitude), axis_m);
    }
    [atan2(y_new, x_new), latitude]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn degrees(code: u32) -> Result<Degrees, String> {
        Degrees::of(&format!("EPSG:{code}").parse().unwrap())
    }

    /// Against PROJ 9.5, through pyproj 3.7, without a shift of the datum.
    #[test]
    fn places_on_the_own_datum_are_those_of_proj() {
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
            let node = format!("EPSG:{code}").parse::<Crs>().unwrap().node();
            let found = scale::place(parts(&node).0, place).unwrap_or_else(|| panic!("EPSG:{code}")).place;
            for (found, wanted) in found.iter().zip(wanted) {
                assert!((found.to_degrees() - wanted).abs() < 4e-8, "EPSG:{code}: {} {wanted}", found.to_degrees());
            }
        }
    }

    /// Against PROJ's `+proj=helmert` with the numbers of the codes.
    #[test]
    fn older_datums_are_shifted_as_proj_does() {
        let known: [(u32, [f64; 3], [f64; 2]); 5] = [
            (2056, [2_600_500.5, 1_130_250.25, 2_100.0], [7.445_142_339, 46.323_650_108]),
            (28992, [155_000.5, 463_200.25, 12.0], [5.387_210_894, 52.156_972_136]),
            (27700, [530_034.5, 180_381.25, 50.0], [-0.127_716_699, 51.507_409_055]),
            (31287, [400_123.5, 400_456.25, 900.0], [13.334_233_755, 47.503_587_304]),
            (31467, [3_512_345.5, 5_400_123.25, 400.0], [9.166_813_183, 48.738_525_979]),
        ];
        for (code, place, wanted) in known {
            let way = degrees(code).unwrap();
            let found = way.at(place).unwrap();
            for (found, wanted) in found.iter().zip(wanted) {
                assert!((found - wanted).abs() < 2e-8, "EPSG:{code}: {found} {wanted}");
            }
            assert!(way.shifted().is_some());
        }
        assert_eq!(degrees(25832).unwrap().shifted(), None);
    }

    #[test]
    fn what_cannot_be_converted_is_told_with_what_can() {
        // A datum without a shift, an oblique cylinder, and a projection without a formula.
        for (code, what) in [(26710, "North_American_Datum_1927"), (2057, "Hotine_Oblique"), (3068, "Cassini_Soldner")]
        {
            let why = degrees(code).unwrap_err();
            assert!(why.contains(what) && why.contains("GDA2020") && why.contains("UTM"), "{why}");
        }
        assert_eq!(degrees(32632).unwrap().at([f64::NAN, 5e6, 0.0]), None);
    }
}
