//! Named files in another program's own format, made to be handed to that program.

/// Files by name, in the order they were made; kept as one archive, laid out beside it in a run's folder.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Files {
    /// Names, with `/` between folders, and contents.
    pub files: Vec<(String, Vec<u8>)>,
}
