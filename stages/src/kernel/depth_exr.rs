//! placeholder
use crate::artefact::{CodecError, Depth};
/// w
pub fn write(_: &Depth) -> Result<Vec<u8>, CodecError> {
    Err(CodecError::new("not yet"))
}
/// r
pub fn read(_: &[u8]) -> Result<Depth, CodecError> {
    Err(CodecError::new("not yet"))
}
