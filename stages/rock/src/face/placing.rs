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
