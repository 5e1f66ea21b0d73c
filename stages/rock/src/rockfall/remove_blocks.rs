//! `remove-blocks`: takes blocks out of a rock face, one after the other, and keeps exact account of what went.

use std::collections::BTreeMap;

use crate::rockfall::ground_truth;
use crate::rockfall::ground_truth::RemovedPiece;
use crate::rockfall::removal::attempts;
use crate::rockfall::removal::attempts::{End, Event, Outcome, Plan};
use crate::rockfall::removal::cut::Least;
use crate::rockfall::removal::evaluate::{Direction, Rules};
use crate::rockfall::removal::face::{Face, Rect};
use crate::rockfall::removal::search;
use crate::rockfall::removal::sites::Sites;
use crate::rockfall::removal::source::{Blocks, Source};
use crate::rockfall::removal::tables;
use crate::rockfall::removal::zone::Zone;
use rockface_core::artefact::{Artefact, Candidates, Frame, Kind, Mesh, Meshes, Raster, Transform};
use rockface_core::params::Range;
use rockface_core::{Context, InputSizes, Inputs, Outputs, Page, Port, Stage, StageError, choice, fail, params};

choice! {
    /// The direction a block is moved along to its place.
    pub enum Along {
        /// The normal of the face around the place: of the plane through the triangles within the block's radius.
        LocalNormal = "local_normal",
        /// Z of the wall frame.
        Z = "z",
    }
}

choice! {
    /// Which area of a niche is maximised, with its volume, by the depth of a block.
    pub enum NicheArea {
        /// That of its opening, seen along the direction of placement: part of the block stays outside.
        Projected = "projected",
        /// That of the surface it leaves in the rock: it grows with the depth, and blocks sink to `max_rock_share`.
        True = "true_area",
    }
}

choice! {
    /// What to do when fewer pieces came out than wanted.
    pub enum Fewer {
        /// Warn, with the reasons.
        Warn = "warn",
        /// Fail.
        Fail = "fail",
    }
}

choice! {
    /// What happens to a piece below a threshold when the block takes others that are not.
    pub enum SmallPieces {
        /// Its rock stays where it is.
        Keep = "keep",
        /// The whole block is rejected.
        Reject = "reject",
    }
}

params! {
    /// The validity checks; each can be switched off.
    pub struct Checks {
        /// No triangle with an edge on the border of the mesh is touched. Off: a block may break the border.
        border: bool = true,
        /// All rock face that goes lies in the zone, where one is connected.
        zone: bool = true,
        /// Earlier niches are neither touched nor come too near (`overlap_rings`, `overlap_buffer_m`).
        overlap: bool = true,
        /// Every piece is at least `min_depth_m` deep.
        depth: bool = true,
        /// Every piece has at least `min_volume_m3` and `min_size_m`.
        size: bool = true,
        /// No edge of three triangles, no vertex where the surface touches itself.
        non_manifold: bool = true,
        /// The border of the mesh stays as it is: no new hole. Where `border` is off it may be bitten, but not fall into more loops.
        holes: bool = true,
        /// The surface of the removed rock does not pass through itself.
        self_intersection: bool = true,
        /// No part of the surface is left hanging on nothing.
        isolated: bool = true,
    }
}

params! {
    /// Parameters of `remove-blocks`.
    pub struct RemoveBlocksParams {
        /// Pieces to remove; null: 10 of an unbounded sequence, all of a finite one.
        count: Option<u32> = None; Range::AtLeast(1.0),
        /// Candidates that may fail in a row before the stage gives up.
        max_failed_attempts: u32 = 200; Range::AtLeast(1.0),
        /// What to do when fewer pieces came out than `count`.
        fewer: Fewer = Fewer::Warn,
        /// The direction a block is moved along to its place, and depth is measured along.
        direction: Along = Along::LocalNormal,
        /// Which area of the niche counts where the depth is sought that maximises its area times its volume.
        niche_area: NicheArea = NicheArea::Projected,
        /// Largest share of a placed block's volume that may be rock: the rest stands out of the face. Blocks at their own
        /// position, or with a given `z_m`, are not moved.
        max_rock_share: f64 = 0.98; Range::Between(0.01, 1.0),
        /// Least depth of a piece, metres: greatest distance from the niche to the face over it.
        min_depth_m: f64 = 0.0; Range::NonNegative,
        /// How far a block that would be too shallow may be pushed in beyond its best place, metres; null: `min_depth_m`.
        max_shift_m: Option<f64> = None; Range::NonNegative,
        /// Least volume of a piece, cubic metres.
        min_volume_m3: f64 = 0.0; Range::NonNegative,
        /// Least size of a piece, metres: square root of the area of rock face that goes with it.
        min_size_m: f64 = 0.0; Range::NonNegative,
        /// What happens to a piece below a threshold when the block takes others that are not.
        small_pieces: SmallPieces = SmallPieces::Keep,
        /// Least distance between the centroids of removed blocks, metres.
        spacing_m: f64 = 0.0; Range::NonNegative,
        /// Rings of triangles that must lie between the face a block touches and an earlier niche.
        overlap_rings: u32 = 1,
        /// Least distance between the rock face of two blocks, metres.
        overlap_buffer_m: f64 = 0.0; Range::NonNegative,
        /// Edges of the face under a block are cut until none is longer, metres; null: the face is taken as it is.
        refine_edge_m: Option<f64> = None; Range::Positive,
        /// The validity checks.
        checks: Checks = Checks::default(),
        /// Cell of the rasters of labels and depths, metres.
        cell_m: f64 = 0.05; Range::Positive,
    }
}

