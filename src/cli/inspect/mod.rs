//! `rockface inspect`: what a blob, a record, a file or a run folder holds: kind, sizes, ranges, missing values, a small
//! picture; and one pixel followed through the steps that made it.

mod colmap;
mod facts;
mod foreign;
mod origin;
mod picture;
mod pixel;
mod run;

use std::path::Path;

use clap::Args;
use rockface_cache::{Digest, Record, Store};
use rockface_core::Registry;
use rockface_core::artefact::sketch::Shown;
use rockface_core::artefact::{Artefact, Kind};
use serde_json::{Map, Value, json};

use self::facts::{of_artefact, of_log};
use self::picture::When;
use super::export::chosen;
use super::places::Places;
use super::{CliError, say};
use rockface_engine::history::Manifest;

/// Arguments of `rockface inspect`.
#[derive(Debug, Args)]
pub struct InspectArgs {
    /// A file, a run folder, or the digest of a blob or record in the store; the first digits are enough.
    what: String,
    /// An output of the run, such as `dem.raster[epoch=pre]`; WHAT is then a run as `rockface export` names it.
    output: Option<String>,
    #[command(flatten)]
    places: Places,
    /// Follow one pixel of a depth map through the steps that made it: column and row, from 0 at the upper left.
    #[arg(long, value_name = "X,Y", value_parser = pixel::parse, allow_hyphen_values = true)]
    pixel: Option<[usize; 2]>,
    /// Show small pictures in the terminal.
    #[arg(long, value_enum, default_value_t = When::Auto)]
    picture: When,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

/// What there is to say, in order.
type Facts = Vec<(String, Value)>;

/// What was found: what there is to say of it, and the artefact where it is one.
struct Found {
    facts: Facts,
    artefact: Option<Artefact>,
}

impl From<Facts> for Found {
    fn from(facts: Facts) -> Self {
        Self { facts, artefact: None }
    }
}

impl InspectArgs {
    /// Prints what it is.
    pub fn run(self, registry: &Registry) -> Result<(), CliError> {
        let path = run::file_meant(Path::new(&self.what));
        let output = self.output.as_ref().map(|output| OfRun::find(&self.places, &self.what, output)).transpose()?;
        if let Some(pixel) = self.pixel {
            let what = output.map_or_else(|| self.what.clone(), |output| output.digest.to_string());
            return pixel::follow(registry, &what, pixel, &self.places, self.json);
        }
        let found = match output {
            Some(output) => output.found()?,
            None if path.is_file() => of_file(&path, &self.places)?,
            None => match colmap::of_folder(Path::new(&self.what)) {
                Some(facts) => facts.into(),
                None => self.of_digest()?,
            },
        };
        if self.json {
            let map: Map<String, Value> = found.facts.into_iter().collect();
            say(&serde_json::to_string_pretty(&map).unwrap_or_default());
            return Ok(());
        }
        say_facts(&found.facts);
        if let Some(artefact) = found.artefact.filter(|_| self.picture.is_wanted()) {
            picture::show(&registry.look().sketches(&artefact))?;
        }
        Ok(())
    }

    fn of_digest(&self) -> Result<Found, CliError> {
        if !self.what.bytes().all(|byte| byte.is_ascii_hexdigit()) {
            return Err(self.unknown());
        }
        let store = self.places.open_store()?;
        let records: Vec<(Digest, Record)> =
            store.keys().into_iter().filter_map(|key| Some((key, store.record(&key)?))).collect();
        let blobs = records.iter().flat_map(|(_, record)| {
            let told = [(record.log, "log"), (record.sketches, "sketches")];
            let told = told.into_iter().filter_map(|(blob, what)| Some((blob?, what)));
            record.outputs.values().map(|output| (output.digest, output.kind.as_str())).chain(told)
        });
        let keys = records.iter().map(|(key, _)| (*key, "record"));
        let mut found: Vec<(Digest, &str)> =
            keys.chain(blobs).filter(|(digest, _)| digest.to_string().starts_with(&self.what)).collect();
        found.sort_unstable();
        found.dedup_by_key(|(digest, _)| *digest);
        match found.as_slice() {
            [(key, "record")] => of_record(key, &records).map(Found::from),
            [(digest, kind)] => of_blob(&store, digest, kind, &records),
            [] => {
                // What a failed step said is named by the manifest of its run only.
                let whole = self.what.parse().ok().filter(|digest| store.contains(digest));
                whole.map_or_else(|| Err(self.unknown()), |digest| of_blob(&store, &digest, "log", &records))
            }
            several => {
                let names: Vec<String> =
                    several.iter().take(8).map(|(digest, kind)| format!("{digest} ({kind})")).collect();
                Err(CliError::Usage(format!(
                    "`{}` fits {} digests: {}; give more digits",
                    self.what,
                    several.len(),
                    names.join(", ")
                )))
            }
        }
    }

