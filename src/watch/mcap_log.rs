//! The MCAP log of a run: what every step instance was, made, said and measured, in a fixed order.

use std::collections::BTreeMap;
use std::io::{Seek, Write};

use mcap::records::MessageHeader;
use mcap::{Compression, McapError, WriteOptions};

/// One step instance for the log.
pub struct LoggedStep {
    /// Name of the step.
    pub step: String,
    /// What happened, as JSON: point, stage, key, outputs, entries.
    pub message: String,
    /// The canonical text of its recipe, JSON.
    pub recipe: String,
}

const SCHEMA: &str = r#"{"type": "object", "title": "rockface.Step", "properties": {
"step": {"type": "string"}, "point": {"type": "object"}, "stage": {"type": "string"}, "version": {"type": "integer"},
"key": {"type": "string", "description": "BLAKE3 of the recipe"},
"outputs": {"type": "object", "description": "by port: kind, BLAKE3 digest, bytes, whether kept"},
"entries": {"type": "array", "description": "notes, warnings, headlines and metrics in the order they were made"}}}"#;

/// Writes the log; equal steps give equal bytes, since it holds no clock time: message times count instances, 1 ms each.
pub fn write_log<W: Write + Seek>(
    out: W,
    about: &BTreeMap<String, String>,
    steps: &[LoggedStep],
) -> Result<W, McapError> {
    // Threads of the compressor would make the bytes depend on the machine.
    let options = WriteOptions::new().compression(Some(Compression::Lz4)).profile("").library("rockface");
    let mut writer = options.create(out)?;
    let metadata = mcap::records::Metadata { name: "rockface".into(), metadata: about.clone() };
    writer.write_metadata(&metadata)?;
    let schema = writer.add_schema("rockface.Step", "jsonschema", SCHEMA.as_bytes())?;
    let mut channels: BTreeMap<&str, u16> = BTreeMap::new();
    for (sequence, logged) in steps.iter().enumerate() {
        let channel = if let Some(channel) = channels.get(logged.step.as_str()) {
            *channel
        } else {
            let topic = format!("/{}/step", logged.step);
            let channel = writer.add_channel(schema, &topic, "json", &BTreeMap::new())?;
            channels.insert(&logged.step, channel);
            channel
        };
        let time = (sequence as u64 + 1) * 1_000_000;
        let header =
            MessageHeader { channel_id: channel, sequence: sequence as u32, log_time: time, publish_time: time };
        writer.write_to_known_channel(&header, logged.message.as_bytes())?;
    }
    let recipes: Vec<&str> = steps.iter().map(|step| step.recipe.as_str()).collect();
    let recipes = format!("[{}]", recipes.join(","));
    writer.attach(&mcap::Attachment {
        log_time: 0,
        create_time: 0,
        name: "recipes.json".into(),
        media_type: "application/json".into(),
        data: recipes.into_bytes().into(),
    })?;
    writer.finish()?;
    Ok(writer.into_inner())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_reader_finds_every_message() {
        let logged = |step: &str, n: u32| LoggedStep {
            step: step.into(),
            message: format!("{{\"n\":{n}}}"),
            recipe: "{}".into(),
        };
        let steps = [logged("a", 1), logged("b", 2), logged("a", 3)];
        let bytes = write_log(std::io::Cursor::new(Vec::new()), &BTreeMap::new(), &steps).unwrap().into_inner();
        let read: Vec<_> = mcap::MessageStream::new(&bytes).unwrap().map(Result::unwrap).collect();
        let topics: Vec<&str> = read.iter().map(|m| m.channel.topic.as_str()).collect();
        assert_eq!(topics, ["/a/step", "/b/step", "/a/step"]);
        assert_eq!(&*read[2].data, br#"{"n":3}"#);
        let again = write_log(std::io::Cursor::new(Vec::new()), &BTreeMap::new(), &steps).unwrap().into_inner();
        assert_eq!(bytes, again);
    }
}
