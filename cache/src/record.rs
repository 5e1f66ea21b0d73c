//! The record of a finished step: its recipe, its outputs, and its cost.

use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize};

use crate::{Digest, Outputs, Recipe};

/// What is remembered of a finished step under the key of its recipe.
///
/// ```
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use std::collections::BTreeMap;
///
/// use rockface_cache::{Cost, OutputRecord, Outputs, Recipe, Record, SafeName, Store};
///
/// let folder = tempfile::tempdir()?;
/// let store = Store::open(&folder.path().join("store"))?;
/// let bytes = b"ten cubic metres";
/// let output = OutputRecord {
///     kind: "table".into(),
///     digest: store.put(bytes)?,
///     bytes: bytes.len() as u64,
///     kept: true,
///     memory_bytes: None,
///     items: None,
/// };
/// let mut outputs = Outputs::default();
/// outputs.insert(SafeName::new("table")?, output);
/// let recipe = Recipe { stage: "sum".into(), version: 1, params: Default::default(), inputs: BTreeMap::new(), seed: None };
/// let record = Record { recipe, outputs, log: None, sketches: None, cost: Cost::default() };
///
/// let key = store.commit(&record)?;
/// assert_eq!(key, record.recipe.key());
/// assert_eq!(store.is_hit(&key), Some(record));
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Record {
    /// What decided the outputs.
    pub recipe: Recipe,
    /// The output at each port.
    pub outputs: Outputs,
    /// The log of the step, a blob.
    pub log: Option<Digest>,
    /// Sketches of the outputs for the log of a run, a blob; `None` where none were made.
    pub sketches: Option<Digest>,
    /// Time, processor time and memory that it took.
    pub cost: Cost,
}

/// The output at one port.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct OutputRecord {
    /// The kind of artefact, such as `mesh`.
    pub kind: String,
    /// The digest of its encoded bytes.
    pub digest: Digest,
    /// The number of its encoded bytes.
    #[serde(deserialize_with = "size")]
    pub bytes: u64,
    /// Whether the bytes were stored; if not, only their digest is known.
    pub kept: bool,
    /// Bytes the value takes in memory, for whoever plans to read it; `None` in records of former versions.
    #[serde(default, deserialize_with = "size_if_told", skip_serializing_if = "Option::is_none")]
    pub memory_bytes: Option<u64>,
    /// The items of a list artefact, over which a dynamic axis may fan out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub items: Option<Vec<String>>,
}

/// What a step took.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Cost {
    /// Elapsed time, seconds.
    #[serde(deserialize_with = "seconds")]
    pub wall_s: f64,
    /// Processor time of the whole process over the life of the step, seconds: all threads, and with them whatever else
    /// ran at the same time; and that of the programs the step started. It is the step's own only where steps run one by one.
    #[serde(deserialize_with = "seconds")]
    pub cpu_s: f64,
    /// Greatest resident memory of the whole process over the life of the step, looked at about 20 times a second, bytes:
    /// the step's own only where steps run one by one; or that of the largest program it started, if that is more. Of a step
    /// too short to be looked at, or where the system does not tell: the size in memory of what it loaded and made.
    #[serde(deserialize_with = "size")]
    pub peak_bytes: u64,
    /// When it was finished, seconds since 1970-01-01 UTC.
    #[serde(deserialize_with = "moment")]
    pub finished_unix_s: u64,
}

/// No size is greater, bytes: sums of many stay far from the end of the numbers.
const SIZE_LIMIT: u64 = 1 << 50;
/// Nothing takes longer, seconds: 30,000 years.
const SECONDS_LIMIT: f64 = 1e12;
/// The last second of the year 9999, after which dates cannot be written.
const MOMENT_LIMIT: u64 = 253_402_300_799;

fn within<T: PartialOrd + std::fmt::Display, E: Error>(value: T, least: &T, most: &T) -> Result<T, E> {
    if value >= *least && value <= *most {
        return Ok(value);
    }
    Err(E::custom(format!("{value} cannot be: it is not from {least} to {most}")))
}

fn size<'de, D: Deserializer<'de>>(from: D) -> Result<u64, D::Error> {
    within(u64::deserialize(from)?, &0, &SIZE_LIMIT)
}

