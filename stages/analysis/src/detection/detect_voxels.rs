//! `detect-voxels`: finds detachments as space enclosed between two surfaces.

use std::collections::BTreeMap;

use nalgebra::Vector3;

use crate::detection::change::Change;
use crate::detection::facing;
use crate::detection::found;
use crate::detection::found::{Found, Heights};
use crate::detection::tested::{self, Tested, Whole};
use crate::detection::voxels::{self, Cluster, Voxels};
use rockface_core::artefact::{Artefact, Band, Grid, Kind, Raster, Surface, Transform};
use rockface_core::params::Range;
use rockface_core::{Context, InputSizes, Inputs, Outputs, Page, Port, Stage, StageError, fail, params};
use rockface_raster::raster_surface;
use rockface_raster::shape::{Moved, Shape};

/// Voxels of a place that a warning counts, at least, and the share of all that was found or lies open that is worth one.
const OPEN_VOXELS: usize = 27;
const OPEN_SHARE: f64 = 0.25;

/// The greatest share of points that were gaps that a change may have: beyond, what encloses it was not seen but drawn.
const MOST_BRIDGED: f64 = 0.5;
/// Voxels across the widest gap that is bridged, unless a width is said.
const BRIDGED_VOXELS: f64 = 5.0;

params! {
    /// Parameters of `detect-voxels`.
    pub struct DetectVoxelsParams {
        /// Which changes are looked for.
        change: Change = Change::Loss,
        /// Edge of a voxel, metres: about the registration error; a change shows from about twice this on.
        voxel_m: f64 = 0.05; Range::Positive,
        /// Widest gap of elevations that is bridged by straight lines, metres; by default five voxels. 0 bridges none: each gap then lets
        /// the outside in. Meshes and surfaces have no other triangles than their own.
        bridge_m: Option<f64> = None; Range::NonNegative,
        /// Enclosed voxels a detachment must have.
        least_voxels: u32 = 8; Range::AtLeast(1.0),
        /// Least ratio of enclosed voxels to those around them: what is thinner is no body.
        least_ratio: f64 = 2.0 / 26.0; Range::NonNegative,
    }
}

/// Finds detachments as clusters of voxels enclosed between two surfaces.
pub struct DetectVoxels;

impl Stage for DetectVoxels {
    type Params = DetectVoxelsParams;
    const NAME: &'static str = "detect-voxels";
    const VERSION: u32 = 6;
    const PAGE: Page = Page::new(include_str!("detect_voxels.md"));
    const INPUTS: &'static [Port] = &[
        Port::one(
            "reference",
            &[Kind::Mesh, Kind::Surface, Kind::Raster],
            "The earlier epoch; a raster holds elevations.",
        ),
        Port::one("comparison", &[Kind::Mesh, Kind::Surface, Kind::Raster], "The later epoch."),
        Port::optional("transform", &[Kind::Transform], "Applied to the comparison, such as a registration."),
    ];
    const OUTPUTS: &'static [Port] = &[
        Port::one("detections", &[Kind::Inventory], "One feature a cluster: outline, volume, area, depth, box, score."),
        Port::one("labels", &[Kind::Raster], "Number of the cluster of each column of voxels, 0 for none."),
        Port::one(
            "summary",
            &[Kind::Table],
            "One row: number and volume of the changes, and how much of the face was tested.",
        ),
    ];

    fn memory_bytes(params: &Self::Params, inputs: &InputSizes) -> u64 {
        // What is known of each voxel of the box around both, and triangles between the cells of rasters.
        let boxes = ["reference", "comparison"].map(|port| inputs.value(port).as_deref().and_then(voxels::size_m));
        let count = |size_m: [f64; 3]| size_m.map(|side_m| side_m / params.voxel_m + 3.0).iter().product::<f64>();
        let most = boxes.into_iter().flatten().map(count).fold(0.0, f64::max).min(voxels::MAXIMUM);
        4 * inputs.total() + (3.0 * most) as u64
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let mut made = Vec::new();
        let mut bridged = Vec::new();
        for port in ["reference", "comparison"] {
            let (surface, gaps) = triangles(port, inputs.artefact(port)?, params)?;
            made.push(surface);
            bridged.push(gaps);
        }
        let shapes = ["reference", "comparison"].into_iter().zip(&made).map(|(port, made)| match made {
            Some(surface) => Ok(Shape::Surface(surface)),
            None => shape(port, inputs),
        });
        let shapes: Vec<Shape> = shapes.collect::<Result<_, StageError>>()?;
        let (reference, comparison) = (shapes[0], shapes[1]);
        let frame = reference.frame();
        if frame != comparison.frame() {
            fail!("the reference is in the {frame} frame, the comparison in the {} frame", comparison.frame());
        }
        let warning = facing::check("reference", reference, facing::VOLUMES_BELOW)?;
        warning.into_iter().for_each(|text| context.warn(text));
        let outward = facing::outward(reference);
        warn_of_dip(&outward, context);
        let moved = inputs.optional::<Transform>("transform")?.and_then(Moved::by);
        let voxels = Voxels::new([reference, comparison], [&bridged[0], &bridged[1]], moved.as_ref(), params.voxel_m)
            .map_err(|e| e.hint("choose a larger `voxel_m`; are both surfaces in metres?"))?;
        let grid = plan(&voxels);
        let low = voxels.low;
        let occupied = voxels.occupied();
        let tested = tested(&voxels, &outward);
        let (clusters, open) = voxels.enclosed(&outward);
        let all = clusters.len();
        let (unseen, clusters): (Vec<Cluster>, Vec<Cluster>) =
            clusters.into_iter().filter(|c| counts(c, params)).partition(|c| c.bridged > MOST_BRIDGED);
        let found: Vec<Found> = clusters.iter().map(|c| body(c, &grid, low, params.voxel_m)).collect();
        report(&found, all, occupied, &tested, context);
        tested.warning().into_iter().for_each(|text| context.warn(text));
        note_unseen(&unseen, params, context);
        warn_of_open(&open, &found, params, context);
        let labels = found::labels(&grid, frame, &found)?;
        let detections = found::inventory(&grid, frame, "voxels", Heights::Known, &found);
        let summary = tested::summary("voxels", params.change, &found, None, &tested);
        Ok(Outputs::of("detections", detections).and("labels", labels).and("summary", summary))
    }
}

