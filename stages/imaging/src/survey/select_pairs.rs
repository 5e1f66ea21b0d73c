//! `select-pairs`: selects the stereo pairs of an image block and fixes the order of their images.

use std::collections::BTreeMap;

use crate::camera::model::Camera;
use crate::matching::rectification::Rectification;
use crate::matching::side::Side;
use crate::survey::overlap::{NoPair, Views};
use rockface_core::artefact::{Cameras, Kind, Mesh, Pair, Pairs};
use rockface_core::numerics::union_find::UnionFind;
use rockface_core::params::{Fault, Range};
use rockface_core::{Context, InputSizes, Inputs, Outputs, Page, Port, Stage, StageError, choice, fail, params};

/// Vertices sampled for the overlap of images.
const SAMPLES: usize = 20_000;
/// Pixels of disparity that a pixel of an image may be without a warning.
const MOST_STRETCHED: f64 = 1.3;
/// Share of the face that pairs beyond `neighbours` may have alone without a warning.
const LOST_SHARE: f64 = 0.005;

choice! {
    /// Which pairs of an image come first.
    pub enum Order {
        /// Those of the largest overlap, which are often those of the shortest baselines.
        Overlap = "overlap",
        /// Those that measure depth most precisely: overlap times the square of the ratio of baseline (its part across the view) to distance.
        Precision = "precision",
    }
}

params! {
    /// Parameters of `select-pairs`.
    pub struct SelectPairsParams {
        /// Smallest share of its part of the face that each image of a pair must have in common with the other.
        min_overlap: f64 = 0.5; Range::Between(0.0, 1.0),
        /// Smallest ratio of baseline to distance.
        min_base_to_distance: f64 = 0.05; Range::NonNegative,
        /// Largest ratio of baseline to distance.
        max_base_to_distance: f64 = 1.0; Range::Positive,
        /// Largest angle between the optical axes, degrees.
        max_convergence_deg: f64 = 45.0; Range::Between(0.0, 180.0),
        /// Most pairs of an image, in the order that `prefer` says: first those that join images no chain of pairs connects yet, then the
        /// others, as long as both images have room; null: no limit.
        neighbours: Option<u32> = None; Range::AtLeast(1.0),
        /// Which pairs within the limits come first where `neighbours` limits them.
        prefer: Order = Order::Overlap,
        /// Pairs by hand, each `a+b`, whatever the limits say; null: every pair within the limits.
        list: Option<Vec<String>> = None,
    }
}

/// Chooses the stereo pairs to match by overlap, ratio of baseline to distance and convergence, or takes a list.
pub struct SelectPairs;

