//! The inverse of normal equations: the covariance, or the names of the directions that nothing fixes.

use nalgebra::{Cholesky, DMatrix, DVectorView, SymmetricEigen};

use super::datum::{inner_constraints, similarity_modes};
use super::normals::Normals;
use super::unknowns::Unknowns;
use rockface_core::StageError;
use rockface_core::artefact::Cameras;

/// Below this share of the largest, an eigenvalue of the scaled normal equations counts as zero.
const SINGULAR: f64 = 1e-13;
/// Below this share of itself a diagonal element has been eliminated: its unit comes from what it was.
const ELIMINATED: f64 = 1e-10;

/// What fixes position, orientation and scale of the whole block.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Datum {
    /// Control points or positions in the normal equations.
    Priors,
    /// Inner constraints; the mean distance of the face turns rotations into metres.
    Inner {
        /// Mean distance of images and face, metres.
        distance_m: f64,
    },
}

/// A covariance and how well it was determined.
#[derive(Debug, Clone)]
pub struct Inverse {
    /// Covariance of the unknowns, exactly symmetric.
    pub covariance: DMatrix<f64>,
    /// Ratio of the largest to the smallest eigenvalue of the scaled normal equations.
    pub condition: f64,
}

/// Inverts reduced normal equations, scaled to a unit diagonal.
///
/// # Errors
///
/// When a direction is free: it is named, with what would fix it.
pub fn invert(normals: &Normals, cameras: &Cameras, unknowns: &Unknowns, datum: Datum) -> Result<Inverse, StageError> {
    let scaled = Scaled::new(normals, cameras, unknowns)?;
    match datum {
        Datum::Priors => {
            let (inverse, condition) = scaled.inverse(&scaled.matrix, cameras, unknowns)?;
            Ok(Inverse { covariance: symmetric(&inverse), condition })
        }
        Datum::Inner { distance_m } => {
            // With an orthonormal basis G of the null space, (N + G G^T)^-1 = N^+ + G G^T.
            let modes = similarity_modes(cameras, unknowns);
            let basis = orthonormal(&DMatrix::from_fn(modes.nrows(), 7, |i, j| modes[(i, j)] / scaled.units[i]))
                .ok_or_else(no_inner)?;
            let fixed = &scaled.matrix + &basis * basis.transpose();
            let (inverse, condition) = scaled.inverse(&fixed, cameras, unknowns)?;
            let inner = inner_constraints(&inverse, &modes, unknowns, distance_m).ok_or_else(no_inner)?;
            Ok(Inverse { covariance: symmetric(&inner), condition })
        }
    }
}

/// What determines a block with so many free directions of the whole and so many others.
fn way_out(whole: usize, others: usize) -> String {
    let block = match whole {
        0 => "",
        7.. => "give `control_points` (three or more), `position_sigma_m` (GNSS), or datum `inner`",
        _ => {
            "projection centres or control points that are on one line, as those of two images always are, leave the turn about \
             it free, however well they are measured: give `control_points` (three or more), an image off the line with \
             `position_sigma_m`, or datum `inner` without both"
        }
    };
    let lens =
        if others > 0 { "fewer `free_interior` or an `interior_sigma` where lens parameters are free" } else { "" };
    [block, lens].into_iter().filter(|text| !text.is_empty()).collect::<Vec<_>>().join("; ")
}

fn no_inner() -> StageError {
    StageError::new("inner constraints need projection centres that do not lie in one point")
        .hint("use control points (`control_points`) instead of datum `inner`")
}

fn symmetric(matrix: &DMatrix<f64>) -> DMatrix<f64> {
    DMatrix::from_fn(matrix.nrows(), matrix.ncols(), |i, j| 0.5 * (matrix[(i, j)] + matrix[(j, i)]))
}

/// Gram-Schmidt, twice for full precision; `None` where the columns are not independent.
fn orthonormal(columns: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let mut basis = columns.clone();
    for j in 0..basis.ncols() {
        let length = basis.column(j).norm();
        let mut column = basis.column(j).clone_owned();
        for _ in 0..2 {
            for k in 0..j {
                let other = basis.column(k).clone_owned();
                column -= &other * other.dot(&column);
            }
        }
        if column.norm() <= 1e-9 * length {
            return None;
        }
        basis.set_column(j, &column.normalize());
    }
    Some(basis)
}

/// Normal equations with a unit diagonal.
struct Scaled {
    matrix: DMatrix<f64>,
    /// The unit of each unknown: what it would be known to if all others were without error.
    units: Vec<f64>,
    /// Root of what each diagonal element was before object points were eliminated: what its rounding is relative to.
    rounding: Vec<f64>,
}

