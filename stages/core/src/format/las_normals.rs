//! Normals of the points of LAS and LAZ files: extra dimensions that programs describe in a record of the file.
//!
//! Described by the extra-bytes record of the ASPRS specification (LAS 1.4 R15, section "Extra Bytes"). `CloudCompare`, PDAL and our own
//! export name them `NormalX`, `NormalY`, `NormalZ`; `nx`, `ny`, `nz` and one dimension `normals` of three values are read too.

use las::Header;

/// User of the record that describes extra dimensions.
const USER: &str = "LASF_Spec";
/// Number of that record.
pub(super) const RECORD: u16 = 4;
/// Bytes of its entry for one dimension.
pub(super) const ENTRY_BYTES: usize = 192;
/// Bytes of values by the numbers of the specification: unsigned and signed integers of 8 to 64 bits in turn, floats of 32 and 64 bits.
const SIZES: [usize; 10] = [1, 1, 2, 2, 4, 4, 8, 8, 4, 8];
/// Options of an entry: integers count these and start there.
const HAS_SCALE: u8 = 1 << 3;
const HAS_OFFSET: u8 = 1 << 4;
/// Where scales and offsets of up to three values stand in an entry.
const SCALES_AT: usize = 112;
const OFFSETS_AT: usize = 136;

/// One value of each point.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Field {
    /// Its first byte in the record of a point.
    at: usize,
    /// Its type without dimensions, 1 to 10.
    kind: u8,
    scale: f64,
    offset: f64,
}

/// Where the normals of a file stand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Normals([Field; 3]);

impl Normals {
    /// Those that a file describes; `None` where it has none, or bytes beyond its points.
    pub fn of(header: &Header) -> Option<Self> {
        let mut records = header.all_vlrs();
        let record = records.find(|vlr| vlr.user_id == USER && vlr.record_id == RECORD)?;
        let length = usize::from(header.point_format().len());
        let extra = usize::from(header.point_format().extra_bytes);
        Self::described(&record.data, length.checked_sub(extra)?, length)
    }

    /// Those of the extra dimensions that start at a byte of the records of points, which have some length.
    fn described(record: &[u8], start: usize, length: usize) -> Option<Self> {
        let mut found = [None; 3];
        let mut at = start;
        for entry in record.as_chunks::<ENTRY_BYTES>().0 {
            // Types beyond 10 are two or three values of the types before; 0 are bytes without a meaning.
            let (kind, count) = match entry[2] {
                0 => (1, usize::from(entry[3])),
                kind => ((kind - 1) % 10 + 1, usize::from((kind - 1) / 10) + 1),
            };
            let size = SIZES[usize::from(kind) - 1];
            let axes = if entry[2] == 0 { None } else { axes(&entry[4..36], count) };
            for (place, axis) in axes.into_iter().flatten().enumerate() {
                let field = Field {
                    at: at + place * size,
                    kind,
                    scale: number(entry, HAS_SCALE, SCALES_AT + 8 * place).unwrap_or(1.0),
                    offset: number(entry, HAS_OFFSET, OFFSETS_AT + 8 * place).unwrap_or(0.0),
                };
                found[axis] = Some(field);
            }
            at += size * count;
            if at > length {
                return None;
            }
        }
        let [x, y, z] = found;
        Some(Self([x?, y?, z?]))
    }

    /// The normal in the record of a point; `None` where a value is no number.
    pub fn read(&self, point: &[u8]) -> Option<[f64; 3]> {
        let [x, y, z] = self.0.map(|field| field.read(point));
        Some([x?, y?, z?])
    }
}

impl Field {
    fn read(&self, point: &[u8]) -> Option<f64> {
        let bytes = point.get(self.at..)?;
        let value = match self.kind {
            1 => f64::from(*bytes.first()?),
            2 => f64::from(bytes.first()?.cast_signed()),
            3 => f64::from(u16::from_le_bytes(*bytes.first_chunk()?)),
            4 => f64::from(i16::from_le_bytes(*bytes.first_chunk()?)),
            5 => f64::from(u32::from_le_bytes(*bytes.first_chunk()?)),
            6 => f64::from(i32::from_le_bytes(*bytes.first_chunk()?)),
            7 => u64::from_le_bytes(*bytes.first_chunk()?) as f64,
            8 => i64::from_le_bytes(*bytes.first_chunk()?) as f64,
            9 => f64::from(f32::from_le_bytes(*bytes.first_chunk()?)),
            _ => f64::from_le_bytes(*bytes.first_chunk()?),
        };
        Some(value * self.scale + self.offset).filter(|value| value.is_finite())
    }
}

