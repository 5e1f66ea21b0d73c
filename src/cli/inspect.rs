//! `rockface inspect`: what a blob, a record or a file holds: kind, sizes, ranges, missing values.

use std::path::{Path, PathBuf};

use clap::Args;
use rockface_cache::{Digest, Record, Store};
use rockface_stages::artefact::{Artefact, Kind, Mesh, Raster, Table};
use serde_json::{Map, Value, json};

use super::places::Places;
use super::{CliError, say};

/// Arguments of `rockface inspect`.
#[derive(Debug, Args)]
pub struct InspectArgs {
    /// A file, or the digest of a blob or record in the store (the first digits are enough).
    what: String,
    #[command(flatten)]
    places: Places,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

/// What there is to say, in order.
type Facts = Vec<(String, Value)>;

impl InspectArgs {
    /// Prints what it is.
    pub fn run(self) -> Result<(), CliError> {
        let path = PathBuf::from(&self.what);
        let facts = if path.is_file() { of_file(&path)? } else { self.of_digest()? };
        if self.json {
            let map: Map<String, Value> = facts.into_iter().collect();
            say(&serde_json::to_string_pretty(&map).unwrap_or_default());
            return Ok(());
        }
        let width = facts.iter().map(|(name, _)| name.chars().count()).max().unwrap_or(0);
        for (name, value) in facts {
            let value = value.as_str().map_or_else(|| value.to_string(), str::to_owned);
            say(&format!("{name:width$}  {value}"));
        }
        Ok(())
    }

    fn of_digest(&self) -> Result<Facts, CliError> {
        let store = self.places.open_store()?;
        let records: Vec<(Digest, Record)> =
            store.keys().into_iter().filter_map(|key| Some((key, store.record(&key)?))).collect();
        let blobs = records.iter().flat_map(|(_, record)| {
            let logs = record.log.map(|log| (log, "log"));
            record.outputs.values().map(|output| (output.digest, output.kind.as_str())).chain(logs)
        });
        let keys = records.iter().map(|(key, _)| (*key, "record"));
        let mut found: Vec<(Digest, &str)> =
            keys.chain(blobs).filter(|(digest, _)| digest.to_string().starts_with(&self.what)).collect();
        found.sort_unstable();
        found.dedup_by_key(|(digest, _)| *digest);
        match found.as_slice() {
            [(key, "record")] => of_record(key, &records),
            [(digest, kind)] => of_blob(&store, digest, kind, &records),
            [] => Err(self.unknown()),
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
        CliError::Usage(format!(
            "`{what}` is neither a file nor the start of a digest on record: `rockface runs show RUN --json` names digests"
        ))
    }
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
        ("cost".into(), json!(record.cost)),
    ])
}

fn of_blob(store: &Store, digest: &Digest, kind: &str, records: &[(Digest, Record)]) -> Result<Facts, CliError> {
    let makers = records.iter().filter_map(|(key, record)| {
        let port = record.outputs.iter().find(|(_, output)| output.digest == *digest).map(|(port, _)| port.as_str());
        let port = port.or((record.log == Some(*digest)).then_some("log"))?;
        Some(format!("{port} of {} (record {})", record.recipe.stage, key.short()))
    });
    let makers: Vec<String> = makers.collect();
    let mut facts: Facts = vec![("blob".into(), digest.to_string().into()), ("made as".into(), json!(makers))];
    let bytes = match store.get(digest) {
        Ok(bytes) => bytes,
        Err(rockface_cache::StoreError::Missing { .. }) => {
            facts.push(("kept".into(), "no: only the digest is on record".into()));
            return Ok(facts);
        }
        Err(error) => return Err(error.into()),
    };
    facts.push(("bytes".into(), bytes.len().into()));
    match kind.parse::<Kind>().ok().map(|kind| Artefact::decode(kind, &bytes)) {
        Some(Ok(artefact)) => facts.extend(of_artefact(&artefact)),
        Some(Err(error)) => facts.push(("fault".into(), error.to_string().into())),
        None => facts.push(("content".into(), serde_json::from_slice(&bytes).unwrap_or(Value::Null))),
    }
    Ok(facts)
}

