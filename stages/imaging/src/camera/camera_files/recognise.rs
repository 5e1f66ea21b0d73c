//! Recognises the files that hold an image block by their names and first bytes, and reads the block.

use super::{CameraFile, bundler, colmap_binary, colmap_text, json, metashape};
use rockface_core::artefact::Frame;
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

/// Reads the one block that the parts hold. A text model of COLMAP is preferred to a binary one beside it.
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
    match (&single[..], text_model, binary_model) {
        ([], Some((cameras, images)), _) => colmap_text::read(text(cameras)?, text(images)?, frame),
        ([], None, Some((cameras, images))) => colmap_binary::read(&cameras.bytes, &images.bytes, frame),
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
    fn a_folder_with_both_models_is_read_once() {
        let text = [part("cameras.txt", b"1 PINHOLE 9 7 9 9 1 1"), part("images.txt", b"1 1 0 0 0 0 0 0 1 a.png\n\n")];
        let [cameras, images] = text;
        let parts = [cameras, images, part("cameras.bin", b"broken"), part("images.bin", b"broken")];
        assert_eq!(read(&parts, Frame::World, None).unwrap().cameras.images[0].name, "a.png");
    }
}
