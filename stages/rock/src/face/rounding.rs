//! Coordinates that were rounded when a file was written: single precision at map coordinates, or too few digits.

/// Rounding to more than this is worth a warning, metres.
const LARGEST_STEP_M: f64 = 1e-3;
/// Digits that programs write where nobody chose their number: `%g` has 6; 9 and more are chosen, or all there are.
const FEW_DIGITS: std::ops::RangeInclusive<usize> = 6..=8;
/// Points whose digits are counted.
const LOOKED_AT: usize = 10_000;

/// What there is to say where coordinates of a file, metres, are coarser than a millimetre because of how they were written.
pub fn warning(points: &[[f64; 3]]) -> Option<String> {
    let Rounding { largest_m, step_m, how } = rounding(points)?;
    Some(format!(
        "coordinates of {largest_m:.0} m were written {how}, whose steps are {step_m:.3} m there: export in double precision with \
         all digits, or shifted, and add the shift with `offset_m`"
    ))
}

/// How coordinates were rounded.
#[derive(Debug, PartialEq)]
struct Rounding {
    /// The largest coordinate.
    largest_m: f64,
    /// Between it and the next number that could be written.
    step_m: f64,
    how: String,
}

fn rounding(points: &[[f64; 3]]) -> Option<Rounding> {
    let largest_m = points.iter().flatten().fold(0.0f64, |largest, x| largest.max(x.abs()));
    let is_single = |x: &f64| f64::from(*x as f32).to_bits() == x.to_bits();
    let single = largest_m as f32;
    let step_m = f64::from(single.next_up()) - f64::from(single);
    if step_m > LARGEST_STEP_M && points.iter().flatten().all(is_single) {
        return Some(Rounding { largest_m, step_m, how: "like numbers of single precision".to_owned() });
    }
    let (_, exponent) = digits(largest_m);
    let step_of = |digits: usize| format!("1e{}", exponent + 1 - digits as i32).parse().unwrap_or(0.0);
    if step_of(*FEW_DIGITS.start()) <= LARGEST_STEP_M {
        return None;
    }
    let mut most = [0; 3];
    for point in points.iter().step_by(points.len().div_ceil(LOOKED_AT).max(1)) {
        for (most, x) in most.iter_mut().zip(point) {
            *most = digits(*x).0.max(*most);
        }
        if most.iter().any(|most| most > FEW_DIGITS.end()) {
            return None;
        }
    }
    // Fixed decimals give large coordinates more digits than small ones; a fixed number of digits gives all axes as many, but for
    // one along which rounding has left a single coordinate.
    let count = *most.iter().max()?;
    let is_full = |axis: usize| {
        most[axis] == count || points.iter().all(|point| point[axis].to_bits() == points[0][axis].to_bits())
    };
    let step_m = step_of(count);
    let is_rounded = FEW_DIGITS.contains(&count) && step_m > LARGEST_STEP_M && (0..3).all(is_full);
    is_rounded.then(|| Rounding { largest_m, step_m, how: format!("with {count} digits") })
}

/// How many decimal digits a number has, zeros at both ends not counted, and the power of ten of the first.
fn digits(x: f64) -> (usize, i32) {
    let text = format!("{:e}", x.abs());
    let (digits, exponent) = text.split_once('e').unwrap_or((&text, "0"));
    (digits.bytes().filter(u8::is_ascii_digit).count(), exponent.parse().unwrap_or(0))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A face in map coordinates, each written by `text` and read again.
    fn written(text: impl Fn(f64) -> String) -> Vec<[f64; 3]> {
        let point = |i: u32| {
            let i = f64::from(i);
            [412_345.0 + 0.137 * i, 5_567_890.0 + 0.0331 * i, 1_800.0 + 0.0713 * i]
        };
        let read = |x: f64| text(x).parse().unwrap();
        (0..400).map(|i| point(i).map(read)).collect()
    }

    #[test]
    fn few_digits_are_told_from_fixed_decimals_and_from_all_digits() {
        let step = |text: fn(f64) -> String| rounding(&written(text)).map(|found| (found.how, found.step_m));
        assert_eq!(step(|x| format!("{x:.6e}")), Some(("with 7 digits".to_owned(), 1.0)));
        assert_eq!(step(|x| format!("{x:.5e}")), Some(("with 6 digits".to_owned(), 10.0)));
        assert_eq!(step(|x| format!("{x:.7e}")), Some(("with 8 digits".to_owned(), 0.1)));
        assert_eq!(
            step(|x| format!("{}", f64::from(x as f32))),
            Some(("like numbers of single precision".to_owned(), 0.5))
        );
        for exact in [|x: f64| format!("{x}"), |x: f64| format!("{x:.3}"), |x: f64| format!("{x:.2}")] {
            assert_eq!(step(exact), None);
        }
    }

    #[test]
    fn a_face_whose_depth_rounding_has_taken_away_is_rounded() {
        let mut points = written(|x| format!("{x:.6e}"));
        points.iter_mut().for_each(|point| point[1] = 5_567_890.0);
        assert_eq!(rounding(&points).unwrap().how, "with 7 digits");
    }

    #[test]
    fn grids_of_elevations_and_small_coordinates_are_not_rounded() {
        let grid: Vec<[f64; 3]> = (0..400)
            .map(|i| [412_345.0 + f64::from(i % 20), 5_567_890.0 + f64::from(i / 20), 1_800.0 + 0.37 * f64::from(i)])
            .collect();
        let half: Vec<[f64; 3]> = grid.iter().map(|[x, y, z]| [x + 0.5, y + 0.5, *z]).collect();
        let local: Vec<[f64; 3]> = (0..400).map(|i| [0.0123 * f64::from(i), -9.87654, 151.371]).collect();
        for points in [grid, half, local, vec![[0.0; 3]; 4], Vec::new()] {
            assert_eq!(rounding(&points), None);
        }
    }

    #[test]
    fn single_precision_is_told_from_steps_of_a_millimetre_on() {
        // Steps are 0.98 mm up to 16384 m and twice as much beyond.
        let step_at = |x: f32| rounding(&[[f64::from(x), 0.0, 0.0]; 3]).map(|found| found.step_m);
        assert_eq!(step_at(16_383.123), None);
        assert_eq!(step_at(16_385.123), Some(0.001_953_125));
    }
}
