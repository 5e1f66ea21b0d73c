//! What there is to say of an artefact or a log: sizes, ranges, missing values.

use rockface_core::artefact::{Artefact, Cameras, Cloud, Frame, Image, Mesh, Raster, Table, Transform};
use rockface_raster::mesh_check;
use rockface_rock::face::inspection::{Found, Inspection};
#[cfg(test)]
use serde_json::Map;
use serde_json::{Value, json};

use super::Facts;

/// What an MCAP file holds.
pub fn of_log(bytes: &[u8]) -> Facts {
    let mut facts: Facts = vec![("kind".into(), "MCAP log".into())];
    let Some(summary) = mcap::Summary::read(bytes).ok().flatten() else { return facts };
    let counts = summary.stats.as_ref().map(|stats| stats.channel_message_counts.clone()).unwrap_or_default();
    if let Some(stats) = &summary.stats {
        facts.push(("messages".into(), stats.message_count.into()));
        facts.push(("attachments".into(), stats.attachment_count.into()));
        facts.push(("seconds".into(), (stats.message_end_time / 1_000_000_000).into()));
    }
    let mut topics: Vec<String> = summary
        .channels
        .values()
        .map(|channel| {
            let schema = channel.schema.as_ref().map_or("no schema", |schema| schema.name.as_str());
            format!("{} ({schema}, {})", channel.topic, counts.get(&channel.id).copied().unwrap_or(0))
        })
        .collect();
    topics.sort();
    facts.push(("topics (schema, messages)".into(), json!(topics)));
    facts
}

/// What an artefact holds.
pub fn of_artefact(artefact: &Artefact) -> Facts {
    let mut facts: Facts = vec![("kind".into(), artefact.kind().word().into())];
    match artefact {
        Artefact::Mesh(mesh) => facts.extend(of_mesh(mesh)),
        Artefact::Cloud(cloud) => facts.extend(of_cloud(cloud)),
        Artefact::Surface(surface) => {
            facts.push(("frame".into(), surface.frame.to_string().into()));
            facts.push(("size".into(), format!("{} x {}", surface.width, surface.height).into()));
            for axis in 0..3 {
                let values = surface.points.iter().map(|point| f64::from(point[axis]));
                facts.push((format!("{} from origin (m)", ["x", "y", "z"][axis]), range(values)));
            }
        }
        Artefact::Raster(raster) => facts.extend(of_raster(raster)),
        Artefact::Depth(depth) => {
            facts.push(("image".into(), depth.image.name.clone().into()));
            facts.push(("frame".into(), depth.frame.to_string().into()));
            facts.push(("size (px)".into(), format!("{} x {}", depth.width, depth.height).into()));
            facts.push(("image pixels a pixel".into(), depth.downscale.into()));
            facts.push(("centre (m)".into(), json!(depth.image.centre_m)));
            facts.push(("camera from object (w, x, y, z)".into(), json!(depth.image.camera_from_object)));
            facts.push(("sensor".into(), json!(depth.sensor)));
            facts.push(("z (m)".into(), range(depth.z.iter().copied().map(f64::from))));
            let channels = depth.channels.iter();
            facts.extend(channels.map(|(name, values)| (name.clone(), range(values.iter().copied().map(f64::from)))));
        }
        Artefact::Table(table) => facts.extend(of_table(table)),
        Artefact::Cameras(cameras) => {
            facts.push(("frame".into(), cameras.frame.to_string().into()));
            facts.push(("sensors".into(), cameras.sensors.len().into()));
            facts.push(("images".into(), of_images(cameras)));
        }
        Artefact::Meshes(meshes) => {
            facts.push(("frame".into(), meshes.frame.to_string().into()));
            facts
                .push(("triangles".into(), meshes.parts.iter().map(|part| part.triangles.len()).sum::<usize>().into()));
        }
        Artefact::Noise(noise) => {
            let bad = noise.members.iter().filter(|member| member.bad).count();
            facts.push(("frame".into(), noise.frame.to_string().into()));
            facts.push(("size".into(), format!("{} x {}", noise.grid.columns, noise.grid.rows).into()));
            facts.push(("acquisitions".into(), noise.members.len().into()));
            facts.push(("bad ones".into(), bad.into()));
            facts.push(("whitened fields".into(), noise.fields.len().into()));
            facts.push(("strength (px)".into(), range(noise.strength.iter().copied().map(f64::from))));
        }
        Artefact::Transform(transform) => {
            facts.push(("from".into(), transform.from.clone().into()));
            facts.push(("to".into(), transform.to.clone().into()));
        }
        _ => {}
    }
    if let Artefact::Inventory(inventory) = artefact {
        facts.push(("frame".into(), inventory.frame.to_string().into()));
        facts.push(("outlines".into(), inventory.features.len().into()));
        facts.push(("columns".into(), inventory.columns.len().into()));
    }
    if let Some(georeference) = artefact.frame().and_then(Frame::georeference) {
        facts.extend(georeference.crs.as_ref().map(|crs| ("crs of the world".into(), json!(crs))));
        facts.extend(georeference.wall_from_world.as_ref().map(|way| ("to the map (PROJ)".into(), to_map(way).into())));
    }
    if let Some(items) = artefact.items() {
        facts.push(("items".into(), items.len().into()));
    }
    facts
}