impl Stage for SelectPairs {
    type Params = SelectPairsParams;
    const NAME: &'static str = "select-pairs";
    const VERSION: u32 = 7;
    const PAGE: Page = Page::new(include_str!("select_pairs.md"));
    const INPUTS: &'static [Port] = &[
        Port::one("cameras", &[Kind::Cameras], "The true orientation."),
        Port::one("mesh", &[Kind::Mesh], "The face, in the same frame."),
    ];
    const OUTPUTS: &'static [Port] = &[
        Port::one("pairs", &[Kind::Pairs], "The pairs, in the order of the block."),
        Port::one("cameras", &[Kind::Cameras], "The orientation of the images that are in a pair."),
    ];

    fn check(params: &Self::Params) -> Vec<Fault> {
        if params.min_base_to_distance <= params.max_base_to_distance {
            return Vec::new();
        }
        let mut fault = Fault::new("greater than `max_base_to_distance`: no pair can be within the limits");
        fault.path = vec!["min_base_to_distance".to_owned()];
        vec![fault]
    }

    fn memory_bytes(_: &Self::Params, inputs: &InputSizes) -> u64 {
        // Samples of the mesh.
        inputs.total() + (4 << 20)
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let cameras: &Cameras = inputs.one("cameras")?;
        let mesh: &Mesh = inputs.one("mesh")?;
        if mesh.frame != cameras.frame {
            let error = StageError::new(format!(
                "the mesh is in the {} frame, the cameras in the {} frame",
                mesh.frame, cameras.frame
            ));
            return Err(error.hint("send both through one transform-crs"));
        }
        let views = Views::of_face(cameras, mesh, SAMPLES);
        let pairs = match &params.list {
            Some(list) => by_hand(list, cameras, &views)?,
            None => within_limits(params, cameras, &views, context)?,
        };
        for pair in &pairs {
            context.note(figures(pair));
            // A pair that is named holds whatever its figures are.
            let broken = faults(params, pair);
            if !broken.is_empty() {
                context.warn(format!("{}, beyond {}", figures(pair), broken.join(", ")));
            }
        }
        warn_of_inclined(cameras, &pairs, context);
        context.metric("pairs", pairs.len() as f64, "1");
        context.metric("face_in_pairs", views.share_in(&numbers(cameras, &pairs)), "1");
        let mut paired = cameras.clone();
        paired.images.retain(|image| pairs.iter().any(|pair| [&pair.first, &pair.second].contains(&&image.name)));
        if params.list.is_none() {
            warn_of_single_images(cameras, &paired, context);
        }
        Ok(Outputs::of("pairs", Pairs { pairs }).and("cameras", paired))
    }
}

/// The numbers of the images of each pair in the block.
fn numbers(cameras: &Cameras, pairs: &[Pair]) -> Vec<[usize; 2]> {
    let place = |name: &str| cameras.images.iter().position(|image| image.name == name);
    pairs.iter().filter_map(|pair| Some([place(&pair.first)?, place(&pair.second)?])).collect()
}

/// Disparity counts pixels of the rectified images. Where the baseline is inclined to the view, one of the two is stretched there, and noise of
/// disparity is less than as many of its own pixels.
fn warn_of_inclined(cameras: &Cameras, pairs: &[Pair], context: &Context) {
    let ready: Vec<Camera> = cameras.images.iter().map(|image| Camera::new(cameras.sensor(image), image)).collect();
    let mut inclined = Vec::new();
    for (pair, images) in pairs.iter().zip(numbers(cameras, pairs)) {
        let both = images.map(|image| &ready[image]);
        let Ok(rectification) = Rectification::new(both, 1) else { continue };
        let scale = |side: Side| rectification.pixels_along_base(side, both[side]).unwrap_or(0.0);
        let largest = Side::BOTH.map(scale).into_iter().fold(0.0, f64::max);
        if largest > MOST_STRETCHED {
            inclined.push((largest, pair));
        }
    }
    inclined.sort_by(|(one, _), (other, _)| other.total_cmp(one));
    if let Some((largest, pair)) = inclined.first() {
        let others = if inclined.len() > 1 { format!(" and {} more", inclined.len() - 1) } else { String::new() };
        context.warn(format!(
            "the baseline of {}{others} is inclined to the view: a pixel of one of its images is {largest:.2} pixels of disparity, so one pixel of noise \
             of disparity is only {:.2} of its pixels; leave the pair out, or raise its noise",
            pair.name,
            1.0 / largest
        ));
    }
}

fn warn_of_single_images(cameras: &Cameras, paired: &Cameras, context: &Context) {
    let names: Vec<&str> = cameras.images.iter().map(|image| image.name.as_str()).collect();
    let single: Vec<&str> = names.into_iter().filter(|name| paired.image(name).is_none()).collect();
    if let [first, others @ ..] = single.as_slice() {
        let others = if others.is_empty() { String::new() } else { format!(" and {} more images", others.len()) };
        context.warn(format!("no pair within the limits has `{first}`{others}"));
    }
}

