//! What parameters of the importers do to the coordinates of a file: their unit, and a shift.

use rockface_core::crs::{CrsName, Kind, Settled, Stated};
use rockface_core::numerics::quantile;
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
    if is_shift(offset_m) {
        points.iter_mut().for_each(|[x, y, z]| [*x, *y, *z] = [*x + offset_m[0], *y + offset_m[1], *z + offset_m[2]]);
    }
}

fn is_shift(offset_m: [f64; 3]) -> bool {
    offset_m.iter().any(|shift| *shift != 0.0)
}

/// Whether a unit or a shift changes coordinates.
pub fn is_moved(unit_m: f64, offset_m: [f64; 3]) -> bool {
    is_given(unit_m) || is_shift(offset_m)
}

/// Points whose median is taken, at most.
const SAMPLE: usize = 10_000;

/// A place in the middle of the points with its shift, which tells whether the file can be in a system: the median of each coordinate, so
/// no point far from all others, such as one at 0, 0, 0, decides.
pub fn middle(points: impl ExactSizeIterator<Item = [f64; 3]>, offset_m: [f64; 3]) -> Option<[f64; 3]> {
    let step = points.len().div_ceil(SAMPLE).max(1);
    let sample: Vec<[f64; 3]> = points.step_by(step).collect();
    let mut middle = [0.0; 3];
    for axis in 0..3 {
        let mut values: Vec<f64> = sample.iter().map(|point| point[axis]).collect();
        middle[axis] = quantile::median(&mut values)? + offset_m[axis];
    }
    Some(middle)
}

/// No face of the Earth is as high, metres.
const HIGHEST_M: f64 = 10_000.0;

/// What there is to say where heights are none of a face: columns in another order, or another unit.
pub fn height_warning(middle: Option<[f64; 3]>) -> Option<String> {
    let [_, _, z] = middle.filter(|[_, _, z]| z.abs() > HIGHEST_M)?;
    Some(format!(
        "the median of Z is {z:.0}, and no face is as high in metres: are X, Y and Z other columns (`columns` of `import-cloud`), or is the \
         unit another one (`unit_m`)?"
    ))
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

/// The fault of a unit beside a coordinate reference system in another unit than metres: `unit_m` makes metres of the file's coordinates.
pub fn unit_beside_system(unit_m: f64, crs: Option<&CrsName>) -> Option<Fault> {
    let crs = crs.filter(|crs| is_given(unit_m) && !crs.is_in_metres())?;
    let text = format!(
        "with `unit_m` the coordinates become metres, and `{}` is a system in another unit; give the system in metres, or leave `unit_m` out",
        crs.0
    );
    Some(Fault::new(text).below("unit_m"))
}

/// Refuses a unit for a file that states one itself, or beside it in a `.prj`.
pub fn check_unit(path: &str, unit_m: f64, stated: &[Option<Stated>; 2]) -> Result<(), StageError> {
    let states_unit =
        |stated: &Stated| stated.kind != Kind::Local || stated.unit.as_ref().is_some_and(|unit| !unit.is_metre());
    if is_given(unit_m) && stated.iter().flatten().any(states_unit) {
        fail!("`{path}` states the system and the unit of its coordinates; leave `unit_m` out");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_middle_is_where_most_points_are() {
        let face = (0..30_000).map(|i| [451_000.0 + f64::from(i % 10), 5_512_000.0, f64::from(i % 7)]);
        let stray: Vec<[f64; 3]> = [[0.0; 3]].into_iter().chain(face).chain([[1e7; 3]]).collect();
        let [x, y, z] = middle(stray.iter().copied(), [10.0, 0.0, 600.0]).unwrap();
        assert!(
            (x - 451_014.5).abs() < 1.0 && (y - 5_512_000.0).abs() < 1e-6 && (z - 603.0).abs() < 1.0,
            "{x} {y} {z}"
        );
        assert_eq!(middle([].into_iter(), [0.0; 3]), None);
        assert_eq!((height_warning(Some([x, y, z])), height_warning(None)), (None, None));
        assert!(height_warning(Some([7.0, x, y])).unwrap().contains("Z is 5512000"));
    }

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

    #[test]
    fn a_face_in_degrees_is_narrow_and_high_for_its_width() {
        let warned = |width: f64, height_m: f64| {
            let points = [[11.0, 47.5, 400.0], [11.0 + width, 47.5, 400.0 + height_m]];
            warning(&Settled::metres(), &points).is_some()
        };
        // At most a twentieth of a degree wide, and 100 times as many metres high as degrees wide.
        assert_eq!([warned(0.049, 900.0), warned(0.051, 900.0)], [true, false]);
        assert_eq!([warned(0.04, 4.1), warned(0.04, 3.9)], [true, false]);
    }

    #[test]
    fn heights_of_more_than_ten_kilometres_are_warned_of() {
        let warned = |z: f64| height_warning(Some([451_000.0, 5_512_000.0, z])).is_some();
        assert_eq!([9_999.0, 10_001.0, -10_001.0].map(warned), [false, true, true]);
    }
}
