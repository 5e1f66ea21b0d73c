//! Distributions that are in files, replaced by the values of those files.

use serde_json::{Map, Value, json};

use crate::StageError;
use crate::format::table_file;
use crate::params::ParamType;

/// How the content of a file is had by the path that names it.
pub type ReadFile<'a> = dyn Fn(&str) -> Result<Vec<u8>, StageError> + 'a;

/// The same parameters with `{file: {path, column, smooth}}`, wherever it stands, replaced by
/// `{samples: {values, smooth}}`, the values in ascending order; and checked again, now that the values are known.
pub fn with_files_read<T: ParamType>(params: &T, read: &ReadFile) -> Result<T, StageError> {
    let mut value = params.encode();
    replace(&mut value, read)?;
    T::decode(&value).map_err(|faults| {
        let text = |fault: &crate::params::Fault| format!("{}: {}", fault.path.join("."), fault.message);
        StageError::new(faults.iter().map(text).collect::<Vec<_>>().join("; "))
    })
}

fn replace(value: &mut Value, read: &ReadFile) -> Result<(), StageError> {
    match value {
        Value::Array(items) => items.iter_mut().try_for_each(|item| replace(item, read)),
        Value::Object(map) => {
            if let (1, Some(file)) = (map.len(), map.get("file")) {
                *map = samples(file, read)?;
            }
            map.values_mut().try_for_each(|inner| replace(inner, read))
        }
        _ => Ok(()),
    }
}

fn samples(file: &Value, read: &ReadFile) -> Result<Map<String, Value>, StageError> {
    let text = |key: &str| file[key].as_str().unwrap_or_default();
    let path = text("path");
    let table = table_file::read(&read(path)?, &|| false);
    let values = table.and_then(|table| table_file::numbers(&table, text("column")));
    let mut values = values.map_err(|e| format!("cannot take numbers from `{path}`: {e}"))?;
    values.sort_by(f64::total_cmp);
    Ok([("samples".to_owned(), json!({"values": values, "smooth": file["smooth"]}))].into_iter().collect())
}
