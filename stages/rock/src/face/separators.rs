//! What separates the columns of a text file, told by its header or by its first line of numbers.

use super::column_marks::{number, numbers, split};

/// What separates columns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Separator {
    /// `;`
    Semicolon,
    /// A tab.
    Tab,
    /// `,`
    Comma,
    /// Blanks, as many as there are, or blanks and commas.
    Blanks,
}

/// Those that separate fields each, so fields between two of them are empty, in the order in which they are looked for.
const MARKS: [Separator; 3] = [Separator::Semicolon, Separator::Tab, Separator::Comma];

impl Separator {
    /// That of a line of names.
    pub fn of_header(line: &str) -> Self {
        let separates = |mark: &Self| {
            let names = mark.fields(line);
            // Tabs that only align names follow each other.
            let is_aligned = *mark == Self::Tab && names.iter().rev().skip(1).rev().skip(1).any(|name| name.is_empty());
            names.len() > 1 && !is_aligned
        };
        MARKS.into_iter().find(separates).unwrap_or(Self::Blanks)
    }

    /// That of lines of numbers, told by the first of them, below a header with a separator, of columns whose number may be known.
    ///
    /// # Errors
    /// Commas and blanks of which it is not certain what separates the columns.
    pub fn of_rows(line: &str, header: Option<Self>, columns: Option<usize>) -> Result<Self, String> {
        if let Some(mark) = header.filter(|mark| mark.fields(line).len() > 1) {
            // `X,Y,Z` above `1,5 2,5 3,5`.
            let by_blanks: Vec<&str> = line.split_whitespace().collect();
            let is_decimal = by_blanks.len() > 1 && by_blanks.iter().all(|word| number(word).is_ok());
            let is_other = mark == Self::Comma && is_decimal && columns == Some(by_blanks.len());
            return Ok(if is_other { Self::Blanks } else { mark });
        }
        for mark in MARKS {
            let fields = mark.fields(line);
            if fields.len() < 2 {
                continue;
            }
            if columns == Some(fields.len()) {
                return Ok(mark);
            }
            let has_inner = fields.iter().any(|field| field.contains(char::is_whitespace));
            let lacks_coordinates = columns.is_none() && fields.iter().take(3).any(|field| field.is_empty());
            if has_inner || lacks_coordinates {
                return Ok(Self::Blanks);
            }
            let known = fields.iter().filter(|field| !field.is_empty()).count();
            let is_certain = line.contains('"') || numbers(line)?.len() == known;
            return Ok(if is_certain { mark } else { Self::Blanks });
        }
        Ok(Self::Blanks)
    }

    /// The fields of a line, without blanks and quotes around them. Between two marks a field is empty.
    pub fn fields(self, line: &str) -> Vec<&str> {
        let mark = match self {
            Self::Semicolon => ';',
            Self::Tab => '\t',
            Self::Comma => ',',
            Self::Blanks => return split(line).collect(),
        };
        if !line.contains('"') {
            return line.split(mark).map(str::trim).collect();
        }
        let mut is_quoted = false;
        let is_end = |letter: char| {
            is_quoted ^= letter == '"';
            letter == mark && !is_quoted
        };
        line.split(is_end).map(unquoted).collect()
    }
}

fn unquoted(field: &str) -> &str {
    let field = field.trim();
    field.strip_prefix('"').and_then(|field| field.strip_suffix('"')).unwrap_or(field).trim()
}

/// A header without units in brackets: `X [m]`, `Easting (m)`.
pub fn without_brackets(header: &str) -> String {
    let mut depth = 0usize;
    let mut outside = |letter: &char| {
        depth += usize::from(matches!(letter, '[' | '('));
        let is_outside = depth == 0;
        depth = depth.saturating_sub(usize::from(matches!(letter, ']' | ')')));
        is_outside
    };
    header.chars().filter(|letter| outside(letter)).collect()
}

#[cfg(test)]
mod tests {
    use super::Separator::{Blanks, Comma, Semicolon, Tab};
    use super::*;

    #[test]
    fn headers_tell_their_separator() {
        for (header, expected) in [
            ("X;Y;Z, above sea", Semicolon),
            ("X\tY\tZ", Tab),
            ("Point ID,Easting,Northing", Comma),
            ("x y z", Blanks),
            ("X\t\tY\t\tZ", Blanks),
            ("\"a;b\",\"c\"", Comma),
        ] {
            assert_eq!(Separator::of_header(header), expected, "{header}");
        }
        assert_eq!(without_brackets("X [m];Y (m, UTM);Z]"), "X ;Y ;Z]");
    }

    #[test]
    fn rows_tell_theirs_where_the_header_does_not() {
        let rows = |line, header, columns| Separator::of_rows(line, header, columns);
        for (line, expected) in [
            ("1,2,3", Comma),
            ("1, 2, 3", Comma),
            ("1;2;3", Semicolon),
            ("1,5;2,5;3,5", Semicolon),
            ("1\t2\t3", Tab),
            ("1\t\t2\t\t3", Blanks),
            ("1,5 2,5 3,5", Blanks),
            ("1.5,2.5,3.5 255 0", Blanks),
            ("1 2 3", Blanks),
            ("1,2,3,,5", Comma),
            ("\"1,5\",\"2,5\",\"3,5\"", Comma),
        ] {
            assert_eq!(rows(line, None, None).unwrap(), expected, "{line}");
        }
        assert!(rows("1,5, 2,5, 3,5", None, None).is_err());
        assert_eq!(rows("1,2,3,weathered rock", None, Some(4)).unwrap(), Comma);
        assert_eq!(rows("1,5 2,5 3,5", Some(Comma), Some(3)).unwrap(), Blanks);
        assert_eq!(rows("1 2 3", Some(Comma), Some(3)).unwrap(), Blanks);
        assert_eq!(rows("1;2,5;3", Some(Semicolon), Some(3)).unwrap(), Semicolon);
    }

    #[test]
    fn fields_are_trimmed_and_empty_ones_stay() {
        assert_eq!(Comma.fields("1, ,\"a, b\",\" 2 \","), ["1", "", "a, b", "2", ""]);
        assert_eq!(Semicolon.fields(" 1,5 ; 2"), ["1,5", "2"]);
        assert_eq!(Blanks.fields("1,  2;3"), ["1", "2", "3"]);
    }
}
