//! `import-inventory`: reads a rockfall inventory from a GeoJSON file, our own or of another program.

use crate::rockfall::inventory_foreign::{self, Foreign};
use rockface_core::artefact::{Cell, CodecError, Frame, Inventory, Kind, Noun};
use rockface_core::crs::{CrsName, Stated, Tool, settle, wall_without_system};
use rockface_core::params::{Fault, FileRef};
use rockface_core::{Context, Inputs, Outputs, Page, Port, Stage, StageError, choice, params};

choice! {
    /// The frame of the outlines.
    pub enum InventoryFrame {
        /// The one the file names in its member `rockface`, or as its system, otherwise world.
        Automatic = "automatic",
        /// X along the face, Y up it.
        Wall = "wall",
        /// The input's reference system.
        World = "world",
    }
}

params! {
    /// Parameters of `import-inventory`.
    pub struct ImportInventoryParams {
        /// A GeoJSON file: a feature collection of polygons, multipolygons, points or features without geometry.
        path: FileRef,
        /// The frame of the outlines.
        frame: InventoryFrame = InventoryFrame::Automatic,
        /// The coordinate reference system of a file that states none: `EPSG:28356`.
        crs: Option<CrsName> = None,
    }
}

/// Reads a rockfall inventory with the outline and the properties of each rockfall.
pub struct ImportInventory;

impl Stage for ImportInventory {
    type Params = ImportInventoryParams;
    const NAME: &'static str = "import-inventory";
    const VERSION: u32 = 6;
    const PAGE: Page = Page::new(include_str!("import_inventory.md"));
    const INPUTS: &'static [Port] = &[];
    const OUTPUTS: &'static [Port] = &[Port::one("inventory", &[Kind::Inventory], "The rockfalls.")];

    fn check(params: &Self::Params) -> Vec<Fault> {
        let is_wall = params.frame == InventoryFrame::Wall;
        params.crs.as_ref().and_then(|_| wall_without_system(is_wall)).into_iter().collect()
    }

    fn run(params: &Self::Params, _inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let bytes = context.read(&params.path)?;
        let named = |e: CodecError| StageError::new(format!("`{}`: {e}", params.path.0));
        let own = Inventory::decode(&bytes).ok();
        let added = own.as_ref().map_or_else(Vec::new, |own| inventory_foreign::unlisted(&bytes, &own.columns));
        if !added.is_empty() {
            context.note(format!("columns that its member `rockface` does not list: {}", added.join(", ")));
        }
        let (mut read, stated) = if let Some(own) = own.filter(|_| added.is_empty()) {
            let stated = own.frame.crs().map(Stated::of_crs);
            (Foreign { inventory: own, points: Vec::new() }, stated)
        } else {
            let read = inventory_foreign::read(&bytes).map_err(named)?;
            let stated = inventory_foreign::stated(&bytes, &read, params.crs.is_some());
            (read, stated)
        };
        let inventory = &mut read.inventory;
        let is_wall = match params.frame {
            InventoryFrame::Automatic if inventory.frame == Frame::Wall && params.crs.is_some() => {
                return Err(StageError::new(format!(
                    "`{}` itself states the wall frame, parameter `crs` a system of map coordinates",
                    params.path.0
                ))
                .hint("leave `crs` out; or say `frame: world` if its outlines are map coordinates after all"));
            }
            InventoryFrame::Automatic => inventory.frame == Frame::Wall,
            InventoryFrame::Wall => true,
            InventoryFrame::World => false,
        };
        if !is_wall {
            bring_to_metres(&mut read, stated, params, context)?;
        } else if inventory.frame != Frame::Wall {
            inventory.frame = Frame::Wall;
        }
        let inventory = with_points(read).map_err(named)?;
        let (count, columns) = (inventory.features.len(), inventory.columns.len());
        context.headline(format!("{count} rockfalls with {columns} properties, {} frame", inventory.frame));
        Ok(Outputs::of("inventory", inventory))
    }
}

/// Columns of the features that are points: where they are, metres.
const POINT_COLUMNS: [&str; 3] = ["x_m", "y_m", "z_m"];

/// The inventory with the places of the features that are points as columns.
fn with_points(Foreign { mut inventory, points }: Foreign) -> Result<Inventory, CodecError> {
    let are_known = |axis: usize| points.iter().flatten().any(|point| !point[axis].is_nan());
    for axis in (0..3).filter(|axis| are_known(*axis)) {
        let name = POINT_COLUMNS[axis];
        if inventory.columns.iter().any(|column| column == name) {
            return Err(CodecError(format!(
                "it has points, whose places become the column `{name}`, but also a property of that name: rename that"
            )));
        }
        inventory.columns.push(name.to_owned());
        for (feature, point) in inventory.features.iter_mut().zip(&points) {
            let value = point.map(|point| point[axis]).filter(|value| !value.is_nan());
            feature.values.push(value.map_or(Cell::Empty(()), Cell::from));
        }
    }
    Ok(inventory)
}

