//! A number that is either fixed or drawn from a distribution.

use serde_json::Value;

use crate::params::{Fault, FileRef, Kind, ParamType, Range};
use crate::{params, union};

params! {
    /// Always the same value.
    pub struct Constant {
        /// The value.
        value: f64,
    }
}

params! {
    /// Every value between two is equally likely.
    pub struct Uniform {
        /// Smallest value.
        min: f64,
        /// Largest value.
        max: f64,
    }
}

params! {
    /// A normal distribution.
    pub struct Normal {
        /// Mean.
        mean: f64,
        /// Standard deviation.
        sd: f64; Range::NonNegative,
    }
}

params! {
    /// A normal distribution of which only the part between two values is kept.
    pub struct TruncatedNormal {
        /// Mean before truncation.
        mean: f64,
        /// Standard deviation before truncation.
        sd: f64; Range::Positive,
        /// Smallest value; null: none.
        min: Option<f64> = None,
        /// Largest value; null: none.
        max: Option<f64> = None,
    }
}

params! {
    /// A distribution whose logarithm is normal.
    pub struct LogNormal {
        /// Median before truncation.
        median: f64; Range::Positive,
        /// Standard deviation of the natural logarithm.
        sigma: f64; Range::Positive,
        /// Smallest value; null: none.
        min: Option<f64> = None; Range::Positive,
        /// Largest value; null: none.
        max: Option<f64> = None; Range::Positive,
    }
}

params! {
    /// Density falling exponentially from `min` upwards.
    pub struct Exponential {
        /// Mean distance above `min` before truncation.
        mean: f64; Range::Positive,
        /// Smallest value.
        min: f64 = 0.0,
        /// Largest value; null: none.
        max: Option<f64> = None,
    }
}

params! {
    /// A beta distribution stretched to an interval.
    pub struct Beta {
        /// First shape parameter.
        a: f64; Range::Between(0.01, 1e4),
        /// Second shape parameter.
        b: f64; Range::Between(0.01, 1e4),
        /// Smallest value.
        min: f64 = 0.0,
        /// Largest value.
        max: f64 = 1.0,
    }
}

params! {
    /// A bounded Pareto distribution: the number of values of at least x falls like `x^-exponent`.
    pub struct PowerLaw {
        /// Exponent of the cumulative number, such as that of a magnitude-frequency relation of volumes.
        exponent: f64; Range::Positive,
        /// Smallest value.
        min: f64; Range::Positive,
        /// Largest value.
        max: f64; Range::Positive,
    }
}

params! {
    /// One of a few values.
    pub struct Discrete {
        /// The values.
        values: Vec<f64>,
        /// How likely each is, relative to the others; null: all the same.
        weights: Option<Vec<f64>> = None; Range::NonNegative,
    }
}

params! {
    /// A density of one's own: a table, linear between its points and zero outside; scaled to unit area.
    pub struct Density {
        /// Values, increasing.
        x: Vec<f64>,
        /// Density at each, up to a factor.
        p: Vec<f64>; Range::NonNegative,
    }
}

params! {
    /// An empirical distribution.
    pub struct Samples {
        /// Observed values.
        values: Vec<f64>,
        /// Also draw values between neighbouring observations (quantiles of type 7), not only the observations.
        smooth: bool = false,
    }
}

params! {
    /// An empirical distribution from a column of a CSV file with a header line.
    pub struct SampleFile {
        /// The file.
        path: FileRef,
        /// Name of the column.
        column: String,
        /// Also draw values between neighbouring observations (quantiles of type 7), not only the observations.
        smooth: bool = false,
    }
}

union! {
    /// The distributions a number can be drawn from.
    pub enum Distribution {
        /// Always the same value.
        Constant(Constant) = "constant",
        /// Every value between two is equally likely.
        Uniform(Uniform) = "uniform",
        /// Normal (Gaussian), unbounded.
        Normal(Normal) = "normal",
        /// Normal, only the part between two values.
        TruncatedNormal(TruncatedNormal) = "truncated_normal",
        /// Log-normal, optionally truncated.
        LogNormal(LogNormal) = "log_normal",
        /// Exponential, optionally truncated.
        Exponential(Exponential) = "exponential",
        /// Beta, stretched to an interval.
        Beta(Beta) = "beta",
        /// Bounded Pareto, as sizes of rockfalls follow.
        PowerLaw(PowerLaw) = "power_law",
        /// One of a few values with weights.
        Discrete(Discrete) = "discrete",
        /// A density given as a table.
        Density(Density) = "density",
        /// Observed values given here.
        Samples(Samples) = "samples",
        /// Observed values of a file.
        File(SampleFile) = "file",
    }
}

