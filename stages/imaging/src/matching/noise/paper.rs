//! The matching noise of a pair: white by pixel, and smooth by bicubic interpolation of a coarse grid of nodes.
//!
//! Both are unit fields that a sigma multiplies, so a sweep of sigma reuses its draws (paper 2.1.2, Eq. 2 and 3).
//! Interpolation lowers the variance between nodes, from 1 at a node to 0.41 in the centre of a Catmull-Rom cell.

use std::ops::Mul;

use crate::matching::noise::student::student;
use rockface_core::choice;
use rockface_core::numerics::fast_round::floor;
use rockface_core::numerics::portable_math;
use rockface_core::numerics::random::{Field, Key};
use rockface_core::numerics::simd::{LANES, Lanes, Number, both};

choice! {
    /// Distribution of a draw, scaled to unit standard deviation.
    pub enum Distribution {
        /// Normal.
        Gaussian = "gaussian",
        /// Two-sided exponential: heavier tails.
        Laplace = "laplace",
        /// Even between bounds: no tails.
        Uniform = "uniform",
        /// Student's t with five degrees of freedom: excess kurtosis 6.
        Student = "student",
    }
}

choice! {
    /// How the smooth field is interpolated between its nodes.
    pub enum Interpolation {
        /// Keys' bicubic kernel with a = -0.5.
        CatmullRom = "catmull_rom",
        /// Keys' bicubic kernel with a = -0.75.
        Cubic075 = "cubic_075",
        /// Keys' bicubic kernel with a = -1.
        Cubic100 = "cubic_100",
        /// Linear in both directions.
        Bilinear = "bilinear",
        /// Cubic B-spline: it smooths and does not pass through the nodes, whose variance it lowers to 0.2 to 0.23.
        BSpline = "b_spline",
    }
}

choice! {
    /// What the standard deviation of the smooth field refers to.
    pub enum Variance {
        /// The nodes; between them it is smaller (the paper's field).
        Nodes = "nodes",
        /// The mean variance over the field.
        Mean = "mean",
        /// Every point.
        Pointwise = "pointwise",
    }
}

impl Distribution {
    /// The draw of cell (x, y), with mean 0 and standard deviation 1.
    pub fn draw(self, field: &Field, x: i32, y: i32) -> f64 {
        match self {
            Self::Gaussian => field.normal(x, y),
            Self::Laplace => laplace(uniform(field, x, y)),
            Self::Uniform => uniform(field, x, y) * 12f64.sqrt(),
            Self::Student => student(uniform(field, x, y)),
        }
    }
}

/// Evenly between -1/2 and 1/2, both excluded.
fn uniform(field: &Field, x: i32, y: i32) -> f64 {
    let [high, low, ..] = field.words(x, y);
    let whole = (u64::from(high) << 20) ^ (u64::from(low) >> 12);
    (whole as f64 + 0.5) / 4_503_599_627_370_496.0 - 0.5
}

fn laplace(u: f64) -> f64 {
    -u.signum() * portable_math::log(1.0 - 2.0 * u.abs()) / 2f64.sqrt()
}

impl Interpolation {
    /// Weights of the nodes -1, 0, 1 and 2 at `t` between nodes 0 and 1.
    #[inline(always)]
    pub fn weights<T: Number>(self, t: T) -> [T; 4] {
        match self {
            Self::CatmullRom => keys(-0.5, t),
            Self::Cubic075 => keys(-0.75, t),
            Self::Cubic100 => keys(-1.0, t),
            Self::Bilinear => [t * 0.0, -t + 1.0, t, t * 0.0],
            Self::BSpline => b_spline(t),
        }
    }

    /// Mean over a cell of the variance along one direction, for nodes of unit variance.
    pub fn mean_variance(self) -> f64 {
        // Gauss-Legendre with four points is exact up to degree 7; the variance has degree 6.
        let points =
            [(0.339_981_043_584_856_3, 0.652_145_154_862_546_1), (0.861_136_311_594_052_6, 0.347_854_845_137_453_9)];
        let at = |x: f64| squares(&self.weights(0.5 + 0.5 * x));
        points.iter().map(|(x, weight)| 0.5 * weight * (at(*x) + at(-x))).sum()
    }
}

