//! The loop of Algorithm 1: candidates one after the other until enough pieces are out or too many failed in a row.
//!
//! Candidates are tried several at a time on the face as it is, and decided in their order; one that looked at a place an
//! earlier one of its batch has changed is tried again. So the result is that of one at a time.

use rayon::prelude::*;

use super::evaluate::{Evaluation, NEW, Proposal, Rules, Trial, evaluate};
use super::face::{Face, Rect};
use super::measure;
use super::reason::{Reason, Rejection};
use crate::face::tetrahedra::volume_m3;
use crate::rockfall::ground_truth::Facets;

/// Candidates tried at a time.
pub const BATCH: usize = 8;

/// When to stop, and how far apart to stay.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plan {
    /// Number of pieces after which the loop ends.
    pub count: u64,
    /// Candidates that may fail in a row.
    pub most_failures: u64,
    /// Least distance between the positions of accepted blocks, metres.
    pub spacing_m: f64,
    /// Least distance between the rock face of one block and that of another, metres.
    pub buffer_m: f64,
}

/// A candidate with its name.
#[derive(Debug, Clone)]
pub struct Candidate {
    /// Its number in its sequence.
    pub number: u64,
    /// The name of its class of blocks.
    pub class: String,
    /// What was drawn for it.
    pub parameters: Vec<(String, f64)>,
    /// Volume a candidate that gives no block was to have, cubic metres.
    pub requested_m3: Option<f64>,
    /// What to try, or why there is nothing.
    pub trial: Result<Trial, Rejection>,
}

/// A candidate that was taken out.
#[derive(Debug, Clone)]
pub struct Event {
    /// Its number among the accepted, from 1.
    pub number: u32,
    /// The number of its first piece; the others follow.
    pub first_piece: u32,
    /// The candidate as it was drawn.
    pub candidate: Candidate,
    /// What it took out of the face.
    pub proposal: Proposal,
}

/// One candidate that was tried.
#[derive(Debug, Clone)]
pub struct Attempt {
    /// Number of the candidate.
    pub candidate: u64,
    /// The name of its class of blocks.
    pub class: String,
    /// Where it was tried, metres.
    pub position: Option<[f64; 3]>,
    /// Volume of its block, or the one it was to have where there is no block, cubic metres; `None` where no shape came about.
    pub block_m3: Option<f64>,
    /// What it became, or why it was rejected.
    pub outcome: Result<Taken, Rejection>,
}

/// What a candidate became.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Taken {
    /// Number of the event.
    pub event: u32,
    /// Volume of rock removed, all pieces, cubic metres.
    pub removed_m3: f64,
    /// How far it was pushed in beyond its best place, metres.
    pub shift_m: f64,
}

/// Why the loop ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum End {
    /// Enough pieces.
    Enough,
    /// Too many failures in a row.
    Failures,
    /// No more candidates.
    Exhausted,
    /// The run was asked to stop.
    Cancelled,
}

/// What the loop came to.
pub struct Outcome {
    /// The face without the pieces.
    pub face: Face,
    /// Colours of its vertices; empty where it had none.
    pub colours: Vec<[u8; 3]>,
    /// What was taken out, in order.
    pub events: Vec<Event>,
    /// Every candidate that was decided on.
    pub attempts: Vec<Attempt>,
    /// Why the loop ended.
    pub end: End,
}

impl Outcome {
    /// How many pieces all events took out together.
    pub fn pieces(&self) -> u64 {
        self.events.iter().map(|event| event.proposal.pieces.len() as u64).sum()
    }
}

/// Runs the loop. `next` hands out the next candidates, some at a time, in order and none any more; an error of it ends the
/// loop at once.
pub fn run<E>(
    face: Face,
    colours: Vec<[u8; 3]>,
    rules: &Rules,
    plan: &Plan,
    mut next: impl FnMut() -> Result<Vec<Candidate>, E>,
    cancelled: impl Fn() -> bool,
) -> Result<Outcome, E> {
    let mut outcome = Outcome { face, colours, events: Vec::new(), attempts: Vec::new(), end: End::Exhausted };
    let mut failures = 0;
    loop {
        if cancelled() {
            return Ok(Outcome { end: End::Cancelled, ..outcome });
        }
        let batch = next()?;
        if batch.is_empty() {
            return Ok(outcome);
        }
        if let Some(end) = outcome.decide_all(batch, rules, plan, &mut failures) {
            return Ok(Outcome { end, ..outcome });
        }
    }
}

fn taken(event: u32, proposal: &Proposal) -> Taken {
    let removed_m3 = proposal.pieces.iter().fold(0.0, |sum, piece| sum + piece.volume_m3);
    Taken { event, removed_m3, shift_m: proposal.shift_m }
}

/// The volume inside a block, cubic metres.
fn volume_of(block: &Facets) -> f64 {
    let about = measure::centroid(&block.vertices, &block.triangles);
    volume_m3(&block.vertices, &block.triangles, about)
}

