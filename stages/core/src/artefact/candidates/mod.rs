//! An unbounded sequence of candidate blocks: the specification they are drawn from, and the key they are drawn with.

mod modifier;
mod quantity;
mod shape;

pub use modifier::{Modifier, Noise, Remesh, Rotate, Roughness, Scale, Skew, Subdivide};
pub use quantity::{
    Beta, Constant, Density, Discrete, Distribution, Exponential, LogNormal, Normal, PowerLaw, Quantity, SampleFile,
    Samples, TruncatedNormal, Uniform,
};
pub use shape::{
    Axes, AxisOrder, Ellipsoid, Exact, JointBlock, JointSet, JointWedge, Kinematics, Library, Polyhedron, Prism,
    Pyramid, Shape, Size, SneedFolk, SneedFolkClass, Trapezoid, Volume, Wedge,
};

use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::Part;
use crate::numerics::random::Key;
use crate::params::{ParamType, Range};
use crate::{choice, params};

choice! {
    /// What the axes of a block are laid along where it is placed.
    pub enum Align {
        /// The axes of the wall frame.
        Wall = "wall",
        /// The local normal of the face: the block is turned by the shortest way that takes Z to it.
        Normal = "normal",
    }
}

params! {
    /// A class of blocks.
    pub struct Class {
        /// Its name in the ground truth; null: the key of its shape.
        name: Option<String> = None,
        /// How often it occurs, relative to the other classes.
        probability: f64 = 1.0; Range::NonNegative,
        /// Its base shape, in a box of 1 m unless `size` says otherwise.
        shape: Shape,
        /// Its size; null: 1 m boxes, and joint and library blocks as they are.
        size: Option<Size> = None,
        /// Longest edge of the base shape: it is cut up to it, so that roughness has vertices to move, metres; null: as coarse
        /// as the shape allows.
        edge_m: Option<f64> = None; Range::Positive,
        /// Applied in this order, any of them more than once.
        modifiers: Vec<Modifier> = Vec::new(),
        /// What its axes are laid along where it is placed.
        align: Align = Align::Wall,
    }
}

impl Class {
    /// Its name: the one given, or the key of its shape.
    pub fn label(&self) -> &str {
        let shape = match &self.shape {
            Shape::Prism(_) => "prism",
            Shape::Ellipsoid(_) => "ellipsoid",
            Shape::Trapezoid(_) => "trapezoid",
            Shape::Pyramid(_) => "pyramid",
            Shape::Wedge(_) => "wedge",
            Shape::Polyhedron(_) => "polyhedron",
            Shape::JointBlock(_) => "joint_block",
            Shape::JointWedge(_) => "joint_wedge",
            Shape::Library(_) => "library",
        };
        self.name.as_deref().unwrap_or(shape)
    }
}

/// An unbounded seeded sequence of candidate blocks addressed by number; every file its distributions named is in it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Candidates {
    /// The classes, with every default filled in.
    #[serde(serialize_with = "write_classes", deserialize_with = "read_classes")]
    pub classes: Vec<Class>,
    /// Rows X, Y, Z of the wall frame in east, north, up; where joint sets are among the classes.
    pub wall_from_enu: Option<[[f64; 3]; 3]>,
    /// Scanned blocks for classes of the shape `library`.
    pub library: Vec<Part>,
    /// Key of the random stream, 64 hexadecimal digits.
    pub key: HexKey,
}

impl Candidates {
    /// The names of the classes, each once, in the order of the specification.
    pub fn class_names(&self) -> Vec<String> {
        let mut names: Vec<String> = Vec::new();
        for class in &self.classes {
            if !names.iter().any(|name| name == class.label()) {
                names.push(class.label().to_owned());
            }
        }
        names
    }
}

/// A key of a random stream, written as 64 hexadecimal digits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct HexKey(pub Key);

impl Serialize for HexKey {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let text: String = self.0.0.iter().map(|byte| format!("{byte:02x}")).collect();
        serializer.serialize_str(&text)
    }
}

impl<'de> Deserialize<'de> for HexKey {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        let byte = |i: usize| text.get(2 * i..2 * i + 2).and_then(|pair| u8::from_str_radix(pair, 16).ok());
        let bytes: Option<Vec<u8>> = (0..32).map(byte).collect();
        match bytes.and_then(|bytes| <[u8; 32]>::try_from(bytes).ok()) {
            Some(bytes) if text.len() == 64 => Ok(Self(Key(bytes))),
            _ => Err(serde::de::Error::custom(format!("`{text}` is no key of 64 hexadecimal digits"))),
        }
    }
}

fn write_classes<S: Serializer>(classes: &Vec<Class>, serializer: S) -> Result<S::Ok, S::Error> {
    classes.encode().serialize(serializer)
}

fn read_classes<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<Class>, D::Error> {
    let value = serde_json::Value::deserialize(deserializer)?;
    Vec::<Class>::decode(&value).map_err(|faults| {
        let text = |fault: &crate::params::Fault| format!("{}: {}", fault.path.join("."), fault.message);
        serde::de::Error::custom(faults.iter().map(text).collect::<Vec<_>>().join("; "))
    })
}

super::json_noun!(
    Candidates,
    fn items(&self) -> Option<Vec<String>> {
        Some(self.class_names())
    }
);

#[cfg(test)]
mod tests {
    use super::*;
    use crate::artefact::Noun;
    use serde_json::json;

    #[test]
    fn a_specification_comes_back_from_its_file() {
        let classes = json!([
            {"shape": "prism", "size": {"axes": {"length_m": {"log_normal": {"median": 0.5, "sigma": 0.4}}}}},
            {"name": "round", "shape": {"ellipsoid": {}}, "modifiers": ["tumble", {"roughness": {"sigma_m": 0.02}}]},
        ]);
        let candidates = Candidates {
            classes: Vec::<Class>::decode(&classes).unwrap(),
            wall_from_enu: None,
            library: Vec::new(),
            key: HexKey(Key(std::array::from_fn(|i| i as u8 * 7))),
        };
        let bytes = candidates.encode().unwrap();
        assert_eq!(Candidates::decode(&bytes).unwrap(), candidates);
        assert_eq!(candidates.class_names(), ["prism", "round"]);
        let broken = String::from_utf8(bytes).unwrap().replace("0.02", "-1");
        assert!(Candidates::decode(broken.as_bytes()).unwrap_err().0.contains("1.modifiers.1.roughness.sigma_m"));
    }
}
