//! Systems in several dialects, units, contradictions and refusals.

use super::geo_keys::{GeoKeys, written};
use super::*;
use crate::Entry;
use crate::testing::TestHost;
use crate::{Context, StageError};

/// UTM zone 33 as ESRI writes it: no codes, other names.
const ESRI: &str = r#"PROJCS["WGS_1984_UTM_Zone_33N",GEOGCS["GCS_WGS_1984",DATUM["D_WGS_1984",SPHEROID["WGS_1984",6378137.0,298.257223563]],PRIMEM["Greenwich",0.0],UNIT["Degree",0.0174532925199433]],PROJECTION["Transverse_Mercator"],PARAMETER["False_Easting",500000.0],PARAMETER["False_Northing",0.0],PARAMETER["Central_Meridian",15.0],PARAMETER["Scale_Factor",0.9996],PARAMETER["Latitude_Of_Origin",0.0],UNIT["Meter",1.0]]"#;

fn crs(text: &str) -> Crs {
    text.parse().unwrap()
}

#[test]
fn one_system_in_several_dialects_is_one() {
    assert_eq!(crs(ESRI).as_str(), "EPSG:32633");
    assert_eq!(crs(&crs("epsg:32633").wkt()), crs("EPSG:32633"));
    assert_eq!(crs("EPSG:7415").as_str(), "EPSG:28992+5709");
    assert!(crs("EPSG:28992").agrees_with(&crs("EPSG:7415")));
    assert!(!crs("EPSG:28356").agrees_with(&crs("EPSG:7856")), "GDA94 and GDA2020 lie 1.8 m apart");
    assert!(!crs("EPSG:32633").agrees_with(&crs("EPSG:25833")));
    let custom = ESRI.replace("15.0", "15.5");
    assert!(crs(&custom).as_str().starts_with("PROJCS[") && crs(&custom).epsg().is_none());
    assert_eq!(crs(crs(&custom).as_str()), crs(&custom));
}

#[test]
fn what_is_not_metric_is_no_system_to_carry() {
    for text in
        ["EPSG:4326", "EPSG:4978", "EPSG:2927", "EPSG:99999", "EPSG:5703", "hello", "LOCAL_CS[\"x\",UNIT[\"metre\",1]]"]
    {
        assert!(text.parse::<Crs>().is_err(), "{text}");
    }
}

fn settled(
    file: Option<Stated>,
    given: Option<&str>,
    first: Option<[f64; 3]>,
) -> (Result<Settled, StageError>, Vec<String>, Vec<String>) {
    let host = TestHost::default();
    let given = given.map(|name| CrsName(name.to_owned()));
    let result = settle("a.laz", [file, None], given.as_ref(), (Tool::Pdal, first), &Context::new(&host));
    let notes = host
        .entries
        .lock()
        .unwrap()
        .iter()
        .filter_map(|e| if let Entry::Note { text } = e { Some(text.clone()) } else { None })
        .collect();
    (result, host.warnings(), notes)
}

#[test]
fn feet_become_metres_with_a_warning_and_a_system_of_their_own() {
    let stated = Stated::from_epsg(2927, None).unwrap();
    let (settled, warnings, _) = settled(Some(stated), None, None);
    let settled = settled.unwrap();
    assert!(
        (settled.horizontal - 1200.0 / 3937.0).abs() < 1e-18
            && settled.vertical.to_bits() == settled.horizontal.to_bits()
    );
    assert!(
        warnings.len() == 1 && warnings[0].contains("US survey feet") && warnings[0].contains("taken for the same"),
        "{warnings:?}"
    );
    let crs = settled.crs.unwrap();
    assert_eq!((crs.epsg(), crs.name().as_str()), (None, "NAD83(HARN) / Washington South (ftUS), in metres"));
    assert!(
        crs.wkt().contains("PARAMETER[\"false_easting\",500000.0001016") && crs.wkt().contains("UNIT[\"metre\",1"),
        "{}",
        crs.wkt()
    );
    assert_eq!(crs.as_str().parse::<Crs>().unwrap(), crs);
}

