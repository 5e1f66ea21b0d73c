//! Draws from Student's t distribution with five degrees of freedom, scaled to unit deviation.

use std::f64::consts::{FRAC_PI_2, PI};

use rockface_core::numerics::portable_math;

/// Degrees of freedom of the Student distribution.
const STUDENT_DEGREES: f64 = 5.0;

/// The quantile of Student's t at `u + 1/2`, divided by its deviation `sqrt(5/3)`.
///
/// The distribution function with five degrees of freedom has a closed form in the angle `atan(t / sqrt 5)`; it is inverted by
/// bisection in that angle.
pub fn student(u: f64) -> f64 {
    let below = |angle: f64| {
        let (sin, cos) = portable_math::sincos(angle);
        (angle + sin * cos * (1.0 + 2.0 / 3.0 * cos * cos)) / PI
    };
    let (mut low, mut high) = (0.0, FRAC_PI_2);
    for _ in 0..54 {
        let middle = 0.5 * (low + high);
        if below(middle) < u.abs() { low = middle } else { high = middle }
    }
    let t = STUDENT_DEGREES.sqrt() * portable_math::tan(0.5 * (low + high));
    t.copysign(u) * ((STUDENT_DEGREES - 2.0) / STUDENT_DEGREES).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn student_quantiles_are_the_tabulated_ones() {
        for (p, t) in [(0.975, 2.570_581_8), (0.75, 0.726_686_8), (0.999, 5.893_43)] {
            assert!((student(p - 0.5) * (5.0f64 / 3.0).sqrt() - t).abs() < 1e-5, "{p}");
            assert!((student(p - 0.5) + student(0.5 - p)).abs() < 1e-12);
        }
    }
}
