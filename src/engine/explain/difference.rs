//! In which components two recipes of one stage differ.

use std::collections::{BTreeMap, BTreeSet};

use rockface_cache::{Digest, Recipe, RecipeInput};
use rockface_core::Point;
use serde_json::Value;

/// The place of an artefact among the inputs of a recipe.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct InputPlace {
    /// The input port that the artefact was read at, by the name the stage gives it.
    pub port: String,
    /// The items of the gathered axes; empty for an input that is not gathered.
    pub point: Point,
}

/// The place of one value in a recipe. What a step decides itself comes before what it is given.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
enum Place {
    Version,
    Param(String),
    Seed(String),
    Input(InputPlace),
}

/// One component in which a recipe differs from a former one.
#[derive(Debug, Clone, PartialEq)]
pub struct Change {
    /// Where, such as `params.cell_m` or `inputs.rows[replicate=3]`.
    pub path: String,
    /// What it was; `None` where there was nothing.
    pub old: Option<Value>,
    /// What it is; `None` where there is nothing any more.
    pub new: Option<Value>,
    /// Which input it is, if it is one.
    pub input: Option<InputPlace>,
}

impl Change {
    /// The digest that an input had.
    pub fn old_digest(&self) -> Option<Digest> {
        self.old.as_ref()?.as_str()?.parse().ok()
    }
}

impl std::fmt::Display for Change {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}: {} -> {}", self.path, shown(self.old.as_ref()), shown(self.new.as_ref()))
    }
}

/// A value as people tell it from others: digests cut short.
fn shown(value: Option<&Value>) -> String {
    let digest = value.and_then(Value::as_str).and_then(|text| text.parse::<Digest>().ok());
    match (digest, value) {
        (Some(digest), _) => format!("{}…", digest.short()),
        (None, Some(value)) => value.to_string(),
        (None, None) => "nothing".to_owned(),
    }
}

/// A recipe taken apart into its single values, to be compared with many others.
#[derive(Debug)]
pub struct Parts(BTreeMap<Place, Value>);

impl Parts {
    /// Takes a recipe apart.
    pub fn of(recipe: &Recipe) -> Self {
        let mut parts = BTreeMap::from([(Place::Version, recipe.version.into())]);
        leaves(&recipe.params, "params", &mut |path, value| drop(parts.insert(Place::Param(path), value)));
        if let Some(seed) = &recipe.seed {
            let seed = serde_json::to_value(seed).unwrap_or_default();
            leaves(&seed, "seed", &mut |path, value| drop(parts.insert(Place::Seed(path), value)));
        }
        for (port, input) in &recipe.inputs {
            let mut add = |point: &Point, digest: &Digest| {
                let place = InputPlace { port: port.clone(), point: point.clone() };
                parts.insert(Place::Input(place), digest.to_string().into());
            };
            match input {
                RecipeInput::One(digest) => add(&Point::new(), digest),
                RecipeInput::Many(elements) => elements.iter().for_each(|one| add(&one.point, &one.digest)),
            }
        }
        Self(parts)
    }

    /// What changed from `former` to this, what the step decides itself first.
    pub fn changes_from(&self, former: &Parts) -> Vec<Change> {
        let places: BTreeSet<&Place> = self.0.keys().chain(former.0.keys()).collect();
        let differing = places.into_iter().filter(|place| self.0.get(*place) != former.0.get(*place));
        let change = |place: &Place| Change {
            path: place.to_string(),
            old: former.0.get(place).cloned(),
            new: self.0.get(place).cloned(),
            input: if let Place::Input(input) = place { Some(input.clone()) } else { None },
        };
        differing.map(change).collect()
    }
}

impl std::fmt::Display for Place {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Version => f.write_str("version"),
            Self::Param(path) | Self::Seed(path) => f.write_str(path),
            Self::Input(InputPlace { port, point }) if point.is_empty() => write!(f, "inputs.{port}"),
            Self::Input(InputPlace { port, point }) => {
                let items: Vec<String> = point.iter().map(|(axis, item)| format!("{axis}={item}")).collect();
                write!(f, "inputs.{port}[{}]", items.join(","))
            }
        }
    }
}

/// Tells every value that holds no others, by its path.
fn leaves(value: &Value, path: &str, tell: &mut impl FnMut(String, Value)) {
    match value {
        Value::Object(map) if !map.is_empty() => {
            map.iter().for_each(|(key, inner)| leaves(inner, &format!("{path}.{key}"), tell));
        }
        Value::Array(list) if !list.is_empty() => {
            list.iter().enumerate().for_each(|(i, inner)| leaves(inner, &format!("{path}[{i}]"), tell));
        }
        other => tell(path.to_owned(), other.clone()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_cache::{Gathered, SeedMaterial};
    use serde_json::json;

    fn recipe(params: Value, row: &[u8]) -> Recipe {
        let element = |item: &str, bytes: &[u8]| Gathered {
            point: [("k".to_owned(), item.to_owned())].into(),
            digest: Digest::of(bytes),
        };
        let rows = RecipeInput::Many(vec![element("1", b"one"), element("2", row)]);
        Recipe {
            stage: "s".into(),
            version: 1,
            params: params.into(),
            inputs: [("mesh".to_owned(), RecipeInput::One(Digest::of(b"m"))), ("rows".to_owned(), rows)].into(),
            seed: Some(SeedMaterial { seed: 1, stream: "s".into(), items: Point::new() }),
        }
    }

    fn told(old: &Recipe, new: &Recipe) -> Vec<String> {
        Parts::of(new).changes_from(&Parts::of(old)).iter().map(ToString::to_string).collect()
    }

    #[test]
    fn every_component_is_told_by_its_path() {
        let old = recipe(json!({"a": 1, "window": [0.0, 1.0], "map": {"x": "tin"}}), b"two");
        assert_eq!(told(&old, &old), Vec::<String>::new());
        let mut new = recipe(json!({"a": 1.0, "window": [0.0, 2.0], "map": {"y": "tin"}}), b"three");
        new.version = 2;
        new.seed.as_mut().unwrap().seed = 7;
        let short = |bytes: &[u8]| format!("{}…", Digest::of(bytes).short());
        let expected = [
            "version: 1 -> 2".to_owned(),
            "params.a: 1 -> 1.0".to_owned(),
            "params.map.x: \"tin\" -> nothing".to_owned(),
            "params.map.y: nothing -> \"tin\"".to_owned(),
            "params.window[1]: 1.0 -> 2.0".to_owned(),
            "seed.seed: 1 -> 7".to_owned(),
            format!("inputs.rows[k=2]: {} -> {}", short(b"two"), short(b"three")),
        ];
        assert_eq!(told(&old, &new), expected);
    }

    #[test]
    fn recipes_of_different_keys_differ_somewhere() {
        let base = recipe(json!({"a": []}), b"two");
        let mut others = vec![base.clone(); 4];
        others[0].seed = None;
        others[1].inputs.remove("mesh");
        others[2].params = json!({"a": {}}).into();
        others[3].params = json!({}).into();
        for other in others {
            assert_ne!(other.key(), base.key());
            assert!(!told(&base, &other).is_empty() && !told(&other, &base).is_empty(), "{other:?}");
        }
    }
}