/// Keys' cubic convolution kernel (1981) for the nodes -1, 0, 1 and 2.
#[inline(always)]
fn keys<T: Number>(a: f64, t: T) -> [T; 4] {
    let near = |t: T| (t * (a + 2.0) - (a + 3.0)) * t * t + 1.0;
    let far = |t: T| ((t * a - 5.0 * a) * t + 8.0 * a) * t - 4.0 * a;
    [far(t + 1.0), near(t), near(-t + 1.0), far(-t + 2.0)]
}

#[inline(always)]
fn b_spline<T: Number>(t: T) -> [T; 4] {
    let end = |t: T| t * t * t / 6.0;
    let middle = |t: T| (t * 3.0 - 6.0) * t * t / 6.0 + 2.0 / 3.0;
    [end(-t + 1.0), middle(t), middle(-t + 1.0), end(t)]
}

#[inline(always)]
fn squares<T: Number>([a, b, c, d]: &[T; 4]) -> T {
    *a * *a + *b * *b + *c * *c + *d * *d
}

/// White noise addressed by pixel, standard deviation 1.
#[derive(Debug, Clone, Copy)]
pub struct LocalNoise {
    field: Field,
    distribution: Distribution,
}

impl LocalNoise {
    /// The noise of a stream.
    pub fn new(key: &Key, distribution: Distribution) -> Self {
        Self { field: key.field(), distribution }
    }

    /// The draw of a pixel.
    pub fn at(&self, column: i32, row: i32) -> f32 {
        self.distribution.draw(&self.field, column, row) as f32
    }

    /// The draws of several pixels; equal to calling [`LocalNoise::at`].
    #[inline(always)]
    pub fn at_lanes(&self, columns: [i32; LANES], rows: [i32; LANES]) -> Lanes {
        if self.distribution != Distribution::Gaussian {
            return Lanes::of(|lane| f64::from(self.at(columns[lane], rows[lane])));
        }
        let mut pairs = columns;
        pairs.iter_mut().for_each(|column| *column >>= 1);
        let [even, odd] = self.field.normals_lanes(pairs, rows);
        Lanes::of(|lane| f64::from(if columns[lane] & 1 == 0 { even[lane] } else { odd[lane] } as f32))
    }

    /// Access to single draws, fast along a row.
    pub fn lookup(&self) -> Lookup<'_> {
        Lookup { noise: self, cell: [0; 2], pair: self.field.normals(0, 0) }
    }

    /// The draws of a row from column `first` on; equal to calling [`LocalNoise::at`].
    pub fn fill_row(&self, first: i32, row: i32, values: &mut [f32]) {
        if self.distribution == Distribution::Gaussian {
            return self.field.fill_row(first, row, values);
        }
        for (column, value) in values.iter_mut().enumerate() {
            *value = self.at(first + column as i32, row);
        }
    }
}

/// Single draws of a noise. Two neighbours along a row come from one transform, which is kept for the second.
#[derive(Debug, Clone, Copy)]
pub struct Lookup<'a> {
    noise: &'a LocalNoise,
    cell: [i32; 2],
    pair: [f64; 2],
}

impl Lookup<'_> {
    /// The draw of a pixel; equal to [`LocalNoise::at`].
    #[inline]
    pub fn at(&mut self, column: i32, row: i32) -> f32 {
        if self.noise.distribution != Distribution::Gaussian {
            return self.noise.at(column, row);
        }
        let cell = [column >> 1, row];
        if cell != self.cell {
            (self.cell, self.pair) = (cell, self.noise.field.normals(cell[0], row));
        }
        self.pair[(column & 1) as usize] as f32
    }
}

/// How a smooth field is made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FieldRecipe {
    /// Distance of the nodes, pixels.
    pub spacing_px: f64,
    /// Distribution of the nodes.
    pub distribution: Distribution,
    /// How values between the nodes are interpolated.
    pub interpolation: Interpolation,
    /// What unit standard deviation refers to.
    pub variance: Variance,
}

/// Smooth noise over the plane: node (i, j) stands at (i, j) times the spacing, for any whole numbers.
#[derive(Debug, Clone)]
pub struct SmoothNoise {
    recipe: FieldRecipe,
    field: Field,
    mean_deviation: f64,
    /// First node and size (columns, rows) of the nodes in `nodes`.
    first: [i32; 2],
    size: [i32; 2],
    nodes: Vec<f64>,
}

