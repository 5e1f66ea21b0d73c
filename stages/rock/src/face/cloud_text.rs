//! Point clouds as text: columns of numbers, as XYZ, TXT, CSV, ASC or PTS files have them.

use super::cloud::Cloud;
use super::column_marks::{Halves, number, numbers, shown};
use super::column_names;
use super::separators::{Separator, without_brackets};
use rockface_core::artefact::CodecError;
use rockface_core::format::utf8;
use rockface_core::limits::Stop;

/// Reads a point a line, columns set apart by blanks, commas or semicolons. Commas are decimal marks where blanks or semicolons
/// separate the columns.
///
/// Where semicolons, tabs or commas separate the names of a header, or the first line of numbers, they alone do in all lines: fields may be
/// empty, and stand in quotes. A coordinate has to be there; without a colour or normal a point has none.
///
/// Columns are those named by the caller; else by a header line (with or without `#` or `//` before it); else x, y and z
/// come first, and a following three columns are a colour where all their values are whole numbers from 0 to 255. Known
/// names are `x y z`, `easting northing` or `e n` with `height`, `elevation`, `elev` or `rl`, `r g b` and `red green blue`, and `nx ny nz`, in
/// either case and with or without a unit in brackets; other columns are skipped, and so are lines that begin with `#` or `//`, a first line
/// that holds nothing but the number of points, and a header where the caller names the columns.
///
/// # Errors
/// The line at fault: a header without x, y and z, another number of columns than before, a word that is no number, a
/// coordinate that is not finite, commas that may be separators as well as decimal marks; `cancelled` became true.
pub fn read(bytes: &[u8], columns: Option<&[String]>, cancelled: &dyn Fn() -> bool) -> Result<Cloud, CodecError> {
    let text = utf8(bytes)?;
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let mut reader = Columns::default();
    if let Some(names) = columns {
        reader.name(&names.iter().map(String::as_str).collect::<Vec<_>>()).map_err(CodecError)?;
        reader.is_given = true;
    }
    let mut stop = Stop::when(cancelled);
    for (number, line) in text.lines().enumerate() {
        stop.check()?;
        reader.line(line).map_err(|e| CodecError(format!("line {}: {e}", number + 1)))?;
    }
    reader.finish().map_err(CodecError)
}

#[derive(Default)]
struct Columns {
    /// Where x, y, z are, and red, green, blue where they are named.
    places: Option<([usize; 3], Option<[usize; 3]>)>,
    /// Where the normals are, which have names.
    normals: Option<[usize; 3]>,
    /// Whether the fourth to sixth column may be a colour though no name says so.
    guessed: bool,
    /// Whether the caller or a header names the columns.
    is_named: bool,
    /// Whether the caller does.
    is_given: bool,
    count: Option<usize>,
    /// Columns of the first row without empty ones at its end, where nothing names columns.
    least: usize,
    /// What separates the names of the header.
    header: Option<Separator>,
    /// Whether the names are those of a comment that may be a sentence: of as many words as the next row has columns they are names.
    is_doubtful: bool,
    /// What separates the columns of points.
    separator: Option<Separator>,
    /// Points whose colour is empty though a name says that they have one.
    without_colour: usize,
    halves: Halves,
    cloud: Cloud,
}

impl Columns {
    fn line(&mut self, line: &str) -> Result<(), String> {
        let comment = line.trim_start().strip_prefix('#').or_else(|| line.trim_start().strip_prefix("//"));
        if (self.cloud.points.is_empty() || comment.is_some())
            && self.is_no_point(comment.unwrap_or(line), comment.is_some())?
        {
            return Ok(());
        }
        if line.trim().is_empty() {
            return Ok(());
        }
        if std::mem::take(&mut self.is_doubtful) {
            let separator = Separator::of_rows(line, self.header, self.count)?;
            let words = if separator == Separator::Blanks { numbers(line)? } else { separator.fields(line) };
            if self.count != Some(words.len()) {
                self.forget_names();
            }
        }
        let separator = match self.separator {
            Some(separator) => separator,
            None => Separator::of_rows(line, self.header, self.count)?,
        };
        self.separator = Some(separator);
        let mut words = if separator == Separator::Blanks { numbers(line)? } else { separator.fields(line) };
        if words.iter().all(|word| word.is_empty()) {
            return Ok(());
        }
        // Some programs end each line with a separator, some only a few.
        let count = self.count.unwrap_or(words.len());
        while words.len() > count && words.last().is_some_and(|word| word.is_empty()) {
            words.pop();
        }
        if self.count.is_none() {
            self.least = words.iter().rposition(|word| !word.is_empty()).map_or(0, |last| last + 1);
        }
        if !self.is_named && words.len() < count && words.len() >= self.least {
            words.resize(count, "");
        }
        // Tabs may follow each other only to align columns.
        if separator == Separator::Tab
            && self.count.is_some_and(|count| words.len() > count && line.split_whitespace().count() == count)
        {
            words = numbers(line)?;
        }
        if !self.is_named {
            self.halves.see(line, &words);
        }
        self.point(&words, line)
    }

