//! A drawing as SVG: boxes in rows, arrows from top to bottom, colours for light and for dark pages.

use std::collections::BTreeMap;

use petgraph::graph::DiGraph;
use petgraph::visit::EdgeRef;

use super::layers::Layers;
use super::place::places_px;
use super::{Arrow, Drawn, Note, Tint, order};

/// Room between two rows, px.
const ROW_GAP_PX: f64 = 44.0;
/// Room around everything, px.
const MARGIN_PX: f64 = 18.0;
/// Height of the line with a step's name, px.
const NAME_PX: f64 = 17.0;
/// Height of every further line, px.
const LINE_PX: f64 = 15.0;
/// Room in a box above and below its lines, px.
const PADDING_PX: f64 = 8.0;
/// Room in a box left and right of its lines, px.
const SIDE_PX: f64 = 14.0;
/// Width of the widest letters in parts of the size of a font that is not known here.
const LETTER: f64 = 0.62;
/// How far the second sheet of a sweep shows, px.
const SHEET_PX: f64 = 4.0;
/// Length and width of the tip of an arrow, px.
const TIP_PX: f64 = 8.0;
/// Room between two arrows at one box, px.
const ARROWS_PX: f64 = 16.0;

/// Colours and line styles; every class is below `rockface-graph`, so that pages it is put into stay as they are.
const STYLE: &str = r#"
.rockface-graph{font-family:system-ui,"Segoe UI",Roboto,"DejaVu Sans",sans-serif}
.rockface-graph .paper{fill:#ffffff}
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

/// The picture.
pub fn svg(drawing: &DiGraph<Drawn, Arrow>, notes: &BTreeMap<String, Note>) -> String {
    let picture = Picture::new(drawing, notes);
    let (width, height) = picture.size_px;
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" class=\"rockface-graph\" role=\"img\" width=\"{width:.0}\" \
         height=\"{height:.0}\" viewBox=\"0 0 {width:.0} {height:.0}\">\n<title>steps of the pipeline</title>\n\
         <style>{STYLE}</style>\n\
         <rect class=\"paper\" width=\"{width:.0}\" height=\"{height:.0}\"/>\n"
    );
    picture.links.iter().enumerate().for_each(|(number, link)| out += &picture.arrow(number, link));
    drawing.node_indices().for_each(|node| out += &picture.step(node.index(), &drawing[node]));
    out += &picture.legend();
    out + "</svg>\n"
}

/// Everything that flows between two steps.
struct Link {
    from: usize,
    to: usize,
    labels: Vec<String>,
    gathers: bool,
    back: bool,
    lists: bool,
}

struct Picture<'a> {
    notes: &'a BTreeMap<String, Note>,
    links: Vec<Link>,
    layers: Layers,
    /// By link, its trail; none for one that leads from a step to itself.
    trails: Vec<Option<usize>>,
    /// By node, the middle of its box.
    x_px: Vec<f64>,
    /// By trail, where it leaves the box it begins at, and where it comes to the one it ends at.
    doors_px: Vec<(f64, f64)>,
    /// By row, its upper and its lower edge.
    rows_px: Vec<(f64, f64)>,
    /// By node, width and height of its box; those of stand-ins are 0.
    boxes_px: Vec<(f64, f64)>,
    /// What the marks mean.
    legend: Vec<String>,
    size_px: (f64, f64),
}

impl<'a> Picture<'a> {
    fn new(drawing: &DiGraph<Drawn, Arrow>, notes: &'a BTreeMap<String, Note>) -> Self {
        let links = links(drawing);
        let mut arrows = Vec::new();
        let trails = links.iter().map(|link| {
            (link.from != link.to).then(|| {
                // What comes from the item before leads up.
                arrows.push((link.from.min(link.to), link.from.max(link.to)));
                arrows.len() - 1
            })
        });
        let trails = trails.collect();
        let mut layers = Layers::new(drawing.node_count(), &arrows);
        order::untangle(&mut layers);
        let mut boxes_px: Vec<(f64, f64)> =
            drawing.node_weights().map(|drawn| box_px(drawn, notes.get(&drawn.name))).collect();
        boxes_px.resize(layers.row_of.len(), (0.0, 0.0));
        let widths: Vec<f64> = boxes_px.iter().map(|size| size.0).collect();
        let x_px: Vec<f64> = places_px(&layers, &widths).into_iter().map(|x| x + MARGIN_PX).collect();
        let mut rows_px = Vec::new();
        let mut top = MARGIN_PX;
        for row in &layers.rows {
            let height = row.iter().map(|node| boxes_px[*node].1).fold(0.0, f64::max);
            rows_px.push((top, top + height));
            top += height + ROW_GAP_PX;
        }
        let right = (0..x_px.len()).map(|node| x_px[node] + widths[node] / 2.0).fold(320.0, f64::max);
        let legend = legend(drawing, right);
        let below = MARGIN_PX + legend.len() as f64 * LINE_PX + PADDING_PX;
        let size_px = (right + 2.0 * MARGIN_PX, top - ROW_GAP_PX + below);
        let doors_px = doors_px(&layers, &x_px, &boxes_px);
        Self { notes, links, layers, trails, x_px, doors_px, rows_px, boxes_px, legend, size_px }
    }

