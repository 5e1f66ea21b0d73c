//! Point clouds as text: columns of numbers, as XYZ, TXT, CSV, ASC or PTS files have them.

use super::cloud::Cloud;
use rockface_core::artefact::CodecError;
use rockface_core::limits::Stop;

/// Reads a point a line, columns set apart by blanks, commas or semicolons.
///
/// Columns are those named by the caller; else by a header line (with or without `#` or `//` before it); else x, y and z
/// come first, and a following three columns are a colour where all their values are whole numbers from 0 to 255. Known
/// names are `x y z`, `r g b` and `red green blue` in either case; other columns are skipped, and so are lines that
/// begin with `#` or `//` and a first line that holds nothing but the number of points.
///
/// # Errors
/// The line at fault: another number of columns than before, a word that is no number, a coordinate that is not finite;
/// `cancelled` became true.
pub fn read(bytes: &[u8], columns: Option<&[String]>, cancelled: &dyn Fn() -> bool) -> Result<Cloud, CodecError> {
    let text = std::str::from_utf8(bytes).map_err(|e| CodecError(format!("byte {} is not text", e.valid_up_to())))?;
    let mut reader = Columns::default();
    if let Some(names) = columns {
        reader.name(&names.iter().map(String::as_str).collect::<Vec<_>>()).map_err(CodecError)?;
    }
    let mut stop = Stop::when(cancelled);
    for (number, line) in text.lines().enumerate() {
        stop.check()?;
        reader.line(line).map_err(|e| CodecError(format!("line {}: {e}", number + 1)))?;
    }
    Ok(reader.finish())
}

#[derive(Default)]
struct Columns {
    /// Where x, y, z are, and red, green, blue where they are named.
    places: Option<([usize; 3], Option<[usize; 3]>)>,
    /// Whether the fourth to sixth column may be a colour though no name says so.
    guessed: bool,
    count: Option<usize>,
    cloud: Cloud,
}

impl Columns {
    fn line(&mut self, line: &str) -> Result<(), String> {
        let comment = line.trim_start().strip_prefix('#').or_else(|| line.trim_start().strip_prefix("//"));
        let words: Vec<&str> = split(comment.unwrap_or(line)).collect();
        if words.is_empty() {
            return Ok(());
        }
        let is_first = self.cloud.points.is_empty();
        let is_header = is_first && words.iter().any(|word| word.parse::<f64>().is_err());
        if is_header && self.places.is_none() && self.name(&words).is_ok() {
            return Ok(());
        }
        if comment.is_some()
            || is_first && (words.len() == 1 || is_header && self.count.is_none() && self.is_named(&words))
        {
            return Ok(());
        }
        self.point(&words)
    }

    /// Whether a line is a header that repeats names the caller gave.
    fn is_named(&self, words: &[&str]) -> bool {
        self.places.is_some() && words.iter().all(|word| word.parse::<f64>().is_err())
    }

    fn name(&mut self, words: &[&str]) -> Result<(), String> {
        let place = |names: [&str; 2]| {
            let clean = |word: &str| word.trim_matches(|c: char| !c.is_alphanumeric()).to_ascii_lowercase();
            words.iter().position(|word| names.contains(&clean(word).as_str()))
        };
        let all = |a: Option<usize>, b: Option<usize>, c: Option<usize>| Some([a?, b?, c?]);
        let places = all(place(["x", "x_m"]), place(["y", "y_m"]), place(["z", "z_m"]))
            .ok_or_else(|| format!("columns x, y and z are needed, but the names are `{}`", words.join(" ")))?;
        let colours = all(place(["r", "red"]), place(["g", "green"]), place(["b", "blue"]));
        self.places = Some((places, colours));
        self.count = Some(words.len());
        Ok(())
    }

