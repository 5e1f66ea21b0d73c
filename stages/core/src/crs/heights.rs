//! Systems of heights by their EPSG codes.

use super::parts;
use super::wkt::{Argument, Node};

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
    (7837, "DHHN2016 height", "Deutsches Haupthoehennetz 2016", 1170),
    (7839, "NZVD2016 height", "New Zealand Vertical Datum 2016", 1169),
    (8841, "MVGC height", "MOMRA Vertical Geodetic Control", 1219),
    (9389, "EVRF2019 height", "European Vertical Reference Frame 2019", 1274),
    (9458, "AVWS height", "Australian Vertical Working Surface", 1292),
    (9650, "Baltic 1986 height", "Baltic 1986", 1296),
    (9651, "EVRF2007-PL height", "European Vertical Reference Frame 2007 Poland", 1297),
];

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
