//! Typed parameters: one declaration ([`crate::params!`]) gives the struct, its defaults, its checks and its documentation.

use std::collections::BTreeMap;

use serde_json::{Map, Value};

/// The shape of a parameter, as the catalogue prints it.
#[derive(Debug, Clone, PartialEq)]
pub enum Kind {
    /// A finite number.
    Number,
    /// A whole number.
    Integer,
    /// `true` or `false`.
    Boolean,
    /// Text.
    Text,
    /// One of a few words, each with what it means.
    Choice(&'static [(&'static str, &'static str)]),
    /// The path of one file, which the engine opens and hashes.
    File,
    /// The same for a file that may have a `.prj` of its name beside it, which is opened and hashed too.
    GeoFile,
    /// A folder, a file or a pattern such as `dir/*.tif`: any number of files.
    Files,
    /// A list of one kind; `Some(n)` fixes its length.
    List(Box<Kind>, Option<usize>),
    /// `null`, or the kind inside.
    Optional(Box<Kind>),
    /// Named parameters.
    Map(Vec<Field>),
    /// A map of any keys to one kind.
    Entries(Box<Kind>),
    /// Any value.
    Any,
    /// A map with exactly one of these keys, which says what its value is: `{prism: {...}}`. The bare word is enough where
    /// everything below the key has a default.
    Union(Vec<Field>),
    /// A number, or the kind inside: a distribution to draw it from.
    NumberOr(Box<Kind>),
}

impl std::fmt::Display for Kind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Number => write!(f, "number"),
            Self::Integer => write!(f, "whole number"),
            Self::Boolean => write!(f, "true or false"),
            Self::Text => write!(f, "text"),
            Self::Choice(words) => {
                let words: Vec<_> = words.iter().map(|(word, _)| *word).collect();
                write!(f, "{}", words.join(" | "))
            }
            Self::File | Self::GeoFile => write!(f, "file"),
            Self::Files => write!(f, "files"),
            Self::List(kind, Some(length)) => write!(f, "list of {length} ({kind})"),
            Self::List(kind, None) => write!(f, "list ({kind})"),
            Self::Optional(kind) => write!(f, "{kind}, or null"),
            Self::Map(_) => write!(f, "map"),
            Self::Entries(kind) => write!(f, "map of names to {kind}"),
            Self::Any => write!(f, "any value"),
            Self::Union(fields) => {
                let words: Vec<_> = fields.iter().map(|field| field.name).collect();
                write!(f, "map with one of the keys {}", words.join(" | "))
            }
            Self::NumberOr(_) => write!(f, "number or distribution"),
        }
    }
}

/// One named parameter of a stage.
#[derive(Debug, Clone, PartialEq)]
pub struct Field {
    /// Its key in `with`; the unit is part of the name.
    pub name: &'static str,
    /// What it does, from its doc comment.
    pub doc: String,
    /// The shape of its value.
    pub kind: Kind,
    /// The value it has when left out; `None` for a required parameter.
    pub default: Option<Value>,
    /// The values it may take.
    pub range: Range,
}

/// The values a number (or every number of a list) may take.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Range {
    /// Any finite value.
    Any,
    /// Greater than zero.
    Positive,
    /// Zero or greater.
    NonNegative,
    /// At least this.
    AtLeast(f64),
    /// Between the two, both included.
    Between(f64, f64),
}

impl Range {
    /// Whether a value lies in the range.
    pub fn holds(self, value: f64) -> bool {
        match self {
            Self::Any => true,
            Self::Positive => value > 0.0,
            Self::NonNegative => value >= 0.0,
            Self::AtLeast(low) => value >= low,
            Self::Between(low, high) => (low..=high).contains(&value),
        }
    }
}

impl std::fmt::Display for Range {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Any => Ok(()),
            Self::Positive => write!(f, "> 0"),
            Self::NonNegative => write!(f, ">= 0"),
            Self::AtLeast(low) => write!(f, ">= {low}"),
            Self::Between(low, high) => write!(f, "{low} to {high}"),
        }
    }
}

/// What is wrong with one value of `with`, and where.
#[derive(Debug, Clone, PartialEq)]
pub struct Fault {
    /// Keys and list positions that lead to the value.
    pub path: Vec<String>,
    /// What is wrong.
    pub message: String,
    /// The keys or words that would have been right, for a suggestion.
    pub known: Vec<String>,
    /// The fault lies in the key, not in its value.
    pub at_key: bool,
}

