//! Cameras to Metashape's XML: one chunk in a local system, its transform the identity, covariance blocks where known.

use nalgebra::Matrix3;

use super::metashape_covariance::{image_blocks, sensor_block};
use rockface_core::artefact::{Cameras, Covariance, Image, Sensor};
use rockface_core::{StageError, fail};

const LOCAL: &str =
    "LOCAL_CS[\"Local Coordinates (m)\",LOCAL_DATUM[\"Local Datum\",0],UNIT[\"metre\",1,AUTHORITY[\"EPSG\",\"9001\"]]]";

/// Writes a camera XML. Of a covariance only the blocks of single images and sensors fit; the rest is not in the file.
///
/// # Errors
///
/// A name with characters that XML cannot hold.
pub fn write(cameras: &Cameras, covariance: Option<&Covariance>) -> Result<Vec<u8>, StageError> {
    let mut xml = String::from(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<document version=\"2.0.0\">\n <chunk label=\"rockface\" enabled=\"true\">\n",
    );
    xml += &format!("  <sensors next_id=\"{}\">\n", cameras.sensors.len());
    for (id, sensor) in cameras.sensors.iter().enumerate() {
        xml += &sensor_element(id, sensor, covariance)?;
    }
    xml +=
        "  </sensors>\n  <components next_id=\"1\" active_id=\"0\">\n   <component id=\"0\" label=\"Component 1\">\n";
    xml += "    <transform><rotation>1 0 0 0 1 0 0 0 1</rotation><translation>0 0 0</translation><scale>1</scale></transform>\n";
    xml += &format!("   </component>\n  </components>\n  <cameras next_id=\"{}\">\n", cameras.images.len());
    for (id, image) in cameras.images.iter().enumerate() {
        xml += &camera_element(id, image, covariance)?;
    }
    xml += &format!("  </cameras>\n  <reference>{}</reference>\n </chunk>\n</document>\n", escaped(LOCAL)?);
    Ok(xml.into_bytes())
}

fn sensor_element(id: usize, sensor: &Sensor, covariance: Option<&Covariance>) -> Result<String, StageError> {
    let (width, height) = (sensor.width_px, sensor.height_px);
    let cx = sensor.cx + 0.5 - 0.5 * f64::from(width);
    let cy = sensor.cy + 0.5 - 0.5 * f64::from(height);
    let ([k1, k2, k3, k4], [p1, p2]) = (sensor.k, sensor.p);
    let resolution = format!("<resolution width=\"{width}\" height=\"{height}\"/>");
    let mut xml =
        format!("   <sensor id=\"{id}\" label=\"{}\" type=\"frame\">\n    {resolution}\n", escaped(&sensor.name)?);
    xml += &format!("    <calibration type=\"frame\" class=\"adjusted\">\n     {resolution}\n     ");
    // Its p1 is our p2 and the other way round.
    for (name, value) in [
        ("f", sensor.f),
        ("cx", cx),
        ("cy", cy),
        ("b1", sensor.b1),
        ("b2", sensor.b2),
        ("k1", k1),
        ("k2", k2),
        ("k3", k3),
        ("k4", k4),
        ("p1", p2),
        ("p2", p1),
    ] {
        xml += &format!("<{name}>{value}</{name}>");
    }
    xml += "\n    </calibration>\n";
    if let Some((names, elements)) = covariance.and_then(|covariance| sensor_block(covariance, &sensor.name)) {
        let (names, elements) = (names.join(" "), words(&elements));
        xml += &format!("    <covariance><params>{names}</params><coeffs>{elements}</coeffs></covariance>\n");
    }
    Ok(xml + "   </sensor>\n")
}

fn camera_element(id: usize, image: &Image, covariance: Option<&Covariance>) -> Result<String, StageError> {
    let (label, sensor) = (escaped(&image.name)?, image.sensor);
    let (r, c) = (image.matrix().transpose(), image.centre_m);
    let rows: Vec<f64> =
        (0..3).flat_map(|i| [r[(i, 0)], r[(i, 1)], r[(i, 2)], c[i]]).chain([0.0, 0.0, 0.0, 1.0]).collect();
    let mut xml = format!("   <camera id=\"{id}\" sensor_id=\"{sensor}\" component_id=\"0\" label=\"{label}\">\n");
    xml += &format!("    <transform>{}</transform>\n", words(&rows));
    let blocks = covariance.map_or([None, None], |covariance| image_blocks(covariance, &image.name));
    for (name, block) in ["rotation_covariance", "location_covariance"].into_iter().zip(blocks) {
        if let Some(block) = block {
            xml += &format!("    <{name}>{}</{name}>\n", words(&row_major(&block)));
        }
    }
    Ok(xml + "   </camera>\n")
}

fn row_major(block: &Matrix3<f64>) -> Vec<f64> {
    block.transpose().iter().copied().collect()
}

fn words(numbers: &[f64]) -> String {
    numbers.iter().map(f64::to_string).collect::<Vec<_>>().join(" ")
}

fn escaped(text: &str) -> Result<String, StageError> {
    if text.chars().any(char::is_control) {
        fail!("the name `{}` has characters that XML cannot hold", text.escape_debug());
    }
    let mut escaped = String::with_capacity(text.len());
    for letter in text.chars() {
        match letter {
            '&' => escaped += "&amp;",
            '<' => escaped += "&lt;",
            '>' => escaped += "&gt;",
            '"' => escaped += "&quot;",
            other => escaped.push(other),
        }
    }
    Ok(escaped)
}