fn shape<'a>(port: &str, inputs: &'a Inputs) -> Result<Shape<'a>, StageError> {
    Shape::of(inputs.artefact(port)?)
        .ok_or_else(|| StageError::new(format!("port `{port}` needs a mesh, a surface or a raster")))
}

/// The triangles between the cell centres of an elevation raster, its narrow gaps bridged, and which cells were such; `None` for what has
/// triangles of its own.
fn triangles(
    port: &str,
    artefact: &Artefact,
    params: &DetectVoxelsParams,
) -> Result<(Option<Surface>, Vec<bool>), StageError> {
    let Artefact::Raster(raster) = artefact else { return Ok((None, Vec::new())) };
    let bridge_m = params.bridge_m.unwrap_or(BRIDGED_VOXELS * params.voxel_m);
    // A width of 0.3 m has 15 cells of 0.02 m, also where the quotient of the two is rounded down.
    let most = (bridge_m / raster.grid.cell_m * (1.0 + 1e-9)) as usize;
    let bridged = raster.bands.iter().map(|band| {
        let values = raster_surface::bridged(&band.values, raster.grid.columns, most);
        Band { values, ..band.clone() }
    });
    let gaps = raster.bands.first().map(|band| band.values.iter().map(|z| z.is_nan()).collect()).unwrap_or_default();
    let raster = Raster { bands: bridged.collect(), ..raster.clone() };
    let surface = raster_surface::between_cells(&raster).map_err(|e| e.within(format!("`{port}`")))?;
    Ok((Some(surface), gaps))
}

/// The columns of voxels as a grid.
fn plan(voxels: &Voxels) -> Grid {
    let [columns, rows, _] = voxels.count;
    let (cell_m, [left_m, bottom_m, _]) = (voxels.edge_m, voxels.low);
    Grid { columns, rows, cell_m, left_m, top_m: bottom_m + rows as f64 * cell_m }
}

fn counts(cluster: &Cluster, params: &DetectVoxelsParams) -> bool {
    let [loss, gain] = cluster.under;
    let wanted = if params.change == Change::Loss { loss > gain } else { gain > loss };
    let inside = cluster.inside.len();
    wanted && inside >= params.least_voxels as usize && inside as f64 > params.least_ratio * cluster.shell as f64
}

