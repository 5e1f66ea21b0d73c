//! The command line of rockface, its drawings and its reports, as a library: a program of your own can add stages to it.

pub mod cli;
pub mod drawing;
pub mod report;
