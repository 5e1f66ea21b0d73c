//! An artefact of every kind, as the store keeps it.

use std::collections::BTreeMap;
use std::io;

use rockface_core::artefact::{
    Acceptance, Artefact, Band, Cell, Cloud, Contrast, Covariance, Depth, Feature, Figure, Files, Frame, Grid,
    GroupModel, Inventory, LateralShift, LevelContrast, LevelFigures, Member, Mesh, Meshes, Noise, Pair, Pairs,
    Parametric, Part, Picture, PlaceSpectrum, Polygon, Raster, ReliefLaw, Sample, Shown, Surface, Table, Transform,
};
use serde_json::json;

use super::{Seed, seed};
use crate::targets::{Files as Lent, image_block, made};

/// A seed of every kind, and their sketches.
pub fn all() -> io::Result<Vec<Seed>> {
    let artefacts = every()?;
    let mut seeds = Vec::new();
    for (target, name, artefact) in &artefacts {
        seeds.push(seed(target, name, artefact.encode().map_err(io::Error::other)?));
        let shown = rockface_stages::registry()
            .look()
            .sketches(artefact)
            .into_iter()
            .map(|sketch| Shown { port: "out".into(), sketch });
        let shown: Vec<Shown> = shown.collect();
        seeds.push(seed("sketches", &format!("{target}-{name}"), Shown::write_all(&shown).map_err(io::Error::other)?));
    }
    Ok(seeds)
}

fn every() -> io::Result<Vec<(&'static str, &'static str, Artefact)>> {
    let raster = raster();
    let picture = rockface_stages::registry()
        .look()
        .preview(&Artefact::from(raster.clone()), &[])
        .map(|preview| preview.to_png());
    let png = picture.ok_or_else(|| io::Error::other("a raster has no preview"))?.map_err(io::Error::other)?;
    let mut bytes = raster.clone();
    bytes.sample = Sample::Byte;
    bytes.bands = vec![Band { name: "mask".into(), values: vec![0.0, 1.0, 255.0, 0.0, 1.0, 1.0] }];
    Ok(vec![
        ("artefact-cloud", "whole", whole_cloud().into()),
        ("artefact-cloud", "bare", Cloud::new(Frame::World, whole_cloud().points).into()),
        ("artefact-mesh", "coloured", Mesh { colours: vec![[1, 2, 3]; 16], ..hills() }.into()),
        ("artefact-mesh", "bare", hills().into()),
        ("artefact-meshes", "two", Meshes { frame: Frame::Wall, parts: vec![part("a"), part("b/..")] }.into()),
        ("artefact-surface", "small", surface().into()),
        ("artefact-raster", "float", raster.into()),
        ("artefact-raster", "byte", bytes.into()),
        ("artefact-depth", "two", depth().into()),
        ("artefact-cameras", "two", image_block().into()),
        ("artefact-covariance", "two", covariance().into()),
        ("artefact-pairs", "one", pairs().into()),
        ("artefact-transform", "identity", Transform::identity("world", "wall").into()),
        ("artefact-table", "cells", table().into()),
        ("artefact-acceptance", "one", acceptance().into()),
        ("artefact-noise", "fields", noise().into()),
        ("artefact-noise", "parametric", parametric_noise().into()),
        ("artefact-picture", "preview", Picture { png }.into()),
        ("artefact-figure", "rectangle", figure().into()),
        ("artefact-files", "two", files().into()),
        ("artefact-inventory", "two", inventory().into()),
        ("artefact-candidates", "shapes", candidates()?),
    ])
}

