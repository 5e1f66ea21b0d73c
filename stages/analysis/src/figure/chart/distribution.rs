//! Histograms and kernel densities of samples.

use super::layer::{Layer, Mark};
use crate::figure::colour_scale::round_step;
use rockface_core::numerics::{portable_math, quantile};

/// The most columns of a histogram.
const COLUMNS: f64 = 200.0;

/// Columns with round edges, as wide as Freedman and Diaconis (1981) say: twice the interquartile range over the cube root
/// of the count; heights are counts. No columns without finite values.
pub fn histogram(name: impl Into<String>, values: &[f64]) -> Layer {
    let sorted = sorted(values);
    let (Some(low), Some(high)) = (sorted.first(), sorted.last()) else {
        return Layer::new(name, Mark::Columns { edges: Vec::new(), heights: Vec::new() });
    };
    let spread = between_quartiles(&sorted);
    let advised = 2.0 * spread / portable_math::cbrt(sorted.len() as f64);
    let width = round_step(advised.max((high - low) / COLUMNS).max(1e-9 * high.abs()).max(f64::MIN_POSITIVE));
    let first = (low / width).floor();
    let count = ((high / width).floor() - first) as usize + 1;
    let edges: Vec<f64> = (0..=count).map(|edge| (first + edge as f64) * width).collect();
    let mut heights = vec![0.0; count];
    for value in &sorted {
        heights[(((value / width).floor() - first) as usize).min(count - 1)] += 1.0;
    }
    Layer::new(name, Mark::Columns { edges, heights })
}

/// The density of a sample by Gaussian kernels, as wide as Silverman (1986), eq. 3.31, says: 0.9 of the smaller of deviation
/// and interquartile range over 1.34, over the fifth root of the count. No line without two different values.
pub fn density(name: impl Into<String>, values: &[f64]) -> Layer {
    let sorted = sorted(values);
    let count = sorted.len() as f64;
    let mean = sorted.iter().sum::<f64>() / count;
    let deviation = (sorted.iter().map(|x| (x - mean) * (x - mean)).sum::<f64>() / (count - 1.0)).sqrt();
    let robust = between_quartiles(&sorted) / 1.34;
    let spread = if robust > 0.0 { deviation.min(robust) } else { deviation };
    let width = 0.9 * spread / portable_math::pow(count, 0.2);
    let (Some(low), Some(high)) = (sorted.first(), sorted.last()) else { return Layer::line(name, Vec::new()) };
    if width.is_nan() || width <= 0.0 {
        return Layer::line(name, Vec::new());
    }
    let (start, step) = (low - 3.0 * width, (high - low + 6.0 * width) / 199.0);
    let scale = 1.0 / (count * width * (2.0 * std::f64::consts::PI).sqrt());
    let height = |x: f64| {
        let kernel = |value: &f64| portable_math::exp(-0.5 * ((x - value) / width) * ((x - value) / width));
        scale * sorted.iter().map(kernel).sum::<f64>()
    };
    let at = |i: u16| start + step * f64::from(i);
    Layer::line(name, (0..200).map(|i| [at(i), height(at(i))]).collect())
}

fn sorted(values: &[f64]) -> Vec<f64> {
    let mut finite: Vec<f64> = values.iter().copied().filter(|value| value.is_finite()).collect();
    finite.sort_by(f64::total_cmp);
    finite
}

fn between_quartiles(sorted: &[f64]) -> f64 {
    let quartile = |share: f64| quantile::of_sorted(sorted, share).unwrap_or(0.0);
    quartile(0.75) - quartile(0.25)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_value_is_in_a_column() {
        let values: Vec<f64> = (0..1000).map(|i| f64::from(i % 97) * 0.31 - 7.0).collect();
        let Mark::Columns { edges, heights } = histogram("a", &values).mark else { panic!() };
        assert!((heights.iter().sum::<f64>() - 1000.0).abs() < 1e-9);
        assert!(edges[0] <= -7.0 && *edges.last().unwrap() >= 22.76 && edges.len() == heights.len() + 1);
        for sample in [vec![], vec![3.0], vec![f64::NAN], vec![1e300, -1e300], vec![0.0, 1e-300]] {
            let Mark::Columns { edges, heights } = histogram("a", &sample).mark else { panic!() };
            assert!(heights.len() < 300 && edges.iter().all(|edge| edge.is_finite()), "{sample:?}");
        }
    }

    #[test]
    fn a_density_has_the_area_one() {
        let values: Vec<f64> = (0..400).map(|i| 0.01 * f64::from(i)).collect();
        let Mark::Line(points) = density("a", &values).mark else { panic!() };
        let area: f64 = points.windows(2).map(|w| 0.5 * (w[0][1] + w[1][1]) * (w[1][0] - w[0][0])).sum();
        assert!((area - 1.0).abs() < 1e-2, "{area}");
        assert!(matches!(density("a", &[2.0, 2.0]).mark, Mark::Line(points) if points.is_empty()));
    }
}
