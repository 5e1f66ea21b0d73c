//! From numbers to colours: palettes, ranges that hold most of the values, round ticks and labels with units.

use super::canvas::Colour;
use rockface_core::numerics::portable_math;

/// Where there is no value.
pub const NO_DATA: Colour = [196, 196, 196];

/// A sequence of colours.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Palette {
    /// Perceptually uniform, dark blue to yellow.
    Viridis,
    /// The same for readers with a colour-vision deficiency.
    Cividis,
    /// Red for negative, white for zero, blue for positive values.
    RedBlue,
    /// Black for the smallest, white for the largest value.
    Grey,
    /// A colour for each of the numbers of [`CONFUSION`], which are no amounts.
    Confusion,
}

/// What the numbers of the quantity `confusion` mean, from 0 on, and their colours (Tol, bright).
pub const CONFUSION: [(&str, Colour); 4] =
    [("neither", [244, 244, 244]), ("found", [0, 119, 187]), ("false", [238, 119, 51]), ("missed", [204, 51, 17])];

/// Whether the values of a quantity are numbers of [`CONFUSION`].
pub fn is_confusion(quantity: &str) -> bool {
    quantity == "confusion"
}

/// The number of a class; NaN for what is beyond the classes.
pub fn class(value: f32) -> f32 {
    if value < CONFUSION.len() as f32 { value } else { f32::NAN }
}

/// A palette over a range of values.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ColourScale {
    /// The sequence of colours that is spread over the range.
    pub palette: Palette,
    /// Value of the first colour.
    pub low: f64,
    /// Value of the last colour.
    pub high: f64,
}

impl ColourScale {
    /// That of the classes of a confusion.
    pub const CLASSES: Self = Self { palette: Palette::Confusion, low: 0.0, high: CONFUSION.len() as f64 - 1.0 };

    /// The colour of a value; values outside the range take its ends.
    pub fn colour(&self, value: f64) -> Colour {
        if value.is_nan() {
            return NO_DATA;
        }
        let t = ((value - self.low) / (self.high - self.low)).clamp(0.0, 1.0);
        let gradient = match self.palette {
            Palette::Viridis => colorous::VIRIDIS,
            Palette::Cividis => colorous::CIVIDIS,
            Palette::RedBlue => colorous::RED_BLUE,
            Palette::Grey => return [(20.0 + 235.0 * t).round() as u8; 3],
            Palette::Confusion => {
                let (_, colour) = CONFUSION[(value.round().max(0.0) as usize).min(CONFUSION.len() - 1)];
                return colour;
            }
        };
        gradient.eval_continuous(t).as_array()
    }

    /// Round values within the range, about this many and at least three.
    pub fn ticks(&self, count: f64) -> Vec<f64> {
        let ends = |step: f64| ((self.low / step - 1e-9).ceil(), (self.high / step + 1e-9).floor());
        let mut step = round_step((self.high - self.low) / count);
        // A step of a third of the range always leaves three ticks; it is reached long before the last turn.
        for _ in 0..6 {
            let (first, last) = ends(step);
            if last - first >= 2.0 {
                break;
            }
            step = round_step(0.39 * step);
        }
        let (first, last) = ends(step);
        let number = (last - first) as usize;
        (0..=number.min(100)).map(|i| (first + i as f64) * step).collect()
    }
}

/// The 1, 2 or 5 times a power of ten that is nearest above a positive value.
pub fn round_step(value: f64) -> f64 {
    let decade = portable_math::pow(10.0, portable_math::log10(value).floor());
    let step = [1.0, 2.0, 5.0, 10.0].into_iter().find(|step| step * decade >= value * (1.0 - 1e-9));
    step.unwrap_or(10.0) * decade
}

/// Decimals that tell neighbouring ticks apart.
fn decimals(step: f64) -> usize {
    let mut decimals = 0;
    let mut scaled = step;
    while decimals < 9 && (scaled - scaled.round()).abs() > 1e-6 * scaled.abs() {
        scaled *= 10.0;
        decimals += 1;
    }
    decimals
}

