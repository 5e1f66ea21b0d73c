//! What a detector found, as an inventory and a label raster: the one form in which all detectors hand over.

use nalgebra::Vector3;

use rockface_core::artefact::{Feature, Frame, Grid, Inventory, Raster, Sample, TableRow, Transform};
use rockface_core::table_row;
use rockface_core::{StageError, fail};
use rockface_rock::rockfall::ground_truth::bounding_box::oriented_box;
use rockface_rock::rockfall::ground_truth::{Facets, outline, sneed_folk};

table_row! {
    /// The columns of an inventory of detections. Only `volume_m3` and outlines are needed to score one.
    struct Columns<'a> {
        id: usize,
        method: &'a str,
        volume_m3: f64,
        volume_sd_m3: f64,
        area_m2: f64,
        cells: usize,
        depth_max_m: f64,
        depth_mean_m: f64,
        score: f64,
        centroid_x_m: f64,
        centroid_y_m: f64,
        centroid_z_m: f64,
        centroid_world_x_m: Option<f64>,
        centroid_world_y_m: Option<f64>,
        centroid_world_z_m: Option<f64>,
        long_m: f64,
        intermediate_m: f64,
        short_m: f64,
        shape_class: Option<&'static str>,
        flatness: Option<f64>,
        elongation: Option<f64>,
    }
}

/// One change that a detector found.
#[derive(Debug, Clone, PartialEq)]
pub struct Found {
    /// (row, column) of the cells it covers on the detector's grid.
    pub cells: Vec<(usize, usize)>,
    /// Its area in plan, square metres, where that is not the area of its cells.
    pub area_m2: Option<f64>,
    /// Volume, cubic metres, positive.
    pub volume_m3: f64,
    /// Standard deviation of the volume, cubic metres; NaN where the detector knows none.
    pub volume_sd_m3: f64,
    /// Greatest change, metres, positive.
    pub depth_max_m: f64,
    /// Mean change, metres, positive.
    pub depth_mean_m: f64,
    /// How sure the detector is: the greatest ratio of a change to its limit of detection; NaN where there is none.
    pub score: f64,
    /// Centroid of the volume, metres.
    pub centroid_m: [f64; 3],
    /// Points of both surfaces around the change, metres: its box is theirs.
    pub points: Vec<[f64; 3]>,
}

/// A volume for people: with four decimals, or in powers of ten where these would hide it.
pub fn volume_text(volume_m3: f64) -> String {
    if volume_m3 == 0.0 || volume_m3 >= 0.01 { format!("{volume_m3:.4}") } else { format!("{volume_m3:.3e}") }
}

/// What the Z of centroids is measured from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Heights {
    /// The origin of the frame: centroids are places in it.
    Known,
    /// The surface before, whose elevations nobody gave: centroids are off along Z by these, and so are no places in the world.
    Unknown,
}

/// The inventory of what was found, numbered from 1 in the given order. Where it is known how the wall frame is in the world, and how high the
/// centroids are in the wall frame, each change has its centroid in the world too.
pub fn inventory(grid: &Grid, frame: Frame, method: &str, heights: Heights, found: &[Found]) -> Inventory {
    let known = frame.wall_from_world().filter(|_| heights == Heights::Known);
    let world_from_wall = known.map(Transform::inverse);
    let feature = |(number, found): (usize, &Found)| {
        let world = world_from_wall.as_ref().map(|transform| transform.apply(&found.centroid_m.into()).into());
        let values = columns(grid, method, number, found, world).cells();
        Feature { outline: outline::polygons(grid, &found.cells), values }
    };
    let features = found.iter().enumerate().map(feature).collect();
    Inventory { frame, columns: Columns::columns(), features }
}

fn columns<'a>(grid: &Grid, method: &'a str, number: usize, found: &Found, world_m: Option<[f64; 3]>) -> Columns<'a> {
    let [centroid_x_m, centroid_y_m, centroid_z_m] = found.centroid_m;
    let [long_m, intermediate_m, short_m] = sides(&found.points);
    let form = sneed_folk::form([long_m, intermediate_m, short_m]);
    let cells = found.cells.len();
    Columns {
        id: number + 1,
        method,
        volume_m3: found.volume_m3,
        volume_sd_m3: found.volume_sd_m3,
        area_m2: found.area_m2.unwrap_or(cells as f64 * grid.cell_m * grid.cell_m),
        cells,
        depth_max_m: found.depth_max_m,
        depth_mean_m: found.depth_mean_m,
        score: found.score,
        centroid_x_m,
        centroid_y_m,
        centroid_z_m,
        centroid_world_x_m: world_m.map(|place| place[0]),
        centroid_world_y_m: world_m.map(|place| place[1]),
        centroid_world_z_m: world_m.map(|place| place[2]),
        long_m,
        intermediate_m,
        short_m,
        shape_class: form.as_ref().map(|form| form.class),
        flatness: form.as_ref().map(|form| form.flatness),
        elongation: form.as_ref().map(|form| form.elongation),
    }
}

