//! Reads rockfall inventories that other programs wrote as GeoJSON.

use std::collections::BTreeSet;

use serde_json::Value;

use rockface_core::artefact::{Cell, CodecError, Feature, Frame, Inventory, Polygon};
use rockface_core::crs::{Kind, Stated};
use rockface_core::format::inventory_file;
use rockface_core::format::table_file::MOST_COLUMNS;
use rockface_core::format::without_mark;
use rockface_core::limits;
use rockface_core::names::twice;

/// What a file of another program holds.
pub struct Foreign {
    /// Features and their properties; those that are points have no outline.
    pub inventory: Inventory,
    /// X, Y and Z of each feature that is a point, in the units of the file; Z is NaN where it has none.
    pub points: Vec<Option<[f64; 3]>>,
}

/// How the formats that an inventory is often in begin, and what each is called.
const OTHERS: [(&[u8], &str); 5] = [
    (b"SQLite format 3", "a GeoPackage"),
    (b"<?xml", "KML or other XML"),
    (b"<kml", "KML"),
    (&[0, 0, 0x27, 0x0a], "a shapefile"),
    (b"PK\x03\x04", "a ZIP file, as KMZ is"),
];

/// Reads a feature collection. Its member `rockface` states frame and columns; without it the frame is the one that its member `crs` names, as
/// files of ours do, or world. Properties that are not listed become columns too, behind those that are, in alphabetical order.
///
/// # Errors
/// Text that is no feature collection; a frame that is not known; the feature (counted from 0) that lacks a column which the
/// file lists, whose geometry is neither polygon nor point, or whose ring is not closed or holds something else than points.
pub fn read(bytes: &[u8]) -> Result<Foreign, CodecError> {
    if let Some((_, name)) = OTHERS.iter().find(|(start, _)| without_mark(bytes).starts_with(start)) {
        return Err(CodecError(format!(
            "it is {name}, but only GeoJSON can be read: `ogr2ogr -f GeoJSON NEW.geojson FILE`, or \"Export, Save Features As\" in QGIS, makes that of it"
        )));
    }
    let file: Value =
        serde_json::from_slice(without_mark(bytes)).map_err(|e| CodecError(format!("not a JSON file: {e}")))?;
    let features = file.get("features").and_then(Value::as_array);
    let features = features.ok_or_else(|| CodecError::new("not a GeoJSON feature collection: it has no `features`"))?;
    let properties =
        |feature: &Value| feature.get("properties").and_then(Value::as_object).cloned().unwrap_or_default();
    let mut names: BTreeSet<String> =
        features.iter().flat_map(|feature| properties(feature).into_iter().map(|(name, _)| name)).collect();
    let about = about(&file)?;
    let listed = about.as_ref().and_then(|about| about.columns.clone());
    let mut columns = listed.clone().unwrap_or_default();
    for column in &columns {
        names.remove(column);
    }
    if !names.is_empty() {
        check_columns(features, columns.len() + names.len())?;
    }
    columns.extend(names);
    let cells = (features.len() as u64).checked_mul((columns.len() * size_of::<Cell>()) as u64);
    limits::affordable(
        &format!("an inventory of {} features with {} properties", features.len(), columns.len()),
        cells,
    )?;
    let read = |(number, feature): (usize, &Value)| {
        let mut properties = properties(feature);
        if let Some(column) = listed.iter().flatten().find(|column| !properties.contains_key(*column)) {
            return Err(CodecError(format!(
                "feature {number} (counted from 0) has no property `{column}`, which the member `rockface` of the file lists: \
                 give it one, null where it is not known, or leave `columns` out of that member"
            )));
        }
        let values = columns.iter().map(|column| cell(properties.remove(column))).collect();
        let place = place(feature.get("geometry").unwrap_or(&Value::Null))
            .map_err(|e| CodecError(format!("feature {number} (counted from 0): {e}")))?;
        let (outline, point) = match place {
            Place::Outline(outline) => (outline, None),
            Place::Point(point) => (Vec::new(), Some(point)),
        };
        Ok((Feature { outline, values }, point))
    };
    let read = features.iter().enumerate().map(read).collect::<Result<Vec<_>, CodecError>>()?;
    let (features, points) = read.into_iter().unzip();
    let frame = about.map_or_else(|| frame_of_crs(&file), |about| about.frame);
    Ok(Foreign { inventory: Inventory { frame, columns, features }, points })
}

