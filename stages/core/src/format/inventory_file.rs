//! Rockfall inventories as GeoJSON (RFC 7946), a feature a line, written and read to the bit.
//!
//! Geometries are `MultiPolygon`, or `null` without an outline. RFC 7946 has longitudes and latitudes in WGS 84; these are
//! metres in the frame that the foreign member `rockface` names. So that GDAL, QGIS and geopandas do not take them for
//! degrees, the member `crs` of the 2008 specification, which those still read, names a local engineering system in
//! metres. `rockface` also holds the order of the columns.

use serde_json::{Value, json};

use crate::artefact::{Cell, CodecError, Feature, Frame, Inventory, Polygon};
use crate::names::twice;

/// Whole numbers are exact up to here.
const LARGEST_WHOLE: f64 = 9_007_199_254_740_992.0;

/// Writes an inventory; equal values give equal bytes.
///
/// # Errors
/// The feature at fault: another number of values than columns, a number that is not finite, a ring of fewer than three
/// points; or a column that is named twice.
pub fn write(inventory: &Inventory) -> Result<Vec<u8>, CodecError> {
    check(inventory)?;
    let about = json!({"frame": inventory.frame, "units": "metres", "columns": inventory.columns});
    let features: Vec<String> = inventory.features.iter().map(|feature| line(inventory, feature)).collect();
    let features = if features.is_empty() { String::new() } else { format!("\n{}\n", features.join(",\n")) };
    let system = system(inventory.frame);
    let crs = json!({"type": "name", "properties": {"name": system}});
    Ok(format!("{{\"type\":\"FeatureCollection\",\"crs\":{crs},\"rockface\":{about},\"features\":[{features}]}}\n")
        .into_bytes())
}

/// How the member `crs` names the system of a frame: by its EPSG code, its well-known text, or as a local one.
fn system(frame: Frame) -> String {
    match frame.crs() {
        None => format!("LOCAL_CS[\"rockface {frame} frame\",UNIT[\"metre\",1]]"),
        Some(crs) => {
            let plane = crs.horizontal();
            plane.epsg().map_or_else(|| plane.wkt(), |code| format!("urn:ogc:def:crs:EPSG::{code}"))
        }
    }
}

/// Whether a member `crs` has the name that we give to the wall frame, as other programs may write it again.
pub fn names_wall_frame(name: &str) -> bool {
    let ours = system(Frame::Wall);
    ours.split_once(',').is_some_and(|(begins, _)| name.starts_with(begins))
}

fn check(inventory: &Inventory) -> Result<(), CodecError> {
    if let Some(twin) = twice(inventory.columns.iter().collect()) {
        return Err(fault(&format!("two columns are called `{twin}`")));
    }
    for (number, feature) in inventory.features.iter().enumerate() {
        check_feature(inventory, feature).map_err(|e| fault(&format!("feature {number} (counted from 0): {e}")))?;
    }
    Ok(())
}

fn check_feature(inventory: &Inventory, feature: &Feature) -> Result<(), String> {
    let (values, columns) = (feature.values.len(), inventory.columns.len());
    if values != columns {
        return Err(format!("{values} values for {columns} columns"));
    }
    let infinite = |cell: &Cell| cell.number().is_some_and(|number| !number.is_finite());
    if let Some(column) = feature.values.iter().position(infinite) {
        return Err(format!("`{}` is {}, which is not finite", inventory.columns[column], feature.values[column]));
    }
    for ring in feature.outline.iter().flat_map(rings) {
        if ring.len() < 3 || !ring.as_flattened().iter().all(|value| value.is_finite()) {
            return Err(format!("a ring of its outline has fewer than 3 points or one that is not finite: {ring:?}"));
        }
    }
    Ok(())
}

fn rings(polygon: &Polygon) -> impl Iterator<Item = &Vec<[f64; 2]>> {
    std::iter::once(&polygon.exterior).chain(&polygon.holes)
}