impl Fault {
    /// A fault of a value; [`Fault::below`] adds the keys that lead to it.
    pub fn new(message: impl Into<String>) -> Self {
        Self { path: Vec::new(), message: message.into(), known: Vec::new(), at_key: false }
    }

    /// The same fault, one key or list position further down.
    #[must_use]
    pub fn below(mut self, segment: &str) -> Self {
        self.path.insert(0, segment.to_owned());
        self
    }
}

/// A type that a parameter can have.
pub trait ParamType: Sized {
    /// The shape that the catalogue and the JSON Schema show.
    fn kind() -> Kind;
    /// Reads a value, or returns every fault in it.
    fn decode(value: &Value) -> Result<Self, Vec<Fault>>;
    /// The canonical form: `decode(encode(x)) = x`, and equal values have equal text.
    fn encode(&self) -> Value;
    /// Faults of a value that is no plain number but may leave the range: a distribution that can draw such values.
    fn outside(&self, _range: Range) -> Vec<Fault> {
        Vec::new()
    }
}

/// The whole of a stage's parameters, or a part that several stages have in common.
pub trait Params: ParamType {
    /// The fields, in the order of declaration.
    fn fields() -> Vec<Field>;
    /// Adds the keys to a list.
    fn names(known: &mut Vec<&'static str>);
    /// Reads the keys of a map that may hold others; `None` where there are faults.
    fn read(reader: &mut MapReader) -> Option<Self>;
    /// Adds every key with its canonical value to a map.
    fn write(&self, map: &mut Map<String, Value>);
}

/// A file named by a parameter; the engine opens and hashes it, [`crate::Context::file`] hands over a reader.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FileRef(pub String);

/// A file named by a parameter that may state its coordinate reference system in a `.prj` beside it;
/// [`crate::Context::read_georeferenced`] reads both.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GeoFileRef(pub String);

/// A folder, file or pattern named by a parameter; [`crate::Context::files`] hands over its readers, sorted by name.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FilesRef(pub String);

fn wrong(expected: &str, value: &Value) -> Vec<Fault> {
    vec![Fault::new(format!("expected {expected}, found {}", describe(value)))]
}

fn describe(value: &Value) -> String {
    match value {
        Value::Null => "nothing (null)".into(),
        Value::Bool(b) => format!("`{b}`"),
        Value::Number(n) => format!("the number {n}"),
        Value::String(s) => format!("the text \"{s}\""),
        Value::Array(list) => format!("a list of {}", list.len()),
        Value::Object(_) => "a map".into(),
    }
}

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

/// Reads the keys of one map; used by [`crate::params!`].
pub struct MapReader<'a> {
    map: Option<&'a Map<String, Value>>,
    faults: Vec<Fault>,
}

impl<'a> MapReader<'a> {
    /// Starts on a value that should be a map; nothing (null) counts as an empty one.
    pub fn new(value: &'a Value) -> Self {
        let faults = match value {
            Value::Object(_) | Value::Null => Vec::new(),
            other => wrong("a map of parameters", other),
        };
        Self { map: value.as_object(), faults }
    }

    /// Reads one key, or its default.
    pub fn field<T: ParamType>(&mut self, name: &str, default: Option<T>, range: Range) -> Option<T> {
        let Some(value) = self.map.and_then(|map| map.get(name)) else {
            if default.is_none() && self.faults.is_empty() | self.map.is_some() {
                self.faults.push(Fault::new(format!("parameter `{name}` ({}) is missing", T::kind())));
            }
            return default;
        };
        match T::decode(value) {
            Ok(decoded) => {
                self.check_range(name, value, range);
                self.faults.extend(decoded.outside(range).into_iter().map(|fault| fault.below(name)));
                Some(decoded)
            }
            Err(faults) => {
                self.faults.extend(faults.into_iter().map(|fault| fault.below(name)));
                None
            }
        }
    }

    fn check_range(&mut self, name: &str, value: &Value, range: Range) {
        match value {
            Value::Number(number) if !number.as_f64().is_some_and(|x| range.holds(x)) => {
                self.faults.push(Fault::new(format!("{number} is out of range: must be {range}")).below(name));
            }
            Value::Array(list) => list.iter().for_each(|item| self.check_range(name, item, range)),
            _ => {}
        }
    }

