//! The noise between two surfaces at a pose, as normals from squares of points meet it.

use nalgebra::Vector3;
use rayon::prelude::*;
use rockface_core::numerics::marginal::NORMAL_MAD;
use rockface_core::numerics::quantile::median;

use super::{Fit, Moving, Pose};
use crate::fusion::nearest::local;

/// Sides, in points, of the squares whose mean residuals tell how noise is correlated: odd, the last one the largest.
const SIDES: [usize; 3] = [1, 3, 5];
const LARGEST: usize = 5;
/// Squares of a side whose spread is known.
const LEAST_SQUARES: usize = 50;

impl Fit<'_> {
    /// Robust standard deviation of the distances of pairs at a pose from the planes, metres; changes hardly add to it.
    pub(super) fn white_noise_m(&self, points: &mut [Moving], pose: &Pose) -> f64 {
        let mut sizes = self.pair_all(pose, points);
        sizes.retain(|size| !size.is_nan());
        NORMAL_MAD * median(&mut sizes).unwrap_or(0.0)
    }

    /// The standard deviation of the white noise that would tilt normals as the noise between the surfaces does, metres: the
    /// largest over sides n of n times the robust spread of mean residuals of n x n neighbouring points of the source. All are
    /// the same for white noise; of correlated noise, which means of neighbours reduce by less, they grow with n.
    pub(super) fn correlated_noise_m(&self, pose: &Pose) -> f64 {
        let (width, height) = (self.source.width, self.source.height);
        // About as many points as are registered, all of some squares.
        let stride = LARGEST * ((width * height) as f64 / self.settings.points.max(1) as f64).sqrt().max(1.0) as usize;
        let corners: Vec<(usize, usize)> = (0..(height + 1).saturating_sub(LARGEST))
            .step_by(stride)
            .flat_map(|row| (0..(width + 1).saturating_sub(LARGEST)).step_by(stride).map(move |column| (row, column)))
            .collect();
        let means: Vec<[f64; SIDES.len()]> = corners.par_iter().map(|corner| self.means(pose, *corner)).collect();
        let spread = |side: usize| {
            let mut sizes: Vec<f64> =
                means.iter().map(|means| means[side].abs()).filter(|size| !size.is_nan()).collect();
            if sizes.len() < LEAST_SQUARES { 0.0 } else { NORMAL_MAD * median(&mut sizes).unwrap_or(0.0) }
        };
        (0..SIDES.len()).map(spread).fold(0.0, f64::max)
    }

    /// Mean residuals of squares of each side in the middle of the largest with this corner, times the root of the number of
    /// points; NaN where less than half of them have a partner.
    fn means(&self, pose: &Pose, (row, column): (usize, usize)) -> [f64; SIDES.len()] {
        let residuals: Vec<f64> = (0..LARGEST * LARGEST)
            .map(|i| (row + i / LARGEST) * self.source.width + column + i % LARGEST)
            .map(|place| self.residual(pose, local(self.source, place)))
            .collect();
        SIDES.map(|side| {
            let margin = (LARGEST - side) / 2;
            let within = |i: usize| (margin..margin + side).contains(&i);
            let inner = (0..LARGEST * LARGEST).filter(|i| within(i / LARGEST) && within(i % LARGEST));
            let known: Vec<f64> = inner.map(|i| residuals[i]).filter(|residual| !residual.is_nan()).collect();
            let is_filled = 2 * known.len() >= side * side;
            if is_filled { known.iter().sum::<f64>() / (known.len() as f64).sqrt() } else { f64::NAN }
        })
    }

    /// Distance of a point of the source from the plane of its partner, metres; NaN without a point or partner.
    fn residual(&self, pose: &Pose, point: Vector3<f64>) -> f64 {
        if point.x.is_nan() {
            return f64::NAN;
        }
        let mut moving = Moving { arm: point - self.centroid, ..Moving::default() };
        self.pair_up(pose, &mut moving);
        moving.pair.map_or(f64::NAN, |pair| pair.offset.dot(&pair.normal))
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix3;

    use super::*;
    use crate::fusion::icp::{Method, Pairing, Settings};
    use crate::fusion::nearest::Columns;
    use crate::fusion::normals::{Neighbourhood, Normals};
    use rockface_core::artefact::{Frame, Surface};
    use rockface_core::numerics::random::Key;

    /// A level face of points 1 m apart with noise that is the sum of white noise over squares of so many points, over their side.
    fn noisy(key: u8, side: i32, noise_m: f64) -> Surface {
        let (width, height) = (120, 110);
        let field = Key([key; 32]).field();
        let point = |i: usize| {
            let (column, row) = ((i % width) as i32, (i / width) as i32);
            let white = (0..side * side).map(|k| field.normal(column + k % side, row + k / side)).sum::<f64>();
            [column as f32, -(row as f32), (noise_m * white / f64::from(side)) as f32]
        };
        let points = (0..width * height).map(point).collect();
        let squares = vec![Surface::FIRST | Surface::SECOND; (width - 1) * (height - 1)];
        Surface { frame: Frame::Wall, width, height, origin_m: [0.0; 3], points, squares }
    }

    /// Noise of the residuals of two such faces with 0.35 m each, metres.
    fn found_m(side: i32) -> f64 {
        let (source, target) = (noisy(1, side, 0.35), noisy(2, side, 0.35));
        let settings = Settings {
            method: Method::PointToPlane,
            pairing: Pairing::InPlan,
            trim: 0.9,
            max_distance_m: None,
            points: 40_000,
            max_iterations: 50,
            weak_eigenvalue: 0.01,
            between_points: true,
        };
        let fit = Fit {
            source: &source,
            centroid: Vector3::zeros(),
            target: &target,
            normals: Normals::new(&target, Neighbourhood::WIDEST, 0),
            finer: None,
            columns: Columns::new(&target, true).unwrap(),
            radius_m: 50.0,
            search_m: 20.0,
            settings,
        };
        fit.correlated_noise_m(&Pose { rotation: Matrix3::identity(), translation: Vector3::zeros() })
    }

    #[test]
    fn correlated_noise_counts_as_the_white_noise_that_tilts_normals_as_much() {
        let white = 0.35 * 2.0f64.sqrt();
        assert!((found_m(1) / white - 1.0).abs() < 0.15, "{}", found_m(1));
        // The correlation is 1 - k / 5 at k points along each axis. Of the sum over 5 points the variance is 5 (1 + 2 (0.8^2 + 0.6^2 +
        // 0.4^2 + 0.2^2)) = 5 * 3.4 times that of one, and that of the square the square of it: a factor of 3.4 on the spread.
        assert!((found_m(5) / (3.4 * white) - 1.0).abs() < 0.15, "{}", found_m(5));
    }
}
