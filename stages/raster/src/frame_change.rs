//! Where a transform takes what is in a frame: forwards where it begins there, backwards where it ends there.

use crate::shape::Moved;
use rockface_core::StageError;
use rockface_core::artefact::{Frame, Transform};

/// A move out of a frame.
#[derive(Debug, Clone, Copy)]
pub struct FrameChange {
    /// How points move; `None`: they stay, to the bit.
    pub moved: Option<Moved>,
    /// The frame they are in afterwards.
    pub frame: Frame,
}

/// The move of what is in `frame` by a transform.
///
/// A transform between world and wall is taken forwards where it begins in `frame` and backwards where it ends there, so
/// `wall_from_world` takes what is in the wall frame back to the world. One between other places, such as a registration,
/// is taken forwards and leaves the frame what it is.
///
/// # Errors
/// A transform that begins in the other frame and does not end in this one.
pub fn change(frame: Frame, transform: Option<&Transform>) -> Result<FrameChange, StageError> {
    let Some(transform) = transform else { return Ok(FrameChange { moved: None, frame }) };
    let named = |name: &str| [Frame::World, Frame::Wall].into_iter().find(|frame| frame.to_string() == name);
    match (named(&transform.from), named(&transform.to)) {
        (Some(from), to) if from == frame => {
            Ok(FrameChange { moved: Moved::by(transform), frame: to.unwrap_or(frame) })
        }
        (Some(from), Some(to)) if to == frame => {
            Ok(FrameChange { moved: Moved::by(&transform.inverse()), frame: from })
        }
        (None, to) => Ok(FrameChange { moved: Moved::by(transform), frame: to.unwrap_or(frame) }),
        (Some(_), _) => {
            let (from, to) = (&transform.from, &transform.to);
            let text = format!("the transform takes {from} to {to}, but what it is to move is in the {frame} frame");
            Err(StageError::new(text).hint("leave the transform out, or give what it is to move as it was before"))
        }
    }
}

#[cfg(test)]
#[allow(clippy::float_cmp)] // to the bit
mod tests {
    use super::*;
    use nalgebra::{Matrix3, Vector3};

    fn shift(from: &str, to: &str) -> Transform {
        Transform::new(from, to, &Matrix3::identity(), Vector3::zeros(), Vector3::new(1.0, 0.0, 0.0))
    }

    fn after(frame: Frame, from: &str, to: &str) -> Option<(f64, Frame)> {
        let change = change(frame, Some(&shift(from, to))).ok()?;
        Some((change.moved.unwrap().apply([0.0; 3])[0], change.frame))
    }

    #[test]
    fn a_transform_leads_out_of_either_of_its_frames() {
        assert_eq!(after(Frame::World, "world", "wall"), Some((1.0, Frame::Wall)));
        assert_eq!(after(Frame::Wall, "world", "wall"), Some((-1.0, Frame::World)));
        assert_eq!(after(Frame::Wall, "source", "target"), Some((1.0, Frame::Wall)));
        assert_eq!(after(Frame::World, "wall", "somewhere"), None);
        assert!(change(Frame::Wall, None).unwrap().moved.is_none());
    }
}
