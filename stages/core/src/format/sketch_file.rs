//! The sketches of a step as one file: a line that names the format, the length of a JSON list (u32, little-endian), the
//! list, and behind it the numbers of all sketches in their order, little-endian.

use crate::artefact::CodecError;
use crate::artefact::sketch::{Shape, Shown};

const MAGIC: &[u8] = b"rockface sketches 1\n";

/// The JSON part: what is shown, and how many bytes each array behind it has.
#[derive(serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct Head<S> {
    shown: S,
    bytes: Vec<usize>,
}

/// Writes a list of sketches.
pub fn write(list: &[Shown]) -> Result<Vec<u8>, CodecError> {
    let arrays: Vec<Vec<u8>> = list.iter().flat_map(|shown| arrays(&shown.sketch.shape)).collect();
    let head = Head { shown: list, bytes: arrays.iter().map(Vec::len).collect() };
    let head = serde_json::to_vec(&head).map_err(|e| CodecError(format!("a sketch cannot be written: {e}")))?;
    // A number that is not finite becomes `null`.
    let read_back = serde_json::from_slice::<Head<Vec<Shown>>>(&head);
    read_back.map_err(|e| CodecError(format!("a sketch cannot be written: a number in it is not finite ({e})")))?;
    let mut out = Vec::with_capacity(MAGIC.len() + 4 + head.len() + arrays.iter().map(Vec::len).sum::<usize>());
    out.extend(MAGIC);
    out.extend((head.len() as u32).to_le_bytes());
    out.extend(head);
    arrays.iter().for_each(|array| out.extend(array));
    Ok(out)
}

/// Reads a list of sketches.
pub fn read(bytes: &[u8]) -> Result<Vec<Shown>, CodecError> {
    let cut = || CodecError::new("not a file of sketches: it is cut short or damaged");
    let (length, rest) = bytes.strip_prefix(MAGIC).and_then(<[u8]>::split_first_chunk::<4>).ok_or_else(cut)?;
    let (head, mut rest) = rest.split_at_checked(u32::from_le_bytes(*length) as usize).ok_or_else(cut)?;
    let head: Head<Vec<Shown>> =
        serde_json::from_slice(head).map_err(|e| CodecError(format!("not a file of sketches: {e}")))?;
    let mut arrays = Vec::with_capacity(head.bytes.len());
    for length in head.bytes {
        let (array, behind) = rest.split_at_checked(length).ok_or_else(cut)?;
        arrays.push(array);
        rest = behind;
    }
    let mut arrays = arrays.into_iter();
    let mut list = head.shown;
    for shown in &mut list {
        fill(&mut shown.sketch.shape, &mut arrays).ok_or_else(cut)?;
    }
    let complete = rest.is_empty() && arrays.next().is_none();
    complete.then_some(list).ok_or_else(cut)
}

/// The arrays of a shape as bytes, in a fixed order.
fn arrays(shape: &Shape) -> Vec<Vec<u8>> {
    match shape {
        Shape::Picture(picture) => vec![picture.png.clone()],
        Shape::Cloud(cloud) => vec![floats(cloud.points.as_flattened())],
        Shape::Bodies(bodies) => bodies
            .bodies
            .iter()
            .flat_map(|body| {
                let corners = body.triangles.as_flattened().iter().flat_map(|i| i.to_le_bytes()).collect();
                [floats(body.vertices.as_flattened()), corners]
            })
            .collect(),
        Shape::Grid(grid) => grid.bands.iter().map(|band| floats(&band.values)).collect(),
        Shape::Cameras(_) | Shape::Transform(_) | Shape::Table(_) | Shape::Values(_) => Vec::new(),
    }
}

/// Gives a shape its arrays back; `None` when they do not fit.
fn fill<'a>(shape: &mut Shape, arrays: &mut impl Iterator<Item = &'a [u8]>) -> Option<()> {
    match shape {
        Shape::Picture(picture) => picture.png = arrays.next()?.to_vec(),
        Shape::Cloud(cloud) => cloud.points = triples(arrays.next()?, f32::from_le_bytes)?,
        Shape::Bodies(bodies) => {
            for body in &mut bodies.bodies {
                body.vertices = triples(arrays.next()?, f32::from_le_bytes)?;
                body.triangles = triples(arrays.next()?, u32::from_le_bytes)?;
                let count = body.vertices.len() as u64;
                let inside = body.triangles.as_flattened().iter().all(|i| u64::from(*i) < count);
                inside.then_some(())?;
            }
        }
        Shape::Grid(grid) => {
            let cells = grid.columns.checked_mul(grid.rows)?;
            for band in &mut grid.bands {
                band.values = words(arrays.next()?, f32::from_le_bytes)?;
                (band.values.len() == cells).then_some(())?;
            }
        }
        Shape::Cameras(cameras) => {
            cameras.images.iter().all(|image| image.sensor < cameras.sensors.len()).then_some(())?;
        }
        Shape::Transform(_) | Shape::Table(_) | Shape::Values(_) => {}
    }
    Some(())
}