fn body(cluster: &Cluster, grid: &Grid, low: [f64; 3], edge_m: f64) -> Found {
    let mut columns: BTreeMap<(usize, usize), usize> = BTreeMap::new();
    for [x, y, _] in &cluster.inside {
        *columns.entry((grid.rows - 1 - y, *x)).or_default() += 1;
    }
    let voxel = edge_m * edge_m * edge_m;
    let volume_m3 = voxel * (cluster.inside.len() as f64 + 0.5 * cluster.shell as f64);
    // Half of the voxel above and of that below are within.
    let deepest = columns.values().max().copied().unwrap_or(0) as f64 + 1.0;
    let corner = |[x, y, z]: [usize; 3], corner: usize| {
        let side = |k: usize| if corner >> k & 1 == 1 { 1.5 } else { -0.5 };
        [x as f64 + side(0), y as f64 + side(1), z as f64 + side(2)]
    };
    let metres = |p: [f64; 3]| std::array::from_fn(|axis| low[axis] + p[axis] * edge_m);
    let points: Vec<[f64; 3]> = cluster.inside.iter().flat_map(|at| (0..8).map(|k| metres(corner(*at, k)))).collect();
    let sum = points.iter().fold(Vector3::zeros(), |sum, point| sum + Vector3::from(*point));
    let centroid = sum / points.len() as f64;
    // As of the volume, half of what is around it is within.
    let area_m2 = edge_m * edge_m * (columns.len() as f64 + 0.5 * cluster.rim as f64);
    Found {
        depth_mean_m: (volume_m3 / area_m2).min(deepest * edge_m),
        area_m2: Some(area_m2),
        cells: columns.into_keys().collect(),
        volume_m3,
        volume_sd_m3: voxel * cluster.shell as f64 / 4.0,
        depth_max_m: deepest * edge_m,
        score: deepest / 2.0,
        centroid_m: centroid.into(),
        points,
    }
}

/// Says what lies mostly under bridges: one of the surveys did not see it, so nobody knows whether anything changed.
fn note_unseen(unseen: &[Cluster], params: &DetectVoxelsParams, context: &Context) {
    if unseen.is_empty() {
        return;
    }
    let voxels: usize = unseen.iter().map(|cluster| cluster.inside.len()).sum();
    let volume = found::volume_text(voxels as f64 * params.voxel_m * params.voxel_m * params.voxel_m);
    context.metric("unseen", unseen.len() as f64, "1");
    context.note(format!(
        "{} spaces of {volume} m3 together are no changes: most of what encloses them are bridges over gaps, where a survey saw nothing",
        unseen.len()
    ));
}

/// Says what is not found since the outside reaches between the surfaces, if it is a quarter of all or more.
fn warn_of_open(open: &[usize], found: &[Found], params: &DetectVoxelsParams, context: &Context) {
    let large = open.iter().filter(|voxels| **voxels >= OPEN_VOXELS.max(params.least_voxels as usize));
    let voxels: usize = large.sum();
    let (edge_m, volume) = (params.voxel_m, found.iter().fold(0.0, |sum, found| sum + found.volume_m3));
    let lost_m3 = voxels as f64 * edge_m * edge_m * edge_m;
    if lost_m3 > OPEN_SHARE * (volume + lost_m3) {
        context.warn(format!(
            "{lost_m3:.3} m3 between the surfaces are open to the outside, over gaps of one of them (`bridge_m`), at its border, or since the voxels are finer than the noise: nothing is \
             found there; `detect-raster` does not need closed surfaces"
        ));
    }
}

/// Sides and volumes are those of the face whatever its dip, but columns of voxels stand upright.
fn warn_of_dip(outward: &Vector3<f64>, context: &Context) {
    if outward.z < facing::POINTS_FROM_ABOVE {
        context.warn(format!(
            "the face of `reference` dips by {:.0} degrees and is in the world frame: areas, outlines and depths of changes are those seen from above, \
             not those of the face; for these bring both epochs into the wall frame with one `transform` of `transform-crs`",
            facing::dip_deg(outward)
        ));
    }
}

/// How much of the face of the reference lies over or under the comparison. Columns of voxels tell that of faces that are not steep.
fn tested(voxels: &Voxels, outward: &Vector3<f64>) -> Tested {
    let [reference, both] = voxels.columns().map(|columns| columns as f64);
    let is_known = outward.z >= facing::POINTS_FROM_ABOVE && reference > 0.0;
    let known = |value: f64| if is_known { value } else { f64::NAN };
    let area_m2 = known(both * voxels.edge_m * voxels.edge_m);
    Tested { share: known(both / reference), whole: Whole::Reference, area_m2 }
}

