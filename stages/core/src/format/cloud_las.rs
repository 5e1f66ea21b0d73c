//! Point clouds as LAS and LAZ files.

use std::collections::BTreeMap;
use std::io::Cursor;
use std::panic::{AssertUnwindSafe, catch_unwind};

use las::{Header, PointData, PointDataBuilder, Reader};
use laz::{DecompressionSelection, LasZipDecompressor};

use super::las_normals::Normals;
use super::laz_check::{check_chunks, check_header, damaged, points_at};
use crate::artefact::CodecError;
use crate::crs::Stated;
use crate::crs::geo_keys::GeoKeys;

/// Points, in the order of the file.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Cloud {
    /// Places, metres, in the frame of the file.
    pub points: Vec<[f64; 3]>,
    /// Red, green and blue of each point; empty where the source has none.
    pub colours: Vec<[u8; 3]>,
    /// Points by their class, those that were left out for their class as well; empty where the format has no classes.
    pub classes: BTreeMap<u8, usize>,
    /// Points that the file flags as withheld, which are left out and counted nowhere else.
    pub withheld: usize,
    /// Sum of the normals of the points, in the frame of the file; zero where the source has none.
    pub normals: [f64; 3],
    /// The coordinate reference system that the file states.
    pub stated: Option<Stated>,
    /// What was wrong with the file and could be read all the same, in sentences.
    pub warnings: Vec<String>,
}

/// User and numbers of the records of a coordinate reference system.
pub(super) const PROJECTION_USER: &str = "LASF_Projection";
/// Number of the record that holds well-known text.
pub(super) const WKT_RECORD: u16 = 2112;
const KEYS_RECORD: u16 = 34735;
const DOUBLES_RECORD: u16 = 34736;
const ASCII_RECORD: u16 = 34737;
/// Points read at once, at most.
const BATCH: u64 = 1 << 16;
/// Bytes of the points read at once.
const BATCH_BYTES: u64 = 1 << 23;

/// Reads all points: `scale x integer + offset` in double precision, so nothing of the file is lost.
///
/// Points that are flagged as withheld are left out (ASPRS: they are to be treated as deleted), all others are taken; see [`read_classes`].
///
/// # Errors
/// What is damaged, or how many points of those promised are there; `cancelled` became true.
pub fn read(bytes: Vec<u8>, cancelled: &dyn Fn() -> bool) -> Result<Cloud, CodecError> {
    read_classes(bytes, &|_| true, cancelled)
}

/// The same of the points whose class is `wanted`.
///
/// Normals are those of extra dimensions that are called so; points whose normal is no number are left out of their sum.
/// Colours of 16 bits keep their upper byte; some programs write 8 bits into them, which is seen by no value exceeding 255.
///
/// # Errors
/// What is damaged, or how many points of those promised are there; all points are withheld; `cancelled` became true.
pub fn read_classes(
    mut bytes: Vec<u8>,
    wanted: &dyn Fn(u8) -> bool,
    cancelled: &dyn Fn() -> bool,
) -> Result<Cloud, CodecError> {
    let warnings: Vec<String> = mend_record_count(&mut bytes).into_iter().collect();
    check_header(&bytes)?;
    let unreadable = |e: las::Error| damaged(&format!("its header cannot be read ({e})"));
    let header = Header::new(Cursor::new(bytes.as_slice())).map_err(unreadable)?;
    if header.point_format().is_compressed {
        check_chunks(&bytes, &header)?;
    }
    let stated = stated(&header);
    // The decompressor panics on some damaged points.
    let points = catch_unwind(AssertUnwindSafe(|| {
        if header.point_format().is_compressed {
            read_points(&header, unpacked(bytes, &header)?, wanted, cancelled)
        } else {
            let mut reader = Reader::new(Cursor::new(bytes)).map_err(unreadable)?;
            let fill = |count, batch: &mut PointData| reader.fill_points(count, batch).map_err(|e| e.to_string());
            read_points(&header, fill, wanted, cancelled)
        }
    }));
    let cloud = points.unwrap_or_else(|_| Err(damaged("its points cannot be decompressed")))?;
    Ok(Cloud { stated, warnings, ..cloud })
}

/// Bytes of the head of a record.
const RECORD_HEAD: usize = 54;

