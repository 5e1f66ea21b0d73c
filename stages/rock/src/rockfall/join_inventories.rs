//! `join-inventories`: puts the features of many gathered inventories into one.

use rockface_core::artefact::{Cell, Feature, Inventory, Kind};
use rockface_core::{Context, Inputs, Outputs, Page, Port, Stage, StageError, fail, params};
use rockface_raster::feature_rows::{axes, item_cell};

params! {
    /// Parameters of `join-inventories`: there are none.
    pub struct JoinInventoriesParams {}
}

/// Joins the rockfalls of many inventories into one, such as those of all epochs of a benchmark.
pub struct JoinInventories;

impl Stage for JoinInventories {
    type Params = JoinInventoriesParams;
    const NAME: &'static str = "join-inventories";
    const VERSION: u32 = 1;
    const PAGE: Page = Page::new(include_str!("join_inventories.md"));
    const INPUTS: &'static [Port] =
        &[Port::many("inventories", &[Kind::Inventory], "Inventories, gathered over any axes.")];
    const OUTPUTS: &'static [Port] = &[Port::one("inventory", &[Kind::Inventory], "All rockfalls.")];

    fn run(_params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let given = inputs.many::<Inventory>("inventories")?;
        let axes = axes(given.iter().map(|(items, _)| *items));
        let Some((_, first)) = given.first() else { fail!("no inventory is gathered") };
        let mut columns: Vec<String> = Vec::new();
        for (items, inventory) in &given {
            let place: String = items.iter().map(|(axis, item)| format!(" at {axis}={item}")).collect();
            if inventory.frame != first.frame {
                fail!(
                    "the inventory{place} is in the {} frame, the first in the {} frame",
                    inventory.frame,
                    first.frame
                );
            }
            if let Some(column) = inventory.columns.iter().find(|column| axes.contains(column)) {
                return Err(StageError::new(format!(
                    "axis `{column}` is called like a column of the inventory{place}"
                ))
                .hint("rename the axis"));
            }
            let new: Vec<String> = inventory.columns.iter().filter(|c| !columns.contains(c)).cloned().collect();
            columns.extend(new);
        }
        let mut features = Vec::new();
        for (items, inventory) in &given {
            let from: Vec<Option<usize>> = columns.iter().map(|column| inventory.column(column)).collect();
            for feature in &inventory.features {
                let cells = from.iter().map(|at| at.map_or(Cell::Empty(()), |at| feature.values[at].clone()));
                let values = axes.iter().map(|axis| item_cell(items, axis)).chain(cells).collect();
                features.push(Feature { outline: feature.outline.clone(), values });
            }
        }
        context.headline(format!("{} rockfalls of {} inventories", features.len(), given.len()));
        let columns = axes.into_iter().chain(columns).collect();
        Ok(Outputs::of("inventory", Inventory { frame: first.frame, columns, features }))
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use rockface_core::artefact::{Artefact, Frame};
    use rockface_core::testing::TestHost;

    fn joined(given: Vec<(&str, Inventory)>) -> Result<Inventory, StageError> {
        let mut inputs = Inputs::default();
        for (item, inventory) in given {
            let point = [("epoch".to_owned(), item.to_owned())].into_iter().collect();
            inputs.push("inventories", point, Arc::new(inventory.into()));
        }
        let made =
            JoinInventories::run(&JoinInventoriesParams::default(), &inputs, &Context::new(&TestHost::default()))?;
        let Artefact::Inventory(found) = made.into_inner().remove("inventory").unwrap() else { panic!("none") };
        Ok(found)
    }

    fn inventory(column: &str, values: &[f64]) -> Inventory {
        let feature = |value: &f64| Feature { outline: Vec::new(), values: vec![(*value).into()] };
        Inventory {
            frame: Frame::Wall,
            columns: vec![column.to_owned()],
            features: values.iter().map(feature).collect(),
        }
    }

    #[test]
    fn columns_unite_and_items_lead() {
        let found = joined(vec![("0", inventory("a", &[1.0, 2.0])), ("1", inventory("b", &[3.0]))]).unwrap();
        assert_eq!(found.columns, ["epoch", "a", "b"]);
        assert_eq!(found.numbers("a").unwrap(), [Some(1.0), Some(2.0), None]);
        assert_eq!(found.numbers("epoch").unwrap(), [Some(0.0), Some(0.0), Some(1.0)]);
    }

    #[test]
    fn another_frame_or_a_clash_is_refused() {
        let world = Inventory { frame: Frame::World, ..inventory("a", &[1.0]) };
        let error = joined(vec![("0", inventory("a", &[1.0])), ("1", world)]).unwrap_err();
        assert!(error.message.contains("at epoch=1 is in the world frame"));
        assert!(joined(vec![("0", inventory("epoch", &[1.0]))]).unwrap_err().message.contains("axis `epoch`"));
    }
}
