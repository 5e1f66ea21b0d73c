//! Whether a LAS or LAZ file holds the bytes it claims, checked before a library reserves memory by its counts.
//!
//! Layout: ASPRS LAS 1.4 R15 for headers and records; the `LASzip` specification (Isenburg, revision 1.4.4) for the `LASzip`
//! record, the chunk table, and the layers of a chunk.

use las::{Header, raw};

use crate::artefact::CodecError;
use crate::limits::{affordable, fits};

/// Bytes of the head of an extended record, and where its length stands in it.
const EXTENDED_HEAD: usize = 60;
const EXTENDED_LENGTH_AT: usize = 20;
/// A point compresses to a bit at the very least.
const LEAST_BITS_PER_POINT: u64 = 1;
/// Memory of a point with its colour as it is read.
const POINT_MEMORY_BYTES: u64 = 33;
/// User and number of the `LASzip` record.
const LASZIP: (&str, u16) = ("laszip encoded", 22204);
/// A chunk size that stands for chunks of their own sizes each, beside 0.
const OF_ITS_OWN: u32 = u32::MAX;

/// Refuses a file whose extended records or points do not fit into its bytes; call it before [`las::Header::new`].
pub fn check_header(bytes: &[u8]) -> Result<(), CodecError> {
    let head = raw::Header::read_from(bytes).map_err(|e| damaged(&format!("its header cannot be read ({e})")))?;
    let large = head.large_file.map_or(0, |large| large.number_of_point_records);
    let legacy = u64::from(head.number_of_point_records);
    let points = if legacy == 0 { large } else { legacy };
    let record = u64::from(head.point_data_record_length);
    let start = head.offset_to_point_data as usize;
    let Some(data) = bytes.get(start..) else {
        return Err(damaged(&format!("its points begin at byte {start} of {}", bytes.len())));
    };
    // The library multiplies these whether the points are compressed or not.
    let whole = points.checked_mul(record).and_then(|length| length.checked_add(start as u64));
    let bits = 8 * data.len() as u64;
    let is_compressed = head.point_data_record_format & 0x80 != 0;
    if whole.is_none() || record == 0 || points / LEAST_BITS_PER_POINT > bits {
        return Err(damaged(&format!("its header promises {points} points, more than the file can hold")));
    }
    if !is_compressed && !fits(points, record, data.len()) {
        let held = data.len() as u64 / record;
        return Err(damaged(&format!("its header promises {points} points, but the file ends after {held}")));
    }
    if !is_compressed {
        check_none_left(&head, points, data)?;
    }
    affordable(&format!("LAS file: {points} points"), points.checked_mul(POINT_MEMORY_BYTES))?;
    head.evlr.map_or(Ok(()), |evlr| check_extended(bytes, evlr.start_of_first_evlr))
}

/// Refuses a header that counts fewer points than the file holds before its extended records and waveforms: the others would be missing
/// without a word.
fn check_none_left(head: &raw::Header, points: u64, data: &[u8]) -> Result<(), CodecError> {
    let start = u64::from(head.offset_to_point_data);
    let after = [head.evlr.map(|evlr| evlr.start_of_first_evlr), head.start_of_waveform_data_packet_record];
    let end =
        after.into_iter().flatten().filter(|at| *at > start).map(|at| at - start).fold(data.len() as u64, u64::min);
    let record = u64::from(head.point_data_record_length).max(1);
    let held = end / record;
    // Some programs fill the last block of a file with zeros.
    let rest = &data[(points * record).min(end) as usize..end as usize];
    if held > points && rest.iter().any(|byte| *byte != 0) {
        return Err(too_few(points, held));
    }
    Ok(())
}

fn too_few(points: u64, held: u64) -> CodecError {
    let way = "write it anew with the program it came from";
    CodecError(format!("LAS file: its header counts {points} points, and {held} are there: {way}"))
}

