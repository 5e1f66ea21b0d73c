//! What an importer makes of the systems that are stated: one in metres to carry on, factors to convert by, or a refusal.

use serde_json::Value;

use super::metric::in_metres;
use super::{Crs, Ellipsoid, Heights, Kind, Scale, Stated, Unit, heights_for_depths, parts, utm_zone};
use crate::artefact::{Frame, Georeference};
use crate::numerics::portable_math;
use crate::params::{self, Fault, ParamType};
use crate::{Context, StageError};

/// Parameter `crs` of importers: `EPSG:28356`, `EPSG:28356+5711` with heights, or well-known text.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CrsName(pub String);

impl CrsName {
    fn stated(&self) -> Result<Stated, String> {
        match super::codes(&self.0) {
            Some((code, height)) => Stated::from_epsg(code, height).map_err(|why| {
                let is_of_the_map = super::definition(code).is_none();
                if !is_of_the_map {
                    return why;
                }
                format!("{why}: give its definition, which `gdalsrsinfo -o wkt1 EPSG:{code}` prints")
            }),
            None if self.0.contains(['[', '(']) => Stated::from_wkt(&self.0),
            None => Err(format!("`{}` is not a code such as EPSG:28356, nor well-known text", self.0)),
        }
    }
}

impl CrsName {
    /// Whether coordinates in the system, and heights where it has them, are metres.
    pub fn is_in_metres(&self) -> bool {
        let is_metre = |unit: &Option<Unit>| unit.as_ref().is_none_or(Unit::is_metre);
        self.stated().is_ok_and(|stated| is_metre(&stated.unit) && is_metre(&stated.vertical_unit))
    }
}

impl ParamType for CrsName {
    fn kind() -> params::Kind {
        params::Kind::Text
    }
    fn decode(value: &Value) -> Result<Self, Vec<Fault>> {
        let name = match value {
            Value::Number(code) => Self(format!("EPSG:{code}")),
            other => Self(String::decode(other)?.trim().to_owned()),
        };
        let stated = name.stated().map_err(|message| vec![Fault::new(message)])?;
        match stated.kind {
            Kind::Projected => Ok(name),
            Kind::Depths => Err(vec![Fault::new(format!(
                "{}: heights are needed; {}",
                sort_of(&stated),
                way_to_heights(&stated, Tool::Other, "the file")
            ))]),
            kind if kind.needs_reprojection() => Err(vec![Fault::new(format!(
                "{}: a system in metres is needed, with axes to the east and north, such as the UTM zone of the site; reproject the file first",
                sort_of(&stated)
            ))]),
            _ => Err(vec![Fault::new(format!("`{}` is no system of map coordinates", stated.name))]),
        }
    }
    fn encode(&self) -> Value {
        Value::from(self.0.clone())
    }
}

fn sort_of(stated: &Stated) -> String {
    let name = &stated.name;
    match stated.kind {
        Kind::Geographic => format!("longitudes and latitudes in degrees ({name})"),
        Kind::Geocentric => format!("geocentric coordinates, X, Y and Z from the centre of the Earth ({name})"),
        Kind::WorldMap => {
            format!(
                "coordinates of a map of the world ({name}), whose lengths are not those on the ground: those of Mercator's are 1.4 times as \
                 long at 45 degrees north"
            )
        }
        Kind::Depths => format!("depths, which count downwards and would mirror the face ({name})"),
        Kind::WestSouth => format!("distances to the west or south ({name})"),
        _ => name.clone(),
    }
}

/// The program that brings a file of some sort into another system.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Tool {
    /// GDAL, for rasters.
    Gdal,
    /// PDAL, for LAS and LAZ.
    Pdal,
    /// GDAL's `ogr2ogr`, for outlines.
    Ogr,
    /// QGIS or CloudCompare, for meshes and text.
    Other,
}

/// What is to be done with the coordinates of a file.
#[derive(Debug, Clone, PartialEq)]
pub struct Settled {
    /// The system they are in once they are metres.
    pub crs: Option<Crs>,
    /// Metres of a unit of X and Y.
    pub horizontal: f64,
    /// Metres of a unit of Z.
    pub vertical: f64,
}

