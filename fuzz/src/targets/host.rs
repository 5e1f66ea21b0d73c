//! What a stage is lent here: the files of a case, and streams that are always the same.

use std::io::Cursor;
use std::sync::Arc;

use rockface_core::artefact::Artefact;
use rockface_core::{Context, Entry, Host, Inputs, Point, SourceFile, StageError};
use serde_json::Value;

use super::{Verdict, artefacts};

/// Name and content of each file.
type Named<'a> = Vec<(&'a str, &'a [u8])>;

/// Lends files from memory: each parameter names a list of them.
pub struct Files<'a>(pub &'a [(&'a str, Named<'a>)]);

impl Host for Files<'_> {
    fn stream_key(&self, purpose: &str, item: &str) -> [u8; 32] {
        *blake3::hash(format!("{purpose} {item}").as_bytes()).as_bytes()
    }

    fn open(&self, as_written: &str) -> std::io::Result<Vec<SourceFile>> {
        let found = self.0.iter().find(|(written, _)| *written == as_written);
        let (_, files) = found.ok_or(std::io::ErrorKind::NotFound)?;
        let open = |(name, bytes): &(&str, &[u8])| SourceFile {
            name: (*name).to_owned(),
            reader: Box::new(Cursor::new(bytes.to_vec())),
        };
        Ok(files.iter().map(open).collect())
    }

    fn record(&self, entry: Entry) {
        // Whatever is said must be text.
        let _ = format!("{entry:?}");
    }

    fn cancelled(&self) -> bool {
        false
    }
}

/// Runs a stage as a run would, and keeps what it makes; the refusal says nothing more than that it is one.
pub fn run(stage: &str, with: &Value, host: &Files, inputs: &[(&str, Artefact)]) -> Verdict {
    match made(stage, with, host, inputs) {
        Ok(artefacts) => {
            for artefact in &artefacts {
                artefacts::used(artefact);
            }
            Verdict::Accepted
        }
        Err(_) => Verdict::Refused,
    }
}

/// What a stage makes of parameters that are right.
pub fn made(stage: &str, with: &Value, host: &Files, inputs: &[(&str, Artefact)]) -> Result<Vec<Artefact>, StageError> {
    let stage = rockface_stages::registry().find(stage).expect("a target names a stage that is there");
    let checked = stage.check(with).expect("the parameters of a target are right");
    let mut given = Inputs::default();
    for (port, artefact) in inputs {
        given.push(port, Point::new(), Arc::new(artefact.clone()));
    }
    let outputs = stage.run(&checked.canonical, &given, &Context::new(host))?;
    Ok(outputs.into_inner().into_values().collect())
}
