//! What tests lend a stage instead of the engine: files from memory, keys from names, a log to look into.

use std::collections::BTreeMap;
use std::io::{Cursor, Error, ErrorKind, Result};
use std::path::PathBuf;
use std::sync::Mutex;

use crate::{Entry, Host, SourceFile};

/// A host without engine.
#[derive(Default)]
pub struct TestHost {
    /// What the stage logged.
    pub entries: Mutex<Vec<Entry>>,
    /// Files by the text a parameter names them with: name and content of each.
    pub files: BTreeMap<String, Vec<(String, Vec<u8>)>>,
    /// Mixed into every random key, so that tests draw several times.
    pub seed: u64,
}

impl TestHost {
    /// A host that draws from another seed.
    pub fn seeded(seed: u64) -> Self {
        Self { seed, ..Self::default() }
    }

    /// Adds files under the text that names them.
    pub fn with(mut self, as_written: &str, files: &[(&str, &[u8])]) -> Self {
        let owned = files.iter().map(|(name, bytes)| ((*name).to_owned(), bytes.to_vec())).collect();
        self.files.insert(as_written.to_owned(), owned);
        self
    }

    /// The warnings so far.
    pub fn warnings(&self) -> Vec<String> {
        let text = |entry: &Entry| if let Entry::Warning { text } = entry { Some(text.clone()) } else { None };
        self.entries.lock().unwrap().iter().filter_map(text).collect()
    }

    /// The value of a metric.
    pub fn metric(&self, wanted: &str) -> Option<f64> {
        self.entries.lock().unwrap().iter().find_map(|entry| match entry {
            Entry::Metric { name, value, .. } if name == wanted => Some(*value),
            _ => None,
        })
    }
}

impl Host for TestHost {
    fn stream_key(&self, purpose: &str, item: &str) -> [u8; 32] {
        *blake3::hash(format!("{} {purpose}\n{item}", self.seed).as_bytes()).as_bytes()
    }

    fn open(&self, as_written: &str) -> Result<Vec<SourceFile>> {
        let files = self.files.get(as_written).ok_or_else(|| Error::new(ErrorKind::NotFound, "no such file"))?;
        let source = |(name, bytes): &(String, Vec<u8>)| SourceFile {
            name: name.clone(),
            reader: Box::new(Cursor::new(bytes.clone())),
        };
        Ok(files.iter().map(source).collect())
    }

    fn record(&self, entry: Entry) {
        self.entries.lock().unwrap().push(entry);
    }

    fn cancelled(&self) -> bool {
        false
    }
}

/// A file of the shared data; `None`, and a line saying so, where the data is not there.
pub fn shared(path: &str) -> Option<Vec<u8>> {
    let file = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data")).join(path);
    let bytes = std::fs::read(&file).ok();
    if bytes.is_none() {
        println!("skipped: {} is not there", file.display());
    }
    bytes
}