fn line(inventory: &Inventory, feature: &Feature) -> String {
    let pair = |(column, cell): (&String, &Cell)| format!("{}:{}", json!(column), value(cell));
    let properties: Vec<String> = inventory.columns.iter().zip(&feature.values).map(pair).collect();
    let geometry = if feature.outline.is_empty() { Value::Null.to_string() } else { geometry(&feature.outline) };
    let properties = properties.join(",");
    format!("{{\"type\":\"Feature\",\"properties\":{{{properties}}},\"geometry\":{geometry}}}")
}

fn geometry(outline: &[Polygon]) -> String {
    let closed = |ring: &Vec<[f64; 2]>| -> Vec<[f64; 2]> { ring.iter().chain(ring.first()).copied().collect() };
    let polygon = |polygon: &Polygon| -> Vec<_> { rings(polygon).map(closed).collect() };
    let coordinates: Vec<Vec<_>> = outline.iter().map(polygon).collect();
    format!("{{\"type\":\"MultiPolygon\",\"coordinates\":{}}}", json!(coordinates))
}

/// A cell as JSON: a whole number is written as one, so that programs make the column one of whole numbers.
pub fn value(cell: &Cell) -> Value {
    match cell {
        Cell::Number(x) if x.fract() == 0.0 && x.abs() < LARGEST_WHOLE && (*x != 0.0 || x.is_sign_positive()) => {
            json!(*x as i64)
        }
        other => json!(other),
    }
}

/// Reads the file that [`write()`] wrote.
///
/// # Errors
/// Text that is no JSON or no inventory, a feature without one of the columns, an outline that is no polygon.
pub fn read(bytes: &[u8]) -> Result<Inventory, CodecError> {
    let file: File =
        serde_json::from_slice(bytes).map_err(|e| fault(&format!("not the GeoJSON expected here: {e}")))?;
    let columns = file.rockface.columns;
    let numbered = file.features.into_iter().enumerate();
    let features = numbered.map(|(number, feature)| {
        read_feature(feature, &columns).map_err(|e| fault(&format!("feature {number} (counted from 0): {e}")))
    });
    let features = features.collect::<Result<_, _>>()?;
    let inventory = Inventory { frame: file.rockface.frame, columns, features };
    check(&inventory)?;
    Ok(inventory)
}

#[derive(serde::Deserialize)]
struct File {
    rockface: About,
    features: Vec<FileFeature>,
}

#[derive(serde::Deserialize)]
struct About {
    frame: Frame,
    columns: Vec<String>,
}

#[derive(serde::Deserialize)]
struct FileFeature {
    properties: std::collections::BTreeMap<String, Cell>,
    geometry: Option<Geometry>,
}

#[derive(serde::Deserialize)]
struct Geometry {
    coordinates: Vec<Vec<Vec<[f64; 2]>>>,
}

fn read_feature(feature: FileFeature, columns: &[String]) -> Result<Feature, String> {
    let mut properties = feature.properties;
    let mut take = |column: &String| properties.remove(column).ok_or_else(|| format!("it has no property `{column}`"));
    let values = columns.iter().map(&mut take).collect::<Result<_, _>>()?;
    let polygons = feature.geometry.map_or_else(Vec::new, |geometry| geometry.coordinates);
    let outline = polygons.into_iter().map(read_polygon).collect::<Result<_, _>>()?;
    Ok(Feature { outline, values })
}

fn read_polygon(rings: Vec<Vec<[f64; 2]>>) -> Result<Polygon, String> {
    let open = |mut ring: Vec<[f64; 2]>| {
        let last = ring.pop();
        if last.is_some() && last == ring.first().copied() { Ok(ring) } else { Err("a ring is not closed".to_owned()) }
    };
    let mut rings = rings.into_iter().map(open);
    let exterior = rings.next().ok_or("a polygon has no ring")??;
    Ok(Polygon { exterior, holes: rings.collect::<Result<_, _>>()? })
}