fn bring_to_metres(
    Foreign { inventory, points }: &mut Foreign,
    stated: Option<Stated>,
    params: &ImportInventoryParams,
    context: &Context,
) -> Result<(), StageError> {
    let mut polygons = inventory.features.iter().flat_map(|feature| &feature.outline);
    let first = polygons.find_map(|polygon| polygon.exterior.first()).map(|[x, y]| [*x, *y, 0.0]);
    let first = first.or_else(|| points.iter().flatten().next().map(|[x, y, _]| [*x, *y, 0.0]));
    let settled = settle(&params.path.0, [stated, None], params.crs.as_ref(), (Tool::Ogr, first), context);
    let settled = settled.map_err(|error| {
        if !error.message.contains(inventory_foreign::UNSTATED) {
            return error;
        }
        let path = &params.path.0;
        let message = format!("`{path}` states no coordinate reference system, and a GeoJSON without one is in degrees (RFC 7946)");
        let metres = "say `frame: wall` if its numbers are metres on the wall, as those of detections are, or `crs: EPSG:...` if they are metres in that system";
        StageError::new(message).hint(error.hint.map_or(metres.to_owned(), |hint| format!("{metres}; else {hint}")))
    })?;
    if !settled.keeps_coordinates() {
        let polygons = inventory.features.iter_mut().flat_map(|feature| &mut feature.outline);
        let rings = polygons.flat_map(|polygon| std::iter::once(&mut polygon.exterior).chain(&mut polygon.holes));
        for point in rings.flatten() {
            let [x, y, _] = settled.point([point[0], point[1], 0.0]);
            *point = [x, y];
        }
        for point in points.iter_mut().flatten() {
            *point = settled.point(*point);
        }
        context.warn("numbers among the properties stay as they are: say in their names which unit they are in");
    }
    inventory.frame = settled.frame();
    Ok(())
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use rockface_core::artefact::{Artefact, Feature, Georeference, Polygon, Transform};
    use rockface_core::testing::{TestHost, run_stage};

    fn imported(text: &str, with: &serde_json::Value) -> Result<Inventory, StageError> {
        let host = TestHost::default().with("a.geojson", &[("a.geojson", text.as_bytes())]);
        let made = run_stage::<ImportInventory>(&host, with, &[])?;
        let Some(Artefact::Inventory(inventory)) = made.into_inner().remove("inventory") else {
            panic!("no inventory")
        };
        Ok(inventory)
    }

    #[test]
    fn a_foreign_file_and_our_own_are_read() {
        let foreign = r#"{"type": "FeatureCollection", "features": [
            {"type": "Feature", "properties": {"v": 2, "b": [1]},
             "geometry": {"type": "Polygon", "coordinates": [[[0, 0, 5], [1, 0, 5], [1, 1, 5], [0, 0, 5]]]}},
            {"type": "Feature", "properties": null, "geometry": null}]}"#;
        let found = imported(foreign, &json!({"path": "a.geojson", "frame": "wall"})).unwrap();
        assert_eq!((found.frame, found.columns.as_slice()), (Frame::Wall, ["b".to_owned(), "v".to_owned()].as_slice()));
        assert_eq!(found.features[0].outline[0].exterior.len(), 3);
        assert_eq!(found.numbers("v").unwrap(), [Some(2.0), None]);
        let own = String::from_utf8(found.encode().unwrap()).unwrap();
        assert_eq!(imported(&own, &json!({"path": "a.geojson"})).unwrap(), found);
    }

    #[test]
    fn a_stated_frame_holds_for_polygons_of_other_programs() {
        let file = |frame: &str, columns: &str, property: &str| {
            format!(
                r#"{{"type": "FeatureCollection", "rockface": {{"frame": {frame}{columns}}}, "features": [
                {{"type": "Feature", "properties": {{"{property}": 0.1, "a": 1}},
                  "geometry": {{"type": "Polygon", "coordinates": [[[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]]]}}}}]}}"#
            )
        };
        let listed = r#", "columns": ["volume_m3"]"#;
        let path = json!({"path": "a.geojson"});
        let found = imported(&file("\"wall\"", listed, "volume_m3"), &path).unwrap();
        // What is not listed stands behind what is.
        assert_eq!((found.frame, found.columns), (Frame::Wall, ["volume_m3", "a"].map(String::from).to_vec()));
        assert_eq!((found.features.len(), found.features[0].outline[0].exterior.len()), (1, 4));
        let unlisted = imported(&file("\"wall\"", "", "volume_m3"), &path).unwrap();
        assert_eq!((unlisted.frame, unlisted.columns.len()), (Frame::Wall, 2));
        let world = imported(&file("\"world\"", "", "volume_m3"), &path).unwrap();
        assert_eq!(world.frame, Frame::World);
        let refused = |text: &str, with: &serde_json::Value| imported(text, with).unwrap_err();
        let lacking = refused(&file("\"wall\"", listed, "volume"), &path).message;
        assert!(lacking.contains("feature 0 (counted from 0) has no property `volume_m3`"), "{lacking}");
        assert!(refused(&file("\"moon\"", "", "v"), &path).message.contains("unknown frame `moon`"));
        let both = json!({"path": "a.geojson", "crs": "EPSG:32633"});
        let error = refused(&file("\"wall\"", listed, "volume_m3"), &both);
        assert!(error.message.contains("states the wall frame") && error.hint.unwrap().contains("frame: world"));
        let overruled = json!({"path": "a.geojson", "crs": "EPSG:32633", "frame": "world"});
        let mapped = imported(&file("\"wall\"", listed, "volume_m3"), &overruled).unwrap();
        assert_eq!(mapped.frame.crs().unwrap().epsg(), Some(32633));
    }

    #[test]
    fn a_property_that_was_added_to_a_file_of_ours_is_a_column_and_the_frame_is_kept() {
        let way = Transform { origin: [385_012.0, 6_355_040.0, 12.0], ..Transform::identity("world", "wall") };
        let frame = Frame::Wall.at(Some(Georeference { crs: None, wall_from_world: Some(way) }));
        let exterior = vec![[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]];
        let outline = vec![Polygon { exterior, holes: Vec::new() }];
        let features = vec![Feature { outline, values: vec![7.0.into(), 0.25.into()] }];
        let found = Inventory { frame, columns: ["id", "volume_m3"].map(String::from).to_vec(), features };
        let own = String::from_utf8(found.encode().unwrap()).unwrap();
        let path = json!({"path": "a.geojson"});
        let marked = own.replace("\"properties\":{\"id\"", "\"properties\":{\"verified\":\"yes\",\"by\":null,\"id\"");
        let read = imported(&marked, &path).unwrap();
        assert_eq!(read.columns, ["id", "volume_m3", "by", "verified"]);
        assert_eq!((read.frame, read.frame.georeference()), (frame, frame.georeference()));
        let values = &read.features[0].values;
        assert_eq!((values[..2].to_vec(), &values[3]), (found.features[0].values.clone(), &Cell::from("yes")));
        assert_eq!(read.features[0].outline, found.features[0].outline);
        // Saved anew by a program that keeps the system but no other member.
        let start = own.find("\"rockface\":").unwrap();
        let end = own.find("\"features\":").unwrap();
        let saved = own[..start].to_owned() + &own[end..];
        let read = imported(&saved, &path).unwrap();
        assert_eq!((read.frame, read.columns), (Frame::Wall, found.columns));
        assert_eq!(imported(&saved, &json!({"path": "a.geojson", "frame": "world"})).unwrap().frame, Frame::World);
    }

    #[test]
    fn points_become_columns_in_metres() {
        let text = r#"{"type": "FeatureCollection", "features": [
            {"properties": {"m3": 2}, "geometry": {"type": "Point", "coordinates": [1000, 2000, 30]}},
            {"properties": {"m3": 3}, "geometry": {"type": "MultiPoint", "coordinates": [[1100, 2100]]}},
            {"properties": {"m3": 4}, "geometry": null}]}"#;
        let found = imported(text, &json!({"path": "a.geojson", "frame": "wall"})).unwrap();
        assert_eq!(found.columns, ["m3", "x_m", "y_m", "z_m"]);
        assert_eq!(found.numbers("x_m").unwrap(), [Some(1000.0), Some(1100.0), None]);
        assert_eq!(found.numbers("z_m").unwrap(), [Some(30.0), None, None]);
        assert!(found.features.iter().all(|feature| feature.outline.is_empty()));
        let feet = imported(text, &json!({"path": "a.geojson", "crs": "EPSG:2229"})).unwrap();
        assert!((feet.numbers("y_m").unwrap()[0].unwrap() - 2000.0 * 1200.0 / 3937.0).abs() < 1e-6);
        let taken = text.replace("m3", "x_m");
        let error = imported(&taken, &json!({"path": "a.geojson", "frame": "wall"})).unwrap_err();
        assert!(error.message.contains("a property of that name"), "{error}");
        let degrees = text.replace("000", "0").replace("100", "9");
        let error = imported(&degrees, &json!({"path": "a.geojson"})).unwrap_err();
        assert!(error.message.contains("states no coordinate reference system"), "{error}");
        assert!(error.hint.unwrap().starts_with("say `frame: wall`"));
    }

    #[test]
    fn what_is_no_inventory_is_refused_with_its_name() {
        let refused = |text: &str| imported(text, &json!({"path": "a.geojson"})).unwrap_err().message;
        assert!(refused("{}").contains("a.geojson"));
        let line = r#"{"features": [{"properties": {}, "geometry": {"type": "LineString", "coordinates": [[1, 2], [3, 4]]}}]}"#;
        assert!(refused(line).contains("feature 0") && refused(line).contains("`LineString`"), "{}", refused(line));
    }
}
