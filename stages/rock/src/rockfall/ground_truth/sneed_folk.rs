//! Classes of shape after Sneed and Folk (1958): how compact, platy, bladed or elongate a body is.

/// Ratios of the axes L >= I >= S of a body, and its class.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Form {
    /// S/L, from 0 (thin) to 1 (as thick as long).
    pub flatness: f64,
    /// (L - I)/(L - S), from 0 (a plate or disc) to 1 (a rod); 0.5 where all axes are equal and it has no value.
    pub elongation: f64,
    /// Maximum projection sphericity, the cube root of S²/(L I).
    pub sphericity: f64,
    /// `C` compact, `P` platy, `B` bladed, `E` elongate, with `C` or `V` (very) before the last three.
    pub class: &'static str,
}

/// The ten classes, most compact first.
pub const CLASSES: [&str; 10] = ["C", "CP", "CB", "CE", "P", "B", "E", "VP", "VB", "VE"];

/// Limits of S/L between compact, its three neighbours, the plain and the very flat or long ones.
pub const FLATNESS_LIMITS: [f64; 3] = [0.7, 0.5, 0.3];

/// Limits of (L - I)/(L - S) between platy, bladed and elongate.
pub const ELONGATION_LIMITS: [f64; 2] = [0.33, 0.67];

/// The form of a body with these axes in any order, metres; `None` unless all are finite and the longest positive.
///
/// # References
/// Sneed, E. D., Folk, R. L. (1958), Pebbles in the lower Colorado River, Texas: a study in particle morphogenesis,
/// Journal of Geology 66, 114-150.
pub fn form(mut sides_m: [f64; 3]) -> Option<Form> {
    sides_m.sort_by(|a, b| b.total_cmp(a));
    let [long, intermediate, short] = sides_m;
    if !(long > 0.0 && long.is_finite() && short >= 0.0) {
        return None;
    }
    let flatness = short / long;
    let elongation = if long > short { (long - intermediate) / (long - short) } else { 0.5 };
    let sphericity = if intermediate > 0.0 {
        rockface_core::numerics::portable_math::cbrt(short * short / (long * intermediate))
    } else {
        0.0
    };
    Some(Form { flatness, elongation, sphericity, class: class(flatness, elongation) })
}

fn class(flatness: f64, elongation: f64) -> &'static str {
    let column = ELONGATION_LIMITS.iter().filter(|limit| elongation >= **limit).count();
    match FLATNESS_LIMITS.iter().filter(|limit| flatness < **limit).count() {
        0 => CLASSES[0],
        row => CLASSES[3 * row - 2 + column],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bodies_fall_into_their_classes() {
        let cases = [
            ([1.0, 1.0, 1.0], "C"),
            ([1.0, 0.8, 0.75], "C"),
            ([1.0, 0.98, 0.6], "CP"),
            ([0.8, 1.0, 0.6], "CB"),
            ([1.0, 0.62, 0.6], "CE"),
            ([1.0, 0.4, 1.0], "P"),
            ([1.0, 0.7, 0.4], "B"),
            ([1.0, 0.4, 0.4], "E"),
            ([1.0, 1.0, 0.1], "VP"),
            ([1.0, 0.5, 0.1], "VB"),
            ([1.0, 0.1, 0.1], "VE"),
        ];
        for (sides, expected) in cases {
            assert_eq!(form(sides).unwrap().class, expected, "{sides:?}");
        }
    }

    #[test]
    fn the_published_sphericity_and_the_cases_without_one() {
        let found = form([4.0, 2.0, 1.0]).unwrap();
        assert!((found.sphericity - 0.5).abs() < 1e-12 && (found.flatness - 0.25).abs() < 1e-15);
        assert!((found.elongation - 2.0 / 3.0).abs() < 1e-15);
        assert_eq!(form([0.0; 3]), None);
        assert_eq!(form([f64::NAN, 1.0, 1.0]), None);
        assert_eq!(form([f64::INFINITY, 1.0, 1.0]), None);
    }
}