fn fault(message: &str) -> CodecError {
    CodecError(format!("inventory: {message}"))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn square(left: f64, side: f64) -> Vec<[f64; 2]> {
        vec![[left, 0.0], [left + side, 0.0], [left + side, side], [left, side]]
    }

    fn inventory() -> Inventory {
        let mut hole = square(0.2, 0.1);
        hole.reverse();
        let outline = vec![
            Polygon { exterior: square(0.0, 1.0), holes: vec![hole] },
            Polygon { exterior: square(2.0, 0.1), holes: Vec::new() },
        ];
        let values = vec![7.0.into(), "slab \"\u{e9}\"".into(), 0.1234.into(), true.into()];
        let hidden = vec![8.0.into(), "".into(), f64::NAN.into(), false.into()];
        Inventory {
            frame: Frame::Wall,
            columns: ["id", "class", "removed_m3", "a\"b"].map(String::from).to_vec(),
            features: vec![Feature { outline, values }, Feature { outline: Vec::new(), values: hidden }],
        }
    }

    #[test]
    fn outlines_with_holes_and_every_kind_of_cell_come_back() {
        let inventory = inventory();
        let bytes = write(&inventory).unwrap();
        assert_eq!(read(&bytes).unwrap(), inventory);
        assert_eq!(write(&read(&bytes).unwrap()).unwrap(), bytes);
        let none = Inventory { features: Vec::new(), ..inventory };
        assert_eq!(read(&write(&none).unwrap()).unwrap(), none);
    }

    #[test]
    fn it_is_geojson_with_closed_rings_and_whole_numbers() {
        let file: Value = serde_json::from_slice(&write(&inventory()).unwrap()).unwrap();
        assert_eq!((&file["type"], &file["rockface"]["frame"]), (&json!("FeatureCollection"), &json!("wall")));
        let system = file["crs"]["properties"]["name"].as_str().unwrap();
        assert_eq!(system, "LOCAL_CS[\"rockface wall frame\",UNIT[\"metre\",1]]");
        let feature = &file["features"][0];
        assert_eq!(feature["properties"]["id"].to_string(), "7");
        let ring = feature["geometry"]["coordinates"][0][1].as_array().unwrap();
        assert_eq!((ring.len(), ring.first()), (5, ring.last()));
        assert!(file["features"][1]["geometry"].is_null());
    }

    #[test]
    fn faults_are_refused_by_name() {
        let refused = |change: fn(&mut Inventory)| {
            let mut bad = inventory();
            change(&mut bad);
            write(&bad).unwrap_err().0
        };
        assert!(refused(|i| i.features[1].values[2] = Cell::Number(f64::INFINITY)).contains("feature 1"));
        assert!(refused(|i| i.columns[1] = "id".into()).contains("two columns are called `id`"));
        assert!(refused(|i| drop(i.features[0].values.pop())).contains("3 values for 4 columns"));
        assert!(refused(|i| i.features[0].outline[0].exterior[1][0] = f64::NAN).contains("not finite"));
        let text = String::from_utf8(write(&inventory()).unwrap()).unwrap();
        assert!(read(text.replace("\"removed_m3\":0.1234,", "").as_bytes()).unwrap_err().0.contains("`removed_m3`"));
        assert!(read(text.replace("[0.0,0.0]]", "[0.0,0.5]]").as_bytes()).unwrap_err().0.contains("not closed"));
        assert!(read(&text.as_bytes()[..text.len() / 2]).is_err());
    }

    proptest! {
        #[test]
        fn any_number_and_text_comes_back(number in any::<f64>(), text in any::<String>(), x in any::<f64>()) {
            prop_assume!(number.is_finite() && x.is_finite());
            let outline = vec![Polygon { exterior: vec![[x, 0.0], [1.0, x], [0.0, 1.0]], holes: Vec::new() }];
            let values = vec![Cell::Number(number), Cell::Text(text)];
            let columns = vec!["n".to_owned(), "t".to_owned()];
            let inventory = Inventory { frame: Frame::World, columns, features: vec![Feature { outline, values }] };
            let bytes = write(&inventory).unwrap();
            let back = read(&bytes).unwrap();
            prop_assert_eq!(write(&back).unwrap(), bytes);
            prop_assert_eq!(back, inventory);
        }
    }
}
