//! Numbers as a report shows them: short to read, exact behind.

use serde::Serialize;

/// Significant digits that are shown.
const DIGITS: usize = 5;
/// Decimals of large numbers and of coordinates.
const DECIMALS: usize = 3;
/// From here on numbers have so many decimals, ...
const LARGE: f64 = 1e5;
/// ... up to here, where a number holds no more of them.
const FIXED: f64 = 1e12;
/// Coordinates of less have more decimals with their five digits.
const METRES: f64 = 10.0;
/// Words by which names of columns tell coordinates.
const COORDINATES: [&str; 6] = ["x", "y", "z", "easting", "northing", "elevation"];
const SUPERSCRIPT: [char; 10] =
    ['\u{2070}', '\u{b9}', '\u{b2}', '\u{b3}', '\u{2074}', '\u{2075}', '\u{2076}', '\u{2077}', '\u{2078}', '\u{2079}'];

/// A text of a table or list; where it is a number, its exact digits stand behind the short ones.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Shown {
    /// What the page shows; a number is rounded.
    pub text: String,
    /// All digits, as they are in `run.json` or CSV; only for numbers.
    pub exact: Option<String>,
}

impl Shown {
    /// A text that may be a number.
    pub fn of(text: &str) -> Self {
        match text.parse::<f64>() {
            Ok(value) if value.is_finite() => Self { text: short(value), exact: Some(text.to_owned()) },
            _ => Self { text: text.to_owned(), exact: None },
        }
    }

    /// A value of JSON, numbers with the digits JSON has.
    pub fn of_json(value: &serde_json::Value) -> Self {
        match value {
            serde_json::Value::String(text) => Self { text: text.clone(), exact: None },
            serde_json::Value::Null => Self { text: "\u{2013}".to_owned(), exact: None },
            other => Self::of(&other.to_string()),
        }
    }
}

/// The cell of a column of a table: coordinates to the millimetre, as those of a map need more than five digits.
pub fn cell(column: &str, text: &str) -> Shown {
    match text.parse::<f64>() {
        Ok(value) if is_coordinate(column) && (METRES..FIXED).contains(&value.abs()) => {
            Shown { text: with_minus(&format!("{value:.DECIMALS$}")), exact: Some(text.to_owned()) }
        }
        _ => Shown::of(text),
    }
}

/// Whether a column holds coordinates in metres: `centroid_world_x_m`, `y_m`, `easting_m`.
fn is_coordinate(column: &str) -> bool {
    let mut words = column.split('_');
    words.next_back() == Some("m") && words.any(|word| COORDINATES.contains(&word))
}

/// A number with five significant digits at most, a true minus sign, and powers of ten where it is very large or small. Those from a hundred
/// thousand on have three decimals, as coordinates in metres need them; whole ones have all their digits.
pub fn short(value: f64) -> String {
    if value == 0.0 {
        return "0".to_owned();
    }
    let scientific = format!("{value:.*e}", DIGITS - 1);
    let (mantissa, power) = scientific.split_once('e').unwrap_or((&scientific, "0"));
    let power: i32 = power.parse().unwrap_or(0);
    let text = if value.fract() == 0.0 && value.abs() < 1e15 {
        format!("{value}")
    } else if (LARGE..FIXED).contains(&value.abs()) {
        format!("{value:.DECIMALS$}")
    } else if (-4..6).contains(&power) {
        let decimals = (DIGITS as i32 - 1 - power).max(0) as usize;
        trimmed(&format!("{value:.decimals$}")).to_owned()
    } else {
        let raised = power.to_string();
        let raised: String =
            raised.chars().map(|c| c.to_digit(10).map_or('\u{207b}', |d| SUPERSCRIPT[d as usize])).collect();
        format!("{}\u{b7}10{raised}", trimmed(mantissa))
    };
    with_minus(&text)
}

fn with_minus(text: &str) -> String {
    text.replace('-', "\u{2212}")
}

fn trimmed(text: &str) -> &str {
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { text }
}

/// Bytes as people say them.
pub fn bytes(count: u64) -> String {
    let (value, unit) = match count {
        0..1000 => return format!("{count} B"),
        1000..1_000_000 => (count as f64 / 1e3, "kB"),
        1_000_000..1_000_000_000 => (count as f64 / 1e6, "MB"),
        _ => (count as f64 / 1e9, "GB"),
    };
    if value < 10.0 { format!("{value:.1} {unit}") } else { format!("{value:.0} {unit}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_short_and_exact_behind() {
        let shown = [0.0, 3.0, -0.977_356_12, 12_345.678, 1.5e-7, 6.022e23, 1e-4, 2747.0].map(short);
        let expected = [
            "0",
            "3",
            "\u{2212}0.97736",
            "12346",
            "1.5\u{b7}10\u{207b}\u{2077}",
            "6.022\u{b7}10\u{b2}\u{b3}",
            "0.0001",
            "2747",
        ];
        assert_eq!(shown, expected);
        assert_eq!(
            [2_612_345.678_4, -123_456.5, 1.25e12].map(short),
            ["2612345.678", "\u{2212}123456.500", "1250000000000"]
        );
        assert_eq!(short(1_250_000_000_000.25), "1.25\u{b7}10\u{b9}\u{b2}");
        let cell = Shown::of("0.123456789012");
        assert_eq!((cell.text.as_str(), cell.exact.as_deref()), ("0.12346", Some("0.123456789012")));
        let shown = |column: &str, text: &str| super::cell(column, text).text;
        assert_eq!(shown("centroid_world_x_m", "2612345.67849"), "2612345.678");
        assert_eq!(shown("centroid_world_z_m", "1432.5"), "1432.500");
        assert_eq!(shown("y_m", "-20.00049"), "\u{2212}20.000");
        assert_eq!(shown("x_m", "0.0123456"), "0.012346");
        assert_eq!((shown("volume_m3", "1432.50012"), shown("x_m", "left")), ("1432.5".into(), "left".into()));
        assert_eq!(Shown::of("left").exact, None);
        assert_eq!(Shown::of("NaN").exact, None);
        assert_eq!([999, 1500, 12_345_678].map(bytes), ["999 B", "1.5 kB", "12 MB"]);
    }
}
