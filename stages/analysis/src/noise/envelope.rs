//! Envelopes of curves that many rasters have: at each abscissa the quantiles over the rasters.

use std::collections::BTreeMap;

use rockface_core::artefact::{Cell, Table};
use rockface_core::numerics::quantile::quantile;

/// The quantiles of an envelope: a band of nine tenths, one of a half in it, and the median.
pub const LEVELS: [f64; 5] = [0.05, 0.25, 0.5, 0.75, 0.95];

/// Quantiles of a curve over rasters at one abscissa.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Step {
    /// Abscissa, the mean over the rasters.
    pub x: f64,
    /// The quantiles of the ordinate at [`LEVELS`].
    pub y: [f64; 5],
}

/// The envelope of one curve over all rasters of tables with the columns raster, curve, x, y (as `describe-noise` makes them).
///
/// Rasters of one grid have one set of abscissae; they are told apart by their order within the raster.
pub fn envelope(tables: &[&Table], curve: &str) -> Option<Vec<Step>> {
    let mut steps: BTreeMap<usize, (Vec<f64>, Vec<f64>)> = BTreeMap::new();
    for table in tables {
        let at = ["raster", "curve", "x", "y"].map(|name| table.column(name));
        let [Some(raster), Some(name), Some(x), Some(y)] = at else { return None };
        let (mut place, mut before) = (0, None::<&Cell>);
        for row in table.rows.iter().filter(|row| row[name].text() == Some(curve)) {
            place = if before == Some(&row[raster]) { place + 1 } else { 0 };
            before = Some(&row[raster]);
            if let (Some(x), Some(y)) = (row[x].number(), row[y].number()) {
                let step = steps.entry(place).or_default();
                step.0.push(x);
                step.1.push(y);
            }
        }
    }
    let step = |(xs, ys): (Vec<f64>, Vec<f64>)| {
        let at = |level: f64| quantile(&ys, level).unwrap_or(f64::NAN);
        Step { x: xs.iter().sum::<f64>() / xs.len() as f64, y: LEVELS.map(at) }
    };
    Some(steps.into_values().map(step).collect())
}

/// One curve of every raster of such tables, by the name of the raster, in their order.
pub fn curves_of(tables: &[&Table], curve: &str) -> Option<Vec<(String, Vec<[f64; 2]>)>> {
    let mut curves: Vec<(String, Vec<[f64; 2]>)> = Vec::new();
    for table in tables {
        let at = ["raster", "curve", "x", "y"].map(|name| table.column(name));
        let [Some(raster), Some(name), Some(x), Some(y)] = at else { return None };
        let mut before = None::<&Cell>;
        for row in table.rows.iter().filter(|row| row[name].text() == Some(curve)) {
            if before != Some(&row[raster]) {
                curves.push((row[raster].to_string(), Vec::new()));
            }
            before = Some(&row[raster]);
            if let (Some(x), Some(y), Some((_, points))) = (row[x].number(), row[y].number(), curves.last_mut()) {
                points.push([x, y]);
            }
        }
    }
    Some(curves)
}

/// Number of rasters in such tables.
pub fn rasters(tables: &[&Table]) -> usize {
    let names = |table: &Table| {
        let column = table.column("raster")?;
        let mut names: Vec<String> = table.rows.iter().map(|row| row[column].to_string()).collect();
        names.dedup();
        Some(names.len())
    };
    tables.iter().filter_map(|table| names(table)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_taken_place_by_place_over_rasters_and_tables() {
        let table = |names: &[&str], shift: f64| {
            let mut table = Table::new(["raster", "curve", "x", "y", "n"]);
            for (k, name) in names.iter().enumerate() {
                for i in 0..3 {
                    let y = shift + k as f64 + 10.0 * f64::from(i);
                    table.push(vec![(*name).into(), "roughness".into(), f64::from(i).into(), y.into(), 1.0.into()]);
                }
                table.push(vec![(*name).into(), "spectrum".into(), 7.0.into(), 1.0.into(), 1.0.into()]);
            }
            table
        };
        let (a, b) = (table(&["a", "b"], 0.0), table(&["c"], 2.0));
        let found = envelope(&[&a, &b], "roughness").unwrap();
        assert_eq!(found.len(), 3);
        assert_eq!((found[1].x, found[1].y[2]), (1.0, 11.0));
        assert!((found[2].y[4] - 21.9).abs() < 1e-9 && (found[2].y[1] - 20.5).abs() < 1e-9);
        assert_eq!(
            curves_of(&[&a, &b], "roughness").unwrap()[1],
            ("b".to_owned(), vec![[0.0, 1.0], [1.0, 11.0], [2.0, 21.0]])
        );
        assert_eq!((rasters(&[&a, &b]), envelope(&[&a], "spectrum").unwrap().len()), (3, 1));
        assert!(envelope(&[&Table::new(["x"])], "spectrum").is_none());
    }
}