impl SmoothNoise {
    /// The field of a stream; the nodes for positions within `low..high` pixels are drawn at once.
    pub fn new(key: &Key, recipe: FieldRecipe, low: [f64; 2], high: [f64; 2]) -> Self {
        let cell = |position: f64| (position / recipe.spacing_px).floor() as i32;
        let first = low.map(|p| cell(p) - 1);
        let size = [0, 1].map(|i| (cell(high[i]) + 3 - first[i]).max(0));
        let field = key.field();
        let draw = |x: i32, y: i32| recipe.distribution.draw(&field, x, y);
        let rows = first[1]..first[1] + size[1];
        let nodes = rows.flat_map(|y| (first[0]..first[0] + size[0]).map(move |x| (x, y))).map(|(x, y)| draw(x, y));
        let nodes = nodes.collect();
        Self { recipe, field, mean_deviation: recipe.interpolation.mean_variance(), first, size, nodes }
    }

    /// The field at a position, pixels.
    #[inline]
    pub fn at(&self, position_px: [f64; 2]) -> f64 {
        let [x, y] = position_px.map(|p| p / self.recipe.spacing_px);
        let (column, row) = (floor(x), floor(y));
        // Weights along both directions cost little more than along one.
        let t = Lanes::from([x - f64::from(column), y - f64::from(row)]);
        let weights = self.recipe.interpolation.weights(t);
        let along = |i: usize| [weights[0][i], weights[1][i], weights[2][i], weights[3][i]];
        let weights = [along(0), along(1)];
        self.of_variance(sum_of(weights, self.nodes_about(column, row)), weights)
    }

    /// The field at several positions, pixels; NaN at a position that is NaN.
    #[inline(always)]
    pub fn at_lanes(&self, position_px: [Lanes; 2]) -> Lanes {
        let [x, y] = both(position_px, |p| p / self.recipe.spacing_px);
        let [across, down] = both([x, y], |p| p.map(f64::floor));
        let kernel = self.recipe.interpolation;
        let weights = [kernel.weights(x - across), kernel.weights(y - down)];
        // Cell by cell, all of the positions in it together. 1 in lanes whose position is still to come.
        let mut open = (across + down).map(|sum| if sum.is_finite() { 1.0 } else { 0.0 });
        let mut sum = Lanes::NONE;
        while let Some(lane) = (0..LANES).find(|lane| open[*lane] > 0.0) {
            let cell = [across[lane], down[lane]];
            let within = (across - cell[0]).with(down - cell[1], |across, down| across.abs().max(down.abs()));
            let of_cell = sum_of(weights, self.nodes_about(cell[0] as i32, cell[1] as i32));
            sum = within.choose(|steps| steps < 0.5, of_cell, sum);
            open = within.choose(|steps| steps < 0.5, Lanes::all(0.0), open);
            if open.every(|open| open <= 0.0) {
                break;
            }
        }
        self.of_variance(sum, weights)
    }

    /// The sum of the nodes about a place, scaled to the variance that is asked for.
    #[inline(always)]
    fn of_variance<T: Number>(&self, sum: T, [wx, wy]: [[T; 4]; 2]) -> T {
        match self.recipe.variance {
            Variance::Nodes => sum,
            Variance::Mean => sum / self.mean_deviation,
            Variance::Pointwise => sum / (squares(&wx) * squares(&wy)).sqrt(),
        }
    }

    /// The four nodes in each of the four rows about a cell.
    #[inline(always)]
    fn nodes_about(&self, column: i32, row: i32) -> [[f64; 4]; 4] {
        [
            self.four_nodes(column - 1, row - 1),
            self.four_nodes(column - 1, row),
            self.four_nodes(column - 1, row + 1),
            self.four_nodes(column - 1, row + 2),
        ]
    }

    #[inline(always)]
    fn four_nodes(&self, column: i32, row: i32) -> [f64; 4] {
        let [x, y] = [column - self.first[0], row - self.first[1]];
        if x >= 0 && y >= 0 && x + 4 <= self.size[0] && y < self.size[1] {
            let start = y as usize * self.size[0] as usize + x as usize;
            let n = &self.nodes[start..start + 4];
            return [n[0], n[1], n[2], n[3]];
        }
        self.drawn_nodes(column, row)
    }

    /// Nodes outside of `nodes`.
    #[cold]
    fn drawn_nodes(&self, column: i32, row: i32) -> [f64; 4] {
        [0, 1, 2, 3].map(|i| self.recipe.distribution.draw(&self.field, column + i, row))
    }
}