fn report(found: &[Found], clusters: usize, occupied: [usize; 3], tested: &Tested, context: &Context) {
    let [reference, comparison, both] = occupied;
    let volume = found.iter().fold(0.0, |sum, found| sum + found.volume_m3);
    context.metric("voxels_reference", reference as f64, "1");
    context.metric("voxels_comparison", comparison as f64, "1");
    context.metric("voxels_shared", both as f64, "1");
    context.metric("clusters", clusters as f64, "1");
    if !tested.share.is_nan() {
        context.metric("tested_share", tested.share, "1");
    }
    context.metric("detections", found.len() as f64, "1");
    context.metric("volume", volume, "m3");
    if both == 0 {
        context.warn("the surfaces share no voxel: nothing closes the space between them; are both registered?");
    }
    context.headline(format!(
        "{} changes of {} m3 together, of {clusters} enclosed spaces{}",
        found.len(),
        found::volume_text(volume),
        tested.words()
    ));
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use rockface_core::artefact::{Frame, Inventory};
    use rockface_core::testing::{TestHost, run_stage};

    const GRID: Grid = Grid { columns: 60, rows: 50, cell_m: 0.02, left_m: -0.6, top_m: 0.5 };

    /// Elevations with a niche of 20 x 10 cells, 12 cm deep.
    fn elevations(depth: f32) -> Raster {
        let inside = |cell: usize| (20..40).contains(&(cell % 60)) && (20..30).contains(&(cell / 60));
        let values = (0..3000).map(|cell| if inside(cell) { 0.01 - depth } else { 0.01 }).collect();
        Raster::single(GRID, Frame::Wall, "elevation", "elevation", values)
    }

    fn found(before: Raster, after: Raster, change: &str) -> (Inventory, Raster) {
        let inputs = [("reference", before.into()), ("comparison", after.into())];
        let with = json!({"voxel_m": 0.02, "change": change});
        let mut made = run_stage::<DetectVoxels>(&TestHost::default(), &with, &inputs).unwrap().into_inner();
        match (made.remove("detections"), made.remove("labels")) {
            (Some(Artefact::Inventory(found)), Some(Artefact::Raster(labels))) => (found, labels),
            _ => panic!("outputs are missing"),
        }
    }

    #[test]
    fn a_niche_in_elevations_is_found_where_it_is() {
        let (made, labels) = found(elevations(0.0), elevations(0.12), "loss");
        assert_eq!(made.features.len(), 1);
        let number = |name: &str| made.numbers(name).unwrap()[0].unwrap();
        assert!((number("volume_m3") / (0.4 * 0.2 * 0.12) - 1.0).abs() < 0.3, "{}", number("volume_m3"));
        assert!((number("depth_max_m") - 0.12).abs() < 0.021);
        assert!(number("centroid_x_m").abs() < 0.03 && number("centroid_y_m").abs() < 0.03);
        let count = labels.bands[0].values.iter().filter(|label| **label > 0.0).count();
        assert!((number("cells") - count as f64).abs() < 0.5 && (120..=220).contains(&count), "{count}");
        assert!(found(elevations(0.0), elevations(0.12), "gain").0.features.is_empty());
        assert_eq!(found(elevations(0.12), elevations(0.0), "gain").0.features.len(), 1);
    }

    #[test]
    fn a_survey_of_half_of_the_face_is_warned_of_with_its_share() {
        let half = |last: usize| {
            let mut after = elevations(0.0);
            (0..3000).filter(|cell| cell % 60 >= last).for_each(|cell| after.bands[0].values[cell] = f32::NAN);
            let host = TestHost::default();
            let inputs = [("reference", elevations(0.0).into()), ("comparison", after.into())];
            run_stage::<DetectVoxels>(&host, &json!({"voxel_m": 0.02}), &inputs).unwrap();
            host.warnings()
        };
        assert!(half(57).is_empty());
        let told = half(30);
        assert!(told.len() == 1 && told[0].contains("% of the face of the reference"), "{told:?}");
    }

    #[test]
    fn a_loss_of_a_steep_face_in_the_world_frame_is_one() {
        // Steep to the west: what is up in the wall frame looks along (-1, 0, 0.15) here.
        let steep = |depth: f32| {
            let raster = elevations(depth);
            let mut surface = raster_surface::between_cells(&raster).unwrap();
            surface.frame = Frame::World;
            let origin_m = std::mem::take(&mut surface.origin_m);
            let turn = |point: [f32; 3]| {
                let [x, y, z]: [f64; 3] = std::array::from_fn(|axis| origin_m[axis] + f64::from(point[axis]));
                [0.15 * y - 0.99 * z, -x, 0.99 * y + 0.15 * z].map(|x| x as f32)
            };
            surface.points.iter_mut().for_each(|point| *point = turn(*point));
            surface
        };
        for (before, after, change) in [(0.0, 0.2, "loss"), (0.2, 0.0, "gain")] {
            let host = TestHost::default();
            let inputs = [("reference", steep(before).into()), ("comparison", steep(after).into())];
            let with = json!({"voxel_m": 0.03, "change": change});
            let made = run_stage::<DetectVoxels>(&host, &with, &inputs).unwrap().into_inner();
            let Artefact::Inventory(found) = &made["detections"] else { panic!("no inventory") };
            assert_eq!(found.features.len(), 1, "{change}");
            let told = host.warnings();
            assert!(
                told.iter().any(|text| text.contains("dips by 81 degrees") && text.contains("transform-crs")),
                "{told:?}"
            );
        }
    }

    #[test]
    fn a_crack_that_one_survey_did_not_see_is_no_change() {
        // A crack of three cells, 20 cm deep, which the first survey has as a gap.
        let is_crack = |cell: usize| (20..23).contains(&(cell % 60)) && (10..40).contains(&(cell / 60));
        let with = |depth: f32| {
            let values = (0..3000).map(|cell| if is_crack(cell) { depth } else { 0.01 }).collect();
            Raster::single(GRID, Frame::Wall, "elevation", "elevation", values)
        };
        for change in ["loss", "gain"] {
            let (before, after) = if change == "loss" { (f32::NAN, -0.2) } else { (-0.2, f32::NAN) };
            assert!(found(with(before), with(after), change).0.features.is_empty(), "{change}");
        }
        assert_eq!(found(with(0.01), with(-0.2), "loss").0.features.len(), 1);
    }

    #[test]
    fn a_niche_with_single_gaps_or_a_ring_of_them_is_found() {
        let whole = elevations(0.12);
        let missing = |is_gap: fn(usize, usize) -> bool| {
            let mut after = whole.clone();
            for (cell, z) in after.bands[0].values.iter_mut().enumerate() {
                *z = if is_gap(cell % 60, cell / 60) { f32::NAN } else { *z };
            }
            after
        };
        let single = missing(|x, y| (7 * x + 11 * y) % 13 == 0);
        // The niche has the columns 20 to 39 and the rows 20 to 29.
        let ring = missing(|x, y| {
            (18..42).contains(&x) && (18..32).contains(&y) && !((20..40).contains(&x) && (20..30).contains(&y))
        });
        for after in [single, ring] {
            let made = found(elevations(0.0), after, "loss").0;
            let volume = made.numbers("volume_m3").unwrap().into_iter().flatten().sum::<f64>();
            assert!(made.features.len() == 1 && (volume / (0.4 * 0.2 * 0.12) - 1.0).abs() < 0.35, "{volume}");
        }
    }

    #[test]
    fn a_hole_lets_the_outside_in() {
        let mut after = elevations(0.12);
        for cell in [0, 1, 60, 61] {
            after.bands[0].values[25 * 60 + 30 + cell] = f32::NAN;
        }
        let (reference, host) = (elevations(0.0), TestHost::default());
        let inputs = [("reference", reference.clone().into()), ("comparison", after.clone().into())];
        // A gap of two cells of 2 cm.
        for (bridge, count) in [(0.0, 0), (0.03, 0), (0.04, 1)] {
            let with = json!({"voxel_m": 0.02, "bridge_m": bridge});
            let made = run_stage::<DetectVoxels>(&host, &with, &inputs).unwrap();
            let Some(Artefact::Inventory(inventory)) = made.into_inner().remove("detections") else { panic!() };
            assert_eq!(inventory.features.len(), count, "{bridge}");
        }
        let told = host.warnings();
        assert!(told.len() == 2 && told[0].contains("m3 between the surfaces are open to the outside"), "{told:?}");
        assert_eq!(found(reference, after, "loss").0.features.len(), 1);
    }
}
