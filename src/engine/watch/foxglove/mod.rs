//! Messages of the run log in the schemas that Foxglove knows, and JSON ones with a schema of their own for the rest.

mod image;
pub mod layout;
mod scene;
mod words;

use std::borrow::Cow;

use ::foxglove::Encode;
use ::foxglove::messages::{self as proto, Timestamp};

use super::step_log::Shown;
use super::step_log::sketch::Shape;
use super::topic::Made;

pub use words::{log, metrics, step};

/// A message of the log: encoded, with its topic and schema.
pub struct Message {
    /// Where it is shown, such as `/step/port`.
    pub topic: String,
    /// The schema of the topic.
    pub schema: Schema,
    /// The value, encoded as the schema says.
    pub data: Vec<u8>,
}

/// A schema as MCAP keeps it.
#[derive(Clone)]
pub struct Schema {
    /// Its name, such as `foxglove.PointCloud`; readers know a schema by it.
    pub name: &'static str,
    /// `protobuf` or `jsonschema`.
    pub encoding: &'static str,
    /// The schema itself: a Protobuf descriptor set, or the text of a JSON schema.
    pub text: Cow<'static, [u8]>,
}

/// Where a message belongs.
#[derive(Clone, Copy)]
pub struct Place<'a> {
    /// The name of the step.
    pub step: &'a str,
    /// The second of its instance on the timeline.
    pub second: u32,
}

impl Place<'_> {
    fn time(&self) -> Timestamp {
        Timestamp::new(self.second, 0)
    }

    /// The topic of a port or of a part of it.
    fn topic(&self, port: &str, part: &str) -> String {
        let step = self.step;
        if part.is_empty() { format!("/{step}/{port}") } else { format!("/{step}/{port}/{part}") }
    }

    /// The frame of a camera: image names are common to many steps, poses are not.
    fn camera(&self, port: &str, image: &str) -> String {
        format!("{}.{port}/{image}", self.step)
    }
}

/// A message in one of the schemas of Foxglove; `name` is that of the schema.
fn message<T: Encode>(name: &'static str, topic: String, value: &T) -> Message {
    let text = T::get_schema().map_or_else(Cow::default, |schema| schema.data);
    let mut data = Vec::with_capacity(value.encoded_len().unwrap_or(0));
    // Encoding into a vector, which grows, cannot fail.
    let _ = value.encode(&mut data);
    Message { topic, schema: Schema { name, encoding: "protobuf", text }, data }
}

/// The messages of a sketch; `made` is the output it stands for.
pub fn messages(place: &Place, shown: &Shown, made: Option<&Made>) -> Vec<Message> {
    let (port, part) = (shown.port.as_str(), shown.sketch.part.as_str());
    let topic = place.topic(port, part);
    match &shown.sketch.shape {
        Shape::Picture(picture) => vec![image::picture(place, port, topic, picture)],
        Shape::Cloud(cloud) => vec![scene::cloud(place, topic, cloud)],
        Shape::Bodies(bodies) => vec![scene::bodies(place, &topic, bodies, &shown.sketch.reduced, made)],
        Shape::Grid(grid) => vec![scene::grid(place, topic, grid)],
        Shape::Cameras(cameras) => image::cameras(place, port, part, cameras),
        Shape::Transform(transform) => scene::transform(place, port, topic, transform),
        Shape::Table(table) => vec![words::table(topic, table)],
        Shape::Values(value) => vec![words::values(topic, value)],
    }
}

/// A pose without a turn.
fn at([x, y, z]: [f64; 3]) -> proto::Pose {
    let orientation = Some(proto::Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 1.0 });
    proto::Pose { position: Some(proto::Vector3 { x, y, z }), orientation }
}

fn float_fields<'a>(names: impl Iterator<Item = &'a str>) -> Vec<proto::PackedElementField> {
    let kind = proto::packed_element_field::NumericType::Float32 as i32;
    let field = |(i, name): (usize, &str)| proto::PackedElementField {
        name: name.to_owned(),
        offset: 4 * i as u32,
        r#type: kind,
    };
    names.enumerate().map(field).collect()
}