impl Outcome {
    /// Tries a batch and decides it in order; the end of the loop, if it is reached.
    fn decide_all(&mut self, batch: Vec<Candidate>, rules: &Rules, plan: &Plan, failures: &mut u64) -> Option<End> {
        let face = &self.face;
        let try_it = |candidate: &Candidate| Some(evaluate(face, candidate.trial.as_ref().ok()?, rules));
        let evaluations: Vec<Option<Evaluation>> = batch.par_iter().map(try_it).collect();
        let mut changed: Vec<Rect> = Vec::new();
        for (candidate, evaluation) in batch.into_iter().zip(evaluations) {
            let stale = |e: &Evaluation| changed.iter().any(|rect| rect.overlaps(&e.read));
            let evaluation = match (&candidate.trial, evaluation) {
                (Ok(trial), Some(evaluation)) if stale(&evaluation) => Some(evaluate(&self.face, trial, rules)),
                (_, evaluation) => evaluation,
            };
            if let Some(rect) = self.decide(candidate, evaluation, plan) {
                changed.push(rect);
                *failures = 0;
            } else {
                *failures += 1;
            }
            if self.pieces() >= plan.count {
                return Some(End::Enough);
            }
            if *failures >= plan.most_failures {
                return Some(End::Failures);
            }
        }
        None
    }

    /// Accepts or rejects one candidate; the rectangle of the face it changed, if it did.
    fn decide(&mut self, candidate: Candidate, evaluation: Option<Evaluation>, plan: &Plan) -> Option<Rect> {
        let (position, result) = match (evaluation, &candidate.trial) {
            (Some(evaluation), _) => (evaluation.position, evaluation.result),
            (None, Err(rejection)) => (None, Err(rejection.clone())),
            (None, Ok(_)) => (None, Err(Reason::NoBlock.into())),
        };
        let result = result.and_then(|proposal| match self.too_near(&proposal, plan) {
            Some(reason) => Err(reason.into()),
            None => Ok(proposal),
        });
        let number = self.events.len() as u32 + 1;
        let outcome = result.as_ref().map(|proposal| taken(number, proposal)).map_err(Clone::clone);
        let class = candidate.class.clone();
        let block_m3 = candidate.trial.as_ref().ok().map(|trial| volume_of(&trial.block)).or(candidate.requested_m3);
        self.attempts.push(Attempt { candidate: candidate.number, class, position, block_m3, outcome });
        let proposal = result.ok()?;
        let first_piece = self.pieces() as u32 + 1;
        let rect = self.apply(&proposal, first_piece);
        self.events.push(Event { number, first_piece, candidate, proposal });
        Some(rect)
    }

    fn too_near(&self, proposal: &Proposal, plan: &Plan) -> Option<Reason> {
        let place = proposal.position;
        let near = |event: &Event| square_distance(event.proposal.position, place) < plan.spacing_m * plan.spacing_m;
        if plan.spacing_m > 0.0 && self.events.iter().any(near) {
            return Some(Reason::Spacing);
        }
        let close = |event: &Event| {
            let others = &event.proposal.pieces;
            others.iter().any(|a| proposal.pieces.iter().any(|b| within(&a.outer, &b.outer, plan.buffer_m)))
        };
        (plan.buffer_m > 0.0 && self.events.iter().any(close)).then_some(Reason::Overlap)
    }

    /// Changes the face; the rectangle of what changed.
    fn apply(&mut self, proposal: &Proposal, first_piece: u32) -> Rect {
        let removed = proposal.removed.iter().map(|t| self.face.rect(*t)).fold(Rect::EMPTY, |a, b| a.union(&b));
        let rect = removed.union(&Rect::around(&proposal.vertices));
        if !self.colours.is_empty() {
            let added = colours_of(&self.face, &self.colours, proposal);
            self.colours.extend(added);
        }
        self.face.replace(&proposal.removed, &proposal.vertices, |base| {
            let number = |v: u32| if v & NEW == 0 { v } else { base + (v & !NEW) };
            let niche = |piece: Option<u32>| piece.map_or(0, |piece| first_piece + piece);
            proposal.triangles.iter().map(|(t, piece)| (t.map(number), niche(*piece))).collect()
        });
        rect
    }
}

fn square_distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).fold(0.0, |sum, k| sum + (a[k] - b[k]) * (a[k] - b[k]))
}

/// Whether two surfaces have vertices nearer to each other than a distance.
fn within(a: &Facets, b: &Facets, distance_m: f64) -> bool {
    let rect = Rect::around(&b.vertices).grown(distance_m);
    let near = |p: &&[f64; 3]| Rect::around(std::iter::once(*p)).overlaps(&rect);
    let close = |p: &[f64; 3]| b.vertices.iter().any(|q| square_distance(*p, *q) < distance_m * distance_m);
    a.vertices.iter().filter(near).any(close)
}

/// New vertices take the colour of the nearest vertex of the triangles that go.
fn colours_of(face: &Face, colours: &[[u8; 3]], proposal: &Proposal) -> Vec<[u8; 3]> {
    let mut around: Vec<u32> = proposal.removed.iter().flat_map(|t| face.triangle(*t)).collect();
    around.sort_unstable();
    around.dedup();
    let nearest = |p: &[f64; 3]| {
        let distance = |v: &u32| square_distance(face.vertex(*v), *p);
        around.iter().min_by(|a, b| distance(a).total_cmp(&distance(b))).map_or([0; 3], |v| colours[*v as usize])
    };
    proposal.vertices.iter().map(nearest).collect()
}
