//! Makes the candidates of a removal: blocks from a sequence or from files, each with the place where it is to stand.

use rayon::prelude::*;

use super::attempts::{BATCH, Candidate};
use super::evaluate::{Stand, Trial};
use super::measure;
use super::reason::{Reason, Rejection};
use super::sites::{Row, Sites};
use crate::rockfall::block::{Block, BlockError, candidate, requested};
use crate::rockfall::ground_truth::Facets;
use rockface_core::artefact;
use rockface_core::artefact::candidates::Align;
use rockface_core::artefact::{Candidates, Mesh};
use rockface_core::distribution::Draws;
use rockface_core::numerics::random::Key;
use rockface_core::{StageError, fail};

/// Candidates looked through for one of the class a row asks for.
const MOST_SKIPPED: u64 = 10_000;

/// Where the blocks come from.
#[derive(Clone, Copy)]
pub enum Blocks<'a> {
    /// Blocks drawn one after the other, without an end.
    Drawn(&'a Candidates),
    /// Meshes, one after the other.
    Given(&'a [artefact::Part]),
}

/// Candidates in their order.
pub struct Source<'a> {
    blocks: Blocks<'a>,
    /// Where they stand; `None`: where they are.
    sites: Option<Sites>,
    mesh: &'a Mesh,
    key: Key,
    next: u64,
    row: usize,
}

impl<'a> Source<'a> {
    /// Blocks on sites of a face. `key` is that of the places; without sites, meshes stay where they are.
    pub fn new(blocks: Blocks<'a>, sites: Option<Sites>, mesh: &'a Mesh, key: Key) -> Self {
        Self { blocks, sites, mesh, key, next: 0, row: 0 }
    }

    /// How many there are, where there is an end.
    pub fn available(&self) -> Option<u64> {
        match (&self.sites, self.blocks) {
            (Some(Sites::Rows(rows)), _) => Some(rows.len() as u64),
            (None, Blocks::Given(parts)) => Some(parts.len() as u64),
            _ => None,
        }
    }

    /// The next candidates; none at the end. A fault of the specification itself is an error.
    pub fn take(&mut self) -> Result<Vec<Candidate>, StageError> {
        if let Some(Sites::Rows(rows)) = &self.sites {
            let rows: Vec<Row> = rows.iter().skip(self.row).take(BATCH).cloned().collect();
            self.row += rows.len();
            return rows.iter().map(|row| self.for_row(row)).collect();
        }
        let end = self.available().unwrap_or(u64::MAX).min(self.next + BATCH as u64);
        let numbers: Vec<u64> = (self.next..end).collect();
        self.next = end;
        let shared = &*self;
        numbers.into_par_iter().map(|number| shared.number(number)).collect::<Vec<_>>().into_iter().collect()
    }

    fn number(&self, number: u64) -> Result<Candidate, StageError> {
        let block = match self.block(number) {
            Ok(block) => block,
            Err(fault) => return self.no_block(number, &fault),
        };
        let stand = match &self.sites {
            None => Some(Stand::Own),
            Some(sites) => sites.draw(self.mesh, &Draws::new(self.key, number), &block.class),
        };
        let Some(stand) = stand else {
            fail!("the placement has no band for the blocks of class `{}`, and none for all", block.class);
        };
        Ok(ready(number, block, stand))
    }

    /// The next block of the class a row asks for; blocks that cannot be made are skipped.
    fn for_row(&mut self, row: &Row) -> Result<Candidate, StageError> {
        for _ in 0..MOST_SKIPPED {
            let number = self.next;
            self.next += 1;
            match self.block(number) {
                Ok(block) if row.class.as_ref().is_none_or(|class| *class == block.class) => {
                    return Ok(ready(number, block, row.stand));
                }
                Ok(_) => {}
                Err(fault) => drop(self.no_block(number, &fault)?),
            }
        }
        let wanted = row.class.as_deref().unwrap_or("any");
        Err(StageError::new(format!(
            "none of {MOST_SKIPPED} candidates in a row is a block of class `{wanted}`, which a position asks for"
        )))
    }

    fn block(&self, number: u64) -> Result<Block, BlockError> {
        match self.blocks {
            Blocks::Drawn(candidates) => candidate(candidates, number),
            Blocks::Given(parts) => {
                let part = &parts[(number % parts.len() as u64) as usize];
                let centre =
                    if self.sites.is_some() { measure::centroid(&part.vertices, &part.triangles) } else { [0.0; 3] };
                Ok(Block {
                    class: part.class.clone(),
                    vertices: part.vertices.iter().map(|v| super::patch::less(*v, centre)).collect(),
                    triangles: part.triangles.clone(),
                    align: Align::Wall,
                    parameters: Vec::new(),
                })
            }
        }
    }
}

impl Source<'_> {
    /// A candidate that is no block, of the class and the volume it was to have.
    fn no_block(&self, number: u64, fault: &BlockError) -> Result<Candidate, StageError> {
        let word = fault.reason().ok_or_else(|| fault.to_string())?;
        let wanted = match self.blocks {
            Blocks::Drawn(candidates) => requested(candidates, number),
            Blocks::Given(_) => None,
        };
        let (class, requested_m3) = wanted.map_or((String::new(), None), |(class, volume)| (class, Some(volume)));
        let rejection = Rejection { reason: Reason::NoBlock, detail: word.to_owned() };
        Ok(Candidate { number, class, parameters: Vec::new(), requested_m3, trial: Err(rejection) })
    }
}

fn ready(number: u64, block: Block, stand: Stand) -> Candidate {
    let align_to_normal = block.align == Align::Normal;
    let part = Facets { vertices: block.vertices, triangles: block.triangles };
    let trial = Ok(Trial { block: part, align_to_normal, stand });
    Candidate { number, class: block.class, parameters: block.parameters, requested_m3: None, trial }
}
