//! Recognises the files that hold an image block by their names and first bytes, and reads the block.

use std::collections::HashMap;

use super::{CameraFile, bundler, colmap_binary, colmap_text, json, metashape};
use rockface_core::artefact::{Cameras, Frame, Image, Sensor};
use rockface_core::{StageError, fail};

/// What a file is to an image block.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Role {
    /// JSON with sensors and images.
    Json,
    /// A camera XML of Metashape.
    Metashape,
    /// A bundle file `.out` of Bundler.
    Bundler,
    /// `list.txt`, the image names of a Bundler file.
    BundlerList,
    /// The interior orientations of COLMAP as text, `cameras.txt`.
    TextCameras,
    /// The exterior orientations of COLMAP as text, `images.txt`.
    TextImages,
    /// The interior orientations of COLMAP as bytes, `cameras.bin`.
    BinaryCameras,
    /// The exterior orientations of COLMAP as bytes, `images.bin`.
    BinaryImages,
}

/// The complete file of a role.
#[derive(Debug)]
pub struct Part {
    /// What the file is to the block.
    pub role: Role,
    /// Its name without folder.
    pub name: String,
    /// The bytes of the whole file.
    pub bytes: Vec<u8>,
}

/// What a file is, by its name and first bytes; `None` where it has nothing to do with an image block.
pub fn role(name: &str, head: &[u8]) -> Option<Role> {
    let start = head.trim_ascii_start();
    let start = start.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(start);
    match name {
        "cameras.txt" if !start.starts_with(b"{") => Some(Role::TextCameras),
        "images.txt" => Some(Role::TextImages),
        "cameras.bin" => Some(Role::BinaryCameras),
        "images.bin" => Some(Role::BinaryImages),
        "list.txt" => Some(Role::BundlerList),
        _ if start.starts_with(b"{") => Some(Role::Json),
        _ if start.starts_with(b"<?xml") || start.starts_with(b"<document") => Some(Role::Metashape),
        _ if bundler::is_bundler(start) => Some(Role::Bundler),
        _ => None,
    }
}

/// Reads the one block that the parts hold. Of two models of COLMAP the binary one is read, as COLMAP does, with a warning where the other differs.
///
/// `frame` holds where the file does not name its frame; `image_size_px` is needed by Bundler, and by it alone.
///
/// # Errors
///
/// No block, several, half a model, and what the format itself refuses.
pub fn read(parts: &[Part], frame: Frame, image_size_px: Option<[u32; 2]>) -> Result<CameraFile, StageError> {
    let of = |role: Role| parts.iter().filter(move |part| part.role == role);
    let first = |role: Role| of(role).next();
    let single: Vec<&Part> =
        parts.iter().filter(|p| matches!(p.role, Role::Json | Role::Metashape | Role::Bundler)).collect();
    let text_model = first(Role::TextCameras).zip(first(Role::TextImages));
    let binary_model = first(Role::BinaryCameras).zip(first(Role::BinaryImages));
    if image_size_px.is_some() && !single.iter().any(|part| part.role == Role::Bundler) {
        fail!("`image_size_px` is for Bundler files, which have no image sizes; this file has them");
    }
    let read_text = |(cameras, images)| colmap_text::read(text(cameras)?, text(images)?, frame);
    match (&single[..], text_model, binary_model) {
        ([], Some(model), None) => read_text(model),
        ([], other, Some((cameras, images))) => {
            let mut file = colmap_binary::read(&cameras.bytes, &images.bytes, frame)?;
            file.warnings.extend(other.and_then(|other| warning_of_two(&file.cameras, &read_text(other))));
            Ok(file)
        }
        ([one], None, None) => match one.role {
            Role::Json => json::read(&one.bytes, frame),
            Role::Metashape => metashape::read(text(one)?, frame),
            _ => {
                let list = first(Role::BundlerList).map(text).transpose()?;
                let Some(size) = image_size_px else {
                    return Err(StageError::new("a Bundler file does not say how large its images are")
                        .hint("give `image_size_px: [width, height]`"));
                };
                bundler::read(text(one)?, list, size, frame)
            }
        },
        _ => Err(unclear(parts)),
    }
}

