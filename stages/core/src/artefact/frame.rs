//! The frame coordinates are in, and where that frame lies on the Earth where that is known.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

use super::{CodecError, Transform};
use crate::crs::Crs;

/// The longest text of a georeference that is read, bytes.
const LONGEST: usize = 1 << 17;

/// Where a frame lies on the Earth, or on its site where that is in no known place on it.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Georeference {
    /// The system of the world frame, where one is stated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub crs: Option<Crs>,
    /// How the wall frame lies in the world frame; absent for the world frame itself, and where it is not known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub wall_from_world: Option<Transform>,
}

impl Georeference {
    /// The world frame in a system.
    pub fn world(crs: Crs) -> Self {
        Self { crs: Some(crs), wall_from_world: None }
    }

    /// Its text in files: JSON in ASCII, on one line.
    pub fn to_text(&self) -> String {
        let json = serde_json::to_string(self).unwrap_or_default();
        let escaped = |c: char| {
            let units: Vec<_> = c.encode_utf16(&mut [0; 2]).iter().map(|unit| format!("\\u{unit:04x}")).collect();
            units.concat()
        };
        json.chars().map(|c| if c.is_ascii() && !c.is_ascii_control() { c.to_string() } else { escaped(c) }).collect()
    }

    /// Reads what [`Georeference::to_text`] wrote.
    ///
    /// # Errors
    /// Text that is none.
    pub fn from_text(text: &str) -> Result<Self, CodecError> {
        if text.len() > LONGEST {
            return Err(CodecError(format!("a georeference of {} bytes", text.len())));
        }
        serde_json::from_str(text).map_err(|e| CodecError(format!("bad georeference: {e}")))
    }

    /// The one value of all that are equal: frames are copied by every stage, so they hold a reference.
    fn shared(self) -> &'static Self {
        static ALL: Mutex<BTreeMap<String, &'static Georeference>> = Mutex::new(BTreeMap::new());
        let mut all = ALL.lock().unwrap_or_else(PoisonError::into_inner);
        all.entry(self.to_text()).or_insert_with(|| Box::leak(Box::new(self)))
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Axes {
    World,
    Wall,
}

/// The frame coordinates are in: the world frame is the input's coordinate reference system, the wall frame has X along the
/// face, Y up the face and Z out of the rock towards the viewer; metres in both.
///
/// Two frames are equal where their axes are. Whether they also lie at the same place on the Earth is checked once for all
/// stages, where inputs are read ([`crate::Inputs`]), so that what states no system goes together with what states one.
#[derive(Clone, Copy)]
pub struct Frame {
    axes: Axes,
    georeference: Option<&'static Georeference>,
}

#[allow(non_upper_case_globals)] // they read as the variants they once were
impl Frame {
    /// The input's coordinate reference system.
    pub const World: Self = Self { axes: Axes::World, georeference: None };
    /// X along the face, Y up the face, Z out of the rock towards the viewer; metres.
    pub const Wall: Self = Self { axes: Axes::Wall, georeference: None };
}

impl Frame {
    /// The frame of a name, `world` or `wall`.
    pub fn named(name: &str) -> Option<Self> {
        [Self::World, Self::Wall].into_iter().find(|frame| frame.name() == name)
    }

    /// The name that files and messages have for the frame: `world` or `wall`.
    pub const fn name(self) -> &'static str {
        match self.axes {
            Axes::World => "world",
            Axes::Wall => "wall",
        }
    }