/// A noise model of six cells and two members.
fn noise() -> Noise {
    let member = |name: &str, bad: bool| Member {
        name: name.into(),
        bad,
        log_strength: vec![0.1, -0.1],
        trend_m: [0.001, -0.002, 0.003, 0.0004, 0.0, -0.0005, 0.0001, 0.0, -0.0002, 0.0003],
        log_amplitude: vec![0.2, 0.0],
        field_log_amplitude: vec![0.0, 0.1],
        skewness: -0.2,
    };
    Noise {
        frame: Frame::Wall,
        grid: Grid { columns: 3, rows: 2, cell_m: 0.5, left_m: -1.0, top_m: 2.0 },
        donors: 2,
        length_cells: 3.0,
        common_share: 0.3,
        bad_share: 0.25,
        class_log_strength: vec![-1.0, 0.5],
        jitter: 0.2,
        sharpness: 4,
        contrast: Contrast {
            finest_cells: 0.7,
            levels: vec![LevelContrast {
                own_power: [0.2, 0.1, 0.0],
                local_power: [-0.1, 0.2],
                log_gain: [0.01, -0.02, 0.0],
                growth: [[0.3, 0.0, 0.0, 0.1, 0.2]; 5],
                usual: LevelFigures { log_rms: [-0.4, -0.5, -1.0], unevenness: [1.5, 1.4, 1.3, -1.0, -1.2] },
                drawn: LevelFigures { log_rms: [-0.5, -0.4, -1.1], unevenness: [1.6, 1.4, 1.2, -1.1, -1.2] },
                deviation: [0.01, 0.02, 0.03, 0.04, 0.05],
            }],
        },
        log_gain: vec![0.0, 0.1],
        relief: ReliefLaw { flat_px: 0.2, gain_px_m: 3.0, window_cells: 2 },
        asymmetry_gain: [1.3, 1.2, 0.0],
        gap_gain: 0.8,
        gap_variety: 1.3,
        skewness_gain: 1.7,
        parametric: None,
        members: vec![member("a", false), member("b", true)],
        orders: [vec![0], vec![0]],
        strength: vec![0.3; 6],
        elevation: vec![0.0, 1.0, f32::NAN, 0.5, 0.5, 0.5],
        bend_shapes: vec![vec![0.1, 0.0, -0.1, 0.2, 0.0, 0.3]; 7],
        trend_weights: vec![1.0, 0.5, 2.0, 1.0, 0.25, 4.0],
        fields: vec![vec![0.5, -0.5, 1.0, 0.0, 0.25, -1.0]; 2],
        weights: vec![vec![127, 192, 1, 127, 127, 127]; 2],
    }
}

fn parametric_noise() -> Noise {
    let spectrum = |log_strength: f64| PlaceSpectrum { log_strength, log_amplitude: vec![0.5, log_strength] };
    let shift = LateralShift { deviation_cells: 1.0, length_cells: 8.0, across_cells: 2.0, share: 0.4, half_m: 0.01 };
    let parametric = Parametric { spectra: [-1.5, -0.5].map(spectrum).into(), shift: Some(shift) };
    Noise { fields: Vec::new(), parametric: Some(Box::new(parametric)), ..noise() }
}

/// A mesh of 16 points over 3 x 3 m.
pub fn hills() -> Mesh {
    let at = |number: u32| [f64::from(number % 4), f64::from(number / 4), f64::from(number * 7 % 5) * 0.1];
    let square = |corner: u32| [[corner, corner + 1, corner + 5], [corner, corner + 5, corner + 4]];
    let corners = (0..3).flat_map(|row| (0..3).map(move |column| 4 * row + column));
    let triangles = corners.flat_map(square).collect();
    Mesh { frame: Frame::Wall, vertices: (0..16).map(at).collect(), triangles, colours: Vec::new() }
}

/// The points of the mesh with all that points can have.
pub fn whole_cloud() -> Cloud {
    let points = hills().vertices;
    let count = points.len();
    let numbers =
        BTreeMap::from([("views".to_owned(), vec![2; count]), ("id".to_owned(), (0..count as u32).collect())]);
    let (normals, colours) = (vec![[0.0, 0.0, 1.0]; count], vec![[9, 8, 7]; count]);
    let values = BTreeMap::from([("difference".to_owned(), vec![-0.25; count])]);
    Cloud { frame: Frame::World, points, normals, colours, numbers, values }
}

fn part(name: &str) -> Part {
    let vertices = vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let triangles = vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];
    Part { name: name.into(), class: "wedge".into(), vertices, triangles }
}

fn surface() -> Surface {
    let points = (0..6u8).map(|n| [f32::from(n % 3), f32::from(n / 3), if n == 4 { f32::NAN } else { 0.5 }]).collect();
    let squares = vec![Surface::FIRST | Surface::SECOND, Surface::FIRST | Surface::OTHER_DIAGONAL];
    Surface { frame: Frame::Wall, width: 3, height: 2, origin_m: [10.0, 20.0, 30.0], points, squares }
}