    /// Takes the names of a header; whether a comment, or a line before the first point, is no point.
    fn is_no_point(&mut self, line: &str, is_comment: bool) -> Result<bool, String> {
        let bare = without_brackets(line);
        let separator = Separator::of_header(&bare);
        let words = separator.fields(&bare);
        let is_number = |word: &&str| number(word).is_ok();
        let is_first = self.cloud.points.is_empty();
        let may_name = is_first && (self.places.is_none() || self.is_doubtful) && !words.iter().all(is_number);
        if may_name && self.name_as(separator, &words, is_comment).is_ok() {
            return Ok(true);
        }
        // Commas may separate the coordinates of a header and blanks the rest.
        let blanks = Separator::Blanks;
        if may_name && separator != blanks && self.name_as(blanks, &blanks.fields(&bare), is_comment).is_ok() {
            self.is_doubtful = is_comment;
            return Ok(true);
        }
        if is_comment || words.iter().filter(|word| !word.is_empty()).count() < 2 {
            return Ok(true);
        }
        if words.iter().any(is_number) {
            return Ok(false);
        }
        // A header repeats the names that the caller gave, or names no x, y and z.
        if self.is_given {
            self.header = Some(separator);
            return Ok(true);
        }
        self.name_as(separator, &words, false).map(|()| true).map_err(|fault| no_coordinates(&fault))
    }

    /// Takes the names of a header that are separated so.
    fn name_as(&mut self, separator: Separator, words: &[&str], is_comment: bool) -> Result<(), String> {
        let count = words.iter().rposition(|word| !word.is_empty()).map_or(0, |last| last + 1);
        let words = &words[..count];
        let is_short = is_comment && column_names::are_short(words);
        if is_short && separator == Separator::Blanks && !column_names::are_all_known(words) {
            return Err("a sentence".to_owned());
        }
        self.name(words)?;
        self.header = Some(separator);
        self.is_doubtful = is_short;
        Ok(())
    }

    fn forget_names(&mut self) {
        (self.places, self.normals, self.count, self.header) = (None, None, None, None);
        self.is_named = false;
    }

    fn name(&mut self, words: &[&str]) -> Result<(), String> {
        let named = column_names::named(words)?;
        self.places = Some((named.places, named.colours));
        self.normals = named.normals;
        self.count = Some(words.len());
        self.is_named = true;
        Ok(())
    }

    fn point(&mut self, words: &[&str], line: &str) -> Result<(), String> {
        let count = *self.count.get_or_insert(words.len());
        if words.len() != count || count < 3 {
            let way = if words.len() > count && line.contains(',') {
                "; if its commas are decimal marks, separate columns by semicolons or blanks"
            } else {
                ""
            };
            let needed = match (self.is_given, self.is_named) {
                (true, _) => format!("`columns` names {count}"),
                (_, true) => format!("its header names {count}"),
                _ => format!("{} are needed", count.max(3)),
            };
            return Err(format!("`{}` has {} columns, but {needed}{way}", shown(line), words.len()));
        }
        if self.places.is_none() {
            self.guessed = count >= 6;
            self.places = Some(([0, 1, 2], self.guessed.then_some([3, 4, 5])));
        }
        let Some((places, colours)) = self.places else { return Ok(()) };
        let mut place = [0.0f64; 3];
        for (value, column) in place.iter_mut().zip(places) {
            if words[column].is_empty() {
                return Err(format!("a coordinate of `{}` is empty", shown(line)));
            }
            *value = number(words[column])?;
            if !value.is_finite() {
                return Err(format!("the coordinate {value} is not finite"));
            }
        }
        self.cloud.points.push(place);
        for (sum, column) in self.cloud.normals.iter_mut().zip(self.normals.into_iter().flatten()) {
            *sum += number(words[column]).ok().filter(|value| value.is_finite()).unwrap_or(0.0);
        }
        let colours = colours.map(|columns| columns.map(|column| words[column]));
        if !self.guessed && colours.is_some_and(|words| words.contains(&"")) {
            self.without_colour += 1;
            return Ok(());
        }
        match colours.map(colour) {
            Some(Ok(colour)) => self.cloud.colours.push(colour),
            Some(Err(_)) if self.guessed => self.places = Some((places, None)),
            Some(Err(message)) => return Err(message),
            None => {}
        }
        Ok(())
    }