/// Name, sensor and projection centre of each image.
fn of_images(cameras: &Cameras) -> Value {
    let told = |image: &Image| {
        let sensor = cameras.sensors.get(image.sensor).map(|sensor| sensor.name.as_str());
        json!({"name": image.name, "sensor": sensor, "centre_m": image.centre_m})
    };
    cameras.images.iter().map(told).collect()
}

/// The way from the wall to the world as an operation of PROJ, which `ogr2ogr -ct` and `cct` take: `world = R^T (wall - translation) + origin`.
fn to_map(wall_from_world: &Transform) -> String {
    let Transform { rotation, origin, translation, .. } = wall_from_world;
    let turned = |axis: usize| (0..3).map(|i| rotation[i][axis] * translation[i]).sum::<f64>();
    let offsets = (0..3).map(|axis| format!("+{}off={}", ["x", "y", "z"][axis], origin[axis] - turned(axis)));
    let matrix = (0..9).map(|k| format!("+s{}{}={}", k / 3 + 1, k % 3 + 1, rotation[k % 3][k / 3]));
    let words: Vec<String> = std::iter::once("+proj=affine".to_owned()).chain(offsets).chain(matrix).collect();
    words.join(" ")
}

fn of_mesh(mesh: &Mesh) -> Facts {
    let mut facts: Facts = vec![
        ("frame".into(), mesh.frame.to_string().into()),
        ("vertices".into(), mesh.vertices.len().into()),
        ("triangles".into(), mesh.triangles.len().into()),
        ("coloured".into(), (!mesh.colours.is_empty()).into()),
    ];
    for axis in 0..3 {
        facts.push((format!("{} (m)", ["x", "y", "z"][axis]), range(mesh.vertices.iter().map(|vertex| vertex[axis]))));
    }
    facts.extend(soundness(mesh));
    facts
}

/// What is wrong with a mesh, and its pieces and holes: what `import-mesh` looks at.
fn soundness(mesh: &Mesh) -> Facts {
    let bad_corners = mesh.vertices.iter().flatten().any(|value| !value.is_finite());
    let flat = mesh_check::degenerate_triangles(mesh);
    let mut facts: Facts = vec![("triangles without area".into(), flat.into())];
    if bad_corners {
        facts.push(("fault".into(), "vertices that are not finite".into()));
        return facts;
    }
    let distinct = |[a, b, c]: &[u32; 3]| a != b && b != c && c != a;
    let mut mesh = mesh.clone();
    mesh.triangles.retain(distinct);
    let found = Inspection::of(&mesh);
    let place = |fault: Found| match fault.place {
        Some([x, y, z]) => format!("{}, the first at ({x:.3}, {y:.3}, {z:.3}) m", fault.count).into(),
        None => Value::from(0),
    };
    facts.extend([
        ("edges of three or more triangles".into(), place(found.crowded_edges)),
        ("edges of opposed triangles".into(), place(found.opposed_edges)),
        ("vertices where pieces meet".into(), place(found.pinched_vertices)),
        ("pieces".into(), found.pieces.len().into()),
        ("border edges".into(), found.border_edges.into()),
    ]);
    if found.crowded_edges.count + found.opposed_edges.count == 0 {
        facts.push(("holes".into(), found.holes.len().into()));
    }
    facts
}

fn of_cloud(cloud: &Cloud) -> Facts {
    let mut facts: Facts = vec![
        ("frame".into(), cloud.frame.to_string().into()),
        ("points".into(), cloud.points.len().into()),
        ("normals".into(), (!cloud.normals.is_empty()).into()),
        ("coloured".into(), (!cloud.colours.is_empty()).into()),
    ];
    for axis in 0..3 {
        facts.push((format!("{} (m)", ["x", "y", "z"][axis]), range(cloud.points.iter().map(|point| point[axis]))));
    }
    let numbers = cloud.numbers.iter();
    facts.extend(numbers.map(|(name, values)| (name.clone(), range(values.iter().copied().map(f64::from)))));
    let values = cloud.values.iter();
    facts.extend(values.map(|(name, values)| (name.clone(), range(values.iter().copied().map(f64::from)))));
    facts
}

