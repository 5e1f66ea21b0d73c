//! Coverage of the bands: perfect simulators must fall into them as often as they say.

use super::*;
use crate::noise::chain;
use crate::noise::mahalanobis::{distance, fit};
use rockface_core::numerics::quantile::quantile;

/// Made-up features: (raster, feature) of a perfect simulator.
type Simulator<'a> = &'a dyn Fn(&Field, i32, i32) -> f64;

fn normal(field: &Field, i: i32, j: i32) -> f64 {
    field.normal(i, j)
}

/// Each feature skewed, as no family of the simulation is.
fn skewed(field: &Field, i: i32, j: i32) -> f64 {
    let [a, b] = field.normals(i, j);
    a * a + b * b
}

/// Student t of 4 degrees of freedom, whole rasters at a time.
fn heavy(field: &Field, i: i32, j: i32) -> f64 {
    let square: f64 = (100..104).map(|k| field.normal(i, k)).map(|x| x * x).sum();
    field.normal(i, j) * (4.0 / square).sqrt()
}

/// How often the count of `m` rasters of a perfect simulator lies in its band, with `n` references of `p` features.
fn coverage(simulator: Simulator, sizes: [usize; 3], worlds: i32, chained: bool) -> f64 {
    coverages(simulator, sizes, worlds, chained)[0]
}

/// How often the count of `m` rasters of a perfect simulator, and their median D2, lie in their bands.
fn coverages(simulator: Simulator, [n, p, m]: [usize; 3], worlds: i32, chained: bool) -> [f64; 2] {
    let names: Vec<String> = (0..p).map(|j| format!("f{j}")).collect();
    let labels: Vec<String> =
        (0..n).map(|i| if chained { format!("c_{i}_{}", i + 1) } else { format!("r{i}") }).collect();
    let mut shared: Option<Simulated> = None;
    let held = (0..worlds).map(|world| {
        let field = Key([
            world as u8,
            (world >> 8) as u8,
            3,
            4,
            5,
            6,
            7,
            8,
            9,
            10,
            11,
            12,
            13,
            14,
            15,
            16,
            17,
            18,
            19,
            20,
            21,
            22,
            23,
            24,
            25,
            26,
            27,
            28,
            29,
            30,
            31,
            32,
        ])
        .field();
        let epoch = |i: usize, j: usize| simulator(&field, i as i32, j as i32);
        let reference = |i: usize| -> Vec<f64> {
            let sum = |j: usize| if chained { 0.8944 * epoch(i, j) + 0.4472 * epoch(i + 1, j) } else { epoch(i, j) };
            (0..p).map(sum).collect()
        };
        let rows: Vec<Vec<f64>> = (0..n).map(reference).collect();
        let mut model = fit(&names, &rows, 1e-3).unwrap();
        model.chain_correlation = chain::correlations(&labels, &rows);
        let threshold = quantile(&model.reference_d2, 0.95).unwrap();
        // Without a chain only the eigenvalues differ from one set of references to the next, which hardly matters.
        let own = || Setting::of(&model, &model, 1e-3, m).simulate(&[0.95]);
        let simulated = if chained { own() } else { shared.get_or_insert_with(own).clone() };
        let expected = simulated.expectation(0, share_below(&model.leave_one_out_d2, threshold), &model.reference_d2);
        let trial = |i: usize| -> Vec<f64> {
            let (a, b) = (1000 + 2 * i, 1001 + 2 * i);
            let sum = |j: usize| if chained { 0.8944 * epoch(a, j) + 0.4472 * epoch(b, j) } else { epoch(a, j) };
            (0..p).map(sum).collect()
        };
        let d2: Vec<f64> = (0..m).map(|i| distance(&model, &trial(i)).d2).collect();
        let median = quantile(&d2, 0.5).unwrap();
        let has_median = expected.median_d2.is_some_and(|[low, high]| (low..=high).contains(&median));
        [expected.holds(d2.iter().filter(|d2| **d2 <= threshold).count()), has_median]
    });
    let counts = held.fold([0, 0], |[a, b], [x, y]| [a + i32::from(x), b + i32::from(y)]);
    counts.map(|count| f64::from(count) / f64::from(worlds))
}

#[test]
fn the_band_of_a_perfect_simulator_is_as_wide_as_it_says() {
    // 200 tests: a standard error of 0.015.
    let [count, median] = coverages(&normal, [39, 10, 39], 200, false);
    assert!((0.91..=0.985).contains(&count) && (0.88..=0.985).contains(&median), "{count} {median}");
    // Of heavier tails the median is a little less certain than its band says.
    let [count, median] = coverages(&heavy, [39, 10, 39], 200, false);
    assert!((0.87..=0.985).contains(&count) && (0.84..=0.985).contains(&median), "{count} {median}");
}

