//! Small pictures show what an artefact holds, with its scale, at the size that was asked for.

use super::*;
use rockface_core::artefact::{
    Cameras, Cell, Depth, Feature, Grid, Image, Inventory, Mesh, Meshes, Part, Picture, Polygon, Raster,
};
use rockface_core::artefact::{Sensor, Surface, Table};
use rockface_core::numerics::portable_math;
use std::collections::BTreeMap;

fn hill(x: f64, y: f64) -> f64 {
    0.5 * portable_math::sin(1.3 * x) * portable_math::cos(0.9 * y) + 0.05 * portable_math::sin(9.0 * x + 4.0 * y)
}

fn mesh(columns: u32, rows: u32) -> Mesh {
    let vertex = |i: u32| {
        let (x, y) =
            (8.0 * f64::from(i % columns) / f64::from(columns), 5.0 * f64::from(i / columns) / f64::from(rows));
        [x, y, hill(x, y)]
    };
    let square = |i: u32| {
        let a = i / (columns - 1) * columns + i % (columns - 1);
        [[a, a + 1, a + columns + 1], [a, a + columns + 1, a + columns]]
    };
    let vertices = (0..columns * rows).map(vertex).collect();
    let triangles = (0..(columns - 1) * (rows - 1)).flat_map(square).collect();
    Mesh { frame: Frame::Wall, vertices, triangles, colours: Vec::new() }
}

fn surface(width: usize, height: usize) -> Surface {
    let point = |i: usize| {
        let (x, y) = (8.0 * (i % width) as f64 / width as f64, -5.0 * (i / width) as f64 / height as f64);
        if i % width < width / 5 { [f32::NAN; 3] } else { [x as f32, y as f32, hill(x, y) as f32] }
    };
    let points = (0..width * height).map(point).collect();
    let squares = vec![3; (width - 1) * (height - 1)];
    Surface { frame: Frame::Wall, width, height, origin_m: [0.0; 3], points, squares }
}

fn difference() -> Raster {
    let grid = Grid { columns: 900, rows: 600, cell_m: 0.01, left_m: 0.0, top_m: 6.0 };
    let value = |i: usize| match (i % 900, i / 900) {
        (x, _) if x < 40 => f32::NAN,
        (x, y) if (300..380).contains(&x) && (200..300).contains(&y) => -0.4,
        (x, y) => ((x * 31 + y * 17) % 23) as f32 * 0.001 - 0.011,
    };
    Raster::single(grid, Frame::Wall, "difference", "difference", (0..540_000).map(value).collect())
}

fn camera(name: &str, centre_m: [f64; 3]) -> Image {
    // Half a turn about X: the optical axis is -Z.
    Image { name: name.to_owned(), sensor: 0, camera_from_object: [0.0, 1.0, 0.0, 0.0], centre_m }
}

fn sensor() -> Sensor {
    let (width_px, height_px) = (1200, 800);
    Sensor {
        name: "s".into(),
        width_px,
        height_px,
        f: 2000.0,
        cx: 600.0,
        cy: 400.0,
        b1: 0.0,
        b2: 0.0,
        k: [0.0; 4],
        p: [0.0; 2],
    }
}

fn depth() -> Depth {
    let z =
        (0..1200 * 800).map(|i| if i % 1200 > 1100 { f32::NAN } else { 20.0 + (i / 1200) as f32 * 0.002 }).collect();
    let (sensor, image) = (sensor(), camera("left", [0.0, 0.0, 20.0]));
    Depth { frame: Frame::Wall, sensor, image, downscale: 1, width: 1200, height: 800, z, channels: BTreeMap::new() }
}

fn inventory() -> Inventory {
    let feature = |i: i32| {
        let (x, y, side) = (1.0 + f64::from(i), 1.0 + 0.6 * f64::from(i % 5), 0.1 + 0.1 * f64::from(i % 4));
        let exterior = vec![[x, y], [x + side, y], [x + side, y + side], [x, y + side]];
        let outline = vec![Polygon { exterior, holes: Vec::new() }];
        Feature { outline, values: vec![Cell::from(side * side * side)] }
    };
    Inventory { frame: Frame::Wall, columns: vec!["removed_m3".into()], features: (0..6).map(feature).collect() }
}

fn all() -> Vec<(&'static str, Artefact)> {
    let part = |name: &str| {
        let small = mesh(20, 20);
        Part { name: name.into(), class: String::new(), vertices: small.vertices, triangles: small.triangles }
    };
    let images = vec![camera("left", [-3.5, 0.0, 20.0]), camera("right", [3.5, 0.0, 20.0])];
    let picture = mesh(60, 40);
    let picture = of(&Artefact::from(picture), &[]).unwrap().to_png().unwrap();
    vec![
        ("mesh", mesh(120, 80).into()),
        ("large-mesh", mesh(900, 600).into()),
        ("surface", surface(800, 500).into()),
        ("difference", difference().into()),
        ("depth", depth().into()),
        ("inventory", inventory().into()),
        ("cameras", Cameras { frame: Frame::Wall, sensors: vec![sensor()], images }.into()),
        ("meshes", Meshes { frame: Frame::Wall, parts: vec![part("1"), part("2")] }.into()),
        ("picture", Picture { png: picture }.into()),
    ]
}

#[test]
fn everything_that_can_be_seen_has_a_small_picture_with_equal_bytes() {
    let face = Artefact::from(mesh(120, 80));
    for (name, artefact) in all() {
        let preview = of(&artefact, &[&face]).unwrap_or_else(|| panic!("no preview of the {name}"));
        assert!(preview.width <= WIDTH_PX && preview.rgb.len() == 3 * preview.width * preview.height, "{name}");
        assert!(!preview.caption.is_empty());
        assert_eq!(of(&artefact, &[&face]), Some(preview.clone()));
        if let Ok(folder) = std::env::var("ROCKFACE_LOOK") {
            std::fs::write(format!("{folder}/{name}.png"), preview.to_png().unwrap()).unwrap();
        }
    }
}

#[test]
fn what_has_nothing_to_be_seen_has_none() {
    let mut empty = difference();
    empty.bands[0].values.fill(f32::NAN);
    assert_eq!(of(&Artefact::from(empty), &[]), None);
    assert_eq!(of(&Artefact::from(Table::new(["a"])), &[]), None);
    assert_eq!(of(&Artefact::from(Picture { png: b"\x89PNG\r\n\x1a\n".to_vec() }), &[]), None);
    let nothing = Mesh { frame: Frame::Wall, vertices: Vec::new(), triangles: Vec::new(), colours: Vec::new() };
    assert_eq!(of(&Artefact::from(nothing), &[]), None);
    assert!(of(&Artefact::from(inventory()), &[]).is_some(), "outlines alone are drawn without a relief");
}

#[test]
fn missing_values_are_grey_and_losses_are_red() {
    let preview = of(&Artefact::from(difference()), &[]).unwrap();
    let [left, top] = SMALL.corner();
    let at = |x: usize, y: usize| &preview.rgb[3 * ((top + y) * preview.width + left + x)..][..3];
    assert_eq!(at(3, 100), crate::figure::colour_scale::NO_DATA);
    let [red, green, blue] = at(157, 115) else { panic!() };
    assert!(*red > 90 && *green < 60 && *blue < 80, "{red} {green} {blue}");
}
