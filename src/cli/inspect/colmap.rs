//! Models of COLMAP, which are several files of a folder: what `inspect` says of one, and of a folder with models below it.

use std::path::{Path, PathBuf};

use rockface_core::artefact::Frame;
use rockface_imaging::camera::camera_files::recognise::{Part, Role, read};
use serde_json::json;

use super::Facts;

/// The files of a model that are read, in the order in which they are looked for.
const FILES: [[(Role, &str); 2]; 2] = [
    [(Role::BinaryCameras, "cameras.bin"), (Role::BinaryImages, "images.bin")],
    [(Role::TextCameras, "cameras.txt"), (Role::TextImages, "images.txt")],
];
/// Folders of a project between its own and that of a model, as `sparse/0`.
const DEEPEST: usize = 2;
/// Entries of a folder that are looked at.
const MOST_ENTRIES: usize = 1000;

/// What there is to say of a file of a model; `None` for any other.
pub fn of_file(path: &Path) -> Option<Facts> {
    let name = path.file_name()?.to_str()?;
    let model = FILES.into_iter().find(|files| files.iter().any(|(_, own)| *own == name))?;
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    told(folder, model)
}

/// What there is to say of a folder with a model, or with models in folders below; `None` for any other.
pub fn of_folder(folder: &Path) -> Option<Facts> {
    if let Some(facts) = FILES.into_iter().find_map(|model| told(folder, model)) {
        return Some(facts);
    }
    let mut models = Vec::new();
    find(folder, 0, &mut models);
    models.sort();
    let first = models.first()?;
    let way = format!(
        "the folder of a COLMAP model is read by a step: `stage: import-cameras, with: {{path: {}}}`",
        first.display()
    );
    let paths: Vec<String> = models.iter().map(|model| model.display().to_string()).collect();
    Some(vec![
        ("kind".into(), "not an artefact".into()),
        ("COLMAP models".into(), json!(paths)),
        ("why".into(), way.into()),
    ])
}

fn find(folder: &Path, depth: usize, models: &mut Vec<PathBuf>) {
    if depth > 0 && FILES.iter().any(|model| model.iter().all(|(_, name)| folder.join(name).is_file())) {
        models.push(folder.to_owned());
    }
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten().take(MOST_ENTRIES);
    if depth < DEEPEST {
        entries.map(|entry| entry.path()).filter(|path| path.is_dir()).for_each(|path| find(&path, depth + 1, models));
    }
}

fn told(folder: &Path, model: [(Role, &str); 2]) -> Option<Facts> {
    let part = |(role, name): (Role, &str)| {
        Some(Part { role, name: name.to_owned(), bytes: std::fs::read(folder.join(name)).ok()? })
    };
    let parts: Vec<Part> = model.into_iter().map(part).collect::<Option<_>>()?;
    let way = format!(
        "files of other programs are read by a step: `stage: import-cameras, with: {{path: {}}}`, the folder of the model",
        folder.display()
    );
    let content = match read(&parts, Frame::World, None) {
        Ok(file) => {
            let [images, cameras] = [file.cameras.images.len(), file.cameras.sensors.len()];
            format!("a COLMAP model: {images} images, {cameras} cameras")
        }
        // A text of this name may be anything; the magic of binary files is their name.
        Err(_) if model[0].0 == Role::TextCameras => return None,
        Err(error) => format!("a COLMAP model that cannot be read: {}", error.message),
    };
    Some(vec![
        ("kind".into(), "not an artefact".into()),
        ("content".into(), content.into()),
        ("why".into(), way.into()),
    ])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_model_is_told_by_its_files_its_folder_and_the_folder_above() {
        let root = tempfile::tempdir().unwrap();
        let model = root.path().join("sparse").join("0");
        std::fs::create_dir_all(&model).unwrap();
        std::fs::write(model.join("cameras.txt"), "1 PINHOLE 9 7 9 9 1 1\n").unwrap();
        assert!(of_file(&model.join("cameras.txt")).is_none(), "half a model");
        std::fs::write(model.join("images.txt"), "1 1 0 0 0 0 0 0 1 a.png\n\n").unwrap();
        let said =
            |facts: Option<Facts>| facts.unwrap().into_iter().map(|(_, value)| value.to_string()).collect::<String>();
        for facts in [of_file(&model.join("images.txt")), of_folder(&model)] {
            let said = said(facts);
            assert!(said.contains("1 images, 1 cameras") && said.contains("stage: import-cameras"), "{said}");
        }
        let above = said(of_folder(root.path()));
        assert!(above.contains(&format!("path: {}", model.display())), "{above}");
        std::fs::write(model.join("images.txt"), "1.5 2.5 3.5\n").unwrap();
        assert!(of_file(&model.join("images.txt")).is_none(), "points of a cloud");
        assert!(of_file(&root.path().join("points.txt")).is_none());
    }
}
