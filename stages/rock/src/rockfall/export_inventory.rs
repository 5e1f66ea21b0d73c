//! `export-inventory`: writes an inventory in longitudes and latitudes, as KML for globes or as GeoJSON for web maps.

use rockface_core::artefact::{Cell, Feature, File, Frame, Inventory, Kind, Polygon, Transform};
use rockface_core::crs::{Crs, CrsName, Degrees};
use rockface_core::format::inventory_file;
use rockface_core::params::{Fault, deciding};
use rockface_core::{Context, Inputs, Outputs, Page, Port, Ports, Stage, StageError, choice, fail, params};
use serde_json::{Value, json};

use super::ground_truth::world_from_wall;
use super::inventory_kml::{self, Placemark};
use super::inventory_places::{Place, places};

choice! {
    /// The format of the file.
    pub enum MapFormat {
        /// KML 2.2, for Google Earth, QGIS and other globes and maps.
        Kml = "kml",
        /// GeoJSON as RFC 7946 has it, for web maps, QGIS and geopandas.
        GeoJson = "geojson",
    }
}

choice! {
    /// What KML says of heights.
    pub enum Altitude {
        /// Points are at their heights, as above the sea; on the ground where they have none.
        Absolute = "absolute",
        /// Points are on the ground of the globe.
        Ground = "ground",
    }
}

params! {
    /// Parameters of `export-inventory`.
    pub struct ExportInventoryParams {
        /// The format of the file.
        format: MapFormat = MapFormat::Kml,
        /// Column that names a rockfall; null: `id`, or its number from 1 on where there is no such column.
        name: Option<String> = None,
        /// Whether points of KML are at their heights.
        altitude: Altitude = Altitude::Absolute,
        /// The coordinate reference system of the world, where neither the inventory nor the transform states one: `EPSG:28356`.
        crs: Option<CrsName> = None,
    }
}

/// Writes an inventory in longitudes and latitudes.
pub struct ExportInventory;

const KML: Port = Port {
    extension: Some("kml"),
    ..Port::one(
        "file",
        &[Kind::File],
        "The rockfalls in longitude and latitude (WGS 84): KML, or GeoJSON with `format: geojson`.",
    )
};
const GEOJSON: Port = Port { extension: Some("geojson"), ..KML };

impl Stage for ExportInventory {
    type Params = ExportInventoryParams;
    const NAME: &'static str = "export-inventory";
    const VERSION: u32 = 1;
    const PAGE: Page = Page::new(include_str!("export_inventory.md"));
    const INPUTS: &'static [Port] = &[
        Port::one("inventory", &[Kind::Inventory], "The rockfalls, with places in the world, or in the wall frame."),
        Port::optional(
            "transform",
            &[Kind::Transform],
            "wall_from_world, for centroids that are known in the wall frame only.",
        ),
    ];
    const OUTPUTS: &'static [Port] = &[KML];

    fn ports(with: &Value) -> Result<Ports, Vec<Fault>> {
        const AS_GEOJSON: &[Port] = &[GEOJSON];
        let is_geojson = deciding(with, "format")?.and_then(Value::as_str) == Some("geojson");
        Ok(Ports { inputs: Self::INPUTS, outputs: if is_geojson { AS_GEOJSON } else { Self::OUTPUTS } })
    }

    fn check(params: &Self::Params) -> Vec<Fault> {
        let given = params.crs.as_ref().map(|name| name.0.parse::<Crs>().and_then(|crs| Degrees::of(&crs)));
        given.and_then(Result::err).map(|why| Fault::new(why).below("crs")).into_iter().collect()
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let inventory = inputs.one::<Inventory>("inventory")?;
        let transform = inputs.optional::<Transform>("transform")?;
        let way = transform.map(world_from_wall).transpose()?;
        let crs = system(params, inventory, transform)?;
        let degrees = Degrees::of(&crs).map_err(|why| {
            StageError::new(why).hint(
                "GDAL converts others: `ogr2ogr -t_srs EPSG:4326` of `truth.csv` or `detections.csv`, with `-s_srs`",
            )
        })?;
        let places = places(inventory, way.as_ref())?;
        let naming = naming(params, inventory)?;
        let mut shown = Vec::with_capacity(places.len());
        for (number, (feature, place)) in inventory.features.iter().zip(&places).enumerate() {
            let Some(place) = place else { continue };
            let name = naming.map(|column| feature.values[column].to_string()).filter(|name| !name.is_empty());
            let name = name.unwrap_or_else(|| (number + 1).to_string());
            let shape =
                shape(inventory, feature, *place, &degrees).map_err(|e| e.within(format!("rockfall {name}")))?;
            shown.push((name, feature, shape));
        }
        report(context, inventory, &crs, &degrees, shown.len());
        let bytes = match params.format {
            MapFormat::Kml => kml(inventory, &shown, &crs, params.altitude == Altitude::Absolute)?,
            MapFormat::GeoJson => geojson(inventory, &shown).into_bytes(),
        };
        Ok(Outputs::of("file", File { bytes }))
    }
}

