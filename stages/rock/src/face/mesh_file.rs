//! Mesh files of several formats, told apart by their content.

use super::{obj, stl};
use rockface_core::artefact::{CodecError, Mesh};
use rockface_core::format::ply;

/// Reads a mesh from a PLY, OBJ or STL file, text or binary.
///
/// # Errors
/// What is wrong in the file and where, or that it is of another format; `cancelled` became true.
pub fn read(bytes: &[u8], cancelled: &dyn Fn() -> bool) -> Result<Mesh, CodecError> {
    if bytes.starts_with(b"ply") {
        ply::read_mesh(bytes)
    } else if bytes.starts_with(b"LASF") {
        Err(CodecError::new("it is a LAS or LAZ point cloud; `import-cloud` makes a mesh of it"))
    } else if [b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"].iter().any(|start| bytes.starts_with(*start)) {
        Err(CodecError::new(
            "it is a TIFF: `import-rasters` reads elevations, and `triangulate-surface` makes a mesh of them",
        ))
    } else if bytes.starts_with(b"glTF") {
        Err(CodecError::new(
            "it is glTF, which is not read: write the mesh as PLY, OBJ or STL (Blender and MeshLab do)",
        ))
    } else if obj::is_obj(bytes) {
        obj::read(bytes, cancelled)
    } else if stl::is_stl(bytes) {
        stl::read(bytes)
    } else {
        Err(CodecError::new(
            "its content is not PLY, OBJ or STL; convert it, or use `import-cloud` for columns of points",
        ))
    }
}

/// The beginning of a word for a message. Of a file that was not meant to be shown, which a link may lead to, it shows no more.
pub(super) fn short(word: &str) -> String {
    const LETTERS: usize = 20;
    word.chars().take(LETTERS).collect()
}