/// The sum of the four nodes in each of the four rows about a place, by their weights along x and y.
#[inline(always)]
fn sum_of<T: Number + Mul<M, Output = T>, M: Copy>([wx, wy]: [[T; 4]; 2], nodes: [[M; 4]; 4]) -> T {
    let [first, second, third, last] = nodes;
    let sum = wy[0] * row_of(wx, first) + wy[1] * row_of(wx, second) + wy[2] * row_of(wx, third);
    sum + wy[3] * row_of(wx, last)
}

#[inline(always)]
fn row_of<T: Number + Mul<M, Output = T>, M: Copy>([a, b, c, d]: [T; 4], nodes: [M; 4]) -> T {
    a * nodes[0] + b * nodes[1] + c * nodes[2] + d * nodes[3]
}

#[cfg(test)]
mod tests {
    use super::*;

    const RECIPE: FieldRecipe = FieldRecipe {
        spacing_px: 8.0,
        distribution: Distribution::Gaussian,
        interpolation: Interpolation::CatmullRom,
        variance: Variance::Nodes,
    };
    const KERNELS: [Interpolation; 5] = [
        Interpolation::CatmullRom,
        Interpolation::Cubic075,
        Interpolation::Cubic100,
        Interpolation::Bilinear,
        Interpolation::BSpline,
    ];

    /// Mean square of a field over 120 x 120 cells, at one place of the cell or over it.
    fn variance(recipe: FieldRecipe, places: &[[f64; 2]]) -> f64 {
        let field = SmoothNoise::new(&Key([5; 32]), recipe, [0.0; 2], [960.0; 2]);
        let cells = (0..120).flat_map(|row| (0..120).map(move |column| [f64::from(column), f64::from(row)]));
        let values = cells.flat_map(|[c, r]| places.iter().map(move |[x, y]| [(c + x) * 8.0, (r + y) * 8.0]));
        let squares: Vec<f64> = values.map(|p| field.at(p) * field.at(p)).collect();
        squares.iter().sum::<f64>() / squares.len() as f64
    }

    fn whole_cell() -> Vec<[f64; 2]> {
        (0..25).map(|i| [0.1 + 0.2 * f64::from(i % 5), 0.1 + 0.2 * f64::from(i / 5)]).collect()
    }

    #[test]
    fn kernels_have_the_published_variances() {
        let centre = [0.640_625, 0.722_656, 0.8125, 0.5];
        let mean = [0.814_286, 0.857_143, 0.904_762, 0.666_667];
        for ((kernel, centre), mean) in KERNELS.into_iter().zip(centre).zip(mean) {
            assert!((squares(&kernel.weights(0.5)) - centre).abs() < 1e-6);
            assert!((kernel.mean_variance() - mean).abs() < 1e-6);
            assert!((kernel.weights(0.3).iter().sum::<f64>() - 1.0).abs() < 1e-15);
            assert!(kernel.weights(0.0).iter().zip([0.0, 1.0, 0.0, 0.0]).all(|(w, e)| (w - e).abs() < 1e-15));
        }
    }

    #[test]
    fn the_field_varies_as_its_kernel_says() {
        // One deviation of the mean square of n draws of unit variance is sqrt(2 / n): 1.2 % at 14,400 nodes.
        for (kernel, centre) in KERNELS.into_iter().zip([0.4104, 0.522_232, 0.660_156, 0.25, 0.211_664]) {
            let found = variance(FieldRecipe { interpolation: kernel, ..RECIPE }, &[[0.5, 0.5]]);
            assert!((found / centre - 1.0).abs() < 0.06, "{kernel:?}: {found} instead of {centre}");
        }
        let mean = variance(RECIPE, &whole_cell());
        assert!((mean / 0.663_061 - 1.0).abs() < 0.04, "mean {mean}");
    }

    #[test]
    fn the_mean_and_pointwise_fields_have_unit_variance() {
        let mean = variance(FieldRecipe { variance: Variance::Mean, ..RECIPE }, &whole_cell());
        assert!((mean - 1.0).abs() < 0.04, "{mean}");
        for place in [[0.0, 0.0], [0.5, 0.5], [0.3, 0.9]] {
            let found = variance(FieldRecipe { variance: Variance::Pointwise, ..RECIPE }, &[place]);
            assert!((found - 1.0).abs() < 0.06, "{place:?}: {found}");
        }
    }

