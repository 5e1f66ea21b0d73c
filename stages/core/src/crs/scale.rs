//! How a map shows a place: the scale of its lengths and the direction of its north, from the formulas of the projection.
//!
//! The projections are those of EPSG guidance note 7-2 and Snyder (1987): most systems of map coordinates are in one of them. Oblique cylinders
//! and cones go through the conformal sphere of Gauss, which differs from the ellipsoid by less than a millionth of the scale near the origin.

use super::signature;
use super::wkt::Node;
use crate::numerics::portable_math::{asin, atan, atan2, cos, exp, log, sin, tan};

/// What a map does to lengths and directions at a place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scale {
    /// The least and the greatest length on the map of a unit of length on the ellipsoid, over all directions: equal where the map is conformal.
    pub lengths: [f64; 2],
    /// How far grid north is to the east of true north (meridian convergence), degrees.
    pub convergence_deg: f64,
    /// Longitude from Greenwich and latitude of the place, degrees.
    pub place_deg: [f64; 2],
}

impl Scale {
    /// The scale at an easting and a northing in metres; `None` for a projection without a formula here, or where it does not reach.
    pub fn at(plane: &Node, [easting_m, northing_m]: [f64; 2]) -> Option<Self> {
        let [false_easting_m, false_northing_m] = signature::false_origin(plane);
        let map = Map::of(plane)?;
        let [lon, lat] = map.inverse([easting_m - false_easting_m, northing_m - false_northing_m])?;
        let [east, north] = map.partials([lon, lat]);
        let curvature = 1.0 - map.e2 * square(sin(lat));
        let parallel_m = map.a * cos(lat) / curvature.sqrt();
        let meridian_m = map.a * (1.0 - map.e2) / (curvature * curvature.sqrt());
        let [along_x, along_y] = east.map(|metres| metres / parallel_m);
        let [up_x, up_y] = north.map(|metres| metres / meridian_m);
        // The half axes of Tissot's indicatrix.
        let squares = square(along_x) + square(along_y) + square(up_x) + square(up_y);
        let area = (along_x * up_y - along_y * up_x).abs();
        let (sum, difference) = ((squares + 2.0 * area).sqrt(), (squares - 2.0 * area).max(0.0).sqrt());
        let lengths = [(sum - difference) / 2.0, sum.midpoint(difference)];
        let convergence_deg = atan2(-up_x, up_y).to_degrees();
        let longitude = (map.lon0 + lon).to_degrees();
        let place_deg = [(longitude + 180.0).rem_euclid(360.0) - 180.0, lat.to_degrees()];
        let is_sound = lengths.iter().chain(&place_deg).all(|number| number.is_finite()) && lengths[0] > 0.0;
        is_sound.then_some(Self { lengths, convergence_deg, place_deg })
    }

    /// How far the length that is farthest off is off, as a fraction of it.
    pub fn error(&self) -> f64 {
        self.lengths.iter().fold(0.0, |worst, length| f64::max(worst, (length - 1.0).abs()))
    }
}

impl std::fmt::Display for Scale {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [least, greatest] = self.lengths;
        if greatest - least < 5e-6 {
            return write!(f, "{greatest:.5}");
        }
        write!(f, "{least:.5} to {greatest:.5}, by direction,")
    }
}

/// The families of projections.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Family {
    Transverse,
    Conformal,
    EqualAreaCone,
    Mercator,
    EqualAreaCylinder,
    Equirectangular,
    EqualAreaAzimuthal,
    Polar,
    Stereographic,
    ObliqueCylinder,
    Krovak,
}

/// A projection with its parameters: angles in radians, lengths in metres.
#[derive(Debug, Clone)]
pub(super) struct Map {
    family: Family,
    /// Half axis of the ellipsoid and the square of its eccentricity.
    pub a: f64,
    pub e2: f64,
    lat0: f64,
    /// From Greenwich.
    pub lon0: f64,
    lat1: Option<f64>,
    lat2: Option<f64>,
    k0: f64,
    azimuth: f64,
    turn: f64,
}

/// Step of the derivatives, radians: some sixty metres.
const STEP: f64 = 1e-5;
/// Steps of Newton's method, and how near they must come, metres.
const MOST_STEPS: usize = 60;
const NEAR_M: f64 = 1e-3;
/// No latitude is nearer to a pole, radians.
const POLE: f64 = std::f64::consts::FRAC_PI_2 - 1e-7;

fn square(x: f64) -> f64 {
    x * x
}

