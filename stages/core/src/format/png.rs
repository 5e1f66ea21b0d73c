//! PNG files: pictures as red, green and blue, eight bits each.

use crate::artefact::sketch::PictureSketch;
use crate::artefact::{CodecError, Preview};

/// Bytes of a decoded picture at most, so that a damaged header asks for no more memory than there is.
const DECODED_BYTES: usize = 1 << 28;

/// The PNG file of red, green and blue by row from the top.
pub fn write(width: usize, height: usize, rgb: &[u8]) -> Result<Vec<u8>, CodecError> {
    let fault = |e: png::EncodingError| CodecError::new(format!("cannot write the picture: {e}"));
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width as u32, height as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(png::Compression::Fast);
    let mut writer = encoder.write_header().map_err(fault)?;
    writer.write_image_data(rgb).map_err(fault)?;
    writer.finish().map_err(fault)?;
    Ok(bytes)
}

/// The pixels of a PNG file by row, red, green and blue.
pub fn read(png: &[u8]) -> Result<Vec<[u8; 3]>, CodecError> {
    let fault = |error: png::DecodingError| CodecError(format!("not a readable PNG file: {error}"));
    let mut decoder = png::Decoder::new(std::io::Cursor::new(png));
    decoder.set_transformations(png::Transformations::normalize_to_color8());
    let mut reader = decoder.read_info().map_err(fault)?;
    let bytes = reader
        .output_buffer_size()
        .filter(|bytes| *bytes <= DECODED_BYTES)
        .ok_or_else(|| CodecError::new("a PNG file too large to be read"))?;
    let mut samples = vec![0; bytes];
    let info = reader.next_frame(&mut samples).map_err(fault)?;
    let of = |pixel: &[u8]| match *pixel {
        [r, g, b] | [r, g, b, _] => [r, g, b],
        [grey, ..] => [grey; 3],
        [] => [0; 3],
    };
    Ok(samples.chunks_exact(info.color_type.samples()).map(of).collect())
}

impl PictureSketch {
    /// Its pixels by row, red, green and blue.
    ///
    /// # Errors
    /// A file that is no PNG.
    pub fn pixels(&self) -> Result<Vec<[u8; 3]>, CodecError> {
        read(&self.png)
    }
}

impl Preview {
    /// The picture as a PNG file.
    ///
    /// # Errors
    /// That of the encoder.
    pub fn to_png(&self) -> Result<Vec<u8>, CodecError> {
        write(self.width, self.height, &self.rgb)
    }
}