fn of_raster(raster: &Raster) -> Facts {
    let grid = &raster.grid;
    let mut facts: Facts = vec![
        ("quantity".into(), raster.quantity.clone().into()),
        ("frame".into(), raster.frame.to_string().into()),
        ("size".into(), format!("{} x {}", grid.columns, grid.rows).into()),
        ("cell (m)".into(), grid.cell_m.into()),
        ("left, top (m)".into(), json!([grid.left_m, grid.top_m])),
    ];
    let bands = raster.bands.iter();
    facts.extend(bands.map(|band| (format!("band {}", band.name), range(band.values.iter().copied().map(f64::from)))));
    facts
}

fn of_table(table: &Table) -> Facts {
    let mut facts: Facts =
        vec![("rows".into(), table.rows.len().into()), ("columns".into(), table.columns.len().into())];
    for (column, name) in table.columns.iter().enumerate() {
        let cells = table.rows.iter().filter_map(|row| row.get(column));
        let numbers: Vec<f64> = cells.filter_map(rockface_core::artefact::Cell::number).collect();
        let told = if numbers.len() == table.rows.len() { range(numbers.into_iter()) } else { "text".into() };
        facts.push((format!("column {name}"), told));
    }
    facts
}

/// Least, greatest and number of values, and how many of them are no number.
pub fn range(values: impl Iterator<Item = f64>) -> Value {
    let (mut least, mut greatest, mut count, mut nan) = (f64::INFINITY, f64::NEG_INFINITY, 0_u64, 0_u64);
    for value in values {
        count += 1;
        if value.is_nan() {
            nan += 1;
        } else {
            (least, greatest) = (least.min(value), greatest.max(value));
        }
    }
    if nan == count {
        return json!({"count": count, "nan": nan});
    }
    json!({"min": least, "max": greatest, "count": count, "nan": nan})
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::artefact::Sensor;
    use rockface_core::testing::{image_at, small_sensor};

    #[test]
    fn ranges_leave_out_what_is_no_number() {
        assert_eq!(range([1.0, f64::NAN, -2.0].into_iter()), json!({"min": -2.0, "max": 1.0, "count": 3, "nan": 1}));
        assert_eq!(range([f64::NAN].into_iter()), json!({"count": 1, "nan": 1}));
    }

    #[test]
    fn what_is_wrong_with_a_mesh_is_told() {
        let corners = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]];
        let told = |triangles: Vec<[u32; 3]>| -> Map<String, Value> {
            let mesh = Mesh { frame: Frame::Wall, vertices: corners.to_vec(), triangles, colours: Vec::new() };
            of_mesh(&mesh).into_iter().collect()
        };
        let sound = told(vec![[0, 1, 2], [1, 0, 3]]);
        assert_eq!((&sound["edges of three or more triangles"], &sound["holes"]), (&json!(0), &json!(0)));
        assert_eq!((&sound["pieces"], &sound["border edges"]), (&json!(1), &json!(4)));
        let faulty = told(vec![[0, 1, 2], [1, 0, 3], [0, 1, 4], [2, 2, 1]]);
        let crowded = faulty["edges of three or more triangles"].as_str().unwrap();
        assert!(crowded.starts_with("1, the first at (") && !faulty.contains_key("holes"), "{crowded}");
        assert_eq!(faulty["triangles without area"], 1);
    }

    #[test]
    fn images_of_cameras_are_told_by_name_sensor_and_place() {
        let sensor = Sensor { name: "s".into(), ..small_sensor() };
        let image = |name: &str| image_at(name, [1.0, 2.0, 3.0], [0.0; 3]);
        let cameras = Cameras { frame: Frame::Wall, sensors: vec![sensor], images: vec![image("a"), image("b")] };
        let facts: Map<String, Value> = of_artefact(&Artefact::Cameras(cameras)).into_iter().collect();
        let images = facts["images"].as_array().unwrap();
        assert_eq!(images[1], json!({"name": "b", "sensor": "s", "centre_m": [1.0, 2.0, 3.0]}));
        assert_eq!((images.len(), &facts["items"]), (2, &json!(2)));
    }

    #[test]
    fn an_artefact_is_told_by_its_numbers() {
        let mut table = Table::new(["a", "name"]);
        table.push(vec![2.5.into(), rockface_core::artefact::Cell::Text("x".into())]);
        let facts: Map<String, Value> = of_artefact(&Artefact::Table(table)).into_iter().collect();
        assert_eq!(facts["rows"], 1);
        assert_eq!(facts["column a"]["max"], 2.5);
        assert_eq!(facts["column name"], "text");
    }
}