fn size_if_told<'de, D: Deserializer<'de>>(from: D) -> Result<Option<u64>, D::Error> {
    Option::deserialize(from)?.map(|bytes| within(bytes, &0, &SIZE_LIMIT)).transpose()
}

fn seconds<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
    within(f64::deserialize(from)?, &0.0, &SECONDS_LIMIT)
}

fn moment<'de, D: Deserializer<'de>>(from: D) -> Result<u64, D::Error> {
    within(u64::deserialize(from)?, &0, &MOMENT_LIMIT)
}

/// What a record says apart from its recipe; quicker to read than the whole.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Outcome {
    /// The output at each port.
    pub outputs: Outputs,
    /// The log of the step, a blob.
    pub log: Option<Digest>,
    /// Sketches of the outputs for the log of a run, a blob; `None` where none were made.
    #[serde(default)]
    pub sketches: Option<Digest>,
    /// Time, processor time and memory that it took.
    pub cost: Cost,
}

impl Outcome {
    /// Whether the bytes of every output were stored.
    pub fn is_kept(&self) -> bool {
        self.outputs.values().all(|output| output.kept)
    }

    /// The blobs promised: every kept output with its size, and log and sketches, whose sizes are not recorded.
    pub fn blobs(&self) -> impl Iterator<Item = (Digest, Option<u64>)> {
        promised(&self.outputs, [self.log, self.sketches])
    }

    /// The outcome in the bytes of a record; `None` when another program wrote them.
    pub(crate) fn decode(bytes: &[u8]) -> Option<Self> {
        // As one text: its letters are looked at once, not string by string.
        serde_json::from_str(std::str::from_utf8(split(bytes)?.1).ok()?).ok()
    }
}

/// The part of a record that is not its recipe, as it is written.
#[derive(Serialize)]
struct OutcomeRef<'a> {
    outputs: &'a Outputs,
    log: &'a Option<Digest>,
    #[serde(skip_serializing_if = "Option::is_none")]
    sketches: &'a Option<Digest>,
    cost: &'a Cost,
}

impl Record {
    /// The blobs this record promises: every kept output with its size, and log and sketches, whose sizes are not recorded.
    pub fn blobs(&self) -> impl Iterator<Item = (Digest, Option<u64>)> {
        promised(&self.outputs, [self.log, self.sketches])
    }

    /// Whether it keeps outputs of which another record of the same recipe and outputs only tells.
    pub fn keeps_more_than(&self, other: &Self) -> bool {
        let same = self
            .outputs
            .iter()
            .map(|(port, output)| (port, output.digest))
            .eq(other.outputs.iter().map(|(port, output)| (port, output.digest)));
        let kept = |record: &Self| record.outputs.values().filter(|output| output.kept).count();
        same && kept(self) > kept(other)
    }

    /// Whether two records of one recipe say the same of everything but the cost.
    pub fn same_outcome(&self, other: &Record) -> bool {
        self.outputs == other.outputs && self.log == other.log && self.sketches == other.sketches
    }

    /// The bytes of a record frame: the length of the recipe's text (u32, little-endian), that text, and the rest as JSON.
    pub(crate) fn encode(&self, recipe_text: &str) -> serde_json::Result<Vec<u8>> {
        let mut out = Vec::with_capacity(recipe_text.len() + 512);
        out.extend((recipe_text.len() as u32).to_le_bytes());
        out.extend(recipe_text.as_bytes());
        let Self { outputs, log, sketches, cost, .. } = self;
        let outcome = OutcomeRef { outputs, log, sketches, cost };
        serde_json::to_writer(&mut out, &outcome)?;
        Ok(out)
    }

    /// The text of the recipe in the bytes of a record.
    pub(crate) fn recipe_text(bytes: &[u8]) -> Option<&str> {
        std::str::from_utf8(split(bytes)?.0).ok()
    }

    /// The record these bytes hold; `None` when another program wrote them.
    pub(crate) fn decode(bytes: &[u8]) -> Option<Record> {
        let (recipe, outcome) = split(bytes)?;
        let Outcome { outputs, log, sketches, cost } = serde_json::from_slice(outcome).ok()?;
        let recipe = serde_json::from_slice(recipe).ok()?;
        Some(Record { recipe, outputs, log, sketches, cost })
    }
}