impl Settled {
    /// Metres in no stated system.
    pub fn metres() -> Self {
        Self { crs: None, horizontal: 1.0, vertical: 1.0 }
    }

    /// The world frame in that system.
    pub fn frame(&self) -> Frame {
        Frame::World.at(self.crs.clone().map(Georeference::world))
    }

    /// Whether the coordinates stay what they are, to the bit.
    pub fn keeps_coordinates(&self) -> bool {
        self.horizontal.to_bits() == 1f64.to_bits() && self.vertical.to_bits() == 1f64.to_bits()
    }

    /// A point in metres.
    pub fn point(&self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        if self.keeps_coordinates() {
            return [x, y, z];
        }
        [x * self.horizontal, y * self.horizontal, z * self.vertical]
    }
}

/// The fault of a parameter `crs` beside `frame: wall`.
pub fn wall_without_system(is_wall: bool) -> Option<Fault> {
    let text = "a wall frame is in no coordinate reference system; leave `crs` out, or `frame: wall`";
    is_wall.then(|| Fault::new(text).below("crs"))
}

/// Decides by what the file states, what a `.prj` beside it states, and parameter `crs`.
///
/// `at` is a place in the file, by which the UTM zone of a way out is found.
///
/// # Errors
/// Degrees, geocentric coordinates, depths, and a map whose lengths at that place are far from those on the ground; two statements that
/// contradict each other.
pub fn settle(
    path: &str,
    [file, beside]: [Option<Stated>; 2],
    given: Option<&CrsName>,
    (tool, first): (Tool, Option<[f64; 3]>),
    context: &Context,
) -> Result<Settled, StageError> {
    let given = given.map(CrsName::stated).transpose().map_err(StageError::new)?;
    let is_local = file.as_ref().is_some_and(|stated| stated.kind == Kind::Local);
    // A local system states its unit alone, which may be part of what else is stated.
    let is_part = |own: &Stated| [&beside, &given].into_iter().flatten().any(|other| other.unit == own.unit);
    let adds = |own: &Stated| !is_local || own.unit.as_ref().is_some_and(|unit| !unit.is_metre()) && !is_part(own);
    let file = file.filter(adds);
    let statements = [
        (format!("`{path}` itself"), file),
        (format!("the `.prj` beside `{path}`"), beside),
        ("parameter `crs`".to_owned(), given),
    ];
    let mut stated: Vec<(String, Stated)> = statements.into_iter().filter_map(|(who, s)| Some((who, s?))).collect();
    let found = |found: Option<(usize, &(String, Stated))>| found.map(|(place, _)| place);
    let unfit = |(_, s): &(String, Stated)| s.kind.needs_reprojection();
    if let Some(place) = found(stated.iter().enumerate().find(|(_, stated)| unfit(stated))) {
        let (who, stated) = stated.swap_remove(place);
        return Err(refusal(path, &who, &stated, tool, first));
    }
    // What cannot be read is overruled by what can.
    let known = stated.iter().any(|(_, s)| s.kind != Kind::Unknown);
    if let Some((who, unread)) = stated.iter().find(|(_, s)| s.kind == Kind::Unknown && !known) {
        let text = format!("{who} states a coordinate reference system that cannot be read: {}", unread.name);
        let way = "say which one it is with `crs: EPSG:...`, or, where its code is not known here, with its well-known text: `crs` takes what `gdalsrsinfo \
                   -o wkt1 EPSG:...` or `projinfo -o WKT1:GDAL EPSG:...` prints";
        return Err(StageError::new(text).hint(way));
    }
    stated.retain(|(_, s)| s.kind != Kind::Unknown);
    if let [(one, a), others @ ..] = stated.as_slice()
        && let Some((other, b)) = others.iter().find(|(_, b)| !a.agrees_with(b))
    {
        let text =
            format!("two coordinate reference systems for `{path}`: {one} states {}, {other} {}", a.name, b.name);
        return Err(StageError::new(text).hint("leave out the one that is wrong; `crs` is for files that state none"));
    }
    if stated.is_empty() {
        if !is_local {
            context.note(format!(
                "`{path}` states no coordinate reference system: its numbers are taken for metres; `crs: EPSG:...` states one"
            ));
        }
        return Ok(Settled::metres());
    }
    // Of those that agree the one that says most.
    stated.sort_by_key(|(_, s)| (s.vertical_unit.is_none(), s.node.is_none()));
    let place = with_heights(&stated).unwrap_or(0);
    let (_, stated) = stated.swap_remove(place);
    if let Some(warning) = first.and_then(|first| far_off(path, &stated, first)) {
        context.warn(warning);
    } else if let Some(scale) = first.and_then(|first| scale_at(&stated, first)) {
        check_scale(path, &stated, scale, tool, context)?;
    }
    Ok(converted(path, &stated, context))
}

