//! Where candidates stand: uniformly on a face or a zone, by a density, or where a table says.

use std::collections::BTreeMap;

use super::evaluate::Stand;
use super::zone::zone_band;
use crate::rockfall::block::placement::class_of_band;
use rockface_core::artefact::{Band, Cell, Grid, Mesh, Raster, Table};
use rockface_core::distribution::Draws;
use rockface_core::{StageError, fail};

/// A source of places.
pub enum Sites {
    /// Uniform in plan over the triangles that face outward: the running sum of their areas in plan.
    Face(Vec<f64>),
    /// A raster: running sums of the weights of its cells, by class; `None` holds for every class.
    Cells(Grid, BTreeMap<Option<String>, Vec<f64>>),
    /// Rows in their order.
    Rows(Vec<Row>),
}

/// One row of a table of places.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    /// Where the block stands.
    pub stand: Stand,
    /// The class it must be of.
    pub class: Option<String>,
}

/// The band of a density that holds for every class.
const ALL: &str = "all";

impl Sites {
    /// Uniform over a face.
    pub fn on_face(mesh: &Mesh) -> Result<Self, StageError> {
        let plan = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|v| mesh.vertices[v as usize]);
            (0.5 * ((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))).max(0.0)
        };
        let sums = running(mesh.triangles.iter().map(plan));
        if sums.last().is_some_and(|sum| *sum > 0.0) {
            Ok(Self::Face(sums))
        } else {
            Err(StageError::new("no triangle of the mesh faces along +Z, out of the rock"))
        }
    }

    /// Uniform over the cells of a zone that are not 0.
    pub fn in_zone(zone: &Raster) -> Result<Self, StageError> {
        let band = zone_band(zone)?;
        let sums = running(band.values.iter().map(|value| if *value > 0.0 { 1.0 } else { 0.0 }));
        if sums.last().is_none_or(|sum| *sum <= 0.0) {
            return Err(StageError::new("every cell of the zone is 0: there is no place for a block"));
        }
        Ok(Self::Cells(zone.grid, BTreeMap::from([(None, sums)])))
    }

    /// By a density with one band for all classes, or a band a class.
    pub fn by_density(density: &Raster) -> Result<Self, StageError> {
        let mut sums = BTreeMap::new();
        for Band { name, values } in &density.bands {
            let weights = running(values.iter().map(|v| f64::from(*v).max(0.0)));
            if weights.last().is_none_or(|sum| *sum <= 0.0) {
                fail!("band `{name}` of the density is 0 everywhere");
            }
            let class = class_of_band(name);
            if sums.insert((class != ALL).then(|| class.to_owned()), weights).is_some() {
                fail!("two bands of the density are for class `{class}`");
            }
        }
        Ok(Self::Cells(density.grid, sums))
    }

    /// The rows of a table with the columns `x_m` and `y_m`, and optionally `z_m`, `class` and `spin_deg`.
    pub fn from_table(table: &Table) -> Result<Self, StageError> {
        let needed =
            |name: &str| table.column(name).ok_or_else(|| format!("the table of positions has no column `{name}`"));
        let (x, y) = (needed("x_m")?, needed("y_m")?);
        let (z, spin, class) = (table.column("z_m"), table.column("spin_deg"), table.column("class"));
        let row = |(number, cells): (usize, &Vec<Cell>)| {
            let numeric = |column: usize| match &cells[column] {
                Cell::Number(value) => Ok(Some(*value)),
                Cell::Empty(()) => Ok(None),
                other => Err(StageError::new(format!("row {} of the positions: `{other}` is no number", number + 1))),
            };
            let optional = |column: Option<usize>| column.map_or(Ok(None), numeric);
            let must = |column: usize| {
                let missing = || StageError::new(format!("row {} of the positions has no x_m or y_m", number + 1));
                numeric(column)?.ok_or_else(missing)
            };
            let xy = [must(x)?, must(y)?];
            let spin_rad = optional(spin)?.unwrap_or(0.0).to_radians();
            let stand = match optional(z)? {
                Some(z) => Stand::At { place: [xy[0], xy[1], z], spin_rad },
                None => Stand::On { xy, spin_rad },
            };
            let class = class.map(|column| cells[column].to_string()).filter(|name| !name.is_empty());
            Ok(Row { stand, class })
        };
        Ok(Self::Rows(table.rows.iter().enumerate().map(row).collect::<Result<_, StageError>>()?))
    }

    /// The classes a density has bands for, where none holds for all.
    pub fn missing_class<'a>(&self, classes: &'a [String]) -> Option<&'a str> {
        let Self::Cells(_, sums) = self else { return None };
        let covered = |class: &&String| sums.contains_key(&None) || sums.contains_key(&Some((*class).clone()));
        classes.iter().find(|class| !covered(class)).map(String::as_str)
    }

    /// A place for a candidate of a class; `None` in a table, or for a class without a band.
    pub fn draw(&self, mesh: &Mesh, draws: &Draws, class: &str) -> Option<Stand> {
        let uniform = |purpose: &str| draws.uniform(purpose);
        let xy = match self {
            Self::Face(sums) => {
                let triangle = mesh.triangles[pick(sums, uniform("triangle"))];
                let [a, b, c] = triangle.map(|v| mesh.vertices[v as usize]);
                let (u, v) = (uniform("u"), uniform("v"));
                let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
                [0, 1].map(|k| a[k] + u * (b[k] - a[k]) + v * (c[k] - a[k]))
            }
            Self::Cells(grid, sums) => {
                let sums = sums.get(&Some(class.to_owned())).or_else(|| sums.get(&None))?;
                let cell = pick(sums, uniform("cell"));
                let (x, y) = grid.centre(cell / grid.columns, cell % grid.columns);
                [x + (uniform("u") - 0.5) * grid.cell_m, y + (uniform("v") - 0.5) * grid.cell_m]
            }
            Self::Rows(_) => return None,
        };
        Some(Stand::On { xy, spin_rad: 0.0 })
    }
}

