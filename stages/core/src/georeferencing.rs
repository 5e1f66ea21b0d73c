//! How the place on the Earth travels through a step: what its inputs state is checked, and given to what it makes.

use std::sync::{Mutex, PoisonError};

use crate::artefact::{Artefact, Frame, Georeference, Kind, Transform};
use crate::crs::Crs;
use crate::{Context, Outputs, Port, StageError};

/// What the inputs of a step have stated so far, with the port of the first that did.
#[derive(Debug, Default)]
pub struct Stated(Mutex<State>);

#[derive(Debug, Default)]
struct State {
    /// A picture may show several places.
    mixed: bool,
    crs: Option<(String, Crs)>,
    /// Of the wall frames of inputs.
    wall: Option<(String, Transform)>,
    /// A second wall frame.
    other_wall: Option<[String; 2]>,
    /// Transforms between world and wall that are inputs.
    given: Option<Transform>,
}

impl Stated {
    /// Lets inputs be of several places: what is made has none.
    pub fn allow_mixed(&self) {
        self.state().mixed = true;
    }

    fn state(&self) -> std::sync::MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Notes what an input states.
    ///
    /// # Errors
    /// A system that another input contradicts.
    pub fn note(&self, port: &str, artefact: &Artefact) -> Result<(), StageError> {
        let (crs, wall) = match artefact {
            Artefact::Transform(transform) => (transform.crs.as_ref(), None),
            other => {
                let frame = other.frame();
                (frame.and_then(Frame::world_crs), frame.and_then(Frame::wall_from_world))
            }
        };
        let mut state = self.state();
        if state.mixed {
            return Ok(());
        }
        if let Artefact::Transform(transform) = artefact
            && transform.from == Frame::World.name()
            && transform.to == Frame::Wall.name()
        {
            state.given = Some(transform.clone());
        }
        if let Some(crs) = crs {
            state.take_crs(port, crs)?;
        }
        if let Some(wall) = wall {
            state.take_wall(port, wall);
        }
        Ok(())
    }

    /// Gives what was stated to all outputs that do not say it themselves.
    pub fn carry(&self, outputs: &mut Outputs, context: &Context) {
        let state = self.state();
        let crs = state.crs.as_ref().map(|(_, crs)| crs.clone()).or_else(|| outputs.values().find_map(crs_of));
        if let Some([one, other]) = &state.other_wall {
            let of = crs.as_ref().map_or_else(String::new, |crs| format!(" of {crs}"));
            context.warn(format!(
                "`{one}` and `{other}` are in two wall frames{of}, so the same place has other coordinates in each; the outputs do not say how \
                 theirs lies in the world: give both epochs one `transform`"
            ));
        }
        let made =
            outputs.values().find_map(|made| if let Artefact::Transform(t) = made { Some(t.clone()) } else { None });
        let made = made.filter(|t| t.from == Frame::World.name() && t.to == Frame::Wall.name());
        let of_inputs = state.wall.as_ref().map(|(_, wall)| wall.clone()).filter(|_| state.other_wall.is_none());
        let wall_from_world = made.or(of_inputs).or_else(|| state.given.clone());
        let georeference = Georeference { crs, wall_from_world };
        for artefact in outputs.values_mut() {
            place(artefact, &georeference);
        }
    }
}

impl State {
    fn take_crs(&mut self, port: &str, crs: &Crs) -> Result<(), StageError> {
        let Some((first, known)) = &self.crs else {
            self.crs = Some((port.to_owned(), crs.clone()));
            return Ok(());
        };
        if !known.agrees_with(crs) {
            // Two systems without a code are often called the same.
            let difference = known.difference(crs).map_or_else(String::new, |what| format!(", different in {what}"));
            let text = format!(
                "`{first}` is in {known}, but `{port}` in {crs}: two coordinate reference systems in one step{difference}"
            );
            return Err(
                StageError::new(text).hint("bring the files into one system first; nothing is reprojected here")
            );
        }
        if crs.has_heights() && !known.has_heights() {
            self.crs = Some((port.to_owned(), crs.clone()));
        }
        Ok(())
    }

    fn take_wall(&mut self, port: &str, wall: &Transform) {
        match &self.wall {
            None => self.wall = Some((port.to_owned(), wall.clone())),
            Some((first, known)) if known != wall => self.other_wall = Some([first.clone(), port.to_owned()]),
            Some(_) => {}
        }
    }
}

fn crs_of(artefact: &Artefact) -> Option<Crs> {
    artefact.frame().and_then(Frame::world_crs).cloned()
}

fn place(artefact: &mut Artefact, georeference: &Georeference) {
    if let Artefact::Transform(transform) = artefact {
        let world = Frame::World.name();
        if transform.crs.is_none() && (transform.from == world || transform.to == world) {
            transform.crs.clone_from(&georeference.crs);
        }
        return;
    }
    let Some(frame) = artefact.frame_mut() else { return };
    let crs = frame.world_crs().or(georeference.crs.as_ref()).cloned();
    let way = frame.wall_from_world().or(georeference.wall_from_world.as_ref());
    *frame = frame.at(Some(Georeference { crs, wall_from_world: way.cloned() }));
}

/// Whether all that these ports hold is looked at and not measured: it may show several places.
pub fn only_shows(outputs: &[Port]) -> bool {
    let shows = |port: &Port| port.kinds.iter().all(|kind| matches!(kind, Kind::Picture | Kind::Figure));
    !outputs.is_empty() && outputs.iter().all(shows)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::artefact::{Grid, Raster};
    use crate::testing::TestHost;

    fn raster(frame: Frame) -> Artefact {
        let grid = Grid { columns: 1, rows: 1, cell_m: 1.0, left_m: 0.0, top_m: 1.0 };
        Raster::single(grid, frame, "elevation", "z", vec![1.0]).into()
    }

    fn wall(shift_m: f64) -> Frame {
        let wall_from_world = Some(Transform { origin: [shift_m, 0.0, 0.0], ..Transform::identity("world", "wall") });
        Frame::Wall.at(Some(Georeference { crs: None, wall_from_world }))
    }

    /// The frame of what is made of two inputs, and the warnings.
    fn made(one: Frame, other: Frame) -> (Frame, Vec<String>) {
        let (stated, host) = (Stated::default(), TestHost::default());
        stated.note("reference", &raster(one)).unwrap();
        stated.note("comparison", &raster(other)).unwrap();
        let mut outputs = Outputs::of("raster", raster(Frame::Wall));
        stated.carry(&mut outputs, &Context::new(&host));
        let frame = outputs.values().next().and_then(Artefact::frame).unwrap();
        (frame, host.warnings())
    }

    #[test]
    fn the_way_of_a_wall_without_a_system_is_carried_and_compared() {
        let (frame, warnings) = made(wall(0.0), wall(0.0));
        assert_eq!((frame.georeference(), warnings.len()), (wall(0.0).georeference(), 0));
        let (frame, warnings) = made(wall(0.0), Frame::Wall);
        assert_eq!((frame.georeference(), warnings.len()), (wall(0.0).georeference(), 0));
        let (frame, warnings) = made(wall(0.0), wall(3.0));
        assert_eq!(frame.georeference(), None);
        assert!(warnings.len() == 1 && warnings[0].contains("two wall frames, so"), "{warnings:?}");
    }
}