/// Takes blocks out of a rock face and gives the face after and the exact ground truth.
pub struct RemoveBlocks;

impl Stage for RemoveBlocks {
    type Params = RemoveBlocksParams;
    const NAME: &'static str = "remove-blocks";
    const VERSION: u32 = 4;
    const PAGE: Page = Page::new(include_str!("remove_blocks.md"));
    const INPUTS: &'static [Port] = &[
        Port::one("mesh", &[Kind::Mesh], "The face before, wall frame."),
        Port::one(
            "blocks",
            &[Kind::Candidates, Kind::Meshes],
            "A sequence of candidates, or blocks one after the other.",
        ),
        Port::optional(
            "zone",
            &[Kind::Raster],
            "Where rock face may go: cells of the band `zone` (or the only one) that are not 0.",
        ),
        Port::optional(
            "placement",
            &[Kind::Raster, Kind::Table],
            "Where blocks stand: a density, with a band a class or the band `all`; or a table with `x_m`, `y_m` and, where wanted, \
             `z_m` (of the centroid), `spin_deg` and `class`.",
        ),
        Port::optional("transform", &[Kind::Transform], "wall_from_world, for world coordinates in the ground truth."),
    ];
    const OUTPUTS: &'static [Port] = &[
        Port::one("mesh", &[Kind::Mesh], "The face after."),
        Port::one("truth", &[Kind::Inventory], "The pieces, one feature each."),
        Port::one("labels", &[Kind::Raster], "Number of the piece each cell lost, 0 for none."),
        Port::one("depth", &[Kind::Raster], "Metres each cell lost along Z."),
        Port::one("blocks", &[Kind::Meshes], "The blocks as placed, one an event."),
        Port::one("pieces", &[Kind::Meshes], "The rock removed, closed, one mesh a piece."),
        Port::one("niches", &[Kind::Meshes], "The surfaces left behind, open, one mesh a piece."),
        Port::one(
            "attempts",
            &[Kind::Table],
            "Every candidate tried, and what became of it. A reason is the name of a check, or `off_face` (no rock face there), `empty` \
             (no rock inside), `buried` (all inside the rock), `spacing`, `mesh_defect`, `block_defect`, `boolean`, or `no_block` (the \
             candidate is no solid).",
        ),
        Port::one(
            "volumes",
            &[Kind::Table],
            "Requested against realised volumes: by the volume of the blocks, candidates tried and taken, volume removed over volume of \
             the block, how many were pushed in.",
        ),
    ];

    fn draws(_params: &Self::Params) -> bool {
        true
    }

    fn memory_bytes(_: &Self::Params, inputs: &InputSizes) -> u64 {
        // The face with its search tree and neighbours, and the face after.
        inputs.total() + inputs.times(3.2, "mesh")
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let mesh: &Mesh = inputs.one("mesh")?;
        check_frame("mesh", mesh.frame)?;
        let zone = inputs.optional::<Raster>("zone")?;
        if let Some(zone) = zone {
            check_frame("zone", zone.frame)?;
            tell_if_foreign(mesh, zone, context);
        }
        let mut source = source(mesh, zone, inputs, context)?;
        let plan = plan(params, source.available());
        let rules = rules(params, zone)?;
        let face = Face::new(mesh.vertices.clone(), mesh.triangles.clone());
        let cancelled = || context.check_cancelled().is_err();
        let outcome = attempts::run(face, mesh.colours.clone(), &rules, &plan, || source.take(), cancelled)?;
        if outcome.end == End::Cancelled {
            context.check_cancelled()?;
        }
        judge(params, &plan, source.available(), &outcome, context)?;
        finish(params, mesh, inputs, outcome)
    }
}