fn figures(pair: &Pair) -> String {
    format!(
        "{}: overlap {:.3}, baseline {:.3} m at {:.3} m (ratio {:.3}), convergence {:.2} deg",
        pair.name,
        pair.overlap,
        pair.baseline_m,
        pair.distance_m,
        pair.baseline_m / pair.distance_m,
        pair.convergence_rad.to_degrees()
    )
}

fn by_hand(list: &[String], cameras: &Cameras, views: &Views) -> Result<Vec<Pair>, StageError> {
    let mut pairs: Vec<Pair> = Vec::with_capacity(list.len());
    for entry in list {
        let (i, j) = named(entry, cameras)?;
        let pair = views.pair(i.min(j), i.max(j)).map_err(|why| {
            StageError::new(format!("list: `{entry}` is no stereo pair: {why}"))
                .hint("leave it out of `list`, or check frames and orientation")
        })?;
        if pairs.iter().any(|other| other.name == pair.name) {
            fail!("list: the pair `{entry}` is there twice");
        }
        pairs.push(pair);
    }
    if pairs.is_empty() {
        return Err(
            StageError::new("list: no pair in it").hint("leave `list` out to take every pair within the limits")
        );
    }
    Ok(pairs)
}

/// The two images of `a+b`; a name may itself have a plus sign.
fn named(entry: &str, cameras: &Cameras) -> Result<(usize, usize), StageError> {
    let find = |name: &str| cameras.images.iter().position(|image| image.name == name);
    let split = |(at, _): (usize, &str)| Some((find(&entry[..at])?, find(&entry[at + 1..])?));
    match entry.match_indices('+').find_map(split) {
        Some((i, j)) if i != j => Ok((i, j)),
        Some(_) => Err(StageError::new(format!("list: `{entry}` is one image twice"))),
        None => {
            let names: Vec<&str> = cameras.images.iter().map(|image| image.name.as_str()).collect();
            let error = StageError::new(format!("list: `{entry}` does not name two images as `a+b`"));
            Err(error.hint(format!("images: {}", names.join(", "))))
        }
    }
}

fn within_limits(
    params: &SelectPairsParams,
    cameras: &Cameras,
    views: &Views,
    context: &Context,
) -> Result<Vec<Pair>, StageError> {
    let n = cameras.images.len();
    let (mut chosen, mut left_out, mut refused) = (Vec::new(), Vec::new(), Vec::new());
    for (i, j) in (0..n).flat_map(|i| (i + 1..n).map(move |j| (i, j))) {
        context.check_cancelled()?;
        match views.pair(i, j) {
            Ok(pair) if faults(params, &pair).is_empty() => chosen.push(pair),
            Ok(pair) => left_out.push(pair),
            Err(why) => refused.push(why),
        }
    }
    for why in [NoPair::NoBaseline, NoPair::Forward, NoPair::NothingShared] {
        let count = refused.iter().filter(|other| **other == why).count();
        if count > 0 {
            context.note(format!("{count} combinations left out: {why}"));
        }
    }
    if chosen.is_empty() {
        return Err(none(params, n, &left_out));
    }
    let Some(most) = params.neighbours else { return Ok(chosen) };
    let weights: Vec<f64> = chosen.iter().map(|pair| weight(params.prefer, cameras, pair)).collect();
    let kept = nearest(&chosen, &weights, most);
    let [parts, all_parts] = [&kept, &chosen].map(|pairs| groups(pairs));
    if parts > all_parts {
        context.warn(format!(
            "with {most} pairs of an image at most (`neighbours`) the images fall into {parts} groups that no pair joins, all pairs within \
             the limits make {all_parts}: a difference is noisier where groups meet; raise `neighbours`"
        ));
    }
    let [share, whole] = [&kept, &chosen].map(|pairs| views.share_in(&numbers(cameras, pairs)));
    if whole - share > LOST_SHARE {
        context.warn(format!(
            "with {most} pairs of an image at most (`neighbours`) {:.1} % of the face lie in a pair, with all pairs within the limits {:.1} %: raise `neighbours`",
            100.0 * share,
            100.0 * whole
        ));
    }
    Ok(kept)
}

