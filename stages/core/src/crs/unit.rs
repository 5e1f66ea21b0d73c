//! Units of length that files of coordinates are in, and how many metres they are.

use super::wkt::Node;

/// A unit of length.
#[derive(Debug, Clone, PartialEq)]
pub struct Unit {
    /// Its name in messages, in the plural.
    pub name: String,
    /// How many metres one of it is.
    pub metres: f64,
}

/// EPSG code, name and metres of the units that georeferenced files name by a code.
const BY_CODE: &[(u32, &str, f64)] = &[
    (9001, "metres", 1.0),
    (9002, "international feet", 0.3048),
    (9003, "US survey feet", 1200.0 / 3937.0),
    (9005, "Clarke's feet", 0.304_797_265_4),
    (9014, "fathoms", 1.8288),
    (9030, "nautical miles", 1852.0),
    (9036, "kilometres", 1000.0),
    (9040, "British yards (Sears 1922)", 0.914_398_414_616_029),
    (9041, "British feet (Sears 1922)", 0.304_799_471_538_676),
    (9042, "British chains (Sears 1922)", 20.116_765_121_552_6),
    (9084, "Indian yards", 0.914_398_530_744_441),
    (9094, "Gold Coast feet", 0.304_799_710_181_509),
    (1025, "millimetres", 0.001),
    (1033, "centimetres", 0.01),
];

/// Feet differ by two millionths, so factors closer than this are the same unit.
const SAME: f64 = 1e-8;

impl Unit {
    /// The metre itself, with a factor of one.
    pub fn metre() -> Self {
        Self { name: "metres".to_owned(), metres: 1.0 }
    }

    /// The unit of an EPSG code.
    pub fn by_code(code: u32) -> Option<Self> {
        let (_, name, metres) = BY_CODE.iter().find(|(known, ..)| *known == code)?;
        Some(Self { name: (*name).to_owned(), metres: *metres })
    }

    /// The unit that a `UNIT` or `LENGTHUNIT` node states; `None` where it has no factor greater than zero.
    pub fn of(node: &Node) -> Option<Self> {
        let metres = node.number(1).filter(|metres| *metres > 0.0)?;
        let known = BY_CODE.iter().find(|(.., factor)| (factor / metres - 1.0).abs() < SAME);
        Some(known.map_or_else(
            || Self { name: format!("units called `{}`", node.name()), metres },
            |(_, name, metres)| Self { name: (*name).to_owned(), metres: *metres },
        ))
    }

    /// Whether it is the metre.
    pub fn is_metre(&self) -> bool {
        (self.metres - 1.0).abs() < SAME
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn feet_are_told_apart() {
        let unit = |text: &str| Unit::of(&Node::parse(text).unwrap()).unwrap();
        assert_eq!(unit("UNIT[\"US survey foot\",0.3048006096012192]"), Unit::by_code(9003).unwrap());
        assert_eq!(unit("UNIT[\"Foot\",0.3048]").name, "international feet");
        assert!(unit("LENGTHUNIT[\"metre\",1.0]").is_metre());
        assert_eq!(unit("UNIT[\"ell\",0.6]").name, "units called `ell`");
        assert_eq!(Unit::of(&Node::parse("UNIT[\"x\",0]").unwrap()), None);
    }
}
