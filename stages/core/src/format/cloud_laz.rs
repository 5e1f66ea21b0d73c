//! Point clouds as LAZ 1.4, for programs that take nothing else: rounded to a tenth of a millimetre, so an export only.
//!
//! Normals are the extra dimensions `NormalX`, `NormalY`, `NormalZ` (float), the numbers of the points extra dimensions of
//! their own names (unsigned, 32 bits), described by the extra-bytes record of the ASPRS specification (LAS 1.4 R15, section
//! "Extra Bytes"). Colours fill 16 bits. The coordinate reference system of the world frame is a record of well-known text.

use std::io::Cursor;

use las::point::Format;
use las::{Builder, PointDataBuilder, Transform, Vector, Version, Vlr, Writer};
use rayon::prelude::*;

use super::cloud_las::{PROJECTION_USER, WKT_RECORD};
use super::las_normals::{ENTRY_BYTES, RECORD as EXTRA_BYTES_RECORD};
use crate::artefact::{Cloud, CodecError};

/// Metres an integer coordinate counts.
const SCALE_M: f64 = 1e-4;
/// Names of the dimensions of a normal.
const NORMAL: [&str; 3] = ["NormalX", "NormalY", "NormalZ"];
/// Types of dimensions by the numbers of the specification.
const UNSIGNED_32: u8 = 5;
const FLOAT_32: u8 = 9;
/// Points made and compressed at once: 16 chunks, each by one core.
const AT_ONCE: usize = 16 * 50_000;
/// Points a task makes.
const TASK: usize = 4096;
/// Bytes of a point of format 6: coordinates, fields that stay 0, and the time.
const POINT_BYTES: usize = 30;
/// Where the number of the return and the number of returns stand, half a byte each, and the first of one.
const RETURNS_AT: usize = 14;
const FIRST_OF_ONE: u8 = 0x11;

/// Writes a cloud; equal clouds give equal bytes.
///
/// # Errors
/// Points farther apart than the integers of the format reach, 214 km.
pub fn write(cloud: &Cloud) -> Result<Vec<u8>, CodecError> {
    let fault = |error: las::Error| CodecError(format!("LAZ file: {error}"));
    check_extent(cloud)?;
    let header = header(cloud).into_header().map_err(fault)?;
    let mut writer = Writer::new(Cursor::new(Vec::new()), header).map_err(fault)?;
    let mut batch = PointDataBuilder::new().for_header(writer.header()).build();
    let (transforms, record) = (*writer.header().transforms(), batch.record_len());
    for first in (0..cloud.points.len()).step_by(AT_ONCE) {
        let bytes = batch.resize_for(AT_ONCE.min(cloud.points.len() - first));
        bytes.par_chunks_mut(TASK * record).enumerate().try_for_each(|(task, bytes)| {
            let places = first + task * TASK..;
            bytes
                .chunks_exact_mut(record)
                .zip(places)
                .try_for_each(|(bytes, place)| encode(cloud, place, &transforms, bytes).map_err(fault))
        })?;
        writer.write_points(&batch).map_err(fault)?;
    }
    writer.close().map_err(fault)?;
    Ok(writer.into_inner().map_err(fault)?.into_inner())
}

/// A point that the integers do not reach would be found out too late: the writer could not be closed any more.
fn check_extent(cloud: &Cloud) -> Result<(), CodecError> {
    for axis in 0..3 {
        let range = cloud.points.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], point| {
            [low.min(point[axis]), high.max(point[axis])]
        });
        let extent_m = range[1] - range[0].floor();
        if extent_m / SCALE_M > f64::from(i32::MAX) {
            let reach_m = f64::from(i32::MAX) * SCALE_M;
            return Err(CodecError(format!("LAZ file: points {extent_m:.0} m apart; it reaches {reach_m:.0} m")));
        }
    }
    Ok(())
}

fn header(cloud: &Cloud) -> Builder {
    let entries = entries(cloud);
    let mut point_format = Format { is_extended: true, has_gps_time: true, is_compressed: true, ..Format::default() };
    point_format.has_color = !cloud.colours.is_empty();
    point_format.extra_bytes = (4 * entries.len() / ENTRY_BYTES) as u16;
    let least = |axis: usize| cloud.points.iter().fold(f64::INFINITY, |least, point| least.min(point[axis]));
    let axis = |axis: usize| Transform { scale: SCALE_M, offset: least(axis).floor() };
    let vlr = Vlr {
        user_id: "LASF_Spec".to_owned(),
        record_id: EXTRA_BYTES_RECORD,
        description: "extra dimensions".to_owned(),
        data: entries,
    };
    let mut builder = Builder::from(Version::new(1, 4));
    // Equal clouds are to have equal files.
    builder.date = None;
    "rockface".clone_into(&mut builder.generating_software);
    "simulation".clone_into(&mut builder.system_identifier);
    builder.transforms = Vector { x: axis(0), y: axis(1), z: axis(2) };
    builder.point_format = point_format;
    if !vlr.data.is_empty() {
        builder.vlrs.push(vlr);
    }
    if let Some(crs) = cloud.frame.crs() {
        builder.vlrs.push(Vlr {
            user_id: PROJECTION_USER.to_owned(),
            record_id: WKT_RECORD,
            description: "OGC WKT".to_owned(),
            data: format!("{}\0", crs.wkt()).into_bytes(),
        });
        builder.has_wkt_crs = true;
    }
    builder
}

