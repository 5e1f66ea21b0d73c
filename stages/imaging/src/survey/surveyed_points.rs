//! Control points that a survey has measured: places with standard deviations, out of a table.

use nalgebra::{Matrix3, Point3, Vector3};
use rockface_core::artefact::{Cell, Frame, Table, Transform};
use rockface_core::{StageError, fail};

/// A control point in the frame of the cameras.
#[derive(Debug, Clone, PartialEq)]
pub struct Surveyed {
    /// Its name, or the number of its row from 1 on.
    pub name: String,
    /// Its place, metres.
    pub position_m: Vector3<f64>,
    /// The inverse of the covariance of the place, per square metre.
    pub weight: Matrix3<f64>,
}

/// Columns of places.
const PLACE: [&str; 3] = ["x_m", "y_m", "z_m"];
/// Columns of standard deviations along the same axes.
const SIGMAS: [&str; 3] = ["sx_m", "sy_m", "sz_m"];
/// Column of one standard deviation along all axes.
const SIGMA: &str = "sigma_m";

/// The points of a table. Without standard deviations in it `sigma_m` is taken, metres; without a transform the table is in `frame`, with one in
/// world coordinates, and standard deviations turn with the points.
///
/// # Errors
/// A column that is not there, a row without a number, a standard deviation that is not positive, a transform that does not lead to `frame`.
pub fn read(
    table: &Table,
    sigma_m: f64,
    frame: Frame,
    transform: Option<&Transform>,
) -> Result<Vec<Surveyed>, StageError> {
    let place = columns(table, PLACE)?;
    let Some(place) = place else {
        let message = format!("`control` has no columns `x_m`, `y_m`, `z_m`; it has {}", table.columns.join(", "));
        return Err(StageError::new(message).hint("`rename` of `import-table` calls others so"));
    };
    let (each, one) = (columns(table, SIGMAS)?, table.column(SIGMA));
    if each.is_some() && one.is_some() {
        fail!("`control` has `sx_m`, `sy_m`, `sz_m` and `sigma_m`: leave one of both out");
    }
    let way = transform.map(|transform| to_cameras(transform, frame)).transpose()?;
    let named = table.column("name");
    let point = |(row, cells): (usize, &Vec<Cell>)| {
        let name = named.map_or_else(|| (row + 1).to_string(), |at| cells[at].to_string());
        let number = |at: usize| {
            let missing = || format!("point `{name}` of `control` has no number in `{}`", table.columns[at]);
            cells[at].number().ok_or_else(missing)
        };
        let [x, y, z] = place;
        let position = Point3::new(number(x)?, number(y)?, number(z)?);
        let sigmas_m = match (each, one) {
            (Some([x, y, z]), _) => [number(x)?, number(y)?, number(z)?],
            (None, Some(at)) => [number(at)?; 3],
            (None, None) => [sigma_m; 3],
        };
        if let Some(wrong) = sigmas_m.iter().find(|sigma| **sigma <= 0.0) {
            fail!("point `{name}` of `control` has the standard deviation {wrong} m, which has to be positive");
        }
        let weight = Matrix3::from_diagonal(&Vector3::from(sigmas_m.map(|sigma| 1.0 / (sigma * sigma))));
        let (position, weight) = way.as_ref().map_or((position, weight), |way| {
            let turn = way.matrix();
            (way.apply(&position), turn * weight * turn.transpose())
        });
        Ok(Surveyed { name, position_m: position.coords, weight })
    };
    table.rows.iter().enumerate().map(point).collect()
}

/// The places of three columns; `None` where none of them is there.
fn columns(table: &Table, names: [&str; 3]) -> Result<Option<[usize; 3]>, StageError> {
    let found = names.map(|name| table.column(name));
    match found {
        [Some(x), Some(y), Some(z)] => Ok(Some([x, y, z])),
        [None, None, None] => Ok(None),
        _ => fail!("`control` has only some of the columns {}", names.map(|name| format!("`{name}`")).join(", ")),
    }
}

/// The way from the world to the frame of the cameras.
fn to_cameras(transform: &Transform, frame: Frame) -> Result<Transform, StageError> {
    let (world, wanted) = (Frame::World.name(), frame.name());
    let (from, to) = (transform.from.as_str(), transform.to.as_str());
    if from == world && to == wanted {
        Ok(transform.clone())
    } else if from == wanted && to == world {
        Ok(transform.inverse())
    } else {
        let message = format!("the transform takes {from} to {to}, and the cameras are in the {frame} frame");
        Err(StageError::new(message).hint("leave `transform` out where `control` is in the frame of the cameras"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(columns: &[&str], row: &[f64]) -> Table {
        let mut table = Table::new(columns.iter().copied());
        table.push(row.iter().map(|value| Cell::from(*value)).collect());
        table
    }

    #[test]
    fn standard_deviations_turn_with_the_points() {
        // X of the wall is north, Y is up, Z is east.
        let turn = Matrix3::new(0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0);
        let origin = Vector3::new(450_000.0, 5_000_000.0, 800.0);
        let wall_from_world = Transform::new("world", "wall", &turn, origin, Vector3::zeros());
        let given =
            table(&["x_m", "y_m", "z_m", "sx_m", "sy_m", "sz_m"], &[450_001.0, 5_000_002.0, 803.0, 0.01, 0.02, 0.05]);
        for transform in [wall_from_world.clone(), wall_from_world.inverse()] {
            let points = read(&given, 0.005, Frame::Wall, Some(&transform)).unwrap();
            assert!((points[0].position_m - Vector3::new(2.0, 3.0, 1.0)).norm() < 1e-9);
            let wanted = Matrix3::from_diagonal(&Vector3::new(2500.0, 400.0, 10_000.0));
            assert!((points[0].weight - wanted).norm() < 1e-6, "{}", points[0].weight);
        }
        assert!(
            read(&given, 0.005, Frame::World, Some(&wall_from_world))
                .unwrap_err()
                .message
                .contains("takes world to wall")
        );
    }

    #[test]
    fn columns_that_do_not_fit_are_told() {
        let message =
            |columns: &[&str], row: &[f64]| read(&table(columns, row), 0.005, Frame::Wall, None).unwrap_err().message;
        assert!(message(&["easting", "northing"], &[1.0, 2.0]).contains("it has easting, northing"));
        assert!(message(&["x_m", "y_m"], &[1.0, 2.0]).contains("only some of the columns"));
        assert!(
            message(&["x_m", "y_m", "z_m"], &[1.0, 2.0, f64::NAN])
                .contains("point `1` of `control` has no number in `z_m`")
        );
        assert!(message(&["x_m", "y_m", "z_m", "sigma_m"], &[1.0, 2.0, 3.0, 0.0]).contains("has to be positive"));
        let even = read(&table(&["x_m", "y_m", "z_m"], &[1.0, 2.0, 3.0]), 0.005, Frame::Wall, None).unwrap();
        assert!((even[0].weight[(1, 1)] - 40_000.0).abs() < 1e-6);
    }
}
