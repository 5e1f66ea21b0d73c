//! What parameters of the importers do to the coordinates of a file: their unit, and a shift.

use rockface_core::crs::Settled;
use rockface_core::params::Fault;
use rockface_core::{StageError, fail};

/// Makes metres of coordinates in a unit of so many metres.
pub fn scale(points: &mut [[f64; 3]], unit_m: f64) {
    if is_given(unit_m) {
        points.iter_mut().flatten().for_each(|x| *x *= unit_m);
    }
}

/// Adds a shift in metres.
pub fn shift(points: &mut [[f64; 3]], offset_m: [f64; 3]) {
    if offset_m.iter().any(|shift| *shift != 0.0) {
        points.iter_mut().for_each(|[x, y, z]| [*x, *y, *z] = [*x + offset_m[0], *y + offset_m[1], *z + offset_m[2]]);
    }
}

/// The first point with its shift, which tells whether the file can be in a system.
pub fn first(points: &[[f64; 3]], offset_m: [f64; 3]) -> Option<[f64; 3]> {
    points.first().map(|point| std::array::from_fn(|axis| point[axis] + offset_m[axis]))
}

/// Widest face in degrees: some kilometres.
const WIDEST_DEG: f64 = 0.05;
/// Times its width that a face in degrees is high, in metres.
const LEAST_TIMES: f64 = 100.0;

/// What there is to say where the points of a file without a system look like longitudes and latitudes with heights in metres.
pub fn warning(settled: &Settled, points: &[[f64; 3]]) -> Option<String> {
    if settled.crs.is_some() {
        return None;
    }
    let extent = |axis: usize| {
        let values = points.iter().map(|point| point[axis]);
        values.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], x| [low.min(x), high.max(x)])
    };
    let [[west, east], [south, north], [low, high]] = [0, 1, 2].map(extent);
    let width = (east - west).max(north - south);
    let can_be = west.abs().max(east.abs()) <= 180.0 && south.abs().max(north.abs()) <= 90.0;
    let are = can_be && width > 0.0 && width < WIDEST_DEG && high - low > LEAST_TIMES * width;
    are.then(|| {
        format!(
            "X spans {:.6}, Y {:.6} and Z {:.3}: longitudes and latitudes in degrees? Lengths are in metres; reproject the file to the UTM zone of the site",
            east - west,
            north - south,
            high - low
        )
    })
}

fn is_given(unit_m: f64) -> bool {
    unit_m.to_bits() != 1f64.to_bits()
}

/// The fault of a unit beside a coordinate reference system, which has one of its own.
pub fn two_units(unit_m: f64, has_crs: bool) -> Option<Fault> {
    let text = "a coordinate reference system has a unit of its own; leave `unit_m` out, or `crs`";
    (is_given(unit_m) && has_crs).then(|| Fault::new(text).below("unit_m"))
}

/// Refuses a unit for a file that states one itself.
pub fn check_unit(path: &str, unit_m: f64, settled: &Settled) -> Result<(), StageError> {
    if is_given(unit_m) && *settled != Settled::metres() {
        fail!("`{path}` states the system and the unit of its coordinates; leave `unit_m` out");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn degrees_with_heights_in_metres_are_told_from_walls() {
        let face = |[x, y, z]: [f64; 3]| [[x, y, 400.0], [x + 2e-4, y + 1e-4, 400.0 + z], [x, y + 1e-4, 400.0]];
        assert!(warning(&Settled::metres(), &face([11.0, 47.5, 25.0])).unwrap().contains("degrees"));
        // A wall that stands along an axis, a coin, and a slope.
        for points in [
            [[0.0, 0.0, 0.0], [0.0, 30.0, 0.0], [0.0, 30.0, 20.0]],
            [[0.0, 0.0, 0.0], [0.02, 0.0, 0.001], [0.0, 0.02, 0.0]],
            [[0.0, 0.0, 0.0], [30.0, 0.0, 20.0], [0.0, 30.0, 5.0]],
        ] {
            assert_eq!(warning(&Settled::metres(), &points), None);
        }
        assert_eq!(warning(&Settled::metres(), &[]), None);
    }
}
