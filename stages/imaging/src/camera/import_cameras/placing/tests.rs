//! Chunks on the Earth brought to a map, against PROJ 9 (through pyproj), and the shift of local files.

use super::*;
use crate::camera::model::Camera;
use nalgebra::Vector3;
use rockface_core::artefact::{Artefact, Cameras, Covariance};
use rockface_core::testing::{TestHost, run_stage};
use serde_json::{Value, json};

use super::super::ImportCameras;

/// A chunk with one camera on the Earth, in its own frame: numbers as text, row by row.
struct Chunk {
    translation: &'static str,
    camera: &'static str,
    covariance: &'static str,
    /// What the centre is in EPSG:32632, with its height above the ellipsoid.
    centre_m: &'static str,
    /// The covariance of the centre there, by the derivatives of PROJ.
    on_map: &'static str,
    /// Points some 15 m in front of the camera, in EPSG:32632; in geocentric coordinates they are seen at [`PIXELS`].
    points_m: &'static str,
}

/// Where the map scales nothing: 2.7 degrees to the east of the central meridian, 870 m above the ellipsoid.
const TRUE_TO_SCALE: Chunk = Chunk {
    translation: "4346745.301907916 899970.749851277 4565877.366459212",
    camera: "0.8667750785879013 -0.4214901794116728 -0.2665464158424442 1.36745307028435 0.3453361174251126 0.12169317616022744 0.9305556065479291 1.9137720272865861 -0.35978316961843265 -0.8986305133566026 0.251036394420734 -3.119962611549369 0.0 0.0 0.0 1.0",
    covariance: "4.1806187264793374e-06 -6.578242672118818e-06 7.99164459277071e-07 -6.578242672118818e-06 1.1841899049692208e-05 -7.804531021608841e-07 7.99164459277071e-07 -7.804531021608841e-07 6.497570092777564e-07",
    centre_m: "708881.198629 5097586.014047 870.0",
    on_map: "6.272695638894454e-05 -6.034734475356438e-05 7.433796931309694e-05 -6.03473447535644e-05 6.588077724276563e-05 -6.994997837975612e-05 7.433796931309694e-05 -6.994997837975614e-05 9.963570779480805e-05",
    points_m: "708865.770455 5097593.117547 871.289117 708880.80907 5097603.748313 869.747696 708872.319534 5097598.434414 864.565211 708865.648254 5097590.21857 859.150354 708881.998364 5097599.393822 859.741913",
};

/// 1.2 degrees to the west of the central meridian, where lengths are 0.43 mm in a metre short.
const SCALED: Chunk = Chunk {
    translation: "4397866.82126059 602424.1738760228 4565877.366459212",
    camera: "0.8855141860765079 -0.38258308566029264 -0.2636186807187778 1.36745307028435 0.32693045449039 0.10993855419058454 0.9386319791213116 1.9137720272865861 -0.3301228622558068 -0.9173569081165373 0.22243021140775895 -3.119962611549369 0.0 0.0 0.0 1.0",
    covariance: "2.43007152132155e-06 -4.038061727367199e-07 -4.778384019622607e-07 -4.038061727367199e-07 5.858261967866608e-07 -6.337217421166689e-07 -4.778384019622607e-07 -6.337217421166689e-07 4.10942823868707e-06",
    centre_m: "407081.450339 5094747.489603 870.0",
    on_map: "4.390683724843577e-05 2.2918460819658793e-06 -1.3104676784748842e-05 2.291846081965879e-06 6.388915216654463e-06 6.262119794846318e-06 -1.310467678474884e-05 6.2621197948463165e-06 4.720667486915635e-05",
    points_m: "407063.013571 5094755.978333 871.541171 407080.980602 5094768.873895 869.695643 407073.707836 5094758.320069 865.258864 407065.637386 5094751.765123 858.962404 407082.393655 5094763.271526 857.895018",
};