fn artanh(x: f64) -> f64 {
    0.5 * log((1.0 + x) / (1.0 - x))
}

/// Hyperbolic sine, cosine and tangent.
fn hyperbolic(x: f64) -> [f64; 3] {
    let (up, down) = (exp(x), exp(-x));
    [(up - down) / 2.0, up.midpoint(down), (up - down) / (up + down)]
}

fn family(projection: &str, lat0: f64) -> Option<Family> {
    let at_a_pole = (lat0.abs() - std::f64::consts::FRAC_PI_2).abs() < 1e-9;
    Some(match projection {
        "transversemercator" => Family::Transverse,
        "lambertconformalconic" | "lambertconformalconic2spbelgium" => Family::Conformal,
        "albersconicequalarea" => Family::EqualAreaCone,
        "mercator" | "mercator1sp" | "mercator2sp" | "mercatorvarianta" | "mercatorvariantb" => Family::Mercator,
        "cylindricalequalarea"
        | "lambertcylindricalequalarea"
        | "lambertcylindricalequalareaspherical"
        | "behrmann" => Family::EqualAreaCylinder,
        "equirectangular"
        | "platecarree"
        | "equidistantcylindrical"
        | "equidistantcylindricalspherical"
        | "pseudoplatecarree" => Family::Equirectangular,
        "lambertazimuthalequalarea" | "lambertazimuthalequalareaspherical" => Family::EqualAreaAzimuthal,
        "polarstereographic" => Family::Polar,
        "stereographic" if at_a_pole => Family::Polar,
        "stereographic" | "obliquestereographic" => Family::Stereographic,
        "hotineobliquemercatorazimuthcenter" | "swissobliquecylindrical" => Family::ObliqueCylinder,
        "krovak" => Family::Krovak,
        _ => return None,
    })
}

impl Map {
    pub fn of(plane: &Node) -> Option<Self> {
        let base = plane.child(&["GEOGCS", "BASEGEOGCRS", "BASEGEODCRS"])?;
        let datum = base.child(&["DATUM", "ENSEMBLE", "GEODETICDATUM", "TRF"])?;
        let ellipsoid = datum.child(&["SPHEROID", "ELLIPSOID"])?;
        let a = ellipsoid.number(1)? * ellipsoid.child(&["LENGTHUNIT"]).and_then(|unit| unit.number(1)).unwrap_or(1.0);
        let inverse_flattening = ellipsoid.number(2)?;
        let flattening = if inverse_flattening > 1.0 { 1.0 / inverse_flattening } else { 0.0 };
        let unit = |node: &Node| node.child(&["UNIT", "ANGLEUNIT"]).and_then(|unit| unit.number(1));
        let radians = unit(base).unwrap_or(1f64.to_radians());
        let number = |wanted: &str| {
            let mut all = signature::parameter_nodes(plane);
            all.find(|(name, _)| name == wanted).and_then(|(_, node)| Some((node, node.number(1)?)))
        };
        let angle = |wanted: &str| number(wanted).map(|(node, value)| value * unit(node).unwrap_or(radians));
        let projection = signature::projection(plane)?;
        let behrmann = (projection == "behrmann").then_some(30f64.to_radians());
        let parallel = angle("latitudeofstandardparallel").or_else(|| angle("standardparallel1")).or(behrmann);
        let lat0 = angle("latitudeoforigin").unwrap_or(0.0);
        let azimuth = angle("azimuth").unwrap_or(std::f64::consts::FRAC_PI_2);
        let meridian = base.child(&["PRIMEM"]).or_else(|| plane.child(&["PRIMEM"]));
        // Without a unit of its own it is in degrees, whatever the unit of the system is.
        let meridian = meridian
            .map_or(0.0, |node| node.number(1).unwrap_or(0.0) * unit(node).unwrap_or_else(|| 1f64.to_radians()));
        Some(Self {
            family: family(&projection, lat0)?,
            a,
            e2: flattening * (2.0 - flattening),
            lat0,
            lon0: angle("centralmeridian").unwrap_or(0.0) + meridian,
            lat1: parallel,
            lat2: angle("standardparallel2"),
            k0: number("scalefactor").map_or(1.0, |(_, factor)| factor),
            azimuth,
            turn: angle("rectifiedgridangle").unwrap_or(azimuth),
        })
    }