/// A rockfall in degrees: its point with the height in metres, and its outline where that is on the map.
struct Shape {
    point: [f64; 3],
    outline: Vec<Vec<Vec<[f64; 2]>>>,
}

type Shown<'a> = (String, &'a Feature, Shape);

/// The system of the world.
fn system(
    params: &ExportInventoryParams,
    inventory: &Inventory,
    transform: Option<&Transform>,
) -> Result<Crs, StageError> {
    let stated = inventory.frame.world_crs().or_else(|| transform.and_then(|transform| transform.crs.as_ref()));
    let given = params.crs.as_ref().map(|name| name.0.parse::<Crs>()).transpose()?;
    match (stated, given) {
        (Some(stated), Some(given)) if !stated.agrees_with(&given) => {
            let message = format!("the inventory is in {stated}, but `crs` says {given}");
            Err(StageError::new(message).hint("leave `crs` out; nothing is reprojected before"))
        }
        (Some(stated), _) => Ok(stated.clone()),
        (None, Some(given)) => Ok(given),
        (None, None) => {
            let message = "nothing states the coordinate reference system of the world, so no place has a longitude and a latitude";
            let hint = "give `crs: EPSG:...` to the importer of the face, so that all outputs state it, or here";
            Err(StageError::new(message).hint(hint))
        }
    }
}

fn naming(params: &ExportInventoryParams, inventory: &Inventory) -> Result<Option<usize>, StageError> {
    let Some(name) = &params.name else { return Ok(inventory.column("id")) };
    match inventory.column(name) {
        Some(column) => Ok(Some(column)),
        None => {
            fail!("the inventory has no column `{name}` to name rockfalls by; it has {}", inventory.columns.join(", "))
        }
    }
}

fn shape(inventory: &Inventory, feature: &Feature, place: Place, degrees: &Degrees) -> Result<Shape, StageError> {
    let [x, y, z] = place;
    let height_m = if z.is_finite() { z } else { 0.0 };
    let at = |[x, y]: [f64; 2]| {
        let found = degrees.at([x, y, height_m]);
        found.ok_or_else(|| StageError::new(format!("the map does not reach easting {x} m, northing {y} m")))
    };
    let [longitude, latitude] = at([x, y])?;
    let ring =
        |ring: &Vec<[f64; 2]>| ring.iter().chain(ring.first()).map(|point| at(*point)).collect::<Result<Vec<_>, _>>();
    let polygon = |polygon: &Polygon| std::iter::once(&polygon.exterior).chain(&polygon.holes).map(ring).collect();
    let is_on_map = inventory.frame == Frame::World;
    let outline = feature.outline.iter().filter(|_| is_on_map).map(polygon).collect::<Result<_, StageError>>()?;
    Ok(Shape { point: [longitude, latitude, z], outline })
}

fn report(context: &Context, inventory: &Inventory, crs: &Crs, degrees: &Degrees, count: usize) {
    if let Some(datum) = degrees.shifted() {
        context.note(format!(
            "the datum `{datum}` is shifted to WGS 84 by the numbers that go with {crs}, which is accurate to some metres"
        ));
    }
    let without = inventory.features.len() - count;
    if without > 0 {
        let whose = if without == 1 { "1 rockfall".to_owned() } else { format!("{without} rockfalls") };
        context.warn(format!("left out for want of a place in the world: {whose}"));
    }
    context.metric("rockfalls", count as f64, "1");
    let noun = if count == 1 { "rockfall" } else { "rockfalls" };
    context.headline(format!("{count} {noun} from {crs} in longitude and latitude"));
}