/// The rotation of both chunks, and of map axes to the camera.
const CHUNK_ROTATION: &str = "-0.14224425972292393 -0.8913512001125886 0.4304179464587009 0.8067072841115986 -0.3563702717168218 -0.4714059685640041 0.5735764363510459 0.2801664995932355 0.7697511313200571";
const CAMERA_FROM_MAP: &str = "0.8308410860384093 0.5526358059070868 -0.06554964362940051 0.13855566520188067 -0.31949469770391614 -0.9374035767904598 -0.5389855446957562 0.7697511313200573 -0.3420201433256687";
const PIXELS: [[f64; 2]; 5] = [[300.0, 300.0], [5200.0, 400.0], [2700.0, 1800.0], [400.0, 3400.0], [5100.0, 3300.0]];

fn numbers(text: &str) -> Vec<f64> {
    text.split(' ').map(|word| word.parse().unwrap()).collect()
}

fn xml(chunk: &Chunk, system: &str) -> String {
    let Chunk { translation, camera, covariance, .. } = chunk;
    let size = "<resolution width=\"5472\" height=\"3648\"/>";
    format!(
        "<?xml version=\"1.0\"?><document version=\"2.0.0\"><chunk><sensors><sensor id=\"0\" type=\"frame\">{size}<calibration class=\"adjusted\">{size}\
         <f>3666</f><k1>-0.02</k1></calibration></sensor></sensors><components><component id=\"0\"><transform><rotation>{CHUNK_ROTATION}</rotation>\
         <translation>{translation}</translation><scale>3.7</scale></transform></component></components><cameras>\
         <camera id=\"0\" sensor_id=\"0\" component_id=\"0\" label=\"a\"><transform>{camera}</transform>\
         <location_covariance>{covariance}</location_covariance></camera></cameras><reference>{}</reference></chunk></document>",
        system.replace('"', "&quot;")
    )
}

fn system(code: &str) -> String {
    code.parse::<Crs>().unwrap().wkt()
}

const WGS_84: &str = "GEOGCS[\"WGS 84\",DATUM[\"World Geodetic System 1984 ensemble\",SPHEROID[\"WGS 84\",6378137,298.257223563]],\
                      PRIMEM[\"Greenwich\",0],UNIT[\"degree\",0.0174532925199433]]";

fn import(text: &str, with: &Value) -> (Result<(Cameras, Covariance), StageError>, TestHost) {
    let host = TestHost::default().with("block", &[("block.xml", text.as_bytes())]);
    let mut params = json!({"path": "block"});
    params.as_object_mut().unwrap().extend(with.as_object().unwrap().clone());
    let made = run_stage::<ImportCameras>(&host, &params, &[]).map(|outputs| {
        let made = outputs.into_inner();
        match (&made["cameras"], &made["covariance"]) {
            (Artefact::Cameras(cameras), Artefact::Covariance(covariance)) => (cameras.clone(), covariance.clone()),
            other => panic!("{other:?}"),
        }
    });
    (made, host)
}

/// How far each point of the map falls from where it is seen, pixels, with horizontal lengths about the centre divided by a scale.
fn off_px(cameras: &Cameras, chunk: &Chunk, scale: f64) -> Vec<f64> {
    let camera = Camera::new(&cameras.sensors[0], &cameras.images[0]);
    let off = |(point, seen): (&[f64], [f64; 2])| {
        let from = Vector3::new(point[0], point[1], point[2]) - camera.centre();
        let [u, v] = camera.project(&(camera.centre() + Vector3::new(from.x / scale, from.y / scale, from.z))).unwrap();
        let (du, dv) = (u - seen[0], v - seen[1]);
        (du * du + dv * dv).sqrt()
    };
    numbers(chunk.points_m).chunks(3).zip(PIXELS).map(off).collect()
}