fn floats(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

fn words<T>(bytes: &[u8], from: fn([u8; 4]) -> T) -> Option<Vec<T>> {
    let (words, rest) = bytes.as_chunks::<4>();
    rest.is_empty().then(|| words.iter().map(|word| from(*word)).collect())
}

fn triples<T: Copy>(bytes: &[u8], from: fn([u8; 4]) -> T) -> Option<Vec<[T; 3]>> {
    let words = words(bytes, from)?;
    let (triples, rest) = words.as_chunks::<3>();
    rest.is_empty().then(|| triples.to_vec())
}

impl Shown {
    /// All sketches of a step as one file; equal lists have equal bytes.
    ///
    /// # Errors
    /// A number that JSON cannot hold.
    pub fn write_all(list: &[Self]) -> Result<Vec<u8>, CodecError> {
        write(list)
    }

    /// Reads what [`Shown::write_all`] wrote.
    ///
    /// # Errors
    /// Bytes that are no such file, cut short or damaged.
    pub fn read_all(bytes: &[u8]) -> Result<Vec<Self>, CodecError> {
        read(bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::artefact::Table;
    use crate::artefact::sketch::{BodiesSketch, Body, CloudSketch, GridBand, GridSketch, PictureSketch, Sketch};

    fn sample() -> Vec<Shown> {
        let frame = || "wall".to_owned();
        let mut table = Table::new(["a_m", "b"]);
        table.push(vec![(0.1 + 0.2).into(), "x".into()]);
        let body = Body {
            name: "1".into(),
            class: "wedge".into(),
            vertices: vec![[0.0, 1.0, -0.0], [1.5; 3], [2.0; 3]],
            triangles: vec![[0, 1, 2]],
        };
        let grid = GridSketch {
            frame: frame(),
            quantity: "difference".into(),
            columns: 2,
            rows: 1,
            cell_m: 0.1,
            left_m: -1.0,
            top_m: 3.0,
            bands: vec![GridBand { name: "difference".into(), values: vec![f32::INFINITY, -3.25] }],
        };
        let picture = PictureSketch { width: 1, height: 1, colours: None, image: None, png: b"\x89PNG".to_vec() };
        let shapes = [
            Shape::Picture(picture),
            Shape::Cloud(CloudSketch { frame: frame(), origin_m: [1e6, 0.0, 0.1], points: vec![[1.0, 2.0, 3.0]] }),
            Shape::Bodies(BodiesSketch { frame: frame(), origin_m: [0.0; 3], bodies: vec![body] }),
            Shape::Grid(grid),
            Shape::Table(table),
            Shape::Values(serde_json::json!({"pairs": [1, 2.5]})),
        ];
        let shown = |shape| Shown { port: "out".into(), sketch: Sketch::whole("p", shape) };
        shapes.into_iter().map(shown).collect()
    }

    #[test]
    fn what_was_written_is_read() {
        let bytes = write(&sample()).unwrap();
        assert_eq!(read(&bytes).unwrap(), sample());
        assert_eq!(read(&write(&[]).unwrap()).unwrap(), []);
    }

    #[test]
    fn what_could_not_be_read_back_is_not_written() {
        let cloud = CloudSketch { frame: "wall".into(), origin_m: [0.0, f64::NAN, 0.0], points: Vec::new() };
        let shown = Shown { port: "out".into(), sketch: Sketch::whole("", Shape::Cloud(cloud)) };
        assert!(write(&[shown]).unwrap_err().0.contains("not finite"));
    }

    #[test]
    fn cut_or_damaged_bytes_never_panic() {
        let bytes = write(&sample()).unwrap();
        for length in 0..bytes.len() {
            assert!(read(&bytes[..length]).is_err(), "length {length}");
        }
        for place in 0..bytes.len() {
            let mut damaged = bytes.clone();
            damaged[place] ^= 0x55;
            let _ = read(&damaged);
        }
    }
}