fn kml(inventory: &Inventory, shown: &[Shown], crs: &Crs, absolute: bool) -> Result<Vec<u8>, StageError> {
    let placemarks: Vec<Placemark> = shown.iter().map(|one| placemark(inventory, one)).collect();
    let about = format!("From {crs}; lengths in metres.");
    let written = inventory_kml::write("Rockfalls", &about, &placemarks, absolute);
    written.map_err(|error| StageError::new(format!("the KML cannot be written: {error}")))
}

fn placemark<'a>(inventory: &'a Inventory, (name, feature, shape): &'a Shown) -> Placemark<'a> {
    Placemark {
        name: name.clone(),
        data: properties(inventory, feature).map(|(column, cell)| (column.as_str(), cell.to_string())).collect(),
        point: shape.point,
        outline: shape.outline.clone(),
    }
}

/// The columns of a rockfall that have a value.
fn properties<'a>(inventory: &'a Inventory, feature: &'a Feature) -> impl Iterator<Item = (&'a String, &'a Cell)> {
    inventory.columns.iter().zip(&feature.values).filter(|(_, cell)| **cell != Cell::Empty(()))
}

fn geojson(inventory: &Inventory, shown: &[Shown]) -> String {
    let line = |(name, feature, shape): &Shown| {
        // In the order of the columns, which a map of JSON would not keep.
        let values = inventory.columns.iter().zip(&feature.values);
        let values = values.map(|(column, cell)| format!("{}:{}", json!(column), inventory_file::value(cell)));
        let properties = values.collect::<Vec<_>>().join(",");
        let geometry = if shape.outline.is_empty() {
            let [longitude, latitude, _] = shape.point;
            json!({"type": "Point", "coordinates": rounded([longitude, latitude])})
        } else {
            let rings = shape.outline.iter().map(|rings| {
                rings
                    .iter()
                    .map(|ring| ring.iter().map(|place| rounded(*place)).collect::<Vec<_>>())
                    .collect::<Vec<_>>()
            });
            json!({"type": "MultiPolygon", "coordinates": rings.collect::<Vec<_>>()})
        };
        format!(
            "{{\"type\":\"Feature\",\"id\":{},\"properties\":{{{properties}}},\"geometry\":{geometry}}}",
            json!(name)
        )
    };
    let features: Vec<String> = shown.iter().map(line).collect();
    format!("{{\"type\":\"FeatureCollection\",\"features\":[\n{}\n]}}\n", features.join(",\n"))
}