impl Distribution {
    /// The smallest and the largest value it can give; a file's are known once it is read.
    pub fn support(&self) -> (f64, f64) {
        let or = |bound: Option<f64>, none: f64| bound.unwrap_or(none);
        let extent = |values: &[f64]| {
            values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(*x), high.max(*x)))
        };
        match self {
            Self::Constant(d) => (d.value, d.value),
            Self::Uniform(d) => (d.min, d.max),
            Self::Normal(d) if d.sd > 0.0 => (f64::NEG_INFINITY, f64::INFINITY),
            Self::Normal(d) => (d.mean, d.mean),
            Self::TruncatedNormal(d) => (or(d.min, f64::NEG_INFINITY), or(d.max, f64::INFINITY)),
            // Zero itself is never drawn.
            Self::LogNormal(d) => (or(d.min, f64::MIN_POSITIVE), or(d.max, f64::INFINITY)),
            Self::Exponential(d) => (if d.min == 0.0 { f64::MIN_POSITIVE } else { d.min }, or(d.max, f64::INFINITY)),
            Self::Beta(d) => (if d.min == 0.0 { f64::MIN_POSITIVE } else { d.min }, d.max),
            Self::PowerLaw(d) => (d.min, d.max),
            Self::Discrete(d) => extent(&d.values),
            Self::Density(d) => extent(&d.x),
            Self::Samples(d) => extent(&d.values),
            Self::File(_) => (f64::NAN, f64::NAN),
        }
    }

    /// What keeps its values within a range.
    fn way_within(&self) -> &'static str {
        match self {
            Self::Normal(_) => "bound it: `truncated_normal` takes `min` and `max` beside `mean` and `sd`",
            Self::Constant(_) => "give another `value`",
            Self::Discrete(_) | Self::Samples(_) => "leave out the `values` beyond it",
            Self::Density(_) => "leave out the values of `x` beyond it",
            _ => "bound it with `min` and `max`",
        }
    }

    /// What its own numbers contradict, each at its parameter.
    fn faults(&self) -> Vec<Fault> {
        let ordered = |key: &str, low: f64, high: f64| {
            let fault =
                || Fault::new(format!("`max` ({high}) must be greater than `min` ({low})")).below("max").below(key);
            if low < high { Vec::new() } else { vec![fault()] }
        };
        let (low, high) = self.support();
        match self {
            Self::Uniform(_) => ordered("uniform", low, high),
            Self::TruncatedNormal(_) => ordered("truncated_normal", low, high),
            Self::LogNormal(_) => ordered("log_normal", low, high),
            Self::Exponential(_) => ordered("exponential", low, high),
            Self::Beta(_) => ordered("beta", low, high),
            Self::PowerLaw(_) => ordered("power_law", low, high),
            Self::Discrete(d) => discrete_faults(d),
            Self::Density(d) => density_faults(d),
            Self::Samples(d) if d.values.is_empty() => {
                vec![Fault::new("no value is given").below("values").below("samples")]
            }
            _ => Vec::new(),
        }
    }
}

fn discrete_faults(discrete: &Discrete) -> Vec<Fault> {
    let fault = |key: &str, text: String| vec![Fault::new(text).below(key).below("discrete")];
    let count = discrete.values.len();
    match &discrete.weights {
        _ if count == 0 => fault("values", "no value is given".into()),
        Some(weights) if weights.len() != count => {
            fault("weights", format!("{count} values need as many weights, found {}", weights.len()))
        }
        Some(weights) if weights.iter().all(|w| *w == 0.0) => fault("weights", "every weight is zero".into()),
        _ => Vec::new(),
    }
}

fn density_faults(density: &Density) -> Vec<Fault> {
    let fault = |key: &str, text: String| vec![Fault::new(text).below(key).below("density")];
    let (x, p) = (&density.x, &density.p);
    if x.len() < 2 {
        return fault("x", format!("a density needs two points or more, found {}", x.len()));
    }
    if p.len() != x.len() {
        return fault("p", format!("{} values of x need as many of p, found {}", x.len(), p.len()));
    }
    let falls = |pair: &[f64]| if let [a, b] = pair { (a >= b).then_some((*a, *b)) } else { None };
    if let Some((before, after)) = x.windows(2).find_map(falls) {
        return fault("x", format!("must increase: {after} comes after {before}"));
    }
    if p.iter().all(|p| *p == 0.0) {
        return fault("p", "the density is zero everywhere".into());
    }
    Vec::new()
}

/// A number of a candidate: the same for all, or drawn for each.
#[derive(Debug, Clone, PartialEq)]
pub enum Quantity {
    /// The same for all.
    Fixed(f64),
    /// Drawn for each candidate from this distribution.
    Drawn(Distribution),
}

impl Quantity {
    /// The smallest and the largest value it can have; NaN while they are in an unread file.
    pub fn support(&self) -> (f64, f64) {
        match self {
            Self::Fixed(value) => (*value, *value),
            Self::Drawn(distribution) => distribution.support(),
        }
    }
}

impl From<f64> for Quantity {
    fn from(value: f64) -> Self {
        Self::Fixed(value)
    }
}