/// Projections whose false origin is within what they map, and how far to its east or west places are at most, metres: zones, and maps of countries.
const FARTHEST_M: [(&str, f64); 5] = [
    ("transversemercator", 1.5e6),
    ("obliquestereographic", 1.5e6),
    ("hotineobliquemercatorazimuthcenter", 1.5e6),
    ("swissobliquecylindrical", 1.5e6),
    ("lambertconformalconic", 6e6),
];
/// Farther to the east or west than the edge of a zone, metres: easting and northing are swapped where the other way round both are within a
/// quarter of what they are from the false origin.
const SWAPPED_M: f64 = 3.5e5;
/// Farthest to the north or south, metres: more than the quarter of a meridian.
const QUARTER_M: f64 = 1.1e7;
/// A false easting that degrees are not mistaken for.
const LEAST_FALSE_M: f64 = 1000.0;

/// What is wrong with a point that cannot be one of the system it is said to be in.
fn far_off(path: &str, stated: &Stated, [x, y, _]: [f64; 3]) -> Option<String> {
    let node = stated.node.as_ref().filter(|_| stated.kind == Kind::Projected)?;
    let (plane, _) = parts(node);
    let metres = stated.unit.as_ref().map_or(1.0, |unit| unit.metres);
    let [false_x, false_y] = super::signature::false_origin(plane);
    let [x_m, y_m] = [x * metres - false_x, y * metres - false_y];
    let name = &stated.name;
    if x.abs() <= 180.0 && y.abs() <= 90.0 && false_x.abs().max(false_y.abs()) > LEAST_FALSE_M {
        return Some(format!(
            "`{path}` has coordinates such as {x}, {y}, which are degrees, or have lost a shift (`offset_m`), but is said to be in {name}"
        ));
    }
    let projection = super::signature::projection(plane)?;
    let (_, farthest_m) = FARTHEST_M.iter().find(|(known, _)| projection == *known)?;
    let other_way_round = [y * metres - false_x, x * metres - false_y];
    let is_swapped = x_m.abs() > SWAPPED_M
        && other_way_round[0].abs() < 0.25 * x_m.abs()
        && other_way_round[1].abs() < 0.25 * y_m.abs();
    let far = is_swapped || x_m.abs() > *farthest_m || y_m.abs() > QUARTER_M;
    far.then(|| {
        format!(
            "`{path}` has coordinates such as {x:.0}, {y:.0}, which lie {:.0} km to the east and {:.0} km to the north of the false origin of {name}: are easting \
             and northing swapped, or are the numbers those of another system?",
            1e-3 * x_m,
            1e-3 * y_m
        )
    })
}

/// A map whose lengths are off by more than this is no map of the site.
const MOST_ERROR: f64 = 0.1;
/// From this error on a step warns of it: volumes are off by twice as much, since heights are not scaled.
const NOTABLE_ERROR: f64 = 0.002;

fn scale_at(stated: &Stated, [x, y, _]: [f64; 3]) -> Option<Scale> {
    let node = stated.node.as_ref().filter(|_| stated.kind == Kind::Projected)?;
    let metres = stated.unit.as_ref().map_or(1.0, |unit| unit.metres);
    Scale::at(parts(node).0, [x * metres, y * metres])
}

