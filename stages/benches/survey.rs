//! What a survey of the Nobbys Head block costs, stage by stage: `cargo bench --workspace --bench survey [-- DOWNSCALE IMAGES]`.
//!
//! The block of `pipelines/nobbys-head.yaml` (strips 18 m before the cliff, 20 megapixels, four neighbours), by default at a
//! fourth of its pixels along each side and with 12 of its 80 images. Time goes by pixel: per image at full size, times the
//! square of the downscale. `1 12` takes minutes; the whole block at full size is to cost less than 8 minutes with two threads.

use std::sync::Arc;
use std::time::{Duration, Instant};

use rockface_core::artefact::Artefact;
use rockface_core::{Context, Entry, Host, Inputs, Point, SourceFile};
use serde_json::{Value, json};

/// Streams of its own, no files, no log.
struct Alone;

impl Host for Alone {
    fn stream_key(&self, purpose: &str, item: &str) -> [u8; 32] {
        *blake3::hash(format!("{purpose}\0{item}").as_bytes()).as_bytes()
    }
    fn open(&self, _as_written: &str) -> std::io::Result<Vec<SourceFile>> {
        Err(std::io::ErrorKind::NotFound.into())
    }
    fn record(&self, _entry: Entry) {}
    fn cancelled(&self) -> bool {
        false
    }
}

type Given<'a> = (&'a str, &'a Arc<Artefact>);

fn main() {
    let numbers: Vec<u32> = std::env::args().skip(1).filter_map(|word| word.parse().ok()).collect();
    let (downscale, images) =
        (numbers.first().copied().unwrap_or(4).max(1), numbers.get(1).copied().unwrap_or(12).max(4));
    let face = one("synthesise-face", &json!({"width_m": 42, "height_m": 24, "relief_m": 0.3, "spacing_m": 0.02}), &[]);
    let block = json!({"block": "strips", "width_px": 5472, "height_px": 3648, "focal_mm": 8.8, "pixel_um": 2.41, "gsd_m": 0.005,
        "columns": images.div_ceil(2), "rows": 2, "overlap": 0.8, "sidelap": 0.8, "directions_deg": [[0, -15]], "follow": "terrain"});
    let cameras = one("plan-survey", &block, &[("mesh", &face)]);
    let on_face = [("cameras", &cameras), ("mesh", &face)];
    let pairs = one("select-pairs", &json!({"neighbours": 4, "min_overlap": 0.4}), &on_face);
    let adjusted = json!({"control_points": 0, "position_sigma_m": [0.015, 0.015, 0.025], "free_interior": ["f", "cx", "cy", "k1", "k2", "p1", "p2"]});
    let covariance = one("estimate-covariance", &adjusted, &on_face);
    let noisy = one("perturb-cameras", &json!({}), &[("cameras", &cameras), ("covariance", &covariance)]);
    let names = cameras.items().expect("cameras are a list");

    let depths = each("project-depth", &names, |name| {
        (json!({"image": name, "downscale": downscale}), vec![("mesh", &face), ("cameras", &cameras)])
    });
    let matched = each("match-image", &names, |name| {
        let with = json!({"image": name, "sigma_local_px": 0.6, "sigma_regular_px": 0.65, "spacing_px": 26});
        let mut given: Vec<Given> = depths.iter().map(|depth| ("depths", depth)).collect();
        given.extend([("noisy", &noisy), ("pairs", &pairs)]);
        (with, given)
    });
    let cell_m = 0.01 * f64::from(downscale);
    let window_m = [-20.0, 20.0, -11.0, 11.0];
    let mut maps = matched.iter();
    let grids = each("grid-depth", &names, |_| {
        let depth = maps.next().expect("a map for each image");
        (json!({"cell_m": cell_m, "window_m": window_m}), vec![("depth", depth)])
    });
    let all = |port, artefacts: &'_ [Arc<Artefact>]| artefacts.iter().map(|a| (port, a.clone())).collect::<Vec<_>>();
    let gathered = all("grids", &grids);
    let gathered: Vec<Given> = gathered.iter().map(|(port, artefact)| (*port, artefact)).collect();
    tell("fuse-grids", timed("fuse-grids", &json!({"window_m": window_m}), &gathered).1, 1);
    let gathered = all("depths", &matched);
    let gathered: Vec<Given> = gathered.iter().map(|(port, artefact)| (*port, artefact)).collect();
    tell("fuse-volume", timed("fuse-volume", &json!({"voxel_m": cell_m, "window_m": window_m}), &gathered).1, 1);
}

/// A stage that runs once.
fn one(stage: &str, with: &Value, given: &[Given]) -> Arc<Artefact> {
    let (artefact, took) = timed(stage, with, given);
    tell(stage, took, 1);
    artefact
}

/// A stage that runs for every image.
fn each<'a>(
    stage: &str,
    names: &[String],
    mut asked: impl FnMut(&str) -> (Value, Vec<Given<'a>>),
) -> Vec<Arc<Artefact>> {
    let mut took = Duration::ZERO;
    let run = |name: &String| {
        let (with, given) = asked(name);
        let (artefact, own) = timed(stage, &with, &given);
        took += own;
        artefact
    };
    let made = names.iter().map(run).collect();
    tell(stage, took, names.len());
    made
}

/// The first output of a stage, and how long it took with all threads.
fn timed(stage: &str, with: &Value, given: &[Given]) -> (Arc<Artefact>, Duration) {
    let mut inputs = Inputs::default();
    for (port, artefact) in given {
        inputs.push(port, Point::new(), (*artefact).clone());
    }
    let found = rockface_stages::registry().find(stage).expect("the stage is there");
    let clock = Instant::now();
    let outputs = found.run(with, &inputs, &Context::new(&Alone)).unwrap_or_else(|error| panic!("{stage}: {error}"));
    let took = clock.elapsed();
    let made = outputs.into_inner().remove(found.outputs()[0].name).expect("every output is made");
    (Arc::new(made), took)
}

fn tell(stage: &str, took: Duration, times: usize) {
    let each = took.as_secs_f64() / times as f64;
    println!("{stage:20} {times:3} x {each:7.3} s = {:7.2} s", took.as_secs_f64());
}