/// Some programs count more records than they write: the number is brought down to those that fit before the points.
fn mend_record_count(bytes: &mut [u8]) -> Option<String> {
    let short = |bytes: &[u8], at: usize| Some(usize::from(u16::from_le_bytes(*bytes.get(at..)?.first_chunk()?)));
    let long = |bytes: &[u8], at: usize| Some(u32::from_le_bytes(*bytes.get(at..)?.first_chunk()?));
    let (mut at, points) = (short(bytes, 94)?, long(bytes, 96)? as usize);
    let promised = long(bytes, 100)?;
    let mut held = 0;
    while held < promised && at + RECORD_HEAD <= points {
        at += RECORD_HEAD + short(bytes, at + 20)?;
        held += u32::from(at <= points);
        if at > points {
            break;
        }
    }
    if held == promised || !bytes.starts_with(b"LASF") {
        return None;
    }
    bytes.get_mut(100..104)?.copy_from_slice(&held.to_le_bytes());
    Some(format!("its header counts {promised} records, but only {held} fit before its points: it is read with {held}"))
}

/// The system that the records of a file state: well-known text before keys.
fn stated(header: &Header) -> Option<Stated> {
    let record = |number: u16| {
        let mut all = header.all_vlrs();
        all.find(|vlr| vlr.user_id == PROJECTION_USER && vlr.record_id == number).map(|vlr| vlr.data.as_slice())
    };
    let wkt = record(WKT_RECORD).map(String::from_utf8_lossy);
    if let Some(text) = wkt.filter(|text| !text.trim_matches(['\0', ' ', '\n']).is_empty()) {
        return Some(Stated::of_prj(text.split('\0').next().unwrap_or_default().as_bytes()));
    }
    let keys = record(KEYS_RECORD)?;
    let directory: Vec<u16> = keys.as_chunks().0.iter().map(|bytes| u16::from_le_bytes(*bytes)).collect();
    let doubles = record(DOUBLES_RECORD).unwrap_or_default();
    let doubles: Vec<f64> = doubles.as_chunks().0.iter().map(|bytes| f64::from_le_bytes(*bytes)).collect();
    let ascii = String::from_utf8_lossy(record(ASCII_RECORD).unwrap_or_default());
    GeoKeys { directory: &directory, doubles: &doubles, ascii: &ascii }.stated()
}

/// Fills batches with compressed points. Where fields are compressed apart, only those that are read are decompressed.
fn unpacked(
    bytes: Vec<u8>,
    header: &Header,
) -> Result<impl FnMut(u64, &mut PointData) -> Result<u64, String>, CodecError> {
    let fields = DecompressionSelection::base().decompress_z().decompress_rgb();
    let fields = fields.decompress_classification().decompress_flags();
    let fields = if Normals::of(header).is_some() { fields.decompress_extra_bytes() } else { fields };
    let record = header.laz_vlr().map_err(|e| damaged(&format!("its LASzip record cannot be read ({e})")))?;
    let mut source = Cursor::new(bytes);
    source.set_position(points_at(source.get_ref()) as u64);
    let mut points = LasZipDecompressor::selective(source, record, fields)
        .map_err(|e| damaged(&format!("its points cannot be decompressed ({e})")))?;
    let mut left = header.number_of_points();
    Ok(move |count: u64, batch: &mut PointData| {
        let count = count.min(left);
        left -= count;
        points.decompress_many(batch.resize_for(count as usize)).map_err(|e| e.to_string())?;
        Ok(count)
    })
}

/// Where flags and class of a point stand in its record, which depends on the format of points.
#[derive(Debug, Clone, Copy)]
struct Marks {
    withheld_at: usize,
    withheld_bit: u8,
    class_at: usize,
    class_bits: u8,
}

impl Marks {
    /// Those of formats 6 to 10, and of 0 to 5, whose class and flags share a byte.
    fn of(header: &Header) -> Self {
        if header.point_format().is_extended {
            Self { withheld_at: 15, withheld_bit: 1 << 2, class_at: 16, class_bits: u8::MAX }
        } else {
            Self { withheld_at: 15, withheld_bit: 1 << 7, class_at: 15, class_bits: 0b1_1111 }
        }
    }

    fn is_withheld(self, record: &[u8]) -> bool {
        record[self.withheld_at] & self.withheld_bit != 0
    }

    fn class(self, record: &[u8]) -> u8 {
        record[self.class_at] & self.class_bits
    }
}

