//! Depth maps as OpenEXR: channel `Z` and any further ones as 32-bit floats, the camera in one text attribute.
//!
//! Scan lines are kept uncompressed: noise does not compress, and 2 million pixels are written in a few milliseconds.

use std::collections::BTreeMap;
use std::io::Cursor;

use exr::block::lines::LineRefMut;
use exr::image::write::samples::{SamplesWriter, WritableSamples};
use exr::math::RoundingMode;
use exr::meta::MetaData;
use exr::meta::attribute::{AttributeValue, LevelMode, SampleType, Text};
use exr::meta::header::{Header, ImageAttributes, LayerAttributes};
use exr::prelude::{
    AnyChannel, AnyChannels, Encoding, FlatSamples, Image as ExrImage, Layer, ReadChannels, ReadLayers, WritableImage,
    read as reader,
};

use crate::artefact::{CodecError, Depth, Frame, Image, Sensor};
use crate::limits;

const DEPTH_CHANNEL: &str = "Z";
/// The one attribute of our own: the crate keeps them unordered, so a second one would make the bytes vary.
const CAMERA_ATTRIBUTE: &str = "rockface.depth";

const CONVENTION: &str = "Z: depth along the optical axis in metres (not distance along the ray), NaN = none, at pixel centres. \
     Depth-map pixel (u, v) is image position ((u + 0.5) s - 0.5, (v + 0.5) s - 0.5), s = downscale, centre of the first \
     pixel = (0, 0). Point = C + Z R^T (x, y, 1), (x, y) = undistorted normalised coordinates (OpenCV model), camera x \
     right, y down, z forward; camera_from_object is the quaternion (w, x, y, z) of R, centre_m is C. Disparities and \
     noise are in depth-map pixels.";

/// Added where there are further channels.
const FURTHER: &str = " range: distance along the ray in metres. triangle: number in the mesh, from 0. valid: 1 where there is a depth, \
     else 0. disparity = disparity.ideal + noise.local + noise.regular + noise.blunder + noise.sub_pixel, terms that are not \
     there being zero; disparity.ideal is that of the true projections rectified by the noisy cameras. y_parallax: rectified \
     row in the first image less that in the second.";

/// What a depth map is besides its channels.
#[derive(PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct Camera {
    frame: Frame,
    downscale: u32,
    sensor: Sensor,
    image: Image,
}

/// Writes a depth map; equal maps have equal bytes and NaN keeps its bits.
pub fn write(depth: &Depth) -> Result<Vec<u8>, CodecError> {
    let further = if depth.channels.is_empty() { "" } else { FURTHER };
    let comments = Some(text(&format!("{CONVENTION}{further}"))?);
    let mut attributes = LayerAttributes { comments, ..LayerAttributes::default() };
    attributes.other.insert(text(CAMERA_ATTRIBUTE)?, AttributeValue::Text(text(&ascii_json(depth)?)?));
    let channels = AnyChannels::sort(channels(depth)?.into_iter().collect());
    let layer = Layer::new((depth.width, depth.height), attributes, Encoding::UNCOMPRESSED, channels);
    let image = ExrImage::new(ImageAttributes::with_size((depth.width, depth.height)), layer);
    // Every line has eight bytes before its values, and eight in the table of offsets.
    let size = (4 * depth.width * (1 + depth.channels.len()) + 16) * depth.height + 8192;
    let mut bytes = Cursor::new(Vec::with_capacity(size));
    image
        .write()
        .non_parallel()
        .to_buffered(&mut bytes)
        .map_err(|e| CodecError(format!("cannot write OpenEXR: {e}")))?;
    Ok(bytes.into_inner())
}

/// The values of a channel where they are, so that the largest maps are not copied to be written.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Values<'a> {
    values: &'a [f32],
    width: usize,
}

impl<'a> WritableSamples<'_> for Values<'a> {
    type Writer = Values<'a>;

    fn sample_type(&self) -> SampleType {
        SampleType::F32
    }

    fn infer_level_modes(&self) -> (LevelMode, RoundingMode) {
        (LevelMode::Singular, RoundingMode::Down)
    }

    fn create_samples_writer(&self, _: &Header) -> Self::Writer {
        *self
    }
}

impl SamplesWriter for Values<'_> {
    fn extract_line(&self, line: LineRefMut<'_>) {
        let first = line.location.position.y() * self.width + line.location.position.x();
        let values = &self.values[first..first + line.location.sample_count];
        line.write_samples_from_slice(values).expect("room for the line in the memory of its block");
    }
}

fn channels(depth: &Depth) -> Result<Vec<AnyChannel<Values<'_>>>, CodecError> {
    let (width, height) = (depth.width, depth.height);
    if width == 0 || height == 0 {
        return Err(CodecError(format!("a depth map of {width} x {height} pixels cannot be kept as OpenEXR")));
    }
    let named = depth.channels.iter().map(|(name, values)| (name.as_str(), values));
    std::iter::once((DEPTH_CHANNEL, &depth.z)).chain(named).map(|(name, values)| channel(depth, name, values)).collect()
}