    /// Whether the formula is that of the projection: oblique cylinders other than the Swiss, stereographic maps beside a pole that are no double
    /// projections, and maps that PROJ takes on a sphere differ from theirs.
    pub fn is_exact(&self, plane: &Node) -> bool {
        match self.family {
            Family::ObliqueCylinder => (self.azimuth - std::f64::consts::FRAC_PI_2).abs() < 1e-9,
            Family::Stereographic => signature::projection(plane).is_some_and(|name| name == "obliquestereographic"),
            Family::Equirectangular => false,
            _ => true,
        }
    }

    fn e(&self) -> f64 {
        self.e2.sqrt()
    }

    /// Isometric latitude.
    fn isometric(&self, lat: f64) -> f64 {
        artanh(sin(lat)) - self.e() * artanh(self.e() * sin(lat))
    }

    /// Radius of a parallel, half axes.
    fn parallel(&self, lat: f64) -> f64 {
        cos(lat) / (1.0 - self.e2 * square(sin(lat))).sqrt()
    }

    /// Area from the equator to a latitude, as Snyder's q.
    fn area(&self, lat: f64) -> f64 {
        let (s, e) = (sin(lat), self.e());
        if e < 1e-9 {
            return 2.0 * s;
        }
        (1.0 - self.e2) * (s / (1.0 - self.e2 * s * s) + artanh(e * s) / e)
    }

    /// Easting and northing from the false origin, metres, of a longitude from the central meridian and a latitude.
    pub fn forward(&self, [lon, lat]: [f64; 2]) -> [f64; 2] {
        match self.family {
            Family::Transverse => {
                let [x, y] = self.transverse([lon, lat]);
                [self.k0 * x, self.k0 * (y - self.transverse([0.0, self.lat0])[1])]
            }
            Family::Conformal => self.conformal_cone([lon, lat]),
            Family::EqualAreaCone => self.equal_area_cone([lon, lat]),
            Family::Mercator => {
                let radius = self.a * self.lat1.map_or(self.k0, |lat1| self.parallel(lat1));
                [radius * lon, radius * self.isometric(lat)]
            }
            Family::EqualAreaCylinder => {
                let k = self.lat1.map_or(self.k0, |lat1| self.parallel(lat1));
                [self.a * k * lon, self.a * self.area(lat) / (2.0 * k)]
            }
            Family::Equirectangular => [self.a * self.lat1.map_or(1.0, cos) * lon, self.a * (lat - self.lat0)],
            Family::EqualAreaAzimuthal => self.equal_area_azimuthal([lon, lat]),
            Family::Polar => self.polar([lon, lat]),
            Family::Stereographic => {
                let [radius, up, east, north] = self.on_sphere([lon, lat]);
                [east, north].map(|side| 2.0 * radius * self.k0 * side / (1.0 + up))
            }
            Family::ObliqueCylinder => {
                let [radius, up, east, north] = self.on_sphere([lon, lat]);
                let along = east * sin(self.azimuth) + north * cos(self.azimuth);
                let across = east * cos(self.azimuth) - north * sin(self.azimuth);
                let (u, v) = (radius * self.k0 * atan2(along, up), radius * self.k0 * artanh(across));
                [v * cos(self.turn) + u * sin(self.turn), u * cos(self.turn) - v * sin(self.turn)]
            }
            Family::Krovak => self.krovak([lon, lat]),
        }
    }

    /// Krueger's series, without scale and origin.
    fn transverse(&self, [lon, lat]: [f64; 2]) -> [f64; 2] {
        let n = {
            let side = (1.0 - self.e2).sqrt();
            (1.0 - side) / (1.0 + side)
        };
        let radius = self.a / (1.0 + n) * (1.0 + n * n / 4.0 + n * n * n * n / 64.0);
        let [sinh, cosh, _] = hyperbolic(self.isometric(lat));
        let (up, along) = (atan2(sinh, cos(lon)), artanh(sin(lon) / cosh));
        let (n2, n3, n4) = (n * n, n * n * n, n * n * n * n);
        let series = [
            n / 2.0 - 2.0 / 3.0 * n2 + 5.0 / 16.0 * n3 + 41.0 / 180.0 * n4,
            13.0 / 48.0 * n2 - 3.0 / 5.0 * n3 + 557.0 / 1440.0 * n4,
            61.0 / 240.0 * n3 - 103.0 / 140.0 * n4,
            49_561.0 / 161_280.0 * n4,
        ];
        let (mut x, mut y) = (along, up);
        for (factor, term) in [2.0, 4.0, 6.0, 8.0].into_iter().zip(series) {
            let [sinh, cosh, _] = hyperbolic(factor * along);
            x += term * cos(factor * up) * sinh;
            y += term * sin(factor * up) * cosh;
        }
        [radius * x, radius * y]
    }