    fn point(&mut self, words: &[&str]) -> Result<(), String> {
        let count = *self.count.get_or_insert(words.len());
        if words.len() != count || count < 3 {
            let shown: String = words.join(" ").chars().take(60).collect();
            return Err(format!("`{shown}` has {} columns, but {} are needed", words.len(), count.max(3)));
        }
        if self.places.is_none() {
            self.guessed = count >= 6;
            self.places = Some(([0, 1, 2], self.guessed.then_some([3, 4, 5])));
        }
        let Some((places, colours)) = self.places else { return Ok(()) };
        let mut place = [0.0f64; 3];
        for (value, column) in place.iter_mut().zip(places) {
            *value = words[column].parse().map_err(|_| format!("`{}` is not a number", words[column]))?;
            if !value.is_finite() {
                return Err(format!("the coordinate {value} is not finite"));
            }
        }
        self.cloud.points.push(place);
        match colours.map(|columns| colour(columns.map(|column| words[column]))) {
            Some(Ok(colour)) => self.cloud.colours.push(colour),
            Some(Err(_)) if self.guessed => self.places = Some((places, None)),
            Some(Err(message)) => return Err(message),
            None => {}
        }
        Ok(())
    }

    /// The cloud; colours that were only guessed and did not go through to the end are none.
    fn finish(mut self) -> Cloud {
        if self.cloud.colours.len() != self.cloud.points.len() {
            self.cloud.colours.clear();
        }
        self.cloud
    }
}

fn split(line: &str) -> impl Iterator<Item = &str> {
    line.split(|c: char| c.is_whitespace() || c == ',' || c == ';').filter(|word| !word.is_empty())
}

fn colour(words: [&str; 3]) -> Result<[u8; 3], String> {
    let mut bytes = [0; 3];
    for (byte, word) in bytes.iter_mut().zip(words) {
        let value = word.parse::<f64>().ok().filter(|value| value.fract() == 0.0 && (0.0..=255.0).contains(value));
        *byte = value.ok_or_else(|| format!("`{word}` is not a colour from 0 to 255"))? as u8;
    }
    Ok(bytes)
}

#[cfg(test)]
#[allow(clippy::float_cmp)] // to the bit
mod tests {
    use super::*;

    fn read(bytes: &[u8], columns: Option<&[String]>) -> Result<Cloud, CodecError> {
        super::read(bytes, columns, &|| false)
    }

    fn cloud(text: &str) -> Cloud {
        read(text.as_bytes(), None).unwrap()
    }

    #[test]
    fn headers_separators_and_colours_are_understood() {
        let plain = cloud("451000.0125 5512000.0375 1.5\n\n4 5 6\n");
        assert_eq!(plain.points, [[451_000.012_5, 5_512_000.037_5, 1.5], [4.0, 5.0, 6.0]]);
        assert!(plain.colours.is_empty());
        let named = cloud("//Z;X;Intensity;Y;R;G;B\n3;1;0.5;2;10;20;30\n");
        assert_eq!((named.points[0], named.colours[0]), ([1.0, 2.0, 3.0], [10, 20, 30]));
        let quoted = cloud("\"x\",\"y\",\"z\"\n1,2,3\n");
        assert_eq!(quoted.points, [[1.0, 2.0, 3.0]]);
        let pts = cloud("2\r\n1 2 3 10 20 30 7\r\n1 2 4 10 20 255 7\r\n");
        assert_eq!((pts.points.len(), pts.colours[1]), (2, [10, 20, 255]));
        let normals = cloud("1 2 3 0 0 1\n1 2 4 0.6 0 0.8\n1 2 5 0 0 1\n");
        assert_eq!((normals.points.len(), normals.colours.len()), (3, 0));
        let names = ["y", "x", "z"].map(str::to_owned);
        assert_eq!(read(b"1 2 3\n", Some(&names)).unwrap().points, [[2.0, 1.0, 3.0]]);
    }

    #[test]
    fn faults_name_their_line() {
        let fault = |text: &str| read(text.as_bytes(), None).unwrap_err().0;
        assert!(fault("1 2 3\n1 2\n").contains("line 2: `1 2` has 2 columns, but 3 are needed"));
        assert!(fault("1 2\n").contains("line 1"));
        assert!(fault("1 2 3\n1 a 3\n").contains("line 2: `a` is not a number"));
        assert!(fault("1 2 nan\n").contains("not finite"));
        assert!(fault("x y z r g b\n1 2 3 4 5 256\n").contains("`256` is not a colour"));
        assert!(read(b"1 2 3\n", Some(&["a".to_owned()])).unwrap_err().0.contains("x, y and z are needed"));
    }
}
