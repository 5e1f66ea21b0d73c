//! How finely the outlines of a truth are drawn.

use rockface_core::artefact::{Inventory, Polygon};

/// Edges that deviate less from an axis lie along it, metres.
const ALONG_M: f64 = 1e-7;

/// The length of the steps of outlines that run along the cells of a raster, as `remove-blocks` draws them, metres; `None`
/// where an outline has an oblique edge, and where all are plain rectangles.
pub fn step_m(inventory: &Inventory) -> Option<f64> {
    let polygons = || inventory.features.iter().flat_map(|feature| &feature.outline);
    let rings = || polygons().flat_map(|Polygon { exterior, holes }| std::iter::once(exterior).chain(holes));
    if !rings().any(|ring| ring.len() > 4) {
        return None;
    }
    let mut least_m = f64::INFINITY;
    for ring in rings() {
        for (a, b) in ring.iter().zip(ring.iter().cycle().skip(1)) {
            let [x, y] = [(b[0] - a[0]).abs(), (b[1] - a[1]).abs()];
            if x.min(y) > ALONG_M {
                return None;
            }
            if x.max(y) > ALONG_M {
                least_m = least_m.min(x.max(y));
            }
        }
    }
    least_m.is_finite().then_some(least_m)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::artefact::{Feature, Frame};

    fn of(exterior: &[[f64; 2]]) -> Option<f64> {
        let outline = vec![Polygon { exterior: exterior.to_vec(), holes: Vec::new() }];
        let features = vec![Feature { outline, values: Vec::new() }];
        step_m(&Inventory { frame: Frame::Wall, columns: Vec::new(), features })
    }

    #[test]
    fn steps_are_those_of_the_cells_an_outline_runs_along() {
        let stairs = [[0.0, 0.0], [0.15, 0.0], [0.15, 0.05], [0.05, 0.05], [0.05, 0.1], [0.0, 0.1]];
        assert!((of(&stairs).unwrap() - 0.05).abs() < 1e-9);
        assert_eq!(of(&[[0.0, 0.0], [0.3, 0.0], [0.3, 0.2], [0.0, 0.2]]), None);
        assert_eq!(of(&[[0.0, 0.0], [0.3, 0.0], [0.4, 0.1], [0.3, 0.2], [0.0, 0.2]]), None);
    }
}
