//! A number in JSON that need not be finite; `null`, which stood for any such number in former logs, is read as NaN.

use serde::de::Error;
use serde::{Deserialize, Deserializer, Serializer};

#[derive(Deserialize)]
#[serde(untagged)]
enum Written {
    Number(f64),
    Word(String),
    Nothing(()),
}

/// Writes a finite number as a number, and others as the strings `NaN`, `inf` and `-inf`.
#[allow(clippy::trivially_copy_pass_by_ref)] // as serde calls it
pub fn serialize<S: Serializer>(value: &f64, serializer: S) -> Result<S::Ok, S::Error> {
    if value.is_finite() { serializer.serialize_f64(*value) } else { serializer.collect_str(value) }
}

/// Reads what [`serialize`] writes; `null` is NaN.
pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    match Written::deserialize(deserializer)? {
        Written::Number(value) => Ok(value),
        Written::Word(word) => word
            .parse()
            .ok()
            .filter(|value: &f64| !value.is_finite())
            .ok_or_else(|| D::Error::custom(format!("`{word}` is no number"))),
        Written::Nothing(()) => Ok(f64::NAN),
    }
}

#[cfg(test)]
mod tests {
    use crate::Entry;

    #[test]
    fn numbers_that_are_not_finite_come_back_from_a_log() {
        for (value, written) in
            [(0.1, "0.1"), (f64::NAN, "\"NaN\""), (f64::INFINITY, "\"inf\""), (f64::NEG_INFINITY, "\"-inf\"")]
        {
            let metric = Entry::Metric { name: "a".into(), value, unit: "m".into() };
            let text = serde_json::to_string(&metric).unwrap();
            assert_eq!(text, format!(r#"{{"type":"metric","name":"a","value":{written},"unit":"m"}}"#));
            let Entry::Metric { value: read, .. } = serde_json::from_str(&text).unwrap() else { panic!("{text}") };
            assert_eq!(read.to_bits(), value.to_bits());
        }
    }

    #[test]
    fn a_former_log_has_null_for_them() {
        let text = r#"{"type":"metric","name":"a","value":null,"unit":"m"}"#;
        let Entry::Metric { value, .. } = serde_json::from_str(text).unwrap() else { panic!("{text}") };
        assert!(value.is_nan());
        assert!(serde_json::from_str::<Entry>(&text.replace("null", "\"many\"")).is_err());
    }
}