/// Says what the map does to lengths and directions at the site.
///
/// # Errors
/// Lengths that are more than a tenth off.
fn check_scale(path: &str, stated: &Stated, scale: Scale, tool: Tool, context: &Context) -> Result<(), StageError> {
    let name = &stated.name;
    let error = scale.error();
    if error > MOST_ERROR {
        let [longitude, latitude] = scale.place_deg;
        let to = zone_of(Kind::Geographic, [longitude, latitude, 0.0]);
        let to = to.map_or_else(|| "EPSG:326NN".to_owned(), |code| format!("EPSG:{code}"));
        let text = format!(
            "`{path}` is in {name}, a map whose lengths at the site are {scale} times those on the ground; what is needed are metres on \
             the ground to the east and north"
        );
        let way = reprojected(path, &to, tool);
        return Err(StageError::new(text).hint(format!("bring it to the UTM zone of the site: {way}")));
    }
    if error > NOTABLE_ERROR {
        context.warn(format!(
            "lengths in {name} are {scale} times those on the ellipsoid at the site of `{path}`: volumes, sizes and distances are those \
             on the map; a map of the site, such as its UTM zone, has lengths that are right to 0.1 %"
        ));
    }
    let side = if scale.convergence_deg < 0.0 { "west" } else { "east" };
    context.note(format!(
        "lengths in {name} are {scale} times those on the ellipsoid at the site of `{path}`, and grid north is {:.3} degrees to the {side} \
         of true north",
        scale.convergence_deg.abs()
    ));
    Ok(())
}

/// Where the system of heights of the first statement is not known: a statement with heights in the same unit.
fn with_heights(stated: &[(String, Stated)]) -> Option<usize> {
    let (_, first) = stated.first().filter(|(_, first)| first.unknown_heights.is_some())?;
    let has_heights = |stated: &Stated| stated.node.as_ref().is_some_and(|node| parts(node).1.is_some());
    stated.iter().position(|(_, other)| has_heights(other) && other.vertical_unit == first.vertical_unit)
}

/// The way from depths to heights.
fn way_to_heights(stated: &Stated, tool: Tool, path: &str) -> String {
    let node = stated.node.as_ref().map(parts);
    let plane = node.and_then(|(plane, _)| plane.epsg());
    let heights = node.and_then(|(_, vertical)| heights_for_depths(vertical?.epsg()?));
    match (plane, heights) {
        (Some(plane), Some(heights)) => {
            let to = format!("EPSG:{plane}+{heights}");
            format!("bring it to the heights above the same datum, {to}: {}", reprojected(path, &to, tool))
        }
        _ => "multiply Z by -1 (CloudCompare: Edit, Multiply/Scale) and state a system of heights".to_owned(),
    }
}

/// What brings a file into a system.
fn reprojected(path: &str, to: &str, tool: Tool) -> String {
    let name = path.rsplit('/').next().unwrap_or(path);
    match tool {
        Tool::Gdal => format!("`gdalwarp -t_srs {to} {name} out.tif`"),
        Tool::Pdal => format!("`pdal translate {name} out.laz reprojection --filters.reprojection.out_srs={to}`"),
        Tool::Ogr => format!("`ogr2ogr -t_srs {to} out.geojson {name}`"),
        Tool::Other => format!("QGIS and CloudCompare reproject to {to}"),
    }
}

fn refusal(path: &str, who: &str, stated: &Stated, tool: Tool, first: Option<[f64; 3]>) -> StageError {
    if stated.kind == Kind::Depths {
        let text = format!("`{path}` has {}, as {who} states; heights are needed", sort_of(stated));
        return StageError::new(text).hint(way_to_heights(stated, tool, path));
    }
    let zone = first.and_then(|first| zone_of(stated.kind, first));
    let to = zone.map_or_else(|| "EPSG:326NN".to_owned(), |code| format!("EPSG:{code}"));
    let of_place = if zone.is_some() { "the UTM zone of the site" } else { "its UTM zone (NN)" };
    let command = reprojected(path, &to, tool);
    let text = format!(
        "`{path}` has {}, as {who} states; what is needed are metres on the ground to the east and north",
        sort_of(stated)
    );
    StageError::new(text).hint(format!("bring it to {of_place}: {command}"))
}

