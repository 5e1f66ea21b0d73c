//! Image blocks in the formats of other programs, as `export-cameras` writes them.

use std::io;

use rockface_core::artefact::{Artefact, Noun};
use serde_json::json;

use super::artefacts::covariance;
use super::{Seed, seed};
use crate::parts::joined;
use crate::targets::{Files, image_block, made};

const SIMPLE: &str = r#"{"sensors": [{"id": 4, "width": 60, "height": 40, "fx": 100.5, "fy": 100, "cx": 29.5, "cy": 19.5,
 "k1": -0.1, "p1": 0.001}], "images": [{"name": "a.png", "sensor": 4, "q_wxyz": [0, 1, 0, 0], "C": [1, 2, 20], "note": "x"}]}"#;
const COVARIANCE: &str = r#"{"parameters": ["a.rx", "sensor1.f"], "covariance": [[1e-6, 1e-5], [1e-5, 1.0]],
 "sigma0_applied": true, "units": {"rx,ry,rz": "rad", "f": "px"}, "method": "by hand"}"#;
const METASHAPE: &str = r#"<?xml version="1.0" encoding="UTF-8"?>
<document version="1.5.0"><chunk label="Chunk 1" enabled="true"><sensors next_id="2"><sensor id="4" label="x" type="frame">
<resolution width="60" height="40"/><calibration type="frame" class="adjusted"><resolution width="60" height="40"/><f>100</f>
<cx>1.5</cx><cy>-0.5</cy><k1>-0.1</k1><p1>0.004</p1></calibration><covariance><params>f p1 k5</params>
<coeffs>4 1 0 1 9 0 0 0 0</coeffs></covariance></sensor></sensors><components><component id="0"><transform>
<rotation>1 0 0 0 1 0 0 0 1</rotation><translation>10 20 30</translation><scale>2.5</scale></transform></component></components>
<cameras><group id="0"><camera id="0" sensor_id="4" component_id="0" label="DJI &amp; 1"><transform>1 0 0 0.5 0 1 0 0 0 0 1 2 0 0 0 1
</transform><rotation_covariance>1 0 0 0 2 0 0 0 3</rotation_covariance><location_covariance>4 0 0 0 1 0 0 0 1</location_covariance>
</camera></group><camera id="1" sensor_id="4" label="b"/></cameras><reference>LOCAL_CS["Local"]</reference></chunk></document>"#;

/// Seeds of every format of image blocks.
pub fn all() -> io::Result<Vec<Seed>> {
    let mut seeds = vec![
        seed("cameras-json", "simple", SIMPLE),
        seed("covariance", "simple", COVARIANCE),
        seed("covariance", "own", covariance().encode().map_err(io::Error::other)?),
        seed("cameras-metashape", "components", METASHAPE),
    ];
    for (target, format) in [
        ("cameras-json", "json"),
        ("cameras-metashape", "metashape"),
        ("cameras-bundler", "bundler"),
        ("cameras-colmap-text", "colmap-text"),
        ("cameras-colmap-binary", "colmap-binary"),
    ] {
        seeds.push(seed(target, "exported", exported(format)?));
    }
    Ok(seeds)
}

/// The block in a format; of several files the first two.
fn exported(format: &str) -> io::Result<Vec<u8>> {
    let inputs = [("cameras", Artefact::from(image_block())), ("covariance", Artefact::from(covariance()))];
    let made = made("export-cameras", &json!({"format": format}), &Files(&[]), &inputs).map_err(io::Error::other)?;
    let Some(Artefact::Files(files)) = made.first() else { return Err(io::Error::other("no files were exported")) };
    let parts: Vec<&[u8]> = files.files.iter().take(2).map(|(_, bytes)| bytes.as_slice()).collect();
    Ok(joined(&parts))
}
