//! The card of a data set: what it holds, how it was split, what to beware of.

use rockface_core::artefact::Table;

use super::split::PARTS;

/// What the card tells beyond its counts.
pub struct Facts<'a> {
    /// The title of the data set.
    pub title: &'a str,
    /// The licence, as hubs write it in the front matter.
    pub licence: &'a str,
    /// Cells along the side of a tile.
    pub side: usize,
    /// Side of a cell, metres.
    pub cell_m: f64,
    /// How it was split, in words.
    pub split: String,
    /// How empty tiles were chosen, in words.
    pub negatives: String,
    /// In which formats the tiles are there, in words.
    pub formats: String,
}

/// The card, in Markdown with the front matter that hubs read; `index` is the list of tiles.
pub fn write(facts: &Facts, index: &Table) -> Vec<u8> {
    let Facts { title, licence, side, cell_m, split, negatives, formats } = facts;
    let mut text = format!(
        "---\nlicense: {licence}\ntask_categories: [image-segmentation]\ntags: [rockfall, change-detection]\n---\n"
    );
    text.push_str(&format!("# {title}\n\nTiles of {side} x {side} cells of {cell_m} m out of simulated surveys of a rock face, with exact ground truth.\n\n"));
    text.push_str("| part | tiles | with change | without | cells | changed cells |\n|---|---|---|---|---|---|\n");
    for part in PARTS {
        let rows = || index.rows.iter().filter(|row| text_of(index, row, "split") == part);
        let sum = |name: &str| rows().map(|row| number(index, row, name)).sum::<f64>();
        let positive = rows().filter(|row| number(index, row, "changed_cells") > 0.0).count();
        let count = rows().count();
        let cells = count * side * side;
        text.push_str(&format!(
            "| {part} | {count} | {positive} | {} | {cells} | {} |\n",
            count - positive,
            sum("changed_cells")
        ));
    }
    text.push_str(&format!(
        "\nSplit: {split}. Tiles without change: {negatives}. Formats: {formats}.\n\n\
         ## Files\n\n`index.csv` has a row a tile; `tiles/PART/` the tiles; `events/` the ground truth of each event (GeoJSON); \
         `stac/catalog.json` a STAC catalogue; `SHA256SUMS` for `sha256sum --check SHA256SUMS`.\n\n\
         ## Arrays\n\n| name | type | meaning |\n|---|---|---|\n\
         | `difference` | float32, metres | after minus before along Z, out of the rock; material lost is negative; NaN: no value |\n\
         | `reference`, `comparison` | float32, metres | elevation before and after |\n\
         | `mask` | uint8 | 1 where rock was lost |\n\
         | `instances` | uint16 | number (`id`) of the loss in `events/`, 0 for none |\n\
         | `transform` | 6 float64 | cell, 0, left, 0, -cell, top in metres of the wall frame (NPZ only) |\n\n\
         Row 0 is at the top. In GeoTIFF each array is a file of its own.\n\n\
         ## Beware\n\nSurveys are simulated: noise is as good as its calibration. Masks are exact, also where a loss is far below the noise and no method \
         can see it: weigh by `removed_m3` in `events/`, or leave out small ones.\n"
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
        let mut index = Table::new(["split", "changed_cells"]);
        for (part, cells) in [("train", 5.0), ("train", 0.0), ("test", 2.0)] {
            index.push(vec![part.into(), cells.into()]);
        }
        let facts = Facts {
            title: "T",
            licence: "cc-by-4.0",
            side: 4,
            cell_m: 0.02,
            split: "by event".into(),
            negatives: "hard".into(),
            formats: "NPZ".into(),
        };
        let text = String::from_utf8(write(&facts, &index)).unwrap();
        assert!(
            text.contains("| train | 2 | 1 | 1 | 32 | 5 |") && text.contains("| test | 1 | 1 | 0 | 16 | 2 |"),
            "{text}"
        );
        assert!(text.starts_with("---\nlicense: cc-by-4.0"));
    }
}
