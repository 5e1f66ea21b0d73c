//! Where the rockfalls of an inventory are in the world: a point each, in metres of its system.

use nalgebra::Point3;
use rockface_core::StageError;
use rockface_core::artefact::{Feature, Frame};
use rockface_core::artefact::{Inventory, Transform};

/// Metres east, north and up; the height is NaN where nothing says it.
pub type Place = [f64; 3];

/// The place of each rockfall, `None` where it has none.
///
/// Places are the columns `centroid_world_x_m`, `_y_m`, `_z_m`. An inventory in the world frame without them has places in `centroid_x_m` and its
/// like, in the columns `x_m`, `y_m`, `z_m` of points, or at the centroids of its outlines; centroids in the wall frame are moved by `world_from_wall`,
/// or where that is not given by what the frame states. Those of detections without elevations are no places in the wall frame, and stay out.
///
/// # Errors
/// No rockfall has a place in the world.
pub fn places(inventory: &Inventory, world_from_wall: Option<&Transform>) -> Result<Vec<Option<Place>>, StageError> {
    let is_world = inventory.frame == Frame::World;
    let mut found = columns(inventory, ["centroid_world_x_m", "centroid_world_y_m", "centroid_world_z_m"]);
    if is_world {
        for names in [["centroid_x_m", "centroid_y_m", "centroid_z_m"], ["x_m", "y_m", "z_m"]] {
            found = either(found, columns(inventory, names));
        }
        found = either(found, inventory.features.iter().map(centre).collect());
    } else if let Some(way) = way_to_world(inventory, world_from_wall) {
        let moved = |[x, y, z]: Place| Some(way.apply(&Point3::new(x, y, z)).into()).filter(|_| z.is_finite());
        let on_wall = columns(inventory, ["centroid_x_m", "centroid_y_m", "centroid_z_m"]);
        found = either(found, on_wall.into_iter().map(|place| place.and_then(moved)).collect());
    }
    if !inventory.features.is_empty() && found.iter().all(Option::is_none) {
        return Err(no_places(inventory, is_world));
    }
    Ok(found)
}

fn no_places(inventory: &Inventory, is_world: bool) -> StageError {
    if is_world {
        let message =
            "no rockfall has a place: there are no outlines, and no columns `centroid_x_m` or `x_m` with numbers";
        return StageError::new(message);
    }
    let message = "the inventory is in the wall frame, and no rockfall has a place in the world (`centroid_world_x_m`, `_y_m`, `_z_m`)";
    let hint = if lacks_elevations(inventory) {
        "connect the elevations before to `reference` of `detect-raster`: without them nobody knows how far from the wall plane a change is"
    } else {
        "give `transform` of `transform-crs` here, or to `remove-blocks`"
    };
    StageError::new(message).hint(hint)
}

fn way_to_world(inventory: &Inventory, given: Option<&Transform>) -> Option<Transform> {
    let stated = || inventory.frame.wall_from_world().map(Transform::inverse);
    given.cloned().or_else(stated).filter(|_| !lacks_elevations(inventory))
}

/// Whether it is one of detections whose detector knew the way to the world: what it left empty is not known.
fn lacks_elevations(inventory: &Inventory) -> bool {
    inventory.column("method").is_some() && inventory.frame.wall_from_world().is_some()
}

fn either(first: Vec<Option<Place>>, second: Vec<Option<Place>>) -> Vec<Option<Place>> {
    first.into_iter().zip(second).map(|(one, other)| one.or(other)).collect()
}

/// The numbers of three columns, where the first two have one.
fn columns(inventory: &Inventory, names: [&str; 3]) -> Vec<Option<Place>> {
    let [x, y, z] = names.map(|name| inventory.column(name));
    let number = |feature: &Feature, column: Option<usize>| column.and_then(|column| feature.values[column].number());
    let place =
        |feature: &Feature| Some([number(feature, x)?, number(feature, y)?, number(feature, z).unwrap_or(f64::NAN)]);
    inventory.features.iter().map(place).collect()
}

