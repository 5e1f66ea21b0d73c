//! Outlines of rockfalls coloured by volume, over the relief of their face where that is at hand.

use crate::figure::canvas::Canvas;
use crate::figure::colour_scale::{ColourScale, Palette};
use crate::figure::picture;
use crate::figure::picture::{SMALL, Subject, brightness};
use crate::figure::rockfall_figure::strokes;
use rockface_core::artefact::{Artefact, Grid, Inventory, Polygon, Preview};
use rockface_core::numerics::portable_math;
use rockface_raster::rasterise;
use rockface_raster::shape::Shape;

use super::{WIDTH_PX, framed, relief, up};

/// Columns that hold a volume, the first found is taken.
const VOLUMES: [&str; 3] = ["removed_m3", "volume_m3", "measured_m3"];
const EDGE: [u8; 3] = [20, 20, 24];

pub(super) fn draw(inventory: &Inventory, beside: &[&Artefact]) -> Option<Preview> {
    let face = beside.iter().find_map(|artefact| Shape::of(artefact).filter(|shape| shape.frame() == inventory.frame));
    let extent = face.and_then(|shape| rasterise::extent(shape, None)).or_else(|| around(inventory))?;
    let longest = (extent[1] - extent[0]).max(extent[3] - extent[2]);
    let cell_m = if longest > 0.0 { longest / (SMALL.room(WIDTH_PX) - 1) as f64 } else { 1.0 };
    let grid = rasterise::grid_around(extent, cell_m).ok()?;
    let column = VOLUMES.iter().find_map(|name| inventory.numbers(name)).unwrap_or_default();
    let logs: Vec<f64> = (0..inventory.features.len()).map(|place| logarithm(column.get(place))).collect();
    let scale = scale(&logs);
    let subject = Subject {
        columns: grid.columns,
        values: &vec![f32::NAN; grid.cells()],
        cell_m: Some(grid.cell_m),
        shaded: false,
        scale,
        title: String::new(),
        subtitle: told(inventory, &column),
        unit: ("lg m\u{b3}", 1.0),
        up: Some(up(inventory.frame)),
    };
    let mut canvas = picture::paint(&subject, WIDTH_PX, &SMALL).ok()?;
    let sheet = sheet(inventory, face, &grid, &logs, &scale);
    canvas.lay(&sheet, SMALL.corner());
    Some(framed("Rockfalls".to_owned(), canvas))
}

fn logarithm(volume_m3: Option<&Option<f64>>) -> f64 {
    volume_m3.copied().flatten().filter(|volume| *volume > 0.0).map_or(f64::NAN, portable_math::log10)
}

fn scale(logs: &[f64]) -> ColourScale {
    let finite = || logs.iter().copied().filter(|log| log.is_finite());
    let (low, high) = (finite().fold(f64::INFINITY, f64::min), finite().fold(f64::NEG_INFINITY, f64::max));
    let (low, high) = if low < high { (low, high) } else { (-1.0, 0.0) };
    ColourScale { palette: Palette::Viridis, low, high }
}

fn told(inventory: &Inventory, volumes: &[Option<f64>]) -> String {
    let sum: f64 = volumes.iter().flatten().sum();
    let count = inventory.features.len();
    if sum > 0.0 { format!("{count} outlines, {sum:.3} m\u{b3}") } else { format!("{count} outlines") }
}

/// The box around all outlines with some room, as (left, right, bottom, top), metres.
fn around(inventory: &Inventory) -> Option<[f64; 4]> {
    let points = inventory.features.iter().flat_map(|feature| &feature.outline).flat_map(|polygon| &polygon.exterior);
    let empty = [f64::INFINITY, f64::NEG_INFINITY, f64::INFINITY, f64::NEG_INFINITY];
    let e = points.fold(empty, |e, [x, y]| [e[0].min(*x), e[1].max(*x), e[2].min(*y), e[3].max(*y)]);
    let room = 0.05 * (e[1] - e[0]).max(e[3] - e[2]);
    room.is_finite().then(|| [e[0] - room, e[1] + room, e[2] - room, e[3] + room])
}

/// The relief in grey with the outlines over it, a pixel a cell.
fn sheet(inventory: &Inventory, face: Option<Shape>, grid: &Grid, logs: &[f64], scale: &ColourScale) -> Canvas {
    let mut sheet = Canvas::new(grid.columns, grid.rows);
    if let Some((under, values)) = face.and_then(|shape| relief::elevations(shape, grid.extent_m())) {
        shade(&mut sheet, grid, &under, &values);
    }
    let ring = |ring: &Vec<[f64; 2]>| ring.iter().map(|place| grid.in_cells(*place)).collect::<Vec<_>>();
    for (feature, log) in inventory.features.iter().zip(logs) {
        for polygon in &feature.outline {
            let pixels = Polygon { exterior: ring(&polygon.exterior), holes: polygon.holes.iter().map(ring).collect() };
            strokes::fill(&mut sheet, &pixels, scale.colour(*log), 0.8);
            strokes::outline(&mut sheet, &pixels, 1.0, EDGE);
        }
    }
    sheet
}

/// Fills a sheet with the light on elevations that may be in larger cells.
fn shade(sheet: &mut Canvas, grid: &Grid, under: &Grid, values: &[f32]) {
    let at = |x: f64, y: f64| under.cell_of([x, y]).map_or(f64::NAN, |cell| f64::from(values[cell]));
    let step = under.cell_m;
    for row in 0..grid.rows {
        for column in 0..grid.columns {
            let (x, y) = grid.centre(row, column);
            let slope_x = (at(x + step, y) - at(x - step, y)) / (2.0 * step);
            let slope_y = (at(x, y + step) - at(x, y - step)) / (2.0 * step);
            let light = if slope_x.is_nan() || slope_y.is_nan() { 1.0 } else { brightness(slope_x, slope_y) };
            if let Some(pixel) = sheet.pixel(column, row) {
                *pixel = [(185.0 * light).min(250.0) as u8; 3];
            }
        }
    }
}
