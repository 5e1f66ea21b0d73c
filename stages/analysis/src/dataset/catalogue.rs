//! A STAC catalogue (version 1.1.0) of a data set: a root and an item for each tile.
//!
//! Tiles in the world frame of a known system have their place on the Earth and its code. Those in the wall frame, which stands
//! upright, have a null geometry, and the projection extension holds the local system.

use serde_json::{Map, Value, json};

use rockface_core::artefact::{Frame, Grid};
use rockface_core::crs::wkt::Node;
use rockface_core::crs::{Crs, Scale};

use super::checksums;

/// What an item tells of a tile.
pub struct Item<'a> {
    /// Its name, unique in the catalogue.
    pub id: &'a str,
    /// The grid of the tile.
    pub grid: Grid,
    /// The frame of its grid.
    pub frame: Frame,
    /// Name of the file of the root.
    pub root: &'a str,
    /// Date and time it stands for, RFC 3339.
    pub datetime: &'a str,
    /// Properties besides time and projection, which are added.
    pub properties: Map<String, Value>,
    /// Its files: role, place in the data set, media type, content.
    pub assets: Vec<(&'a str, &'a str, &'a str, &'a [u8])>,
}

/// The root, in a file of this name, which lists the items.
pub fn root(name: &str, id: &str, title: &str, description: &str, items: &[String]) -> Vec<u8> {
    let link =
        |id: &String| json!({"rel": "item", "href": format!("./items/{id}.json"), "type": "application/geo+json"});
    let mut links = vec![json!({"rel": "root", "href": format!("./{name}"), "type": "application/json"})];
    links.extend(items.iter().map(link));
    pretty(&json!({
        "type": "Catalog", "stac_version": "1.1.0", "id": id, "title": title, "description": description, "links": links,
    }))
}

/// The JSON of the item of one tile.
pub fn item(item: &Item) -> Vec<u8> {
    let Grid { columns, rows, cell_m, left_m, top_m } = item.grid;
    let [_, right_m, bottom_m, _] = item.grid.extent_m();
    let bounds = [left_m, bottom_m, right_m, top_m];
    let mut properties = item.properties.clone();
    let crs = item.frame.crs();
    let code = crs.and_then(Crs::epsg);
    let wkt = match (crs, code) {
        (Some(_), Some(_)) => None,
        (Some(crs), None) => Some(crs.horizontal().wkt()),
        (None, _) => Some(engineering_crs(item.frame)),
    };
    let more = json!({
        "datetime": item.datetime, "proj:code": code.map(|code| format!("EPSG:{code}")), "proj:wkt2": wkt, "proj:bbox": bounds,
        "proj:shape": [rows, columns], "proj:transform": [cell_m, 0.0, left_m, 0.0, -cell_m, top_m],
    });
    properties.extend(more.as_object().cloned().unwrap_or_default());
    if let Some(georeference) = item.frame.georeference().filter(|_| crs.is_none()) {
        properties.insert("rockface:georeference".into(), json!(georeference));
    }
    let asset = |(role, place, media, bytes): &(&str, &str, &str, &[u8])| {
        // A multihash: 0x12 for SHA-256, 0x20 for its 32 bytes.
        let checksum = format!("1220{}", checksums::sum(bytes));
        let value = json!({
            "href": format!("../../{place}"), "type": media, "roles": [if *role == "npz" { "data" } else { *role }],
            "file:size": bytes.len(), "file:checksum": checksum,
        });
        ((*role).to_owned(), value)
    };
    let assets: Map<String, Value> = item.assets.iter().map(asset).collect();
    let root = format!("../{}", item.root);
    let mut made = json!({
        "type": "Feature", "stac_version": "1.1.0", "id": item.id, "geometry": null, "properties": properties, "assets": assets,
        "stac_extensions": [
            "https://stac-extensions.github.io/projection/v2.0.0/schema.json",
            "https://stac-extensions.github.io/file/v2.1.0/schema.json",
        ],
        "links": [
            {"rel": "root", "href": root, "type": "application/json"},
            {"rel": "parent", "href": root, "type": "application/json"},
        ],
    });
    if let Some(ring) = crs.and_then(|crs| on_earth(crs, bounds)) {
        let fold = |axis: usize, pick: fn(f64, f64) -> f64| ring.iter().map(|place| place[axis]).reduce(pick);
        made["bbox"] = json!([fold(0, f64::min), fold(1, f64::min), fold(0, f64::max), fold(1, f64::max)]);
        made["geometry"] = json!({"type": "Polygon", "coordinates": [ring]});
    }
    pretty(&made)
}