/// Labels of ticks in a unit that is `per_metre` to the metre, with a true minus sign.
pub fn labels(ticks: &[f64], per_metre: f64) -> Vec<String> {
    let step = ticks.windows(2).map(|w| (w[1] - w[0]) * per_metre).next().unwrap_or(1.0);
    ticks.iter().map(|tick| rounded(tick * per_metre, step)).collect()
}

/// A value with the decimals of a step, with a true minus sign and no negative zero.
pub fn rounded(value: f64, step: f64) -> String {
    let text = format!("{value:.0$}", decimals(step));
    match text.strip_prefix('-') {
        Some(digits) if digits.chars().all(|c| matches!(c, '0' | '.')) => digits.to_owned(),
        Some(digits) => format!("\u{2212}{digits}"),
        None => text,
    }
}

/// A power of ten as people write it.
pub fn decade_label(power: i32) -> String {
    const DIGITS: [char; 10] = [
        '\u{2070}', '\u{b9}', '\u{b2}', '\u{b3}', '\u{2074}', '\u{2075}', '\u{2076}', '\u{2077}', '\u{2078}',
        '\u{2079}',
    ];
    match power {
        -2 => "0.01".to_owned(),
        -1 => "0.1".to_owned(),
        0 => "1".to_owned(),
        1 => "10".to_owned(),
        2 => "100".to_owned(),
        _ => {
            let digits = power.to_string();
            let raised = digits.chars().map(|c| c.to_digit(10).map_or('\u{207b}', |digit| DIGITS[digit as usize]));
            format!("10{}", raised.collect::<String>())
        }
    }
}

/// A length with the unit people would write: `50 cm`, `2 m`.
pub fn length(length_m: f64) -> String {
    let (value, unit) = match length_m {
        l if l < 0.01 => (l * 1e3, "mm"),
        l if l < 1.0 => (l * 1e2, "cm"),
        l if l < 1e3 => (l, "m"),
        l => (l / 1e3, "km"),
    };
    format!("{value:.0$} {unit}", decimals(value))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_labelled_in_the_unit() {
        let scale = ColourScale { palette: Palette::RedBlue, low: -0.034, high: 0.034 };
        let ticks = scale.ticks(6.0);
        assert_eq!(labels(&ticks, 1e3), ["\u{2212}20", "0", "20"]);
        let fine = ColourScale { palette: Palette::Viridis, low: 1.02, high: 1.31 };
        assert_eq!(labels(&fine.ticks(6.0), 1.0), ["1.05", "1.10", "1.15", "1.20", "1.25", "1.30"]);
    }

    #[test]
    fn a_bar_shows_at_least_three_ticks() {
        let scale = ColourScale { palette: Palette::RedBlue, low: -48.0, high: 48.0 };
        assert_eq!(labels(&scale.ticks(3.0), 1.0), ["\u{2212}40", "\u{2212}20", "0", "20", "40"]);
        for i in 1..400 {
            let low = -0.013 * f64::from(i);
            let scale = ColourScale { palette: Palette::Viridis, low, high: low + 0.37 * f64::from(i) };
            let ticks = scale.ticks(3.0);
            assert!((3..10).contains(&ticks.len()), "{scale:?}: {ticks:?}");
            assert!(ticks.iter().all(|t| *t >= low - 1e-6 && *t <= scale.high + 1e-6));
        }
    }

    #[test]
    fn lengths_read_as_people_write_them() {
        assert_eq!([0.005, 0.2, 2.0, 0.5, 20_000.0].map(length), ["5 mm", "20 cm", "2 m", "50 cm", "20 km"]);
    }

    #[test]
    fn powers_of_ten_have_names() {
        assert_eq!([-3, 0, 12].map(decade_label), ["10\u{207b}\u{b3}", "1", "10\u{b9}\u{b2}"]);
    }

    #[test]
    fn zero_is_white_and_nothing_is_grey() {
        let scale = ColourScale { palette: Palette::RedBlue, low: -1.0, high: 1.0 };
        assert!(scale.colour(0.0).iter().all(|c| *c > 235));
        let [red, _, blue] = scale.colour(-0.8);
        assert!(red > 120 && blue < 80);
        assert_eq!(scale.colour(f64::NAN), NO_DATA);
    }
}
