//! A drawing as SVG: boxes in rows, frames around the uses of parts, arrows from top to bottom, colours for light and for dark
//! pages.

use std::collections::BTreeMap;

use petgraph::graph::{DiGraph, NodeIndex};

use super::sheet::{Cell, HEAD_PX, RIM_PX, SIDE_PX, Sheet, Sizes};
use super::{Arrow, Drawn, Note, Tint};
use rockface_engine::pipeline::INSIDE;

/// Room around everything, px.
const MARGIN_PX: f64 = 18.0;
/// Height of the line with a step's name, px.
const NAME_PX: f64 = 17.0;
/// Height of every further line, px.
const LINE_PX: f64 = 15.0;
/// Room in a box above and below its lines, px.
const PADDING_PX: f64 = 8.0;
/// Width of the widest letters in parts of the size of a font that is not known here.
const LETTER: f64 = 0.62;
/// How far the second sheet of a sweep shows, px.
const SHEET_PX: f64 = 4.0;
/// Length and width of the tip of an arrow, px.
const TIP_PX: f64 = 8.0;

/// Colours and line styles; every class is below `rockface-graph`, so that pages it is put into stay as they are.
const STYLE: &str = r#"
.rockface-graph{font-family:system-ui,"Segoe UI",Roboto,"DejaVu Sans",sans-serif}
.rockface-graph .paper{fill:#ffffff}
.rockface-graph .frame{fill:#8c959f14;stroke:#8c959f;stroke-width:1}
.rockface-graph .box{fill:#f3f5f7;stroke:#57606a;stroke-width:1.2}
.rockface-graph .ran .box{fill:#fff3d1;stroke:#9a6700}
.rockface-graph .cached .box{fill:#dcf7e3;stroke:#1a7f37}
.rockface-graph .failed .box{fill:#ffe5e2;stroke:#cf222e}
.rockface-graph .target .box{stroke-width:2.6}
.rockface-graph .loose .box{stroke-dasharray:6 4}
.rockface-graph .idle{opacity:.45}
.rockface-graph .name{fill:#1f2328;font-size:13px;font-weight:600}
.rockface-graph .more{fill:#57606a;font-size:11px}
.rockface-graph .arrow{fill:none;stroke:#8c959f;stroke-width:1.3}
.rockface-graph .gathers{stroke-width:3}
.rockface-graph .back{stroke-dasharray:5 3}
.rockface-graph .lists{stroke-dasharray:1.5 2.5}
.rockface-graph .tip{fill:#8c959f}
@media (prefers-color-scheme:dark){
.rockface-graph .paper{fill:#14181d}
.rockface-graph .box{fill:#222831;stroke:#8b949e}
.rockface-graph .ran .box{fill:#3a2f10;stroke:#d29922}
.rockface-graph .cached .box{fill:#12321c;stroke:#3fb950}
.rockface-graph .failed .box{fill:#42161a;stroke:#f85149}
.rockface-graph .name{fill:#e6edf3}
.rockface-graph .more{fill:#9da7b3}
.rockface-graph .arrow{stroke:#6e7681}
.rockface-graph .tip{fill:#6e7681}
}
"#;

/// The picture; `uses` are the parts that are used, by the names of their uses.
pub fn svg(drawing: &DiGraph<Drawn, Arrow>, uses: &[(String, String)], notes: &BTreeMap<String, Note>) -> String {
    let picture = Picture { drawing, notes, uses };
    let step = |drawn: &Drawn| box_px(drawn, notes.get(&drawn.name), uses);
    let head = |used: &str| picture.head(used).chars().count() as f64 * LETTER * 11.0 + 2.0 * RIM_PX;
    let sheet = Sheet::of(drawing, &Sizes { step: &step, head: &head });
    let width = sheet.size_px.0.max(320.0) + 2.0 * MARGIN_PX;
    let legend = legend(drawing, width - 2.0 * MARGIN_PX);
    let height = sheet.size_px.1 + 2.0 * MARGIN_PX + legend.len() as f64 * LINE_PX + PADDING_PX;
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" class=\"rockface-graph\" role=\"img\" width=\"{width:.0}\" \
         height=\"{height:.0}\" viewBox=\"0 0 {width:.0} {height:.0}\">\n<title>steps of the pipeline</title>\n\
         <style>{STYLE}</style>\n\
         <rect class=\"paper\" width=\"{width:.0}\" height=\"{height:.0}\"/>\n"
    );
    out += &picture.sheet(&sheet, (MARGIN_PX, MARGIN_PX));
    for (number, text) in legend.iter().enumerate() {
        let y = height - PADDING_PX - (legend.len() - 1 - number) as f64 * LINE_PX;
        out += &format!("<text class=\"more\" x=\"{MARGIN_PX:.0}\" y=\"{y:.0}\">{}</text>\n", escaped(text));
    }
    out + "</svg>\n"
}

/// What is drawn, besides where it stands.
struct Picture<'a> {
    drawing: &'a DiGraph<Drawn, Arrow>,
    notes: &'a BTreeMap<String, Note>,
    uses: &'a [(String, String)],
}

impl Picture<'_> {
    /// What is written above the frame of a use.
    fn head(&self, used: &str) -> String {
        let part = self.uses.iter().find(|(name, _)| name == used).map_or("", |(_, part)| part.as_str());
        format!("{} ({part})", short(used))
    }

    /// A sheet with its upper left corner at a place: frames, then arrows, then boxes.
    fn sheet(&self, sheet: &Sheet, (x, y): (f64, f64)) -> String {
        let mut out = String::new();
        for (node, cell) in sheet.cells.iter().enumerate() {
            let Cell::Frame(name, inner) = cell else { continue };
            let (left, top, width, height) = sheet.box_px(node);
            let (left, top) = (x + left, y + top);
            let title = escaped(&self.head(name));
            out += &format!(
                "<g><title>{}</title><rect class=\"frame\" x=\"{left:.1}\" y=\"{top:.1}\" width=\"{width:.1}\" \
                 height=\"{height:.1}\" rx=\"7\"/>\n<text class=\"more\" x=\"{:.1}\" y=\"{:.1}\">{title}</text></g>\n",
                escaped(name),
                left + 8.0,
                top + 15.0
            );
            out += &self.sheet(inner, (left + RIM_PX, top + HEAD_PX));
        }
        (0..sheet.links.len()).for_each(|number| out += &arrow(sheet, number, (x, y)));
        for (node, cell) in sheet.cells.iter().enumerate() {
            if let Cell::Step(step) = cell {
                let (left, top, width, height) = sheet.box_px(node);
                let drawn = &self.drawing[NodeIndex::new(*step)];
                out += &self.step(drawn, (x + left, y + top, width, height));
            }
        }
        out
    }

    fn step(&self, drawn: &Drawn, (left, top, width, height): (f64, f64, f64, f64)) -> String {
        let note = self.notes.get(&drawn.name);
        let rect = |shift: f64| {
            format!(
                "<rect class=\"box\" x=\"{:.1}\" y=\"{:.1}\" width=\"{width:.1}\" height=\"{height:.1}\" rx=\"5\"/>\n",
                left + shift,
                top + shift
            )
        };
        let mut out = format!("<g class=\"{}\">\n", class(drawn, note));
        if drawn.name != shown_name(drawn, self.uses) {
            out += &format!("<title>{}</title>\n", escaped(&drawn.name));
        }
        if drawn.over.is_some() {
            out += &rect(SHEET_PX);
        }
        out += &rect(0.0);
        for (number, line) in lines(drawn, note, self.uses).iter().enumerate() {
            let class = if number == 0 { "name" } else { "more" };
            let y = top + PADDING_PX + NAME_PX - 4.0 + number as f64 * LINE_PX;
            let (x, line) = (left + width / 2.0, escaped(line));
            out += &format!("<text class=\"{class}\" x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"middle\">{line}</text>\n");
        }
        out + "</g>\n"
    }
}

/// A link with what it is; its tip where it comes to a step.
fn arrow(sheet: &Sheet, number: usize, corner: (f64, f64)) -> String {
    let link = &sheet.links[number];
    let (path, tip) = match sheet.way_px(number) {
        Some(points) => way(&points, corner),
        None => loop_path(sheet.box_px(link.from), corner),
    };
    let mut class = String::from("arrow");
    class += if link.gathers { " gathers" } else { "" };
    class += if link.back { " back" } else { "" };
    class += if link.lists { " lists" } else { "" };
    let told = escaped(&link.labels.join("\n"));
    let goes_on = matches!(sheet.cells[link.to], Cell::Exit(_) | Cell::Frame(..)) && link.from < link.to;
    let tip = if goes_on { String::new() } else { format!("<path class=\"tip\" d=\"{tip}\"/>") };
    format!("<g><title>{told}</title><path class=\"{class}\" d=\"{path}\"/>{tip}</g>\n")
}

/// A path by way of some corners, and its tip.
fn way(points: &[(f64, f64)], (left, top): (f64, f64)) -> (String, String) {
    let points: Vec<(f64, f64)> = points.iter().map(|(x, y)| (left + x, top + y)).collect();
    let mut path = format!("M{:.1} {:.1}", points[0].0, points[0].1);
    for pair in points.windows(2) {
        let ((x, y), (next_x, next_y)) = (pair[0], pair[1]);
        let middle = f64::midpoint(y, next_y);
        path += &format!("C{x:.1} {middle:.1} {next_x:.1} {middle:.1} {next_x:.1} {next_y:.1}");
    }
    let last = points.len() - 1;
    let ((x, y), up) = (points[last], points[last - 1].1 > points[last].1);
    let (left, right, base) = (x - TIP_PX / 2.0, x + TIP_PX / 2.0, if up { y + TIP_PX } else { y - TIP_PX });
    (path, format!("M{left:.1} {base:.1}L{x:.1} {y:.1}L{right:.1} {base:.1}z"))
}

/// Out of the right side of a box and back into it, and its tip.
fn loop_path((left, top, width, height): (f64, f64, f64, f64), corner: (f64, f64)) -> (String, String) {
    let (x, top) = (corner.0 + left + width, corner.1 + top);
    let (out, back) = (top + 0.7 * height, top + 0.3 * height);
    let (far, near) = (x + 24.0, x + SHEET_PX);
    let (top, base, bottom) = (back - TIP_PX / 2.0, near + TIP_PX, back + TIP_PX / 2.0);
    (
        format!("M{x:.1} {out:.1}C{far:.1} {out:.1} {far:.1} {back:.1} {near:.1} {back:.1}"),
        format!("M{base:.1} {top:.1}L{near:.1} {back:.1}L{base:.1} {bottom:.1}z"),
    )
}

/// What the marks mean, as far as there are any, in lines that fit.
fn legend(drawing: &DiGraph<Drawn, Arrow>, width_px: f64) -> Vec<String> {
    let steps = |is: fn(&Drawn) -> bool| drawing.node_weights().any(is);
    let arrows = |is: fn(&Arrow) -> bool| drawing.edge_weights().any(is);
    let marks = [
        (steps(|step| step.target), "bold frame: target"),
        (steps(|step| step.over.is_some()), "two sheets: one instance a point"),
        (steps(|step| !step.keep), "broken frame: not kept"),
        (steps(|step| !step.needed), "faint: no target needs it"),
        (arrows(|arrow| arrow.gathers), "bold arrow: gathered"),
        (arrows(|arrow| arrow.back), "broken arrow: from the item before"),
        (arrows(Arrow::lists), "dotted arrow: items of an axis"),
    ];
    let mut lines: Vec<String> = Vec::new();
    for (_, mark) in marks.iter().filter(|(there, _)| *there) {
        let longer = lines.last().map(|line| format!("{line} · {mark}"));
        match longer.filter(|line| line.chars().count() as f64 * LETTER * 11.0 <= width_px) {
            Some(longer) => {
                lines.pop();
                lines.push(longer);
            }
            None => lines.push((*mark).to_owned()),
        }
    }
    lines
}

fn class(drawn: &Drawn, note: Option<&Note>) -> String {
    let tint = match note.map_or(Tint::Plain, |note| note.tint) {
        Tint::Plain => "plain",
        Tint::Ran => "ran",
        Tint::Cached => "cached",
        Tint::Failed => "failed",
    };
    let marks = [(drawn.target, " target"), (!drawn.keep, " loose"), (!drawn.needed, " idle")];
    let marks = marks.iter().filter(|(there, _)| *there).map(|(_, class)| *class);
    std::iter::once(tint).chain(marks).collect()
}

/// The last part of a full name.
fn short(name: &str) -> &str {
    name.rsplit(INSIDE).next().unwrap_or(name)
}

/// The name in the box of a step: where frames tell the uses around it, its own.
fn shown_name<'d>(drawn: &'d Drawn, uses: &[(String, String)]) -> &'d str {
    if uses.is_empty() { &drawn.name } else { short(&drawn.name) }
}

/// Name, stage, what it is expanded over, and what is to be said besides.
fn lines(drawn: &Drawn, note: Option<&Note>, uses: &[(String, String)]) -> Vec<String> {
    let mut lines = vec![shown_name(drawn, uses).to_owned(), drawn.stage.clone()];
    lines.extend(drawn.over.as_ref().map(|(count, axes)| match count {
        Some(count) => format!("{count} × {axes}"),
        None => format!("? × {axes}"),
    }));
    lines.extend(note.map(|note| note.text.clone()).filter(|text| !text.is_empty()));
    lines
}

fn box_px(drawn: &Drawn, note: Option<&Note>, uses: &[(String, String)]) -> (f64, f64) {
    let lines = lines(drawn, note, uses);
    let width =
        |(number, line): (usize, &String)| line.chars().count() as f64 * LETTER * if number == 0 { 13.0 } else { 11.0 };
    let widest = lines.iter().enumerate().map(width).fold(70.0, f64::max);
    (widest + 2.0 * SIDE_PX, 2.0 * PADDING_PX + NAME_PX + (lines.len() - 1) as f64 * LINE_PX)
}

/// What stands for itself in XML.
pub fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