/// Warns where a zone cannot be that of the whole face: it reaches farther beyond it than the cells around a face.
fn tell_if_foreign(mesh: &Mesh, zone: &Raster, context: &Context) {
    let (face, grid) = (Rect::around(&mesh.vertices), &zone.grid);
    let [left, right, bottom, top] = grid.extent_m();
    let zone = Rect { low: [left, bottom], high: [right, top] };
    let beyond = |k: usize| (face.low[k] - zone.low[k]).max(zone.high[k] - face.high[k]);
    let farthest_m = beyond(0).max(beyond(1));
    if farthest_m > 3.0 * grid.cell_m {
        context.warn(format!("the zone reaches {farthest_m:.2} m beyond the face: was it made for another one?"));
    }
}

fn check_frame(port: &str, frame: Frame) -> Result<(), StageError> {
    if frame == Frame::Wall {
        return Ok(());
    }
    let error =
        StageError::new(format!("port `{port}` is in the {frame} frame, but blocks are removed in the wall frame"));
    Err(error.hint("take it to the wall frame first, with `transform-crs` or the `transform` port of its importer"))
}

fn source<'a>(
    mesh: &'a Mesh,
    zone: Option<&Raster>,
    inputs: &'a Inputs,
    context: &Context,
) -> Result<Source<'a>, StageError> {
    let blocks = match inputs.artefact("blocks")? {
        Artefact::Meshes(Meshes { parts, .. }) if parts.is_empty() => fail!("port `blocks` has no block"),
        Artefact::Meshes(Meshes { frame, parts }) => {
            check_frame("blocks", *frame)?;
            Blocks::Given(parts)
        }
        _ => Blocks::Drawn(inputs.one::<Candidates>("blocks")?),
    };
    let placement = if inputs.elements("placement").is_empty() { None } else { Some(inputs.artefact("placement")?) };
    let sites = match (placement, blocks, zone) {
        (Some(Artefact::Table(table)), ..) => Some(Sites::from_table(table)),
        (Some(_), ..) => Some(Sites::by_density(inputs.one("placement")?)),
        (None, Blocks::Given(_), _) => None,
        (None, Blocks::Drawn(_), Some(zone)) => Some(Sites::in_zone(zone)),
        (None, Blocks::Drawn(_), None) => Some(Sites::on_face(mesh)),
    };
    let sites = sites.transpose()?;
    if let (Some(sites), Blocks::Drawn(candidates)) = (&sites, blocks)
        && let Some(class) = sites.missing_class(&candidates.class_names())
    {
        fail!("the placement has no band for the blocks of class `{class}`, and none called `all`");
    }
    Ok(Source::new(blocks, sites, mesh, context.stream("placement", "")))
}

fn plan(params: &RemoveBlocksParams, available: Option<u64>) -> Plan {
    let all = if available.is_some() { u64::MAX } else { 10 };
    Plan {
        count: params.count.map_or(all, u64::from),
        most_failures: u64::from(params.max_failed_attempts),
        spacing_m: params.spacing_m,
        buffer_m: if params.checks.overlap { params.overlap_buffer_m } else { 0.0 },
    }
}

fn rules<'a>(params: &RemoveBlocksParams, zone: Option<&'a Raster>) -> Result<Rules<'a>, StageError> {
    let checks = &params.checks;
    let when = |on: bool, value: f64| if on { value } else { 0.0 };
    let zone = zone.filter(|_| checks.zone).map(Zone::new).transpose()?;
    Ok(Rules {
        direction: match params.direction {
            Along::LocalNormal => Direction::LocalNormal,
            Along::Z => Direction::Z,
        },
        border: checks.border,
        zone,
        overlap_rings: checks.overlap.then_some(params.overlap_rings),
        non_manifold: checks.non_manifold,
        holes: checks.holes,
        self_intersection: checks.self_intersection,
        isolated: checks.isolated,
        least: Least {
            volume_m3: when(checks.size, params.min_volume_m3),
            size_m: when(checks.size, params.min_size_m),
            depth_m: when(checks.depth, params.min_depth_m),
            whole_block: params.small_pieces == SmallPieces::Reject,
        },
        niche_area: match params.niche_area {
            NicheArea::Projected => search::NicheArea::Projected,
            NicheArea::True => search::NicheArea::True,
        },
        most_volume: params.max_rock_share,
        most_shift_m: params.max_shift_m.unwrap_or(params.min_depth_m),
        refine_edge_m: params.refine_edge_m,
    })
}

