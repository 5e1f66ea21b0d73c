//! What tests of stages share: a host without an engine.

use std::collections::BTreeMap;
use std::io::Cursor;
use std::sync::{Arc, Mutex};

use crate::artefact::Artefact;
use crate::params::ParamType;
use crate::{Context, Entry, Host, Inputs, Outputs, Point, SourceFile, Stage, StageError};

/// A host that keeps its log in memory and serves files from memory.
#[derive(Default)]
pub struct TestHost {
    /// What was logged, in order.
    pub entries: Mutex<Vec<Entry>>,
    /// Files by the text that names them in a pipeline.
    pub files: BTreeMap<String, Vec<(String, Vec<u8>)>>,
}

impl TestHost {
    /// The last number logged under a name.
    pub fn metric(&self, wanted: &str) -> Option<f64> {
        let entries = self.entries.lock().expect("no test panics while it logs");
        entries.iter().rev().find_map(|entry| match entry {
            Entry::Metric { name, value, .. } if name == wanted => Some(*value),
            _ => None,
        })
    }

    /// The warnings logged.
    pub fn warnings(&self) -> Vec<String> {
        let entries = self.entries.lock().expect("no test panics while it logs");
        let warning = |entry: &Entry| if let Entry::Warning { text } = entry { Some(text.clone()) } else { None };
        entries.iter().filter_map(warning).collect()
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
            reader: Box::new(Cursor::new(bytes.clone())),
        };
        Ok(files.iter().map(open).collect())
    }
    fn record(&self, entry: Entry) {
        self.entries.lock().expect("no test panics while it logs").push(entry);
    }
    fn cancelled(&self) -> bool {
        false
    }
}

/// Runs a stage on parameters as a pipeline writes them, and artefacts by port.
pub fn run_stage<S: Stage>(
    host: &TestHost,
    with: &serde_json::Value,
    inputs: &[(&str, Artefact)],
) -> Result<Outputs, StageError> {
    let params = S::Params::decode(with).expect("parameters of a test are right");
    let mut given = Inputs::default();
    for (port, artefact) in inputs {
        given.push(port, Point::new(), Arc::new(artefact.clone()));
    }
    S::run(&params, &given, &Context::new(host))
}
