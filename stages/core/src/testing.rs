//! What tests of stages share: a host without an engine, and small scenes with known answers.

use std::collections::BTreeMap;
use std::io::Cursor;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};

use nalgebra::UnitQuaternion;

use crate::artefact::{Artefact, Frame, Image, Mesh, Sensor};
use crate::params::ParamType;
use crate::{AnyStage, Context, Entry, Host, Inputs, Outputs, Point, SourceFile, Stage, StageError};

/// A host that keeps its log in memory and serves files from memory.
#[derive(Default)]
pub struct TestHost {
    /// What was logged, in order.
    pub entries: Mutex<Vec<Entry>>,
    /// Files by the text that names them in a pipeline.
    pub files: BTreeMap<String, Vec<(String, Vec<u8>)>>,
    /// Whether a stream was asked for.
    pub drew: AtomicBool,
    /// Mixed into every random key, so that tests draw several times.
    pub seed: u64,
}

impl TestHost {
    /// A host that draws from another seed.
    pub fn seeded(seed: u64) -> Self {
        Self { seed, ..Self::default() }
    }

    /// Adds files under the text that names them.
    #[must_use]
    pub fn with(mut self, as_written: &str, files: &[(&str, &[u8])]) -> Self {
        let owned = files.iter().map(|(name, bytes)| ((*name).to_owned(), bytes.to_vec())).collect();
        self.files.insert(as_written.to_owned(), owned);
        self
    }

    /// The last number logged under a name.
    pub fn metric(&self, wanted: &str) -> Option<f64> {
        let entries = self.entries.lock().expect("no test panics while it logs");
        entries.iter().rev().find_map(|entry| match entry {
            Entry::Metric { name, value, .. } if name == wanted => Some(*value),
            _ => None,
        })
    }

    /// The warnings logged so far, in order.
    pub fn warnings(&self) -> Vec<String> {
        let entries = self.entries.lock().expect("no test panics while it logs");
        let warning = |entry: &Entry| if let Entry::Warning { text } = entry { Some(text.clone()) } else { None };
        entries.iter().filter_map(warning).collect()
    }
}

impl Host for TestHost {
    fn stream_key(&self, purpose: &str, item: &str) -> [u8; 32] {
        self.drew.store(true, Ordering::Relaxed);
        *blake3::hash(format!("{} {purpose}\0{item}", self.seed).as_bytes()).as_bytes()
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

/// The stage of a name in a room.
///
/// # Panics
/// When the room has no such stage.
pub fn stage(room: &[&'static dyn AnyStage], name: &str) -> &'static dyn AnyStage {
    let found = room.iter().copied().find(|stage| stage.name() == name);
    found.unwrap_or_else(|| panic!("the room has no stage `{name}`"))
}

/// A file of the shared data; `None`, and a line saying so, where the data is not there.
#[allow(clippy::print_stdout)] // in tests only
pub fn shared(path: &str) -> Option<Vec<u8>> {
    let file = std::path::Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data")).join(path);
    let bytes = std::fs::read(&file).ok();
    if bytes.is_none() {
        println!("skipped: {} is not there", file.display());
    }
    bytes
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
    host.drew.store(false, Ordering::Relaxed);
    let outputs = crate::stage::run::<S>(&params, &given, &Context::new(host));
    let drew = host.drew.load(Ordering::Relaxed);
    assert!(!drew || S::draws(&params), "{} draws random numbers although its `draws` says it does not", S::NAME);
    outputs
}

/// A camera of 60 x 40 pixels, f 100 px, at a point, looking along -Z of the wall frame (x right, y down).
pub fn small_sensor() -> Sensor {
    Sensor {
        name: "small".into(),
        width_px: 60,
        height_px: 40,
        f: 100.0,
        cx: 29.5,
        cy: 19.5,
        b1: 0.0,
        b2: 0.0,
        k: [0.0; 4],
        p: [0.0; 2],
    }
}

/// An image at `centre_m` that looks along -Z of the wall frame, turned by a rotation vector in its own frame.
pub fn image_at(name: &str, centre_m: [f64; 3], turn_rad: [f64; 3]) -> Image {
    let mut image = Image { name: name.into(), sensor: 0, camera_from_object: [0.0, 1.0, 0.0, 0.0], centre_m };
    let turned = UnitQuaternion::from_scaled_axis(turn_rad.into()) * image.rotation();
    image.set_rotation(&turned);
    image
}

/// A grid of `n` x `n` squares, two triangles each, over `x0..x1` by `y0..y1`; z by a function. Faces +Z.
pub fn height_mesh(n: u32, [x0, x1, y0, y1]: [f64; 4], z: impl Fn(f64, f64) -> f64) -> Mesh {
    let at = |i: u32, low: f64, high: f64| low + (high - low) * f64::from(i) / f64::from(n);
    let vertex = |row: u32, column: u32| {
        let (x, y) = (at(column, x0, x1), at(row, y0, y1));
        [x, y, z(x, y)]
    };
    let vertices =
        (0..=n).flat_map(|row| (0..=n).map(move |column| (row, column))).map(|(r, c)| vertex(r, c)).collect();
    let square = |row: u32, column: u32| {
        let a = row * (n + 1) + column;
        [[a, a + 1, a + n + 2], [a, a + n + 2, a + n + 1]]
    };
    let triangles = (0..n).flat_map(|row| (0..n).flat_map(move |column| square(row, column))).collect();
    Mesh { frame: Frame::Wall, vertices, triangles, colours: Vec::new() }
}

/// Reads every beginning of a file, which must be refused: a file that was cut short is no other file.
///
/// # Panics
/// Where a beginning is read.
pub fn refuses_every_beginning<T, E>(bytes: &[u8], read: impl Fn(&[u8]) -> Result<T, E>) {
    for length in 0..bytes.len() {
        assert!(read(&bytes[..length]).is_err(), "the first {length} of {} bytes are read", bytes.len());
    }
}
