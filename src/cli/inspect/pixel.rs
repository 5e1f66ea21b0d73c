//! One pixel of a depth map, followed through the steps that made it: each is run again in memory with all its channels,
//! and what comes out is compared with what is on record.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use rockface_cache::{Digest, RecipeInput, Record, Store};
use rockface_core::Registry;
use rockface_core::artefact::{Artefact, Depth, Kind, Mesh, Noun};
use serde_json::{Value, json};

use super::super::places::Places;
use super::super::{CliError, say};
use super::{Facts, say_facts};
use rockface_engine::run::rerun;

/// How an OpenEXR file begins.
const OPENEXR: &[u8] = &[0x76, 0x2f, 0x31, 0x01];

/// Reads `X,Y`, column and row, from the command line.
pub fn parse(text: &str) -> Result<[usize; 2], String> {
    let (x, y) = text.split_once(',').ok_or("give column and row, such as 812,430")?;
    let wrong = |text: &str| format!("`{text}` is no column or row: whole numbers from 0, such as 812,430");
    let number = |text: &str| text.trim().parse::<usize>().map_err(|_| wrong(text));
    Ok([number(x)?, number(y)?])
}

/// What one step makes of the pixel.
struct Stop {
    title: String,
    facts: Facts,
}

/// Follows a pixel of the depth map `what` (a file, or the start of the digest of one on record).
pub fn follow(
    registry: &Registry,
    what: &str,
    pixel: [usize; 2],
    places: &Places,
    as_json: bool,
) -> Result<(), CliError> {
    let path = Path::new(what);
    let (store, start) = if path.is_file() {
        let bytes = std::fs::read(path).map_err(|error| CliError::Usage(format!("cannot read `{what}`: {error}")))?;
        if !bytes.starts_with(OPENEXR) {
            return Err(CliError::Usage(format!(
                "`{what}` is no depth map (OpenEXR), and `--pixel` follows a pixel of one"
            )));
        }
        let depth = Depth::decode(&bytes).map_err(|error| CliError::Usage(format!("`{what}`: {error}")))?;
        check(&depth, pixel)?;
        (store_near(path, places), Start::File(Digest::of(&bytes), Box::new(depth)))
    } else {
        (Some(places.open_store()?), Start::Prefix)
    };
    let chain = store.as_ref().map(|store| Chain::new(registry, store));
    let stops = match (start, &chain) {
        (Start::File(digest, depth), chain) => {
            match chain.as_ref().and_then(|chain| chain.maker(&digest).map(|m| (chain, m))) {
                Some((chain, (key, port))) => chain.stops(&key, &port, pixel)?,
                None => vec![alone(what, &depth, pixel)],
            }
        }
        (Start::Prefix, Some(chain)) => {
            let (key, port) = chain.find(what)?;
            chain.stops(&key, &port, pixel)?
        }
        (Start::Prefix, None) => Vec::new(),
    };
    tell(&stops, pixel, as_json);
    Ok(())
}

enum Start {
    File(Digest, Box<Depth>),
    Prefix,
}

fn tell(stops: &[Stop], [column, row]: [usize; 2], as_json: bool) {
    if as_json {
        let stops: Vec<Value> = stops
            .iter()
            .map(|stop| json!({"step": stop.title, "facts": stop.facts.iter().cloned().collect::<BTreeMap<_, _>>()}))
            .collect();
        say(&serde_json::to_string_pretty(&json!({"pixel": [column, row], "chain": stops})).unwrap_or_default());
        return;
    }
    say(&format!("pixel {column}, {row}"));
    for stop in stops {
        say(&format!("\n{}", stop.title));
        say_facts(&stop.facts);
    }
}

/// The store a file of a run folder belongs to, or the usual one; none where there is none.
fn store_near(file: &Path, places: &Places) -> Option<Store> {
    let absolute = std::path::absolute(file).unwrap_or_else(|_| PathBuf::from(file));
    let beside = absolute.ancestors().map(|folder| folder.join("store")).find(|store| store.join("format").is_file());
    beside.and_then(|store| Store::open(&store).ok()).or_else(|| places.open_store().ok())
}