#[test]
fn points_of_the_map_fall_where_they_are_seen_in_geocentric_coordinates() {
    for (chunk, scale) in [(TRUE_TO_SCALE, 1.0), (SCALED, 0.999_569_8)] {
        let (made, host) = import(&xml(&chunk, &system("EPSG:32632")), &json!({}));
        let (cameras, _) = made.unwrap();
        assert_eq!(cameras.frame.crs().unwrap().epsg(), Some(32632));
        let centre = cameras.images[0].centre() - Vector3::from_column_slice(&numbers(chunk.centre_m));
        assert!(centre.norm() < 1e-5, "{centre}");
        let turned = cameras.images[0].matrix() - nalgebra::Matrix3::from_row_slice(&numbers(CAMERA_FROM_MAP));
        assert!(turned.norm() < 2e-6, "{turned}");
        let same_shape = off_px(&cameras, &chunk, scale);
        assert!(same_shape.iter().all(|px| *px < 0.01), "{same_shape:?}");
        let as_it_is = off_px(&cameras, &chunk, 1.0).into_iter().fold(0.0, f64::max);
        let told = host.metric("map_scale_error").unwrap();
        println!("scale {scale}: without it {same_shape:?} px, with it {as_it_is} px, told {told} px");
        assert!(as_it_is < told + 0.01 && as_it_is > 0.7 * told - 0.01, "{as_it_is} px, told {told} px");
        assert!((host.metric("map_scale_minus_1").unwrap() - (scale - 1.0)).abs() < 2e-6);
        // Where the map is true to scale the points themselves fall where they are seen.
        assert!(scale < 1.0 || as_it_is < 0.05, "{as_it_is} px");
        let warnings = host.warnings();
        assert!(warnings.iter().any(|text| text.contains("above the ellipsoid")), "{warnings:?}");
        assert_eq!(warnings.iter().any(|text| text.contains("px from where the photographs have it")), told > 0.5);
    }
}

/// CH1903+ is shifted only, DHDN turned and scaled too; both as PROJ does with the numbers of the codes.
#[test]
fn centres_are_shifted_to_an_older_datum() {
    let swiss = "2929782.500534 1103233.273730 824.351870 2929797.318852 1103244.209114 822.810949 2929788.939757 1103238.723230 817.628196 \
                 2929782.437748 1103230.373161 812.213045 2929798.596940 1103239.880078 812.805096";
    let german = "4476671.952405 5095695.497827 816.068686 4476687.378748 5095705.553429 814.527513 4476678.696262 5095700.563715 809.344937 \
                  4476671.721238 5095692.606021 803.929968 4476688.403154 5095701.157918 804.521753";
    for (code, centre_m, points_m) in [
        ("EPSG:2056", "2929798.070289 1103226.486736 823.062889", swiss),
        ("EPSG:31468", "4476687.100191 5095687.819336 814.779604", german),
    ] {
        let chunk = Chunk { centre_m, points_m, ..TRUE_TO_SCALE };
        let (made, host) = import(&xml(&chunk, WGS_84), &json!({"crs": code}));
        let (mut cameras, _) = made.unwrap();
        let known = Vector3::from_column_slice(&numbers(centre_m));
        let off = cameras.images[0].centre() - known;
        assert!(off.norm() < 2e-3, "{code}: {off}");
        // PROJ takes the angles as small on the way back as well, which moves all places by the same millimetre.
        cameras.images[0].centre_m = known.into();
        let scale = 1.0 + host.metric("map_scale_minus_1").unwrap();
        let same_shape = off_px(&cameras, &chunk, scale);
        assert!(same_shape.iter().all(|px| *px < 0.02), "{code}: {same_shape:?}");
        let warns = |what: &str| host.warnings().iter().any(|text| text.contains(what));
        assert!(
            warns("exact for CH1903+") && warns(&format!("above the ellipsoid of {code}")),
            "{:?}",
            host.warnings()
        );
    }
}

