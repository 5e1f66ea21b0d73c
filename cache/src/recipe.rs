//! The recipe of an output: everything that decides its bytes and nothing else.

use std::collections::BTreeMap;
use std::sync::Arc;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::Digest;
use crate::canonical::{push_display, write_digest, write_entries, write_list, write_str, write_strings, write_value};

/// Separates keys of random streams from every other use of BLAKE3. Changing it reshuffles every simulation.
const STREAM_CONTEXT: &str = "rockface 1 random stream key";

/// Everything that decides the outputs of a step. Its digest is the key under which they are remembered.
///
/// ```
/// use std::collections::BTreeMap;
/// use std::sync::Arc;
///
/// use rockface_cache::{Digest, Recipe, RecipeInput};
/// use serde_json::json;
///
/// let recipe = Recipe {
///     stage: "difference-dem".into(),
///     version: 1,
///     params: Arc::new(json!({"cell_m": 0.1})),
///     inputs: BTreeMap::from([("reference".into(), RecipeInput::One(Digest::of(b"a raster")))]),
///     seed: None,
/// };
/// assert!(recipe.text().contains(r#""params":{"cell_m":0.1}"#));
/// assert_eq!(recipe.key(), Digest::of(recipe.text().as_bytes()));
/// assert_ne!(recipe.key(), Recipe { version: 2, ..recipe.clone() }.key());
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Recipe {
    /// The name of the stage, such as `remove-blocks`.
    pub stage: String,
    /// The version of the stage's code.
    pub version: u32,
    /// The parameters, defaults filled in, files replaced by their digests.
    #[serde(with = "shared")]
    pub params: Arc<Value>,
    /// What each input port reads.
    pub inputs: BTreeMap<String, RecipeInput>,
    /// Where the random numbers come from; `None` for a stage that draws none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seed: Option<SeedMaterial>,
}

/// What one input port reads.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum RecipeInput {
    /// One artefact that is not gathered, by the digest of its blob.
    One(Digest),
    /// Artefacts gathered over axes, in the order of the points.
    Many(Vec<Gathered>),
}

/// One element of a gathered input.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Gathered {
    /// The item of each gathered axis this element belongs to.
    pub point: BTreeMap<String, String>,
    /// The digest of the artefact.
    pub digest: Digest,
}

/// What a random stream is derived from.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SeedMaterial {
    /// The seed of the pipeline.
    pub seed: u64,
    /// The name of the step, or the label it shares with others.
    pub stream: String,
    /// The item of each reseeding axis.
    pub items: BTreeMap<String, String>,
}

impl Recipe {
    /// The canonical JSON of the recipe. This very text is hashed, stored in the record and printed.
    pub fn text(&self) -> String {
        let mut out = String::with_capacity(512);
        out.push_str("{\"inputs\":");
        write_entries(&mut out, self.inputs.iter(), write_input);
        out.push_str(",\"params\":");
        write_value(&mut out, &self.params);
        if let Some(seed) = &self.seed {
            out.push_str(",\"seed\":");
            seed.write(&mut out);
        }
        out.push_str(",\"stage\":");
        write_str(&mut out, &self.stage);
        push_display(&mut out, format_args!(",\"version\":{}}}", self.version));
        out
    }

    /// The digest of [`Recipe::text`].
    pub fn key(&self) -> Digest {
        Digest::of(self.text().as_bytes())
    }
}

impl SeedMaterial {
    /// The 256-bit key of the stream: `blake3::derive_key` over the canonical JSON of this value.
    pub fn key(&self) -> [u8; 32] {
        let mut text = String::new();
        self.write(&mut text);
        blake3::derive_key(STREAM_CONTEXT, text.as_bytes())
    }

    fn write(&self, out: &mut String) {
        out.push_str("{\"items\":");
        write_strings(out, &self.items);
        push_display(out, format_args!(",\"seed\":{},\"stream\":", self.seed));
        write_str(out, &self.stream);
        out.push('}');
    }
}

/// A value that others hold too, written as if it were held by one alone; for `#[serde(with)]`.
pub mod shared {
    use std::sync::Arc;

    use serde::{Deserialize, Deserializer, Serialize, Serializer};
    use serde_json::Value;

    /// Writes the value as if it were not shared.
    pub fn serialize<S: Serializer>(value: &Arc<Value>, serializer: S) -> Result<S::Ok, S::Error> {
        value.as_ref().serialize(serializer)
    }

    /// Reads a value that nobody else holds yet.
    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Arc<Value>, D::Error> {
        Value::deserialize(deserializer).map(Arc::new)
    }
}