    fn conformal_cone(&self, [lon, lat]: [f64; 2]) -> [f64; 2] {
        let lat1 = self.lat1.unwrap_or(self.lat0);
        let n = match self.lat2.filter(|lat2| (lat2 - lat1).abs() > 1e-9) {
            Some(lat2) => {
                log(self.parallel(lat1) / self.parallel(lat2)) / (self.isometric(lat2) - self.isometric(lat1))
            }
            None => sin(lat1),
        };
        let radius = |lat: f64| {
            self.a * self.k0 * self.parallel(lat1) / n * exp(n * (self.isometric(lat1) - self.isometric(lat)))
        };
        [radius(lat) * sin(n * lon), radius(self.lat0) - radius(lat) * cos(n * lon)]
    }

    fn equal_area_cone(&self, [lon, lat]: [f64; 2]) -> [f64; 2] {
        let lat1 = self.lat1.unwrap_or(self.lat0);
        let lat2 = self.lat2.unwrap_or(lat1);
        let n = if (lat2 - lat1).abs() > 1e-9 {
            (square(self.parallel(lat1)) - square(self.parallel(lat2))) / (self.area(lat2) - self.area(lat1))
        } else {
            sin(lat1)
        };
        let most = square(self.parallel(lat1)) + n * self.area(lat1);
        let radius = |lat: f64| self.a * (most - n * self.area(lat)).max(0.0).sqrt() / n;
        [radius(lat) * sin(n * lon), radius(self.lat0) - radius(lat) * cos(n * lon)]
    }

    fn equal_area_azimuthal(&self, [lon, lat]: [f64; 2]) -> [f64; 2] {
        let whole = self.area(std::f64::consts::FRAC_PI_2);
        let authalic = |lat: f64| asin((self.area(lat) / whole).clamp(-1.0, 1.0));
        let (beta, beta0) = (authalic(lat), authalic(self.lat0));
        let radius = self.a * (whole / 2.0).sqrt();
        let is_polar = cos(self.lat0) < 1e-9;
        let stretch = if is_polar { 1.0 } else { self.a * self.parallel(self.lat0) / (radius * cos(beta0)) };
        let up = sin(beta0) * sin(beta) + cos(beta0) * cos(beta) * cos(lon);
        let side = radius * (2.0 / (1.0 + up)).sqrt();
        let north = cos(beta0) * sin(beta) - sin(beta0) * cos(beta) * cos(lon);
        [side * stretch * cos(beta) * sin(lon), side / stretch * north]
    }

    /// `1` where the map is of the north pole, `-1` of the south pole.
    fn pole(&self) -> f64 {
        // Where the latitude of the pole is left out the standard parallel says the side.
        let parallel = if self.lat0.abs() < 1e-9 { self.lat1.unwrap_or(1.0) } else { self.lat0 };
        parallel.signum()
    }

    fn polar(&self, [lon, lat]: [f64; 2]) -> [f64; 2] {
        let pole = self.pole();
        let true_at = self.lat1.unwrap_or(self.lat0).abs();
        let fall = |lat: f64| exp(-self.isometric(lat));
        let radius = if true_at < POLE {
            self.k0 * self.parallel(true_at) / fall(true_at)
        } else {
            let e = self.e();
            2.0 * self.k0 / exp(0.5 * ((1.0 + e) * log(1.0 + e) + (1.0 - e) * log(1.0 - e)))
        };
        let distance = self.a * radius * fall(pole * lat);
        [distance * sin(lon), -pole * distance * cos(lon)]
    }

    /// Radius of the conformal sphere at the origin, and the point on it: up, east and north from there.
    fn on_sphere(&self, [lon, lat]: [f64; 2]) -> [f64; 4] {
        let [radius, factor, chi0, chi] = self.sphere(lat);
        let lon = factor * lon;
        let up = sin(chi0) * sin(chi) + cos(chi0) * cos(chi) * cos(lon);
        let north = cos(chi0) * sin(chi) - sin(chi0) * cos(chi) * cos(lon);
        [radius, up, cos(chi) * sin(lon), north]
    }