/// Logs what happened; fails where too little did.
fn judge(
    params: &RemoveBlocksParams,
    plan: &Plan,
    available: Option<u64>,
    outcome: &Outcome,
    context: &Context,
) -> Result<(), StageError> {
    let mut reasons: BTreeMap<&str, u64> = BTreeMap::new();
    for rejection in outcome.attempts.iter().filter_map(|attempt| attempt.outcome.as_ref().err()) {
        *reasons.entry(rejection.reason.word()).or_default() += 1;
    }
    let told: Vec<String> = reasons.iter().map(|(word, count)| format!("{word} {count}")).collect();
    let told = if told.is_empty() { String::new() } else { format!(", rejected for: {}", told.join(", ")) };
    let (pieces, events, tried) = (outcome.pieces(), outcome.events.len(), outcome.attempts.len());
    let volume = outcome.events.iter().flat_map(|event| &event.proposal.pieces).fold(0.0, |sum, p| sum + p.volume_m3);
    context.metric("pieces", pieces as f64, "1");
    context.metric("blocks", events as f64, "1");
    context.metric("candidates", tried as f64, "1");
    context.metric("removed_volume", volume, "m3");
    let spared: usize = outcome.events.iter().map(|event| event.proposal.spared).sum();
    context.metric("pieces_kept_as_rock", spared as f64, "1");
    for (word, count) in &reasons {
        context.metric(&format!("rejected_{word}"), *count as f64, "1");
    }
    let wanted = if plan.count == u64::MAX { available.unwrap_or(0) } else { plan.count };
    if pieces >= wanted && events > 0 {
        context.headline(format!("{pieces} pieces, {volume:.4} m3, by {events} of {tried} candidates"));
        return Ok(());
    }
    let why = match outcome.end {
        End::Failures => format!("{} candidates failed in a row", plan.most_failures),
        _ if tried == 0 => "there are no candidates".to_owned(),
        _ => "there are no more candidates".to_owned(),
    };
    let text = format!("{pieces} of {wanted} pieces are out: {why}; {tried} were tried{told}");
    if events == 0 || params.fewer == Fewer::Fail {
        let hint = "the tables `attempts` and `volumes` of this step, in the folder of the run, have every candidate; \
                    `rockface stages remove-blocks` says what the reasons mean; blocks and face must be in the same place";
        let attempts = tables::candidates(&outcome.attempts);
        let tried = Outputs::of("attempts", attempts).and("volumes", tables::by_volume(&outcome.attempts));
        return Err(StageError::new(text).hint(hint).evidence(tried));
    }
    context.warn(text);
    Ok(())
}

fn finish(
    params: &RemoveBlocksParams,
    before: &Mesh,
    inputs: &Inputs,
    outcome: Outcome,
) -> Result<Outputs, StageError> {
    let (table, volumes) = (tables::candidates(&outcome.attempts), tables::by_volume(&outcome.attempts));
    let seed = match inputs.artefact("blocks")? {
        Artefact::Candidates(candidates) => candidates.key.0.0.iter().map(|byte| format!("{byte:02x}")).collect(),
        _ => String::new(),
    };
    let pieces: Vec<RemovedPiece> = outcome.events.into_iter().flat_map(|event| records(event, &seed)).collect();
    let (vertices, triangles) = outcome.face.into_mesh();
    let after = Mesh { frame: Frame::Wall, vertices, triangles, colours: outcome.colours };
    let transform = inputs.optional::<Transform>("transform")?;
    let truth = ground_truth::assemble(before, &after, &pieces, params.cell_m, transform)?;
    Ok(Outputs::of("mesh", after)
        .and("truth", truth.inventory)
        .and("labels", truth.labels)
        .and("depth", truth.depth)
        .and("blocks", truth.blocks)
        .and("pieces", truth.pieces)
        .and("niches", truth.niches)
        .and("attempts", table)
        .and("volumes", volumes))
}

fn records(event: Event, seed: &str) -> Vec<RemovedPiece> {
    let Event { number, first_piece, candidate, proposal } = event;
    let record = |(place, piece): (usize, crate::rockfall::removal::cut::Piece)| RemovedPiece {
        id: first_piece + place as u32,
        event: number,
        candidate: candidate.number,
        class: candidate.class.clone(),
        seed: seed.to_owned(),
        block: proposal.block.clone(),
        removed: piece.removed,
        niche: piece.niche,
        outer: piece.outer,
        parameters: candidate.parameters.clone(),
        shift_m: proposal.shift_m,
        position: proposal.position,
        normal: proposal.normal,
    };
    proposal.pieces.into_iter().enumerate().map(record).collect()
}

#[cfg(test)]
mod tests;
