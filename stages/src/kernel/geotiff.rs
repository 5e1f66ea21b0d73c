//! placeholder
use crate::artefact::{CodecError, Raster};
/// w
pub fn write(_: &Raster) -> Result<Vec<u8>, CodecError> {
    Err(CodecError::new("not yet"))
}
/// r
pub fn read(_: &[u8]) -> Result<Raster, CodecError> {
    Err(CodecError::new("not yet"))
}