/// The library reads the first extended record.
fn check_extended(bytes: &[u8], start: u64) -> Result<(), CodecError> {
    let record = usize::try_from(start).ok().and_then(|start| bytes.get(start..)).filter(|r| r.len() >= EXTENDED_HEAD);
    let record = record.ok_or_else(|| damaged(&format!("an extended record at byte {start} is beyond its end")))?;
    let length = u64::from_le_bytes(record[EXTENDED_LENGTH_AT..][..8].try_into().unwrap_or_default());
    if fits(length, 1, record.len() - EXTENDED_HEAD) {
        return Ok(());
    }
    Err(damaged(&format!("an extended record at byte {start} claims {length} bytes, more than the file has")))
}

/// Refuses compressed points whose chunk table or layers do not fit into the bytes of the file.
pub fn check_chunks(bytes: &[u8], header: &Header) -> Result<(), CodecError> {
    let record = header.vlrs().iter().find(|vlr| (vlr.user_id.as_str(), vlr.record_id) == LASZIP);
    let record = record.ok_or_else(|| damaged("it has no LASzip record"))?;
    let start = points_at(bytes);
    let packing = Packing::read(&record.data).ok_or_else(|| damaged("its LASzip record is cut short"))?;
    packing.check(usize::from(header.point_format().len()))?;
    let table = packing.table(bytes, start)?;
    if packing.is_layered() { packing.walk(bytes, start, table, header.number_of_points()) } else { Ok(()) }
}

/// Where the points begin: `offset_to_point_data` of the header.
pub(super) fn points_at(bytes: &[u8]) -> usize {
    number(bytes, 96).unwrap_or(0) as usize
}

fn number(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_le_bytes(*bytes.get(at..)?.first_chunk()?))
}

fn long(bytes: &[u8], at: usize) -> Option<i64> {
    Some(i64::from_le_bytes(*bytes.get(at..)?.first_chunk()?))
}

fn short(bytes: &[u8], at: usize) -> Option<u16> {
    Some(u16::from_le_bytes(*bytes.get(at..)?.first_chunk()?))
}

/// A field of a point as the `LASzip` record lists it: type, bytes, version of its compression.
struct Item {
    kind: u16,
    bytes: u16,
    version: u16,
}

impl Item {
    /// Bytes a field of this type has; `None` where the record says it (extra bytes) or for an unknown type.
    fn usual_bytes(&self) -> Option<u16> {
        [(6, 20), (7, 8), (8, 6), (9, 29), (10, 30), (11, 6), (12, 8), (13, 29)]
            .into_iter()
            .find_map(|(kind, bytes)| (kind == self.kind).then_some(bytes))
    }

    fn is_extra(&self) -> bool {
        matches!(self.kind, 0 | 14)
    }

    /// Whether fields of this type are compressed in layers.
    fn is_layered(&self) -> bool {
        (10..=14).contains(&self.kind)
    }

    fn is_sound(&self, layered: bool) -> bool {
        let version = if layered { 3..=4 } else { 1..=2 };
        let sized = if self.is_extra() { self.bytes > 0 } else { self.usual_bytes() == Some(self.bytes) };
        sized && self.is_layered() == layered && version.contains(&self.version)
    }

    /// Layers of a chunk that hold this field.
    fn layers(&self) -> usize {
        match self.kind {
            10 => 9,
            12 => 2,
            14 => usize::from(self.bytes),
            _ => 1,
        }
    }
}

/// How points are packed, as the `LASzip` record says it.
struct Packing {
    compressor: u16,
    chunk_size: u32,
    items: Vec<Item>,
}

impl Packing {
    fn read(record: &[u8]) -> Option<Self> {
        let count = usize::from(short(record, 32)?);
        let item = |place: usize| {
            let at = 34 + 6 * place;
            Some(Item { kind: short(record, at)?, bytes: short(record, at + 2)?, version: short(record, at + 4)? })
        };
        let items = (0..count).map(item).collect::<Option<_>>()?;
        Some(Self { compressor: short(record, 0)?, chunk_size: number(record, 12)?, items })
    }

    /// Compressor 1 packs all points into one chunk, 2 into several, 3 into several of a layer a field.
    fn is_layered(&self) -> bool {
        self.compressor == 3
    }

