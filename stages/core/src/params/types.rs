//! The types that parameters have: numbers, text, files, lists, maps and what may be left out.

use std::collections::BTreeMap;

use serde_json::Value;

use super::{Fault, FileRef, FilesRef, GeoFileRef, Kind, ParamType, Range, wrong};

impl ParamType for f64 {
    fn kind() -> Kind {
        Kind::Number
    }
    fn decode(value: &Value) -> Result<Self, Vec<Fault>> {
        value.as_f64().filter(|x| x.is_finite()).ok_or_else(|| wrong("a number", value))
    }
    fn encode(&self) -> Value {
        // -0.0 and 0.0 are one value and must have one text.
        Value::from(*self + 0.0)
    }
}

macro_rules! whole {
    ($($ty:ty),*) => {$(
        impl ParamType for $ty {
            fn kind() -> Kind {
                Kind::Integer
            }
            fn decode(value: &Value) -> Result<Self, Vec<Fault>> {
                let whole = value.as_f64().filter(|x| x.fract() == 0.0 && x.abs() <= 9e15).map(|x| x as i64);
                whole
                    .and_then(|x| Self::try_from(x).ok())
                    .ok_or_else(|| wrong(concat!("a whole number (", stringify!($ty), ")"), value))
            }
            fn encode(&self) -> Value {
                Value::from(*self)
            }
        }
    )*};
}
whole!(u32, u64, i64, usize);

impl ParamType for bool {
    fn kind() -> Kind {
        Kind::Boolean
    }
    fn decode(value: &Value) -> Result<Self, Vec<Fault>> {
        value.as_bool().ok_or_else(|| wrong("true or false", value))
    }
    fn encode(&self) -> Value {
        Value::from(*self)
    }
}

macro_rules! textual {
    ($ty:ty, $kind:expr, $expected:literal, $make:expr, $text:expr) => {
        impl ParamType for $ty {
            fn kind() -> Kind {
                $kind
            }
            fn decode(value: &Value) -> Result<Self, Vec<Fault>> {
                value.as_str().map($make).ok_or_else(|| wrong($expected, value))
            }
            fn encode(&self) -> Value {
                let text: fn(&Self) -> &String = $text;
                Value::from(text(self).clone())
            }
        }
    };
}
textual!(FileRef, Kind::File, "the path of a file", |x| FileRef(x.to_owned()), |x| &x.0);
textual!(GeoFileRef, Kind::GeoFile, "the path of a file", |x| GeoFileRef(x.to_owned()), |x| &x.0);
textual!(FilesRef, Kind::Files, "the path of a folder or a pattern", |x| FilesRef(x.to_owned()), |x| &x.0);

/// A number is text too where text is asked for: names such as `7` need no quotes.
impl ParamType for String {
    fn kind() -> Kind {
        Kind::Text
    }
    fn decode(value: &Value) -> Result<Self, Vec<Fault>> {
        match value {
            Value::String(text) => Ok(text.clone()),
            Value::Number(number) => Ok(number.to_string()),
            other => Err(wrong("text", other)),
        }
    }
    fn encode(&self) -> Value {
        Value::from(self.clone())
    }
}

impl<T: ParamType> ParamType for Option<T> {
    fn kind() -> Kind {
        Kind::Optional(Box::new(T::kind()))
    }
    fn decode(value: &Value) -> Result<Self, Vec<Fault>> {
        if value.is_null() { Ok(None) } else { T::decode(value).map(Some) }
    }
    fn encode(&self) -> Value {
        self.as_ref().map_or(Value::Null, ParamType::encode)
    }
    fn outside(&self, range: Range) -> Vec<Fault> {
        self.as_ref().map_or_else(Vec::new, |value| value.outside(range))
    }
}

impl<T: ParamType> ParamType for Vec<T> {
    fn kind() -> Kind {
        Kind::List(Box::new(T::kind()), None)
    }
    fn decode(value: &Value) -> Result<Self, Vec<Fault>> {
        let list = value.as_array().ok_or_else(|| wrong("a list", value))?;
        let mut faults = Vec::new();
        let mut items = Vec::with_capacity(list.len());
        for (index, item) in list.iter().enumerate() {
            match T::decode(item) {
                Ok(item) => items.push(item),
                Err(found) => faults.extend(found.into_iter().map(|f| f.below(&index.to_string()))),
            }
        }
        if faults.is_empty() { Ok(items) } else { Err(faults) }
    }
    fn encode(&self) -> Value {
        self.iter().map(ParamType::encode).collect()
    }
}

impl<T: ParamType> ParamType for BTreeMap<String, T> {
    fn kind() -> Kind {
        Kind::Entries(Box::new(T::kind()))
    }
    fn decode(value: &Value) -> Result<Self, Vec<Fault>> {
        let map = value.as_object().ok_or_else(|| wrong("a map", value))?;
        let mut faults = Vec::new();
        let mut entries = Self::new();
        for (key, item) in map {
            match T::decode(item) {
                Ok(item) => drop(entries.insert(key.clone(), item)),
                Err(found) => faults.extend(found.into_iter().map(|fault| fault.below(key))),
            }
        }
        if faults.is_empty() { Ok(entries) } else { Err(faults) }
    }
    fn encode(&self) -> Value {
        Value::Object(self.iter().map(|(key, item)| (key.clone(), item.encode())).collect())
    }
}

/// The whole number that a number with a decimal point or an exponent is, up to where every whole number has one.
fn whole_number(number: &serde_json::Number) -> Option<i64> {
    let value = number.as_f64().filter(|x| number.is_f64() && x.fract() == 0.0 && x.abs() < 9e15)?;
    Some(value as i64)
}

/// Any value. A number is one however it is written: `1.0` and `1e0` become `1`.
impl ParamType for Value {
    fn kind() -> Kind {
        Kind::Any
    }
    fn decode(value: &Value) -> Result<Self, Vec<Fault>> {
        Ok(match value {
            Value::Number(number) => whole_number(number).map_or_else(|| value.clone(), Value::from),
            Value::Array(_) => Value::Array(Vec::decode(value)?),
            Value::Object(_) => BTreeMap::<String, Value>::decode(value)?.encode(),
            other => other.clone(),
        })
    }
    fn encode(&self) -> Value {
        self.clone()
    }
}

impl<T: ParamType, const N: usize> ParamType for [T; N] {
    fn kind() -> Kind {
        Kind::List(Box::new(T::kind()), Some(N))
    }
    fn decode(value: &Value) -> Result<Self, Vec<Fault>> {
        let items = Vec::<T>::decode(value)?;
        let found = items.len();
        items.try_into().map_err(|_| vec![Fault::new(format!("expected a list of {N}, found one of {found}"))])
    }
    fn encode(&self) -> Value {
        self.iter().map(ParamType::encode).collect()
    }
}
