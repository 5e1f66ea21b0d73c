//! What the engine and the stages of rockface share.
//!
//! The contract of a stage ([`Stage`], [`params`], [`Inputs`], [`Context`]), the nouns that stages hand to each other
//! ([`artefact`]), the files they are kept in ([`format`]), and [`numerics`]. Nothing here touches disk, clock, thread
//! count, YAML or hash function; what a stage needs of them it is lent through [`Context`].

mod any_number;
pub mod artefact;
pub mod format;
mod inputs;
pub mod limits;
mod needs;
pub mod numerics;
pub mod params;
pub mod program;
mod registry;
mod stage;
pub mod testing;

pub use inputs::{Element, Inputs, Later};
pub use needs::{InputSize, InputSizes, SmallInput};
pub use program::{Piece, Program, ProgramResult};
pub use registry::{Look, Registry, Room};
pub use stage::{
    AnyStage, Arity, Checked, Context, Entry, Host, Outputs, Page, Point, Port, Ports, Row, SourceFile, Stage,
    StageError,
};
