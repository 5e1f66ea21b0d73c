//! The names of the columns of a point cloud.

/// Names of x, y and z.
const COORDINATES: [&[&str]; 3] =
    [&["x", "x_m", "easting", "e"], &["y", "y_m", "northing", "n"], &["z", "z_m", "height", "elevation", "elev", "rl"]];
const COLOURS: [&[&str]; 3] = [&["r", "red"], &["g", "green"], &["b", "blue"]];
const NORMALS: [&[&str]; 3] = [&["nx"], &["ny"], &["nz"]];
/// Names that may as well be somebody's initials.
const SHORT: [&str; 3] = ["e", "n", "rl"];

/// Columns of what is read, counted from 0.
pub struct Named {
    /// Of x, y and z.
    pub places: [usize; 3],
    /// Of red, green and blue.
    pub colours: Option<[usize; 3]>,
    /// Of the normal.
    pub normals: Option<[usize; 3]>,
}

/// The columns with these names.
///
/// # Errors
/// None is called x, y or z.
pub fn named(words: &[&str]) -> Result<Named, String> {
    let names: Vec<String> = words.iter().map(|word| clean(word)).collect();
    // Of several names for one the first of the list is taken.
    let place = |known: &[&str]| known.iter().find_map(|known| names.iter().position(|name| name == known));
    let all = |[a, b, c]: [&[&str]; 3]| Some([place(a)?, place(b)?, place(c)?]);
    let places = all(COORDINATES)
        .ok_or_else(|| format!("columns x, y and z are needed, but the names are `{}`", words.join(" ")))?;
    Ok(Named { places, colours: all(COLOURS), normals: all(NORMALS) })
}

/// Whether a coordinate has no other name among these than a short one such as `e`.
pub fn are_short(words: &[&str]) -> bool {
    let spelt =
        |known: &[&str]| words.iter().map(|word| clean(word)).any(|name| is_in(&name, known) && !is_in(&name, &SHORT));
    !COORDINATES.into_iter().all(spelt)
}

/// Whether all are names of coordinates, colours or normals.
pub fn are_all_known(words: &[&str]) -> bool {
    let is_known = |name: &str| [COORDINATES, COLOURS, NORMALS].as_flattened().iter().any(|known| is_in(name, known));
    words.iter().all(|word| is_known(&clean(word)))
}

fn is_in(name: &str, known: &[&str]) -> bool {
    known.contains(&name)
}

/// A name in small letters, without marks around it.
fn clean(word: &str) -> String {
    word.trim_matches(|c: char| !c.is_alphanumeric()).to_ascii_lowercase()
}