/// Numbers of two models that are nearer to each other than this share of them are the same: programs write text with fewer digits.
const SAME: f64 = 1e-6;

/// What to say of a text model beside the binary one that was read; `None` where both are one block.
fn warning_of_two(read: &Cameras, other: &Result<CameraFile, StageError>) -> Option<String> {
    let difference = match other {
        Err(error) => format!("the text model cannot be read ({})", error.message),
        Ok(other) => format!("they differ: {}", difference(read, &other.cameras)?),
    };
    Some(format!(
        "two COLMAP models are in the folder, as `.bin` and as `.txt`, and {difference}; the binary one is taken, as COLMAP does; `/*.txt` after the \
         folder in `path` takes the text"
    ))
}

/// What is different in two models of one folder, first of all their images.
fn difference(binary: &Cameras, text: &Cameras) -> Option<String> {
    let [ours, theirs] = [binary.images.len(), text.images.len()];
    if ours != theirs {
        return Some(format!("images: {ours} in the binary one, {theirs} in the text"));
    }
    let others: HashMap<&str, &Image> = text.images.iter().map(|image| (image.name.as_str(), image)).collect();
    let far = |a: f64, b: f64| (a - b).abs() > SAME * a.abs().max(b.abs()).max(1.0);
    binary.images.iter().find_map(|image| {
        let name = &image.name;
        let Some(other) = others.get(name.as_str()) else {
            return Some(format!("image `{name}` is in the binary one only"));
        };
        let is_elsewhere = (0..3).any(|axis| far(image.centre_m[axis], other.centre_m[axis]))
            || image.rotation().angle_to(&other.rotation()) > SAME;
        let [own, others] = [(binary, image), (text, *other)].map(|(block, image)| block.sensor(image));
        let numbers = |s: &Sensor| [[s.f, s.cx, s.cy, s.b1], s.k, [s.b2, s.p[0], s.p[1], 0.0]].concat();
        let is_other = (own.width_px, own.height_px) != (others.width_px, others.height_px)
            || numbers(own).into_iter().zip(numbers(others)).any(|(a, b)| far(a, b));
        let what = if is_elsewhere { "another orientation" } else { "another camera" };
        (is_elsewhere || is_other).then(|| format!("image `{name}` has {what}"))
    })
}

fn text(part: &Part) -> Result<&str, StageError> {
    let text =
        std::str::from_utf8(&part.bytes).map_err(|e| StageError::new(format!("{}: not UTF-8: {e}", part.name)))?;
    Ok(text.trim_start_matches('\u{feff}'))
}