fn channel<'a>(depth: &Depth, name: &str, values: &'a [f32]) -> Result<AnyChannel<Values<'a>>, CodecError> {
    let (width, height, found) = (depth.width, depth.height, values.len());
    if Some(found) != width.checked_mul(height) {
        return Err(CodecError(format!("channel `{name}` has {found} values, {width} x {height} are needed")));
    }
    let usable = !name.is_empty() && name.len() < 256 && name.bytes().all(|b| b.is_ascii_graphic());
    if !usable || (name == DEPTH_CHANNEL && depth.channels.contains_key(name)) {
        return Err(CodecError(format!("`{name}` cannot be the name of a further channel of a depth map")));
    }
    Ok(AnyChannel::new(text(name)?, Values { values, width }))
}

fn text(value: &str) -> Result<Text, CodecError> {
    Text::new_or_none(value).ok_or_else(|| CodecError(format!("`{value}` cannot be written as OpenEXR text")))
}

/// The camera as JSON in which every character beyond ASCII is escaped, since OpenEXR text has no encoding.
fn ascii_json(depth: &Depth) -> Result<String, CodecError> {
    let camera = Camera {
        frame: depth.frame,
        downscale: depth.downscale,
        sensor: depth.sensor.clone(),
        image: depth.image.clone(),
    };
    let failed = |e: serde_json::Error| CodecError(format!("the camera of a depth map cannot be written: {e}"));
    let json = serde_json::to_string(&camera).map_err(failed)?;
    if serde_json::from_str::<Camera>(&json).map_err(failed)? != camera {
        return Err(CodecError::new("the camera of a depth map holds numbers that are not finite"));
    }
    Ok(json.chars().map(|c| if c.is_ascii() { c.to_string() } else { escaped(c) }).collect())
}

fn escaped(c: char) -> String {
    let units: Vec<_> = c.encode_utf16(&mut [0; 2]).iter().map(|unit| format!("\\u{unit:04x}")).collect();
    units.concat()
}

/// Reads a depth map, whatever lossless compression another program may have given it.
pub fn read(bytes: &[u8]) -> Result<Depth, CodecError> {
    check_header(bytes)?;
    let image = reader()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .non_parallel()
        .from_buffered(Cursor::new(bytes))
        .map_err(|e| unreadable(&e))?;
    let camera = camera(&image.attributes, &image.layer_data.attributes)?;
    let size = image.layer_data.size;
    check_size(&camera, [size.0, size.1])?;
    let mut channels = float_channels(image.layer_data.channel_data)?;
    let z = channels.remove(DEPTH_CHANNEL).ok_or_else(|| CodecError::new("OpenEXR depth map: no channel `Z`"))?;
    Ok(Depth {
        frame: camera.frame,
        sensor: camera.sensor,
        image: camera.image,
        downscale: camera.downscale,
        width: size.0,
        height: size.1,
        z,
        channels,
    })
}

/// Each pixel of a map has the ray of its place: a map of another size than its camera, such as one that was cut, would be somewhere else.
fn check_size(camera: &Camera, [width, height]: [usize; 2]) -> Result<(), CodecError> {
    let Camera { sensor, downscale, .. } = camera;
    let side = |pixels: u32| pixels.checked_div(*downscale).unwrap_or(0) as usize;
    let wanted = [side(sensor.width_px), side(sensor.height_px)];
    if wanted != [width, height] {
        return Err(CodecError(format!(
            "the depth map has {width} x {height} pixels, its camera with downscale {downscale} has {} x {}: set pixels that are not wanted to \
             NaN rather than cutting them off",
            wanted[0], wanted[1]
        )));
    }
    Ok(())
}

fn unreadable(error: &exr::error::Error) -> CodecError {
    CodecError(format!("not a readable OpenEXR file: {error}; it is cut short or damaged"))
}

/// Refuses what the decoder should not be trusted with: other layouts, and sizes the bytes cannot hold.
fn check_header(bytes: &[u8]) -> Result<(), CodecError> {
    let meta = MetaData::read_from_buffered(Cursor::new(bytes), true).map_err(|e| unreadable(&e))?;
    let [header] = meta.headers.as_slice() else {
        return Err(CodecError(format!("OpenEXR depth map: one layer is needed, found {}", meta.headers.len())));
    };
    let channels = &header.channels.list;
    if header.deep || channels.iter().any(|c| c.sample_type != SampleType::F32 || c.sampling.area() != 1) {
        return Err(CodecError::new("OpenEXR depth map: every channel must be 32-bit float at full resolution"));
    }
    let (w, h, found) = (header.layer_size.0, header.layer_size.1, bytes.len());
    let samples = sample_bytes(header, channels.len());
    if samples.is_none_or(|samples| least_bytes(header, samples) > found) {
        return Err(CodecError(format!(
            "OpenEXR depth map: {w} x {h} pixels do not fit in {found} bytes; it is cut short or damaged"
        )));
    }
    let what = format!("OpenEXR depth map of {found} bytes: {w} x {h} pixels of {} channels", channels.len());
    limits::affordable(&what, samples.map(|bytes| bytes as u64))
}