fn read_points(
    header: &Header,
    mut fill: impl FnMut(u64, &mut PointData) -> Result<u64, String>,
    wanted: &dyn Fn(u8) -> bool,
    cancelled: &dyn Fn() -> bool,
) -> Result<Cloud, CodecError> {
    let promised = header.number_of_points();
    let at_once = (BATCH_BYTES / u64::from(header.point_format().len()).max(1)).clamp(1, BATCH);
    let mut batch = PointDataBuilder::new().for_header(header).build();
    let (normals, marks) = (Normals::of(header), Marks::of(header));
    let (mut cloud, mut colours) = (Cloud::default(), Vec::new());
    let (mut total, mut counts, mut is_kept) = (0, [0usize; 256], Vec::new());
    loop {
        if cancelled() {
            return Err(CodecError::new("interrupted"));
        }
        let read = fill(at_once, &mut batch).map_err(|why| cut_short(promised, total, &why))?;
        if read == 0 {
            break;
        }
        is_kept.clear();
        for record in batch.raw_bytes().chunks_exact(batch.record_len()) {
            let (is_withheld, class) = (marks.is_withheld(record), marks.class(record));
            cloud.withheld += usize::from(is_withheld);
            counts[usize::from(class)] += usize::from(!is_withheld);
            is_kept.push(!is_withheld && wanted(class));
        }
        for (((x, y), z), is_kept) in batch.x().zip(batch.y()).zip(batch.z()).zip(&is_kept) {
            let place = [x, y, z];
            if !place.iter().all(|x| x.is_finite()) {
                return Err(fault(&format!("point {total} (counted from 0): {place:?} is not finite")));
            }
            cloud.points.extend(is_kept.then_some(place));
            total += 1;
        }
        if let Some(normals) = normals {
            let records = batch.raw_bytes().chunks_exact(batch.record_len()).zip(&is_kept);
            for normal in records.filter(|(_, is_kept)| **is_kept).filter_map(|(record, _)| normals.read(record)) {
                (0..3).for_each(|axis| cloud.normals[axis] += normal[axis]);
            }
        }
        let coloured = batch.rgb().into_iter().flatten().zip(&is_kept).filter(|(_, is_kept)| **is_kept);
        colours.extend(coloured.map(|(colour, _)| <[u16; 3]>::from(colour)));
    }
    if (total as u64) < promised {
        return Err(cut_short(promised, total, "the file ends"));
    }
    if total > 0 && cloud.withheld == total {
        return Err(fault(&format!("all its {total} points are flagged as withheld, which is to say deleted")));
    }
    if colours.len() == cloud.points.len() {
        cloud.colours = to_bytes(&colours);
    }
    let of_class = (0u8..=u8::MAX).zip(counts).filter(|(_, count)| *count > 0);
    cloud.classes = of_class.collect();
    Ok(cloud)
}

fn to_bytes(colours: &[[u16; 3]]) -> Vec<[u8; 3]> {
    let shift = if colours.iter().flatten().all(|value| *value <= 255) { 0 } else { 8 };
    colours.iter().map(|colour| colour.map(|value| (value >> shift) as u8)).collect()
}

fn cut_short(promised: u64, read: usize, why: &str) -> CodecError {
    fault(&format!(
        "the header promises {promised} points, but after some {read} {why}: it was cut short or is damaged"
    ))
}

fn fault(message: &str) -> CodecError {
    CodecError(format!("LAS file: {message}"))
}

#[cfg(test)]
#[allow(clippy::float_cmp)] // to the bit
mod tests {
    use super::*;
    use las::{Builder, Color, Point, Transform, Vector, Writer};

    fn read(bytes: Vec<u8>) -> Result<Cloud, CodecError> {
        super::read(bytes, &|| false)
    }

    /// Formats of points whose fields are compressed together, and apart.
    const FORMATS: [u8; 2] = [3, 7];

    fn written(format: u8, compressed: bool) -> Vec<u8> {
        marked(format, compressed, |_| (0, false))
    }

