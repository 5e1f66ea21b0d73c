//! Which past run a record is known from: the folders of runs, looked through for its key.

use std::path::Path;

use rockface_cache::Digest;

/// The latest run in a folder of runs whose manifest names a key. Names begin with the time, so the last one is looked
/// at first; the text is searched, since reading the manifests of large runs as JSON takes long.
pub fn run_naming(runs: &Path, key: &Digest) -> Option<String> {
    let entries = std::fs::read_dir(runs).ok()?.flatten();
    // `latest` is another name of one of them.
    let folders = entries.filter(|entry| entry.file_type().is_ok_and(|kind| kind.is_dir()));
    let mut names: Vec<String> = folders.filter_map(|entry| entry.file_name().into_string().ok()).collect();
    names.sort_unstable_by(|one, other| other.cmp(one));
    let key = key.to_string();
    let names_key = |name: &String| {
        std::fs::read_to_string(runs.join(name).join("run.json")).is_ok_and(|manifest| manifest.contains(&key))
    };
    names.into_iter().find(names_key)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_latest_run_that_names_a_key_is_found() {
        let runs = tempfile::tempdir().unwrap();
        let (key, other) = (Digest::of(b"key"), Digest::of(b"other"));
        assert_eq!(run_naming(&runs.path().join("nowhere"), &key), None);
        for (name, named) in [("2001-a", key), ("2002-a", key), ("2003-a", other)] {
            std::fs::create_dir(runs.path().join(name)).unwrap();
            std::fs::write(runs.path().join(name).join("run.json"), format!("{{\"key\": \"{named}\"}}")).unwrap();
        }
        std::fs::create_dir(runs.path().join("2004-torn")).unwrap();
        assert_eq!(run_naming(runs.path(), &key).as_deref(), Some("2002-a"));
        assert_eq!(run_naming(runs.path(), &Digest::of(b"neither")), None);
    }
}
