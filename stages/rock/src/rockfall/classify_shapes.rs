//! `classify-shapes`: puts bodies into the shape classes of Sneed and Folk.

use crate::rockfall::ground_truth::Facets;
use crate::rockfall::ground_truth::bounding_box::oriented_box;
use crate::rockfall::ground_truth::sneed_folk;
use crate::rockfall::ground_truth::sneed_folk::CLASSES;
use rockface_core::artefact::{Artefact, Cell, Kind, Meshes, Table};
use rockface_core::{Context, Inputs, Outputs, Page, Port, Stage, StageError, params};
use rockface_raster::columns;

params! {
    /// Parameters of `classify-shapes`.
    pub struct ClassifyShapesParams {
        /// Columns with the three axes, in any order; closed meshes are measured instead.
        axes: Vec<String> = ["long_m", "intermediate_m", "short_m"].map(str::to_owned).to_vec(),
        /// Column that names each body; left out, bodies are numbered from 1.
        name: Option<String> = None,
    }
}

/// Classifies the shapes of the bodies of an inventory, a table or a file of meshes.
pub struct ClassifyShapes;

impl Stage for ClassifyShapes {
    type Params = ClassifyShapesParams;
    const NAME: &'static str = "classify-shapes";
    const VERSION: u32 = 1;
    const PAGE: Page = Page::new(include_str!("classify_shapes.md"));
    const INPUTS: &'static [Port] = &[Port::one(
        "bodies",
        &[Kind::Inventory, Kind::Table, Kind::Meshes],
        "A ground truth, a table with three axes a row, or named meshes.",
    )];
    const OUTPUTS: &'static [Port] = &[
        Port::one("shapes", &[Kind::Table], "One row a body: name, axes, ratios, class."),
        Port::one("classes", &[Kind::Table], "One row a class: how many, and which share."),
    ];

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let bodies = match inputs.artefact("bodies")? {
            Artefact::Meshes(meshes) => measured(meshes),
            rows => listed(rows, params)?,
        };
        let mut shapes = Table::new([
            "name",
            "long_m",
            "intermediate_m",
            "short_m",
            "flatness",
            "elongation",
            "sphericity",
            "class",
        ]);
        let mut counts = [0usize; CLASSES.len()];
        for (name, mut sides) in bodies.iter().cloned() {
            let Some(form) = sneed_folk::form(sides) else { continue };
            sides.sort_by(|a, b| b.total_cmp(a));
            let numbers = sides.into_iter().chain([form.flatness, form.elongation, form.sphericity]);
            let cells = std::iter::once(Cell::from(name)).chain(numbers.map(Cell::from));
            shapes.push(cells.chain([Cell::from(form.class)]).collect());
            counts.iter_mut().zip(CLASSES).filter(|(_, class)| *class == form.class).for_each(|(n, _)| *n += 1);
        }
        report(bodies.len(), shapes.rows.len(), context)?;
        let mut classes = Table::new(["class", "count", "share"]);
        for (class, count) in CLASSES.into_iter().zip(counts) {
            let share = count as f64 / shapes.rows.len() as f64;
            classes.push(vec![class.into(), (count as f64).into(), share.into()]);
        }
        Ok(Outputs::of("shapes", shapes).and("classes", classes))
    }
}

fn report(bodies: usize, classified: usize, context: &Context) -> Result<(), StageError> {
    if classified == 0 {
        return Err(StageError::new(format!("none of the {bodies} bodies has three axes")));
    }
    if classified < bodies {
        context.warn(format!("{} of {bodies} bodies have no three axes and are left out", bodies - classified));
    }
    context.headline(format!("{classified} bodies classified"));
    Ok(())
}

/// Names and axes of meshes; a body without extent gets axes that are no numbers.
fn measured(meshes: &Meshes) -> Vec<(String, [f64; 3])> {
    let sides = |part: &rockface_core::artefact::Part| {
        let facets = Facets { vertices: part.vertices.clone(), triangles: part.triangles.clone() };
        let axes = facets.body().map_or_else(unit_axes, |body| body.principal_axes());
        oriented_box(&facets, axes).map_or([f64::NAN; 3], |found| found.sides_m)
    };
    meshes.parts.iter().map(|part| (part.name.clone(), sides(part))).collect()
}