impl Scaled {
    fn new(normals: &Normals, cameras: &Cameras, unknowns: &Unknowns) -> Result<Self, StageError> {
        let n = normals.diagonal.len();
        let loose: Vec<usize> = (0..n).filter(|i| normals.diagonal[*i] <= 0.0).collect();
        if !loose.is_empty() {
            let parameters = unknowns.parameters();
            let names: Vec<String> = loose.iter().take(6).map(|i| parameters[*i].name(cameras)).collect();
            return Err(StageError::new(format!(
                "nothing measures {} of the {n} parameters: {}{}",
                loose.len(),
                names.join(", "),
                if loose.len() > names.len() { ", ..." } else { "" }
            ))
            .hint("an image without tie points has no orientation: more `tie_points`, or leave it out"));
        }
        let weight = |i: usize| normals.matrix[(i, i)].max(ELIMINATED * normals.diagonal[i]);
        let units: Vec<f64> = (0..n).map(|i| 1.0 / weight(i).sqrt()).collect();
        let rounding = (0..n).map(|i| normals.diagonal[i].sqrt() * units[i]).collect();
        let matrix = DMatrix::from_fn(n, n, |i, j| normals.matrix[(i, j)] * units[i] * units[j]);
        Ok(Self { matrix, units, rounding })
    }

    /// What rounding of the normal equations can make of an eigenvalue, by its vector.
    fn uncertainty(&self, vector: DVectorView<f64>) -> f64 {
        let sum: f64 = vector.iter().zip(&self.rounding).map(|(x, rounding)| x.abs() * rounding).sum();
        16.0 * f64::EPSILON * sum * sum
    }

    /// The inverse in the units of the unknowns, and the condition number of the scaled matrix.
    fn inverse(
        &self,
        matrix: &DMatrix<f64>,
        cameras: &Cameras,
        unknowns: &Unknowns,
    ) -> Result<(DMatrix<f64>, f64), StageError> {
        let eigen = SymmetricEigen::new(matrix.clone());
        let largest = eigen.eigenvalues.iter().copied().fold(0.0, f64::max);
        let limit = |i: usize| self.uncertainty(eigen.eigenvectors.column(i)).max(SINGULAR * largest);
        let free: Vec<usize> = (0..self.units.len()).filter(|i| eigen.eigenvalues[*i] <= limit(*i)).collect();
        if !free.is_empty() {
            return Err(self.singular(&eigen.eigenvectors, &free, cameras, unknowns));
        }
        let smallest = eigen.eigenvalues.iter().copied().fold(f64::INFINITY, f64::min);
        let cholesky = Cholesky::new(matrix.clone()).ok_or_else(|| {
            StageError::new("the normal equations are not positive definite: nothing is known well enough")
        })?;
        let inverse = cholesky.inverse();
        let units = &self.units;
        let unscaled = DMatrix::from_fn(units.len(), units.len(), |i, j| inverse[(i, j)] * units[i] * units[j]);
        Ok((unscaled, largest / smallest))
    }

    /// The error that names free directions: those of the whole block, and of the others their largest parameters.
    fn singular(&self, vectors: &DMatrix<f64>, free: &[usize], cameras: &Cameras, unknowns: &Unknowns) -> StageError {
        let modes = similarity_modes(cameras, unknowns);
        let scaled = DMatrix::from_fn(modes.nrows(), 7, |i, j| modes[(i, j)] / self.units[i]);
        let basis = orthonormal(&scaled);
        let of_block = |at: usize| {
            let share = basis.as_ref().map_or(0.0, |basis| basis.tr_mul(&vectors.column(at)).norm_squared());
            share > 0.99
        };
        let (whole, others): (Vec<usize>, Vec<usize>) = free.iter().partition(|at| of_block(**at));
        let mut named = Vec::new();
        if !whole.is_empty() {
            named.push(format!("{} of the block as a whole (position, orientation, scale)", whole.len()));
        }
        let parameters = unknowns.parameters();
        for at in others.iter().take(3) {
            let vector = vectors.column(*at);
            let mut order: Vec<usize> = (0..self.units.len()).collect();
            order.sort_by(|a, b| vector[*b].abs().total_cmp(&vector[*a].abs()).then(a.cmp(b)));
            let names: Vec<String> = order.iter().take(3).map(|i| parameters[*i].name(cameras)).collect();
            named.push(format!("one of {} and others together", names.join(", ")));
        }
        let message = format!("the block is not determined: {} free directions: {}", free.len(), named.join("; "));
        StageError::new(message).hint(way_out(whole.len(), others.len()))
    }
}