/// Long, intermediate and short side of the box around points, metres; NaN without points.
fn sides(points: &[[f64; 3]]) -> [f64; 3] {
    let body = Facets { vertices: points.to_vec(), triangles: Vec::new() };
    let axes = [Vector3::x(), Vector3::y(), Vector3::z()];
    oriented_box(&body, axes).map_or([f64::NAN; 3], |found| found.sides_m)
}

/// The label raster of what was found: the number of each, 0 elsewhere; a later one covers an earlier one.
///
/// # Errors
/// More than 65535 of them.
pub fn labels(grid: &Grid, frame: Frame, found: &[Found]) -> Result<Raster, StageError> {
    let largest = usize::from(u16::MAX);
    if found.len() > largest {
        fail!("{} changes were found, a label raster holds {largest}", found.len());
    }
    let mut values = vec![0.0f32; grid.cells()];
    for (number, found) in found.iter().enumerate() {
        found.cells.iter().for_each(|(row, column)| values[row * grid.columns + column] = (number + 1) as f32);
    }
    let mut raster = Raster::single(*grid, frame, "label", "detection", values);
    raster.sample = Sample::Word;
    Ok(raster)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::artefact::{Georeference, Noun};

    #[test]
    fn a_box_of_cells_has_its_measures() {
        let grid = Grid { columns: 10, rows: 8, cell_m: 0.1, left_m: 1.0, top_m: 2.0 };
        let cells: Vec<(usize, usize)> = (0..6).map(|i| (2 + i / 3, 4 + i % 3)).collect();
        let corner =
            |i: u32| [1.4 + 0.3 * f64::from(i & 1), 1.6 + 0.2 * f64::from(i >> 1 & 1), 0.1 * f64::from(i >> 2)];
        let found = Found {
            cells,
            area_m2: None,
            volume_m3: 0.006,
            volume_sd_m3: f64::NAN,
            depth_max_m: 0.1,
            depth_mean_m: 0.1,
            score: 5.0,
            centroid_m: [0.0, 0.0, 0.05],
            points: (0..8).map(corner).collect(),
        };
        let made = inventory(&grid, Frame::Wall, "raster", Heights::Known, std::slice::from_ref(&found));
        let number = |name: &str| made.numbers(name).unwrap()[0];
        assert_eq!((number("id"), number("cells"), number("volume_sd_m3")), (Some(1.0), Some(6.0), None));
        let near = |name: &str, expected: f64| assert!((number(name).unwrap() - expected).abs() < 1e-9, "{name}");
        near("area_m2", 0.06);
        near("long_m", 0.3);
        near("intermediate_m", 0.2);
        near("short_m", 0.1);
        near("centroid_z_m", 0.05);
        assert!(made.encode().is_ok() && made.features[0].outline.len() == 1);
        assert_eq!(number("centroid_world_x_m"), None);
        let turn = nalgebra::Matrix3::new(0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0);
        let wall_from_world = Transform::new("world", "wall", &turn, [500.0, 600.0, 70.0].into(), Vector3::zeros());
        let placed = Frame::Wall.at(Some(Georeference { crs: None, wall_from_world: Some(wall_from_world) }));
        let made = inventory(&grid, placed, "raster", Heights::Known, std::slice::from_ref(&found));
        let world = ["x", "y", "z"].map(|axis| made.numbers(&format!("centroid_world_{axis}_m")).unwrap()[0]);
        // Z of the wall is X of the world.
        assert_eq!(world, [Some(500.05), Some(600.0), Some(70.0)]);
        let made = inventory(&grid, placed, "raster", Heights::Unknown, std::slice::from_ref(&found));
        for axis in ["x", "y", "z"] {
            assert_eq!(made.numbers(&format!("centroid_world_{axis}_m")).unwrap(), [None]);
        }
        let labels = labels(&grid, Frame::Wall, &[found]).unwrap();
        assert_eq!(labels.bands[0].values.iter().filter(|v| **v > 0.5).count(), 6);
    }
}