    /// Where it lies on the Earth, if that is known.
    pub fn georeference(self) -> Option<&'static Georeference> {
        self.georeference
    }

    /// The system its own coordinates are in: that of the world frame; the wall frame is in none.
    pub fn crs(self) -> Option<&'static Crs> {
        self.world_crs().filter(|_| self == Self::World)
    }

    /// The system of the world it is, or lies in, if that is known.
    pub fn world_crs(self) -> Option<&'static Crs> {
        self.georeference.and_then(|georeference| georeference.crs.as_ref())
    }

    /// How the wall frame lies in the world, if that is known.
    pub fn wall_from_world(self) -> Option<&'static Transform> {
        self.georeference.and_then(|georeference| georeference.wall_from_world.as_ref())
    }

    /// The same axes at this place on the Earth.
    #[must_use]
    pub fn at(self, georeference: Option<Georeference>) -> Self {
        let own = georeference.map(|mut own| {
            own.wall_from_world =
                own.wall_from_world.filter(|_| self == Self::Wall).map(|t| Transform { crs: None, ..t });
            own
        });
        let says_any = |own: &Georeference| own.crs.is_some() || own.wall_from_world.is_some();
        Self { georeference: own.filter(says_any).map(Georeference::shared), ..self }
    }
}

impl PartialEq for Frame {
    fn eq(&self, other: &Self) -> bool {
        self.axes == other.axes
    }
}

impl Eq for Frame {}

impl std::fmt::Display for Frame {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

impl std::fmt::Debug for Frame {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.georeference {
            None => f.write_str(self.name()),
            Some(georeference) => write!(f, "{} of {}", self.name(), georeference.to_text()),
        }
    }
}

/// In JSON a frame is its name, or its name with its georeference.
#[derive(serde::Serialize, serde::Deserialize)]
#[serde(untagged)]
enum Written {
    Name(String),
    Placed {
        axes: String,
        #[serde(flatten)]
        georeference: Box<Georeference>,
    },
}

impl serde::Serialize for Frame {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let name = self.name().to_owned();
        let written = match self.georeference {
            None => Written::Name(name),
            Some(georeference) => Written::Placed { axes: name, georeference: Box::new(georeference.clone()) },
        };
        written.serialize(serializer)
    }
}

impl<'de> serde::Deserialize<'de> for Frame {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let (name, georeference) = match Written::deserialize(deserializer)? {
            Written::Name(name) => (name, None),
            Written::Placed { axes, georeference } => (axes, Some(*georeference)),
        };
        let frame = Self::named(&name);
        let frame =
            frame.ok_or_else(|| serde::de::Error::custom(format!("unknown frame `{name}`, not `world` or `wall`")));
        frame.map(|frame| frame.at(georeference))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wall() -> Frame {
        let wall_from_world = Some(Transform::identity("world", "wall"));
        Frame::Wall.at(Some(Georeference { crs: "EPSG:28356".parse().ok(), wall_from_world }))
    }

    fn of_site() -> Georeference {
        Georeference { crs: None, wall_from_world: Some(Transform::identity("world", "wall")) }
    }

    #[test]
    fn a_frame_comes_back_through_json() {
        for frame in [
            Frame::World,
            Frame::Wall,
            wall(),
            Frame::Wall.at(Some(of_site())),
            Frame::World.at(Some(Georeference::world("EPSG:32633".parse().unwrap()))),
        ] {
            let text = serde_json::to_string(&frame).unwrap();
            let again: Frame = serde_json::from_str(&text).unwrap();
            assert_eq!((again, again.georeference()), (frame, frame.georeference()), "{text}");
        }
        assert_eq!(serde_json::to_string(&Frame::Wall).unwrap(), "\"wall\"");
        assert!(serde_json::from_str::<Frame>("\"moon\"").is_err());
    }

    #[test]
    fn only_the_world_frame_is_in_the_system_and_only_the_wall_has_a_way_to_it() {
        assert_eq!(wall().crs(), None);
        let world = Frame::World.at(wall().georeference().cloned());
        assert_eq!(world.crs().unwrap().epsg(), Some(28356));
        assert_eq!(world.georeference().unwrap().wall_from_world, None);
        assert_eq!(wall(), Frame::Wall);
        // The world of a site without a system has nothing to say.
        assert_eq!(Frame::World.at(Some(of_site())).georeference(), None);
    }

    #[test]
    fn equal_georeferences_are_one_value() {
        assert!(std::ptr::eq(wall().georeference().unwrap(), wall().georeference().unwrap()));
    }
}
