//! From geocentric coordinates to a map, to a hundredth of a millimetre: the ellipsoid, transverse Mercator and Lambert's conformal cone.
//!
//! Transverse Mercator is Krueger's series to the fourth power of the third flattening (EPSG guidance note 7-2; Karney 2011), Lambert's cone
//! that of Snyder (1987). Scale and convergence are those of [`Scale`], whose own formulas also check what is computed here.

use nalgebra::Matrix3;

use rockface_core::crs::wkt::Node;
use rockface_core::crs::{Crs, Scale};
use rockface_core::numerics::portable_math::{atan2, cos, exp, log, sin};

/// An ellipsoid: its half axis and the square of its eccentricity.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Ellipsoid {
    a: f64,
    e2: f64,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Family {
    Transverse,
    /// With its two standard parallels, which may be one.
    Cone([f64; 2]),
}

/// A projected system whose coordinates can be computed: angles in radians, lengths in metres.
#[derive(Debug, Clone)]
pub struct MapProjection {
    family: Family,
    ellipsoid: Ellipsoid,
    lat0: f64,
    /// From Greenwich.
    lon0: f64,
    k0: f64,
    false_m: [f64; 2],
    plane: Node,
}

/// A place on a map, and how the map lies there.
#[derive(Debug, Clone)]
pub struct OnMap {
    /// Easting, northing and height above the ellipsoid, metres.
    pub place_m: [f64; 3],
    /// The rotation that is nearest to the derivatives: from geocentric axes to east, north and up of the map.
    pub map_from_earth: Matrix3<f64>,
    /// Length on the map of a unit of horizontal length at the height of the place; heights are not scaled.
    pub scale: f64,
    /// How far grid north is to the east of true north (meridian convergence), degrees.
    pub convergence_deg: f64,
}

fn square(x: f64) -> f64 {
    x * x
}

fn artanh(x: f64) -> f64 {
    0.5 * log((1.0 + x) / (1.0 - x))
}

impl Ellipsoid {
    /// Isometric latitude.
    fn isometric(self, lat: f64) -> f64 {
        let e = self.e2.sqrt();
        artanh(sin(lat)) - e * artanh(e * sin(lat))
    }

    /// Radius of a parallel, half axes.
    fn parallel(self, lat: f64) -> f64 {
        cos(lat) / (1.0 - self.e2 * square(sin(lat))).sqrt()
    }

    /// Longitude from Greenwich, latitude (radians) and height of geocentric coordinates (Bowring 1976, iterated).
    fn geodetic(self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        let (a, e2) = (self.a, self.e2);
        let side = (1.0 - e2).sqrt();
        let radius = (x * x + y * y).sqrt();
        let mut reduced = atan2(z, side * radius);
        let mut lat = reduced;
        for _ in 0..4 {
            let (s, c) = (sin(reduced), cos(reduced));
            lat = atan2(z + e2 / (1.0 - e2) * a * side * s * s * s, radius - e2 * a * c * c * c);
            reduced = atan2(side * sin(lat), cos(lat));
        }
        let height = radius * cos(lat) + z * sin(lat) - a * (1.0 - e2 * square(sin(lat))).sqrt();
        [atan2(y, x), lat, height]
    }

    /// Mean radius of curvature.
    fn radius(self, lat: f64) -> f64 {
        self.a * (1.0 - self.e2).sqrt() / (1.0 - self.e2 * square(sin(lat)))
    }
}

/// Rows to the east, north and up at a place.
fn local_axes([lon, lat]: [f64; 2]) -> Matrix3<f64> {
    let (sin_lon, cos_lon, sin_lat, cos_lat) = (sin(lon), cos(lon), sin(lat), cos(lat));
    Matrix3::new(
        -sin_lon,
        cos_lon,
        0.0,
        -sin_lat * cos_lon,
        -sin_lat * sin_lon,
        cos_lat,
        cos_lat * cos_lon,
        cos_lat * sin_lon,
        sin_lat,
    )
}

/// Longitude from Greenwich and latitude of geocentric coordinates, degrees, on the ellipsoid of WGS 84.
pub fn place_deg(geocentric_m: [f64; 3]) -> [f64; 2] {
    let flattening = 1.0 / 298.257_223_563;
    let [lon, lat, _] = Ellipsoid { a: 6_378_137.0, e2: flattening * (2.0 - flattening) }.geodetic(geocentric_m);
    [lon.to_degrees(), lat.to_degrees()]
}

/// Letters and digits alone, in lower case.
fn plain(name: &str) -> String {
    name.chars().filter(char::is_ascii_alphanumeric).map(|c| c.to_ascii_lowercase()).collect()
}