fn of_file(path: &Path) -> Result<Facts, CliError> {
    let bytes =
        std::fs::read(path).map_err(|error| CliError::Usage(format!("cannot read `{}`: {error}", path.display())))?;
    let mut facts: Facts = vec![
        ("file".into(), path.display().to_string().into()),
        ("bytes".into(), bytes.len().into()),
        ("blake3".into(), Digest::of(&bytes).to_string().into()),
    ];
    if mcap::Summary::read(&bytes).is_ok_and(|summary| summary.is_some()) {
        facts.extend(of_log(&bytes));
        return Ok(facts);
    }
    let extension = path.extension().map(|extension| extension.to_string_lossy().to_lowercase()).unwrap_or_default();
    let kinds = Kind::ALL.iter().filter(|kind| kind.extension() == extension);
    let mut faults = Vec::new();
    for kind in kinds {
        match Artefact::decode(*kind, &bytes) {
            Ok(artefact) => {
                facts.extend(of_artefact(&artefact));
                return Ok(facts);
            }
            Err(error) => faults.push(format!("as {kind}: {error}")),
        }
    }
    let why =
        if faults.is_empty() { format!("no artefact has the extension `{extension}`") } else { faults.join("; ") };
    facts.push(("kind".into(), "not an artefact".into()));
    facts.push(("why".into(), why.into()));
    Ok(facts)
}

fn of_log(bytes: &[u8]) -> Facts {
    let mut facts: Facts = vec![("kind".into(), "MCAP log".into())];
    let summary = mcap::Summary::read(bytes).ok().flatten();
    if let Some(stats) = summary.as_ref().and_then(|summary| summary.stats.as_ref()) {
        facts.push(("messages".into(), stats.message_count.into()));
        facts.push(("attachments".into(), stats.attachment_count.into()));
    }
    let mut topics: Vec<String> =
        summary.iter().flat_map(|summary| summary.channels.values().map(|channel| channel.topic.clone())).collect();
    topics.sort();
    facts.push(("topics".into(), json!(topics)));
    facts
}

fn of_artefact(artefact: &Artefact) -> Facts {
    let mut facts: Facts = vec![("kind".into(), artefact.kind().word().into())];
    match artefact {
        Artefact::Mesh(mesh) => facts.extend(of_mesh(mesh)),
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
            facts.push(("z (m)".into(), range(depth.z.iter().copied().map(f64::from))));
            let channels = depth.channels.iter();
            facts.extend(channels.map(|(name, values)| (name.clone(), range(values.iter().copied().map(f64::from)))));
        }
        Artefact::Table(table) => facts.extend(of_table(table)),
        Artefact::Cameras(cameras) => {
            facts.push(("frame".into(), cameras.frame.to_string().into()));
            facts.push(("sensors".into(), cameras.sensors.len().into()));
        }
        _ => {}
    }
    if let Some(items) = artefact.items() {
        facts.push(("items".into(), items.len().into()));
    }
    facts
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
        let numbers: Vec<f64> = cells.filter_map(rockface_stages::artefact::Cell::number).collect();
        let told = if numbers.len() == table.rows.len() { range(numbers.into_iter()) } else { "text".into() };
        facts.push((format!("column {name}"), told));
    }
    facts
}

/// Least, greatest and number of values, and how many of them are no number.
fn range(values: impl Iterator<Item = f64>) -> Value {
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

    #[test]
    fn ranges_leave_out_what_is_no_number() {
        assert_eq!(range([1.0, f64::NAN, -2.0].into_iter()), json!({"min": -2.0, "max": 1.0, "count": 3, "nan": 1}));
        assert_eq!(range([f64::NAN].into_iter()), json!({"count": 1, "nan": 1}));
    }

    #[test]
    fn an_artefact_is_told_by_its_numbers() {
        let mut table = Table::new(["a", "name"]);
        table.push(vec![2.5.into(), rockface_stages::artefact::Cell::Text("x".into())]);
        let facts: Map<String, Value> = of_artefact(&Artefact::Table(table)).into_iter().collect();
        assert_eq!(facts["rows"], 1);
        assert_eq!(facts["column a"]["max"], 2.5);
        assert_eq!(facts["column name"], "text");
    }
}
