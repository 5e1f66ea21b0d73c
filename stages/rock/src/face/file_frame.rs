//! The frame of a file's coordinates, by what the file states itself and by what is given.

use super::placing;
use rockface_core::artefact::Frame;
use rockface_core::{StageError, choice};

choice! {
    /// The frame of the file's coordinates.
    pub enum FileFrame {
        /// The one that the file states itself, as a PLY of ours does, otherwise world.
        Automatic = "automatic",
        /// The input's coordinate reference system, Z up.
        World = "world",
        /// X along the face, Y up the face, Z out of the rock.
        Wall = "wall",
    }
}

/// What parameters say of the coordinates of a file.
pub struct Given<'a> {
    /// The path of the file.
    pub path: &'a str,
    /// The frame.
    pub frame: FileFrame,
    /// Whether a coordinate reference system is given.
    pub has_crs: bool,
    /// Whether there is a `.prj` beside the file.
    pub has_prj: bool,
    /// Metres of a unit.
    pub unit_m: f64,
    /// Added to every point, metres.
    pub offset_m: [f64; 3],
}

/// The wall frame, with its georeference if the file states one, where the coordinates are in it, and what there is to warn of; `stated` is the
/// frame that the file states itself.
///
/// # Errors
/// The file states the wall frame, and `crs` is a system of map coordinates; it states how the wall lies in the world, which does not hold for
/// coordinates that are scaled or shifted.
pub fn wall(stated: Option<Frame>, given: &Given) -> Result<(Option<Frame>, Option<String>), StageError> {
    let path = given.path;
    let says_wall = stated == Some(Frame::Wall);
    let overruled = |given: &str, own: &str| {
        format!(
            "`{path}` itself states the {own} frame, but its coordinates are taken to be in the {given} frame, as `frame: {given}` says; \
             `frame: {own}` goes by the file"
        )
    };
    let (is_wall, warning) = match given.frame {
        FileFrame::Automatic if says_wall && given.has_crs => {
            return Err(StageError::new(format!(
                "`{path}` itself states the wall frame, parameter `crs` a system of map coordinates"
            ))
            .hint("leave `crs` out; or say `frame: world` if it has map coordinates after all"));
        }
        FileFrame::Automatic => {
            let left_out =
                || format!("`{path}` itself states the wall frame: the system in the `.prj` beside it is left out");
            (says_wall, (says_wall && given.has_prj).then(left_out))
        }
        FileFrame::World => (false, says_wall.then(|| overruled("world", "wall"))),
        FileFrame::Wall => (true, (stated == Some(Frame::World)).then(|| overruled("wall", "world"))),
    };
    let wall = is_wall.then(|| stated.filter(|_| says_wall).unwrap_or(Frame::Wall));
    if wall.is_some_and(|wall| wall.georeference().is_some()) && placing::is_moved(given.unit_m, given.offset_m) {
        return Err(StageError::new(format!(
            "`{path}` states how its wall frame lies in the world, which `unit_m` and `offset_m` would make untrue"
        ))
        .hint("leave them out, or take the comment `rockface georeference` out of the file"));
    }
    Ok((wall, warning))
}