    /// The cloud; colours that were only guessed and did not go through to the end are none.
    fn finish(mut self) -> Result<Cloud, String> {
        if let Some(doubt) = self.halves.doubt() {
            return Err(doubt);
        }
        if self.cloud.colours.len() != self.cloud.points.len() {
            if self.without_colour > 0 {
                let text = format!("{} points have no colour: colours are left out", self.without_colour);
                self.cloud.warnings.push(text);
            }
            self.cloud.colours.clear();
        }
        Ok(self.cloud)
    }
}

/// What is wrong with a header, and the way out.
fn no_coordinates(fault: &str) -> String {
    format!("{fault}; name all columns of the file with `columns: [x, y, z, ...]`")
}

fn colour(words: [&str; 3]) -> Result<[u8; 3], String> {
    let mut bytes = [0; 3];
    for (byte, word) in bytes.iter_mut().zip(words) {
        let value = number(word).ok().filter(|value| value.fract() == 0.0 && (0.0..=255.0).contains(value));
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
        let turned = cloud("//X Y Z Nx Ny Nz\n1 2 3 0 0.6 0.8\n1 2 4 0 -0.6 0.8\n1 2 5 nan nan nan\n");
        assert_eq!((turned.normals, turned.colours.len()), ([0.0, 0.0, 1.6], 0));
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
    fn decimal_commas_are_read_where_columns_are_certain() {
        let expected = [[451_231.921, 5_512_349.12, 730.072], [451_231.964, 5_512_349.095, 730.0]];
        let blanks = "451231,921 5512349,120 730,072\n451231,964 5512349,095 730\n";
        assert_eq!(cloud(blanks).points, expected);
        assert_eq!(cloud(&blanks.replace(' ', ";")).points, expected);
        assert_eq!(cloud(&format!("X;Y;Z\n{}", blanks.replace(' ', ";"))).points, expected);
        assert_eq!(cloud(&format!("Easting\tNorthing\tHeight\n{}", blanks.replace(' ', "\t"))).points, expected);
        let coloured = cloud("1,5;2,5;3,5;10;20;30\n");
        assert_eq!((coloured.points[0], coloured.colours[0]), ([1.5, 2.5, 3.5], [10, 20, 30]));
        let fault = |text: &str| read(text.as_bytes(), None).unwrap_err().0;
        let commas = blanks.replace(' ', ",").replace("730\n", "730,000\n");
        assert!(fault(&commas).contains("`451231,921,5512349,120,730,072` may be three numbers"));
        let named = fault(&format!("x,y,z\n{commas}"));
        assert!(
            named.contains("line 2: `451231,921,5512349,120,730,072` has 6 columns") && named.contains("by semicolons")
        );
        let whole: Vec<String> = ["x", "y", "z", "a", "b", "c"].map(str::to_owned).to_vec();
        assert_eq!(read(commas.as_bytes(), Some(&whole)).unwrap().points[0], [451_231.0, 921.0, 5_512_349.0]);
    }

    #[test]
    fn a_header_without_coordinates_is_named_and_overruled() {
        let message = read(b"Rechts;Hoch;Hoehe\n1;2;3\n", None).unwrap_err().0;
        assert!(message.contains("line 1") && message.contains("names are `Rechts Hoch Hoehe`"), "{message}");
        assert!(message.contains("`columns: [x, y, z, ...]`"), "{message}");
        let names = ["x", "y", "z"].map(str::to_owned);
        assert_eq!(read(b"Rechts;Hoch;Hoehe\n1;2;3\n", Some(&names)).unwrap().points, [[1.0, 2.0, 3.0]]);
        // A height above ground beside z is none of the coordinates.
        assert_eq!(cloud("x,y,height,z\n1,2,9,3\n").points, [[1.0, 2.0, 3.0]]);
    }

    #[test]
    fn fields_may_be_empty_quoted_and_called_otherwise() {
        let expected = [[451_252.07, 5_512_343.531, 591.5], [451_257.0, 5_512_347.0, 585.0]];
        for text in [
            "\u{feff}Point ID,Easting,Northing,RL,Code\r\nP1,451252.070,5512343.531,591.5,ROCK\r\nP2,451257,5512347,585,\r\n",
            "PointID,E,N,Elev,Code,Note\n0,451252.070,5512343.531,591.5,,x\n1,451257,5512347,585,weathered rock,\n",
            "\"X\",\"Y\",\"Z\",\"I\"\n\"451252.070\",\"5512343.531\",\"591.5\",\"12\"\n\"451257\",\"5512347\",\"585\",\"\"\n",
            "X [m];Y [m];Z [m]\n451252,070;5512343,531;591,5\n451257;5512347;585\n;;\n",
            "Easting (m) Northing (m) Elevation (m)\n451252.070 5512343.531 591.5\n451257 5512347 585\n",
            "X, Y, Z,\n451252.070, 5512343.531, 591.5,\n451257, 5512347, 585\n,,\n\n",
            ",x,y,z\n0,451252.070,5512343.531,591.5\n1,451257,5512347,585\n",
            "//X,Y,Z\n2\n451252.070 5512343.531 591.5\n451257 5512347 585\n",
            "X,Y,Z R G B\n451252.070,5512343.531,591.5 1 2 3\n451257.0,5512347.0,585.0 1 2 3\n",
            "X,Y,Z\n451252,070 5512343,531 591,5\n451257,0 5512347 585\n",
        ] {
            assert_eq!(cloud(text).points, expected, "{text}");
        }
        let given = ["id", "x", "y", "z", "code"].map(str::to_owned);
        let text = "Nr,East,North,Up,Code\nP1,451252.070,5512343.531,591.5,weathered rock\nP2,451257,5512347,585,\n";
        assert_eq!(read(text.as_bytes(), Some(&given)).unwrap().points, expected);
        let coloured = cloud("x,y,z,r,g,b\n1,2,3,4,5,6\n1,2,4,,,\n");
        assert!(coloured.colours.is_empty() && coloured.points.len() == 2);
        assert_eq!(coloured.warnings, ["1 points have no colour: colours are left out"]);
    }

    #[test]
    fn comments_name_columns_where_they_fit_the_rows() {
        let turned = |text: &str| cloud(text).points[0];
        let [rgb, intensity] = ["2 1 3 10 20 30\n", "1 2 3 90 10 20 30\n"];
        for text in [
            format!("# Y, X, Z R G B\n{rgb}"),
            format!("# X, Y, Z intensity R G B\n{intensity}"),
            "// id,x,y,z nx ny nz\n0 1 2 3 0 0 1\n".to_owned(),
            "# N E RL\n2 1 3\n".to_owned(),
            "# N E RL R G B\n2 1 3 9 9 9\n".to_owned(),
            "# N, E, RL, code\n2,1,3,7\n".to_owned(),
            format!("# seen from X, Y, Z of the lift\n# Y, X, Z R G B\n{rgb}"),
            format!("# seen from X, Y, Z of the lift\nY X Z R G B\n{rgb}"),
            // Sentences.
            "# seen from X, Y, Z of the lift\n1 2 3\n".to_owned(),
            "# surveyed by N E RL\n1 2 3\n".to_owned(),
            "# surveyed by N E RL\n1 2 3 4 5\n".to_owned(),
            "# N, E, RL and others\n1 2 3\n".to_owned(),
        ] {
            assert_eq!(turned(&text), [1.0, 2.0, 3.0], "{text}");
        }
        let coloured = cloud(&format!("# Y, X, Z R G B\n{rgb}"));
        assert_eq!(coloured.colours, [[10, 20, 30]]);
    }

    #[test]
    fn tabs_may_align_columns() {
        for text in [
            "X\tY\tZ\n1\t\t2\t\t3\n4\t\t5\t\t6\n",
            "X\tY\tZ\n1\t2\t3\n4\t\t5\t6\n",
            "X\tY\tZ\n1\t\t2\t3\n4\t5\t6\t\n",
            "1\t2\t3\t\n4\t5\t6\n",
            "1,2,3,\n4,5,6\n",
            "1,2,3,\n4,5,6,rock\n",
            "1\t2\t3\n4\t5\t\t6\n",
            "1\t2\t\t3\n4\t5\t6\n",
            "X\tY\tZ\n1,0\t\t2,0\t3\n4\t5\t6\n",
        ] {
            assert_eq!(cloud(text).points, [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]], "{text:?}");
        }
        // An empty field stays one where a header gives it a name.
        let coded = cloud("X\tY\tCode\tZ\n1\t2\t\t3\n4\t5\tweathered rock\t6\n");
        assert_eq!(coded.points, [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]);
    }

    #[test]
    fn more_values_than_names_and_empty_coordinates_are_faults() {
        let fault = |text: &str| read(text.as_bytes(), None).unwrap_err().0;
        let shifted = fault("Point ID,Easting,Northing,Elevation\n0,451252.070,5512343.531,591.513,12\n");
        assert!(
            shifted.starts_with("line 2: ") && shifted.contains("has 5 columns, but its header names 4"),
            "{shifted}"
        );
        assert!(fault("x,y,z\n1,2,3\n1,,3\n").contains("line 3: a coordinate of `1,,3` is empty"));
        let given = ["x", "y", "z"].map(str::to_owned);
        assert!(read(b"1,2,3,4\n", Some(&given)).unwrap_err().0.contains("`columns` names 3"));
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
