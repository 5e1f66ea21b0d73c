//! Small pictures in a terminal: two pixels a character, the upper half of a block over its background, in 24-bit colour.

use std::io::IsTerminal;

use clap::ValueEnum;
use rockface_core::artefact::Sketch;
use rockface_core::artefact::sketch::{PictureSketch, Shape};

use super::super::{CliError, output, say};

/// Columns of a picture.
const COLUMNS: usize = 80;
/// Pictures shown at most.
const PICTURES: usize = 12;

/// When pictures are shown.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum When {
    /// On a terminal.
    Auto,
    /// Always.
    Always,
    /// Never.
    Never,
}

impl When {
    /// Whether pictures are wanted here.
    pub fn is_wanted(self) -> bool {
        match self {
            Self::Always => true,
            Self::Never => false,
            Self::Auto => {
                let dumb = std::env::var_os("TERM").is_none_or(|term| term == "dumb");
                std::io::stdout().is_terminal() && !dumb && !output::is_plain()
            }
        }
    }
}

/// Shows the pictures among some sketches, and says what their colours mean.
pub fn show(sketches: &[Sketch]) -> Result<(), CliError> {
    let pictures = sketches.iter().filter_map(|sketch| match &sketch.shape {
        Shape::Picture(picture) => Some((sketch, picture)),
        _ => None,
    });
    for (sketch, picture) in pictures.take(PICTURES) {
        let failed = |error: rockface_core::artefact::CodecError| CliError::Usage(error.to_string());
        let pixels = picture.pixels().map_err(failed)?;
        say(&format!("\n{}", caption(sketch, picture)));
        lines(&pixels, picture.width as usize, COLUMNS).iter().for_each(|line| say(line));
    }
    Ok(())
}

fn caption(sketch: &Sketch, picture: &PictureSketch) -> String {
    let Some(key) = &picture.colours else { return sketch.part.clone() };
    let reduced = if sketch.reduced.is_empty() { String::new() } else { format!(", {}", sketch.reduced) };
    if key.palette == "confusion" {
        return format!(
            "{}: white neither, blue found, orange false, red missed{reduced}; grey: not compared",
            key.quantity
        );
    }
    let (low, high, unit) = (key.low, key.high, &key.unit);
    format!("{}: {} from {low:.4} to {high:.4} {unit}{reduced}; grey: no value", key.quantity, key.palette)
}

/// A picture as lines of half blocks, at most `columns` wide; every n-th pixel where it is wider.
fn lines(pixels: &[[u8; 3]], width: usize, columns: usize) -> Vec<String> {
    if width == 0 {
        return Vec::new();
    }
    let stride = width.div_ceil(columns);
    let rows: Vec<Vec<[u8; 3]>> = pixels
        .chunks_exact(width)
        .skip(stride / 2)
        .step_by(stride)
        .map(|row| row.iter().skip(stride / 2).step_by(stride).copied().collect())
        .collect();
    rows.chunks(2)
        .map(|pair| {
            let below = |i: usize| pair.get(1).map(|row| row[i]);
            let characters = pair[0].iter().enumerate().map(|(i, [r, g, b])| {
                let ground =
                    below(i).map_or_else(|| "\x1b[49m".to_owned(), |[r, g, b]| format!("\x1b[48;2;{r};{g};{b}m"));
                format!("\x1b[38;2;{r};{g};{b}m{ground}\u{2580}")
            });
            format!("{}\x1b[0m", characters.collect::<String>())
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_rows_share_a_line_and_wide_pictures_are_thinned() {
        let pixels: Vec<[u8; 3]> = (0..12).map(|i| [i, 0, 0]).collect();
        let shown = lines(&pixels, 4, 80);
        assert_eq!(shown.len(), 2);
        assert!(shown[0].starts_with("\x1b[38;2;0;0;0m\x1b[48;2;4;0;0m\u{2580}"), "{:?}", shown[0]);
        assert!(shown[1].contains("\x1b[49m") && shown[1].ends_with("\x1b[0m"));
        assert_eq!(lines(&pixels, 4, 2)[0].matches('\u{2580}').count(), 2);
        assert!(lines(&[], 0, 80).is_empty());
    }
}