#[test]
fn degrees_and_geocentric_coordinates_are_refused_with_the_zone() {
    let (error, ..) = settled(Some(Stated::from_epsg(4326, None).unwrap()), None, Some([151.2, -33.9, 5.0]));
    let error = error.unwrap_err();
    assert!(error.message.contains("longitudes and latitudes in degrees (WGS 84, EPSG:4326)"), "{error}");
    assert!(error.hint.unwrap().contains("out_srs=EPSG:32756"));
    let (error, ..) =
        settled(Some(Stated::from_epsg(4978, None).unwrap()), None, Some([3_970_000.0, 1_020_000.0, 4_870_000.0]));
    let error = error.unwrap_err();
    assert!(error.message.contains("from the centre of the Earth") && error.hint.unwrap().contains("EPSG:32633"));
}

#[test]
fn maps_of_the_world_are_refused_for_their_lengths() {
    for code in [3857, 3395] {
        let stated = Stated::from_epsg(code, None).unwrap();
        assert_eq!(stated.kind, Kind::WorldMap, "EPSG:{code}");
        let error = settled(Some(stated), None, Some([1_700_000.0, 5_600_000.0, 300.0])).0.unwrap_err();
        assert!(error.message.contains("whose lengths are not those on the ground"), "{error}");
        assert!(error.hint.unwrap().contains("EPSG:32633"));
    }
    let esri = "PROJCS[\"WGS_1984_Web_Mercator_Auxiliary_Sphere\",GEOGCS[\"GCS_WGS_1984\",DATUM[\"D_WGS_1984\",\
                SPHEROID[\"WGS_1984\",6378137.0,298.257223563]],PRIMEM[\"Greenwich\",0.0],UNIT[\"Degree\",0.0174532925199433]],\
                PROJECTION[\"Mercator_Auxiliary_Sphere\"],UNIT[\"Meter\",1.0]]";
    assert_eq!(Stated::of_prj(esri.as_bytes()).kind, Kind::WorldMap);
    // Maps of a region, whose scale holds there.
    for code in [3001, 3388, 2056, 28992] {
        assert_eq!(Stated::from_epsg(code, None).unwrap().kind, Kind::Projected, "EPSG:{code}");
    }
}

#[test]
fn contradictions_are_refused_and_silence_is_noted() {
    let utm = || Stated::from_epsg(32633, None).unwrap();
    let error = settled(Some(utm()), Some("EPSG:28356"), None).0.unwrap_err();
    assert!(
        error.message.contains("`a.laz` itself states WGS 84 / UTM zone 33N, EPSG:32633, parameter `crs` GDA94"),
        "{error}"
    );
    let agreed = settled(Some(utm()), Some("EPSG:32633"), None).0.unwrap();
    assert_eq!(agreed.crs, Some(crs("EPSG:32633")));
    let (silent, warnings, notes) = settled(None, None, None);
    assert_eq!((silent.unwrap(), warnings.len()), (Settled::metres(), 0));
    assert!(notes[0].contains("`crs: EPSG:...` states one"), "{notes:?}");
    let unread = settled(Some(Stated::unknown("EPSG:1".into())), None, None).0.unwrap_err();
    assert!(unread.hint.unwrap().contains("crs: EPSG"));
    assert_eq!(settled(Some(Stated::unknown("EPSG:1".into())), Some("EPSG:32633"), None).0.unwrap(), agreed);
}

#[test]
fn keys_state_systems_and_are_written_for_them() {
    let stated = |directory: &[u16]| GeoKeys { directory, doubles: &[], ascii: "" }.stated();
    let utm = stated(&[1, 1, 0, 2, 1024, 0, 1, 1, 3072, 0, 1, 32633]).unwrap();
    assert_eq!((utm.kind, utm.name.as_str()), (Kind::Projected, "WGS 84 / UTM zone 33N, EPSG:32633"));
    assert_eq!(stated(&[1, 1, 0, 2, 1024, 0, 1, 2, 2048, 0, 1, 4326]).unwrap().kind, Kind::Geographic);
    assert_eq!(stated(&[1, 1, 0, 1, 1024, 0, 1, 32767]).unwrap().kind, Kind::Local);
    assert_eq!(stated(&[]), None);
    assert_eq!(stated(&[1, 1, 0, 2, 1024, 0, 1, 1, 3072, 0, 1, 1999]).unwrap().kind, Kind::Unknown);
    let feet = stated(&[1, 1, 0, 3, 1024, 0, 1, 1, 3072, 0, 1, 32633, 3076, 0, 1, 9002]).unwrap();
    assert_eq!(feet.unit, Unit::by_code(9002));
    let custom = crs(&ESRI.replace("15.0", "15.5"));
    for system in [crs("EPSG:28356"), crs("EPSG:7415"), crs("EPSG:25832+7837"), custom] {
        let (keys, ascii) = written(&system, 0);
        let mut directory = vec![1, 1, 0, keys.len() as u16 + 1, 1024, 0, 1, super::geo_keys::model(&system)];
        directory.extend(keys.as_flattened());
        let stated = GeoKeys { directory: &directory, doubles: &[], ascii: &ascii }.stated().unwrap();
        assert_eq!(Crs::of_node(&stated.node.unwrap()), system);
    }
}