    /// Gauss' conformal sphere: radius, factor of longitudes, latitude of the origin on it, and that of a latitude.
    fn sphere(&self, lat: f64) -> [f64; 4] {
        let curvature = 1.0 - self.e2 * square(sin(self.lat0));
        let radius = self.a * (1.0 - self.e2).sqrt() / curvature;
        let factor = (1.0 + self.e2 * square(square(cos(self.lat0))) / (1.0 - self.e2)).sqrt();
        let sin_chi0 = sin(self.lat0) / factor;
        let shift = artanh(sin_chi0) - factor * self.isometric(self.lat0);
        let [.., tanh] = hyperbolic(factor * self.isometric(lat) + shift);
        [radius, factor, asin(sin_chi0), asin(tanh)]
    }

    /// Krovak's oblique cone, its axes counted to the east and north.
    fn krovak(&self, [lon, lat]: [f64; 2]) -> [f64; 2] {
        let parallel = 78.5f64.to_radians();
        let [radius, factor, _, chi] = self.sphere(lat);
        let lon = factor * lon;
        let sin_s = cos(self.azimuth) * sin(chi) + sin(self.azimuth) * cos(chi) * cos(lon);
        let s = asin(sin_s.clamp(-1.0, 1.0));
        let angle = sin(parallel) * asin((cos(chi) * sin(lon) / cos(s)).clamp(-1.0, 1.0));
        let half = |latitude: f64| log(tan(latitude / 2.0 + std::f64::consts::FRAC_PI_4));
        let distance = self.k0 * radius / tan(parallel) * exp(sin(parallel) * (half(parallel) - half(s)));
        [distance * sin(angle), -distance * cos(angle)]
    }

    /// The derivatives of easting and northing to longitude and to latitude.
    fn partials(&self, [lon, lat]: [f64; 2]) -> [[f64; 2]; 2] {
        let between = |[above, below]: [[f64; 2]; 2]| [0, 1].map(|i| (above[i] - below[i]) / (2.0 * STEP));
        let east = [lon + STEP, lon - STEP].map(|lon| self.forward([lon, lat]));
        let north = [lat + STEP, lat - STEP].map(|lat| self.forward([lon, lat]));
        [between(east), between(north)]
    }

    /// Longitude from the central meridian and latitude of a place on the map.
    pub fn inverse(&self, wanted: [f64; 2]) -> Option<[f64; 2]> {
        let [mut lon, mut lat] = self.guess(wanted);
        for _ in 0..MOST_STEPS {
            lat = lat.clamp(-POLE, POLE);
            let found = self.forward([lon, lat]);
            let [x, y] = [wanted[0] - found[0], wanted[1] - found[1]];
            if x.abs() + y.abs() < NEAR_M {
                return Some([lon, lat]);
            }
            let [east, north] = self.partials([lon, lat]);
            let whole = east[0] * north[1] - east[1] * north[0];
            // A step of more than half a radian leads away from where the map is nearly linear.
            let step = |part: f64| (part / whole).clamp(-0.5, 0.5);
            lon += step(x * north[1] - y * north[0]);
            lat += step(y * east[0] - x * east[1]);
            if !(lon.abs() < 4.0 && lat.is_finite()) {
                return None;
            }
        }
        None
    }

    fn guess(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let is_polar =
            self.family == Family::Polar || self.family == Family::EqualAreaAzimuthal && cos(self.lat0) < 1e-9;
        if is_polar {
            let pole = self.pole();
            let distance = (x * x + y * y).sqrt();
            let lat = std::f64::consts::FRAC_PI_2 - 2.0 * atan(distance / (2.0 * self.a));
            return [atan2(x, -pole * y), pole * lat];
        }
        match self.family {
            Family::Mercator => {
                let radius = self.a * self.lat1.map_or(self.k0, |lat1| self.parallel(lat1));
                let [.., tanh] = hyperbolic(y / radius);
                [x / radius, asin(tanh)]
            }
            Family::EqualAreaCylinder => {
                let k = self.lat1.map_or(self.k0, |lat1| self.parallel(lat1));
                [x / (self.a * k), asin((y * k / self.a).clamp(-1.0, 1.0))]
            }
            Family::Equirectangular => [x / (self.a * self.lat1.map_or(1.0, cos)), self.lat0 + y / self.a],
            // The false origin is the tip of the cone.
            Family::Krovak => [-0.15, self.lat0],
            _ => {
                let lat = (self.lat0 + y / self.a).clamp(-1.4, 1.4);
                [x / (self.a * cos(lat)), lat]
            }
        }
    }
}

#[cfg(test)]
mod tests;
