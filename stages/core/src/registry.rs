//! What a program hands to the engine: the stages it can run, by room, and what draws small pictures of their outputs.

use crate::AnyStage;
use crate::artefact::{Artefact, Preview, Sketch};

/// The stages of one domain.
#[derive(Clone, Copy)]
pub struct Room {
    /// The name of the domain, such as `matching`.
    pub name: &'static str,
    /// What its stages are about, in a sentence for `rockface stages`.
    pub doc: &'static str,
    /// The stages, in the order of the catalogue.
    pub stages: &'static [&'static dyn AnyStage],
}

/// A chain of steps that comes with the program, in the pipeline language.
#[derive(Debug, Clone, Copy)]
pub struct PartText {
    /// The name it is used by, such as `rockface/stereo-survey`.
    pub name: &'static str,
    /// Its text: a file that says `part:`.
    pub text: &'static str,
}

/// Draws artefacts for logs and reports.
pub trait Look: Sync + std::fmt::Debug {
    /// Small likenesses of an artefact; none of what cannot be seen.
    fn sketches(&self, artefact: &Artefact) -> Vec<Sketch>;

    /// A small picture of an artefact, at most 512 pixels wide, where it can be seen; `beside` is what it may be drawn over, such as
    /// the face of an inventory. Equal artefacts have equal pictures.
    fn preview(&self, artefact: &Artefact, beside: &[&Artefact]) -> Option<Preview>;
}

/// A [`Look`] that draws nothing.
#[derive(Debug)]
struct Blank;

impl Look for Blank {
    fn sketches(&self, _: &Artefact) -> Vec<Sketch> {
        Vec::new()
    }

    fn preview(&self, _: &Artefact, _: &[&Artefact]) -> Option<Preview> {
        None
    }
}

/// Every stage a program knows, room by room.
///
/// A program of your own clones the registry of `rockface-stages` and adds a room; see `examples/own_stage.rs`.
///
/// ```
/// use rockface_core::artefact::{Kind, Picture};
/// use rockface_core::{AnyStage, Context, Inputs, Outputs, Page, Port, Registry, Room, Row, Stage, StageError, params};
///
/// params! {
///     /// `draw-nothing` has no parameters.
///     pub struct NoParams {}
/// }
///
/// struct DrawNothing;
///
/// impl Stage for DrawNothing {
///     type Params = NoParams;
///     const NAME: &'static str = "draw-nothing";
///     const VERSION: u32 = 1;
///     const PAGE: Page = Page::new("# draw-nothing\n\nMakes an empty picture.\n");
///     const INPUTS: &'static [Port] = &[];
///     const OUTPUTS: &'static [Port] = &[Port::one("picture", &[Kind::Picture], "No bytes.")];
///
///     fn run(_: &NoParams, _: &Inputs, _: &Context) -> Result<Outputs, StageError> {
///         Ok(Outputs::of("picture", Picture { png: Vec::new() }))
///     }
/// }
///
/// static OWN: &[&dyn AnyStage] = &[&Row::<DrawNothing>::new()];
///
/// let registry = Registry::default().with(Room { name: "own", doc: "Stages of this program.", stages: OWN });
/// assert_eq!(registry.find("draw-nothing").map(|stage| stage.version()), Some(1));
/// assert!(registry.find("draw-all").is_none());
/// ```
#[derive(Clone)]
pub struct Registry {
    rooms: Vec<Room>,
    stages: Vec<&'static dyn AnyStage>,
    parts: &'static [PartText],
    look: &'static dyn Look,
}

impl std::fmt::Debug for Registry {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let names =
            self.rooms.iter().map(|room| (room.name, room.stages.iter().map(|stage| stage.name()).collect::<Vec<_>>()));
        f.debug_map().entries(names).finish()
    }
}

impl Default for Registry {
    fn default() -> Self {
        Self { rooms: Vec::new(), stages: Vec::new(), parts: &[], look: &Blank }
    }
}

impl Registry {
    /// Adds a room after the others.
    ///
    /// # Panics
    /// When two stages have one name: that is a mistake of the program, not of its user.
    #[must_use]
    pub fn with(mut self, room: Room) -> Self {
        for stage in room.stages {
            assert!(self.find(stage.name()).is_none(), "two stages are named `{}`", stage.name());
            self.stages.push(*stage);
        }
        self.rooms.push(room);
        self
    }

    /// Replaces the parts that pipelines may use by name; a new registry has none.
    #[must_use]
    pub fn with_parts(mut self, parts: &'static [PartText]) -> Self {
        self.parts = parts;
        self
    }

    /// Replaces what draws artefacts; a new registry draws nothing.
    #[must_use]
    pub fn drawn_by(mut self, look: &'static dyn Look) -> Self {
        self.look = look;
        self
    }

    /// The rooms, in the order they were added.
    pub fn rooms(&self) -> &[Room] {
        &self.rooms
    }

    /// Every stage, in the order of the catalogue.
    pub fn stages(&self) -> &[&'static dyn AnyStage] {
        &self.stages
    }

    /// The stage of a name.
    pub fn find(&self, name: &str) -> Option<&'static dyn AnyStage> {
        self.stages.iter().copied().find(|stage| stage.name() == name)
    }

    /// The parts that pipelines may use by name.
    pub fn parts(&self) -> &'static [PartText] {
        self.parts
    }

    /// What draws artefacts for logs and reports.
    pub fn look(&self) -> &'static dyn Look {
        self.look
    }
}
