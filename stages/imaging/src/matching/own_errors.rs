//! A field of disparity errors that a step of the user's own makes: one value for each pixel of the image that is matched.

use rockface_core::StageError;
use rockface_core::artefact::Depth;

/// The channel with the errors of all pairs of the image, pixels; that of one pair is called `error_px.PAIR`.
pub const CHANNEL: &str = "error_px";

/// The errors for a pair, by row from the top; NaN where the user's matcher finds nothing.
///
/// # Errors
/// The map is not of the image that is matched, or has neither channel.
pub fn errors_of<'m>(map: &'m Depth, pair: &str, ideal: &Depth) -> Result<&'m [f32], StageError> {
    let (image, name) = (&ideal.image.name, &map.image.name);
    if image != name {
        let text = format!("`errors` is of image `{name}`, the depth map that is made of image `{image}`");
        return Err(StageError::new(text).hint("make the errors from the ideal depth map of that image"));
    }
    if (map.width, map.height) != (ideal.width, ideal.height) {
        let text = format!(
            "`errors` has {} x {} pixels, the depth map of image `{image}` {} x {}",
            map.width, map.height, ideal.width, ideal.height
        );
        return Err(StageError::new(text).hint("one error for each pixel of the ideal depth map"));
    }
    let own = map.channels.get(&format!("{CHANNEL}.{pair}")).or_else(|| map.channels.get(CHANNEL));
    let named = || map.channels.keys().map(String::as_str).collect::<Vec<_>>().join(", ");
    own.map(Vec::as_slice).ok_or_else(|| {
        let text = format!("`errors` has neither channel `{CHANNEL}` nor `{CHANNEL}.{pair}`; it has: {}", named());
        StageError::new(text).hint("in Python: `depth.with_channels(error_px=...)`")
    })
}