impl ParamType for Quantity {
    fn kind() -> Kind {
        Kind::NumberOr(Box::new(Distribution::kind()))
    }
    fn decode(value: &Value) -> Result<Self, Vec<Fault>> {
        if value.is_number() {
            return f64::decode(value).map(Self::Fixed);
        }
        if !value.is_object() {
            return Err(vec![Fault::new(format!("expected a number or a distribution, found {value}"))]);
        }
        let bounds = bounds_of_normal(value);
        if !bounds.is_empty() {
            return Err(bounds);
        }
        let distribution = Distribution::decode(value)?;
        let faults = distribution.faults();
        if faults.is_empty() { Ok(Self::Drawn(distribution)) } else { Err(faults) }
    }
    fn encode(&self) -> Value {
        match self {
            Self::Fixed(value) => value.encode(),
            Self::Drawn(distribution) => distribution.encode(),
        }
    }
    fn outside(&self, range: Range) -> Vec<Fault> {
        let Self::Drawn(distribution) = self else { return Vec::new() };
        let (low, high) = distribution.support();
        let out = |x: f64| !x.is_nan() && !range.holds(x);
        if !out(low) && !out(high) {
            return Vec::new();
        }
        vec![Fault::new(format!(
            "can draw values from {low} to {high}, but must be {range}; {}",
            distribution.way_within()
        ))]
    }
}

/// Bounds that are given to `normal`, which has none.
fn bounds_of_normal(value: &Value) -> Vec<Fault> {
    let given =
        ["min", "max"].into_iter().filter(|key| value.get("normal").is_some_and(|normal| normal.get(key).is_some()));
    let fault = |key| {
        Fault::new("`normal` has no bounds: `truncated_normal` is the one with `min` and `max`")
            .below(key)
            .below("normal")
    };
    given.map(fault).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    params! {
        /// A bar.
        pub struct Bar {
            /// Its length.
            length_m: Quantity = Quantity::Fixed(1.0); Range::Positive,
            /// Its width.
            width_m: Option<Quantity> = None; Range::Between(0.0, 2.0),
        }
    }

    #[test]
    fn a_number_or_a_distribution_stands_in_one_place() {
        let bar = Bar::decode(&json!({"length_m": 2, "width_m": {"uniform": {"min": 0, "max": 1}}})).unwrap();
        assert_eq!(bar.length_m, Quantity::Fixed(2.0));
        assert_eq!(bar.encode(), json!({"length_m": 2.0, "width_m": {"uniform": {"min": 0.0, "max": 1.0}}}));
        assert_eq!(Bar::decode(&bar.encode()).unwrap(), bar);
    }

    #[test]
    fn a_normal_distribution_is_bounded_by_truncating_it() {
        let faults = |value: Value| Bar::decode(&json!({"length_m": value})).unwrap_err();
        let found = faults(json!({"normal": {"mean": 5, "sd": 0.1}}));
        assert!(found[0].message.contains("must be > 0; bound it: `truncated_normal` takes"), "{found:?}");
        let found = faults(json!({"normal": {"mean": 5, "sd": 0.1, "min": 4, "max": 6}}));
        let places: Vec<String> = found.iter().map(|fault| fault.path.join(".")).collect();
        assert_eq!(places, ["length_m.normal.min", "length_m.normal.max"]);
        assert!(found[0].message.contains("`truncated_normal`"), "{found:?}");
        let found = faults(json!({"uniform": {"min": -1, "max": 1}}));
        assert!(found[0].message.ends_with("bound it with `min` and `max`"), "{found:?}");
        let found = faults(json!({"samples": {"values": [-1, 1]}}));
        assert!(found[0].message.ends_with("leave out the `values` beyond it"), "{found:?}");
        assert!(Bar::decode(&json!({"length_m": {"truncated_normal": {"mean": 5, "sd": 0.1, "min": 4}}})).is_ok());
    }

    #[test]
    fn what_can_leave_the_range_is_refused_at_its_place() {
        let fault = |value: Value| Bar::decode(&value).unwrap_err().remove(0);
        let place = |value: Value| fault(value).path.join(".");
        assert_eq!(place(json!({"length_m": -1})), "length_m");
        assert_eq!(place(json!({"length_m": {"normal": {"mean": 5, "sd": 0.1}}})), "length_m");
        assert_eq!(place(json!({"width_m": {"uniform": {"min": 1, "max": 3}}})), "width_m");
        assert_eq!(place(json!({"length_m": {"uniform": {"min": 3, "max": 1}}})), "length_m.uniform.max");
        assert_eq!(place(json!({"length_m": {"density": {"x": [1, 1], "p": [1, 1]}}})), "length_m.density.x");
        assert_eq!(
            place(json!({"length_m": {"discrete": {"values": [1], "weights": [1, 2]}}})),
            "length_m.discrete.weights"
        );
        assert_eq!(
            place(json!({"length_m": {"log_normal": {"median": -1, "sigma": 1}}})),
            "length_m.log_normal.median"
        );
        assert_eq!(place(json!({"length_m": {"lognormal": {}}})), "length_m.lognormal");
        assert!(Bar::decode(&json!({"length_m": {"log_normal": {"median": 1, "sigma": 1}}})).is_ok());
        assert!(Bar::decode(&json!({"length_m": {"file": {"path": "a.csv", "column": "l"}}})).is_ok());
    }
}