/// The centroid of the outer rings of an outline, in the order of their areas; taken from the first point, so that map coordinates lose nothing.
fn centre(feature: &Feature) -> Option<Place> {
    let [x0, y0] = *feature.outline.first()?.exterior.first()?;
    let (mut area, mut sum) = (0.0, [0.0; 2]);
    for ring in feature.outline.iter().map(|polygon| &polygon.exterior) {
        for (a, b) in ring.iter().zip(ring.iter().cycle().skip(1)) {
            let [ax, ay, bx, by] = [a[0] - x0, a[1] - y0, b[0] - x0, b[1] - y0];
            let cross = ax * by - bx * ay;
            area += cross;
            sum = [sum[0] + cross * (ax + bx), sum[1] + cross * (ay + by)];
        }
    }
    let [x, y] = sum.map(|sum| sum / (3.0 * area));
    Some(if x.is_finite() && y.is_finite() { [x0 + x, y0 + y, f64::NAN] } else { [x0, y0, f64::NAN] })
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::artefact::{Cell, Georeference, Polygon};

    fn inventory(frame: Frame, columns: &[&str], rows: &[&[f64]]) -> Inventory {
        let ring = vec![[100.0, 10.0], [102.0, 10.0], [102.0, 14.0], [100.0, 14.0]];
        let feature = |row: &&[f64]| Feature {
            outline: vec![Polygon { exterior: ring.clone(), holes: Vec::new() }],
            values: row.iter().map(|value| Cell::from(*value)).collect(),
        };
        let columns = columns.iter().map(ToString::to_string).collect();
        Inventory { frame, columns, features: rows.iter().map(feature).collect() }
    }

    const CENTROID: [&str; 3] = ["centroid_x_m", "centroid_y_m", "centroid_z_m"];

    #[test]
    fn places_come_from_columns_outlines_or_the_transform() {
        let world = inventory(Frame::World, &[], &[&[]]);
        let found = places(&world, None).unwrap()[0].unwrap();
        assert!((found[0] - 101.0).abs() < 1e-12 && (found[1] - 12.0).abs() < 1e-12 && found[2].is_nan());
        let with_points = inventory(Frame::World, &["x_m", "y_m"], &[&[7.0, 8.0], &[f64::NAN, 8.0]]);
        let found = places(&with_points, None).unwrap();
        assert!((found[0].unwrap()[0] - 7.0).abs() < 1e-12 && (found[1].unwrap()[0] - 101.0).abs() < 1e-12);
        let wall = inventory(Frame::Wall, &CENTROID, &[&[1.0, 2.0, 3.0], &[1.0, 2.0, f64::NAN]]);
        let way = Transform { translation: [1e6, 0.0, 0.0], ..Transform::identity("wall", "world") };
        let found = places(&wall, Some(&way)).unwrap();
        assert_eq!((found[0], found[1]), (Some([1_000_001.0, 2.0, 3.0]), None));
        // A frame that says itself how it lies in the world needs no transform.
        let stated = Frame::Wall.at(Some(Georeference { crs: None, wall_from_world: Some(way.inverse()) }));
        assert_eq!(places(&Inventory { frame: stated, ..wall }, None).unwrap(), found);
    }

    #[test]
    fn no_place_in_the_world_names_the_way_out() {
        let hint = |columns: &[&str], row: &[f64]| {
            places(&inventory(Frame::Wall, columns, &[row]), None).unwrap_err().hint.unwrap()
        };
        assert!(hint(&CENTROID, &[1.0, 2.0, 3.0]).contains("give `transform`"));
        assert!(places(&inventory(Frame::Wall, &[], &[]), None).unwrap().is_empty());
        let way = Transform::identity("world", "wall");
        let frame = Frame::Wall.at(Some(Georeference { crs: None, wall_from_world: Some(way.clone()) }));
        let columns = [&CENTROID[..], &["method"]].concat();
        let found = places(&inventory(frame, &columns, &[&[1.0, 2.0, 0.1, 0.0]]), Some(&way.inverse()));
        assert!(found.unwrap_err().hint.unwrap().contains("`reference` of `detect-raster`"));
    }
}