    /// Points whose class and flag `withheld` are told by their number.
    fn marked(format: u8, compressed: bool, mark: impl Fn(u16) -> (u8, bool)) -> Vec<u8> {
        let mut header = Builder::from((1, 4));
        header.point_format = las::point::Format::new(format).unwrap();
        header.point_format.is_compressed = compressed;
        let axis = |offset| Transform { scale: 0.001, offset };
        header.transforms = Vector { x: axis(451_000.0), y: axis(5_512_000.0), z: axis(0.0) };
        let mut writer = Writer::new(Cursor::new(Vec::new()), header.into_header().unwrap()).unwrap();
        for i in 0..2000u16 {
            let (x, y) = (451_000.0 + f64::from(i) * 0.001, 5_512_000.0 - f64::from(i) * 0.25);
            let color = Some(Color::new(i * 30, 256, 511));
            let (class, is_withheld) = mark(i);
            let classification = las::point::Classification::new(class).unwrap();
            let point = Point { x, y, z: f64::from(i % 7) * 0.013, color, gps_time: Some(0.0), ..Point::default() };
            writer.write_point(Point { classification, is_withheld, ..point }).unwrap();
        }
        writer.close().unwrap();
        writer.into_inner().unwrap().into_inner()
    }

    #[test]
    fn a_header_that_counts_fewer_points_than_there_are_is_refused() {
        // Of points whose fields are compressed together, only whole chunks tell that there are more.
        for (format, compressed) in [(3, false), (7, false), (7, true)] {
            let mut bytes = written(format, compressed);
            bytes[247..255].copy_from_slice(&1000u64.to_le_bytes());
            if bytes[107..111] != [0; 4] {
                bytes[107..111].copy_from_slice(&1000u32.to_le_bytes());
            }
            let fault = read(bytes).unwrap_err().0;
            assert!(fault.contains("counts 1000 points, and 2000 are there"), "{format} {compressed}: {fault}");
        }
    }

    #[test]
    fn integers_times_scale_plus_offset_are_read_to_the_bit() {
        for (format, compressed) in FORMATS.into_iter().flat_map(|format| [(format, false), (format, true)]) {
            let cloud = read(written(format, compressed)).unwrap();
            assert_eq!((cloud.points.len(), cloud.colours.len()), (2000, 2000));
            for (i, [x, y, z]) in cloud.points.iter().enumerate() {
                let i = i as f64;
                assert_eq!(*x, 0.001 * i + 451_000.0);
                assert_eq!(*y, 0.001 * (-250.0 * i) + 5_512_000.0);
                assert_eq!(*z, 0.001 * (13.0 * (i % 7.0)));
            }
            assert_eq!(cloud.colours[1999], [((1999u16 * 30) >> 8) as u8, 1, 1]);
        }
    }

    #[test]
    fn withheld_points_are_left_out_and_classes_are_told_apart() {
        for (format, compressed) in FORMATS.into_iter().flat_map(|format| [(format, false), (format, true)]) {
            let bytes = marked(format, compressed, |i| ([2, 5, 7, 18][usize::from(i % 4)], i % 10 == 3));
            let all = read(bytes.clone()).unwrap();
            assert_eq!((all.withheld, all.points.len(), all.colours.len()), (200, 1800, 1800), "{format} {compressed}");
            assert_eq!(all.classes, BTreeMap::from([(2, 500), (5, 400), (7, 500), (18, 400)]));
            let ground = read_classes(bytes, &|class| class == 2, &|| false).unwrap();
            assert_eq!((ground.withheld, ground.points.len(), &ground.classes), (200, 500, &all.classes));
            assert_eq!(ground.points[1][1], 0.001 * -1000.0 + 5_512_000.0);
            assert_eq!(ground.colours[499], [((1996u16 * 30) >> 8) as u8, 1, 1]);
            let message = read(marked(format, compressed, |_| (2, true))).unwrap_err().0;
            assert!(message.contains("all its 2000 points are flagged as withheld"), "{message}");
        }
    }

    #[test]
    fn damaged_files_are_errors_and_no_panics() {
        for (format, compressed) in FORMATS.into_iter().flat_map(|format| [(format, false), (format, true)]) {
            let bytes = written(format, compressed);
            let message = read(bytes[..bytes.len() * 2 / 3].to_vec()).unwrap_err().0;
            assert!(message.contains("cut short"), "{message}");
            let key = crate::numerics::random::Key([3; 32]).field();
            for trial in 0..80 {
                let mut damaged = bytes.clone();
                for hit in 0..4 {
                    let [at, value, near, _] = key.words(trial, hit);
                    let reach = if near % 2 == 0 { 400 } else { bytes.len() };
                    damaged[at as usize % reach] = value as u8;
                }
                let _ = read(damaged);
            }
        }
    }
}
