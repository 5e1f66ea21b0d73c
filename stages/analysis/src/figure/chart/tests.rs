//! Charts are plain SVG, the same every time, with what they show in them.

use super::*;
use rockface_core::artefact::Noun;

fn curves() -> Sheet {
    let lags: Vec<f64> = (1..=60).map(|i| 0.02 * f64::from(i)).collect();
    let model = |h: &f64, sill: f64| sill * (1.0 - rockface_core::numerics::portable_math::exp(-3.0 * h / 0.5)) + 4.0;
    let band = lags.iter().map(|h| [*h, model(h, 30.0), model(h, 62.0)]).collect();
    let axes = Axes::new(Axis::linear("lag, m"), Axis::log("semivariance, mm²"))
        .with(Layer::band("39 real comparisons, 5 to 95 %", band).ink(Ink::Muted))
        .with(Layer::line("simulated", lags.iter().map(|h| [*h, model(h, 45.0)]).collect()))
        .with(Layer::points("of one replicate", lags.iter().step_by(6).map(|h| [*h, model(h, 55.0)]).collect()))
        .with(Layer::new("range", Mark::AtX(0.5)));
    Sheet::of([Panel::new("Variogram", axes)])
}

fn landscape() -> Axes {
    let values = (0..20 * 12).map(|i| {
        let (x, y) = (f64::from(i % 20) - 12.0, f64::from(i / 20) - 5.0);
        if i == 25 { f64::NAN } else { x * x + 3.0 * y * y }
    });
    let values: Vec<f64> = values.collect();
    let key = ColourKey::over("D²", values.iter().copied());
    let cells = Mark::Cells { x: [0.1, 1.1], y: [0.01, 10.0], columns: 20, values };
    Axes::new(Axis::linear("local noise, px"), Axis::log("correlation length, px"))
        .colours(key)
        .with(Layer::new("", cells))
        .with(Layer::points("best", vec![[0.72, 0.6]]).ink(Ink::Series(1)))
}

fn samples() -> Vec<f64> {
    (0..500).map(|i| f64::from((i * 7919) % 1000) / 300.0 + f64::from((i * 31) % 17) / 9.0).collect()
}

fn every_kind() -> Sheet {
    let bars = Axes::bars("contribution to D²", [("sill", 3.2), ("skewness", -0.4), ("spectral slope", 1.25)]);
    let outline = |ink, values: [f64; 5]| ("run".to_owned(), ink, values.to_vec());
    let spokes = ["recall", "precision", "F1", "IoU", "volume"].map(str::to_owned).to_vec();
    let outlines =
        vec![outline(Ink::Muted, [0.9, 0.8, 0.7, 0.6, f64::NAN]), outline(Ink::Series(0), [0.4, 0.9, 0.6, 0.5, 0.8])];
    let radar = Radar {
        spokes,
        range: [0.0, 1.0],
        outlines,
        bands: vec![("band".into(), Ink::Muted, 0.2, vec![[0.2, 0.6]; 5])],
    };
    let sides_m: Vec<[f64; 3]> =
        (1..60).map(|i| [1.0, 0.3 + 0.01 * f64::from(i), 0.1 + 0.005 * f64::from(i)]).collect();
    let values: Vec<f64> = sides_m.iter().map(|sides| sides[1]).collect();
    let key = ColourKey::over("V, m³", values.iter().copied());
    let ternary = Ternary { sides_m, ink: None, values: Some((values, key)) };
    let one_to_one = Axes::new(Axis::log("true volume, m³"), Axis::log("measured volume, m³"))
        .with(Layer::new("equal", Mark::Diagonal))
        .with(Layer::points("M3C2", samples().iter().map(|x| [*x, 1.1 * x * x]).collect()));
    let density = Axes::new(Axis::linear("error, mm"), Axis::linear("density"))
        .with(density("simulated", &samples()))
        .with(density("real", &samples().iter().map(|x| 1.3 * x).collect::<Vec<_>>()));
    let histogram = Axes::new(Axis::linear("error, mm"), Axis::linear("count")).with(histogram("", &samples()));
    Sheet::of([
        Panel::new("Contributions", bars),
        Panel::new("Scores", radar),
        Panel::new("Shapes", ternary),
        Panel::new("Landscape", landscape()),
        Panel::new("Volumes", one_to_one),
        Panel::new("Density", density),
        Panel::new("Histogram", histogram),
    ])
    .title("Every kind of chart <once>")
    .subtitle("drawn by a test")
    .size(1000, 300)
}

#[test]
fn every_kind_is_a_figure_with_equal_bytes() {
    for sheet in [curves(), every_kind()] {
        let figure = draw(&sheet).unwrap();
        assert_eq!(draw(&sheet).unwrap(), figure);
        assert_eq!(Figure::decode(&figure.encode().unwrap()).unwrap(), figure);
        // A page shows what the file does.
        let inside = figure.inside_page().unwrap();
        assert_eq!(inside.replace('\'', "&apos;"), figure.svg.replace('\'', "&apos;"));
        if let Ok(folder) = std::env::var("ROCKFACE_LOOK") {
            let name = format!("{folder}/{}.svg", sheet.panels.len());
            std::fs::write(name, &figure.svg).unwrap();
        }
    }
}

#[test]
fn every_colour_follows_the_page_and_axes_have_their_units() {
    let svg = draw(&curves()).unwrap().svg;
    for expected in ["var(--ink,#1f2328)", "class=\"rl-s1\"", "class=\"rf-m\"", "lag, m", "semivariance, mm²"] {
        assert!(svg.contains(expected), "{expected}");
    }
    let bare = svg.lines().filter(|line| line.contains("stroke=\"#") && !line.contains("class=")).count();
    assert_eq!(bare, 0);
}

#[test]
fn what_cannot_be_drawn_is_refused_or_left_out() {
    assert!(draw(&Sheet::of([])).unwrap_err().0.contains("1 to 100 panels"));
    let cells = Mark::Cells { x: [0.0, 1.0], y: [0.0, 1.0], columns: 2, values: vec![1.0; 4] };
    let axes = Axes::new(Axis::linear("x"), Axis::linear("y")).with(Layer::new("", cells));
    assert!(draw(&Sheet::of([Panel::new("", axes)])).unwrap_err().0.contains("no colour key"));
    let points = vec![[f64::NAN, 1.0], [1.0, f64::INFINITY], [-1.0, 2.0], [3.0, 2.0]];
    let axes = Axes::new(Axis::log("x"), Axis::linear("y")).with(Layer::points("", points));
    let svg = draw(&Sheet::of([Panel::new("", axes)])).unwrap().svg;
    assert_eq!(svg.matches("<circle").count(), 1);
    for axis in [Axis::linear("x"), Axis::log("x")] {
        let empty = Axes::new(axis.clone(), axis).with(Layer::line("nothing", Vec::new()));
        assert!(draw(&Sheet::of([Panel::new("", empty)])).is_ok());
    }
}
