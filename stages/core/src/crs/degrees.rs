//! Longitudes and latitudes in WGS 84 of places on a map, as globes and web maps take them.

use super::{Crs, DatumShift, Ellipsoid, Plane, datums};

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
    plane: Plane,
    shift: Option<DatumShift>,
}

/// Datums that are converted, for messages.
const DATUMS: &str = "WGS 84, ETRS89, GDA94, GDA2020, NAD83, NZGD2000, JGD2011 and their like, and on older datums whose EPSG code has a shift to WGS 84 \
                      (CH1903+, DHDN, MGI, OSGB 1936)";

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

impl Degrees {
    /// The way from a system.
    ///
    /// # Errors
    /// A projection or a datum of which nothing is known here; the message says which systems are converted.
    pub fn of(crs: &Crs) -> Result<Self, String> {
        let converted = || format!("systems of {} are converted, on {DATUMS}", Plane::COMPUTED);
        let plane = Plane::of(crs).map_err(|projection| {
            format!("{crs} has the projection `{projection}`, which has no way back to degrees here; {}", converted())
        })?;
        if is_like_wgs_84(plane.datum()) {
            return Ok(Self { plane, shift: None });
        }
        match DatumShift::of(crs) {
            Some(shift) => Ok(Self { plane, shift: Some(shift).filter(DatumShift::moves) }),
            None => Err(format!(
                "{crs} is on the datum `{}`, whose shift to WGS 84 is not known here; {}",
                plane.datum(),
                converted()
            )),
        }
    }

    /// The name of the datum where it is shifted.
    pub fn shifted(&self) -> Option<&str> {
        self.shift.map(|_| self.plane.datum())
    }

    /// Longitude and latitude in degrees of an easting, a northing and a height in metres; `None` where the map does not reach.
    pub fn at(&self, [easting_m, northing_m, height_m]: [f64; 3]) -> Option<[f64; 2]> {
        let [lon, lat] = self.plane.place([easting_m, northing_m])?;
        let [lon, lat] = self.shift.map_or([lon, lat], |shift| {
            let there = shift.to_wgs_84(self.plane.ellipsoid().geocentric([lon, lat, height_m]));
            let [lon, lat, _] = Ellipsoid::WGS_84.geodetic(there);
            [lon, lat]
        });
        let longitude = (lon.to_degrees() + 180.0).rem_euclid(360.0) - 180.0;
        let place = [longitude, lat.to_degrees()];
        place.iter().all(|angle| angle.is_finite()).then_some(place)
    }
}

/// Whether a datum is WGS 84 within two metres or so, by its name in any dialect.
pub fn is_like_wgs_84(datum: &str) -> bool {
    let known = datums::known(datum);
    ALIKE.contains(&known.as_str()) || known.starts_with("nad83")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn degrees(code: u32) -> Result<Degrees, String> {
        Degrees::of(&format!("EPSG:{code}").parse().unwrap())
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