/// To a tenth of a millimetre.
fn rounded(place: [f64; 2]) -> [f64; 2] {
    place.map(|degrees| (degrees * 1e9).round() / 1e9)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::artefact::{Artefact, Georeference};
    use rockface_core::params::ParamType as _;
    use rockface_core::testing::{TestHost, run_stage};

    fn in_utm() -> Frame {
        Frame::World.at(Some(Georeference::world("EPSG:32632".parse().unwrap())))
    }

    fn truth(frame: Frame) -> Inventory {
        let columns = ["id", "class", "centroid_world_x_m", "centroid_world_y_m", "centroid_world_z_m"];
        let ring = vec![[451_236.0, 5_512_346.0], [451_240.0, 5_512_346.0], [451_236.0, 5_512_350.0]];
        let values = |id: f64, place: f64| {
            vec![id.into(), "a <b> & \"c\"\u{1}".into(), place.into(), 5_512_346.8.into(), 233.25.into()]
        };
        let outline = vec![Polygon { exterior: ring, holes: Vec::new() }];
        let features = vec![
            Feature { outline, values: values(7.0, 451_236.4) },
            Feature { outline: Vec::new(), values: values(8.0, f64::NAN) },
        ];
        Inventory { frame, columns: columns.map(ToOwned::to_owned).to_vec(), features }
    }

    fn run(with: &Value, inventory: Inventory) -> Result<(String, TestHost), StageError> {
        let host = TestHost::default();
        let made = run_stage::<ExportInventory>(&host, with, &[("inventory", inventory.into())])?;
        let Some(Artefact::File(file)) = made.into_inner().remove("file") else { panic!("no file") };
        Ok((String::from_utf8(file.bytes).unwrap(), host))
    }

    #[test]
    fn kml_has_a_placemark_for_each_place() {
        let (text, host) = run(&json!({}), truth(in_utm())).unwrap();
        let xml = roxmltree::Document::parse(&text).unwrap();
        let tagged = |name: &'static str| xml.descendants().filter(move |node| node.tag_name().name() == name);
        assert_eq!(tagged("Placemark").count(), 1);
        let placemark = tagged("Placemark").next().unwrap();
        assert_eq!(
            placemark
                .children()
                .find(|node| node.has_tag_name(("http://www.opengis.net/kml/2.2", "name")))
                .unwrap()
                .text(),
            Some("7")
        );
        // As PROJ has it.
        let point = tagged("Point").next().unwrap();
        let told: Vec<&str> =
            point.descendants().filter(roxmltree::Node::is_text).filter_map(|node| node.text()).collect();
        let told = told.concat().split_whitespace().collect::<String>();
        assert!(
            told.starts_with("absolute8.3229209") && told.contains(",49.7616180") && told.ends_with(",233.250"),
            "{told}"
        );
        let class = tagged("Data").find(|node| node.attribute("name") == Some("class")).unwrap();
        let value = class.descendants().find(|node| node.tag_name().name() == "value").unwrap();
        assert_eq!(value.text(), Some("a <b> & \"c\"\u{fffd}"));
        assert_eq!(tagged("Polygon").count(), 1);
        assert!(host.warnings()[0].ends_with("want of a place in the world: 1 rockfall"));
        let (text, _) = run(&json!({"altitude": "ground", "name": "class"}), truth(in_utm())).unwrap();
        assert!(!text.contains("absolute") && text.contains("<name>a &lt;b&gt;"), "{text}");
    }

    #[test]
    fn geojson_is_that_of_rfc_7946() {
        let (text, _) = run(&json!({"format": "geojson"}), truth(in_utm())).unwrap();
        let read: Value = serde_json::from_str(&text).unwrap();
        let feature = &read["features"][0];
        assert_eq!((&feature["id"], &feature["properties"]["id"]), (&json!("7"), &json!(7)));
        let ring = feature["geometry"]["coordinates"][0][0].as_array().unwrap();
        assert_eq!((ring.len(), &ring[0]), (4, &ring[3]));
        assert!(
            (ring[0][0].as_f64().unwrap() - 8.32).abs() < 0.01 && (ring[0][1].as_f64().unwrap() - 49.76).abs() < 0.01
        );
        assert_eq!(read.get("crs"), None);
        // Outlines on the wall are on no map.
        let wall = Frame::Wall.at(Some(Georeference::world("EPSG:32632".parse().unwrap())));
        let (text, _) = run(&json!({"format": "geojson"}), truth(wall)).unwrap();
        let read: Value = serde_json::from_str(&text).unwrap();
        assert_eq!(read["features"][0]["geometry"]["type"], "Point");
        assert_eq!(
            ExportInventory::ports(&json!({"format": "geojson"})).unwrap().outputs[0].extension,
            Some("geojson")
        );
    }

    #[test]
    fn what_has_no_degrees_is_told() {
        let message = |with: Value, frame: Frame| run(&with, truth(frame)).err().unwrap().message;
        assert!(message(json!({}), Frame::World).contains("nothing states the coordinate reference system"));
        assert!(message(json!({"crs": "EPSG:25832"}), in_utm()).contains("but `crs` says EPSG:25832"));
        assert!(run(&json!({"crs": "EPSG:32632"}), truth(Frame::World)).is_ok());
        assert!(message(json!({"name": "number"}), in_utm()).contains("no column `number`"));
        let old = Frame::World.at(Some(Georeference::world("EPSG:26710".parse().unwrap())));
        assert!(message(json!({}), old).contains("shift to WGS 84 is not known"));
        let params = ExportInventoryParams::decode(&json!({"crs": "EPSG:26710"})).unwrap();
        assert!(ExportInventory::check(&params)[0].message.contains("North_American_Datum_1927"));
    }
}