fn running(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let add = |sum: &mut f64, value: f64| {
        if value.is_finite() {
            *sum += value;
        }
        Some(*sum)
    };
    values.scan(0.0, add).collect()
}

/// The first item whose running sum exceeds a share of the whole.
fn pick(sums: &[f64], share: f64) -> usize {
    let whole = sums.last().copied().unwrap_or(0.0);
    sums.partition_point(|sum| *sum <= share * whole).min(sums.len().saturating_sub(1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::artefact::Frame;
    use rockface_core::numerics::random::Key;
    use rockface_core::testing::height_mesh;

    fn stands(sites: &Sites, mesh: &Mesh, class: &str) -> Vec<[f64; 2]> {
        let place = |n| match sites.draw(mesh, &Draws::new(Key([3; 32]), n), class) {
            Some(Stand::On { xy, .. }) => xy,
            other => panic!("{other:?}"),
        };
        (0..4000).map(place).collect()
    }

    #[test]
    fn places_spread_evenly_over_face_and_zone() {
        let mesh = height_mesh(3, [0.0, 4.0, 0.0, 2.0], |x, _| x * x);
        let grid = Grid { columns: 4, rows: 2, cell_m: 1.0, left_m: 0.0, top_m: 2.0 };
        let zone = Raster::single(grid, Frame::Wall, "mask", "zone", vec![0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0]);
        for (sites, low, high) in
            [(Sites::on_face(&mesh).unwrap(), 0.0, 4.0), (Sites::in_zone(&zone).unwrap(), 1.0, 3.0)]
        {
            let places = stands(&sites, &mesh, "prism");
            assert!(places.iter().all(|p| p[0] >= low && p[0] <= high && (0.0..=2.0).contains(&p[1])));
            for k in [0, 1] {
                let mean = places.iter().map(|p| p[k]).sum::<f64>() / 4000.0;
                let wanted = [0.5 * low + 0.5 * high, 1.0][k];
                assert!((mean - wanted).abs() < 0.06, "{k} {mean} {wanted}");
            }
        }
    }

    #[test]
    fn a_density_sends_each_class_to_its_own_cells() {
        let grid = Grid { columns: 2, rows: 1, cell_m: 1.0, left_m: 0.0, top_m: 1.0 };
        let mut density = Raster::single(grid, Frame::Wall, "placement_density", "prism", vec![1.0, 0.0]);
        density.bands.push(Band { name: "wedge".into(), values: vec![f32::NAN, 2.0] });
        let sites = Sites::by_density(&density).unwrap();
        let mesh = height_mesh(1, [0.0, 2.0, 0.0, 1.0], |_, _| 0.0);
        assert!(stands(&sites, &mesh, "prism").iter().all(|p| p[0] < 1.0));
        assert!(stands(&sites, &mesh, "wedge").iter().all(|p| p[0] > 1.0));
        assert_eq!(sites.missing_class(&["wedge".into(), "cone".into()]), Some("cone"));
        // A band of probabilities of another program names its class behind `prob.`.
        density.bands.iter_mut().for_each(|band| band.name = format!("prob.{}", band.name));
        let named = Sites::by_density(&density).unwrap();
        assert_eq!(stands(&named, &mesh, "wedge"), stands(&sites, &mesh, "wedge"));
        assert_eq!(named.missing_class(&["wedge".into(), "cone".into()]), Some("cone"));
        density.bands[0].name = "wedge".into();
        assert!(Sites::by_density(&density).err().unwrap().message.contains("two bands"));
    }

    #[test]
    fn rows_of_a_table_are_places() {
        let mut table = Table::new(["y_m", "x_m", "class", "z_m"]);
        table.push(vec![2.0.into(), 1.0.into(), "prism".into(), Cell::Empty(())]);
        table.push(vec![2.0.into(), 1.0.into(), Cell::Empty(()), 0.5.into()]);
        let Sites::Rows(rows) = Sites::from_table(&table).unwrap() else { panic!("no rows") };
        let class = Some("prism".to_owned());
        assert_eq!(rows[0], Row { stand: Stand::On { xy: [1.0, 2.0], spin_rad: 0.0 }, class });
        assert_eq!(rows[1].stand, Stand::At { place: [1.0, 2.0, 0.5], spin_rad: 0.0 });
        table.push(vec!["left".into(), 1.0.into(), "prism".into(), Cell::Empty(())]);
        assert!(Sites::from_table(&table).err().unwrap().message.contains("row 3"));
        assert!(Sites::from_table(&Table::new(["x_m"])).err().unwrap().message.contains("`y_m`"));
    }
}
