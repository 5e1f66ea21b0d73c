//! How much the log of a run shows of a step: `log: full|brief|none`.

/// How much the log shows of a step instance. It decides no output and is no part of a recipe.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum LogLevel {
    /// That it was there, what it made and how.
    None,
    /// With that, what it said and measured.
    Brief,
    /// With that, sketches of its outputs: pictures, points, triangles, grids, tables.
    Full,
}

/// Instances of a step that are logged in full where nobody says otherwise: the first one and the last ones.
pub const IN_FULL: usize = 4;

impl LogLevel {
    /// The words of the pipeline.
    pub const WORDS: [&str; 3] = ["full", "brief", "none"];

    /// The level of a word.
    pub fn of_word(word: &str) -> Option<Self> {
        match word {
            "full" => Some(Self::Full),
            "brief" => Some(Self::Brief),
            "none" => Some(Self::None),
            _ => None,
        }
    }

    /// The level of an instance that has `before` others of its step before it, of `count` together, where the pipeline says nothing: of the
    /// items of an axis that grows the newest count.
    pub fn by_place(before: usize, count: usize) -> Self {
        if before == 0 || before + IN_FULL > count { Self::Full } else { Self::Brief }
    }
}
