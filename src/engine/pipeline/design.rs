//! Designs of experiments: points of a sample axis, drawn from the pipeline's seed and the name of the axis alone.
//!
//! Every draw is addressed by axis, value and point, so that a random or Sobol design keeps its points when `count` is
//! raised and its other columns when a value is added. References: `McKay`, Beckman, Conover (1979) for the Latin
//! hypercube; Qian (2009) for nesting one in the next; Joe and Kuo (2008) for the direction numbers of Sobol's sequence.

use rockface_cache::SeedMaterial;
use serde_json::Value;

use super::sobol;

/// How points are spread.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Design {
    /// Every combination of equidistant levels.
    Grid,
    /// Independent uniform draws.
    Random,
    /// Every value has one point in each of `count` strata; doubling the count keeps the points.
    LatinHypercube,
    /// Sobol's sequence with a random digital shift.
    Sobol,
}

impl Design {
    /// The words for them.
    pub const NAMES: [&'static str; 4] = ["grid", "random", "latin-hypercube", "sobol"];

    /// The design of a word.
    pub fn named(word: &str) -> Option<Self> {
        let all = [Self::Grid, Self::Random, Self::LatinHypercube, Self::Sobol];
        Self::NAMES.iter().position(|name| *name == word).map(|index| all[index])
    }
}

/// How a value is spread between its ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scale {
    /// Every value between the ends is as likely.
    Linear,
    /// Evenly in the logarithm.
    Log,
    /// Whole numbers, both ends included, each as likely.
    Whole,
}

/// One value of a point and its range.
#[derive(Debug, Clone, PartialEq)]
pub struct Spread {
    /// The name behind the dot of `${axis.name}`.
    pub name: String,
    /// How it is spread.
    pub scale: Scale,
    /// The lower end of the range.
    pub lo: f64,
    /// The upper end of the range.
    pub hi: f64,
}

impl Spread {
    /// What is wrong with its range.
    pub fn fault(&self) -> Option<String> {
        let (lo, hi) = (self.lo, self.hi);
        match self.scale {
            _ if !(hi - lo).is_finite() => Some(format!("the range from {lo:e} to {hi:e} is wider than any number")),
            _ if lo >= hi => Some(format!("the range has to grow, from {lo} to {hi} it does not")),
            Scale::Log if lo <= 0.0 => Some(format!("a logarithm needs a range above zero, it begins at {lo}")),
            Scale::Whole if lo.fract() != 0.0 || hi.fract() != 0.0 || lo.abs().max(hi.abs()) > 9e15 => {
                Some(format!("{lo} and {hi} have to be whole numbers"))
            }
            _ => None,
        }
    }

    /// The value at a fraction of the range, 0 to 1.
    fn at(&self, fraction: f64) -> Value {
        match self.scale {
            _ if fraction >= 1.0 => self.number(self.hi),
            Scale::Linear => self.number(self.lo + (self.hi - self.lo) * fraction),
            Scale::Log => {
                let (low, high) = (libm::log(self.lo), libm::log(self.hi));
                self.number(libm::exp(low + (high - low) * fraction).clamp(self.lo, self.hi))
            }
            Scale::Whole => self.number((self.lo + ((self.hi - self.lo + 1.0) * fraction).floor()).min(self.hi)),
        }
    }

    /// A level of a grid without dust.
    fn tidy(&self, value: f64, count: u64) -> f64 {
        let parts = count.saturating_sub(1).max(1) as f64;
        let (apart, size) = match self.scale {
            Scale::Log => (value * libm::log(self.hi / self.lo) / parts, value),
            Scale::Linear | Scale::Whole => ((self.hi - self.lo) / parts, self.lo.abs().max(self.hi.abs())),
        };
        tidy(value, (self.lo, self.hi), apart, size)
    }

    fn number(&self, value: f64) -> Value {
        if self.scale == Scale::Whole { Value::from(value as i64) } else { Value::from(value + 0.0) }
    }
}

/// A point: its item name and one value a spread.
type Drawn = (String, Vec<Value>);