/// A file that no record tells of: its own numbers only.
fn alone(what: &str, depth: &Depth, pixel: [usize; 2]) -> Stop {
    let mut facts: Facts = vec![("made by".into(), "no record in the store tells".into())];
    facts.extend(numbers(depth, pixel));
    Stop { title: what.to_owned(), facts }
}

fn check(depth: &Depth, [column, row]: [usize; 2]) -> Result<(), CliError> {
    if column < depth.width && row < depth.height {
        return Ok(());
    }
    let (w, h) = (depth.width, depth.height);
    Err(CliError::Usage(format!("the depth map has {w} x {h} pixels: columns 0 to {}, rows 0 to {}", w - 1, h - 1)))
}

/// Depth, channels and point of a pixel.
fn numbers(depth: &Depth, [column, row]: [usize; 2]) -> Facts {
    let at = row * depth.width + column;
    let number = |value: f32| if value.is_nan() { "no value".into() } else { json!(f64::from(value)) };
    let mut facts: Facts = vec![("image".into(), depth.image.name.clone().into())];
    let found = rockface_imaging::camera::depth_pixel::pixel(depth, column, row);
    if let Some(found) = &found {
        facts.push(("position in the full image (px)".into(), json!(found.full_px)));
    }
    facts.push(("Z (m)".into(), number(depth.z[at])));
    facts.extend(depth.channels.iter().map(|(name, values)| (labelled(name), number(values[at]))));
    if let Some(found) = found {
        facts.push((format!("point in the {} frame (m)", depth.frame), json!(found.point_m)));
    }
    facts
}

/// A channel with its unit.
fn labelled(name: &str) -> String {
    match name {
        "range" => format!("{name} (m)"),
        "triangle" | "valid" | "noise.strength" => name.to_owned(),
        _ => format!("{name} (px)"),
    }
}

/// The records of a store, as far as a pixel is concerned.
struct Chain<'a> {
    registry: &'a Registry,
    store: &'a Store,
    records: Vec<(Digest, Record)>,
    kinds: BTreeMap<Digest, Kind>,
}

impl<'a> Chain<'a> {
    fn new(registry: &'a Registry, store: &'a Store) -> Self {
        let records: Vec<(Digest, Record)> =
            store.keys().into_iter().filter_map(|key| Some((key, store.record(&key)?))).collect();
        let outputs = records.iter().flat_map(|(_, record)| record.outputs.values());
        let kinds = outputs.filter_map(|output| Some((output.digest, output.kind.parse().ok()?))).collect();
        Self { registry, store, records, kinds }
    }

    /// The record and port that made an output.
    fn maker(&self, digest: &Digest) -> Option<(Digest, String)> {
        self.records.iter().find_map(|(key, record)| {
            let (port, _) = record.outputs.iter().find(|(_, output)| output.digest == *digest)?;
            Some((*key, port.to_string()))
        })
    }

    /// The depth map whose digest, or whose record's key, begins like this.
    fn find(&self, start: &str) -> Result<(Digest, String), CliError> {
        let mut found: Vec<(Digest, String)> = Vec::new();
        for (key, record) in &self.records {
            for (port, output) in record.outputs.iter().filter(|(_, output)| output.kind == Kind::Depth.word()) {
                let fits = [&output.digest, key].iter().any(|digest| digest.to_string().starts_with(start));
                if fits && !found.iter().any(|(key, _)| self.digest(key, port) == Some(output.digest)) {
                    found.push((*key, port.to_string()));
                }
            }
        }
        match found.as_slice() {
            [one] => Ok(one.clone()),
            [] => Err(CliError::Usage(format!(
                "`{start}` is neither a file nor the start of the digest of a depth map on record"
            ))),
            several => Err(CliError::Usage(format!("`{start}` fits {} depth maps: give more digits", several.len()))),
        }
    }

    fn record(&self, key: &Digest) -> Option<&Record> {
        self.records.iter().find(|(known, _)| known == key).map(|(_, record)| record)
    }

    fn digest(&self, key: &Digest, port: &str) -> Option<Digest> {
        Some(self.record(key)?.outputs.get(port)?.digest)
    }