/// What a pair is preferred by. Depth of a normal pair has the deviation Z / (B / Z) times that of angles, and pairs are averaged by weights of
/// one over the variance; what they measure in common counts as often as there are points.
fn weight(prefer: Order, cameras: &Cameras, pair: &Pair) -> f64 {
    let ends = cameras.image(&pair.first).zip(cameras.image(&pair.second));
    match (prefer, ends) {
        (Order::Precision, Some((first, second))) => {
            let view = (first.axis() + second.axis()).normalize();
            let across_m = (second.centre() - first.centre()).cross(&view).norm();
            pair.overlap * (across_m / pair.distance_m) * (across_m / pair.distance_m)
        }
        _ => pair.overlap,
    }
}

/// At most `most` pairs of each image, in the order given. Pairs of the largest `weights` come first, in two rounds: those that join two
/// groups of images, so that a strip does not fall apart where its images overlap less, and then the others.
fn nearest(pairs: &[Pair], weights: &[f64], most: u32) -> Vec<Pair> {
    let mut order: Vec<usize> = (0..pairs.len()).collect();
    order.sort_by(|a, b| weights[*b].total_cmp(&weights[*a]).then(a.cmp(b)));
    let (ends, images) = numbered(pairs);
    let (mut sets, mut taken, mut kept) = (UnionFind::new(images), vec![0; images], vec![false; pairs.len()]);
    for joining in [true, false] {
        for index in &order {
            let [a, b] = ends[*index];
            let is_wanted = !kept[*index] && (!joining || sets.root(a) != sets.root(b));
            if is_wanted && taken[a] < most && taken[b] < most {
                sets.join(a, b);
                (taken[a], taken[b]) = (taken[a] + 1, taken[b] + 1);
                kept[*index] = true;
            }
        }
    }
    pairs.iter().zip(kept).filter(|(_, kept)| *kept).map(|(pair, _)| pair.clone()).collect()
}

/// The two images of each pair as numbers, and how many images there are.
fn numbered(pairs: &[Pair]) -> (Vec<[usize; 2]>, usize) {
    let mut numbers: BTreeMap<&str, usize> = BTreeMap::new();
    let mut number = |image| {
        let next = numbers.len();
        *numbers.entry(image).or_insert(next)
    };
    let ends = pairs.iter().map(|pair| [number(pair.first.as_str()), number(pair.second.as_str())]).collect();
    (ends, numbers.len())
}

/// How many groups of images there are that chains of pairs connect.
fn groups(pairs: &[Pair]) -> usize {
    let (ends, images) = numbered(pairs);
    let mut sets = UnionFind::new(images);
    ends.into_iter().for_each(|[a, b]| {
        sets.join(a, b);
    });
    (0..images).filter(|image| sets.root(*image) == *image).count()
}

/// The parameters whose limits a pair exceeds.
fn faults(params: &SelectPairsParams, pair: &Pair) -> Vec<&'static str> {
    let ratio = pair.baseline_m / pair.distance_m;
    let limits = [
        (pair.overlap < params.min_overlap, "min_overlap"),
        (ratio < params.min_base_to_distance, "min_base_to_distance"),
        (ratio > params.max_base_to_distance, "max_base_to_distance"),
        (pair.convergence_rad.to_degrees() > params.max_convergence_deg, "max_convergence_deg"),
    ];
    limits.into_iter().filter_map(|(broken, name)| broken.then_some(name)).collect()
}

