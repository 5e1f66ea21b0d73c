//! The rows of the table, in Markdown, so that they can stand in the book as they were printed.

use crate::measure::Cost;
use crate::peer::Answer;

/// One work of the program, and how it compares.
pub struct Row<'a> {
    /// What was done, with its size.
    pub what: &'a str,
    /// What it cost.
    pub cost: Cost,
    /// What was done by another program with the same input; `None` where there is none.
    pub peer: Option<&'a Answer>,
    /// How far apart both results are, or what else was checked.
    pub check: &'a str,
}

/// Prints the head of the table.
pub fn print_head() {
    println!("| what | wall s | CPU s | MB | peer: wall s, CPU s | CPU, peer / ours | check |");
    println!("|---|---|---|---|---|---|---|");
}

impl Row<'_> {
    /// Prints the row.
    pub fn print(&self) {
        let Cost { wall_s, cpu_s, memory_mb } = self.cost;
        let (peer, ratio) = match self.peer {
            None => (String::new(), String::new()),
            Some(Answer::Missing(package)) => (format!("{package} not installed"), String::new()),
            Some(Answer::Failed) => ("failed".to_owned(), String::new()),
            Some(Answer::Done(done)) => {
                let further: String = done.further.iter().map(|(name, value)| format!("; {name} {value}")).collect();
                let cell = format!("{}: {}, {}{further}", done.who, digits(done.wall_s), digits(done.cpu_s));
                (cell, digits(done.cpu_s / cpu_s))
            }
        };
        let what = self.what;
        let (wall, cpu) = (digits(wall_s), digits(cpu_s));
        println!("| {what} | {wall} | {cpu} | {memory_mb:.0} | {peer} | {ratio} | {} |", self.check);
    }
}

/// Three significant digits, or all before the point.
pub fn digits(value: f64) -> String {
    match value.abs() {
        size if size < 0.1 => format!("{value:.3}"),
        size if size < 10.0 => format!("{value:.2}"),
        size if size < 100.0 => format!("{value:.1}"),
        _ => format!("{value:.0}"),
    }
}
