//! A stereo pair out of a block of three images, from files that an earlier run exported.

use crate::cli::House;

/// A face, three cameras before it, and their covariance.
const SITE: &str = "
rockface: 1
seed: 3
steps:
  face:   {stage: synthesise-face, with: {width_m: 8, height_m: 5, spacing_m: 0.1}}
  survey: {stage: plan-survey, in: {mesh: face.mesh}, with: {block: strips, width_px: 160, height_px: 120, focal_px: 130, distance_m: 8, columns: 3, rows: 1}}
  errors: {stage: estimate-covariance, in: {cameras: survey.cameras, mesh: face.mesh}, with: {tie_points: 60, control_points: 4}}
";

/// The parts that are told two images.
const PAIR: &str = "
rockface: 1
seed: 3
steps:
  site:  {use: rockface/stereo-site, with: {mesh: face.ply, cameras: cameras.json, covariance: covariance.json, first: ONE, second: TWO}}
  pair:  {use: rockface/stereo-survey, in: {first: site.first, second: site.second, cameras: site.cameras, covariance: site.covariance, pairs: site.pairs}}
  bench:
    use: rockface/detection-benchmark
    with: {first: ONE, second: TWO, window_m: [-1, 1, -1, 1], cell_m: 0.1, epochs: 1, count: 1, smallest_m3: 0.02, largest_m3: 0.05, least_width_m: 0.2, least_area_m2: 0.04}
    in: {mesh: site.mesh, cameras: site.cameras, covariance: site.covariance}
targets: [pair, bench]
";

fn done(house: &House, arguments: &[&str]) -> String {
    let (code, out, err) = house.rockface(arguments);
    assert_eq!(code, Some(0), "{arguments:?}: {out}{err}");
    out + &err
}

/// A folder with the files of the site, and the names of its images.
fn site() -> (House, Vec<String>) {
    let house = House::new(SITE);
    done(&house, &["run", "p.yaml"]);
    for (output, file) in
        [("face.mesh", "face.ply"), ("survey.cameras", "cameras.json"), ("errors.covariance", "covariance.json")]
    {
        done(&house, &["export", "latest", output, file]);
    }
    let cameras = std::fs::read(house.path("cameras.json")).unwrap();
    let cameras: serde_json::Value = serde_json::from_slice(&cameras).unwrap();
    let images = cameras["images"].as_array().unwrap();
    let names = images.iter().map(|image| image["name"].as_str().unwrap().to_owned()).collect();
    (house, names)
}

#[test]
fn the_two_images_that_are_named_are_a_pair_of_a_block_of_three() {
    let (house, names) = site();
    assert_eq!(names.len(), 3);
    std::fs::write(house.path("p.yaml"), PAIR.replace("ONE", &names[0]).replace("TWO", &names[1])).unwrap();
    done(&house, &["run", "p.yaml"]);
}