/// The points of a design, or why there are none. `counts` has one number, for a grid perhaps one a value.
pub fn points(design: Design, counts: &[u64], spreads: &[Spread], seed: u64, axis: &str) -> Result<Vec<Drawn>, String> {
    if spreads.is_empty() {
        return Err("`over` names no value: for example over: {a_m: [0.1, 2.0]}".to_owned());
    }
    if design == Design::Grid {
        return grid(&levels(counts, spreads)?, spreads);
    }
    let [count] = counts else {
        return Err("a list of counts is for a grid; this design takes one number".to_owned());
    };
    let count = *count as usize;
    let draw = Draw::new(seed, axis);
    let columns = spreads.iter().enumerate().map(|(index, spread)| {
        let fractions = match design {
            Design::LatinHypercube => latin(&draw, &spread.name, count),
            Design::Sobol => sobol::column(index, count, draw.bits(&spread.name, "shift", 0) as u32)?,
            Design::Random | Design::Grid => {
                (0..count).map(|i| draw.fraction(&spread.name, "point", i as u64)).collect()
            }
        };
        Ok(fractions.into_iter().map(|fraction| spread.at(fraction)).collect::<Vec<_>>())
    });
    let columns = columns.collect::<Result<Vec<_>, String>>()?;
    Ok((0..count).map(|i| (i.to_string(), columns.iter().map(|column| column[i].clone()).collect())).collect())
}

/// Levels of each value of a grid.
fn levels(counts: &[u64], spreads: &[Spread]) -> Result<Vec<u64>, String> {
    let dimensions = spreads.len() as u32;
    match counts {
        [total] => {
            let root = (1..=*total).find(|n| n.saturating_pow(dimensions) >= *total).unwrap_or(1);
            if root.saturating_pow(dimensions) == *total {
                return Ok(vec![root; spreads.len()]);
            }
            let (less, more) = ((root - 1).saturating_pow(dimensions), root.saturating_pow(dimensions));
            Err(format!(
                "a grid over {dimensions} values has {less} or {more} points, not {total}; or give the levels of each: \
                 count: [{}]",
                vec![root.to_string(); spreads.len()].join(", ")
            ))
        }
        each if each.len() == spreads.len() => Ok(each.to_vec()),
        each => {
            Err(format!("{} counts for {dimensions} values; a grid takes one for each, or one for all", each.len()))
        }
    }
}

/// Item names are the levels; a grid of 2n-1 levels contains that of n.
fn grid(levels: &[u64], spreads: &[Spread]) -> Result<Vec<Drawn>, String> {
    let total = levels.iter().fold(1_u64, |total, count| total.saturating_mul(*count));
    if total > 1_000_000 {
        return Err(format!("this grid has {total} points, an axis has at most 1000000"));
    }
    let narrow = spreads.iter().zip(levels).find(|(s, n)| s.scale == Scale::Whole && **n as f64 > s.hi - s.lo + 1.0);
    if let Some((spread, count)) = narrow {
        return Err(format!(
            "`{}` has fewer than {count} whole numbers from {} to {}",
            spread.name, spread.lo, spread.hi
        ));
    }
    let mut points: Vec<Drawn> = vec![(String::new(), Vec::new())];
    for (spread, count) in spreads.iter().zip(levels) {
        let extend = |(item, values): Drawn| {
            (0..*count).map(move |level| {
                let item = if item.is_empty() { level.to_string() } else { format!("{item}-{level}") };
                (item, values.iter().cloned().chain([level_value(spread, level, *count)]).collect())
            })
        };
        points = points.into_iter().flat_map(extend).collect();
    }
    Ok(points)
}

/// The ends are levels; a single level is the middle.
fn level_value(spread: &Spread, level: u64, count: u64) -> Value {
    let fraction = if count == 1 { 0.5 } else { level as f64 / (count - 1) as f64 };
    if spread.scale == Scale::Whole {
        return spread.number((spread.lo + (spread.hi - spread.lo) * fraction).round());
    }
    match spread.at(fraction).as_f64() {
        _ if level == 0 && count > 1 => spread.number(spread.lo),
        Some(value) if level + 1 < count || count == 1 => spread.number(spread.tidy(value, count)),
        _ => spread.number(spread.hi),
    }
}