    fn unknown(&self) -> CliError {
        let what = &self.what;
        if self.places.find(what).is_ok() {
            return CliError::Usage(format!(
                "`{what}` is a run: `rockface runs show {what}` describes it, `rockface inspect {what} STEP.PORT` an output of it"
            ));
        }
        CliError::Usage(format!(
            "`{what}` is neither a file nor the start of a digest on record: `rockface runs show RUN --json` names digests"
        ))
    }
}

/// An output of a past run.
struct OfRun {
    label: String,
    kind: String,
    digest: Digest,
    store: Store,
}

impl OfRun {
    fn find(places: &Places, run: &str, output: &str) -> Result<Self, CliError> {
        let run = places.find(run)?;
        let (done, port) = chosen(&run.manifest, output)?;
        let made = done.outputs.as_ref().and_then(|outputs| outputs.get(port));
        let unmade = || CliError::Usage(format!("`{}` was not made in this run", done.label()));
        let made = made.ok_or_else(unmade)?;
        let store = places.store_of(&run)?;
        Ok(Self { label: format!("{}.{port}", done.label()), kind: made.kind.clone(), digest: made.digest, store })
    }

    fn found(&self) -> Result<Found, CliError> {
        let Found { mut facts, artefact } = of_blob(&self.store, &self.digest, &self.kind, &[])?;
        facts.retain(|(name, _)| name != "made as");
        facts.insert(0, ("output".into(), self.label.clone().into()));
        Ok(Found { facts, artefact })
    }
}

/// Facts in two columns.
fn say_facts(facts: &Facts) {
    let width = facts.iter().map(|(name, _)| name.chars().count()).max().unwrap_or(0);
    for (name, value) in facts {
        if let ("images", Some(images)) = (name.as_str(), value.as_array()) {
            for (place, line) in image_lines(images).iter().enumerate() {
                say(&format!("{:width$}  {line}", if place == 0 { "images" } else { "" }));
            }
            continue;
        }
        let value = value.as_str().map_or_else(|| value.to_string(), str::to_owned);
        say(&format!("{name:width$}  {value}"));
    }
}

/// Images that are listed; JSON has all.
const MOST_IMAGES: usize = 20;

/// A line for each image: name, sensor and projection centre.
fn image_lines(images: &[Value]) -> Vec<String> {
    let text = |value: &Value| value.as_str().unwrap_or_default().to_owned();
    let line = |image: &Value| {
        format!("{} (sensor {}) at {} m", text(&image["name"]), text(&image["sensor"]), image["centre_m"])
    };
    let mut lines: Vec<String> = images.iter().take(MOST_IMAGES).map(line).collect();
    if images.len() > MOST_IMAGES {
        lines.push(format!("and {} more (`--json` lists all)", images.len() - MOST_IMAGES));
    }
    lines
}

fn of_record(key: &Digest, records: &[(Digest, Record)]) -> Result<Facts, CliError> {
    let found = records.iter().find(|(known, _)| known == key).map(|(_, record)| record);
    let record = found.ok_or_else(|| CliError::Usage(format!("record {key} is gone")))?;
    let recipe = serde_json::from_str(&record.recipe.text()).unwrap_or(Value::Null);
    Ok(vec![
        ("record".into(), key.to_string().into()),
        ("stage".into(), format!("{} {}", record.recipe.stage, record.recipe.version).into()),
        ("recipe".into(), recipe),
        ("outputs".into(), json!(record.outputs)),
        ("log".into(), json!(record.log)),
        ("sketches".into(), json!(record.sketches)),
        ("cost".into(), json!(record.cost)),
    ])
}

fn of_blob(store: &Store, digest: &Digest, kind: &str, records: &[(Digest, Record)]) -> Result<Found, CliError> {
    let makers = records.iter().filter_map(|(key, record)| {
        let port = record.outputs.iter().find(|(_, output)| output.digest == *digest).map(|(port, _)| port.as_str());
        let port = port.or((record.log == Some(*digest)).then_some("log"));
        let port = port.or((record.sketches == Some(*digest)).then_some("sketches"))?;
        Some(format!("{port} of {} (record {})", record.recipe.stage, key.short()))
    });
    let makers: Vec<String> = makers.collect();
    let mut facts: Facts = vec![("blob".into(), digest.to_string().into()), ("made as".into(), json!(makers))];
    let bytes = match store.get(digest) {
        Ok(bytes) => bytes,
        Err(rockface_cache::StoreError::Missing { .. }) => {
            facts.push(("kept".into(), "no: only the digest is on record".into()));
            return Ok(facts.into());
        }
        Err(error) => return Err(error.into()),
    };
    facts.push(("bytes".into(), bytes.len().into()));
    match kind.parse::<Kind>().ok().map(|kind| Artefact::decode(kind, &bytes)) {
        Some(Ok(artefact)) => {
            facts.extend(of_artefact(&artefact));
            return Ok(Found { facts, artefact: Some(artefact) });
        }
        Some(Err(error)) => facts.push(("fault".into(), error.to_string().into())),
        None if kind == "sketches" => facts.push(("content".into(), of_sketches(&bytes))),
        None => facts.push(("content".into(), serde_json::from_slice(&bytes).unwrap_or(Value::Null))),
    }
    Ok(facts.into())
}

/// What each sketch shows and leaves out.
fn of_sketches(bytes: &[u8]) -> Value {
    let told = |shown: &Shown| json!({"port": shown.port, "part": shown.sketch.part, "reduced": shown.sketch.reduced});
    match Shown::read_all(bytes) {
        Ok(list) => list.iter().map(told).collect(),
        Err(error) => error.to_string().into(),
    }
}

fn of_file(path: &Path, places: &Places) -> Result<Found, CliError> {
    let bytes =
        std::fs::read(path).map_err(|error| CliError::Usage(format!("cannot read `{}`: {error}", path.display())))?;
    let digest = Digest::of(&bytes);
    let mut facts: Facts = vec![
        ("file".into(), path.display().to_string().into()),
        ("bytes".into(), bytes.len().into()),
        ("blake3".into(), digest.to_string().into()),
    ];
    if mcap::Summary::read(&bytes).is_ok_and(|summary| summary.is_some()) {
        facts.extend(of_log(&bytes));
        return Ok(facts.into());
    }
    if run::is_manifest(&bytes) {
        facts.extend(run::of_manifest(&Manifest::read(path)?));
        return Ok(facts.into());
    }
    facts.extend(origin::of(path, &digest, &bytes, places));
    if let Some(found) = colmap::of_file(path) {
        facts.extend(found);
        return Ok(facts.into());
    }
    let extension = path.extension().map(|extension| extension.to_string_lossy().to_lowercase()).unwrap_or_default();
    let kinds = Kind::ALL.iter().filter(|kind| kind.extension() == extension);
    let mut faults = Vec::new();
    for kind in kinds {
        match Artefact::decode(*kind, &bytes) {
            Ok(artefact) => {
                facts.extend(of_artefact(&artefact));
                if let Artefact::Raster(raster) = &artefact {
                    foreign::of_system(raster, &bytes, &mut facts);
                }
                return Ok(Found { facts, artefact: Some(artefact) });
            }
            Err(error) => faults.push(format!("as {kind}: {error}")),
        }
    }
    let importer = match foreign::of(&bytes, &extension) {
        Some(Ok(found)) => {
            facts.extend(found.facts);
            return Ok(Found { facts, ..found });
        }
        Some(Err(error)) => {
            faults.push(error.to_string());
            None
        }
        None => importer(&extension),
    };
    let why = match importer.or_else(|| importer_of_json(&bytes)) {
        Some(stage) => format!("files of other programs are read by a step: `stage: {stage}`"),
        None if faults.is_empty() => format!("no artefact has the extension `{extension}`"),
        None => faults.join("; "),
    };
    facts.push(("kind".into(), "not an artefact".into()));
    facts.push(("why".into(), why.into()));
    Ok(facts.into())
}

/// The stage that reads files of other programs with this extension.
fn importer(extension: &str) -> Option<&'static str> {
    match extension {
        "las" | "laz" | "xyz" | "pts" | "txt" => Some("import-cloud"),
        "csv" => Some("import-cloud` for points, `import-table"),
        "obj" | "stl" => Some("import-mesh"),
        "xml" | "out" => Some("import-cameras"),
        _ => None,
    }
}

/// The stage that reads JSON of its own with such keys.
fn importer_of_json(bytes: &[u8]) -> Option<&'static str> {
    let value: Value = serde_json::from_slice(bytes).ok()?;
    let has = |key: &str| value.get(key).is_some();
    (has("sensors") && has("images")).then_some("import-cameras")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn some_images_are_listed_and_the_rest_counted() {
        let image = |name: usize| json!({"name": format!("i{name}"), "sensor": "s", "centre_m": [1.0, 2.0, 3.0]});
        let lines = |count: usize| image_lines(&(0..count).map(image).collect::<Vec<_>>());
        assert_eq!(lines(2), ["i0 (sensor s) at [1.0,2.0,3.0] m", "i1 (sensor s) at [1.0,2.0,3.0] m"]);
        assert_eq!((lines(20).len(), lines(23).last().unwrap().as_str()), (20, "and 3 more (`--json` lists all)"));
    }
}
