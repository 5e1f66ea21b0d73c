//! Points, triangles, grids and transforms for a three-dimensional view.

use ::foxglove::messages as proto;
use rockface_core::artefact::Transform;

use super::super::step_log::sketch::{BodiesSketch, Body, CloudSketch, GridSketch};
use super::super::topic::Made;
use super::{Message, Place, at, float_fields, message};

/// Colours of bodies in turn, which colour-blind readers can distinguish (Okabe and Ito); red, green, blue from 0 to 1.
const COLOURS: [[f64; 3]; 6] = [
    [0.90, 0.62, 0.0],
    [0.34, 0.71, 0.91],
    [0.0, 0.62, 0.45],
    [0.94, 0.89, 0.26],
    [0.84, 0.37, 0.0],
    [0.80, 0.47, 0.65],
];
/// Colour of a body without a name: rock.
const ROCK: [f64; 3] = [0.72, 0.70, 0.67];

/// A cloud of points as `foxglove.PointCloud`, 32-bit floats relative to its pose.
pub fn cloud(place: &Place, topic: String, cloud: &CloudSketch) -> Message {
    let value = proto::PointCloud {
        timestamp: Some(place.time()),
        frame_id: cloud.frame.clone(),
        pose: Some(at(cloud.origin_m)),
        point_stride: 12,
        fields: float_fields(["x", "y", "z"].into_iter()),
        data: cloud.points.as_flattened().iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>().into(),
    };
    message("foxglove.PointCloud", topic, &value)
}

/// Meshes. They take the place of those the topic showed before.
pub fn bodies(place: &Place, topic: &str, bodies: &BodiesSketch, reduced: &str, made: Option<&Made>) -> Message {
    let clear = proto::SceneEntityDeletion {
        timestamp: Some(place.time()),
        r#type: proto::scene_entity_deletion::Type::All as i32,
        id: String::new(),
    };
    let entity = |(number, body): (usize, &Body)| entity(place, topic, bodies, body, number, reduced, made);
    let entities = bodies.bodies.iter().enumerate().map(entity).collect();
    message("foxglove.SceneUpdate", topic.to_owned(), &proto::SceneUpdate { deletions: vec![clear], entities })
}

fn entity(
    place: &Place,
    topic: &str,
    bodies: &BodiesSketch,
    body: &Body,
    number: usize,
    reduced: &str,
    made: Option<&Made>,
) -> proto::SceneEntity {
    let path = made.and_then(|made| made.path.clone());
    let told = [
        ("name", Some(body.name.clone())),
        ("class", Some(body.class.clone())),
        ("reduced", Some(reduced.to_owned())),
        ("blake3", made.map(|made| made.digest.clone())),
        ("file", path),
    ];
    let told = told.into_iter().filter_map(|(key, value)| {
        let value = value.filter(|value| !value.is_empty())?;
        Some(proto::KeyValuePair { key: key.to_owned(), value })
    });
    let [r, g, b] = if body.name.is_empty() { ROCK } else { COLOURS[number % COLOURS.len()] };
    let point = |[x, y, z]: &[f32; 3]| proto::Point3 { x: f64::from(*x), y: f64::from(*y), z: f64::from(*z) };
    let triangles = proto::TriangleListPrimitive {
        pose: Some(at(bodies.origin_m)),
        points: body.vertices.iter().map(point).collect(),
        color: Some(proto::Color { r, g, b, a: 1.0 }),
        colors: Vec::new(),
        indices: body.triangles.as_flattened().to_vec(),
    };
    proto::SceneEntity {
        timestamp: Some(place.time()),
        frame_id: bodies.frame.clone(),
        id: format!("{topic}/{number}"),
        frame_locked: true,
        metadata: told.collect(),
        triangles: vec![triangles],
        ..proto::SceneEntity::default()
    }
}

/// A grid in the plane z = 0 of its frame; its rows go upward, ours come from the top.
pub fn grid(place: &Place, topic: String, grid: &GridSketch) -> Message {
    let bottom_m = grid.top_m - grid.rows as f64 * grid.cell_m;
    let stride = 4 * grid.bands.len();
    let cells = (0..grid.rows).rev().flat_map(|row| (0..grid.columns).map(move |column| row * grid.columns + column));
    let bytes = cells.flat_map(|cell| grid.bands.iter().flat_map(move |band| band.values[cell].to_le_bytes()));
    let value = proto::Grid {
        timestamp: Some(place.time()),
        frame_id: grid.frame.clone(),
        pose: Some(at([grid.left_m, bottom_m, 0.0])),
        column_count: grid.columns as u32,
        cell_size: Some(proto::Vector2 { x: grid.cell_m, y: grid.cell_m }),
        row_stride: (stride * grid.columns) as u32,
        cell_stride: stride as u32,
        fields: float_fields(grid.bands.iter().map(|band| band.name.as_str())),
        data: bytes.collect::<Vec<u8>>().into(),
    };
    message("foxglove.Grid", topic, &value)
}

/// The pose of the frame that a transform takes points from, in the frame that it takes them to. Only world and wall are the same in all
/// steps; other frames are named after theirs.
pub fn transform(place: &Place, port: &str, topic: String, transform: &Transform) -> Vec<Message> {
    let frame = |name: &str| match name {
        "world" | "wall" => name.to_owned(),
        other => format!("{}.{port}/{other}", place.step),
    };
    let [w, i, j, k] = transform.quaternion();
    let turned = |row: &[f64; 3]| row.iter().zip(transform.origin).map(|(r, o)| r * o).sum::<f64>();
    let [x, y, z] = [0, 1, 2].map(|i| transform.translation[i] - turned(&transform.rotation[i]));
    let value = proto::FrameTransform {
        timestamp: Some(place.time()),
        parent_frame_id: frame(&transform.to),
        child_frame_id: frame(&transform.from),
        translation: Some(proto::Vector3 { x, y, z }),
        rotation: Some(proto::Quaternion { x: i, y: j, z: k, w }),
    };
    vec![message("foxglove.FrameTransforms", topic, &proto::FrameTransforms { transforms: vec![value] })]
}
