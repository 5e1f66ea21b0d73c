//! The MCAP log of a run: what every step instance was, made, said and measured, and sketches of it, in a fixed order.
//!
//! It holds no clock time: an instance takes one second on its timeline, so that a player goes from step to step, and within
//! a step from point to point (from before a rockfall to after it). Equal runs have equal bytes.

use std::collections::{BTreeMap, HashMap};
use std::io::{Seek, Write};

use mcap::records::MessageHeader;
use mcap::{Compression, McapError, WriteOptions};
use rockface_cache::{Digest, Outputs};
use rockface_core::Point;

use super::foxglove::{self, Message, Place};
use super::step_log::sketch::{ColourKey, Shape};
use super::step_log::{Entry, Shown};
use super::topic::{Made, Topic};

/// What one step instance is, for the log.
pub struct StepNote<'a> {
    /// Name of the step.
    pub step: &'a str,
    /// The item of each of its axes.
    pub point: Point,
    /// Name and point as people write them.
    pub label: String,
    /// Stage, version, key and outputs.
    pub facts: Facts<'a>,
    /// What it made, by port, where that is shown.
    pub made: BTreeMap<String, Made>,
    /// Why it failed, if it did.
    pub failure: Option<&'a str>,
    /// Why there is no sketch of it though one is wanted; empty otherwise.
    pub unshown: String,
    /// The canonical text of its recipe.
    pub recipe: String,
}

/// What a record says of an instance.
#[derive(Clone, serde::Serialize)]
pub struct Facts<'a> {
    /// Name of the stage.
    pub stage: &'a str,
    /// The version of the stage that made the outputs.
    pub version: u32,
    /// The key of its recipe.
    pub key: Option<Digest>,
    /// Its outputs, by port.
    pub outputs: &'a Outputs,
}

/// The log while it is written.
pub struct RunLog<W: Write + Seek> {
    writer: mcap::Writer<W>,
    schemas: BTreeMap<&'static str, u16>,
    /// By topic; a topic that is logged in two schemas has two.
    channels: HashMap<String, Vec<(&'static str, u16)>>,
    topics: Vec<Topic>,
    /// The list of recipes, JSON, without its end.
    recipes: String,
    second: u32,
}

impl<W: Write + Seek> RunLog<W> {
    /// Begins a log that tells `about` of the run.
    pub fn new(out: W, about: &BTreeMap<String, String>) -> Result<Self, McapError> {
        let options = WriteOptions::new().compression(Some(Compression::Lz4)).profile("").library("rockface");
        let mut writer = options.create(out)?;
        let metadata = mcap::records::Metadata { name: "rockface".into(), metadata: about.clone() };
        writer.write_metadata(&metadata)?;
        let (schemas, channels) = (BTreeMap::new(), HashMap::new());
        Ok(Self { writer, schemas, channels, topics: Vec::new(), recipes: String::new(), second: 0 })
    }

    /// Adds an instance: a note on it, then what it said and measured, then what it shows.
    pub fn add(&mut self, note: &StepNote, entries: &[Entry], shown: &[Shown]) -> Result<(), McapError> {
        self.second += 1;
        let place = Place { step: note.step, second: self.second };
        let sketches: Vec<(&Shown, Vec<Message>)> =
            shown.iter().map(|shown| (shown, foxglove::messages(&place, shown, note.made.get(&shown.port)))).collect();
        self.send(&foxglove::step(&place, step_message(note, entries, &sketches)))?;
        self.send_all(&foxglove::log(&place, &note.label, entries, note.failure))?;
        self.send_all(&foxglove::metrics(&place, &note.point, entries))?;
        for (_, messages) in &sketches {
            self.send_all(messages)?;
        }
        self.recipes.push(if self.recipes.is_empty() { '[' } else { ',' });
        self.recipes.push_str(&note.recipe);
        Ok(())
    }

    fn send_all(&mut self, messages: &[Message]) -> Result<(), McapError> {
        messages.iter().try_for_each(|message| self.send(message))
    }

    fn send(&mut self, message: &Message) -> Result<(), McapError> {
        let channel_id = self.channel(message)?;
        let time = u64::from(self.second) * 1_000_000_000;
        let header = MessageHeader { channel_id, sequence: self.second - 1, log_time: time, publish_time: time };
        self.writer.write_to_known_channel(&header, &message.data)
    }

    fn channel(&mut self, message: &Message) -> Result<u16, McapError> {
        let known = self.channels.get(&message.topic).into_iter().flatten();
        if let Some((_, channel)) = known.copied().find(|(schema, _)| *schema == message.schema.name) {
            return Ok(channel);
        }
        let schema = if let Some(schema) = self.schemas.get(message.schema.name) {
            *schema
        } else {
            let (name, encoding) = (message.schema.name, message.schema.encoding);
            let schema = self.writer.add_schema(name, encoding, &message.schema.text)?;
            self.schemas.insert(name, schema);
            schema
        };
        let encoding = if message.schema.encoding == "protobuf" { "protobuf" } else { "json" };
        let channel = self.writer.add_channel(schema, &message.topic, encoding, &BTreeMap::new())?;
        self.topics.push(Topic { name: message.topic.clone(), schema: message.schema.name.to_owned() });
        self.channels.entry(message.topic.clone()).or_default().push((message.schema.name, channel));
        Ok(channel)
    }