/// Longitudes and latitudes around a rectangle of map coordinates, degrees, of the datum of the system; `None` for a projection whose
/// formulas are not known here.
fn on_earth(crs: &Crs, [left, bottom, right, top]: [f64; 4]) -> Option<Vec<[f64; 2]>> {
    let plane = Node::parse(&crs.horizontal().wkt()).ok()?;
    let corners = [[left, bottom], [right, bottom], [right, top], [left, top], [left, bottom]];
    // A tenth of a millimetre.
    let rounded = |degrees: f64| (degrees * 1e9).round() / 1e9;
    corners.iter().map(|corner| Scale::at(&plane, *corner).map(|scale| scale.place_deg.map(rounded))).collect()
}

/// The local system in WKT2 (ISO 19162), so that readers take coordinates for metres and for nothing on the Earth.
fn engineering_crs(frame: Frame) -> String {
    format!(
        "ENGCRS[\"rockface {frame} frame\",EDATUM[\"{frame} frame\"],CS[Cartesian,2],AXIS[\"(X)\",unspecified,ORDER[1]],\
         AXIS[\"(Y)\",unspecified,ORDER[2]],LENGTHUNIT[\"metre\",1]]"
    )
}

fn pretty(value: &Value) -> Vec<u8> {
    let mut text = format!("{value:#}").into_bytes();
    text.push(b'\n');
    text
}

/// The date `days` after 1970-01-01 at midnight, RFC 3339 (Gregorian calendar, Hinnant's algorithm).
pub fn date(days: i64) -> String {
    let shifted = days + 719_468;
    let era = shifted.div_euclid(146_097);
    let of_era = shifted.rem_euclid(146_097);
    let year_of_era = (of_era - of_era / 1460 + of_era / 36_524 - of_era / 146_096) / 365;
    let of_year = of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let month = (5 * of_year + 2) / 153;
    let day = of_year - (153 * month + 2) / 5 + 1;
    let month = if month < 10 { month + 3 } else { month - 9 };
    let year = year_of_era + era * 400 + i64::from(month <= 2);
    format!("{year:04}-{month:02}-{day:02}T00:00:00Z")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn days_become_dates() {
        let cases = [
            (0, "1970-01-01"),
            (19_782, "2024-02-29"),
            (20_454, "2026-01-01"),
            (-1, "1969-12-31"),
            (11_016, "2000-02-29"),
        ];
        for (days, expected) in cases {
            assert_eq!(date(days), format!("{expected}T00:00:00Z"));
        }
    }

    #[test]
    fn an_item_has_no_place_on_earth_and_knows_its_own() {
        let grid = Grid { columns: 4, rows: 2, cell_m: 0.5, left_m: 1.0, top_m: 3.0 };
        let made = item(&Item {
            id: "a",
            grid,
            frame: Frame::Wall,
            root: "catalog.json",
            datetime: "2026-01-01T00:00:00Z",
            properties: Map::new(),
            assets: vec![("npz", "tiles/a.npz", "application/x-npz", b"abc")],
        });
        let made: Value = serde_json::from_slice(&made).unwrap();
        assert!(made["geometry"].is_null() && made.get("bbox").is_none());
        assert_eq!(made["properties"]["proj:bbox"], json!([1.0, 2.0, 3.0, 3.0]));
        assert!(made["assets"]["npz"]["file:checksum"].as_str().unwrap().starts_with("1220ba7816bf"));
        let root: Value = serde_json::from_slice(&root("catalog.json", "i", "t", "d", &["a".to_owned()])).unwrap();
        assert_eq!(root["links"][1]["href"], "./items/a.json");
    }

    #[test]
    fn an_item_in_a_known_system_has_its_code_and_its_place_on_the_earth() {
        use rockface_core::artefact::Georeference;

        let frame = Frame::World.at(Some(Georeference::world("EPSG:28356".parse().unwrap())));
        let grid = Grid { columns: 100, rows: 100, cell_m: 1.0, left_m: 500_000.0, top_m: 6_250_100.0 };
        let made = item(&Item {
            id: "a",
            grid,
            frame,
            root: "catalog.json",
            datetime: "2026-01-01T00:00:00Z",
            properties: Map::new(),
            assets: Vec::new(),
        });
        let made: Value = serde_json::from_slice(&made).unwrap();
        assert_eq!(made["properties"]["proj:code"], "EPSG:28356");
        assert!(made["properties"]["proj:wkt2"].is_null());
        // The left edge is on the central meridian.
        let first = &made["geometry"]["coordinates"][0][0];
        let (longitude, latitude) = (first[0].as_f64().unwrap(), first[1].as_f64().unwrap());
        assert!((longitude - 153.0).abs() < 1e-7 && (latitude + 33.890_365).abs() < 1e-5, "{first}");
        assert_eq!(made["bbox"][0], first[0]);
    }
}
