//! Reads the text of a pipeline file, or says why that is impossible.

use std::path::Path;

use crate::diagnostic::{Diagnostic, listed};

/// The text of a file that holds a pipeline or a part.
pub fn read_text(path: &Path) -> Result<String, Diagnostic> {
    let shown = path.display();
    if path.is_dir() {
        let fault = Diagnostic::general(format!("`{shown}` is a folder; a pipeline is a file"));
        return Err(name_one_of(fault, &pipelines_in(path)));
    }
    if is_stream(path) {
        let fault = Diagnostic::general(format!("`{shown}` is no regular file; a pipeline is one"));
        let hint = "write it to a file: the paths in it are relative to that, and its results are kept beside it";
        return Err(fault.hint(hint));
    }
    let bytes = std::fs::read(path).map_err(|error| unreadable(path, &error))?;
    String::from_utf8(bytes).map_err(|error| {
        let at = error.utf8_error().valid_up_to();
        Diagnostic::general(format!("`{shown}` is not a text in UTF-8: its byte {at} fits nowhere"))
            .hint("a pipeline is a YAML text; save it as UTF-8")
    })
}

/// Whether a path leads to what can be read only once, or has no folder of its own: a pipe, a device, the standard input.
pub fn is_stream(path: &Path) -> bool {
    let absolute = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    let lent = ["/dev/stdin", "/dev/fd", "/proc"].iter().any(|place| absolute.starts_with(place));
    lent || path.metadata().is_ok_and(|metadata| !metadata.is_file() && !metadata.is_dir())
}

fn unreadable(path: &Path, error: &std::io::Error) -> Diagnostic {
    let fault = Diagnostic::general(format!("cannot read the pipeline `{}`: {error}", path.display()));
    if error.kind() != std::io::ErrorKind::NotFound {
        return fault;
    }
    let below = below(path);
    if !below.is_empty() {
        return fault
            .hint(format!("there is {}: go into its folder, or name it", listed(below.iter().map(String::as_str))));
    }
    let files = pipelines_in(path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new(".")));
    let given = path.display().to_string();
    let near = crate::diagnostic::nearest(&given, &files.iter().map(String::as_str).collect::<Vec<_>>());
    match near {
        Some(near) if near != given => fault.hint(format!("did you mean `{near}`?")),
        _ => name_one_of(fault, &files),
    }
}

/// Files of the same name one folder down, as one would name them; sorted.
fn below(path: &Path) -> Vec<String> {
    let (Some(name), Some(folder)) = (path.file_name(), path.parent()) else { return Vec::new() };
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path().join(name));
    let files = entries.filter(|path| path.is_file());
    let mut files: Vec<String> =
        files.map(|path| format!("`{}`", path.strip_prefix(".").unwrap_or(&path).display())).collect();
    files.sort();
    files
}

fn name_one_of(fault: Diagnostic, files: &[String]) -> Diagnostic {
    if files.is_empty() { fault } else { fault.hint(format!("YAML files there: {}", files.join(", "))) }
}

/// The YAML files of a folder, sorted, as one would name them.
fn pipelines_in(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let yaml = entries.filter(|path| path.is_file() && path.extension().is_some_and(|e| e == "yaml" || e == "yml"));
    let mut files: Vec<String> =
        yaml.map(|path| path.strip_prefix(".").unwrap_or(&path).display().to_string()).collect();
    files.sort();
    files
}
