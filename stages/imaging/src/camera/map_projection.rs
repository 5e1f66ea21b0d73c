//! From geocentric coordinates to a map.

use nalgebra::Matrix3;

use rockface_core::crs::wkt::Node;
use rockface_core::crs::{Crs, Ellipsoid, Plane, known_datum};
use rockface_core::numerics::portable_math::{cos, sin};

/// A projected system whose coordinates can be computed.
#[derive(Debug, Clone)]
pub struct MapProjection {
    plane: Plane,
    ellipsoid: Ellipsoid,
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
    /// How much longer on the map a length in one direction is than one in another: 0 where the map is conformal.
    pub uneven: f64,
    /// How far grid north is to the east of true north (meridian convergence), degrees.
    pub convergence_deg: f64,
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
    let [lon, lat, _] = Ellipsoid::WGS_84.geodetic(geocentric_m);
    [lon.to_degrees(), lat.to_degrees()]
}

impl MapProjection {
    /// The projection of a system in metres.
    ///
    /// # Errors
    /// The name of a projection that is not computed, see [`Plane::COMPUTED`].
    pub fn of(crs: &Crs) -> Result<Self, String> {
        let plane = Plane::of(crs)?;
        Ok(Self { ellipsoid: plane.ellipsoid(), plane })
    }

    /// Whether its ellipsoid is that of WGS 84 or GRS 80, which differ by a tenth of a millimetre.
    pub fn has_figure_of_wgs_84(&self) -> bool {
        (self.ellipsoid.a - Ellipsoid::WGS_84.a).abs() < 1.0
    }

    /// The place of geocentric coordinates in the datum of the system; `None` where the map does not reach.
    pub fn place(&self, geocentric_m: [f64; 3]) -> Option<OnMap> {
        let [lon, lat, height_m] = self.ellipsoid.geodetic(geocentric_m);
        let [easting_m, northing_m] = self.plane.at([lon, lat])?;
        let of_map = self.plane.scale([easting_m, northing_m])?;
        let convergence = of_map.convergence_deg.to_radians();
        let (s, c) = (sin(convergence), cos(convergence));
        let to_grid = Matrix3::new(c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0);
        let radius_m = self.ellipsoid.mean_radius_m(lat);
        Some(OnMap {
            place_m: [easting_m, northing_m, height_m],
            map_from_earth: to_grid * local_axes([lon, lat]),
            scale: of_map.lengths[0].midpoint(of_map.lengths[1]) * radius_m / (radius_m + height_m),
            uneven: of_map.lengths[1] - of_map.lengths[0],
            convergence_deg: of_map.convergence_deg,
        })
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
        let known = known_datum(&name);
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
