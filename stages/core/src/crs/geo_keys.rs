//! The keys by which GeoTIFF, and LAS before version 1.4, state a system (OGC 19-008r4, annex B), read and written.

use super::stated::{Kind, Stated, linear_unit};
use super::unit::Unit;
use super::wkt::{Argument, Node};
use super::{Crs, Heights, compound, definition, is_depths, vertical_definition};

const MODEL_TYPE: u16 = 1024;
const CITATION: u16 = 1026;
const GEODETIC: u16 = 2048;
const GEODETIC_CITATION: u16 = 2049;
const PROJECTED: u16 = 3072;
const PROJECTED_CITATION: u16 = 3073;
const METHOD: u16 = 3075;
const LINEAR_UNITS: u16 = 3076;
const LINEAR_UNIT_SIZE: u16 = 3077;
const VERTICAL: u16 = 4096;
const VERTICAL_CITATION: u16 = 4097;
const VERTICAL_UNITS: u16 = 4099;

const USER_DEFINED: u16 = 32767;
const METRE: u16 = 9001;
/// Tag and record of the texts that keys refer to.
const ASCII: u16 = 34737;
/// Tag and record of the numbers that keys refer to.
const DOUBLES: u16 = 34736;
/// What stands before a well-known text in a citation, as ESRI began and GDAL reads.
const PE_STRING: &str = "ESRI PE String = ";