/// A number of an entry that stands there where an option is set.
fn number(entry: &[u8; ENTRY_BYTES], option: u8, at: usize) -> Option<f64> {
    let is_there = entry[3] & option != 0;
    is_there.then(|| entry.get(at..)?.first_chunk().map(|bytes| f64::from_le_bytes(*bytes))).flatten()
}

/// The axes of the normal that the values of a dimension are along; `None` where it is no part of the normal.
fn axes(name: &[u8], count: usize) -> Option<Vec<usize>> {
    let text = String::from_utf8_lossy(name.split(|byte| *byte == 0).next().unwrap_or_default()).to_ascii_lowercase();
    let text: String = text.chars().filter(char::is_ascii_alphanumeric).collect();
    match (text.as_str(), count) {
        ("normalx" | "nx", 1) => Some(vec![0]),
        ("normaly" | "ny", 1) => Some(vec![1]),
        ("normalz" | "nz", 1) => Some(vec![2]),
        ("normal" | "normals", 3) => Some(vec![0, 1, 2]),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entry(kind: u8, options: u8, name: &str) -> [u8; ENTRY_BYTES] {
        let mut entry = [0; ENTRY_BYTES];
        (entry[2], entry[3]) = (kind, options);
        entry[4..4 + name.len()].copy_from_slice(name.as_bytes());
        entry
    }

    #[test]
    fn normals_are_read_as_other_programs_write_them() {
        // Floats of 64 bits in another order behind a dimension of its own.
        let record = [entry(5, 0, "id"), entry(10, 0, "nz"), entry(10, 0, "Nx"), entry(10, 0, "normal_y")].concat();
        let values = [0.5f64, -1.0, 0.25].map(f64::to_le_bytes).concat();
        let point = [&[0; 30][..], &values].concat();
        let normals = Normals::described(&record, 26, 54).unwrap();
        assert_eq!(normals.read(&point), Some([-1.0, 0.25, 0.5]));
        assert_eq!(normals.read(&point[..50]), None);
        // Three scaled integers in one dimension.
        let mut scaled = entry(24, HAS_SCALE | HAS_OFFSET, "Normals");
        for place in 0..3 {
            scaled[SCALES_AT + 8 * place..][..8].copy_from_slice(&0.5f64.to_le_bytes());
            scaled[OFFSETS_AT + 8 * place..][..8].copy_from_slice(&0.25f64.to_le_bytes());
        }
        let point = [[-2i16, 0, 4].map(i16::to_le_bytes).concat(), vec![0; 9]].concat();
        assert_eq!(Normals::described(&scaled, 0, 15).unwrap().read(&point), Some([-0.75, 0.25, 2.25]));
    }

    #[test]
    fn what_is_no_normal_or_beyond_the_point_is_left() {
        let two = [entry(9, 0, "NormalX"), entry(9, 0, "NormalY")].concat();
        assert_eq!(Normals::described(&two, 20, 28), None);
        let three = [&two[..], &entry(9, 0, "NormalZ")].concat();
        assert_eq!(Normals::described(&three, 20, 28), None);
        let normals = Normals::described(&three, 0, 12).unwrap();
        assert_eq!(normals.read(&[0.0f32, 1.0, f32::NAN].map(f32::to_le_bytes).concat()), None);
        // Five bytes without a meaning, whatever their name.
        let behind = [&entry(0, 5, "NormalX")[..], &three].concat();
        assert!(Normals::described(&behind, 0, 17).is_some() && Normals::described(&behind, 0, 16).is_none());
        assert_eq!(Normals::described(&[0xff; 3 * ENTRY_BYTES], 0, 12), None);
    }
}
