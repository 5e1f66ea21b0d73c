//! The resolved graph of steps: every name found, every port checked, axes propagated along the arrows.

use std::collections::BTreeMap;
use std::path::PathBuf;

use rockface_stages::{AnyStage, Port};
use serde_json::Value;

use crate::diagnostic::Span;
use crate::pipeline::{Axis, Node};

/// A pipeline whose every name is resolved; steps are in topological order.
pub struct Graph {
    /// Name of the pipeline.
    pub name: String,
    /// Pipeline seed.
    pub seed: u64,
    /// Paths in parameters are relative to this folder.
    pub folder: PathBuf,
    /// Values that `${name}` refers to.
    pub params: BTreeMap<String, Value>,
    /// The axes, in the order of declaration.
    pub axes: Vec<Axis>,
    /// The steps, producers before consumers.
    pub steps: Vec<GraphStep>,
    /// Indices of the steps to make.
    pub targets: Vec<usize>,
}

/// One resolved step.
pub struct GraphStep {
    /// Its name.
    pub name: String,
    /// Where its name stands.
    pub span: Span,
    /// Its stage.
    pub stage: &'static dyn AnyStage,
    /// Its parameters as written.
    pub with: Option<Node>,
    /// What feeds each given input port, in the stage's order of ports.
    pub inputs: Vec<(&'static Port, Feed)>,
    /// Indices of the axes it is expanded over, ascending.
    pub axes: Vec<usize>,
    /// Indices of the axes its parameters mention, ascending.
    pub with_axes: Vec<usize>,
    /// Whether its outputs are kept.
    pub keep: bool,
    /// What stands for it in seed material.
    pub stream: String,
    /// The reseeding axes whose items are part of the seed material, ascending.
    pub stream_axes: Vec<usize>,
}

/// Where an input comes from.
#[derive(Debug, Clone)]
pub enum Feed {
    /// One output.
    Plain(Source),
    /// The output chosen by the item of an axis: one source an item.
    By {
        /// Index of the axis.
        axis: usize,
        /// One source an item.
        cases: Vec<Source>,
    },
    /// The outputs at all items of some axes.
    Each {
        /// The output.
        source: Source,
        /// Indices of the axes gathered over, outermost first.
        over: Vec<usize>,
    },
}

/// One output of a step, perhaps with the items of some axes picked.
#[derive(Debug, Clone)]
pub struct Source {
    /// Index of the step.
    pub step: usize,
    /// Its output port.
    pub port: &'static Port,
    /// Picked items: (axis, item).
    pub picks: Vec<(usize, usize)>,
}

impl Feed {
    /// Every source in it.
    pub fn sources(&self) -> &[Source] {
        match self {
            Self::Plain(source) | Self::Each { source, .. } => std::slice::from_ref(source),
            Self::By { cases, .. } => cases,
        }
    }
}
