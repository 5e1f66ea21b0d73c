//! `import-table`: reads a CSV file into a table, such as the positions of blocks or of surveyed rockfalls.

use nalgebra::Point3;

use rockface_core::artefact::{Cell, Kind, Table, Transform};
use rockface_core::format::table_file;
use rockface_core::params::FileRef;
use rockface_core::{Context, Inputs, Outputs, Page, Port, Stage, StageError, fail, params};

/// The columns a transform moves.
const POSITION: [&str; 3] = ["x_m", "y_m", "z_m"];

params! {
    /// What a column of a file is called in the table.
    pub struct Renamed {
        /// Its name in the file.
        from: String,
        /// Its name in the table, with its unit.
        to: String,
    }
}

params! {
    /// Parameters of `import-table`.
    pub struct ImportTableParams {
        /// The file: a header line, then a row a line; separated by commas, semicolons or tabs.
        path: FileRef,
        /// Columns to be called differently.
        rename: Vec<Renamed> = Vec::new(),
    }
}

/// Reads a table from a CSV file.
pub struct ImportTable;

impl Stage for ImportTable {
    type Params = ImportTableParams;
    const NAME: &'static str = "import-table";
    const VERSION: u32 = 3;
    const PAGE: Page = Page::new(include_str!("import_table.md"));
    const INPUTS: &'static [Port] =
        &[Port::optional("transform", &[Kind::Transform], "wall_from_world, which positions are moved by.")];
    const OUTPUTS: &'static [Port] = &[Port::one("table", &[Kind::Table], "The table.")];

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let path = &params.path.0;
        let failed = |e: StageError| e.within(format!("cannot read `{path}`"));
        let mut table =
            table_file::read(&context.read(&params.path)?, &|| context.cancelled()).map_err(|e| failed(e.0.into()))?;
        rename(&mut table, &params.rename).map_err(failed)?;
        if let Some(transform) = inputs.optional::<Transform>("transform")? {
            move_positions(&mut table, transform).map_err(failed)?;
        }
        context.metric("rows", table.rows.len() as f64, "1");
        context.note(format!("{} rows of {}", table.rows.len(), table_file::listed(&table)));
        Ok(Outputs::of("table", table))
    }
}

fn rename(table: &mut Table, renamed: &[Renamed]) -> Result<(), StageError> {
    for Renamed { from, to } in renamed {
        let missing = || format!("it has no column `{from}` to rename, only {}", table_file::listed(table));
        let at = table.column(from).ok_or_else(missing)?;
        if table.column(to).is_some() {
            fail!("`{from}` cannot be called `{to}`: another column is called so already");
        }
        table.columns[at].clone_from(to);
    }
    Ok(())
}

fn move_positions(table: &mut Table, transform: &Transform) -> Result<(), StageError> {
    let missing = |name: &str| format!("a transform moves positions, but there is no column `{name}`");
    let mut at = [0; 3];
    for (at, name) in at.iter_mut().zip(POSITION) {
        *at = table.column(name).ok_or_else(|| missing(name))?;
    }
    for (row, cells) in table.rows.iter_mut().enumerate() {
        let number = |i: usize| {
            cells[at[i]].number().ok_or_else(|| format!("row {} of column `{}` holds no number", row + 1, POSITION[i]))
        };
        let moved = transform.apply(&Point3::new(number(0)?, number(1)?, number(2)?));
        at.iter().zip(moved.coords.iter()).for_each(|(at, value)| cells[*at] = Cell::from(*value));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use rockface_core::artefact::Artefact;
    use rockface_core::testing::{TestHost, run_stage};

    fn import(text: &str, rename: &[[&str; 2]], transform: Option<Transform>) -> Result<Table, StageError> {
        let host = TestHost::default().with("p.csv", &[("p.csv", text.as_bytes())]);
        let rename: Vec<_> = rename.iter().map(|[from, to]| json!({"from": from, "to": to})).collect();
        let inputs: Vec<_> = transform.into_iter().map(|t| ("transform", Artefact::from(t))).collect();
        let outputs = run_stage::<ImportTable>(&host, &json!({"path": "p.csv", "rename": rename}), &inputs)?;
        match outputs.into_inner().remove("table") {
            Some(Artefact::Table(table)) => Ok(table),
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn positions_are_renamed_and_taken_to_the_wall() {
        let quarter = nalgebra::Matrix3::new(0.0, 1.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 1.0);
        let origin = nalgebra::Vector3::new(450_000.0, 0.0, 0.0);
        let transform = Transform::new("world", "wall", &quarter, origin, nalgebra::Vector3::zeros());
        let text = "east,north,z_m,class\n450001.5,2,3,slab\n";
        let table = import(text, &[["east", "x_m"], ["north", "y_m"]], Some(transform)).unwrap();
        assert_eq!(table.columns, ["x_m", "y_m", "z_m", "class"]);
        assert_eq!(table.rows[0], [2.0.into(), (-1.5).into(), 3.0.into(), "slab".into()]);
    }

    #[test]
    fn faults_name_file_row_and_column() {
        let identity = || Some(Transform::identity("world", "wall"));
        let message = |text: &str, rename: &[[&str; 2]], by| import(text, rename, by).unwrap_err().message;
        assert!(message("a,a\n", &[], None).contains("`p.csv`"));
        assert!(message("a,b\n", &[["c", "d"]], None).contains("no column `c`"));
        assert!(message("a,b\n", &[["a", "b"]], None).contains("called so already"));
        assert!(message("x_m,y_m\n", &[], identity()).contains("no column `z_m`"));
        assert!(message("x_m,y_m,z_m\n1,2,3\n1,,3\n", &[], identity()).contains("row 2 of column `y_m`"));
    }
}