fn unit_axes() -> [nalgebra::Vector3<f64>; 3] {
    [nalgebra::Vector3::x(), nalgebra::Vector3::y(), nalgebra::Vector3::z()]
}

fn listed(rows: &Artefact, params: &ClassifyShapesParams) -> Result<Vec<(String, [f64; 3])>, StageError> {
    let [a, b, c] = params.axes.as_slice() else {
        return Err(StageError::new(format!("`axes` names {} columns, three are needed", params.axes.len())));
    };
    let numbers = |column: &String| columns::numbers(rows, column);
    let (a, b, c) = (numbers(a)?, numbers(b)?, numbers(c)?);
    let names = names(rows, params.name.as_deref(), a.len())?;
    let or_none = |number: &Option<f64>| number.unwrap_or(f64::NAN);
    let sides = a.iter().zip(&b).zip(&c).map(|((a, b), c)| [a, b, c].map(or_none));
    Ok(names.into_iter().zip(sides).collect())
}

fn names(rows: &Artefact, column: Option<&str>, count: usize) -> Result<Vec<String>, StageError> {
    let Some(column) = column else { return Ok((1..=count).map(|number| number.to_string()).collect()) };
    let (columns, rows) = columns::rows(rows).ok_or_else(|| StageError::new("there are no rows"))?;
    let place = columns::place(columns, column)?;
    Ok(rows.iter().map(|row| row.get(place).map_or_else(String::new, ToString::to_string)).collect())
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use rockface_core::artefact::{Frame, Part};
    use rockface_core::testing::{TestHost, run_stage};

    fn classes(made: Outputs) -> Vec<(String, f64)> {
        let Some(Artefact::Table(table)) = made.into_inner().remove("classes") else { panic!("no classes") };
        let row = |row: &Vec<Cell>| (row[0].to_string(), row[1].number().unwrap());
        table.rows.iter().map(row).filter(|(_, count)| *count > 0.0).collect()
    }

    #[test]
    fn rows_are_classified_and_those_without_axes_left_out() {
        let mut table = Table::new(["who", "a", "b", "c"]);
        for (who, a, b, c) in [("x", 1.0, 1.0, 1.0), ("y", 0.1, 1.0, 0.1), ("z", f64::NAN, 1.0, 1.0)] {
            table.push(vec![who.into(), a.into(), b.into(), c.into()]);
        }
        let host = TestHost::default();
        let with = json!({"axes": ["a", "b", "c"], "name": "who"});
        let made = run_stage::<ClassifyShapes>(&host, &with, &[("bodies", table.clone().into())]).unwrap();
        assert_eq!(classes(made), [("C".to_owned(), 1.0), ("VE".to_owned(), 1.0)]);
        assert!(host.warnings()[0].contains("1 of 3 bodies"));
        let refused = run_stage::<ClassifyShapes>(&host, &json!({"axes": ["a"]}), &[("bodies", table.into())]);
        assert!(refused.unwrap_err().message.contains("names 1 columns"));
    }

    #[test]
    fn meshes_are_measured() {
        let flat = |name: &str, z: f64| {
            let corner = |i: u32| [f64::from(i & 1), f64::from(i >> 1 & 1), z * f64::from(i >> 2)];
            let triangles = vec![[0, 2, 1], [0, 1, 4], [0, 4, 2], [1, 2, 4]];
            Part { name: name.into(), class: String::new(), vertices: (0..5).map(corner).collect(), triangles }
        };
        let parts = vec![flat("plate", 0.1), flat("thick", 1.0)];
        let meshes = Meshes { frame: Frame::Wall, parts };
        let made = run_stage::<ClassifyShapes>(&TestHost::default(), &json!({}), &[("bodies", meshes.into())]).unwrap();
        let found = classes(made);
        assert!(found.iter().any(|(class, count)| class == "VP" && (*count - 1.0).abs() < 1e-12), "{found:?}");
    }
}
