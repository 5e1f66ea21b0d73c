//! What is cited of the paper stands in it: sections, algorithms with their lines, equations, tables and figures.

use std::path::{Path, PathBuf};

use crate::tidy::sources;

/// The sections of the paper.
const SECTIONS: [&str; 20] = [
    "1", "2", "2.1", "2.1.1", "2.1.2", "2.2", "2.2.1", "2.2.2", "2.2.3", "2.2.4", "2.2.5", "2.3", "2.4", "2.4.1",
    "2.4.2", "3", "3.1", "3.2", "4", "5",
];
/// Its numbered equations, figures and tables, and the lines of its two algorithms.
const EQUATIONS: u32 = 16;
const FIGURES: u32 = 18;
const TABLES: [&str; 2] = ["1", "A1"];
const LINES: [u32; 2] = [41, 39];

/// What a word says the numbers after it are.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Sort {
    Section,
    Equation,
    Figure,
    Table,
    Algorithm,
    Line,
}

fn sort(word: &str) -> Option<Sort> {
    Some(match word.to_lowercase().trim_matches(|c: char| !c.is_alphanumeric()) {
        "paper" | "paper's" | "section" | "sections" => Sort::Section,
        "equation" | "equations" | "eq" | "eqs" => Sort::Equation,
        "figure" | "figures" | "fig" | "figs" => Sort::Figure,
        "table" | "tables" => Sort::Table,
        "algorithm" => Sort::Algorithm,
        "line" | "lines" => Sort::Line,
        _ => return None,
    })
}

/// The faults of one text that follows the word `paper`: each cited thing that the paper does not have.
fn faults(text: &str) -> Vec<String> {
    let (mut faults, mut now, mut algorithm) = (Vec::new(), Some(Sort::Section), None);
    // Without the word, only what looks like a section is one: `paper 2.4.1`, and not `the paper's 39 comparisons`.
    let mut is_said = false;
    for word in text.split_whitespace() {
        if let Some(sort) = sort(word) {
            (now, is_said) = (Some(sort), true);
            continue;
        }
        let plain = word.trim_matches(|c: char| !c.is_alphanumeric());
        let is_number = plain.trim_start_matches('A').chars().all(|c| c.is_ascii_digit() || c == '.')
            && plain.chars().any(|c| c.is_ascii_digit());
        if !is_number {
            // Between the numbers of a list.
            now = now.filter(|_| ["and", "to", "its", "in", ""].contains(&plain));
            continue;
        }
        let Some(sort) = now.filter(|_| is_said || plain.contains('.')) else { continue };
        let number = plain.parse::<u32>().ok();
        let within = |last: u32| number.is_some_and(|number| (1..=last).contains(&number));
        let stands = match sort {
            Sort::Section => SECTIONS.contains(&plain),
            Sort::Equation => within(EQUATIONS),
            Sort::Figure => within(FIGURES),
            Sort::Table => TABLES.contains(&plain),
            Sort::Algorithm => {
                algorithm = number.filter(|number| (1..=2).contains(number));
                algorithm.is_some()
            }
            Sort::Line => within(LINES[algorithm.unwrap_or(1) as usize - 1]),
        };
        if !stands {
            faults.push(format!("{sort:?} {plain}"));
        }
    }
    faults
}

/// The parts of a text that cite the paper: from each word `paper` to the end of its parenthesis or sentence. Lines of comments are put
/// together first.
fn citations(text: &str) -> Vec<String> {
    let plain = |line: &str| line.trim().trim_start_matches(['/', '!', '#', '*']).trim().to_owned();
    let whole = text.lines().map(plain).collect::<Vec<_>>().join(" ");
    let mut found = Vec::new();
    for (at, _) in whole.match_indices("aper") {
        let before = whole[..at].chars().next_back();
        if !matches!(before, Some('p' | 'P')) {
            continue;
        }
        let rest = &whole[at + "aper".len()..];
        let rest = rest.strip_prefix("'s").unwrap_or(rest);
        if rest.starts_with(|c: char| c.is_alphanumeric() || c == '-' || c == '_' || c == '/') {
            continue;
        }
        let end = [rest.find(')'), rest.find(';'), rest.find(": "), sentence(rest)].into_iter().flatten().min();
        found.push(rest[..end.unwrap_or(rest.len())].to_owned());
    }
    found
}

/// Where a sentence ends: at a point before a blank, unless it is that of an abbreviation.
fn sentence(text: &str) -> Option<usize> {
    let mut points = text.match_indices(". ").map(|(at, _)| at);
    points.find(|at| !["Eq", "Eqs", "Fig", "Figs"].iter().any(|short| text[..*at].ends_with(short)))
}

/// Texts that cite the paper: sources, pages of stages, pipelines, documentation.
fn texts() -> Vec<(PathBuf, String)> {
    let mut texts = sources("stages");
    texts.extend(sources("src"));
    let mut folders: Vec<PathBuf> =
        ["stages", "pipelines", "docs"].map(|name| Path::new(env!("CARGO_MANIFEST_DIR")).join(name)).to_vec();
    while let Some(folder) = folders.pop() {
        for path in std::fs::read_dir(&folder).unwrap().flatten().map(|entry| entry.path()) {
            if path.is_dir() && !path.ends_with("target") {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "md" || extension == "yaml") {
                texts.push((path.clone(), std::fs::read_to_string(&path).unwrap()));
            }
        }
    }
    let readme = Path::new(env!("CARGO_MANIFEST_DIR")).join("README.md");
    texts.push((readme.clone(), std::fs::read_to_string(&readme).unwrap()));
    texts
}

#[test]
fn what_is_cited_of_the_paper_stands_in_it() {
    let mut wrong = Vec::new();
    for (path, text) in texts() {
        let cited = citations(&text);
        wrong.extend(cited.iter().flat_map(|text| faults(text)).map(|fault| format!("{}: {fault}", path.display())));
    }
    assert!(wrong.is_empty(), "not in the paper:\n{}", wrong.join("\n"));
}

#[test]
fn wrong_citations_are_found_and_right_ones_are_not() {
    let of = |text: &str| citations(text).iter().flat_map(|text| faults(text)).collect::<Vec<_>>();
    for text in [
        "(paper, section 3.2)",
        "(paper 2.1.2, Algorithm 2 lines 10 to 19, Eq. 2 and 3)",
        "Paper 2.2.5 (equations 15 and 16): standardised. Lague, equation 99",
        "the paper's Figures 15, 16 and 17 for any",
        "Paper, section 2.1.1, Algorithm 1, lines 5 to 41.",
        "as in Table A1 of the paper, 44 of 50",
        "the paper's 39 comparisons",
    ] {
        assert_eq!(of(text), Vec::<String>::new(), "{text}");
    }
    assert_eq!(of("(paper, section 4.3)"), ["Section 4.3"]);
    assert_eq!(of("(Paper 2.1.2 and 2.5; Kraus)"), ["Section 2.5"]);
    assert_eq!(of("/// (paper, sections 2.2\n/// and 2.6)"), ["Section 2.6"]);
    assert_eq!(of("Paper 2.2.5, equations 15 to 18: x"), ["Equation 18"]);
    assert_eq!(of("paper, Algorithm 2, line 40"), ["Line 40"]);
    assert_eq!(of("the paper's Figure 19"), ["Figure 19"]);
    assert_eq!(of("paper, Table 2"), ["Table 2"]);
}