    /// All faults found, unknown keys among them.
    pub fn finish(mut self, known: &[&str]) -> Vec<Fault> {
        for key in self.map.into_iter().flat_map(Map::keys).filter(|key| !known.contains(&key.as_str())) {
            self.faults.push(Fault {
                path: vec![key.clone()],
                message: format!("unknown parameter `{key}`"),
                known: known.iter().map(ToString::to_string).collect(),
                at_key: true,
            });
        }
        self.faults
    }
}

/// Declares the parameters of a stage: `name: type = default; range` with a doc comment each.
///
/// A parameter without `= default` is required. A parameter without `; range` takes any value of its type. Parameters that
/// several stages share are a part, `..part: Part,` before the others: the keys of the part stand beside the keys of the
/// stage and are listed after them.
///
/// ```
/// use rockface_core::params;
/// use rockface_core::params::{ParamType, Range};
/// use serde_json::json;
///
/// params! {
///     /// Parameters of `smooth-raster`.
///     pub struct SmoothParams {
///         /// Standard deviation of the filter, metres.
///         sigma_m: f64 = 0.1; Range::Positive,
///         /// Number of passes.
///         passes: u32 = 1,
///     }
/// }
///
/// let params = SmoothParams::decode(&json!({"passes": 3})).unwrap();
/// assert_eq!(params, SmoothParams { passes: 3, ..SmoothParams::default() });
/// assert_eq!(params.encode(), json!({"sigma_m": 0.1, "passes": 3}));
///
/// let faults = SmoothParams::decode(&json!({"sigma_m": -1})).unwrap_err();
/// assert_eq!(faults[0].path, ["sigma_m"]);
/// assert_eq!(faults[0].message, "-1 is out of range: must be > 0");
/// ```
///
/// The struct has `Default` where every parameter has a default; it does not where one is required:
///
/// ```compile_fail,E0277
/// rockface_core::params! {
///     /// Parameters with a required one.
///     pub struct ReadParams {
///         /// Name of the image.
///         image: String,
///     }
/// }
///
/// fn defaults<P: Default>() -> P {
///     P::default()
/// }
/// defaults::<ReadParams>();
/// ```
#[macro_export]
macro_rules! params {
    (
        $(#[doc = $about:literal])*
        pub struct $Name:ident {
            $( ..$part:ident : $Part:ty , )*
            $( $(#[doc = $doc:literal])+ $field:ident : $ty:ty $(= $default:expr)? $(; $range:expr)? ),* $(,)?
        }
    ) => {
        $(#[doc = $about])*
        #[derive(Debug, Clone, PartialEq)]
        #[allow(clippy::struct_field_names)] // units are part of the names
        pub struct $Name {
            $( $(#[doc = $doc])+ pub $field: $ty, )*
            $( #[doc = concat!("What it has in common with others: [`", stringify!($Part), "`].")] pub $part: $Part, )*
        }

        impl $crate::params::ParamType for $Name {
            fn kind() -> $crate::params::Kind {
                $crate::params::Kind::Map(<Self as $crate::params::Params>::fields())
            }
            fn decode(value: &serde_json::Value) -> Result<Self, Vec<$crate::params::Fault>> {
                let mut reader = $crate::params::MapReader::new(value);
                let read = <Self as $crate::params::Params>::read(&mut reader);
                let mut known = Vec::new();
                <Self as $crate::params::Params>::names(&mut known);
                let faults = reader.finish(&known);
                if !faults.is_empty() {
                    return Err(faults);
                }
                read.ok_or_else(|| vec![$crate::params::Fault::new("a parameter is missing")])
            }
            fn encode(&self) -> serde_json::Value {
                let mut map = serde_json::Map::new();
                $crate::params::Params::write(self, &mut map);
                serde_json::Value::Object(map)
            }
        }

        impl $crate::params::Params for $Name {
            #[allow(unused_mut)]
            fn fields() -> Vec<$crate::params::Field> {
                let mut fields: Vec<$crate::params::Field> = vec![$( $crate::params::Field {
                    name: stringify!($field),
                    doc: [$($doc),+].map(str::trim).join(" "),
                    kind: <$ty as $crate::params::ParamType>::kind(),
                    default: $crate::params!(@default $ty $(, $default)?)
                        .map(|value: $ty| $crate::params::ParamType::encode(&value)),
                    range: $crate::params!(@range $($range)?),
                } ),*];
                $( fields.extend(<$Part as $crate::params::Params>::fields()); )*
                fields
            }
            #[allow(unused_variables)]
            fn names(known: &mut Vec<&'static str>) {
                $( known.push(stringify!($field)); )*
                $( <$Part as $crate::params::Params>::names(known); )*
            }
            #[allow(unused_variables)]
            fn read(reader: &mut $crate::params::MapReader) -> Option<Self> {
                $( let $field: Option<$ty> =
                    reader.field(stringify!($field), $crate::params!(@default $ty $(, $default)?), $crate::params!(@range $($range)?)); )*
                $( let $part = <$Part as $crate::params::Params>::read(reader); )*
                match ($($field,)* $($part,)*) {
                    ($(Some($field),)* $(Some($part),)*) => Some(Self { $($field,)* $($part,)* }),
                    #[allow(unreachable_patterns)]
                    _ => None,
                }
            }
            #[allow(unused_variables)]
            fn write(&self, map: &mut serde_json::Map<String, serde_json::Value>) {
                $( map.insert(stringify!($field).to_owned(), $crate::params::ParamType::encode(&self.$field)); )*
                $( $crate::params::Params::write(&self.$part, map); )*
            }
        }

        $crate::params!(@all_defaults $Name [$($part: $Part),*] [$( $field [$($default)?] ),*]);
    };
    (@all_defaults $Name:ident [$($part:ident : $Part:ty),*] [$( $field:ident [$default:expr] ),*]) => {
        impl Default for $Name {
            fn default() -> Self {
                Self { $( $field: $default, )* $( $part: <$Part as Default>::default(), )* }
            }
        }
    };
    // A parameter is required.
    (@all_defaults $($rest:tt)*) => {};
    (@default $ty:ty) => { None::<$ty> };
    (@default $ty:ty, $default:expr) => { Some::<$ty>($default) };
    (@range) => { $crate::params::Range::Any };
    (@range $range:expr) => { $range };
}

/// Declares a parameter that is one of a few words: `Variant = "word"` with a doc comment each.
///
/// ```
/// use rockface_core::choice;
/// use rockface_core::params::ParamType;
///
/// choice! {
///     /// How elevations are averaged.
///     pub enum Average {
///         /// Arithmetic mean.
///         Mean = "mean",
///         /// Middle value.
///         Median = "median",
///     }
/// }
///
/// assert_eq!(Average::decode(&"median".into()), Ok(Average::Median));
/// assert_eq!(Average::decode(&"mode".into()).unwrap_err()[0].known, ["mean", "median"]);
/// ```
#[macro_export]
macro_rules! choice {
    (
        $(#[doc = $about:literal])+
        pub enum $Name:ident { $( #[doc = $doc:literal] $Variant:ident = $word:literal ),* $(,)? }
    ) => {
        $(#[doc = $about])+
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub enum $Name { $( #[doc = $doc] $Variant ),* }

        impl $crate::params::ParamType for $Name {
            fn kind() -> $crate::params::Kind {
                $crate::params::Kind::Choice(&[$(($word, $doc)),*])
            }
            fn decode(value: &serde_json::Value) -> Result<Self, Vec<$crate::params::Fault>> {
                match value.as_str() {
                    $( Some($word) => Ok(Self::$Variant), )*
                    _ => {
                        let known: Vec<String> = [$($word),*].iter().map(ToString::to_string).collect();
                        let mut fault = $crate::params::Fault::new(format!("expected one of {}, found {value}", known.join(", ")));
                        fault.known = known;
                        Err(vec![fault])
                    }
                }
            }
            fn encode(&self) -> serde_json::Value {
                match self { $( Self::$Variant => $word.into() ),* }
            }
        }
    };
}

/// Reads the one key of an externally tagged value, or a bare word: the key, and what is below it; used by
/// [`crate::union!`].
pub fn one_key<'a>(value: &'a Value, known: &[&str]) -> Result<(&'a str, &'a Value), Vec<Fault>> {
    let listed = known.join(", ");
    let fault = |message: String| {
        let known = known.iter().map(ToString::to_string).collect();
        vec![Fault { known, ..Fault::new(message) }]
    };
    let (key, inner) = match value {
        Value::String(word) => (word.as_str(), &Value::Null),
        Value::Object(map) if map.len() == 1 => match map.iter().next() {
            Some((key, inner)) => (key.as_str(), inner),
            None => return Err(fault(format!("expected one of the keys {listed}"))),
        },
        Value::Object(map) => {
            return Err(fault(format!("expected exactly one of the keys {listed}, found {}", map.len())));
        }
        other => return Err(fault(format!("expected a map with one of the keys {listed}, found {}", describe(other)))),
    };
    if known.contains(&key) {
        return Ok((key, inner));
    }
    let mut faults = fault(format!("unknown key `{key}`, expected one of {listed}"));
    if value.is_object() {
        faults[0].path.push(key.to_owned());
        faults[0].at_key = true;
    }
    Err(faults)
}

/// Declares a parameter that is a map with one key, which selects the variant: `Variant(Type) = "key"` with a doc comment
/// each; the types are declared with [`crate::params!`].
#[macro_export]
macro_rules! union {
    (
        $(#[doc = $about:literal])+
        pub enum $Name:ident { $( $(#[doc = $doc:literal])+ $Variant:ident($ty:ty) = $word:literal ),* $(,)? }
    ) => {
        $(#[doc = $about])+
        // A few parameters of a step, not millions: size does not matter.
        #[allow(clippy::large_enum_variant)]
        #[derive(Debug, Clone, PartialEq)]
        pub enum $Name { $( $(#[doc = $doc])+ $Variant($ty) ),* }

        impl $crate::params::ParamType for $Name {
            fn kind() -> $crate::params::Kind {
                $crate::params::Kind::Union(vec![$( $crate::params::Field {
                    name: $word,
                    doc: [$($doc),+].map(str::trim).join(" "),
                    kind: <$ty as $crate::params::ParamType>::kind(),
                    default: None,
                    range: $crate::params::Range::Any,
                } ),*])
            }
            fn decode(value: &serde_json::Value) -> Result<Self, Vec<$crate::params::Fault>> {
                let (key, inner) = $crate::params::one_key(value, &[$($word),*])?;
                let below = |faults: Vec<$crate::params::Fault>| {
                    let depth = |fault: $crate::params::Fault| if value.is_object() { fault.below(key) } else { fault };
                    faults.into_iter().map(depth).collect::<Vec<_>>()
                };
                match key {
                    $( $word => <$ty as $crate::params::ParamType>::decode(inner).map(Self::$Variant).map_err(below), )*
                    _ => Err(vec![$crate::params::Fault::new(format!("unknown key `{key}`"))]),
                }
            }
            fn encode(&self) -> serde_json::Value {
                let (key, inner) = match self {
                    $( Self::$Variant(inner) => ($word, $crate::params::ParamType::encode(inner)), )*
                };
                serde_json::Value::Object([(key.to_owned(), inner)].into_iter().collect())
            }
        }
    };
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    choice! {
        /// A shape.
        pub enum Shape {
            /// Round.
            Round = "round",
            /// Not round.
            Square = "square",
        }
    }

    params! {
        /// A sample.
        pub struct Sample {
            /// Cell size.
            cell_m: f64 = 0.5; Range::Positive,
            /// How many.
            count: u32 = 3,
            /// Its shape.
            shape: Shape = Shape::Round,
            /// A corner.
            corner_m: Option<[f64; 2]> = None,
            /// A file.
            path: FileRef,
        }
    }

    #[test]
    fn default_is_what_an_empty_map_gives() {
        assert_eq!(Disc::default(), Disc::decode(&json!({})).unwrap());
        assert_eq!(Framed::default(), Framed::decode(&json!({})).unwrap());
        assert_eq!(Framed::default().lettering, Lettering { height_mm: 2.5 });
    }

    #[test]
    fn defaults_are_filled_in_and_canonical() {
        let sample = Sample::decode(&json!({"path": "a.ply", "cell_m": 1})).unwrap();
        assert_eq!(
            sample.encode().to_string(),
            r#"{"cell_m":1.0,"corner_m":null,"count":3,"path":"a.ply","shape":"round"}"#
        );
        assert_eq!(Sample::decode(&sample.encode()).unwrap(), sample);
    }

    #[test]
    fn a_number_is_one_however_it_is_written() {
        let free = |value: Value| Value::decode(&value).unwrap().encode().to_string();
        for one in [json!(1), json!(1.0), serde_json::from_str("1e0").unwrap()] {
            assert_eq!((free(one.clone()), f64::decode(&one).unwrap().encode()), ("1".to_owned(), json!(1.0)));
            assert_eq!(u32::decode(&one).unwrap().encode(), json!(1));
        }
        assert_eq!(free(json!({"a": [-0.0, 0.5, 1e300, -7.0], "b": "1.0"})), r#"{"a":[0,0.5,1e+300,-7],"b":"1.0"}"#);
        assert_eq!(free(json!(u64::MAX)), u64::MAX.to_string());
    }

    #[test]
    fn every_fault_is_reported_with_its_place() {
        let faults =
            Sample::decode(&json!({"cell_m": -1, "shape": "roun", "corner_m": [1, "x"], "cel_m": 1})).unwrap_err();
        let places: Vec<_> = faults.iter().map(|f| f.path.join(".")).collect();
        assert_eq!(places, ["cell_m", "shape", "corner_m.1", "", "cel_m"]);
        assert!(faults[3].message.contains("`path` (file) is missing"));
    }

    params! {
        /// What all labels have.
        pub struct Lettering {
            /// Height of its letters.
            height_mm: f64 = 2.5; Range::Positive,
        }
    }

    params! {
        /// A label.
        pub struct Label {
            ..lettering: Lettering,
            /// What it says.
            text: String,
        }
    }

    params! {
        /// A framed label.
        pub struct Framed {
            ..lettering: Lettering,
            /// Corners of the frame.
            corners: Vec<f64> = vec![0.0, 1.0],
        }
    }

    #[test]
    fn a_part_in_common_has_its_keys_beside_the_others() {
        let label = Label::decode(&json!({"text": "a", "height_mm": 3})).unwrap();
        assert_eq!((label.lettering.height_mm, label.encode()), (3.0, json!({"text": "a", "height_mm": 3.0})));
        assert_eq!(Label::fields().iter().map(|field| field.name).collect::<Vec<_>>(), ["text", "height_mm"]);
        let places =
            |value| Label::decode(&value).unwrap_err().into_iter().map(|f| f.path.join(".")).collect::<Vec<_>>();
        assert_eq!(places(json!({"text": "a", "height_mm": -1, "lettering": 1})), ["height_mm", "lettering"]);
    }

    params! {
        /// A disc.
        pub struct Disc {
            /// Its radius.
            radius_m: f64 = 1.0; Range::Positive,
        }
    }

    params! {
        /// A file.
        pub struct Given {
            /// Its path.
            path: FileRef,
        }
    }

    union! {
        /// What to draw.
        pub enum Figure {
            /// A disc.
            Disc(Disc) = "disc",
            /// What a file holds.
            Given(Given) = "given",
        }
    }

    #[test]
    fn a_union_is_told_by_its_key_and_a_bare_word_takes_the_defaults() {
        let disc = Figure::decode(&json!({"disc": {"radius_m": 2}})).unwrap();
        assert_eq!(disc, Figure::Disc(Disc { radius_m: 2.0 }));
        assert_eq!(disc.encode(), json!({"disc": {"radius_m": 2.0}}));
        for short in [json!("disc"), json!({"disc": null}), json!({"disc": {}})] {
            assert_eq!(Figure::decode(&short).unwrap(), Figure::Disc(Disc { radius_m: 1.0 }));
        }
    }

    #[test]
    fn faults_of_a_union_name_their_place() {
        let fault = |value: Value| Figure::decode(&value).unwrap_err().remove(0);
        assert_eq!(fault(json!({"disc": {"radius_m": -2}})).path, ["disc", "radius_m"]);
        assert!(fault(json!("given")).message.contains("`path` (file) is missing"));
        let unknown = fault(json!({"disk": {}}));
        assert_eq!((unknown.path.as_slice(), unknown.at_key), (&["disk".to_owned()][..], true));
        assert_eq!(unknown.known, ["disc", "given"]);
        assert!(fault(json!({"disc": {}, "given": {}})).message.contains("exactly one"));
        assert!(fault(json!(3)).message.contains("found the number 3"));
    }

    #[test]
    fn the_catalogue_knows_names_docs_and_defaults() {
        let fields = Sample::fields();
        assert_eq!(fields[0].doc, "Cell size.");
        assert_eq!(fields[1].default, Some(json!(3)));
        assert_eq!(fields[4].default, None);
    }
}