/// The frame of a file without member `rockface`: wall where its member `crs` has the name that we give to it.
fn frame_of_crs(file: &Value) -> Frame {
    let name = file.pointer("/crs/properties/name").and_then(Value::as_str);
    if name.is_some_and(inventory_file::names_wall_frame) { Frame::Wall } else { Frame::World }
}

/// Properties of a file of ours that its member `rockface` does not list, in alphabetical order: those that were added to it by hand.
pub fn unlisted(bytes: &[u8], columns: &[String]) -> Vec<String> {
    let Ok(file) = serde_json::from_slice::<Value>(without_mark(bytes)) else { return Vec::new() };
    let features = file.get("features").and_then(Value::as_array).into_iter().flatten();
    let properties = features.filter_map(|feature| feature.get("properties").and_then(Value::as_object));
    let names: BTreeSet<&String> = properties.flat_map(serde_json::Map::keys).collect();
    let listed: BTreeSet<&String> = columns.iter().collect();
    names.difference(&listed).map(ToString::to_string).collect()
}

/// Cells that are made of one property on average, at most: those of features that lack it are empty.
const CELLS_OF_A_PROPERTY: usize = 64;
/// Cells below which nobody counts.
const FEW_CELLS: usize = 1 << 20;

/// Refuses features whose properties have so many names that a table of them is far larger than the file.
fn check_columns(features: &[Value], columns: usize) -> Result<(), CodecError> {
    let count = |feature: &Value| feature.get("properties").and_then(Value::as_object).map_or(0, serde_json::Map::len);
    let (rows, given) = (features.len(), features.iter().map(count).sum::<usize>());
    let way = "is a value used as the name of a property?";
    if columns > MOST_COLUMNS {
        return Err(CodecError(format!("its properties have {columns} names, {MOST_COLUMNS} is the most; {way}")));
    }
    let cells = rows.saturating_mul(columns);
    if cells > FEW_CELLS && cells / CELLS_OF_A_PROPERTY > given {
        return Err(CodecError(format!(
            "its {rows} features have {columns} properties by name, but only {given} values: of {cells} cells, each property a column, nearly all would be empty; {way}"
        )));
    }
    Ok(())
}

/// What the member `rockface` of a file says about it.
struct About {
    frame: Frame,
    columns: Option<Vec<String>>,
}

/// The member `rockface`, if it is ours: one that names a frame.
fn about(file: &Value) -> Result<Option<About>, CodecError> {
    let member = |name: &str| file.get("rockface").and_then(|about| about.get(name)).cloned();
    let Some(frame) = member("frame") else { return Ok(None) };
    let faulty = |e: serde_json::Error| CodecError(format!("its member `rockface` cannot be read: {e}"));
    let frame = serde_json::from_value(frame).map_err(faulty)?;
    let columns: Option<Vec<String>> = member("columns").map(serde_json::from_value).transpose().map_err(faulty)?;
    match twice(columns.iter().flatten().collect()) {
        Some(name) => Err(CodecError(format!("its member `rockface` lists the column `{name}` twice"))),
        None => Ok(Some(About { frame, columns })),
    }
}

/// The name of the system of a file that has no member `crs`.
pub const UNSTATED: &str = "WGS 84 without a word";

/// The system of a feature collection: that of its frame or its member `crs`; degrees where it states neither and its numbers
/// can be such. `overruled`: a parameter says what a file without `crs` is in.
pub fn stated(bytes: &[u8], Foreign { inventory, points }: &Foreign, overruled: bool) -> Option<Stated> {
    if let Some(crs) = inventory.frame.crs() {
        return Some(Stated::of_crs(crs));
    }
    let file: Value = serde_json::from_slice(without_mark(bytes)).ok()?;
    if let Some(name) = file.pointer("/crs/properties/name").and_then(Value::as_str) {
        return Some(named(name));
    }
    let corners = inventory.features.iter().flat_map(|feature| &feature.outline).flat_map(|polygon| &polygon.exterior);
    let mut places = corners.copied().chain(points.iter().flatten().map(|[x, y, _]| [*x, *y])).peekable();
    let has_points = places.peek().is_some();
    let may_be_degrees = places.all(|[x, y]| x.abs() <= 180.0 && y.abs() <= 90.0);
    let states_frame = file.pointer("/rockface/frame").is_some();
    (may_be_degrees && has_points && !overruled && !states_frame)
        .then(|| Stated { kind: Kind::Geographic, ..Stated::local(UNSTATED, None) })
}