fn raster() -> Raster {
    let grid = Grid { columns: 3, rows: 2, cell_m: 0.5, left_m: 10.0, top_m: 20.0 };
    let band = |name: &str, step: f32| Band {
        name: name.into(),
        values: (0..6u8).map(|n| if n == 2 { f32::NAN } else { step * f32::from(n) }).collect(),
    };
    let bands = vec![band("a", 0.5), band("b", -2.0)];
    Raster { grid, frame: Frame::Wall, quantity: "difference".into(), sample: Sample::Float, bands }
}

fn depth() -> Depth {
    let block = image_block();
    let z: Vec<f32> = (0..24u8).map(|n| if n == 5 { f32::NAN } else { 20.0 + f32::from(n) * 0.01 }).collect();
    let channels = BTreeMap::from([("noise".to_owned(), vec![0.01; 24])]);
    let (sensor, image) = (block.sensors[0].clone(), block.images[0].clone());
    Depth { frame: Frame::Wall, sensor, image, downscale: 10, width: 6, height: 4, z, channels }
}

/// A covariance of four parameters of the block.
pub fn covariance() -> Covariance {
    let parameters = ["a.png.rx", "a.png.X", "b.png.Z", "sensor1.f"].map(str::to_owned).to_vec();
    let row = |i: usize| (0..4).map(|j| if i == j { 1e-4 } else { 1e-6 }).collect();
    let matrix = (0..4).map(row).collect();
    Covariance { frame: Frame::Wall, parameters, matrix, sigma0_applied: true, full_joint: true }
}

fn pairs() -> Pairs {
    let (first, second) = ("a.png".to_owned(), "b.png".to_owned());
    let pair = Pair {
        name: "a-b".into(),
        first,
        second,
        baseline_m: 4.5,
        distance_m: 20.0,
        convergence_rad: 0.1,
        overlap: 0.8,
    };
    Pairs { pairs: vec![pair] }
}

fn table() -> Table {
    let mut table = Table::new(["name", "value_m", "is_good"]);
    table.push(vec!["a".into(), 1.5.into(), true.into()]);
    table.push(vec!["".into(), Cell::Empty(()), false.into()]);
    table
}

fn acceptance() -> Acceptance {
    let group = GroupModel {
        features: vec!["mean".into()],
        mean: vec![0.0],
        deviation: vec![1.0],
        inverse: vec![vec![1.0]],
        eigenvalues: vec![1.0],
        reference_d2: vec![0.5, 1.5],
        leave_one_out_d2: vec![0.6, 2.0],
        constant: vec!["nugget_m2".into()],
        constant_value: vec![0.0],
        constant_resolution: vec![1e-7],
        chain_correlation: vec![0.3],
    };
    let labels = vec!["a".into(), "b".into()];
    Acceptance { references: 2, ridge: 0.01, labels, groups: [("all".to_owned(), group)].into() }
}

fn figure() -> Figure {
    Figure { svg: "<svg xmlns=\"http://www.w3.org/2000/svg\"><g><rect width=\"3\" height=\"2\"/></g></svg>".into() }
}

fn files() -> Files {
    Files { files: vec![("a.txt".into(), b"one".to_vec()), ("folder/b/name.txt".into(), vec![7; 600])] }
}

fn inventory() -> Inventory {
    let square =
        |at: f64, side: f64| vec![[at, at], [at + side, at], [at + side, at + side], [at, at + side], [at, at]];
    let mut hole = square(0.2, 0.2);
    hole.reverse();
    let outline = vec![Polygon { exterior: square(0.0, 1.0), holes: vec![hole] }];
    let features = vec![
        Feature { outline, values: vec!["a".into(), 0.5.into()] },
        Feature { outline: Vec::new(), values: vec!["b".into(), Cell::Empty(())] },
    ];
    Inventory { frame: Frame::Wall, columns: vec!["id".into(), "volume_m3".into()], features }
}

fn candidates() -> io::Result<Artefact> {
    let classes = json!([
        {"shape": "prism", "size": {"axes": {"length_m": {"log_normal": {"median": 0.5, "sigma": 0.4}}}}},
        {"name": "round", "shape": {"ellipsoid": {}}, "modifiers": ["tumble", {"roughness": {"sigma_m": 0.02}}]},
    ]);
    let made = made("generate-blocks", &json!({"classes": classes}), &Lent(&[]), &[]).map_err(io::Error::other)?;
    made.into_iter().next().ok_or_else(|| io::Error::other("generate-blocks made nothing"))
}
