//! Systems of heights by their EPSG codes.

use super::wkt::{Argument, Node};
use super::{parts, signature, stated};

/// Codes of systems with heights, in which vertical systems are looked for.
const COMPOUND_CODES: std::ops::RangeInclusive<u16> = 3901..=8912;

/// Code, name, datum and code of the datum of systems in metres upwards that no compound system of the table has (EPSG registry).
const FURTHER: &[(u32, &str, &str, u32)] = &[
    (4440, "NZVD2009 height", "New Zealand Vertical Datum 2009", 1039),
    (5195, "Trieste height", "Trieste", 1050),
    (5214, "Genoa 1942 height", "Genoa 1942", 1051),
    (5237, "SLVD height", "Sri Lanka Vertical Datum", 1054),
    (5705, "Baltic 1977 height", "Baltic 1977", 5105),
    (5711, "AHD height", "Australian Height Datum", 5111),
    (5713, "CGVD28 height", "Canadian Geodetic Vertical Datum of 1928", 5114),
    (5714, "MSL height", "Mean Sea Level", 5100),
    (5728, "LN02 height", "Landesnivellement 1902", 5127),
    (5729, "LHN95 height", "Landeshohennetz 1995", 5128),
    (5757, "Guadeloupe 1988 height", "Guadeloupe 1988", 5155),
    (5758, "Reunion 1989 height", "Reunion 1989", 5156),
    (5773, "EGM96 height", "EGM96 geoid", 5171),
    (5775, "Antalya height", "Antalya", 5173),
    (5777, "Durres height", "Durres", 5175),
    (5778, "GHA height", "Gebrauchshohen ADRIA", 5176),
    (5779, "SVS2000 height", "Slovenian Vertical System 2000", 5177),
    (5780, "Cascais height", "Cascais", 5178),
    (5782, "Alicante height", "Alicante", 5180),
    (5784, "DHHN85 height", "Deutsches Haupthoehennetz 1985", 5182),
    (5785, "SNN76 height", "Staatlichen Nivellementnetzes 1976", 5183),
    (5786, "Baltic 1982 height", "Baltic 1982", 5184),
    (5787, "EOMA 1980 height", "Baltic 1980", 5185),
    (5798, "EGM84 height", "EGM84 geoid", 5203),
    (7962, "Poolbeg height (m)", "Poolbeg", 5152),
    (7968, "NGVD29 height (m)", "National Geodetic Vertical Datum 1929", 5102),
    (7837, "DHHN2016 height", "Deutsches Haupthoehennetz 2016", 1170),
    (7839, "NZVD2016 height", "New Zealand Vertical Datum 2016", 1169),
    (8841, "MVGC height", "MOMRA Vertical Geodetic Control", 1219),
    (9389, "EVRF2019 height", "European Vertical Reference Frame 2019", 1274),
    (9458, "AVWS height", "Australian Vertical Working Surface", 1292),
    (9650, "Baltic 1986 height", "Baltic 1986", 1296),
    (9651, "EVRF2007-PL height", "European Vertical Reference Frame 2007 Poland", 1297),
];

/// Systems in feet, and those in metres above the same datum (EPSG registry).
const IN_METRES: &[(u32, u32)] = &[(5702, 7968), (5754, 7962), (6360, 5703), (8050, 5714), (8052, 5714), (8228, 5703)];

/// Systems of depths, which count downwards, and those of heights in metres above the same datum; 0 where there is none (EPSG registry).
const DEPTHS: &[(u32, u32)] = &[
    (5336, 5735),
    (5612, 5705),
    (5614, 7979),
    (5706, 5611),
    (5715, 5714),
    (5734, 5797),
    (5739, 0),
    (5789, 7979),
    (5831, 5829),
    (5861, 0),
    (5862, 0),
    (5863, 0),
    (5864, 0),
    (5865, 0),
    (5866, 0),
    (5867, 0),
    (5873, 0),
    (6357, 5703),
    (6358, 5703),
    (6359, 7968),
    (7976, 5738),
    (8051, 5714),
    (8053, 5714),
    (8358, 8357),
    (8378, 0),
    (8897, 0),
    (9287, 0),
    (9288, 0),
    (9672, 0),
    (10150, 0),
    (10151, 0),
    (10349, 0),
    (10364, 5780),
    (10370, 6178),
    (10371, 6179),
    (10372, 6185),
    (10373, 6181),
    (10374, 6182),
    (10375, 6180),
    (10376, 6183),
    (10377, 6184),
    (10378, 6187),
    (10379, 6186),
    (10547, 0),
    (10548, 0),
    (10549, 0),
    (10550, 0),
    (10551, 0),
    (10552, 0),
    (10649, 0),
    (10650, 0),
    (10678, 0),
];

/// Whether a code is of depths.
pub fn is_depths(code: u32) -> bool {
    DEPTHS.iter().any(|(depths, _)| *depths == code)
}

/// The code of the heights in metres above the datum of depths, where the registry has any.
pub fn heights_for_depths(code: u32) -> Option<u32> {
    let (_, heights) = DEPTHS.iter().find(|(depths, _)| *depths == code)?;
    Some(*heights).filter(|heights| *heights > 0)
}