/// `urn:ogc:def:crs:EPSG::28356`, `http://www.opengis.net/def/crs/EPSG/0/28356`, `urn:ogc:def:crs,crs:EPSG::28356,crs:EPSG::5711`, `EPSG:28356`,
/// `urn:ogc:def:crs:OGC:1.3:CRS84`, or well-known text.
fn named(name: &str) -> Stated {
    if name.contains('[') {
        return Stated::of_prj(name.as_bytes());
    }
    if name.ends_with("CRS84") || name.ends_with("CRS84h") {
        return Stated { kind: Kind::Geographic, ..Stated::local("WGS 84, OGC:CRS84", None) };
    }
    let code = |part: &str| part.rsplit([':', '/']).next().and_then(|code| code.parse().ok());
    let codes: Option<Vec<u32>> =
        name.split(',').filter(|part| part.contains("EPSG")).map(code).collect::<Option<Vec<u32>>>();
    let stated = match codes.as_deref() {
        Some([code]) => Some(Stated::from_epsg(*code, None)),
        // Outlines have no heights.
        Some([code, height]) => {
            Some(Stated::from_epsg(*code, Some(*height)).or_else(|_| Stated::from_epsg(*code, None)))
        }
        _ => None,
    };
    stated.unwrap_or_else(|| Err(format!("`{name}`"))).unwrap_or_else(Stated::unknown)
}

fn cell(value: Option<Value>) -> Cell {
    match value {
        None | Some(Value::Null) => Cell::Empty(()),
        Some(Value::Bool(flag)) => flag.into(),
        Some(Value::String(text)) => text.into(),
        Some(Value::Number(number)) => number.as_f64().map_or(Cell::Empty(()), Cell::from),
        Some(other) => other.to_string().into(),
    }
}

enum Place {
    Outline(Vec<Polygon>),
    Point([f64; 3]),
}

fn place(geometry: &Value) -> Result<Place, String> {
    if geometry.is_null() {
        return Ok(Place::Outline(Vec::new()));
    }
    let coordinates = geometry.get("coordinates").and_then(Value::as_array).ok_or("a geometry without coordinates")?;
    match geometry.get("type").and_then(Value::as_str) {
        Some("Point") => point(coordinates).map(Place::Point),
        Some("MultiPoint") => match coordinates.as_slice() {
            [Value::Array(only)] => point(only).map(Place::Point),
            several => Err(format!("it has {} points, and a rockfall is at one", several.len())),
        },
        Some("Polygon") => Ok(Place::Outline(vec![polygon(coordinates)?])),
        Some("MultiPolygon") => {
            let list = |value: &Value| value.as_array().cloned().ok_or("a polygon that is no list");
            coordinates.iter().map(|value| polygon(&list(value)?)).collect::<Result<_, _>>().map(Place::Outline)
        }
        other => Err(format!("its geometry is a `{}`, not a polygon or a point", other.unwrap_or_default())),
    }
}

/// X, Y and Z of a point, Z NaN where it has none.
fn point(coordinates: &[Value]) -> Result<[f64; 3], String> {
    let number = |place: usize| coordinates.get(place).and_then(Value::as_f64);
    let plan = number(0).zip(number(1)).ok_or("a point without two numbers")?;
    Ok([plan.0, plan.1, number(2).unwrap_or(f64::NAN)])
}

fn polygon(rings: &[Value]) -> Result<Polygon, String> {
    let mut rings = rings.iter().map(ring);
    let exterior = wound(rings.next().ok_or("a polygon without rings")??, true);
    let holes = rings.map(|ring| Ok(wound(ring?, false))).collect::<Result<_, String>>()?;
    Ok(Polygon { exterior, holes })
}