#[test]
fn the_covariance_of_centres_turns_along() {
    let (made, _) = import(&xml(&SCALED, &system("EPSG:32632")), &json!({}));
    let (cameras, covariance) = made.unwrap();
    assert_eq!((covariance.frame.crs(), covariance.parameters.len()), (cameras.frame.crs(), 3));
    for (found, known) in covariance.matrix.concat().iter().zip(numbers(SCALED.on_map)) {
        // It is turned and not scaled: 0.04 % of a standard deviation.
        assert!((found - known).abs() < 1e-3 * 5e-5, "{found} {known}");
    }
}

#[test]
fn a_geographic_chunk_needs_the_system_that_is_wanted() {
    let geographic = xml(&SCALED, WGS_84);
    let error = import(&geographic, &json!({})).0.unwrap_err();
    assert!(error.message.contains("referenced to `WGS 84`, so its centres are geocentric"), "{error}");
    assert!(error.hint.as_ref().unwrap().contains("`crs: EPSG:32632`"), "{error:?}");
    let (made, host) = import(&geographic, &json!({"crs": "EPSG:32632"}));
    let own = import(&xml(&SCALED, &system("EPSG:32632")), &json!({})).0.unwrap();
    assert_eq!(made.unwrap(), own);
    assert!(!host.warnings().iter().any(|text| text.contains("datum")), "{:?}", host.warnings());
    // ETRS 89 is taken for WGS 84, with a warning.
    let (made, host) = import(&geographic, &json!({"crs": "EPSG:25832"}));
    let moved = made.unwrap().0.images[0].centre() - own.0.images[0].centre();
    assert!(moved.norm() < 1e-3, "{moved}");
    assert!(host.warnings().iter().any(|text| text.contains("taken for the same")), "{:?}", host.warnings());
}

#[test]
fn what_cannot_be_brought_to_a_map_says_why() {
    let says = |text: &str, with: &Value, message: &str, hint: &str| {
        let error = import(text, with).0.unwrap_err();
        assert!(error.message.contains(message), "{error}");
        assert!(error.hint.as_ref().is_some_and(|own| own.contains(hint)), "{error:?}");
    };
    let chunk = xml(&SCALED, WGS_84);
    says(&chunk, &json!({"crs": "EPSG:26710"}), "the shift from one to the other is not known", "Reference > Convert");
    says(&chunk, &json!({"crs": "EPSG:32632", "frame": "wall"}), "not in a wall frame", "transform-crs");
    says(&chunk, &json!({"frame": "wall"}), "not in a wall frame", "transform-crs");
    says(&chunk, &json!({"crs": "EPSG:2057"}), "is not computed here", "the zone is EPSG:32632");
    says(&chunk, &json!({"crs": "EPSG:3035"}), "differ by 0.2", "its UTM zone is EPSG:32632");
    says(&chunk, &json!({"crs": "EPSG:32655"}), "", "its UTM zone is EPSG:32632");
    says(&chunk, &json!({"crs": "EPSG:32632+5773"}), "no geoid is known here", "`crs: EPSG:32632`");
    let with = json!({"crs": "EPSG:32632+5773", "offset_m": [0.0, 0.0, -50.0]});
    let (made, host) = import(&chunk, &with);
    let (cameras, _) = made.unwrap();
    assert!((cameras.images[0].centre_m[2] - 820.0).abs() < 1e-5);
    assert_eq!(cameras.frame.crs().unwrap().vertical_epsg(), Some(5773));
    assert!(!host.warnings().iter().any(|text| text.contains("above the ellipsoid")), "{:?}", host.warnings());
}