/// A parameter of a projection by one of its names in any dialect, and the factor of its own unit.
fn parameter(plane: &Node, names: &[&str]) -> Option<(f64, Option<f64>)> {
    let all = plane.child(&["CONVERSION"]).unwrap_or(plane).nodes().filter(|node| node.keyword == "PARAMETER");
    let node = all.into_iter().find(|node| names.contains(&plain(node.name()).as_str()))?;
    let unit = node.child(&["LENGTHUNIT", "ANGLEUNIT", "UNIT"]).and_then(|unit| unit.number(1));
    Some((node.number(1)?, unit))
}

impl MapProjection {
    /// The projection of a system in metres; `None` for one that is neither transverse Mercator nor Lambert's conformal cone.
    pub fn of(crs: &Crs) -> Option<Self> {
        let plane = Node::parse(&crs.horizontal().wkt()).ok()?;
        let base = plane.child(&["GEOGCS", "BASEGEOGCRS", "BASEGEODCRS"])?;
        let datum = base.child(&["DATUM", "ENSEMBLE", "GEODETICDATUM", "TRF"])?;
        let figure = datum.child(&["SPHEROID", "ELLIPSOID"])?;
        let metres = figure.child(&["LENGTHUNIT"]).and_then(|unit| unit.number(1)).unwrap_or(1.0);
        let flattening = figure.number(2).filter(|inverse| *inverse > 1.0).map_or(0.0, |inverse| 1.0 / inverse);
        let ellipsoid = Ellipsoid { a: figure.number(1)? * metres, e2: flattening * (2.0 - flattening) };
        let unit = |node: &Node| node.child(&["UNIT", "ANGLEUNIT"]).and_then(|unit| unit.number(1));
        let radians = unit(base).unwrap_or(1f64.to_radians());
        let angle = |names: &[&str]| parameter(&plane, names).map(|(value, unit)| value * unit.unwrap_or(radians));
        let length = |names: &[&str]| parameter(&plane, names).map_or(0.0, |(value, unit)| value * unit.unwrap_or(1.0));
        let meridian = base.child(&["PRIMEM"]).or_else(|| plane.child(&["PRIMEM"]));
        let meridian =
            meridian.map_or(0.0, |node| node.number(1).unwrap_or(0.0) * unit(node).unwrap_or(1f64.to_radians()));
        let lat0 = angle(&["latitudeoforigin", "latitudeofnaturalorigin", "latitudeoffalseorigin"]).unwrap_or(0.0);
        let lon0 = angle(&[
            "centralmeridian",
            "longitudeoforigin",
            "longitudeofcenter",
            "longitudeofnaturalorigin",
            "longitudeoffalseorigin",
        ])?;
        let method = plane.child(&["CONVERSION"]).and_then(|conversion| conversion.child(&["METHOD"]));
        let family = match plain(method.or_else(|| plane.child(&["PROJECTION"]))?.name()).as_str() {
            "transversemercator" | "gausskruger" => Family::Transverse,
            "lambertconformalconic"
            | "lambertconformalconic1sp"
            | "lambertconformalconic2sp"
            | "lambertconicconformal1sp"
            | "lambertconicconformal2sp" => {
                let first = angle(&["standardparallel1", "latitudeof1ststandardparallel"]).unwrap_or(lat0);
                Family::Cone([first, angle(&["standardparallel2", "latitudeof2ndstandardparallel"]).unwrap_or(first)])
            }
            _ => return None,
        };
        let k0 = parameter(&plane, &["scalefactor", "scalefactoratnaturalorigin"]).map_or(1.0, |(factor, _)| factor);
        let false_m =
            [length(&["falseeasting", "eastingatfalseorigin"]), length(&["falsenorthing", "northingatfalseorigin"])];
        Some(Self { family, ellipsoid, lat0, lon0: lon0 + meridian, k0, false_m, plane })
    }

    /// The place of geocentric coordinates in the datum of the system; `None` where the map does not reach, or is defined otherwise than it seems.
    pub fn place(&self, geocentric_m: [f64; 3]) -> Option<OnMap> {
        /// Both inverses agree to a decimetre.
        const SAME_DEG: f64 = 1e-6;
        let [lon, lat, height] = self.ellipsoid.geodetic(geocentric_m);
        let turn = std::f64::consts::TAU;
        let from_middle = (lon - self.lon0 + turn / 2.0).rem_euclid(turn) - turn / 2.0;
        let [x, y] = match self.family {
            Family::Transverse => {
                let [x, y] = self.transverse([from_middle, lat]);
                [x, y - self.transverse([0.0, self.lat0])[1]]
            }
            Family::Cone(parallels) => self.cone(parallels, [from_middle, lat]),
        };
        let plane = [x + self.false_m[0], y + self.false_m[1]];
        let of_map = Scale::at(&self.plane, plane)?;
        let [other_lon, other_lat] = of_map.place_deg;
        let off = (other_lon - lon.to_degrees() + 180.0).rem_euclid(360.0) - 180.0;
        if off.abs() * cos(lat) > SAME_DEG || (other_lat - lat.to_degrees()).abs() > SAME_DEG {
            return None;
        }
        let convergence = of_map.convergence_deg.to_radians();
        let (s, c) = (sin(convergence), cos(convergence));
        let to_grid = Matrix3::new(c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0);
        let radius = self.ellipsoid.radius(lat);
        Some(OnMap {
            place_m: [plane[0], plane[1], height],
            map_from_earth: to_grid * local_axes([lon, lat]),
            scale: of_map.lengths[0].midpoint(of_map.lengths[1]) * radius / (radius + height),
            convergence_deg: of_map.convergence_deg,
        })
    }

