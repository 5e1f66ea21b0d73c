//! The declarations of parameters: [`crate::params!`], [`crate::choice!`] and [`crate::union!`].

use serde_json::Value;

use super::{Fault, describe};

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