fn none(params: &SelectPairsParams, images: usize, left_out: &[Pair]) -> StageError {
    let rank = |pair: &&Pair| (faults(params, pair).len(), -pair.overlap);
    let best = left_out.iter().min_by(|a, b| {
        let (a, b) = (rank(a), rank(b));
        a.0.cmp(&b.0).then(a.1.total_cmp(&b.1))
    });
    match best {
        Some(pair) => {
            StageError::new(format!("no pair of {images} images is within the limits; the best is {}", figures(pair)))
                .hint(format!("it breaks {}", faults(params, pair).join(", ")))
        }
        None => StageError::new(format!("no two of {images} images make a stereo pair"))
            .hint("they share no part of the face, have no baseline, or look along it: check frames and centres"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::camera_files::json as json_file;
    use rockface_core::artefact::{Artefact, Frame};
    use rockface_core::params::ParamType;
    use rockface_core::testing::TestHost;
    use serde_json::{Value, json};
    use std::sync::Arc;

    /// Images that look straight at the plane Z = 0 from 20 m, at these abscissae; `up` is turned by half a turn.
    fn row(images: &[(&str, f64)]) -> Cameras {
        let sensor = json!({"id": 0, "width": 2000, "height": 2000, "f": 4000, "cx": 999.5, "cy": 999.5});
        let image = |(name, x): &(&str, f64)| {
            let q = if *name == "up" { [0, 0, 1, 0] } else { [0, 1, 0, 0] };
            json!({"name": name, "sensor": 0, "q_wxyz": q, "C": [x, 0, 20]})
        };
        let file = json!({"sensors": [sensor], "images": images.iter().map(image).collect::<Vec<_>>()});
        json_file::read(file.to_string().as_bytes(), Frame::Wall).unwrap().cameras
    }

    fn face(frame: Frame) -> Mesh {
        let at = |i: i32| 0.25 * f64::from(i) - 0.125;
        let vertices = (-80..80).flat_map(|i| (-40..40).map(move |j| [at(i), at(j), 0.0])).collect();
        let squares = (0..159u32).flat_map(|i| (0..79).map(move |j| 80 * i + j));
        let triangles = squares.flat_map(|v| [[v, v + 80, v + 1], [v + 1, v + 80, v + 81]]).collect();
        Mesh { frame, vertices, triangles, colours: Vec::new() }
    }

    fn select(cameras: &Cameras, mesh: Mesh, with: &Value) -> Result<Vec<Pair>, StageError> {
        select_on(&TestHost::default(), cameras, mesh, with).map(|(pairs, _)| pairs)
    }

    fn select_on(
        host: &TestHost,
        cameras: &Cameras,
        mesh: Mesh,
        with: &Value,
    ) -> Result<(Vec<Pair>, Cameras), StageError> {
        let mut inputs = Inputs::default();
        inputs.push("cameras", rockface_core::Point::new(), Arc::new(cameras.clone().into()));
        inputs.push("mesh", rockface_core::Point::new(), Arc::new(mesh.into()));
        let params = SelectPairsParams::decode(with).unwrap();
        let made = SelectPairs::run(&params, &inputs, &Context::new(host))?.into_inner();
        match (&made["pairs"], &made["cameras"]) {
            (Artefact::Pairs(pairs), Artefact::Cameras(cameras)) => Ok((pairs.pairs.clone(), cameras.clone())),
            other => panic!("{other:?}"),
        }
    }

    fn names(pairs: &[Pair]) -> Vec<&str> {
        pairs.iter().map(|pair| pair.name.as_str()).collect()
    }

    #[test]
    fn a_row_gives_its_neighbours_in_the_order_of_x() {
        let cameras = row(&[("c", 10.0), ("b", 4.0), ("a", 0.0)]);
        let pairs = select(&cameras, face(Frame::Wall), &json!({})).unwrap();
        assert_eq!(names(&pairs), ["a+b"]);
        // Footprints of 10 m, 4 m apart: 6 m shared.
        assert!((pairs[0].overlap - 0.6).abs() < 1e-12, "{}", pairs[0].overlap);
        assert!((pairs[0].distance_m - 20.0).abs() < 1e-12);
        assert!(pairs[0].convergence_rad.abs() < 1e-12 && (pairs[0].baseline_m - 4.0).abs() < 1e-12);
        let more = select(&cameras, face(Frame::Wall), &json!({"min_overlap": 0.3})).unwrap();
        assert_eq!(names(&more), ["b+c", "a+b"]);
    }

    #[test]
    fn images_without_a_pair_are_left_out_and_named() {
        let cameras = row(&[("c", 10.0), ("b", 4.0), ("a", 0.0)]);
        let host = TestHost::default();
        let (_, paired) = select_on(&host, &cameras, face(Frame::Wall), &json!({})).unwrap();
        let names: Vec<&str> = paired.images.iter().map(|image| image.name.as_str()).collect();
        assert_eq!((names, paired.sensors.len()), (vec!["b", "a"], cameras.sensors.len()));
        assert!(host.warnings()[0].ends_with("has `c`"), "{:?}", host.warnings());
        let chosen = TestHost::default();
        select_on(&chosen, &cameras, face(Frame::Wall), &json!({"list": ["a+b"]})).unwrap();
        assert!(chosen.warnings().is_empty());
    }

    #[test]
    fn an_image_that_looks_along_the_baseline_makes_no_pair() {
        let mut cameras = row(&[("a", 0.0), ("b", 4.0)]);
        let vertices = [nalgebra::Vector3::new(2.0, 0.0, 0.0)];
        assert!(Views::new(&cameras, &vertices).pair(0, 1).is_ok());
        // Turned by 86 degrees towards the first: both axes together still look across the baseline.
        cameras.images[1].camera_from_object = [0.0, 0.732, 0.0, 0.681];
        assert_eq!(Views::new(&cameras, &vertices).pair(0, 1).unwrap_err(), NoPair::Forward);
    }

    #[test]
    fn neighbours_are_those_of_the_largest_overlap() {
        let cameras = row(&[("a", 0.0), ("b", 1.0), ("c", 2.0), ("d", 3.0)]);
        let chosen = |with: Value| select(&cameras, face(Frame::Wall), &with).unwrap();
        assert_eq!(chosen(json!({"min_overlap": 0.1})).len(), 6);
        let pairs = chosen(json!({"min_overlap": 0.1, "neighbours": 2}));
        assert_eq!(names(&pairs), ["a+b", "a+d", "b+c", "c+d"]);
        assert_eq!(names(&chosen(json!({"min_overlap": 0.1, "neighbours": 1}))), ["a+b", "c+d"]);
    }

    #[test]
    fn preferred_by_precision_are_long_baselines_within_the_limits() {
        let cameras = row(&[("a", 0.0), ("b", 1.0), ("c", 2.0), ("d", 3.0)]);
        let chosen = |with: Value| select(&cameras, face(Frame::Wall), &with).unwrap();
        let with = |most: u32, least: f64| json!({"min_overlap": least, "neighbours": most, "prefer": "precision"});
        // Footprints of 10 m: 0.7 x 3^2 for a+d, 0.8 x 2^2 for a+c and b+d, 0.9 for the others.
        assert_eq!(names(&chosen(with(1, 0.1))), ["a+d", "b+c"]);
        assert_eq!(names(&chosen(with(2, 0.1))), ["a+c", "a+d", "b+c", "b+d"]);
        assert_eq!(names(&chosen(with(2, 0.75))), ["a+b", "a+c", "b+d", "c+d"]);
        // Without a limit every pair is there, in whatever order.
        assert_eq!(chosen(json!({"min_overlap": 0.1, "prefer": "precision"})).len(), 6);
    }

    #[test]
    fn the_part_of_a_baseline_along_the_view_does_not_count() {
        let mut cameras = row(&[("a", 0.0), ("b", 2.0), ("c", 2.0)]);
        cameras.images[2].centre_m[2] = 22.0;
        let views = Views::of_face(&cameras, &face(Frame::Wall), SAMPLES);
        let [level, deep] = [1, 2].map(|second| {
            let pair = views.pair(0, second).unwrap();
            let ratio = 2.0 / pair.distance_m;
            weight(Order::Precision, &cameras, &pair) / (pair.overlap * ratio * ratio)
        });
        assert!((level - 1.0).abs() < 1e-12 && (deep - 1.0).abs() < 1e-12, "{level} {deep}");
    }

    #[test]
    fn a_baseline_inclined_to_the_view_and_a_part_of_the_face_that_is_lost_are_warned_of() {
        let warnings = |cameras: &Cameras, with: &Value| {
            let host = TestHost::default();
            select_on(&host, cameras, face(Frame::Wall), with).unwrap();
            (host.warnings(), host.metric("face_in_pairs").unwrap())
        };
        let mut cameras = row(&[("a", 0.0), ("b", 2.0)]);
        assert_eq!(warnings(&cameras, &json!({})).0, [""; 0]);
        cameras.images[1].centre_m[2] = 24.0;
        let (told, _) = warnings(&cameras, &json!({"min_overlap": 0.3}));
        assert!(told[0].starts_with("the baseline of a+b is inclined"), "{told:?}");
        // Footprints of 10 m: three pairs have 14 m x 10 m of 40 m x 20 m in common, the two that are left 12 m.
        let cameras = row(&[("a", 0.0), ("b", 4.0), ("c", 8.0), ("d", 12.0)]);
        let (told, share) = warnings(&cameras, &json!({"min_overlap": 0.1}));
        assert!(told.is_empty() && (share - 0.175).abs() < 0.005, "{told:?} {share}");
        let (told, share) = warnings(&cameras, &json!({"min_overlap": 0.1, "neighbours": 1}));
        assert!(
            told.iter().any(|text| text.contains("of the face lie in a pair, with all pairs"))
                && (share - 0.15).abs() < 0.005,
            "{told:?} {share}"
        );
    }

    /// Two rows of images before a face that ends soon after them.
    fn block(columns: u8) -> Cameras {
        let name = |row: u8, column: u8| format!("{}{column}", if row == 0 { "a" } else { "b" });
        let names: Vec<String> = (0..2).flat_map(|row| (0..columns).map(move |column| name(row, column))).collect();
        let places =
            (0..2u8).flat_map(|_| 0..columns).map(|column| 5.0 * (f64::from(column) - 0.5 * f64::from(columns - 1)));
        let mut cameras = row(&names.iter().map(String::as_str).zip(places).collect::<Vec<_>>());
        let count = usize::from(columns);
        cameras
            .images
            .iter_mut()
            .enumerate()
            .for_each(|(i, image)| image.centre_m[1] = if i < count { -1.0 } else { 1.0 });
        cameras
    }

    #[test]
    fn a_symmetric_block_is_one_group_and_its_ends_have_as_many_pairs() {
        for (columns, most) in [(4, 3), (6, 3), (6, 4), (9, 3)] {
            let cameras = block(columns);
            let host = TestHost::default();
            let with = json!({"min_overlap": 0.1, "neighbours": most});
            let (pairs, _) = select_on(&host, &cameras, face(Frame::Wall), &with).unwrap();
            assert_eq!((groups(&pairs), host.warnings()), (1, Vec::new()), "{columns} {most}: {:?}", names(&pairs));
            let mut once = names(&pairs);
            once.sort_unstable();
            once.dedup();
            assert_eq!(once.len(), pairs.len(), "{:?}", names(&pairs));
            let of = |image: &str| pairs.iter().filter(|pair| [&*pair.first, &*pair.second].contains(&image)).count();
            assert!(cameras.images.iter().all(|image| (1..=most).contains(&of(&image.name))), "{:?}", names(&pairs));
        }
        let all = select(&block(4), face(Frame::Wall), &json!({"min_overlap": 0.1})).unwrap();
        let overlap = |name: &str| all.iter().find(|pair| pair.name == name).unwrap().overlap;
        assert!((overlap("a0+a1") - overlap("a2+a3")).abs() < 0.02, "{} {}", overlap("a0+a1"), overlap("a2+a3"));
    }

    #[test]
    fn a_block_that_falls_apart_is_warned_of() {
        let host = TestHost::default();
        let with = json!({"min_overlap": 0.1, "neighbours": 1});
        let (pairs, _) = select_on(&host, &block(4), face(Frame::Wall), &with).unwrap();
        assert_eq!(groups(&pairs), 4);
        assert!(host.warnings()[0].contains("fall into 4 groups"), "{:?}", host.warnings());
    }

    #[test]
    fn the_first_images_own_x_axis_decides() {
        let turned = row(&[("up", 0.0), ("b", 3.0)]);
        assert_eq!(names(&select(&turned, face(Frame::Wall), &json!({})).unwrap()), ["b+up"]);
        let mut vertical = row(&[("a", 0.0), ("b", 0.0)]);
        vertical.images[1].centre_m[1] = 3.0;
        assert_eq!(names(&select(&vertical, face(Frame::Wall), &json!({})).unwrap()), ["a+b"]);
    }

    #[test]
    fn a_pair_that_is_named_holds_beyond_the_limits_with_a_warning() {
        let cameras = row(&[("a", 0.0), ("b", 4.0)]);
        let warnings = |params: Value| {
            let host = TestHost::default();
            let inputs = [("mesh", Artefact::from(face(Frame::Wall))), ("cameras", Artefact::from(cameras.clone()))];
            rockface_core::testing::run_stage::<SelectPairs>(&host, &params, &inputs).unwrap();
            host.warnings()
        };
        let warned = warnings(json!({"list": ["a+b"], "min_overlap": 0.9}));
        assert!(warned[0].contains("overlap 0.600") && warned[0].ends_with("beyond min_overlap"), "{warned:?}");
        assert_eq!(warnings(json!({"list": ["a+b"]})), [""; 0]);
    }

    #[test]
    fn a_list_by_hand_is_put_in_order() {
        let cameras = row(&[("c+1", 10.0), ("b", 4.0), ("a", 0.0)]);
        let list = json!({"list": ["c+1+b", "b+a"]});
        assert_eq!(names(&select(&cameras, face(Frame::Wall), &list).unwrap()), ["b+c+1", "a+b"]);
        for (list, text) in [
            (json!(["a+d"]), "`a+d` does not name two images"),
            (json!(["a+a"]), "one image twice"),
            (json!(["a+b", "b+a"]), "there twice"),
            (json!([]), "no pair"),
            (json!(["a+c+1"]), "no part of the face"),
        ] {
            let message = select(&cameras, face(Frame::Wall), &json!({"list": list})).unwrap_err().message;
            assert!(message.contains(text), "{message}");
        }
    }

    #[test]
    fn no_pair_tells_the_best_and_forward_motion_is_left_out() {
        let cameras = row(&[("a", 0.0), ("b", 4.0)]);
        let error = select(&cameras, face(Frame::Wall), &json!({"min_overlap": 0.9})).unwrap_err();
        assert!(error.message.contains("a+b: overlap 0.600, baseline 4.000 m"), "{error}");
        assert_eq!(error.hint.unwrap(), "it breaks min_overlap");
        let mut forward = row(&[("a", 0.0), ("b", 0.01)]);
        forward.images[1].centre_m[2] = 15.0;
        let error = select(&forward, face(Frame::Wall), &json!({})).unwrap_err();
        assert!(error.message.contains("no two of 2 images"), "{error}");
        let error = select(&cameras, face(Frame::World), &json!({})).unwrap_err();
        assert!(error.message.contains("world frame"));
    }
}