/// Numbers of projections by their key, the name in WKT 1, and the keys of its parameters.
type Projection = (u16, &'static str, &'static [(u16, &'static str)]);
const PROJECTIONS: &[Projection] = &[
    (
        1,
        "Transverse_Mercator",
        &[
            (3081, "latitude_of_origin"),
            (3080, "central_meridian"),
            (3092, "scale_factor"),
            (3082, "false_easting"),
            (3083, "false_northing"),
        ],
    ),
    (
        8,
        "Lambert_Conformal_Conic_2SP",
        &[
            (3078, "standard_parallel_1"),
            (3079, "standard_parallel_2"),
            (3085, "latitude_of_origin"),
            (3084, "central_meridian"),
            (3086, "false_easting"),
            (3087, "false_northing"),
        ],
    ),
    (
        9,
        "Lambert_Conformal_Conic_1SP",
        &[
            (3081, "latitude_of_origin"),
            (3080, "central_meridian"),
            (3092, "scale_factor"),
            (3082, "false_easting"),
            (3083, "false_northing"),
        ],
    ),
];

/// The keys of a file with what they refer to.
#[derive(Debug, Clone, Copy, Default)]
pub struct GeoKeys<'a> {
    /// The directory: four numbers a key, after four of its own.
    pub directory: &'a [u16],
    /// Numbers that keys refer to by their place.
    pub doubles: &'a [f64],
    /// Texts that keys refer to by place and length.
    pub ascii: &'a str,
}

impl GeoKeys<'_> {
    fn entry(&self, key: u16) -> Option<[u16; 4]> {
        let mut entries = self.directory.chunks_exact(4).skip(1);
        entries.find(|entry| entry[0] == key).map(|entry| [entry[0], entry[1], entry[2], entry[3]])
    }

    fn code(&self, key: u16) -> Option<u16> {
        self.entry(key).filter(|entry| entry[1] == 0).map(|entry| entry[3]).filter(|code| *code != 0)
    }

    fn double(&self, key: u16) -> Option<f64> {
        let [_, _, _, at] = self.entry(key).filter(|entry| entry[1] == DOUBLES)?;
        self.doubles.get(usize::from(at)).copied().filter(|number| number.is_finite())
    }

    fn text(&self, key: u16) -> Option<&str> {
        let [_, _, length, at] = self.entry(key).filter(|entry| entry[1] == ASCII)?;
        let text = self.ascii.get(usize::from(at)..usize::from(at).checked_add(usize::from(length))?)?;
        Some(text.trim_end_matches(['|', '\0']))
    }

    fn pe_string(&self) -> Option<&str> {
        [PROJECTED_CITATION, CITATION].into_iter().find_map(|key| self.text(key)?.strip_prefix(PE_STRING))
    }

    fn name(&self) -> String {
        let cited = [PROJECTED_CITATION, CITATION, GEODETIC_CITATION].into_iter().find_map(|key| self.text(key));
        cited.unwrap_or("a system of its own").to_owned()
    }

    fn unit(&self) -> Option<Unit> {
        let by_size = || {
            let metres = self.double(LINEAR_UNIT_SIZE).filter(|metres| *metres > 0.0)?;
            let word = Argument::Word(metres.to_string());
            Unit::of(&Node::new("UNIT", vec![Argument::Text("unit of the file".to_owned()), word]))
        };
        match self.code(LINEAR_UNITS)? {
            USER_DEFINED => by_size(),
            code => Unit::by_code(u32::from(code)),
        }
    }

    /// What the keys state; `None` where they state no system.
    pub fn stated(&self) -> Option<Stated> {
        let own = |key: u16| self.code(key).filter(|code| *code != USER_DEFINED).map(u32::from);
        let Some(model) = self.code(MODEL_TYPE).or_else(|| own(PROJECTED).map(|_| 1)) else {
            // Without a model and a code keys state no more than a unit.
            return self.unit().filter(|unit| !unit.is_metre()).map(|unit| Stated::local(&self.name(), Some(unit)));
        };
        if let Some(text) = self.pe_string().filter(|_| own(PROJECTED).is_none()) {
            return Some(Stated::of_prj(text.as_bytes()));
        }
        Some(match model {
            1 => self.projected(own(PROJECTED)).unwrap_or_else(Stated::unknown),
            model @ (2 | 3) => {
                let kind = if model == 2 { Kind::Geographic } else { Kind::Geocentric };
                let named = own(GEODETIC).and_then(|code| Stated::from_epsg(code, None).ok());
                let name = named.map_or_else(|| self.name(), |stated| stated.name);
                Stated { kind, ..Stated::local(&name, None) }
            }
            _ => Stated::local(&self.name(), self.unit()),
        })
    }

    fn projected(&self, code: Option<u32>) -> Result<Stated, String> {
        let mut stated = match code {
            Some(code) => Stated::from_epsg(code, None)?,
            None => self.described(),
        };
        if let Some(code) = self.code(VERTICAL) {
            self.add_heights(&mut stated, code);
        }
        // A file may say that it is in another unit than its code.
        if let Some(unit) = self.unit()
            && stated.unit.as_ref() != Some(&unit)
        {
            stated.name = format!("{} in {}", stated.name, unit.name);
            stated.node = stated.node.filter(|_| stated.unit.is_none());
            stated.unit = Some(unit);
        }
        let height = self.code(VERTICAL_UNITS).and_then(|code| Unit::by_code(u32::from(code)));
        stated.vertical_unit = height.or(stated.vertical_unit);
        Ok(stated)
    }

    /// Adds the system of heights of a code, or notes that it is not known.
    fn add_heights(&self, stated: &mut Stated, code: u16) {
        let is_named_depth =
            || self.text(VERTICAL_CITATION).is_some_and(|name| name.to_ascii_lowercase().contains("depth"));
        if is_depths(u32::from(code)) || code == USER_DEFINED && is_named_depth() {
            let cited = self.text(VERTICAL_CITATION).map_or_else(String::new, |name| format!(" ({name})"));
            stated.name = format!("{} with heights EPSG:{code}{cited}", stated.name);
            stated.kind = Kind::Depths;
            return;
        }
        let known = Some(u32::from(code)).filter(|code| *code != u32::from(USER_DEFINED)).and_then(vertical_definition);
        match (known, &stated.node) {
            (Some(heights), Some(horizontal)) => {
                let node = compound(horizontal, &heights);
                node.name().clone_into(&mut stated.name);
                stated.vertical_unit = linear_unit(&heights);
                stated.node = Some(node);
            }
            // Of a system that cannot be carried on its heights cannot be either.
            (Some(_), None) => {}
            (None, _) => {
                let code = if code == USER_DEFINED { "without a code".to_owned() } else { format!("EPSG:{code}") };
                let cited = self.text(VERTICAL_CITATION).filter(|text| !text.is_empty());
                stated.unknown_heights = Some(cited.map_or_else(|| code.clone(), |text| format!("{text}, {code}")));
            }
        }
    }

    /// A system that the keys describe by its projection, where it is one of the usual ones.
    fn described(&self) -> Stated {
        let unit = self.unit();
        let name = self.name();
        let built = || {
            let base = definition(u32::from(self.code(GEODETIC)?)).filter(|node| node.keyword == "GEOGCS")?;
            let method = self.code(METHOD)?;
            let (_, projection, parameters) = PROJECTIONS.iter().find(|(known, ..)| *known == method)?;
            let unit = unit.clone()?;
            let text = |text: &str| Argument::Text(text.to_owned());
            let word = |number: f64| Argument::Word(number.to_string());
            let node = |keyword, arguments| Argument::Node(Node::new(keyword, arguments));
            let mut arguments = vec![text(&name), Argument::Node(base), node("PROJECTION", vec![text(projection)])];
            for (key, parameter) in *parameters {
                // Files of different ages use the keys of the natural origin and those of a false one.
                let value = self.double(*key).or_else(|| self.double(alternative(*key)?))?;
                arguments.push(node("PARAMETER", vec![text(parameter), word(value)]));
            }
            arguments.push(node("UNIT", vec![text(&unit.name), word(unit.metres)]));
            Some(Node::new("PROJCS", arguments))
        };
        Stated { kind: Kind::Projected, node: built(), ..Stated::local(&name, unit) }
    }
}

fn alternative(key: u16) -> Option<u16> {
    let pairs = [(3085, 3081), (3084, 3080), (3086, 3082), (3087, 3083)];
    pairs.iter().find(|(one, _)| *one == key).map(|(_, other)| *other)
}

/// The system that keys are written for: none state heights above the ellipsoid in a way that GDAL reads, so these are in our own metadata only.
fn shown(crs: &Crs) -> Crs {
    if Heights::of(&crs.node()) == Heights::Ellipsoid { crs.horizontal() } else { crs.clone() }
}

/// The codes that say all of a system, of the map and of heights; `None` where only its text does.
fn codes(crs: &Crs) -> Option<(u16, Option<u16>)> {
    let narrow = |code: u32| u16::try_from(code).ok().filter(|code| *code < USER_DEFINED);
    let plane = narrow(crs.epsg()?)?;
    if !crs.has_heights() {
        return Some((plane, None));
    }
    Some((plane, Some(narrow(crs.vertical_epsg()?)?)))
}

/// Number of the model of a system: one without code is a text, which GDAL reads where the model is user-defined.
pub fn model(crs: &Crs) -> u16 {
    if codes(&shown(crs)).is_some() { 1 } else { USER_DEFINED }
}

/// The minor revision of a directory: GDAL takes heights from files of GeoTIFF 1.1 on only.
pub fn minor_revision(keys: &[[u16; 4]]) -> u16 {
    u16::from(keys.iter().any(|[key, ..]| *key == VERTICAL))
}

/// The keys of a system in metres, to follow those of the raster, and the texts they refer to, which begin at byte `at`.
pub fn written(crs: &Crs, at: usize) -> (Vec<[u16; 4]>, String) {
    let crs = shown(crs);
    let codes = codes(&crs);
    let mut keys = Vec::new();
    let mut ascii = String::new();
    if let Some((code, _)) = codes {
        keys.push([PROJECTED, 0, 1, code]);
    } else {
        ascii = format!("{PE_STRING}{}|", crs.wkt());
        keys.push([PROJECTED, 0, 1, USER_DEFINED]);
        keys.push([PROJECTED_CITATION, ASCII, ascii.len() as u16, at as u16]);
    }
    keys.push([LINEAR_UNITS, 0, 1, METRE]);
    if let Some((_, Some(code))) = codes {
        keys.push([VERTICAL, 0, 1, code]);
        keys.push([VERTICAL_UNITS, 0, 1, METRE]);
    }
    (keys, ascii)
}
