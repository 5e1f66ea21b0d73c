//! The card of a data set: what it holds, how it was split, what to beware of.

use rockface_core::artefact::Table;

use super::split::PARTS;

/// What the card tells beyond its counts.
pub struct Facts<'a> {
    /// The title of the data set.
    pub title: &'a str,
    /// Text before the names of files.
    pub prefix: &'a str,
    /// The licence, as hubs write it in the front matter.
    pub licence: &'a str,
    /// Cells along the side of a tile.
    pub side: usize,
    /// Side of a cell, metres, or of several sizes, in words.
    pub cells_m: String,
    /// The frame or system that X and Y are in, in words.
    pub frame: String,
    /// Whether that is the wall frame.
    pub is_wall: bool,
    /// Cells of each part, those of overlapping tiles counted once.
    pub distinct: [usize; 3],
    /// How tiles overlap, a sentence; none: they do not.
    pub overlap: Option<&'a str>,
    /// How it was split, in words.
    pub split: String,
    /// How empty tiles were chosen, in words.
    pub negatives: String,
    /// In which formats the tiles are there, in words.
    pub formats: String,
}

/// The card, in Markdown with the front matter that hubs read; `index` is the list of tiles.
pub fn write(facts: &Facts, index: &Table) -> Vec<u8> {
    let Facts { title, prefix, licence, side, cells_m, frame, is_wall, distinct, overlap, split, negatives, formats } =
        facts;
    let mut text = format!(
        "---\nlicense: {licence}\ntask_categories: [image-segmentation]\ntags: [rockfall, change-detection]\n---\n"
    );
    text.push_str(&format!("# {title}\n\nTiles of {side} x {side} cells of {cells_m} m out of simulated surveys of a rock face, with exact ground truth.\n\n"));
    text.push_str(
        "| part | tiles | with change | without | cells | distinct cells | changed cells | of them with a value |\n|---|---|---|---|---|---|---|---|\n",
    );
    for (part, distinct) in PARTS.into_iter().zip(distinct) {
        let rows = || index.rows.iter().filter(|row| text_of(index, row, "split") == part);
        let sum = |name: &str| rows().map(|row| number(index, row, name)).fold(0.0, |sum, cells| sum + cells);
        let positive = rows().filter(|row| number(index, row, "changed_valid_cells") > 0.0).count();
        let count = rows().count();
        let cells = count * side * side;
        text.push_str(&format!(
            "| {part} | {count} | {positive} | {} | {cells} | {distinct} | {} | {} |\n",
            count - positive,
            sum("changed_cells"),
            sum("changed_valid_cells")
        ));
    }
    let overlap = overlap.map(|text| format!(" {text}")).unwrap_or_default();
    let along = if *is_wall { "along Z, out of the rock" } else { "along Z" };
    text.push_str(&format!(
        "\nSplit: {split}. Tiles without change: {negatives}. Formats: {formats}.{overlap}\n\n\
         ## Files\n\n`{prefix}index.csv` has a row a tile; `tiles/PART/` the tiles; `events/` the ground truth (GeoJSON); the column `truth` \
         of the index names the file of each tile, as an event has several where its surveys saw different changes, or none; \
         `stac/{prefix}catalog.json` a STAC catalogue; `{prefix}SHA256SUMS` for `sha256sum --check {prefix}SHA256SUMS`.\n\n\
         ## Arrays\n\n| name | type | meaning |\n|---|---|---|\n\
         | `difference` | float32, metres | after minus before {along}; material lost is negative; NaN: no value |\n\
         | `reference`, `comparison` | float32, metres | elevation before and after |\n\
         | `mask` | uint8 | 1 where rock was lost, also where `difference` has no value |\n\
         | `instances` | uint16 | number (`id`) of the loss in the file `truth` of the index, 0 for none |\n\
         | `transform` | 6 float64 | cell, 0, left, 0, -cell, top in metres of {frame} (NPZ only) |\n\n\
         Row 0 is at the top. In GeoTIFF each array is a file of its own.\n\n\
         ## Beware\n\nSurveys are simulated: noise is as good as its calibration. Masks hold the outlines of the truth, which are as fine as the cell \
         they were drawn with (`cell_m` of `remove-blocks`), also where a loss is far below the noise and no method \
         can see it: weigh by `removed_m3` in `events/`, or leave out small ones. Leave cells without a value in `difference` out of the loss: nothing \
         was measured there, and some are marked as changed. A tile is with change where a changed cell has a value.\n"
    ));
    text.into_bytes()
}

fn number(table: &Table, row: &[rockface_core::artefact::Cell], name: &str) -> f64 {
    table.column(name).and_then(|at| row[at].number()).unwrap_or(0.0)
}

fn text_of<'a>(table: &Table, row: &'a [rockface_core::artefact::Cell], name: &str) -> &'a str {
    table.column(name).and_then(|at| row[at].text()).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_card_counts_by_part() {
        let mut index = Table::new(["split", "changed_cells", "changed_valid_cells"]);
        for (part, cells) in [("train", 5.0), ("train", 0.0), ("test", 2.0)] {
            index.push(vec![part.into(), cells.into(), (cells / 2.0).into()]);
        }
        let facts = Facts {
            title: "T",
            prefix: "s1_",
            licence: "cc-by-4.0",
            side: 4,
            cells_m: "0.02 and 0.04".into(),
            frame: "the wall frame".into(),
            is_wall: true,
            distinct: [28, 0, 16],
            overlap: Some("Tiles overlap."),
            split: "by event".into(),
            negatives: "hard".into(),
            formats: "NPZ".into(),
        };
        let text = String::from_utf8(write(&facts, &index)).unwrap();
        assert!(
            text.contains("| train | 2 | 1 | 1 | 32 | 28 | 5 | 2.5 |")
                && text.contains("| test | 1 | 1 | 0 | 16 | 16 | 2 | 1 |"),
            "{text}"
        );
        assert!(text.contains("cells of 0.02 and 0.04 m") && text.contains("Tiles overlap."), "{text}");
        assert!(text.contains("| validation | 0 | 0 | 0 | 0 | 0 | 0 | 0 |"), "{text}");
        assert!(text.contains("`s1_index.csv`") && text.contains("`stac/s1_catalog.json`"), "{text}");
        assert!(text.starts_with("---\nlicense: cc-by-4.0"));
    }
}