/// The points of a ring without the repetition of the first.
fn ring(value: &Value) -> Result<Vec<[f64; 2]>, String> {
    let points = value.as_array().ok_or("a ring that is no list")?.iter().map(|point| {
        let number = |place: usize| point.get(place).and_then(Value::as_f64);
        number(0).zip(number(1)).map(|(x, y)| [x, y]).ok_or_else(|| format!("`{point}` is no point"))
    });
    let mut points = points.collect::<Result<Vec<_>, String>>()?;
    let last = points.pop();
    if points.len() < 3 || last != points.first().copied() {
        return Err("a ring that is not closed or has fewer than three points".to_owned());
    }
    Ok(points)
}

/// The ring turned so that it is counter-clockwise, or clockwise.
fn wound(mut ring: Vec<[f64; 2]>, counter_clockwise: bool) -> Vec<[f64; 2]> {
    let origin = ring.first().copied().unwrap_or_default();
    let local = |p: &[f64; 2]| [p[0] - origin[0], p[1] - origin[1]];
    let pairs = ring.iter().zip(ring.iter().cycle().skip(1)).map(|(a, b)| (local(a), local(b)));
    let area = pairs.fold(0.0, |sum, (a, b)| sum + a[0] * b[1] - b[0] * a[1]);
    if (area < 0.0) == counter_clockwise {
        ring.reverse();
    }
    ring
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rings_are_wound_as_the_standard_wants() {
        let clockwise = vec![[5e5, 5e6], [5e5, 5e6 + 1.0], [5e5 + 1.0, 5e6 + 1.0]];
        let turned = wound(clockwise.clone(), true);
        assert!((turned[0][0] - clockwise[2][0]).abs() < 1e-9);
        assert_eq!(wound(turned.clone(), true).len(), 3);
        assert!((wound(turned, false)[0][0] - clockwise[0][0]).abs() < 1e-9);
    }

    #[test]
    fn features_that_share_no_property_are_refused_before_they_fill_the_memory() {
        let feature = |number: usize| format!(r#"{{"properties": {{"p{number}": 1}}}}"#);
        let made = |count: usize| {
            let features: Vec<String> = (0..count).map(feature).collect();
            read(format!(r#"{{"features": [{}]}}"#, features.join(",")).as_bytes())
        };
        let message = made(20_000).err().unwrap().0;
        assert!(message.contains("have 20000 names, 16384 is the most"), "{message}");
        let message = made(4000).err().unwrap().0;
        assert!(message.contains("4000 features have 4000 properties by name, but only 4000 values"), "{message}");
        assert_eq!(made(1000).unwrap().inventory.columns.len(), 1000);
    }

    #[test]
    fn files_of_other_formats_are_named() {
        for (bytes, name) in [(&b"SQLite format 3\0"[..], "a GeoPackage"), (b"<?xml version=\"1.0\"?><kml>", "KML")] {
            let message = read(bytes).err().unwrap().0;
            assert!(message.contains(name) && message.contains("ogr2ogr -f GeoJSON"), "{message}");
        }
    }

    #[test]
    fn an_open_ring_is_refused() {
        let text =
            r#"{"features": [{"geometry": {"type": "Polygon", "coordinates": [[[0, 0], [1, 0], [1, 1], [0, 1]]]}}]}"#;
        assert!(
            read(text.as_bytes()).err().unwrap().0.contains("feature 0 (counted from 0): a ring that is not closed")
        );
    }

    #[test]
    fn names_of_systems_in_several_forms_are_read() {
        for name in ["EPSG:25832", "urn:ogc:def:crs:EPSG::25832", "http://www.opengis.net/def/crs/EPSG/0/25832"] {
            assert_eq!(named(name), Stated::from_epsg(25832, None).unwrap(), "{name}");
        }
        let compound = named("urn:ogc:def:crs,crs:EPSG::25832,crs:EPSG::7837");
        assert_eq!(compound, Stated::from_epsg(25832, Some(7837)).unwrap());
        assert_eq!(named("urn:ogc:def:crs,crs:EPSG::25832,crs:EPSG::1"), Stated::from_epsg(25832, None).unwrap());
        assert_eq!(named("urn:ogc:def:crs,crs:EPSG::1,crs:EPSG::7837").kind, Kind::Unknown);
    }
}