/// A value between two ends without the dust of its computation: to 12 digits, if that leaves it between them. Levels that
/// are nearer to each other than 12 digits of numbers of this size can tell keep all they have.
pub fn tidy(value: f64, (lo, hi): (f64, f64), apart: f64, size: f64) -> f64 {
    if apart <= size * 1e-10 {
        return value;
    }
    let is_dust = lo.signum() != hi.signum() && value.abs() < lo.abs().max(hi.abs()) * 1e-14;
    let short = if is_dust { 0.0 } else { format!("{value:.11e}").parse().unwrap_or(value) };
    if (lo.min(hi)..=lo.max(hi)).contains(&short) { short } else { value }
}

/// Fractions of a Latin hypercube. The chain of counts begins at the odd part of `count` and doubles: each doubling
/// leaves the points where they are and puts as many new ones into the strata of half the width that are free.
fn latin(draw: &Draw, value: &str, count: usize) -> Vec<f64> {
    let first = count >> count.trailing_zeros();
    let mut fractions: Vec<f64> = Vec::with_capacity(count);
    let mut strata = first;
    while fractions.len() < count {
        let mut free = vec![true; strata];
        fractions.iter().for_each(|fraction| free[(fraction * strata as f64) as usize] = false);
        let mut free: Vec<usize> = (0..strata).filter(|stratum| free[*stratum]).collect();
        let purpose = format!("strata {first} {strata}");
        for last in (1..free.len()).rev() {
            free.swap(last, (draw.fraction(value, &purpose, last as u64) * (last + 1) as f64) as usize);
        }
        let purpose = format!("place {first} {strata}");
        let placed = free.iter().enumerate().map(|(index, stratum)| {
            // Kept off the borders of the strata that later doublings cut.
            let steps = (draw.fraction(value, &purpose, index as u64) * f64::from(1 << 20)).floor() + 0.5;
            (*stratum as f64 + steps / f64::from(1 << 20)) / strata as f64
        });
        fractions.extend(placed);
        strata *= 2;
    }
    fractions
}

/// Draws addressed by value, purpose and number.
struct Draw([u8; 32]);

impl Draw {
    fn new(seed: u64, axis: &str) -> Self {
        // No step is called like this: names have no spaces.
        let material = SeedMaterial { seed, stream: format!("axis {axis}"), items: std::collections::BTreeMap::new() };
        Self(material.key())
    }

    fn bits(&self, value: &str, purpose: &str, number: u64) -> u64 {
        let mut hasher = blake3::Hasher::new_keyed(&self.0);
        for text in [value, purpose] {
            hasher.update(&(text.len() as u64).to_le_bytes());
            hasher.update(text.as_bytes());
        }
        hasher.update(&number.to_le_bytes());
        let mut bytes = [0; 8];
        bytes.copy_from_slice(&hasher.finalize().as_bytes()[..8]);
        u64::from_le_bytes(bytes)
    }