#[test]
fn centres_in_map_coordinates_are_taken_as_they_stand() {
    let translation = "407081.45 5094747.49 870";
    let (made, host) = import(&xml(&Chunk { translation, ..SCALED }, &system("EPSG:32632")), &json!({}));
    assert_eq!(made.unwrap().0.frame.crs(), None);
    assert!(
        host.warnings().iter().any(|text| text.contains("far from the surface of the Earth")),
        "{:?}",
        host.warnings()
    );
    let (made, _) = import(&xml(&Chunk { translation, ..SCALED }, &system("EPSG:32632")), &json!({"crs": 32632}));
    assert_eq!(made.unwrap().0.frame.crs().unwrap().epsg(), Some(32632));
}

/// Names and bytes of the files of a block.
type Files<'a> = &'a [(&'a str, &'a [u8])];

#[test]
fn a_shift_is_added_to_the_centres_of_every_format() {
    let by = [400_000.0, 5_000_000.0, 612.5];
    let files: [(&str, Files); 4] = [
        ("colmap", &[("cameras.txt", b"1 PINHOLE 9 7 9 9 1 1"), ("images.txt", b"1 1 0 0 0 -1 -2 -3 1 a.png\n\n")]),
        (
            "simple.json",
            &[(
                "simple.json",
                b"{\"sensors\": [{\"id\": 1, \"width\": 9, \"height\": 7, \"f\": 9, \"cx\": 4, \"cy\": 3}], \"images\": [{\"name\": \"a.png\", \"sensor\": 1, \
                  \"q_wxyz\": [1, 0, 0, 0], \"C\": [1, 2, 3]}]}",
            )],
        ),
        ("b.out", &[("b.out", b"# Bundle file v0.3\n1 0\n9 0 0\n1 0 0\n0 1 0\n0 0 1\n-1 -2 -3\n")]),
        ("local.xml", &[("local.xml", b"")]),
    ];
    let local = xml(&Chunk { translation: "0 0 0", ..SCALED }, "LOCAL_CS[\"Local\",UNIT[\"metre\",1]]");
    for (path, parts) in files {
        let parts: Vec<(&str, &[u8])> = parts
            .iter()
            .map(|(name, bytes)| (*name, if bytes.is_empty() { local.as_bytes() } else { *bytes }))
            .collect();
        let host = TestHost::default().with(path, &parts);
        let read = |offset: &[f64; 3]| {
            let mut with = json!({"path": path, "offset_m": offset});
            if path == "b.out" {
                with["image_size_px"] = json!([9, 7]);
            }
            let made = run_stage::<ImportCameras>(&host, &with, &[]).unwrap().into_inner();
            match (&made["cameras"], &made["covariance"]) {
                (Artefact::Cameras(cameras), Artefact::Covariance(covariance)) => (cameras.clone(), covariance.clone()),
                other => panic!("{other:?}"),
            }
        };
        let ((own, covariance), (shifted, same)) = (read(&[0.0; 3]), read(&by));
        let moved = shifted.images[0].centre() - own.images[0].centre() - Vector3::from(by);
        assert!(moved.norm() < 1e-8, "{path}: {moved}");
        assert_eq!(
            (covariance.matrix, own.images[0].camera_from_object),
            (same.matrix, shifted.images[0].camera_from_object)
        );
    }
}

#[test]
fn a_file_that_states_where_its_wall_lies_is_not_shifted() {
    let own = json!({"frame": {"axes": "wall", "crs": "EPSG:32632"}, "sensors": [{"name": "s", "width_px": 9, "height_px": 7, "f": 9.0, "cx": 4.0, "cy": 3.0,
        "b1": 0.0, "b2": 0.0, "k": [0.0, 0.0, 0.0, 0.0], "p": [0.0, 0.0]}],
        "images": [{"name": "a", "sensor": 0, "camera_from_object": [1.0, 0.0, 0.0, 0.0], "centre_m": [0.0, 0.0, 9.0]}]});
    let error = import(&own.to_string(), &json!({"offset_m": [1.0, 0.0, 0.0]})).0.unwrap_err();
    assert!(error.message.contains("which `offset_m` would make untrue"), "{error}");
    assert!(import(&own.to_string(), &json!({})).0.is_ok());
}