fn sample_bytes(header: &Header, channels: usize) -> Option<usize> {
    header.layer_size.0.checked_mul(header.layer_size.1)?.checked_mul(channels)?.checked_mul(4)
}

/// The least number of bytes that can hold the samples: no compression of OpenEXR reaches 1100 : 1.
fn least_bytes(header: &Header, sample_bytes: usize) -> usize {
    let is_plain = header.compression == exr::prelude::Compression::Uncompressed;
    if is_plain { sample_bytes } else { sample_bytes / 1100 }
}

fn camera(image: &ImageAttributes, layer: &LayerAttributes) -> Result<Camera, CodecError> {
    let own = |(name, value): (&Text, &AttributeValue)| match value {
        AttributeValue::Text(json) if name.as_slice() == CAMERA_ATTRIBUTE.as_bytes() => Some(json.clone()),
        _ => None,
    };
    let json = layer.other.iter().chain(&image.other).find_map(own).ok_or_else(|| {
        CodecError(format!("OpenEXR depth map: no text attribute `{CAMERA_ATTRIBUTE}` with its camera"))
    })?;
    let camera: Camera = serde_json::from_slice(json.as_slice())
        .map_err(|e| CodecError(format!("OpenEXR depth map: bad attribute `{CAMERA_ATTRIBUTE}`: {e}")))?;
    if camera.downscale == 0 || camera.image.sensor != 0 {
        return Err(CodecError(format!(
            "OpenEXR depth map: `{CAMERA_ATTRIBUTE}` has downscale {} (at least 1) and sensor {} (0)",
            camera.downscale, camera.image.sensor
        )));
    }
    Ok(camera)
}

fn float_channels(channels: AnyChannels<FlatSamples>) -> Result<BTreeMap<String, Vec<f32>>, CodecError> {
    let named = |channel: AnyChannel<FlatSamples>| match channel.sample_data {
        FlatSamples::F32(values) => Ok((channel.name.to_string(), values)),
        _ => Err(CodecError(format!("OpenEXR depth map: channel `{}` is not 32-bit float", channel.name))),
    };
    channels.list.into_iter().map(named).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample() -> Depth {
        let sensor = Sensor {
            name: "Kamera Süd \u{1f5fb}".into(),
            width_px: 6,
            height_px: 4,
            f: 10.1 + 0.2,
            cx: 2.5,
            cy: 1.5,
            b1: 0.0,
            b2: -0.0,
            k: [0.1, 1e-300, 0.0, 0.0],
            p: [0.0; 2],
        };
        let image =
            Image { name: "left".into(), sensor: 0, camera_from_object: [1.0, 0.0, 0.0, 0.0], centre_m: [0.1; 3] };
        let odd = vec![f32::NAN, f32::from_bits(0x7fc0_1234), -0.0, f32::INFINITY, 1e-45, 7.25];
        let channels =
            BTreeMap::from([("noise.local".to_owned(), odd.clone()), ("disparity".to_owned(), vec![3.5; 6])]);
        Depth { frame: Frame::Wall, sensor, image, downscale: 2, width: 3, height: 2, z: odd, channels }
    }

    #[test]
    fn comes_back_bit_for_bit_with_equal_bytes() {
        let bytes = write(&sample()).unwrap();
        assert_eq!(read(&bytes).unwrap(), sample());
        assert_eq!(write(&read(&bytes).unwrap()).unwrap(), bytes);
        assert!(bytes.windows(CONVENTION.len()).any(|window| window == CONVENTION.as_bytes()));
    }

    #[test]
    fn a_map_of_another_size_than_its_camera_is_refused() {
        let cut = Depth { height: 1, z: vec![1.0; 3], channels: BTreeMap::new(), ..sample() };
        assert!(
            read(&write(&cut).unwrap()).unwrap_err().0.contains("3 x 1 pixels, its camera with downscale 2 has 3 x 2")
        );
        let none = Depth { downscale: 0, ..sample() };
        assert!(read(&write(&none).unwrap()).is_err());
    }

    #[test]
    fn a_cut_file_is_refused_at_every_length() {
        crate::testing::refuses_every_beginning(&write(&sample()).unwrap(), read);
    }

    #[test]
    fn damaged_bytes_never_panic() {
        let bytes = write(&sample()).unwrap();
        for place in 0..bytes.len() {
            for value in [0, 1, 0x7f, 0x80, 0xff, bytes[place] ^ 1] {
                let mut damaged = bytes.clone();
                damaged[place] = value;
                if let Ok(depth) = read(&damaged) {
                    assert_eq!(depth.z.len(), depth.width * depth.height);
                }
            }
        }
    }

    #[test]
    fn what_cannot_be_kept_is_refused() {
        let mut depth = sample();
        depth.channels.insert("Z".into(), vec![0.0; 6]);
        assert!(write(&depth).unwrap_err().0.contains("`Z`"));
        let mut depth = sample();
        depth.z.pop();
        assert!(write(&depth).unwrap_err().0.contains("5 values"));
        let mut depth = sample();
        depth.sensor.f = f64::NAN;
        assert!(write(&depth).is_err());
    }
}