/// The EPSG code of the UTM zone (WGS 84) of a point; `None` where it cannot be one.
fn zone_of(kind: Kind, [x, y, z]: [f64; 3]) -> Option<u32> {
    let earth = Ellipsoid::WGS_84;
    let (longitude, latitude) = match kind {
        Kind::Geocentric if (x * x + y * y).sqrt() < 1e5 => return None,
        Kind::Geocentric => {
            let [longitude, latitude, _] = earth.geodetic([x, y, z]);
            (longitude.to_degrees(), latitude.to_degrees())
        }
        Kind::WorldMap => {
            let latitude = 2.0 * portable_math::atan(portable_math::exp(y / earth.a)) - std::f64::consts::FRAC_PI_2;
            ((x / earth.a).to_degrees(), latitude.to_degrees())
        }
        _ => (x, y),
    };
    (longitude.abs() <= 180.0 && latitude.abs() <= 84.0).then(|| utm_zone([longitude, latitude]))
}

fn converted(path: &str, stated: &Stated, context: &Context) -> Settled {
    let unit = stated.unit.clone().unwrap_or_else(Unit::metre);
    let height = stated.vertical_unit.clone().unwrap_or_else(|| unit.clone());
    let crs = stated.node.as_ref().filter(|_| stated.kind == Kind::Projected);
    let crs = crs.map(|node| Crs::of_node(&in_metres(node, unit.metres, height.metres)));
    if !unit.is_metre() || !height.is_metre() {
        let lengths = if unit == height {
            format!("{} ({} m)", unit.name, unit.metres)
        } else {
            format!("{} ({} m), heights in {} ({} m)", unit.name, unit.metres, height.name, height.metres)
        };
        let assumed = if stated.vertical_unit.is_none() {
            "; nothing states the unit of heights, so they are taken for the same"
        } else {
            ""
        };
        let carried = crs.as_ref().map_or_else(String::new, |crs| format!("; the system is now {crs}"));
        context.warn(format!(
            "`{path}` is in {lengths}, as {} states: converted to metres{assumed}{carried}",
            stated.name
        ));
    } else if let Some(crs) = &crs {
        context.note(format!("coordinate reference system {} ({crs})", crs.name()));
    }
    if let Some(heights) = &stated.unknown_heights {
        let way = crs.as_ref().and_then(Crs::epsg).map_or_else(String::new, |code| {
            format!("; if it is known under another code, state that with `crs: EPSG:{code}+...`")
        });
        context.warn(format!(
            "`{path}` states its heights in {heights}, which is not known here: outputs do not state it{way}"
        ));
    }
    if stated.node.as_ref().is_some_and(|node| Heights::of(node) == Heights::Ellipsoid) {
        context.warn(format!(
            "the heights of `{path}` are above the ellipsoid, as {} states: they are up to 100 m from heights above the sea, and do not go together \
             with such",
            stated.name
        ));
    }
    if let (Some(shift), true) = (&stated.shift, crs.as_ref().is_none_or(|crs| crs.epsg().is_none())) {
        context.warn(format!(
            "{} has a shift of its datum to WGS 84 ({shift}), as `{path}` states, which outputs do not state: on other maps they may be hundreds \
             of metres off; give the EPSG code of the system with `crs: EPSG:...`",
            stated.name
        ));
    }
    if crs.is_none() && stated.kind == Kind::Projected {
        context.warn(format!(
            "the system of `{path}`, {}, is described in a way that cannot be carried on: outputs state none; give its code with \
             `crs: EPSG:...`",
            stated.name
        ));
    }
    Settled { crs, horizontal: unit.metres, vertical: height.metres }
}