    fn check(&self, point_bytes: usize) -> Result<(), CodecError> {
        let layered = self.is_layered();
        let starts = self.items.first().is_some_and(|item| matches!(item.kind, 6 | 10));
        let total: usize = self.items.iter().map(|item| usize::from(item.bytes)).sum();
        let kinds = self.items.iter().map(|item| item.kind).collect::<std::collections::BTreeSet<_>>();
        let sound = matches!(self.compressor, 1..=3) && self.items.iter().all(|item| item.is_sound(layered));
        if starts && sound && kinds.len() == self.items.len() && total == point_bytes {
            return Ok(());
        }
        Err(damaged(&format!("its LASzip record does not describe points of {point_bytes} bytes")))
    }

    /// Where the chunk table begins; `None` where the library reads none.
    fn table(&self, bytes: &[u8], start: usize) -> Result<Option<usize>, CodecError> {
        if self.compressor == 1 {
            return Ok(None);
        }
        let beyond = |at: Option<i64>| at.filter(|at| *at > start as i64);
        let at = beyond(long(bytes, start)).or_else(|| beyond(long(bytes, bytes.len().checked_sub(8)?)));
        let at = at.and_then(|at| usize::try_from(at).ok());
        let Some((at, count)) = at.and_then(|at| Some((at, number(bytes, at.checked_add(4)?)?))) else {
            return Ok(None);
        };
        // Every chunk begins with a point that is not compressed; one without points may end them.
        let point: usize = self.items.iter().map(|item| usize::from(item.bytes)).sum();
        let held = at.saturating_sub(start) / point.max(1) + 1;
        if count as usize <= held {
            return Ok(Some(at));
        }
        Err(damaged(&format!("its chunk table claims {count} chunks, but the file has room for {held}")))
    }

    /// Goes from chunk to chunk by the sizes of their layers.
    fn walk(&self, bytes: &[u8], start: usize, table: Option<usize>, points: u64) -> Result<(), CodecError> {
        let own = matches!(self.chunk_size, 0 | OF_ITS_OWN);
        let end = table.filter(|at| *at <= bytes.len()).unwrap_or(bytes.len());
        let (mut at, mut passed, mut held, mut chunk) = (start + 8, 0u64, 0u64, 0u64);
        // Chunks of their own sizes are counted by the table, which only the library reads: all of them are checked.
        // Further chunks of the usual size would be points that the header does not count.
        while passed < points || (table.is_some() && at < end) {
            let (count, next) = self.chunk(&bytes[..end], at).ok_or_else(|| {
                damaged(&format!("chunk {chunk} (counted from 0) at byte {at} claims more bytes than the file has"))
            })?;
            passed = passed.saturating_add(u64::from(if own { count } else { self.chunk_size }));
            held = held.saturating_add(u64::from(count));
            (at, chunk) = (next, chunk + 1);
        }
        if held > points { Err(too_few(points, held)) } else { Ok(()) }
    }

    /// How many points a chunk says it has, and where the next begins: a point, their number, sizes of layers, layers.
    fn chunk(&self, bytes: &[u8], at: usize) -> Option<(u32, usize)> {
        let point: usize = self.items.iter().map(|item| usize::from(item.bytes)).sum();
        let layers: usize = self.items.iter().map(Item::layers).sum();
        let counted = at.checked_add(point)?;
        let count = number(bytes, counted)?;
        let sizes = bytes.get(counted + 4..)?.get(..4 * layers)?;
        let sizes = sizes.chunks_exact(4).map(|size| u64::from(number(size, 0).unwrap_or(u32::MAX)));
        let next = (counted + 4 + 4 * layers) as u64 + sizes.sum::<u64>();
        usize::try_from(next).ok().filter(|next| *next <= bytes.len()).map(|next| (count, next))
    }
}

/// A fault of the bytes.
pub fn damaged(what: &str) -> CodecError {
    CodecError(format!("LAS file: {what}: it was cut short or is damaged"))
}