#[test]
fn the_median_of_noise_that_is_far_off_lies_outside_though_every_count_is_possible() {
    let rows: Vec<Vec<f64>> = {
        let field = Key([9; 32]).field();
        (0..12).map(|i| (0..10).map(|j| field.normal(i, j)).collect()).collect()
    };
    let names: Vec<String> = (0..10).map(|j| format!("f{j}")).collect();
    let model = fit(&names, &rows, 1e-3).unwrap();
    let simulated = Setting::of(&model, &model, 1e-3, 40).simulate(&[0.95]);
    let threshold = quantile(&model.reference_d2, 0.95).unwrap();
    let found = simulated.expectation(0, share_below(&model.leave_one_out_d2, threshold), &model.reference_d2);
    println!("12 references of 10 features: {found:?}");
    let [low, high] = found.median_d2.unwrap();
    let median = |shift: f64| distance(&model, &[shift; 10]).d2;
    assert!(found.low == 0 && low > 12.0 && median(30.0) > high, "{found:?} {}", median(30.0));
}

#[test]
fn the_band_of_few_references_is_as_wide_as_it_says() {
    // The count of tests by three references is anything from few to all; 200 tests.
    for n in [3, 4, 6] {
        let covered = coverage(&normal, [n, 1, 40], 200, false);
        assert!(covered >= 0.9, "{n}: {covered}");
    }
}

#[test]
fn the_band_covers_95_percent_for_many_sizes_and_distributions() {
    if std::env::var_os("ROCKFACE_SLOW").is_none() {
        println!("skipped: set ROCKFACE_SLOW=1 for the coverage of bands on a grid");
        return;
    }
    let simulators: [(&str, Simulator); 3] = [("normal", &normal), ("skewed", &skewed), ("t of 4", &heavy)];
    let mut outside = Vec::new();
    for (name, simulator) in simulators {
        for (n, p) in [(26, 9), (26, 10), (39, 9), (39, 10), (39, 3)] {
            for m in [13, 26, 39, 50] {
                let covered = coverage(simulator, [n, p, m], 1500, false);
                println!("{name}, n = {n}, p = {p}, m = {m}: {covered:.3}");
                // 1500 tests: a standard error of 0.006.
                if !(0.925..=0.975).contains(&covered) {
                    outside.push(format!("{name} {n} {p} {m}: {covered}"));
                }
            }
        }
    }
    assert!(outside.is_empty(), "{outside:?}");
}

#[test]
fn the_band_allows_for_a_chain() {
    if std::env::var_os("ROCKFACE_SLOW").is_none() {
        println!("skipped: set ROCKFACE_SLOW=1 for the coverage of bands of chained references");
        return;
    }
    // Features of heavy tails are less so in comparisons, which have noise of two epochs: references and trials alike.
    let simulators: [(&str, Simulator); 2] = [("normal", &normal), ("t of 4", &heavy)];
    for (name, simulator) in simulators {
        for n in [26, 39] {
            let covered = coverage(simulator, [n, 9, 39], 400, true);
            println!("{name}, chained references, n = {n}, p = 9, m = 39: {covered:.3}");
            // 400 tests: a standard error of 0.011.
            assert!((0.92..=0.98).contains(&covered), "{name} {n}: {covered}");
        }
    }
}

#[test]
fn counts_of_a_lucky_and_an_unlucky_simulator_lie_outside() {
    let setting = Setting {
        references: 39,
        trials: 39,
        eigenvalues: vec![1.0; 10],
        ridge: 1e-3,
        chain_correlation: 0.0,
        opposed: 0,
    };
    let simulated = setting.simulate(&[0.95]);
    let expected = simulated.expectation(0, 0.667, &[9.74; 39]);
    assert!((0.5..0.75).contains(&expected.share), "{expected:?}");
    assert!(expected.low > 5 && expected.high < 39 && expected.high - expected.low > 11, "{expected:?}");
    assert!(!expected.holds(5) && !expected.holds(39));
}

#[test]
fn the_band_is_the_likeliest_run_nearest_to_95_percent() {
    assert_eq!(band(&[0.0, 0.02, 0.1, 0.7, 0.14, 0.04]), (2, 4));
    assert_eq!(band(&[0.0, 0.0, 1.0]), (2, 2));
    assert_eq!(band(&[1.0]), (0, 0));
}

#[test]
fn leaving_one_out_has_its_closed_form() {
    let field = Key([2; 32]).field();
    let rows: Vec<Vec<f64>> = (0..15).map(|i| (0..3).map(|j| field.normal(i, j)).collect()).collect();
    let names: Vec<String> = (0..3).map(|j| format!("f{j}")).collect();
    let model = fit(&names, &rows, 0.0).unwrap();
    for (d2, loo) in model.reference_d2.iter().zip(&model.leave_one_out_d2) {
        assert!((leave_one_out(*d2, 15.0) - loo).abs() < 1e-9 * loo);
    }
}