    /// What the steps upstream make of a pixel, then what this one does.
    fn stops(&self, key: &Digest, port: &str, pixel: [usize; 2]) -> Result<Vec<Stop>, CliError> {
        let Some(record) = self.record(key) else { return Ok(Vec::new()) };
        let failed = |error: rockface_core::StageError| {
            let hint = error.hint.map(|hint| format!(" ({hint})")).unwrap_or_default();
            CliError::Usage(format!("`{}` cannot be run again: {}{hint}", record.recipe.stage, error.message))
        };
        let kind_of = |digest: &Digest| self.kinds.get(digest).copied();
        let made = rerun::with_channels(&record.recipe, self.registry, self.store, &kind_of).map_err(failed)?;
        let Some(Artefact::Depth(depth)) = made.get(port) else {
            return Err(CliError::Usage(format!("`{port}` of `{}` is no depth map", record.recipe.stage)));
        };
        check(depth, pixel)?;
        let mut stops = self.upstream(record, depth, pixel)?;
        let mut facts = numbers(depth, pixel);
        facts.extend(self.triangle(record, depth, pixel));
        facts.extend(stops.last().and_then(|before| moved(&before.facts, &facts)));
        facts.push(("checked".into(), verdict(record, port, depth).into()));
        let title = format!("{} {} (record {})", record.recipe.stage, record.recipe.version, key.short());
        stops.push(Stop { title, facts });
        Ok(stops)
    }

    /// The stops of the input that is the same image at the same size.
    fn upstream(&self, record: &Record, depth: &Depth, pixel: [usize; 2]) -> Result<Vec<Stop>, CliError> {
        if record.recipe.params.get("sampling").and_then(Value::as_str) == Some("rectified") {
            // Its pixels are those of a rectified image, which no map upstream has.
            return Ok(Vec::new());
        }
        for input in record.recipe.inputs.values() {
            let RecipeInput::One(digest) = input else { continue };
            if self.kinds.get(digest) != Some(&Kind::Depth) {
                continue;
            }
            let Ok(before) = Depth::decode(&self.store.get(digest)?) else { continue };
            let same =
                (&before.image.name, before.width, before.height) == (&depth.image.name, depth.width, depth.height);
            if let (true, Some((key, port))) = (same, self.maker(digest)) {
                return self.stops(&key, &port, pixel);
            }
        }
        Ok(Vec::new())
    }

    /// The corners of the triangle seen.
    fn triangle(&self, record: &Record, depth: &Depth, [column, row]: [usize; 2]) -> Option<(String, Value)> {
        let number = *depth.channels.get("triangle")?.get(row * depth.width + column)?;
        let digest = record.recipe.inputs.values().find_map(|input| match input {
            RecipeInput::One(digest) if self.kinds.get(digest) == Some(&Kind::Mesh) => Some(digest),
            _ => None,
        })?;
        let mesh = Mesh::decode(&self.store.get(digest).ok()?).ok()?;
        let corners = mesh.triangles.get((!number.is_nan()).then_some(number as usize)?)?;
        Some(("its corners (m)".into(), json!(corners.map(|corner| mesh.vertices[corner as usize]))))
    }
}

/// How far the point has moved since the stop before, metres.
fn moved(before: &Facts, now: &Facts) -> Option<(String, Value)> {
    let point = |facts: &Facts| -> Option<Vec<f64>> {
        let (_, value) = facts.iter().find(|(name, _)| name.starts_with("point in the"))?;
        value.as_array()?.iter().map(Value::as_f64).collect()
    };
    let (from, to) = (point(before)?, point(now)?);
    let step: Vec<f64> = to.iter().zip(&from).map(|(to, from)| to - from).collect();
    Some(("moved by (m)".into(), json!(step)))
}

/// Whether the recomputed output is the recorded one.
fn verdict(record: &Record, port: &str, depth: &Depth) -> String {
    let Some(output) = record.outputs.get(port) else { return "not on record".to_owned() };
    let plain = Depth { channels: BTreeMap::new(), ..depth.clone() };
    let equal =
        [depth, &plain].into_iter().any(|depth| depth.encode().is_ok_and(|bytes| Digest::of(&bytes) == output.digest));
    if equal {
        "recomputed, identical to the record bit by bit".to_owned()
    } else {
        format!("recomputed, but NOT equal to {} on record", output.digest.short())
    }
}