    /// Uniform from 0 to 1, 1 excluded.
    fn fraction(&self, value: &str, purpose: &str, number: u64) -> f64 {
        (self.bits(value, purpose, number) >> 11) as f64 / (1_u64 << 53) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn unit(names: &[&str]) -> Vec<Spread> {
        let spread = |name: &&str| Spread { name: (*name).to_owned(), scale: Scale::Linear, lo: 0.0, hi: 1.0 };
        names.iter().map(spread).collect()
    }

    fn drawn(design: Design, count: u64, names: &[&str]) -> Vec<Vec<f64>> {
        let points = points(design, &[count], &unit(names), 7, "p").unwrap();
        points.into_iter().map(|(_, values)| values.iter().map(|v| v.as_f64().unwrap()).collect()).collect()
    }

    #[test]
    fn a_raised_count_keeps_what_was_drawn() {
        for design in [Design::Random, Design::Sobol] {
            assert_eq!(drawn(design, 37, &["a", "b"])[..11], drawn(design, 11, &["a", "b"])[..], "{design:?}");
        }
        assert_eq!(drawn(Design::LatinHypercube, 48, &["a"])[..12], drawn(Design::LatinHypercube, 12, &["a"])[..]);
    }

    #[test]
    fn another_value_leaves_the_first_ones_alone() {
        for design in [Design::Random, Design::Sobol, Design::LatinHypercube] {
            let (one, two) = (drawn(design, 8, &["a"]), drawn(design, 8, &["a", "b"]));
            let same = |(one, two): (&Vec<f64>, &Vec<f64>)| {
                one[0].to_bits() == two[0].to_bits() && two[0].to_bits() != two[1].to_bits()
            };
            assert!(one.iter().zip(&two).all(same), "{design:?}");
        }
    }

    #[test]
    fn sobol_fills_every_elementary_interval_of_a_net() {
        // A digital shift keeps the net: 16 points, one in each box of 1/16, 1/8 x 1/2, 1/4 x 1/4, ...
        let points = drawn(Design::Sobol, 16, &["a", "b"]);
        for (across, up) in [(16, 1), (8, 2), (4, 4), (2, 8), (1, 16)] {
            let mut boxes = vec![0; across * up];
            for point in &points {
                boxes[(point[0] * across as f64) as usize * up + (point[1] * up as f64) as usize] += 1;
            }
            assert!(boxes.iter().all(|count| *count == 1), "{across} x {up}: {boxes:?}");
        }
    }

    #[test]
    fn scales_reach_their_ends() {
        let spread = |scale, lo, hi| Spread { name: "a".into(), scale, lo, hi };
        let whole = points(Design::Random, &[400], &[spread(Scale::Whole, 1.0, 3.0)], 1, "p").unwrap();
        for wanted in 1..=3 {
            let share = whole.iter().filter(|(_, values)| values[0] == wanted).count();
            assert!((100..170).contains(&share), "{wanted}: {share}");
        }
        let log = points(Design::Grid, &[3], &[spread(Scale::Log, 0.01, 100.0)], 1, "p").unwrap();
        let log: Vec<f64> = log.iter().map(|(_, values)| values[0].as_f64().unwrap()).collect();
        assert!(
            (log[0] - 0.01).abs() < 1e-15 && (log[1] - 1.0).abs() < 1e-14 && (log[2] - 100.0).abs() < 1e-12,
            "{log:?}"
        );
    }

    #[test]
    fn levels_carry_no_dust_and_ranges_are_no_wider_than_numbers() {
        let spread = |scale, lo, hi| Spread { name: "a".into(), scale, lo, hi };
        let levels = |spread: Spread, count| -> Vec<f64> {
            let drawn = points(Design::Grid, &[count], &[spread], 1, "p").unwrap();
            drawn.iter().map(|(_, values)| values[0].as_f64().unwrap()).collect()
        };
        assert_eq!(levels(spread(Scale::Linear, 0.05, 0.2), 7), [0.05, 0.075, 0.1, 0.125, 0.15, 0.175, 0.2]);
        assert_eq!(levels(spread(Scale::Log, 0.01, 100.0), 5), [0.01, 0.1, 1.0, 10.0, 100.0]);
        assert_eq!(levels(spread(Scale::Linear, -0.1, 0.2), 4), [-0.1, 0.0, 0.1, 0.2]);
        let narrow = levels(spread(Scale::Linear, 1.0, 1.0 + 1e-12), 5);
        assert!(narrow.windows(2).all(|pair| pair[0] < pair[1]), "{narrow:?}");
        assert!(spread(Scale::Linear, -1e308, 1e308).fault().unwrap().contains("wider"));
        assert!(spread(Scale::Linear, 0.0, 1e308).fault().is_none());
    }

    #[test]
    fn a_grid_has_as_many_points_as_it_says() {
        let nine = points(Design::Grid, &[9], &unit(&["a", "b"]), 1, "p").unwrap();
        assert_eq!((nine.len(), nine[5].0.as_str()), (9, "1-2"));
        let finer = points(Design::Grid, &[5, 5], &unit(&["a", "b"]), 1, "p").unwrap();
        assert!(nine.iter().all(|(_, values)| finer.iter().any(|(_, other)| other == values)));
        let message = points(Design::Grid, &[10], &unit(&["a", "b"]), 1, "p").unwrap_err();
        assert!(message.contains("9 or 16"), "{message}");
    }

    #[test]
    fn a_latin_hypercube_has_one_point_a_stratum() {
        for (count, seed) in (1..60).chain([100, 192]).zip(0..) {
            let fractions = latin(&Draw::new(seed, "p"), "a", count);
            let mut strata: Vec<usize> = fractions.iter().map(|x| (x * count as f64) as usize).collect();
            strata.sort_unstable();
            assert_eq!(strata, (0..count).collect::<Vec<_>>());
        }
    }
}