    #[test]
    fn several_positions_have_the_bits_of_each() {
        for (variance, kernel) in [Variance::Nodes, Variance::Mean, Variance::Pointwise].into_iter().zip(KERNELS) {
            let recipe = FieldRecipe { variance, interpolation: kernel, ..RECIPE };
            let field = SmoothNoise::new(&Key([6; 32]), recipe, [-50.0, -30.0], [40.0, 60.0]);
            // All in one cell, over several cells, and outside of the nodes that `new` drew.
            for step in [0.5, 3.7, -20.0] {
                let x = Lanes::of(|lane| 16.2 + step * lane as f64);
                let y = Lanes::of(|lane| -5.4 + 0.1 * step * lane as f64);
                let found = field.at_lanes([x, y]);
                for lane in 0..LANES {
                    assert_eq!(
                        found[lane].to_bits(),
                        field.at([x[lane], y[lane]]).to_bits(),
                        "{kernel:?} {step} {lane}"
                    );
                }
            }
        }
    }

    #[test]
    fn nodes_drawn_ahead_change_nothing() {
        let key = Key([9; 32]);
        let ahead = SmoothNoise::new(&key, RECIPE, [-50.0, -30.0], [40.0, 60.0]);
        let none = SmoothNoise::new(&key, RECIPE, [0.0; 2], [0.0; 2]);
        for i in 0..500 {
            let position = [f64::from(i) * 0.37 - 70.0, 65.0 - f64::from(i) * 0.29];
            assert_eq!(ahead.at(position).to_bits(), none.at(position).to_bits());
        }
    }

    #[test]
    fn every_distribution_has_unit_deviation_and_its_own_tails() {
        let field = Key([3; 32]).field();
        for (distribution, kurtosis) in
            [(Distribution::Gaussian, 3.0), (Distribution::Laplace, 6.0), (Distribution::Uniform, 1.8)]
        {
            let draws: Vec<f64> = (0..200_000).map(|i| distribution.draw(&field, i % 500, i / 500)).collect();
            let moment = |order: i32| {
                let powers = draws.iter().map(|d| (0..order).fold(1.0, |p, _| p * d));
                powers.sum::<f64>() / draws.len() as f64
            };
            assert!(moment(1).abs() < 0.01 && (moment(2) - 1.0).abs() < 0.02, "{distribution:?}");
            assert!((moment(4) / kurtosis - 1.0).abs() < 0.08, "{distribution:?}: {}", moment(4));
        }
    }

    #[test]
    fn the_b_spline_smooths_as_published() {
        let kernel = Interpolation::BSpline;
        assert!((squares(&kernel.weights(0.5)) - 0.460_069).abs() < 1e-6);
        assert!((kernel.mean_variance() - 0.479_365).abs() < 1e-6);
        assert!(kernel.weights(0.0).iter().zip([1.0, 4.0, 1.0, 0.0]).all(|(w, e)| (6.0 * w - e).abs() < 1e-15));
    }

    #[test]
    fn the_local_field_is_white_and_its_rows_equal_its_cells() {
        for distribution in [Distribution::Gaussian, Distribution::Laplace] {
            let noise = LocalNoise::new(&Key([1; 32]), distribution);
            let mut rows = vec![[0.0f32; 300]; 300];
            rows.iter_mut().enumerate().for_each(|(y, row)| noise.fill_row(0, y as i32, row));
            assert_eq!(rows[7][123].to_bits(), noise.at(123, 7).to_bits());
            let (columns, lines) = ([0, 7, 6, -3, -4, 1, 250, 8], [0, 3, 3, 4, -1, 0, 299, 5]);
            let several = noise.at_lanes(columns, lines);
            for lane in 0..LANES {
                assert_eq!(several[lane].to_bits(), f64::from(noise.at(columns[lane], lines[lane])).to_bits());
            }
            let mut lookup = noise.lookup();
            for (column, row) in [(0, 0), (7, 3), (6, 3), (7, 4), (-3, 4), (-4, 4), (1, 0)] {
                assert_eq!(lookup.at(column, row).to_bits(), noise.at(column, row).to_bits());
            }
            let pairs = |f: &dyn Fn(usize, usize) -> f32| {
                let products = (0..299 * 299).map(|i| f64::from(f(i / 299, i % 299)));
                products.sum::<f64>() / (299.0 * 299.0)
            };
            assert!(pairs(&|y, x| rows[y][x] * rows[y][x + 1]).abs() < 0.015);
            assert!(pairs(&|y, x| rows[y][x] * rows[y + 1][x]).abs() < 0.015);
        }
    }
}