/// Whether a vertical system counts downwards: by its axis, or by the sign that ESRI gives it.
pub fn points_down(node: &Node) -> bool {
    let is_down = |child: &Node| match child.keyword.as_str() {
        "AXIS" => matches!(child.arguments.get(1), Some(Argument::Word(way)) if way.eq_ignore_ascii_case("down")),
        "PARAMETER" => child.name().eq_ignore_ascii_case("direction") && child.number(1).is_some_and(|sign| sign < 0.0),
        _ => false,
    };
    node.nodes().any(is_down) || node.epsg().is_some_and(is_depths)
}

/// The system in metres above the datum of one in feet, where the registry has it.
pub fn metric_of(node: &Node) -> Option<Node> {
    if let Some(code) = node.epsg() {
        let (_, metric) = IN_METRES.iter().find(|(feet, _)| *feet == code)?;
        return vertical_definition(*metric);
    }
    let datum = |node: &Node| {
        let datum = node.child(&["VERT_DATUM", "VDATUM", "VRF", "VERTICALDATUM", "ENSEMBLE"])?;
        Some(signature::plain(datum.name()))
    };
    let wanted = datum(node)?;
    let is_metric = |node: &Node| stated::linear_unit(node).is_some_and(|unit| unit.is_metre()) && !points_down(node);
    let all = compound_texts().filter_map(vertical_part).chain(FURTHER.iter().map(built));
    let mut found = all.filter(|known| is_metric(known) && datum(known).as_ref() == Some(&wanted));
    let first = found.next()?;
    found.all(|other| other.epsg() == first.epsg()).then_some(first)
}

/// The definition of a vertical system: from a compound one that has it, or from the list here.
pub fn vertical_definition(code: u32) -> Option<Node> {
    let stated = format!("\"EPSG\",\"{code}\"");
    let compounds = compound_texts().filter(|text| text.contains(&stated));
    let of_compound = compounds.filter_map(vertical_part).find(|node| node.epsg() == Some(code));
    of_compound.or_else(|| FURTHER.iter().find(|(known, ..)| *known == code).map(built))
}

/// The codes of all vertical systems that are known, in ascending order.
pub fn known_codes() -> Vec<u32> {
    let of_compounds = compound_texts().filter_map(|text| vertical_part(text)?.epsg());
    let codes: std::collections::BTreeSet<u32> = of_compounds.chain(FURTHER.iter().map(|(code, ..)| *code)).collect();
    codes.into_iter().collect()
}

fn compound_texts() -> impl Iterator<Item = &'static str> {
    let texts = COMPOUND_CODES.filter_map(|known| Some(crs_definitions::from_code(known)?.wkt));
    texts.filter(|text| text.starts_with("COMPD_CS"))
}

fn vertical_part(text: &str) -> Option<Node> {
    parts(&Node::parse(text).ok()?).1.cloned()
}

fn built((code, name, datum, datum_code): &(u32, &str, &str, u32)) -> Node {
    let text = |text: &str| Argument::Text(text.to_owned());
    let word = |number: u32| Argument::Word(number.to_string());
    let node = |keyword: &str, arguments: Vec<Argument>| Argument::Node(Node::new(keyword, arguments));
    let authority = |code: u32| node("AUTHORITY", vec![text("EPSG"), text(&code.to_string())]);
    // 2005 is the type of all datums of heights in well-known text (OGC 01-009).
    let datum = node("VERT_DATUM", vec![text(datum), word(2005), authority(*datum_code)]);
    let unit = node("UNIT", vec![text("metre"), word(1), authority(9001)]);
    let axis = node("AXIS", vec![text("Gravity-related height"), Argument::Word("UP".to_owned())]);
    Node::new("VERT_CS", vec![text(name), datum, unit, axis, authority(*code)])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heights_in_feet_become_those_in_metres_above_their_datum() {
        for (feet, metric) in IN_METRES {
            let found = vertical_definition(*metric).unwrap_or_else(|| panic!("EPSG:{metric}"));
            assert!(!points_down(&found) && found.epsg() == Some(*metric), "EPSG:{feet}");
        }
        let esri = |datum: &str| {
            let text = format!("VERTCS[\"of a file\",VDATUM[\"{datum}\"],UNIT[\"Foot_US\",0.3048006096012192]]");
            metric_of(&Node::parse(&text).unwrap()).and_then(|node| node.epsg())
        };
        assert_eq!(esri("North_American_Vertical_Datum_1988"), Some(5703));
        assert_eq!((esri("National_Geodetic_Vertical_Datum_1929"), esri("our gauge")), (Some(7968), None));
    }

    #[test]
    fn depths_are_told_from_heights() {
        assert!(
            DEPTHS.is_sorted()
                && known_codes().iter().all(|code| {
                    vertical_definition(*code).is_some_and(|node| points_down(&node)) == is_depths(*code)
                })
        );
        assert_eq!((heights_for_depths(6357), heights_for_depths(5739)), (Some(5703), None));
        assert!(is_depths(5739) && !is_depths(5703));
    }

    #[test]
    fn every_listed_system_is_found_by_its_code_in_metres() {
        let codes = known_codes();
        for (code, name, ..) in FURTHER {
            let node = vertical_definition(*code).unwrap();
            assert_eq!((node.epsg(), node.name()), (Some(*code), *name), "a compound system has EPSG:{code} too");
            assert!(super::super::stated::linear_unit(&node).unwrap().is_metre() && codes.contains(code));
        }
        assert!(codes.contains(&5709) && !codes.contains(&4326), "{codes:?}");
        assert_eq!(vertical_definition(4326), None);
    }
}
