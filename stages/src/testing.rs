//! A host for the tests of stages: keeps the log, hands out files from memory, derives streams from purpose and item.

use std::collections::BTreeMap;
use std::sync::Mutex;

use crate::{Entry, Host, SourceFile};

/// A host without engine.
#[derive(Default)]
pub struct TestHost {
    /// What the stage logged.
    pub entries: Mutex<Vec<Entry>>,
    /// Files (name and content) by the path or pattern a parameter names.
    pub files: BTreeMap<String, Vec<(String, Vec<u8>)>>,
}

impl TestHost {
    /// A host with one file.
    pub fn with_file(path: &str, bytes: Vec<u8>) -> Self {
        let files = BTreeMap::from([(path.to_owned(), vec![(path.to_owned(), bytes)])]);
        Self { files, ..Self::default() }
    }

    /// The value of a logged metric.
    pub fn metric(&self, wanted: &str) -> Option<f64> {
        let entries = self.entries.lock().unwrap();
        entries.iter().find_map(|entry| match entry {
            Entry::Metric { name, value, .. } if name == wanted => Some(*value),
            _ => None,
        })
    }

    /// All warnings, one a line.
    pub fn warnings(&self) -> String {
        let entries = self.entries.lock().unwrap();
        let texts = entries.iter().filter_map(|entry| match entry {
            Entry::Warning { text } => Some(text.as_str()),
            _ => None,
        });
        texts.collect::<Vec<_>>().join("\n")
    }
}

impl Host for TestHost {
    fn stream_key(&self, purpose: &str, item: &str) -> [u8; 32] {
        *blake3::hash(format!("{purpose}\0{item}").as_bytes()).as_bytes()
    }
    fn open(&self, as_written: &str) -> std::io::Result<Vec<SourceFile>> {
        let files = self.files.get(as_written).ok_or(std::io::ErrorKind::NotFound)?;
        let open = |(name, bytes): &(String, Vec<u8>)| SourceFile {
            name: name.clone(),
            reader: Box::new(std::io::Cursor::new(bytes.clone())),
        };
        Ok(files.iter().map(open).collect())
    }
    fn record(&self, entry: Entry) {
        self.entries.lock().unwrap().push(entry);
    }
    fn cancelled(&self) -> bool {
        false
    }
}