/// The text of the recipe and the rest of a record.
fn split(bytes: &[u8]) -> Option<(&[u8], &[u8])> {
    let (length, rest) = bytes.split_first_chunk::<4>()?;
    rest.split_at_checked(u32::from_le_bytes(*length) as usize)
}

fn promised(outputs: &Outputs, told: [Option<Digest>; 2]) -> impl Iterator<Item = (Digest, Option<u64>)> {
    let kept = outputs.values().filter(|output| output.kept);
    kept.map(|output| (output.digest, Some(output.bytes))).chain(told.into_iter().flatten().map(|blob| (blob, None)))
}

impl Cost {
    /// Whether it could be read back: no time is negative or without end.
    pub(crate) fn is_sound(&self) -> bool {
        let times = [self.wall_s, self.cpu_s].iter().all(|time| (0.0..=SECONDS_LIMIT).contains(time));
        times && self.peak_bytes <= SIZE_LIMIT && self.finished_unix_s <= MOMENT_LIMIT
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::SafeName;
    use crate::recipe::tests::any_recipe;
    use proptest::prelude::*;

    fn any_output() -> impl Strategy<Value = OutputRecord> {
        let items = proptest::option::of(proptest::collection::vec(any::<String>(), 0..3));
        let memory_bytes = proptest::option::of(0..=SIZE_LIMIT);
        (any::<String>(), any::<[u8; 32]>(), 0..=SIZE_LIMIT, memory_bytes, any::<bool>(), items).prop_map(
            |(kind, digest, bytes, memory_bytes, kept, items)| OutputRecord {
                kind,
                digest: Digest::from_bytes(digest),
                bytes,
                memory_bytes,
                kept,
                items,
            },
        )
    }

    prop_compose! {
        pub(crate) fn any_record()(
            recipe in any_recipe(), outputs in proptest::collection::vec(("[a-z_0-9-]{1,9}", any_output()), 0..3),
            log in proptest::option::of(any::<[u8; 32]>()), sketches in proptest::option::of(any::<[u8; 32]>()), wall_s in 0.0..1e6, cpu_s in 0.0..1e6, peak_bytes in 0..=SIZE_LIMIT,
        ) -> Record {
            let cost = Cost { wall_s, cpu_s, peak_bytes, finished_unix_s: 1_700_000_000 };
            let [log, sketches] = [log, sketches].map(|blob| blob.map(Digest::from_bytes));
            let named = |(port, output): (String, OutputRecord)| (SafeName::new(port).unwrap(), output);
            let outputs = outputs.into_iter().map(named).collect();
            Record { recipe, outputs, log, sketches, cost }
        }
    }

    proptest! {
        #[test]
        fn decoding_gives_back_what_was_encoded(record in any_record()) {
            let bytes = record.encode(&record.recipe.text()).unwrap();
            let text = record.recipe.text();
            prop_assert_eq!(Record::recipe_text(&bytes), Some(text.as_str()));
            prop_assert_eq!(Record::decode(&bytes).unwrap(), record);
        }

        #[test]
        fn records_without_sketches_are_read(record in any_record()) {
            let record = Record { sketches: None, ..record };
            let bytes = record.encode(&record.recipe.text()).unwrap();
            prop_assert!(!String::from_utf8_lossy(&bytes).contains("\"sketches\":"));
            prop_assert_eq!(Record::decode(&bytes).unwrap(), record);
        }

        #[test]
        fn numbers_that_cannot_be_are_not_read(record in any_record(), at in 0usize..4) {
            let text = String::from_utf8(record.encode("").unwrap()[4..].to_vec()).unwrap();
            let field = ["\"wall_s\":", "\"cpu_s\":", "\"peak_bytes\":", "\"finished_unix_s\":"][at];
            let (before, after) = text.split_once(field).unwrap();
            let after = after.split_once([',', '}']).unwrap();
            let end = &text[text.len() - after.1.len() - 1..];
            for number in ["-1", "1e300", "18446744073709551615"] {
                let forged = format!("{before}{field}{number}{end}");
                prop_assert!(serde_json::from_str::<Outcome>(&forged).is_err(), "{}", forged);
            }
        }

        #[test]
        fn no_bytes_make_the_decoder_panic(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
            let _ = Record::decode(&bytes);
        }
    }
}
