//! What the engine and the stages of rockface share: the contract of a stage, artefacts, their file formats, numerics.
//!
//! - [`Stage`] is the contract: parameters ([`params!`]), typed ports ([`Port`]), a page ([`Page`]) and `run`, which reads
//!   [`Inputs`] and returns [`Outputs`]. Its documentation has a whole stage as an example.
//! - [`artefact`] has the values that stages hand to each other, [`mod@format`] the files they are kept in.
//! - [`Registry`] lists the stages a program knows, room by room.
//! - [`numerics`] has random fields, FFT, filters and quantiles whose results are the same on every machine.
//! - [`testing`] runs a stage without an engine.
//!
//! Nothing here touches disk, clock, thread count, YAML or a hash function: the engine lends a stage files, random streams and
//! its log through [`Context`].
//!
//! ```
//! use rockface_core::artefact::{Artefact, Kind, Noun, Table};
//!
//! let mut table = Table::new(["volume_m3"]);
//! table.push(vec![0.25.into()]);
//! let file = table.encode()?;
//! assert_eq!(Artefact::decode(Kind::Table, &file)?, Artefact::Table(table));
//! # Ok::<(), rockface_core::artefact::CodecError>(())
//! ```

#![cfg_attr(not(test), warn(clippy::print_stdout, clippy::print_stderr, clippy::exit))]

mod any_number;
pub mod artefact;
pub mod crs;
pub mod distribution;
pub mod format;
mod georeferencing;
mod inputs;
pub mod limits;
pub mod names;
mod needs;
pub mod numerics;
pub mod params;
mod planner;
pub mod program;
mod registry;
mod stage;
pub mod testing;

pub use inputs::{Element, Inputs, Later};
pub use needs::{InputSize, InputSizes, SmallInput};
pub use planner::Planner;
pub use program::{Found, Job, JobResult, Piece, Program, ProgramResult};
pub use registry::{Look, PartText, Registry, Room};
pub use stage::{
    AnyStage, Arity, Checked, Context, Entry, Host, Outputs, Page, Point, Port, Ports, Row, SourceFile, Stage,
    StageError,
};
