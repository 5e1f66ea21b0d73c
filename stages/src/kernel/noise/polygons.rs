//! Polygons of a GeoJSON file, and the cells of a grid they hold.

use serde_json::Value;

use crate::artefact::Grid;

/// A polygon with its holes.
#[derive(Debug, Clone, PartialEq)]
pub struct Polygon {
    /// Its label, at least 1.
    pub label: u32,
    /// Closed rings of X and Y, metres: the outline and its holes, in any direction.
    pub rings: Vec<Vec<[f64; 2]>>,
}

/// Whole numbers up to this one are exact in a cell.
const LARGEST_LABEL: u64 = 1 << 24;

/// Every polygon of a GeoJSON value, labelled by a property or by the number of its feature.
///
/// # Errors
/// A sentence that names the feature and what is wrong with it.
pub fn read(whole: &Value, label: Option<&str>) -> Result<Vec<Polygon>, String> {
    let features: Vec<&Value> = match (kind(whole)?, whole["features"].as_array()) {
        ("FeatureCollection", Some(features)) => features.iter().collect(),
        ("FeatureCollection", None) => return Err("the collection has no list `features`".to_owned()),
        _ => vec![whole],
    };
    let mut polygons = Vec::new();
    for (number, feature) in features.into_iter().enumerate() {
        let place = |why: String| format!("feature {}: {why}", number + 1);
        let is_feature = kind(feature).map_err(place)? == "Feature";
        let geometry = if is_feature { &feature["geometry"] } else { feature };
        let label = match label {
            None => number as u64 + 1,
            Some(name) => feature["properties"][name].as_u64().ok_or_else(|| {
                place(format!("property `{name}` is {}, no whole number", feature["properties"][name]))
            })?,
        };
        if !(1..=LARGEST_LABEL).contains(&label) {
            return Err(place(format!("label {label} is not between 1 and {LARGEST_LABEL}")));
        }
        for rings in geometry_rings(geometry).map_err(place)? {
            polygons.push(Polygon { label: label as u32, rings });
        }
    }
    Ok(polygons)
}

fn kind(value: &Value) -> Result<&str, String> {
    value["type"].as_str().ok_or_else(|| "it has no `type`: it is no GeoJSON".to_owned())
}

type Rings = Vec<Vec<[f64; 2]>>;

fn geometry_rings(geometry: &Value) -> Result<Vec<Rings>, String> {
    let list = |value: &Value| value.as_array().cloned().ok_or_else(|| format!("expected a list, found {value}"));
    let rings = |value: &Value| list(value)?.iter().map(ring).collect::<Result<Rings, String>>();
    match kind(geometry)? {
        "Polygon" => Ok(vec![rings(&geometry["coordinates"])?]),
        "MultiPolygon" => list(&geometry["coordinates"])?.iter().map(rings).collect(),
        other => Err(format!("a {other} covers no area; polygons and multipolygons do")),
    }
}

fn ring(value: &Value) -> Result<Vec<[f64; 2]>, String> {
    let position = |value: &Value| match (value[0].as_f64(), value[1].as_f64()) {
        (Some(x), Some(y)) => Ok([x, y]),
        _ => Err(format!("{value} is no position")),
    };
    let positions: Vec<[f64; 2]> = value.as_array().into_iter().flatten().map(position).collect::<Result<_, _>>()?;
    if positions.len() < 4 {
        return Err(format!(
            "a ring of {} positions encloses nothing (at least 4, the last as the first)",
            positions.len()
        ));
    }
    Ok(positions)
}

/// The label of the last polygon that holds the centre of each cell; 0 where none does.
pub fn burn(polygons: &[Polygon], grid: &Grid) -> Vec<f32> {
    let mut labels = vec![0.0; grid.cells()];
    for polygon in polygons {
        for (row, line) in labels.chunks_mut(grid.columns.max(1)).enumerate() {
            let y = grid.centre(row, 0).1;
            let mut crossings = crossings(&polygon.rings, y);
            crossings.sort_by(f64::total_cmp);
            for pair in crossings.chunks_exact(2) {
                let column =
                    |x: f64| ((x - grid.left_m) / grid.cell_m - 0.5).ceil().clamp(0.0, grid.columns as f64) as usize;
                line[column(pair[0])..column(pair[1]).max(column(pair[0]))].fill(polygon.label as f32);
            }
        }
    }
    labels
}

/// Where the rings cross a horizontal line; an edge holds its lower end and not its upper one.
fn crossings(rings: &[Vec<[f64; 2]>], y: f64) -> Vec<f64> {
    let edges = rings.iter().flat_map(|ring| ring.iter().zip(ring.iter().cycle().skip(1)));
    let crossed = edges.filter(|(a, b)| (a[1] <= y) != (b[1] <= y));
    crossed.map(|(a, b)| a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0])).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    const GRID: Grid = Grid { columns: 8, rows: 8, cell_m: 0.5, left_m: 0.0, top_m: 4.0 };

    #[test]
    fn holes_stay_open_and_later_features_cover_earlier_ones() {
        let square = |a: f64, b: f64| json!([[a, a], [b, a], [b, b], [a, b], [a, a]]);
        let whole = json!({"type": "FeatureCollection", "features": [
            {"type": "Feature", "properties": {"id": 7}, "geometry": {"type": "Polygon", "coordinates": [square(0.0, 4.0), square(1.0, 3.0)]}},
            {"type": "Feature", "properties": {"id": 9}, "geometry": {"type": "MultiPolygon", "coordinates": [[square(0.0, 0.5)], [square(1.5, 2.0)]]}},
        ]});
        let labels = burn(&read(&whole, Some("id")).unwrap(), &GRID);
        let count = |label: u8| labels.iter().filter(|l| **l as u8 == label).count();
        assert_eq!([0, 7, 9].map(count), [15, 47, 2]);
        assert!(read(&whole, Some("nr")).unwrap_err().contains("feature 1: property `nr`"));
    }

    #[test]
    fn a_triangle_has_half_the_cells_of_its_square() {
        let triangle = json!({"type": "Polygon", "coordinates": [[[0, 0], [4, 0], [0, 4.001], [0, 0]]]});
        let labels = burn(&read(&triangle, None).unwrap(), &GRID);
        assert_eq!(labels.iter().filter(|l| **l > 0.0).count(), 36);
        assert!(
            read(&json!({"type": "Polygon", "coordinates": [[[0, 0], [1, 1]]]}), None)
                .unwrap_err()
                .contains("2 positions")
        );
    }
}