fn unclear(parts: &[Part]) -> StageError {
    let names: Vec<&str> = parts.iter().map(|part| part.name.as_str()).collect();
    let missing = |a: Role, b: Role, name: &str| {
        let has = |role| parts.iter().any(|part| part.role == role);
        (has(a) && !has(b)).then(|| format!(", but no {name}"))
    };
    let half = missing(Role::TextCameras, Role::TextImages, "images.txt")
        .or_else(|| missing(Role::TextImages, Role::TextCameras, "cameras.txt"))
        .or_else(|| missing(Role::BinaryCameras, Role::BinaryImages, "images.bin"))
        .or_else(|| missing(Role::BinaryImages, Role::BinaryCameras, "cameras.bin"));
    StageError::new(format!("one image block is needed; found [{}]{}", names.join(", "), half.unwrap_or_default()))
        .hint("name one JSON, XML or Bundler file, or the folder of one COLMAP model or Bundler file")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn part(name: &str, bytes: &[u8]) -> Part {
        let role = role(name, bytes).unwrap_or_else(|| panic!("{name} has no role"));
        Part { role, name: name.to_owned(), bytes: bytes.to_vec() }
    }

    #[test]
    fn files_are_known_by_name_and_start() {
        assert_eq!(role("a.json", b"\n {"), Some(Role::Json));
        assert_eq!(role("a.xml", b"\xEF\xBB\xBF<?xml "), Some(Role::Metashape));
        assert_eq!(role("bundle.out", b"# Bundle file v0.3"), Some(Role::Bundler));
        assert_eq!(role("cameras.txt", b"# c"), Some(Role::TextCameras));
        assert_eq!(role("cameras.txt", b"{"), Some(Role::Json));
        assert_eq!((role("a.jpg", b"\xFF\xD8"), role("points3D.txt", b"1")), (None, None));
    }

    #[test]
    fn no_block_or_several_are_refused() {
        let says = |parts: &[Part], size: Option<[u32; 2]>, text: &str| {
            let message = read(parts, Frame::World, size).unwrap_err().message;
            assert!(message.contains(text), "{message}");
        };
        says(&[part("a.json", b"{}"), part("b.json", b"{}")], None, "found [a.json, b.json]");
        says(&[part("cameras.txt", b"#")], None, "found [cameras.txt], but no images.txt");
        says(&[part("images.bin", b"#"), part("list.txt", b"")], None, "but no cameras.bin");
        says(&[part("b.out", b"# Bundle file v0.3\n0 0")], None, "how large its images are");
        says(&[part("a.json", b"{}")], Some([9, 7]), "`image_size_px` is for Bundler files");
        says(&[], None, "found []");
    }

    #[test]
    fn of_two_models_the_binary_one_is_read_and_another_text_is_warned_of() {
        let camera = b"1 PINHOLE 9 7 9 9 1 1";
        let model = |images: &[u8]| [part("cameras.txt", camera), part("images.txt", images)];
        let line = b"1 1 0 0 0 0 0 0 1 a.png\n\n";
        let block = read(&model(line), Frame::World, None).unwrap();
        assert!(block.warnings.is_empty());
        let found = |[cameras, images]: [Part; 2]| {
            let binary = colmap_binary::write(&block.cameras).unwrap();
            let binary =
                binary.iter().filter(|(name, _)| *name != "points3D.bin").map(|(name, bytes)| part(name, bytes));
            let parts: Vec<Part> = [cameras, images].into_iter().chain(binary).collect();
            let file = read(&parts, Frame::World, None).unwrap();
            assert_eq!((file.cameras.images.len(), file.cameras.images[0].name.as_str()), (1, "a.png"));
            file.warnings
        };
        assert!(found(model(line)).is_empty());
        assert!(found(model(b"1 1 0 0 0 0 0 1e-9 1 a.png\n\n")).is_empty());
        let says = |images: &[u8], text: &str| {
            let warnings = found(model(images));
            assert!(warnings.len() == 1 && warnings[0].contains(text), "{warnings:?}");
            assert!(
                warnings[0].contains("the binary one is taken") && warnings[0].contains("`/*.txt`"),
                "{warnings:?}"
            );
        };
        says(b"1 1 0 0 0 0 0 0.5 1 a.png\n\n", "image `a.png` has another orientation");
        says(b"1 1 0 0 0 0 0 0 1 b.png\n\n", "image `a.png` is in the binary one only");
        says(b"1 1 0 0 0 0 0 0 1 a.png\n\n2 1 0 0 0 0 0 0 1 b.png\n\n", "images: 1 in the binary one, 2 in the text");
        says(b"broken", "the text model cannot be read");
        let [_, images] = model(line);
        let warnings = found([part("cameras.txt", b"1 PINHOLE 9 7 8 8 1 1"), images]);
        assert!(warnings[0].contains("image `a.png` has another camera"), "{warnings:?}");
    }
}