/// The description of the extra dimensions, in the order of their bytes.
fn entries(cloud: &Cloud) -> Vec<u8> {
    let normals = NORMAL.iter().filter(|_| !cloud.normals.is_empty()).map(|name| (*name, FLOAT_32));
    let numbers = cloud.numbers.keys().map(|name| (name.as_str(), UNSIGNED_32));
    let values = cloud.values.keys().map(|name| (name.as_str(), FLOAT_32));
    normals.chain(numbers).chain(values).flat_map(|(name, kind)| entry(name, kind)).collect()
}

/// Reserved (2), type, options, name (32), and further fields that are not used.
fn entry(name: &str, kind: u8) -> [u8; ENTRY_BYTES] {
    let mut entry = [0; ENTRY_BYTES];
    entry[2] = kind;
    let length = name.len().min(32);
    entry[4..4 + length].copy_from_slice(&name.as_bytes()[..length]);
    entry
}

/// A point of format 6, or 7 where there are colours, with its extra dimensions behind.
fn encode(cloud: &Cloud, place: usize, transforms: &Vector<Transform>, bytes: &mut [u8]) -> Result<(), las::Error> {
    let [x, y, z] = cloud.points[place];
    let integers = [transforms.x.inverse(x)?, transforms.y.inverse(y)?, transforms.z.inverse(z)?];
    let (point, mut rest) = bytes.split_at_mut(POINT_BYTES);
    point.fill(0);
    point.as_chunks_mut().0.iter_mut().zip(integers).for_each(|(bytes, value)| *bytes = value.to_le_bytes());
    point[RETURNS_AT] = FIRST_OF_ONE;
    let mut put = |value: &[u8]| {
        let (field, behind) = std::mem::take(&mut rest).split_at_mut(value.len());
        field.copy_from_slice(value);
        rest = behind;
    };
    let colour = cloud.colours.get(place).into_iter().flatten();
    colour.for_each(|value| put(&(u16::from(*value) * 257).to_le_bytes()));
    cloud.normals.get(place).into_iter().flatten().for_each(|value| put(&value.to_le_bytes()));
    cloud.numbers.values().for_each(|values| put(&values[place].to_le_bytes()));
    cloud.values.values().for_each(|values| put(&values[place].to_le_bytes()));
    Ok(())
}

#[cfg(test)]
#[allow(clippy::float_cmp)] // to the bit
mod tests {
    use super::*;
    use crate::artefact::Frame;
    use crate::format::cloud_las;

    fn cloud() -> Cloud {
        let at = |i: u32| [451_000.5 + f64::from(i) * 0.01, 5_512_000.25 - f64::from(i) * 0.5, f64::from(i % 9) * 0.1];
        let mut cloud = Cloud::new(Frame::World, (0..3000).map(at).collect());
        cloud.normals = (0..3000).map(|i| [0.0, i as f32 / 3000.0, 0.5]).collect();
        cloud.colours = (0..3000).map(|i| [i as u8, 7, 255]).collect();
        cloud.numbers.insert("id".to_owned(), (0..3000).map(|i| i * 1_000_000).collect());
        cloud
    }

    #[test]
    fn points_and_extra_dimensions_are_read_back() {
        let bytes = write(&cloud()).unwrap();
        assert_eq!(bytes, write(&cloud()).unwrap());
        let read = cloud_las::read(bytes.clone(), &|| false).unwrap();
        for (read, given) in read.points.iter().zip(&cloud().points) {
            assert!((0..3).all(|axis| (read[axis] - given[axis]).abs() <= 0.5001 * SCALE_M));
        }
        assert_eq!(read.colours, cloud().colours);
        let expected = cloud()
            .normals
            .iter()
            .fold([0.0; 3], |sum: [f64; 3], normal| [0, 1, 2].map(|axis| sum[axis] + f64::from(normal[axis])));
        assert_eq!(read.normals, expected);
        let mut reader = las::Reader::new(Cursor::new(bytes)).unwrap();
        let first = reader.read_points(1).unwrap();
        let point = first.points().next().unwrap().unwrap();
        assert_eq!(point.extra_bytes.len(), 16);
        assert_eq!(point.extra_bytes[8..12], 0.5f32.to_le_bytes());
        let record = reader.header().vlrs().iter().find(|vlr| vlr.record_id == EXTRA_BYTES_RECORD).unwrap();
        assert_eq!(record.data.len(), 4 * ENTRY_BYTES);
        assert_eq!(&record.data[3 * ENTRY_BYTES + 4..3 * ENTRY_BYTES + 7], b"id\0");
    }

    #[test]
    fn a_bare_cloud_needs_no_record() {
        let bytes = write(&Cloud::new(Frame::Wall, vec![[1.0, 2.0, 3.0]])).unwrap();
        assert_eq!(cloud_las::read(bytes, &|| false).unwrap().points.len(), 1);
        let far = Cloud::new(Frame::Wall, vec![[0.0; 3], [1e6, 0.0, 0.0]]);
        assert!(write(&far).unwrap_err().0.contains("points 1000000 m apart"));
    }
}
