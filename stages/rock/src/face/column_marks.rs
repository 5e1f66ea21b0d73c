//! The marks between the numbers of a line of text: which separate columns, and which are decimal marks.

use rockface_core::format::table_file::with_decimal_comma;

/// Letters of a line that a message shows.
const SHOWN: usize = 60;

/// The words of a line; blanks, commas and semicolons alike separate them.
pub fn split(line: &str) -> impl Iterator<Item = &str> {
    line.split(|c: char| is_blank_or_semicolon(c) || c == ',').filter(|word| !word.is_empty())
}

fn is_blank_or_semicolon(c: char) -> bool {
    c.is_whitespace() || c == ';'
}

/// The numbers of a line, each as it is written. Where semicolons or blanks separate them, commas are decimal marks.
///
/// # Errors
/// Commas and blanks of which it is not certain what separates the columns.
pub fn numbers(line: &str) -> Result<Vec<&str>, String> {
    if !line.contains(',') {
        return Ok(split(line).collect());
    }
    let words: Vec<&str> = line.split(is_blank_or_semicolon).filter(|word| !word.is_empty()).collect();
    if line.contains(';') {
        return Ok(words);
    }
    // A word such as `1.5,2` is two numbers, and `1, 2` has its comma at the end of a word.
    let has_two = |word: &&str| word.split_once(',').is_some_and(|(first, _)| first.contains('.'));
    let has_inner = words.iter().any(|word| word.trim_matches(',').contains(','));
    if words.len() == 1 || !has_inner || words.iter().any(has_two) {
        return Ok(split(line).collect());
    }
    if words.iter().all(|word| !word.contains(',') || with_decimal_comma(word).is_some()) {
        return Ok(words);
    }
    Err(format!(
        "`{}` has commas and blanks, and it is not certain which separate its columns: separate them by semicolons",
        shown(line)
    ))
}

/// The number that a word writes, with a decimal point or a decimal comma.
///
/// # Errors
/// A word that is no number.
pub fn number(word: &str) -> Result<f64, String> {
    word.parse().ok().or_else(|| with_decimal_comma(word)).ok_or_else(|| {
        let way = if word.contains(',') { "; leave out marks that group digits" } else { "" };
        format!("`{word}` is not a number{way}")
    })
}

/// The beginning of a line as it stands, for a message.
pub fn shown(line: &str) -> String {
    line.trim().chars().take(SHOWN).collect()
}

/// Watches lines of whole numbers that commas alone separate: the first six may be three numbers with decimal commas.
#[derive(Default)]
pub struct Halves {
    /// A line was seen that cannot be such.
    others: bool,
    lines: usize,
    first: String,
    /// Digits of all second halves, where they are as many.
    digits: Option<usize>,
    varying: bool,
    /// A second half begins with a zero, as no whole number does.
    zero: bool,
}

/// Lines from which on it is no chance that all second halves have as many digits.
const LEAST_LINES: usize = 3;

impl Halves {
    /// Takes notice of a line and its words.
    pub fn see(&mut self, line: &str, words: &[&str]) {
        if self.others {
            return;
        }
        let is_whole = |word: &str| word.bytes().all(|byte| byte.is_ascii_digit());
        let firsts = words.iter().copied().step_by(2).take(3).map(|word| word.strip_prefix('-').unwrap_or(word));
        let seconds: Vec<&str> = words.iter().skip(1).step_by(2).take(3).copied().collect();
        let commas_alone = !line.trim().contains(is_blank_or_semicolon);
        if words.len() < 6 || !commas_alone || !firsts.chain(seconds.iter().copied()).all(is_whole) {
            self.others = true;
            return;
        }
        if self.lines == 0 {
            self.first = shown(line);
        }
        self.lines += 1;
        for second in seconds {
            self.zero |= second.len() > 1 && second.starts_with('0');
            self.varying |= *self.digits.get_or_insert(second.len()) != second.len();
        }
    }

    /// What is not certain about all lines together, if anything is.
    pub fn doubt(&self) -> Option<String> {
        let of_one_length = self.lines >= LEAST_LINES && !self.varying && self.digits.is_some_and(|digits| digits > 1);
        (!self.others && (self.zero || of_one_length)).then(|| {
            format!(
                "`{}` may be three numbers with decimal commas, as may all lines: separate columns by semicolons or blanks then; \
                 if its numbers are whole, name its columns with `columns: [x, y, z, ...]`",
                self.first
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commas_are_decimal_marks_where_something_else_separates() {
        for line in ["451231,921 5512349,12 -730", "451231,921\t5512349,12\t-730", "451231,921;5512349,12; -730"] {
            let found: Vec<f64> = numbers(line).unwrap().into_iter().map(|word| number(word).unwrap()).collect();
            assert_eq!(found, [451_231.921, 5_512_349.12, -730.0], "{line}");
        }
        for line in ["1,2,3", "1, 2, 3", "1 ,2 ,3", "1;2;3", "1 2 3", "1,2,3 "] {
            assert_eq!(numbers(line).unwrap(), ["1", "2", "3"], "{line}");
        }
        assert_eq!(numbers("1.5,2.5,3.5 255 0").unwrap(), ["1.5", "2.5", "3.5", "255", "0"]);
    }

    #[test]
    fn what_is_not_certain_is_refused() {
        for line in ["451,231.921 5,512,349.120 730.072", "1,2,3 4", "1,5, 2,5, 3,5"] {
            let refused = numbers(line).unwrap_err();
            assert!(refused.contains(line) && refused.contains("by semicolons"), "{refused}");
        }
        assert!(number(numbers("451,231.921;5;7").unwrap()[0]).unwrap_err().contains("group digits"));
        assert_eq!(number("a").unwrap_err(), "`a` is not a number");
    }

    fn doubt(lines: &[&str]) -> bool {
        let mut halves = Halves::default();
        lines.iter().for_each(|line| halves.see(line, &split(line).collect::<Vec<_>>()));
        halves.doubt().is_some()
    }

    #[test]
    fn halves_of_decimal_numbers_are_doubted() {
        assert!(doubt(&["451231,921,5512349,120,730,072"]), "072 is no whole number");
        assert!(doubt(&["-1,25,2,50,3,75", "1,35,2,50,3,75", "1,45,2,50,3,75,9"]));
        assert!(!doubt(&["1,25,2,50,3,75", "1,35,2,50,3,75"]), "two lines are chance");
        assert!(!doubt(&["100,25,2,10,20,30", "101,25,2,100,20,30", "102,25,2,10,20,30"]));
        assert!(!doubt(&["100,25,2,10,20,30", "101.5,25,2,10,20,30", "102,25,2,10,20,30"]));
        assert!(!doubt(&["451231,921,72", "451231,922,72", "451231,923,72"]));
        assert!(!doubt(&["1 25 2 50 3 75", "1 35 2 50 3 75", "1 45 2 50 3 75"]));
        assert!(!doubt(&[]));
    }
}
