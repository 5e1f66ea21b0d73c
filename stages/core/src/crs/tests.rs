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

fn of_feet(code: u32) -> Result<Settled, StageError> {
    settled(Some(Stated::from_epsg(code, None).unwrap()), None, None).0
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
    // Its false easting is that of the system in metres to a tenth of a millimetre.
    assert_eq!((crs.epsg(), crs.name().as_str()), (Some(2856), "NAD83(HARN) / Washington South"));
    // There is no such system in metres.
    let crs = of_feet(26741).unwrap().crs.unwrap();
    assert_eq!((crs.epsg(), crs.name().as_str()), (None, "NAD27 / California zone I, in metres"));
    assert!(
        crs.wkt().contains("PARAMETER[\"false_easting\",609601.2192") && crs.wkt().contains("UNIT[\"metre\",1"),
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
    // Others are told by the scale at the site, here at 10 degrees east and 60 degrees north.
    let at_60 = [
        (4087, [1_113_194.9, 6_679_169.4]),
        (32662, [1_113_194.9, 6_679_169.4]),
        (3832, [-15_584_728.7, 8_362_698.5]),
        (6933, [964_862.8, 6_347_032.7]),
        (3410, [962_865.6, 6_366_654.4]),
        (3994, [-7_586_066.0, 6_340_394.0]),
        (3388, [-3_400_000.0, 6_206_000.0]),
    ];
    for (code, [x, y]) in at_60 {
        let stated = Stated::from_epsg(code, None).unwrap();
        let error = settled(Some(stated), None, Some([x, y, 300.0])).0.unwrap_err();
        assert!(error.message.contains("a map whose lengths at the site are"), "EPSG:{code}: {error}");
    }
    for method in ["Mollweide", "Robinson", "Sinusoidal", "Eckert_IV", "Interrupted_Goode_Homolosine", "Winkel_I"] {
        let text = esri("D_WGS_1984", [6_378_137.0, 298.257_223_563], method, &[("Central_Meridian", 0.0)]);
        assert_eq!(Stated::of_prj(text.as_bytes()).kind, Kind::WorldMap, "{method}");
    }
    let behrmann = esri("D_WGS_1984", [6_378_137.0, 298.257_223_563], "Behrmann", &[("Central_Meridian", 0.0)]);
    assert!(settled(Some(Stated::of_prj(behrmann.as_bytes())), None, Some([964_862.8, 6_347_032.7, 0.0])).0.is_err());
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
    let gauge = "VERT_CS[\"our gauge\",VERT_DATUM[\"our gauge\",2005],UNIT[\"metre\",1],AXIS[\"Up\",UP]]";
    let gauge = crs(&format!("COMPD_CS[\"both\",{},{gauge}]", crs("EPSG:25832").wkt()));
    for system in [crs("EPSG:28356"), crs("EPSG:7415"), crs("EPSG:25832+7837"), custom, gauge] {
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

/// A projected system as ESRI writes it, in degrees and metres: datum, ellipsoid, projection, parameters.
fn esri(datum: &str, [axis, flattening]: [f64; 2], projection: &str, parameters: &[(&str, f64)]) -> String {
    let parameters: Vec<String> =
        parameters.iter().map(|(name, value)| format!("PARAMETER[\"{name}\",{value:?}]")).collect();
    format!(
        "PROJCS[\"of a file\",GEOGCS[\"its own\",DATUM[\"{datum}\",SPHEROID[\"its own\",{axis:?},{flattening:?}]],PRIMEM[\"Greenwich\",0.0],\
         UNIT[\"Degree\",0.017_453_292_519_943_3]],PROJECTION[\"{projection}\"],{},UNIT[\"Meter\",1.0]]",
        parameters.join(",")
    )
}

#[test]
fn a_system_with_its_axes_in_another_order_does_not_count_beside_another() {
    let utm = |axes: &str| {
        format!(
            "PROJCS[\"ETRS_1989_UTM_Zone_32N\",GEOGCS[\"GCS_ETRS_1989\",DATUM[\"D_ETRS_1989\",SPHEROID[\"GRS_1980\",6378137.0,298.257222101]],\
             PRIMEM[\"Greenwich\",0.0],UNIT[\"Degree\",0.0174532925199433]],PROJECTION[\"Transverse_Mercator\"],PARAMETER[\"False_Easting\",500000.0],\
             PARAMETER[\"False_Northing\",0.0],PARAMETER[\"Central_Meridian\",9.0],PARAMETER[\"Scale_Factor\",0.9996],\
             PARAMETER[\"Latitude_Of_Origin\",0.0],UNIT[\"Meter\",1.0]{axes}]"
        )
    };
    let code = |text: &str| signature::find(&Node::parse(text).unwrap());
    assert_eq!(code(&utm("")), Some(25832));
    assert_eq!(code(&utm(",AXIS[\"E\",EAST],AXIS[\"N\",NORTH]")), Some(25832));
    // Beside 25835 there are 3047, and 3067 and 5048 of Finland.
    assert_eq!(code(&utm("").replace("Meridian\",9.0", "Meridian\",27.0")), Some(25835));
    let crs = |code: u32| format!("EPSG:{code}").parse::<Crs>().unwrap();
    assert!(
        crs(25832).agrees_with(&crs(3044))
            && !crs(25832).agrees_with(&crs(25833))
            && !crs(25832).agrees_with(&crs(32632))
    );
    let german = "PROJCS[\"DHDN_3_Degree_Gauss_Zone_3\",GEOGCS[\"GCS_Deutsches_Hauptdreiecksnetz\",DATUM[\"D_Deutsches_Hauptdreiecksnetz\",\
        SPHEROID[\"Bessel_1841\",6377397.155,299.1528128]],PRIMEM[\"Greenwich\",0.0],UNIT[\"Degree\",0.0174532925199433]],\
        PROJECTION[\"Gauss_Kruger\"],PARAMETER[\"False_Easting\",3500000.0],PARAMETER[\"False_Northing\",0.0],\
        PARAMETER[\"Central_Meridian\",9.0],PARAMETER[\"Scale_Factor\",1.0],PARAMETER[\"Latitude_Of_Origin\",0.0],UNIT[\"Meter\",1.0]]";
    assert_eq!(code(german), Some(31467));
}

const INTERNATIONAL: [f64; 2] = [6_378_388.0, 297.0];
const BESSEL: [f64; 2] = [6_377_397.155, 299.152_812_8];

fn utm(datum: &str, ellipsoid: [f64; 2], meridian: f64, northing: f64) -> String {
    let parameters = [
        ("False_Easting", 500_000.0),
        ("False_Northing", northing),
        ("Central_Meridian", meridian),
        ("Scale_Factor", 0.9996),
        ("Latitude_Of_Origin", 0.0),
    ];
    esri(datum, ellipsoid, "Transverse_Mercator", &parameters)
}

#[test]
fn another_datum_on_the_same_ellipsoid_is_another_system() {
    // Aratu lies 210 m from Corrego Alegre, La Canoa 600 m from Bogota.
    assert_eq!(crs(&utm("D_Corrego_Alegre", INTERNATIONAL, -51.0, 1e7)).epsg(), Some(22522));
    assert_eq!(crs(&utm("D_Bogota", INTERNATIONAL, -75.0, 0.0)).epsg(), Some(21818));
    let unknown = crs(&utm("D_Of_The_Mine", INTERNATIONAL, -51.0, 1e7));
    assert!(unknown.epsg().is_none() && !unknown.agrees_with(&crs("EPSG:20822")), "{unknown}");
    // NAD83 and its later realisations lie up to two metres apart, in feet as in metres.
    let metres = |code: u32| of_feet(code).unwrap().crs.unwrap();
    assert!(metres(2229).agrees_with(&metres(2229)) && !metres(2229).agrees_with(&metres(2874)));
    // A code that is not known here is no other one.
    let newer = crs("EPSG:2154").wkt().replace("\"2154\"", "\"9794\"");
    assert_eq!((crs(&newer).epsg(), crs(&newer).agrees_with(&crs("EPSG:2154"))), (Some(9794), false));
}

#[test]
fn national_systems_are_known_as_esri_writes_them() {
    let swiss = [
        ("False_Easting", 2_600_000.0),
        ("False_Northing", 1_200_000.0),
        ("Scale_Factor", 1.0),
        ("Azimuth", 90.0),
        ("Longitude_Of_Center", 7.439_583_333_333_333),
        ("Latitude_Of_Center", 46.952_405_555_555_565),
    ];
    assert_eq!(crs(&esri("D_CH1903+", BESSEL, "Hotine_Oblique_Mercator_Azimuth_Center", &swiss)).epsg(), Some(2056));
    let dutch = [
        ("False_Easting", 155_000.0),
        ("False_Northing", 463_000.0),
        ("Central_Meridian", 5.387_638_888_888_889),
        ("Scale_Factor", 0.999_907_9),
        ("Latitude_Of_Origin", 52.156_160_555_555_55),
    ];
    assert_eq!(crs(&esri("D_Amersfoort", BESSEL, "Double_Stereographic", &dutch)).epsg(), Some(28992));
    let czech = |x_scale: f64| {
        let parameters = [
            ("False_Easting", 0.0),
            ("False_Northing", 0.0),
            ("Pseudo_Standard_Parallel_1", 78.5),
            ("Scale_Factor", 0.9999),
            ("Azimuth", 30.288_139_752_777_78),
            ("Longitude_Of_Center", 24.833_333_333_333_33),
            ("Latitude_Of_Center", 49.5),
            ("X_Scale", x_scale),
            ("Y_Scale", 1.0),
            ("XY_Plane_Rotation", 90.0),
        ];
        Stated::of_prj(esri("D_S_JTSK", BESSEL, "Krovak", &parameters).as_bytes())
    };
    assert!(czech(-1.0).agrees_with(&Stated::from_epsg(5514, None).unwrap()));
    assert_eq!(czech(1.0).kind, Kind::WestSouth);
    // Without axes the text may mean either.
    let plain = crs("EPSG:5514").wkt().replace(",AXIS[\"X\",EAST],AXIS[\"Y\",NORTH]", "");
    let plain = plain.replace(",AUTHORITY[\"EPSG\",\"5514\"]", "");
    assert!(!plain.contains("AXIS") && crs(&plain).epsg().is_none(), "{plain}");
    let french = [
        ("False_Easting", 600_000.0),
        ("False_Northing", 200_000.0),
        ("Central_Meridian", 2.337_229_166_666_667),
        ("Standard_Parallel_1", 46.8),
        ("Scale_Factor", 0.999_877_42),
        ("Latitude_Of_Origin", 46.8),
    ];
    let cone = esri("D_NTF", [6_378_249.2, 293.466_021_293_626_5], "Lambert_Conformal_Conic", &french);
    let tangent = cone.replace("PARAMETER[\"Standard_Parallel_1\",46.8],", "");
    assert!(Stated::of_prj(cone.as_bytes()).agrees_with(&Stated::of_prj(tangent.as_bytes())));
}

#[test]
fn axes_to_the_west_or_south_are_refused() {
    for code in [2048, 5513, 2065] {
        let stated = Stated::from_epsg(code, None).unwrap();
        assert_eq!(stated.kind, Kind::WestSouth, "EPSG:{code}");
        let error = settled(Some(stated), None, None).0.unwrap_err();
        assert!(error.message.contains("to the west or south"), "{error}");
    }
    // Northing before easting is another order of the same numbers, and polar maps have axes that all point south.
    for code in [5514, 31468, 3413, 3031] {
        assert_eq!(Stated::from_epsg(code, None).unwrap().kind, Kind::Projected, "EPSG:{code}");
    }
}

#[test]
fn an_axis_to_the_south_alone_is_refused_too() {
    let utm = |axes: &str| ESRI.replace("UNIT[\"Meter\",1.0]]", &format!("UNIT[\"Meter\",1.0],{axes}]"));
    let kind = |axes: &str| Stated::of_prj(utm(axes).as_bytes()).kind;
    assert_eq!(kind("AXIS[\"E\",EAST],AXIS[\"S\",SOUTH]"), Kind::WestSouth);
    assert_eq!(kind("AXIS[\"S\",SOUTH],AXIS[\"E\",EAST]"), Kind::WestSouth);
    assert_eq!(kind("AXIS[\"X\",SOUTH],AXIS[\"Y\",SOUTH]"), Kind::Projected);
    assert_eq!(kind("AXIS[\"N\",NORTH],AXIS[\"E\",EAST]"), Kind::Projected);
}

#[test]
fn depths_are_refused_with_the_way_to_heights() {
    let refused = |stated: Stated| settled(Some(stated), None, None).0.unwrap_err();
    let heights = "VERT_CS[\"NAVD88 depth\",VERT_DATUM[\"North American Vertical Datum 1988\",2005],UNIT[\"metre\",1],\
                   AXIS[\"Depth\",DOWN],AUTHORITY[\"EPSG\",\"6357\"]]";
    let text = format!("COMPD_CS[\"both\",{},{heights}]", crs("EPSG:26945").wkt());
    let error = refused(Stated::from_wkt(&text).unwrap());
    assert!(error.message.contains("depths, which count downwards"), "{error}");
    assert!(error.hint.unwrap().contains("out_srs=EPSG:26945+5703"));
    let esri = format!("{ESRI},VERTCS[\"depth\",VDATUM[\"x\"],PARAMETER[\"Direction\",-1.0],UNIT[\"Meter\",1.0]]");
    assert!(refused(Stated::of_prj(esri.as_bytes())).hint.unwrap().contains("multiply Z by -1"));
    let wkt2 = text.replace("DOWN", "down").replace(",AUTHORITY[\"EPSG\",\"6357\"]", "");
    assert_eq!(Stated::from_wkt(&wkt2).unwrap().kind, Kind::Depths);
    let keys = [1, 1, 0, 4, 1024, 0, 1, 1, 3072, 0, 1, 26945, 4096, 0, 1, 6357, 4099, 0, 1, 9001];
    let keys = GeoKeys { directory: &keys, doubles: &[], ascii: "" };
    assert!(refused(keys.stated().unwrap()).message.contains("EPSG:6357"));
    let given = settled(None, Some("EPSG:26945+6357"), None).0.unwrap_err();
    assert!(given.message.contains("a system of depths") && given.message.contains("EPSG:5703"), "{given}");
}

/// UTM zone 33 with heights above the ellipsoid, as PROJ writes it.
fn ellipsoidal() -> Stated {
    let text = r#"PROJCRS["WGS 84 / UTM zone 33N",BASEGEOGCRS["WGS 84",DATUM["World Geodetic System 1984",ELLIPSOID["WGS 84",6378137,298.257223563,LENGTHUNIT["metre",1]]],PRIMEM["Greenwich",0,ANGLEUNIT["degree",0.0174532925199433]]],CONVERSION["UTM zone 33N",METHOD["Transverse Mercator",ID["EPSG",9807]],PARAMETER["Latitude of natural origin",0],PARAMETER["Longitude of natural origin",15],PARAMETER["Scale factor at natural origin",0.9996],PARAMETER["False easting",500000,LENGTHUNIT["metre",1]],PARAMETER["False northing",0,LENGTHUNIT["metre",1]]],CS[Cartesian,3],AXIS["(E)",east,ORDER[1],LENGTHUNIT["metre",1]],AXIS["(N)",north,ORDER[2],LENGTHUNIT["metre",1]],AXIS["ellipsoidal height (h)",up,ORDER[3],LENGTHUNIT["metre",1]],REMARK["Promoted to 3D from EPSG:32633"]]"#;
    Stated::from_wkt(text).unwrap()
}

#[test]
fn heights_above_the_ellipsoid_are_kept_and_go_with_no_others() {
    let (result, warnings, _) = settled(Some(ellipsoidal()), None, None);
    let kept = result.unwrap().crs.unwrap();
    assert!(warnings.len() == 1 && warnings[0].contains("above the ellipsoid"), "{warnings:?}");
    assert!(kept.has_heights() && kept.as_str().parse::<Crs>().unwrap() == kept && kept.epsg().is_none(), "{kept:?}");
    assert_eq!(kept.horizontal(), crs("EPSG:32633"));
    // GDAL reads the map alone, as it does of a code.
    assert_eq!(written(&kept, 0), written(&crs("EPSG:32633"), 0));
    assert!(kept.agrees_with(&crs("EPSG:32633")) && !kept.agrees_with(&crs("EPSG:32633+5773")));
    assert_eq!(kept.difference(&crs("EPSG:32633+5773")).unwrap(), "heights: above the ellipsoid, EGM96 height");
    assert!(settled(Some(ellipsoidal()), Some("EPSG:32633+5773"), None).0.is_err());
    let feet = ellipsoidal().node.unwrap().to_string();
    let feet = feet.replace("ORDER[3],LENGTHUNIT[\"metre\",1]", "ORDER[3],LENGTHUNIT[\"foot\",0.3048]");
    let settled = settled(Some(Stated::from_wkt(&feet).unwrap()), None, None).0.unwrap();
    assert!((settled.horizontal - 1.0).abs() < 1e-12 && (settled.vertical - 0.3048).abs() < 1e-12);
    assert!(settled.crs.unwrap().agrees_with(&kept));
}

#[test]
fn a_shift_of_a_datum_without_code_is_warned_of() {
    let shifted = |shift: &str| {
        let text = utm("D_Of_The_Mine", INTERNATIONAL, -51.0, 1e7);
        Stated::of_prj(text.replace(",297.0]]", &format!(",297.0],TOWGS84[{shift}]]")).as_bytes())
    };
    let (_, warnings, _) = settled(Some(shifted("598.1,73.7,418.2,0,0,0,0")), None, None);
    assert!(warnings.len() == 1 && warnings[0].contains("(598.1, 73.7, 418.2, 0, 0, 0, 0)"), "{warnings:?}");
    assert_eq!(settled(Some(shifted("0,0,0,0,0,0,0")), None, None).1, Vec::<String>::new());
    assert!(!shifted("1,2,3,0,0,0,0").agrees_with(&shifted("4,5,6,0,0,0,0")));
    let bound = format!(
        "BOUNDCRS[SOURCECRS[{}],TARGETCRS[GEOGCRS[\"WGS 84\"]],ABRIDGEDTRANSFORMATION[\"t\",METHOD[\"m\"],PARAMETER[\"X-axis translation\",598.1]]]",
        utm("D_Of_The_Mine", INTERNATIONAL, -51.0, 1e7)
    );
    assert_eq!(Stated::of_prj(bound.as_bytes()).shift.as_deref(), Some("598.1"));
    // Of a datum with a code the shift is no part.
    let known = utm("D_Corrego_Alegre", INTERNATIONAL, -51.0, 1e7).replace(",297.0]]", ",297.0],TOWGS84[1,2,3]]");
    assert_eq!(settled(Some(Stated::of_prj(known.as_bytes())), None, None).1, Vec::<String>::new());
}

#[test]
fn heights_in_feet_become_the_metric_system_of_their_datum() {
    let text = |feet: &str, code: &str| {
        format!(
            "COMPD_CS[\"both\",{},VERT_CS[\"of the file\",VERT_DATUM[\"North American Vertical Datum 1988\",2005],{feet},AXIS[\"Up\",UP]{code}]]",
            definition(2229).unwrap()
        )
    };
    for code in [",AUTHORITY[\"EPSG\",\"6360\"]", ""] {
        let stated = Stated::from_wkt(&text("UNIT[\"US survey foot\",0.3048006096012192]", code)).unwrap();
        assert_eq!(settled(Some(stated), None, None).0.unwrap().crs, Some(crs("EPSG:26945+5703")));
    }
}

#[test]
fn a_difference_is_named() {
    let [mine, other] = ["D_Of_The_Mine", "D_Bogota"].map(|datum| crs(&utm(datum, INTERNATIONAL, -51.0, 1e7)));
    assert_eq!(mine.difference(&other).unwrap(), "datum: D_Of_The_Mine, D_Bogota");
    assert_eq!(mine.difference(&mine), None);
    let zone = crs(&utm("D_Of_The_Mine", INTERNATIONAL, -51.5, 1e7));
    assert_eq!(mine.difference(&zone).unwrap(), "centralmeridian: -51, -51.5");
    assert_eq!(
        crs("EPSG:25832+7837").difference(&crs("EPSG:25832+5773")).unwrap(),
        "heights: DHHN2016 height, EGM96 height"
    );
}

#[test]
fn chains_of_a_false_easting_are_chains() {
    let [easting_m, _] = signature::false_origin(&definition(3167).unwrap());
    assert!((easting_m - 804_670.24).abs() < 1e-3, "{easting_m}");
}

#[test]
fn statements_of_heights_must_agree() {
    let stated = |height| Stated::from_epsg(25832, height).unwrap();
    let error = settled(Some(stated(Some(7837))), Some("EPSG:25832+5773"), None).0.unwrap_err();
    assert!(error.message.contains("two coordinate reference systems"), "{error}");
    assert!(settled(Some(stated(Some(7837))), Some("EPSG:25832"), None).0.is_ok());
    assert!(settled(Some(stated(None)), Some("EPSG:25832+7837"), None).0.is_ok());
}

#[test]
fn numbers_that_cannot_be_of_a_system_are_warned_of() {
    let warned =
        |code: u32, x: f64, y: f64| settled(Some(Stated::from_epsg(code, None).unwrap()), None, Some([x, y, 300.0])).1;
    assert_eq!(warned(25832, 691_000.0, 5_334_000.0), Vec::<String>::new());
    assert_eq!(warned(31468, 4_468_000.0, 5_334_000.0), Vec::<String>::new());
    assert_eq!(warned(2154, 1_000_000.0, 6_300_000.0), Vec::<String>::new());
    assert_eq!(warned(5514, -740_000.0, -1_040_000.0), Vec::<String>::new());
    let polar = warned(3031, -2_600_000.0, 1_900_000.0);
    assert!(polar.len() == 1 && polar[0].contains("times those on the ellipsoid"), "{polar:?}");
    assert!(warned(25832, 5_334_000.0, 691_000.0)[0].contains("swapped"));
    assert!(warned(2056, 1_187_670.0, 2_612_370.0)[0].contains("swapped"));
    assert!(warned(21781, 187_670.0, 612_370.0)[0].contains("swapped"));
    assert_eq!(warned(2056, 2_834_000.0, 1_170_000.0), Vec::<String>::new());
    assert_eq!(warned(32648, 167_000.0, 500_000.0), Vec::<String>::new());
    assert!(warned(2056, 691_000.0, 5_334_000.0)[0].contains("EPSG:2056"));
    assert!(warned(25832, 11.5, 48.1)[0].contains("degrees"));
    // A system of WKT 2 has parameters of other names, and units of their own.
    let swiss = r#"PROJCRS["CH1903+ / LV95",BASEGEOGCRS["CH1903+",DATUM["CH1903+",ELLIPSOID["Bessel 1841",6377397.155,299.1528128]]],CONVERSION["Swiss",METHOD["Hotine Oblique Mercator (variant B)"],PARAMETER["Latitude of projection centre",46.9524055555556],PARAMETER["Longitude of projection centre",7.43958333333333],PARAMETER["Azimuth of initial line",90],PARAMETER["Angle from Rectified to Skew Grid",90],PARAMETER["Scale factor on initial line",1],PARAMETER["Easting at projection centre",2600000,LENGTHUNIT["metre",1]],PARAMETER["Northing at projection centre",1200000,LENGTHUNIT["metre",1]]],CS[Cartesian,2],AXIS["easting (E)",east],AXIS["northing (N)",north],LENGTHUNIT["metre",1]]"#;
    let stated = || Stated::of_prj(swiss.as_bytes());
    assert!(stated().agrees_with(&Stated::from_epsg(2056, None).unwrap()));
    assert_eq!(settled(Some(stated()), None, Some([2_660_000.0, 1_180_000.0, 900.0])).1, Vec::<String>::new());
    // Feet are told in metres.
    assert_eq!(warned(2229, 6_480_000.0, 1_840_000.0).len(), 1);
}

#[test]
fn a_unit_without_a_model_is_that_of_a_local_system() {
    let stated = |unit: u16| GeoKeys { directory: &[1, 1, 0, 1, 3076, 0, 1, unit], doubles: &[], ascii: "" }.stated();
    let feet = stated(9003).unwrap();
    assert_eq!((feet.kind, feet.node.is_none()), (Kind::Local, true));
    assert_eq!(stated(9001), None);
    let (settled, warnings, _) = settled(Some(feet), None, None);
    assert!((settled.unwrap().horizontal - 1200.0 / 3937.0).abs() < 1e-15 && warnings.len() == 1, "{warnings:?}");
}

#[test]
fn a_prj_may_have_heights_after_the_map_and_be_utf_16() {
    let heights = r#"VERTCS["EGM96_Geoid",VDATUM["EGM96_Geoid"],PARAMETER["Vertical_Shift",0.0],PARAMETER["Direction",1.0],UNIT["Foot_US",0.3048006096012192]]"#;
    let text = format!("{ESRI},{heights}");
    let stated = Stated::of_prj(text.as_bytes());
    assert_eq!((stated.kind, stated.vertical_unit.as_ref().map(Unit::is_metre)), (Kind::Projected, Some(false)));
    let wide: Vec<u8> = std::iter::once(0xfeff).chain(text.encode_utf16()).flat_map(u16::to_le_bytes).collect();
    assert_eq!(Stated::of_prj(&wide), stated);
    assert_eq!(Stated::of_prj(format!("{ESRI}\n{heights}\n").as_bytes()), stated);
    assert_eq!(Stated::of_prj(b"EPSG:32633\n"), Stated::from_epsg(32633, None).unwrap());
    assert_eq!(Stated::of_prj(format!("{ESRI},{ESRI}").as_bytes()).kind, Kind::Unknown);
}

#[test]
fn what_is_no_well_known_text_is_not_quoted() {
    for text in ["Geheimnis 12345", "Geheimnis[1 Geheimnis", "GEHEIMNIS[\"a\" b]", "root:Geheimnis:0:0", "Geheimnis"] {
        let stated = Stated::of_prj(text.as_bytes());
        assert!(stated.kind == Kind::Unknown, "{text}");
        assert!(!stated.name.to_lowercase().contains("geheimnis"), "{text}: {}", stated.name);
    }
}