    /// Upper and lower edge of a box; it stands in the middle of its row.
    fn edges_px(&self, node: usize) -> (f64, f64) {
        let (top, bottom) = self.rows_px[self.layers.row_of[node]];
        let height = self.boxes_px[node].1;
        let middle = f64::midpoint(top, bottom);
        if height == 0.0 { (top, bottom) } else { (middle - height / 2.0, middle + height / 2.0) }
    }

    fn arrow(&self, number: usize, link: &Link) -> String {
        let (path, tip) = match self.trails[number] {
            Some(trail) => self.path(trail, link.from > link.to),
            None => self.loop_path(link.from),
        };
        let mut class = String::from("arrow");
        class += if link.gathers { " gathers" } else { "" };
        class += if link.back { " back" } else { "" };
        class += if link.lists { " lists" } else { "" };
        let told = escaped(&link.labels.join("\n"));
        format!("<g><title>{told}</title><path class=\"{class}\" d=\"{path}\"/><path class=\"tip\" d=\"{tip}\"/></g>\n")
    }

    /// From box to box by way of the stand-ins, and its tip; `up` for what leads to a box above.
    fn path(&self, trail: usize, up: bool) -> (String, String) {
        let nodes = &self.layers.trails[trail];
        let last = nodes.len() - 1;
        let (leaves_px, comes_px) = self.doors_px[trail];
        let mut points = vec![(leaves_px, self.edges_px(nodes[0]).1)];
        for node in &nodes[1..last] {
            let (top, bottom) = self.edges_px(*node);
            points.extend([(self.x_px[*node], top), (self.x_px[*node], bottom)]);
        }
        points.push((comes_px, self.edges_px(nodes[last]).0));
        if up {
            points.reverse();
        }
        let mut path = format!("M{:.1} {:.1}", points[0].0, points[0].1);
        for pair in points.windows(2) {
            let ((x, y), (next_x, next_y)) = (pair[0], pair[1]);
            let middle = f64::midpoint(y, next_y);
            path += &format!("C{x:.1} {middle:.1} {next_x:.1} {middle:.1} {next_x:.1} {next_y:.1}");
        }
        let (x, y) = points[points.len() - 1];
        let (left, right, base) = (x - TIP_PX / 2.0, x + TIP_PX / 2.0, if up { y + TIP_PX } else { y - TIP_PX });
        (path, format!("M{left:.1} {base:.1}L{x:.1} {y:.1}L{right:.1} {base:.1}z"))
    }

    /// Out of the right side of a box and back into it, and its tip.
    fn loop_path(&self, node: usize) -> (String, String) {
        let (top, bottom) = self.edges_px(node);
        let x = self.x_px[node] + self.boxes_px[node].0 / 2.0;
        let (out, back) = (top + 0.7 * (bottom - top), top + 0.3 * (bottom - top));
        let (far, near) = (x + 24.0, x + SHEET_PX);
        let (top, base, bottom) = (back - TIP_PX / 2.0, near + TIP_PX, back + TIP_PX / 2.0);
        (
            format!("M{x:.1} {out:.1}C{far:.1} {out:.1} {far:.1} {back:.1} {near:.1} {back:.1}"),
            format!("M{base:.1} {top:.1}L{near:.1} {back:.1}L{base:.1} {bottom:.1}z"),
        )
    }

