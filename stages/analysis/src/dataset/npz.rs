//! NumPy archives: arrays in the NPY format, version 1.0, in a ZIP file, as `numpy.load` reads them.

use std::io::{Cursor, Write};

use rockface_core::StageError;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

/// An array of an archive, by row.
#[derive(Debug, Clone, PartialEq)]
pub enum Array {
    /// 32-bit floats, `<f4`.
    Floats(Vec<f32>),
    /// 64-bit floats, `<f8`.
    Doubles(Vec<f64>),
    /// Whole numbers from 0 to 255.
    Bytes(Vec<u8>),
    /// Whole numbers from 0 to 65535.
    Words(Vec<u16>),
}

/// Writes an archive of arrays, each with its name and shape; equal arrays give equal bytes.
///
/// # Errors
/// What the ZIP library refuses.
pub fn write(arrays: &[(&str, &[usize], Array)]) -> Result<Vec<u8>, StageError> {
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    let options = SimpleFileOptions::default().compression_method(CompressionMethod::Deflated);
    for (name, shape, array) in arrays {
        archive.start_file(format!("{name}.npy"), options).map_err(|e| format!("cannot write `{name}`: {e}"))?;
        archive.write_all(&npy(shape, array)).map_err(|e| format!("cannot write `{name}`: {e}"))?;
    }
    Ok(archive.finish().map_err(|e| format!("cannot write an archive: {e}"))?.into_inner())
}

/// One array as an NPY file.
fn npy(shape: &[usize], array: &Array) -> Vec<u8> {
    let (kind, data): (&str, Vec<u8>) = match array {
        Array::Floats(values) => ("<f4", values.iter().flat_map(|value| value.to_le_bytes()).collect()),
        Array::Doubles(values) => ("<f8", values.iter().flat_map(|value| value.to_le_bytes()).collect()),
        Array::Bytes(values) => ("|u1", values.clone()),
        Array::Words(values) => ("<u2", values.iter().flat_map(|value| value.to_le_bytes()).collect()),
    };
    let shape: String = shape.iter().map(|length| format!("{length},")).collect();
    let mut header = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': ({shape}), }}");
    // Magic, version and length are 10 bytes; the header ends with a line feed at a multiple of 64.
    header.push_str(&" ".repeat(63 - (10 + header.len()) % 64));
    header.push('\n');
    let mut file = b"\x93NUMPY\x01\x00".to_vec();
    file.extend((header.len() as u16).to_le_bytes());
    file.extend(header.into_bytes());
    file.extend(data);
    file
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_array_has_the_header_numpy_expects() {
        let file = npy(&[2, 1], &Array::Words(vec![7, 300]));
        assert_eq!(&file[..8], b"\x93NUMPY\x01\x00");
        let length = usize::from(u16::from_le_bytes([file[8], file[9]]));
        assert_eq!((10 + length) % 64, 0);
        let header = std::str::from_utf8(&file[10..10 + length]).unwrap();
        assert!(
            header.starts_with("{'descr': '<u2', 'fortran_order': False, 'shape': (2,1,), }") && header.ends_with('\n')
        );
        assert_eq!(&file[10 + length..], [7, 0, 44, 1]);
    }

    #[test]
    fn equal_arrays_give_equal_archives() {
        let arrays =
            || [("a", &[3usize][..], Array::Floats(vec![1.0, f32::NAN, -2.5])), ("b", &[][..], Array::Bytes(vec![1]))];
        let file = write(&arrays()).unwrap();
        assert!(file.starts_with(b"PK") && file == write(&arrays()).unwrap());
    }
}
