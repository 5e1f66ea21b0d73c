//! The report of a run: made with it, made anew from its folder, and of two runs side by side.

use serde_json::Value;

use crate::cli::{House, last_line};

const SEEN: &str = "rockface: 1
name: seen
seed: 1
axes:
  cell: {values: [0.05, 0.1]}
steps:
  face: {stage: synthesise-face, with: {width_m: 4, height_m: 3.6, spacing_m: 0.025}}
  dem: {stage: rasterise-dem, in: {surface: face.mesh}, with: {cell_m: \"${cell}\", method: tin}}
  mean: {stage: rasterise-dem, in: {surface: face.mesh, grid: \"dem.raster[cell=0.05]\"}}
  change: {stage: difference-dem, in: {reference: \"dem.raster[cell=0.05]\", comparison: mean.raster}}
  noise: {stage: describe-noise, in: {raster: change.raster}}
  picture: {stage: draw-picture, in: {subject: \"dem.raster[cell=0.1]\"}}
targets: [noise, picture, dem]
";

fn read(house: &House, name: &str) -> String {
    std::fs::read_to_string(house.path(name)).unwrap()
}

#[test]
fn a_run_leaves_a_report_with_its_numbers_and_pictures() {
    let house = House::new(SEEN);
    let (code, _, err) = house.rockface(&["run", "p.yaml"]);
    assert_eq!(code, Some(0), "{err}");
    let page = read(&house, ".rockface/runs/latest/report.html");
    let manifest: Value = serde_json::from_str(&read(&house, ".rockface/runs/latest/run.json")).unwrap();
    let steps = manifest["steps"].as_array().unwrap();
    let metrics =
        steps.iter().filter(|step| step["step"] != "dem").flat_map(|step| step["metrics"].as_array().unwrap());
    let mut told = 0;
    for value in metrics.map(|metric| &metric["value"]).filter(|value| value.is_number()) {
        assert!(page.contains(&format!("<data value=\"{value}\"")), "{value}");
        told += 1;
    }
    assert!(told > 0);
    let csv = read(&house, ".rockface/runs/latest/outputs/noise/features.csv");
    let mut rows = csv::Reader::from_reader(csv.as_bytes());
    let row = rows.records().next().unwrap().unwrap();
    for cell in row.iter().filter(|cell| cell.parse::<f64>().is_ok()) {
        assert!(page.contains(&format!("<data value=\"{cell}\"")), "{cell}");
    }
    assert!(page.contains("data:image/png;base64,iVBOR") && page.contains("2 × cell"), "pictures, and sweeps folded");
    assert!(page.contains("href=\"outputs/noise/features.csv\""));

    let before = std::fs::metadata(house.path(".rockface/runs/latest/report.html")).unwrap().modified().unwrap();
    house.rockface(&["run", "p.yaml"]);
    let after = std::fs::metadata(house.path(".rockface/runs/latest/report.html")).unwrap().modified().unwrap();
    assert_eq!(before, after, "a run of hits is told of by the former report");
}

#[test]
fn a_report_can_be_made_later_and_elsewhere() {
    let house = House::new(SEEN);
    house.rockface(&["run", "p.yaml"]);
    let first = read(&house, ".rockface/runs/latest/report.html");
    std::fs::remove_file(house.path(".rockface/runs/latest/report.html")).unwrap();
    let (code, out, err) = house.rockface(&["report", "latest"]);
    assert_eq!(code, Some(0), "{err}");
    assert!(out.trim().ends_with("report.html"), "{out}");
    assert_eq!(read(&house, ".rockface/runs/latest/report.html"), first);
    let (code, _, err) = house.rockface(&["report", "latest", "--output", "page.html"]);
    assert_eq!(code, Some(0), "{err}");
    assert!(read(&house, "page.html").contains("href=\"file:///"));
    let (code, _, err) = house.rockface(&["report", "latest", "--output", "a/new/folder/page.html"]);
    assert!(code == Some(0) && house.path("a/new/folder/page.html").is_file(), "{err}");
    let (code, _, err) = house.rockface(&["report", "latest", "--output", "p.yaml/page.html"]);
    assert!(code == Some(3) && err.contains("p.yaml"), "{err}");
    let (code, _, err) = house.rockface(&["report", "nothing"]);
    assert!(code == Some(2) && err.contains("there is no run `nothing`"), "{err}");
}

/// Figures that are drawings to a reader of XML, and run or load something where a reader of HTML finds them.
const HOSTILE: [&str; 5] = [
    "<!--> <img src=\"x\" onerror=\"evil()\"> -->",
    "<title><g><![CDATA[><script>evil()</script>]]></g></title>",
    "<?p ><script>evil()</script>?>",
    "<image ONLOAD=\"evil()\" HREF=\"http://example.org/evil.png\"/>",
    "<style>@IMPORT 'http://example.org/evil.css'; h1 {fill: URL(evil)}</style>",
];

#[test]
fn a_figure_of_a_stranger_runs_nothing_in_a_page() {
    let numbered = || HOSTILE.iter().chain(&["<text>\"<![CDATA[<script>]]></text>"]).enumerate();
    let step = |number: usize| {
        format!(
            "  s{number}: {{stage: command, with: {{program: cp, args: [\"{{file.svg}}\", \"{{out.figure}}\"], \
             files: {{svg: {number}.svg}}, version: cp, outputs: {{figure: figure}}}}}}\n"
        )
    };
    let steps: String = numbered().map(|(number, _)| step(number)).collect();
    let house = House::new(&format!("rockface: 1\nname: strange\nsteps:\n{steps}"));
    for (number, inside) in numbered() {
        let svg = format!("<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"9\">{inside}</svg>");
        std::fs::write(house.path(&format!("{number}.svg")), svg).unwrap();
    }
    for seed in ["1", "2"] {
        let (code, _, err) = house.rockface(&["run", "p.yaml", "--seed", seed]);
        assert_eq!(code, Some(0), "{err}");
    }
    let runs = std::fs::read_dir(house.path(".rockface/runs")).unwrap().flatten().map(|entry| entry.file_name());
    let runs: Vec<String> =
        runs.map(|name| name.into_string().unwrap()).filter(|name| name.contains("-strange-")).collect();
    let (code, _, err) = house.rockface(&["runs", "compare", &runs[0], &runs[1], "--html", "two.html"]);
    assert_eq!(code, Some(0), "{err}");
    for (name, runs) in [(".rockface/runs/latest/report.html", 1), ("two.html", 2)] {
        let page = read(&house, name);
        let policy = "<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; script-src 'sha256-";
        assert!(page.contains(policy), "{name}");
        let found = page.to_lowercase();
        assert!(!found.contains("evil") && !found.contains("<!--") && !found.contains("@import"), "{name}");
        assert_eq!(page.matches("<script").count(), 1, "{name}: only its own");
        assert!(page.matches("<img src=\"data:image/svg+xml;base64,").count() >= HOSTILE.len() * runs, "{name}");
        assert!(
            page.matches("<text>&quot;&lt;script&gt;</text>").count() >= runs,
            "{name}: a plain one is in the page"
        );
    }
}

#[test]
fn runs_are_compared_on_a_page() {
    let house = House::new(SEEN);
    for seed in ["1", "2"] {
        house.rockface(&["run", "p.yaml", "--seed", seed]);
    }
    let runs = std::fs::read_dir(house.path(".rockface/runs")).unwrap().flatten().map(|entry| entry.file_name());
    let names: Vec<String> =
        runs.map(|name| name.into_string().unwrap()).filter(|name| name.contains("-seen-")).collect();
    let (code, _, err) = house.rockface(&["runs", "compare", &names[0], &names[1], "--html", "two.html"]);
    assert_eq!(code, Some(0), "{err}");
    let page = read(&house, "two.html");
    assert!(names.iter().all(|name| page.contains(name.as_str())) && page.contains(">seed<"), "runs and what differs");
    assert!(page.matches("data:image/png;base64,").count() >= 2, "pictures of both");
}

#[test]
fn the_newest_item_of_an_axis_is_shown_and_not_the_first_ones_only() {
    let weeks = |count: usize| {
        let cells: Vec<String> = (1..=count).map(|week| format!("{:.2}", 0.05 + 0.01 * week as f64)).collect();
        format!(
            "rockface: 1\nname: weeks\naxes: {{cell: {{values: [{}]}}}}\nsteps:\n  face: {{stage: synthesise-face, with: {{width_m: 4, \
             height_m: 3.6, spacing_m: 0.05}}}}\n  dem: {{stage: rasterise-dem, in: {{surface: face.mesh}}, with: {{cell_m: \
             \"${{cell}}\", method: tin}}}}\n  noise: {{stage: describe-noise, with: {{scales_cells: [1, 2, 4]}}, in: {{raster: dem.raster}}}}\ntargets: [dem, noise]\n",
            cells.join(", ")
        )
    };
    let house = House::new(&weeks(7));
    assert_eq!(house.rockface(&["run", "p.yaml"]).0, Some(0));
    std::fs::write(house.path("p.yaml"), weeks(8)).unwrap();
    let (code, out, err) = house.rockface(&["run", "p.yaml"]);
    assert_eq!(code, Some(0), "{err}");
    let told: Vec<&str> = out.lines().filter(|line| line.starts_with("dem")).collect();
    let begins =
        ["dem[cell=0.06]: ", "dem: … 5 more results between, in report.html", "dem[cell=0.12]: ", "dem[cell=0.13]: "];
    assert!(told.len() == 4 && told.iter().zip(begins).all(|(line, begin)| line.starts_with(begin)), "{out}");
    let (_, out, _) = house.rockface(&["runs", "list"]);
    assert!(last_line(&out).contains("[cell=0.13]: "), "{out}");
    let page = read(&house, ".rockface/runs/latest/report.html");
    assert!(page.contains("8 results</strong>, the newest: <span class=\"label\">dem[cell=0.13]</span>"), "headlines");
    let results = page.split_once("id=\"results\"").unwrap().1.split_once("id=\"steps\"").unwrap().0;
    let place = |text: &str| results.find(text).unwrap_or_else(|| panic!("{text}"));
    let table = |cell: &str| place(&format!("<figcaption><span>noise[cell={cell}].features</span>"));
    // The newest table stands first, the others are folded.
    assert!(table("0.13") < table("0.06") && table("0.06") < table("0.12"));
    assert!(results.contains("… 4 more between") && results.contains("4 more instances are not shown here"));
    assert!(!results.contains("noise[cell=0.09].features"));
    assert!(page.contains("dem[cell=0.13].raster"), "a picture");
}