#[test]
fn heights_are_kept_or_their_loss_is_warned_of() {
    let keys = |height: u16| {
        let directory = [1, 1, 0, 4, 1024, 0, 1, 1, 3072, 0, 1, 25832, 4096, 0, 1, height, 4099, 0, 1, 9001];
        GeoKeys { directory: &directory, doubles: &[], ascii: "" }.stated().unwrap()
    };
    for (height, known) in [(5709, "EPSG:25832+5709"), (7837, "EPSG:25832+7837")] {
        let (result, warnings, _) = settled(Some(keys(height)), None, None);
        assert_eq!((result.unwrap().crs, warnings.len()), (Some(crs(known)), 0));
    }
    let (result, warnings, _) = settled(Some(keys(5030)), None, None);
    assert_eq!(result.unwrap().crs, Some(crs("EPSG:25832")));
    assert!(
        warnings.len() == 1 && warnings[0].contains("EPSG:5030") && warnings[0].contains("EPSG:25832+"),
        "{warnings:?}"
    );
    let (result, warnings, _) = settled(Some(keys(5030)), Some("EPSG:25832+7837"), None);
    assert_eq!((result.unwrap().crs, warnings.len()), (Some(crs("EPSG:25832+7837")), 0));
    let without_code = GeoKeys {
        directory: &[1, 1, 0, 4, 1024, 0, 1, 1, 3072, 0, 1, 25832, 4096, 0, 1, 32767, 4097, 34737, 9, 0],
        doubles: &[],
        ascii: "our gauge|",
    };
    let (_, warnings, _) = settled(without_code.stated(), None, None);
    assert!(warnings.len() == 1 && warnings[0].contains("our gauge, without a code"), "{warnings:?}");
    let refused = "EPSG:25832+4326".parse::<Crs>().unwrap_err();
    assert!(refused.contains("EPSG:4326 is not among the systems of heights") && refused.contains("5709"), "{refused}");
}

#[test]
fn a_described_projection_is_rebuilt() {
    let directory = [
        1, 1, 0, 10, 1024, 0, 1, 1, 2048, 0, 1, 4152, 3072, 0, 1, 32767, 3075, 0, 1, 8, 3076, 0, 1, 9002, 3078, 34736,
        1, 0, 3079, 34736, 1, 1, 3084, 34736, 1, 2, 3085, 34736, 1, 3, 3086, 34736, 1, 4,
    ];
    let mut directory = directory.to_vec();
    directory.extend([3087, 34736, 1, 5]);
    directory[3] = 11;
    let doubles = [43.0, 45.5, -120.5, 41.75, 1_312_335.958_005_249, 0.0];
    let stated = GeoKeys { directory: &directory, doubles: &doubles, ascii: "" }.stated().unwrap();
    assert_eq!((stated.unit.as_ref().unwrap().name.as_str(), stated.node.is_some()), ("international feet", true));
    let (settled, warnings, _) = settled(Some(stated), None, None);
    let wkt = settled.unwrap().crs.unwrap().wkt();
    let easting = wkt.split("\"false_easting\",").nth(1).unwrap().split(']').next().unwrap();
    assert!((easting.parse::<f64>().unwrap() - 400_000.0).abs() < 1e-6 && warnings.len() == 1, "{wkt}");
}

#[test]
fn every_code_of_the_table_is_read() {
    let mut kinds = std::collections::BTreeMap::new();
    for code in 0..=u16::MAX {
        // A few systems have no definition in well-known text.
        if crs_definitions::from_code(code).is_some_and(|known| !known.wkt.is_empty()) {
            let stated = Stated::from_epsg(u32::from(code), None).unwrap_or_else(|e| panic!("EPSG:{code}: {e}"));
            *kinds.entry(format!("{:?}", stated.kind)).or_insert(0) += 1;
            assert!(stated.kind != Kind::Projected || stated.unit.is_some(), "EPSG:{code}");
        }
    }
    assert!(kinds["Projected"] > 4900 && kinds["Geographic"] > 500 && kinds["Geocentric"] > 150, "{kinds:?}");
}