    fn step(&self, node: usize, drawn: &Drawn) -> String {
        let note = self.notes.get(&drawn.name);
        let (width, height) = self.boxes_px[node];
        let (top, _) = self.edges_px(node);
        let left = self.x_px[node] - width / 2.0;
        let rect = |shift: f64| {
            format!(
                "<rect class=\"box\" x=\"{:.1}\" y=\"{:.1}\" width=\"{width:.1}\" height=\"{height:.1}\" rx=\"5\"/>\n",
                left + shift,
                top + shift
            )
        };
        let mut out = format!("<g class=\"{}\">\n", class(drawn, note));
        if drawn.over.is_some() {
            out += &rect(SHEET_PX);
        }
        out += &rect(0.0);
        for (number, line) in lines(drawn, note).iter().enumerate() {
            let class = if number == 0 { "name" } else { "more" };
            let y = top + PADDING_PX + NAME_PX - 4.0 + number as f64 * LINE_PX;
            let (x, line) = (self.x_px[node], escaped(line));
            out += &format!("<text class=\"{class}\" x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"middle\">{line}</text>\n");
        }
        out + "</g>\n"
    }

    fn legend(&self) -> String {
        let line = |(number, text): (usize, &String)| {
            let y = self.size_px.1 - PADDING_PX - (self.legend.len() - 1 - number) as f64 * LINE_PX;
            format!("<text class=\"more\" x=\"{MARGIN_PX:.0}\" y=\"{y:.0}\">{}</text>\n", escaped(text))
        };
        self.legend.iter().enumerate().map(line).collect()
    }
}

/// Where each trail leaves its first box and comes to its last: beside the other trails there, in the order of where they
/// lead.
fn doors_px(layers: &Layers, x_px: &[f64], boxes_px: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let mut doors = vec![(0.0, 0.0); layers.trails.len()];
    for leaving in [true, false] {
        let mut at: BTreeMap<usize, Vec<(f64, usize)>> = BTreeMap::new();
        for (number, trail) in layers.trails.iter().enumerate() {
            let last = trail.len() - 1;
            let (own, next) = if leaving { (trail[0], trail[1]) } else { (trail[last], trail[last - 1]) };
            at.entry(own).or_default().push((x_px[next], number));
        }
        for (node, mut trails) in at {
            trails.sort_by(|one, other| one.0.total_cmp(&other.0));
            let gaps = (trails.len() - 1) as f64;
            let gap = ARROWS_PX.min((boxes_px[node].0 - 2.0 * SIDE_PX) / gaps.max(1.0));
            for (place, (_, number)) in trails.into_iter().enumerate() {
                let door = x_px[node] + (place as f64 - gaps / 2.0) * gap;
                if leaving { doors[number].0 = door } else { doors[number].1 = door }
            }
        }
    }
    doors
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

fn links(drawing: &DiGraph<Drawn, Arrow>) -> Vec<Link> {
    let mut links: BTreeMap<(usize, usize), Link> = BTreeMap::new();
    for edge in drawing.edge_references() {
        let (from, to, arrow) = (edge.source().index(), edge.target().index(), edge.weight());
        let new = || Link { from, to, labels: Vec::new(), gathers: false, back: false, lists: true };
        let link = links.entry((from, to)).or_insert_with(new);
        link.labels.push(arrow.label.clone());
        link.gathers |= arrow.gathers;
        link.back |= arrow.back;
        link.lists &= arrow.lists();
    }
    links.into_values().collect()
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

/// Name, stage, what it is expanded over, and what is to be said besides.
fn lines(drawn: &Drawn, note: Option<&Note>) -> Vec<String> {
    let mut lines = vec![drawn.name.clone(), drawn.stage.clone()];
    lines.extend(drawn.over.as_ref().map(|(count, axes)| match count {
        Some(count) => format!("{count} × {axes}"),
        None => format!("? × {axes}"),
    }));
    lines.extend(note.map(|note| note.text.clone()).filter(|text| !text.is_empty()));
    lines
}

fn box_px(drawn: &Drawn, note: Option<&Note>) -> (f64, f64) {
    let lines = lines(drawn, note);
    let width =
        |(number, line): (usize, &String)| line.chars().count() as f64 * LETTER * if number == 0 { 13.0 } else { 11.0 };
    let widest = lines.iter().enumerate().map(width).fold(70.0, f64::max);
    (widest + 2.0 * SIDE_PX, 2.0 * PADDING_PX + NAME_PX + (lines.len() - 1) as f64 * LINE_PX)
}

/// What stands for itself in XML.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