    /// Ends the log with attachments (name, media type, content) and the recipe of each instance; gives back the
    /// topics, in the order of their first messages.
    pub fn finish(mut self, attachments: &[(&str, &str, &[u8])]) -> Result<(W, Vec<Topic>), McapError> {
        self.recipes.push_str(if self.recipes.is_empty() { "[]" } else { "]" });
        let recipes = ("recipes.json", "application/json", self.recipes.as_bytes());
        for (name, media_type, data) in attachments.iter().chain([&recipes]) {
            self.writer.attach(&mcap::Attachment {
                log_time: 0,
                create_time: 0,
                name: (*name).into(),
                media_type: (*media_type).into(),
                data: (*data).into(),
            })?;
        }
        self.writer.finish()?;
        Ok((self.writer.into_inner(), self.topics))
    }
}

/// The note on an instance: what it is, what it said, and on which topics it is shown.
#[derive(serde::Serialize)]
struct StepMessage<'a> {
    step: &'a str,
    point: &'a Point,
    #[serde(flatten)]
    facts: &'a Facts<'a>,
    entries: &'a [Entry],
    failure: &'a str,
    shown: Vec<ShownOn<'a>>,
    unshown: &'a str,
}

/// Where and how an output is shown.
#[derive(serde::Serialize)]
struct ShownOn<'a> {
    port: &'a str,
    part: &'a str,
    topics: Vec<&'a str>,
    reduced: &'a str,
    colours: Option<&'a ColourKey>,
    of: Option<&'a Made>,
}

fn step_message(note: &StepNote, entries: &[Entry], sketches: &[(&Shown, Vec<Message>)]) -> Vec<u8> {
    let shown = sketches.iter().map(|(shown, messages)| ShownOn {
        port: &shown.port,
        part: &shown.sketch.part,
        topics: messages.iter().map(|message| message.topic.as_str()).collect(),
        reduced: &shown.sketch.reduced,
        colours: if let Shape::Picture(picture) = &shown.sketch.shape { picture.colours.as_ref() } else { None },
        of: note.made.get(&shown.port),
    });
    let StepNote { step, point, facts, failure, unshown, .. } = note;
    serde_json::to_vec(&StepMessage {
        step,
        point,
        facts,
        entries,
        failure: failure.unwrap_or_default(),
        shown: shown.collect(),
        unshown,
    })
    .unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::watch::step_log::Sketch;
    use crate::watch::step_log::sketch::CloudSketch;
    use serde_json::Value;

    fn note<'a>(step: &'a str, outputs: &'a Outputs) -> StepNote<'a> {
        let made = Made { digest: "ab".into(), path: Some("outputs/a/b.ply".into()) };
        StepNote {
            step,
            point: Point::new(),
            label: step.into(),
            facts: Facts { stage: "make-points", version: 1, key: None, outputs },
            made: BTreeMap::from([("points".to_owned(), made)]),
            failure: None,
            unshown: String::new(),
            recipe: "{}".into(),
        }
    }

    fn written() -> Vec<u8> {
        let mut log = RunLog::new(std::io::Cursor::new(Vec::new()), &BTreeMap::new()).unwrap();
        let cloud = CloudSketch { frame: "wall".into(), origin_m: [1.0; 3], points: vec![[0.5; 3]] };
        let shown = Shown { port: "points".into(), sketch: Sketch::whole("", Shape::Cloud(cloud)) };
        let metric = Entry::Metric { name: "rms".into(), value: 0.1 + 0.2, unit: "m".into() };
        let warning = Entry::Warning { text: "thin".into() };
        let none = Outputs::default();
        log.add(&note("a", &none), &[metric, warning], &[shown]).unwrap();
        log.add(&note("b", &none), &[], &[]).unwrap();
        log.finish(&[("pipeline.yaml", "application/yaml", b"rockface: 1\n")]).unwrap().0.into_inner()
    }

    #[test]
    fn another_reader_finds_every_message_and_equal_runs_have_equal_bytes() {
        let bytes = written();
        let read: Vec<_> = mcap::MessageStream::new(&bytes).unwrap().map(Result::unwrap).collect();
        let told: Vec<(&str, u64)> =
            read.iter().map(|m| (m.channel.topic.as_str(), m.log_time / 1_000_000_000)).collect();
        assert_eq!(told, [("/a/step", 1), ("/log", 1), ("/a/metrics", 1), ("/a/points", 1), ("/b/step", 2)]);
        let step: Value = serde_json::from_slice(&read[0].data).unwrap();
        assert_eq!(step["shown"][0]["of"]["path"], "outputs/a/b.ply");
        assert_eq!(step["shown"][0]["topics"][0], "/a/points");
        let metrics: Value = serde_json::from_slice(&read[2].data).unwrap();
        assert_eq!(metrics["values"]["rms"], 0.1 + 0.2);
        assert_eq!(bytes, written());
    }
}
