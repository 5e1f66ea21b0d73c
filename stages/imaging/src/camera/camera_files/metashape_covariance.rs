//! The covariance blocks of a Metashape XML as one covariance that knows what it lacks: everything between the blocks.

use nalgebra::Matrix3;

use super::metashape::{our_name, placed};
use super::metashape_xml::{CameraEntry, Chunk, SensorEntry, Similarity};
use crate::camera::orientation_parameters::{EXTERIOR, INTERIOR, Parameter};
use rockface_core::artefact::{Cameras, Covariance};
use rockface_core::{StageError, fail};

/// Gathers the blocks of the images and sensors in use, in canonical order; `None` where the file has none.
///
/// Rotations are about the camera's own axes on both sides (`R dR` there, `Exp(-dtheta) R` here: the sign drops out);
/// centres go from chunk to world units, `(sR) Sigma (sR)^T`.
pub fn covariance(
    chunk: &Chunk,
    images: &[&CameraEntry],
    sensors: &[&SensorEntry],
    cameras: &Cameras,
) -> Result<Option<Covariance>, StageError> {
    let mut blocks = Vec::new();
    for (at, image) in images.iter().enumerate() {
        let similarity = placed(chunk, image).unwrap_or_else(Similarity::identity);
        blocks.extend(image.rotation_covariance.map(|block| exterior(at, 0, &block)));
        let world = |block: Matrix3<f64>| {
            let turn = similarity.rotation * similarity.scale;
            exterior(at, 3, &(turn * block * turn.transpose()))
        };
        blocks.extend(image.location_covariance.map(world));
    }
    for (at, sensor) in sensors.iter().enumerate() {
        if let Some((names, elements)) = &sensor.covariance {
            // All its parameters may be ones that cannot be held and are known exactly: no block is left then.
            blocks.extend(Some(interior(at, &sensor.id, names, elements)?).filter(|(known, _)| !known.is_empty()));
        }
    }
    Ok((!blocks.is_empty()).then(|| united(&blocks, cameras)))
}

/// Parameters, and the row-major elements of their covariance.
type Block = (Vec<Parameter>, Vec<f64>);

fn exterior(image: usize, first: usize, block: &Matrix3<f64>) -> Block {
    let parameters = (first..first + 3).map(|place| Parameter::Exterior(image, place)).collect();
    (parameters, (0..9).map(|at| 0.5 * (block[(at / 3, at % 3)] + block[(at % 3, at / 3)])).collect())
}

/// The block of a sensor, its parameters put in our order.
fn interior(sensor: usize, id: &str, names: &[String], elements: &[f64]) -> Result<Block, StageError> {
    let n = names.len();
    let mut order = Vec::with_capacity(n);
    for (from, name) in names.iter().enumerate() {
        match INTERIOR.iter().position(|ours| *ours == our_name(name)) {
            Some(place) => order.push((place, from)),
            None if elements[from * n + from] == 0.0 => {}
            None => fail!("sensor {id}: the covariance has the parameter `{name}`, which cannot be held"),
        }
    }
    order.sort_unstable();
    let parameters = order.iter().map(|(place, _)| Parameter::Interior(sensor, *place)).collect();
    let element = |i: usize, j: usize| 0.5 * (elements[i * n + j] + elements[j * n + i]);
    Ok((parameters, order.iter().flat_map(|(_, i)| order.iter().map(move |(_, j)| element(*i, *j))).collect()))
}

fn united(blocks: &[Block], cameras: &Cameras) -> Covariance {
    let parameters: Vec<String> =
        blocks.iter().flat_map(|(parameters, _)| parameters.iter().map(|p| p.name(cameras))).collect();
    let mut matrix = vec![vec![0.0; parameters.len()]; parameters.len()];
    let mut first = 0;
    for (parameters, elements) in blocks {
        let n = parameters.len();
        for (row, values) in elements.chunks(n).enumerate() {
            matrix[first + row][first..first + n].copy_from_slice(values);
        }
        first += n;
    }
    Covariance { frame: cameras.frame, parameters, matrix, sigma0_applied: true, full_joint: false }
}

/// What of a covariance Metashape's XML holds of one image: the blocks of its rotation and of its centre.
pub fn image_blocks(covariance: &Covariance, image: &str) -> [Option<Matrix3<f64>>; 2] {
    [0, 3].map(|first| {
        let at = |place: usize| {
            let name = format!("{image}.{}", EXTERIOR[first + place]);
            covariance.parameters.iter().position(|parameter| *parameter == name)
        };
        let places = [at(0)?, at(1)?, at(2)?];
        Some(Matrix3::from_fn(|i, j| covariance.matrix[places[i]][places[j]]))
    })
}

/// Metashape's names and the row-major block of a sensor's parameters; `None` where the covariance has none of them.
pub fn sensor_block(covariance: &Covariance, sensor: &str) -> Option<(Vec<&'static str>, Vec<f64>)> {
    let at = |ours: &str| covariance.parameters.iter().position(|name| *name == format!("{sensor}.{ours}"));
    // Metashape's own order is that of its names: its p1 is our p2.
    let order = ["f", "cx", "cy", "b1", "b2", "k1", "k2", "k3", "k4", "p1", "p2"];
    let known: Vec<(&'static str, usize)> =
        order.into_iter().filter_map(|name| Some((name, at(our_name(name))?))).collect();
    let element = |(i, j): (usize, usize)| covariance.matrix[i][j];
    let elements = known.iter().flat_map(|(_, i)| known.iter().map(move |(_, j)| element((*i, *j)))).collect();
    (!known.is_empty()).then(|| (known.iter().map(|(name, _)| *name).collect(), elements))
}