    /// Easting from the central meridian and northing from the equator, metres.
    fn transverse(&self, [lon, lat]: [f64; 2]) -> [f64; 2] {
        let n = {
            let side = (1.0 - self.ellipsoid.e2).sqrt();
            (1.0 - side) / (1.0 + side)
        };
        let (n2, n3, n4) = (n * n, n * n * n, n * n * n * n);
        let radius = self.k0 * self.ellipsoid.a / (1.0 + n) * (1.0 + n2 / 4.0 + n4 / 64.0);
        let hyperbolic = |x: f64| {
            let (up, down) = (exp(x), exp(-x));
            [(up - down) / 2.0, up.midpoint(down)]
        };
        let [sinh, cosh] = hyperbolic(self.ellipsoid.isometric(lat));
        let (up, along) = (atan2(sinh, cos(lon)), artanh(sin(lon) / cosh));
        let series = [
            n / 2.0 - 2.0 / 3.0 * n2 + 5.0 / 16.0 * n3 + 41.0 / 180.0 * n4,
            13.0 / 48.0 * n2 - 3.0 / 5.0 * n3 + 557.0 / 1440.0 * n4,
            61.0 / 240.0 * n3 - 103.0 / 140.0 * n4,
            49_561.0 / 161_280.0 * n4,
        ];
        let (mut x, mut y) = (along, up);
        for (factor, term) in [2.0, 4.0, 6.0, 8.0].into_iter().zip(series) {
            let [sinh, cosh] = hyperbolic(factor * along);
            x += term * cos(factor * up) * sinh;
            y += term * sin(factor * up) * cosh;
        }
        [radius * x, radius * y]
    }

    fn cone(&self, [lat1, lat2]: [f64; 2], [lon, lat]: [f64; 2]) -> [f64; 2] {
        let of = self.ellipsoid;
        let n = if (lat2 - lat1).abs() > 1e-9 {
            log(of.parallel(lat1) / of.parallel(lat2)) / (of.isometric(lat2) - of.isometric(lat1))
        } else {
            sin(lat1)
        };
        let radius =
            |lat: f64| of.a * self.k0 * of.parallel(lat1) / n * exp(n * (of.isometric(lat1) - of.isometric(lat)));
        [radius(lat) * sin(n * lon), radius(self.lat0) - radius(lat) * cos(n * lon)]
    }
}

/// The datum of a system on the Earth: its name without the words of dialects, and its ellipsoid.
#[derive(Debug, Clone, PartialEq)]
pub struct Datum {
    /// As the system states it.
    pub name: String,
    known: String,
    half_axis_m: f64,
    inverse_flattening: f64,
}

impl Datum {
    /// That of a system, in whatever depth it stands there.
    pub fn of(system: &Node) -> Option<Self> {
        let Some(datum) = system.child(&["DATUM", "ENSEMBLE", "GEODETICDATUM", "TRF"]) else {
            return system.nodes().find_map(Self::of);
        };
        let figure = datum.child(&["SPHEROID", "ELLIPSOID"])?;
        let name = datum.name().to_owned();
        let short = plain(name.strip_prefix("D_").unwrap_or(&name));
        let known = match short.strip_suffix("ensemble").unwrap_or(&short) {
            "worldgeodeticsystem1984" => "wgs1984",
            "etrs1989" => "europeanterrestrialreferencesystem1989",
            other => other,
        };
        let known = known.to_owned();
        Some(Self { name, known, half_axis_m: figure.number(1)?, inverse_flattening: figure.number(2)? })
    }

    /// Whether both are one.
    pub fn is(&self, other: &Self) -> bool {
        self.known == other.known && self.has_figure_of(other)
    }

    /// Whether both have the figure of WGS 84 or GRS 80: they are about the middle of the Earth, and a metre or two apart.
    pub fn is_near(&self, other: &Self) -> bool {
        let is_modern = |of: &Self| {
            (of.half_axis_m - 6_378_137.0).abs() < 1e-3 && (of.inverse_flattening - 298.257_222_8).abs() < 2e-6
        };
        is_modern(self) && is_modern(other)
    }

    fn has_figure_of(&self, other: &Self) -> bool {
        (self.half_axis_m - other.half_axis_m).abs() < 1e-3
            && (self.inverse_flattening - other.inverse_flattening).abs() < 1e-5
    }
}

#[cfg(test)]
mod tests;