fn write_input(out: &mut String, input: &RecipeInput) {
    match input {
        RecipeInput::One(digest) => write_digest(out, digest),
        RecipeInput::Many(elements) => write_list(out, elements, |out, element| {
            out.push_str("{\"digest\":");
            write_digest(out, &element.digest);
            out.push_str(",\"point\":");
            write_strings(out, &element.point);
            out.push('}');
        }),
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::canonical::tests::any_value;
    use proptest::collection::{btree_map, vec};
    use proptest::prelude::*;
    use serde_json::json;

    fn any_digest() -> impl Strategy<Value = Digest> {
        any::<[u8; 32]>().prop_map(Digest::from_bytes)
    }

    fn any_strings() -> impl Strategy<Value = BTreeMap<String, String>> {
        btree_map(any::<String>(), any::<String>(), 0..3)
    }

    fn any_input() -> impl Strategy<Value = RecipeInput> {
        let element = (any_strings(), any_digest()).prop_map(|(point, digest)| Gathered { point, digest });
        prop_oneof![any_digest().prop_map(RecipeInput::One), vec(element, 0..4).prop_map(RecipeInput::Many)]
    }

    fn any_seed() -> impl Strategy<Value = SeedMaterial> {
        (any::<u64>(), any::<String>(), any_strings()).prop_map(|(seed, stream, items)| SeedMaterial {
            seed,
            stream,
            items,
        })
    }

    prop_compose! {
        pub(crate) fn any_recipe()(
            stage: String, version: u32, params in any_value(),
            inputs in btree_map(any::<String>(), any_input(), 0..4), seed in proptest::option::of(any_seed()),
        ) -> Recipe {
            Recipe { stage, version, params: Arc::new(params), inputs, seed }
        }
    }

    fn strings(pairs: &[(&str, &str)]) -> BTreeMap<String, String> {
        pairs.iter().map(|(key, item)| ((*key).to_owned(), (*item).to_owned())).collect()
    }

    fn fixed() -> Recipe {
        let mesh = RecipeInput::One(Digest::of(b"mesh"));
        let rows =
            RecipeInput::Many(vec![Gathered { point: strings(&[("epoch", "pre")]), digest: Digest::of(b"row") }]);
        Recipe {
            stage: "remove-blocks".into(),
            version: 3,
            params: json!({"radius_m": 1.0, "count": 100, "file": Digest::of(b"").to_string()}).into(),
            inputs: [("rows".to_owned(), rows), ("mesh".to_owned(), mesh)].into(),
            seed: Some(SeedMaterial { seed: 2747, stream: "removed".into(), items: strings(&[("replicate", "7")]) }),
        }
    }

    #[test]
    fn the_text_is_canonical() {
        let expected = format!(
            concat!(
                r#"{{"inputs":{{"mesh":"{}","rows":[{{"digest":"{}","point":{{"epoch":"pre"}}}}]}},"#,
                r#""params":{{"count":100,"file":"{}","radius_m":1.0}},"#,
                r#""seed":{{"items":{{"replicate":"7"}},"seed":2747,"stream":"removed"}},"#,
                r#""stage":"remove-blocks","version":3}}"#
            ),
            Digest::of(b"mesh"),
            Digest::of(b"row"),
            Digest::of(b"")
        );
        assert_eq!(fixed().text(), expected);
    }

    #[test]
    fn the_key_and_the_stream_of_a_fixed_recipe_never_change() {
        // A change here orphans every store and reshuffles every simulation: it needs a new format version.
        assert_eq!(fixed().key().to_string(), "9301eebf15de6e86a6fbc71f410d288675c90490266bd732aebe43eec32368c6");
        let stream = Digest::from_bytes(fixed().seed.unwrap().key());
        assert_eq!(stream.to_string(), "2090106c0da7d3fab642f2b7881d8363742b75c05eaad805e5800b223ca65925");
    }

    #[test]
    fn every_part_of_the_recipe_decides_its_key() {
        let mut others = vec![fixed(); 6];
        others[0].stage.push('s');
        others[1].version = 4;
        Arc::make_mut(&mut others[2].params)["count"] = json!(100.0);
        others[3].inputs.remove("rows");
        others[4].seed = None;
        others[5].seed.as_mut().unwrap().seed = 2748;
        let mut keys: Vec<_> = others.iter().map(Recipe::key).chain([fixed().key()]).collect();
        keys.sort_unstable();
        keys.dedup();
        assert_eq!(keys.len(), 7);
    }

    #[test]
    fn streams_differ_by_seed_name_and_item() {
        let base = fixed().seed.unwrap();
        let other_seed = SeedMaterial { seed: 1, ..base.clone() };
        let other_name = SeedMaterial { stream: "blocks".into(), ..base.clone() };
        let other_item = SeedMaterial { items: strings(&[("replicate", "8")]), ..base.clone() };
        let mut keys = [base.key(), other_seed.key(), other_name.key(), other_item.key()].to_vec();
        keys.sort_unstable();
        keys.dedup();
        assert_eq!(keys.len(), 4);
    }

    proptest! {
        #[test]
        fn the_text_reads_back_as_the_recipe(recipe in any_recipe()) {
            let back: Recipe = serde_json::from_str(&recipe.text()).unwrap();
            prop_assert_eq!(&back, &recipe);
            prop_assert_eq!(back.text(), recipe.text());
        }

        #[test]
        fn serde_and_the_canonical_text_tell_the_same(recipe in any_recipe()) {
            let mut text = String::new();
            write_value(&mut text, &serde_json::to_value(&recipe).unwrap());
            prop_assert_eq!(text, recipe.text());
        }
    }
}
