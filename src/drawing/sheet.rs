//! Where everything of a drawing stands: boxes in rows, and around the steps of every use of a part a frame with rows of its
//! own. What leads into a frame or out of it passes a door in its edge.

use std::collections::{BTreeMap, BTreeSet};

use petgraph::graph::{DiGraph, NodeIndex};
use petgraph::visit::EdgeRef;

use super::layers::{Doors, Layers};
use super::place::places_px;
use super::{Arrow, Drawn, order};
use rockface_engine::pipeline::INSIDE;

/// Room between two rows, px.
const ROW_GAP_PX: f64 = 44.0;
/// Room between two arrows at one box, px.
const ARROWS_PX: f64 = 16.0;
/// Room left and right of the lines of a box, where no arrow ends, px.
pub const SIDE_PX: f64 = 14.0;
/// Room in a frame above its first row, where its name stands, px.
pub const HEAD_PX: f64 = 26.0;
/// Room in a frame beside and below what is in it, px.
pub const RIM_PX: f64 = 14.0;

/// Boxes in rows, and arrows between them; places are relative to its upper left corner.
pub struct Sheet {
    /// By node: what stands there.
    pub cells: Vec<Cell>,
    /// What flows between two of them.
    pub links: Vec<Link>,
    /// Width and height, px.
    pub size_px: (f64, f64),
    layers: Layers,
    /// By link, its trail; none for one that leads from a step to itself.
    trails: Vec<Option<usize>>,
    /// By node, the middle of its box.
    x_px: Vec<f64>,
    /// By trail, where it leaves the box it begins at, and where it comes to the one it ends at.
    ends_px: Vec<(f64, f64)>,
    /// By row, its upper and its lower edge.
    rows_px: Vec<(f64, f64)>,
    /// By node, width and height of its box; those of doors and of stand-ins are 0.
    boxes_px: Vec<(f64, f64)>,
}

/// What stands at a node.
pub enum Cell {
    /// A step, by its number in the drawing.
    Step(usize),
    /// The steps of a use of a part, by its full name.
    Frame(String, Box<Sheet>),
    /// Where the output of a step outside, by its number, comes in.
    Entry(usize),
    /// Where the output of a step inside, by its number, goes out.
    Exit(usize),
}

/// What flows between two nodes of a sheet, of one step.
#[derive(Default)]
pub struct Link {
    /// The node it comes from.
    pub from: usize,
    /// The node it leads to.
    pub to: usize,
    /// The step that makes it, by its number in the drawing.
    maker: usize,
    /// The labels of the arrows it stands for, each once.
    pub labels: Vec<String>,
    /// Whether items come together.
    pub gathers: bool,
    /// Whether it comes from the item before.
    pub back: bool,
    /// Whether it is nothing but the items of axes.
    pub lists: bool,
}

/// What flows from a step to another, as far as both are in a frame.
#[derive(Clone, Copy)]
struct Flow<'d> {
    /// The step it comes from; none where that stands outside.
    from: Option<usize>,
    /// The step it leads to; none where that stands outside.
    to: Option<usize>,
    maker: usize,
    arrow: &'d Arrow,
}

/// How much room texts take, px.
pub struct Sizes<'b> {
    /// Width and height of the box of a step.
    pub step: &'b dyn Fn(&Drawn) -> (f64, f64),
    /// Width of what is written above the frame of a use.
    pub head: &'b dyn Fn(&str) -> f64,
}

impl Sheet {
    /// The sheet of a drawing.
    pub fn of(drawing: &DiGraph<Drawn, Arrow>, sizes: &Sizes) -> Self {
        let steps: Vec<usize> = drawing.node_indices().map(NodeIndex::index).collect();
        let flow = |from: usize, to: usize, arrow| Flow { from: Some(from), to: Some(to), maker: from, arrow };
        let flows =
            drawing.edge_references().map(|edge| flow(edge.source().index(), edge.target().index(), edge.weight()));
        Self::new("", &steps, &flows.collect::<Vec<_>>(), drawing, sizes)
    }

    fn new(prefix: &str, steps: &[usize], flows: &[Flow], drawing: &DiGraph<Drawn, Arrow>, sizes: &Sizes) -> Self {
        let mut plan = Rows::of(prefix, steps, flows, drawing);
        let links = plan.links(flows);
        let links = plan.put_in_order(links);
        let cell = |content| match content {
            Content::Cell(cell) => cell,
            Content::Use(name, steps, flows) => {
                let prefix = format!("{name}{INSIDE}");
                Cell::Frame(name, Box::new(Self::new(&prefix, &steps, &flows, drawing, sizes)))
            }
        };
        let cells: Vec<Cell> = plan.cells.into_iter().map(cell).collect();
        let size = |cell: &Cell| match cell {
            Cell::Step(step) => (sizes.step)(&drawing[NodeIndex::new(*step)]),
            Cell::Frame(name, sheet) => {
                let (width, height) = sheet.size_px;
                ((width + 2.0 * RIM_PX).max((sizes.head)(name)), height + HEAD_PX + RIM_PX)
            }
            Cell::Entry(_) | Cell::Exit(_) => (0.0, 0.0),
        };
        let boxes_px = cells.iter().map(size).collect();
        Self::placed(cells, links, boxes_px)
    }

    fn placed(cells: Vec<Cell>, links: Vec<Link>, mut boxes_px: Vec<(f64, f64)>) -> Self {
        let mut arrows = Vec::new();
        let trails = links.iter().map(|link| {
            (link.from != link.to).then(|| {
                // What leads to something further up is drawn upwards.
                arrows.push((link.from.min(link.to), link.from.max(link.to)));
                arrows.len() - 1
            })
        });
        let trails = trails.collect();
        let count = |is: fn(&Cell) -> bool| cells.iter().filter(|cell| is(cell)).count();
        let doors = Doors {
            entries: count(|cell| matches!(cell, Cell::Entry(_))),
            exits: count(|cell| matches!(cell, Cell::Exit(_))),
        };
        let mut layers = Layers::new(cells.len(), &arrows, doors);
        order::untangle(&mut layers);
        boxes_px.resize(layers.row_of.len(), (0.0, 0.0));
        let widths: Vec<f64> = boxes_px.iter().map(|size| size.0).collect();
        let x_px = places_px(&layers, &widths);
        let (mut rows_px, mut top) = (Vec::new(), 0.0);
        for row in &layers.rows {
            let height = row.iter().map(|node| boxes_px[*node].1).fold(0.0, f64::max);
            rows_px.push((top, top + height));
            top += height + ROW_GAP_PX;
        }
        let right = (0..x_px.len()).map(|node| x_px[node] + widths[node] / 2.0).fold(0.0, f64::max);
        let size_px = (right, (top - ROW_GAP_PX).max(0.0));
        let mut sheet = Self { cells, links, size_px, layers, trails, x_px, ends_px: Vec::new(), rows_px, boxes_px };
        sheet.ends_px = sheet.ends();
        sheet
    }

    /// Left and upper edge of a node's box, and its width and height.
    pub fn box_px(&self, node: usize) -> (f64, f64, f64, f64) {
        let (width, height) = self.boxes_px[node];
        (self.x_px[node] - width / 2.0, self.edges_px(node).0, width, height)
    }

    /// Upper and lower edge of a box; it stands in the middle of its row.
    fn edges_px(&self, node: usize) -> (f64, f64) {
        let (top, bottom) = self.rows_px[self.layers.row_of[node]];
        let height = self.boxes_px[node].1;
        let middle = f64::midpoint(top, bottom);
        if height == 0.0 { (top, bottom) } else { (middle - height / 2.0, middle + height / 2.0) }
    }

    /// The corners of a link's way from box to box by way of the stand-ins, in its direction; none for one that leads from
    /// a step to itself.
    pub fn way_px(&self, number: usize) -> Option<Vec<(f64, f64)>> {
        let trail = self.trails[number]?;
        let nodes = &self.layers.trails[trail];
        let last = nodes.len() - 1;
        let (leaves_px, comes_px) = self.ends_px[trail];
        let mut points = Vec::new();
        if let Some(Cell::Entry(_)) = self.cells.get(nodes[0]) {
            points.push((leaves_px, -HEAD_PX));
        }
        points.push((leaves_px, self.edges_px(nodes[0]).1));
        for node in &nodes[1..last] {
            let (top, bottom) = self.edges_px(*node);
            points.extend([(self.x_px[*node], top), (self.x_px[*node], bottom)]);
        }
        points.push((comes_px, self.edges_px(nodes[last]).0));
        if let Some(Cell::Exit(_)) = self.cells.get(nodes[last]) {
            points.push((comes_px, self.size_px.1 + RIM_PX));
        }
        if self.links[number].from > self.links[number].to {
            points.reverse();
        }
        Some(points)
    }

    /// Where each trail leaves its first box and comes to its last: at its door in a frame, and at a step beside the other
    /// trails there, in the order of where they lead.
    fn ends(&self) -> Vec<(f64, f64)> {
        let trails = &self.layers.trails;
        let mut ends = vec![(0.0, 0.0); trails.len()];
        for leaving in [true, false] {
            let mut at: BTreeMap<usize, Vec<(f64, usize)>> = BTreeMap::new();
            for (number, trail) in trails.iter().enumerate() {
                let last = trail.len() - 1;
                let (own, next) = if leaving { (trail[0], trail[1]) } else { (trail[last], trail[last - 1]) };
                at.entry(own).or_default().push((self.x_px[next], number));
            }
            for (node, mut trails) in at {
                trails.sort_by(|one, other| one.0.total_cmp(&other.0));
                let gaps = (trails.len() - 1) as f64;
                let room = (self.boxes_px[node].0 - 2.0 * SIDE_PX).max(0.0);
                let gap = ARROWS_PX.min(room / gaps.max(1.0));
                for (place, (_, number)) in trails.into_iter().enumerate() {
                    let side = self.x_px[node] + (place as f64 - gaps / 2.0) * gap;
                    let end = self.door_px(node, number, leaving).unwrap_or(side);
                    if leaving { ends[number].0 = end } else { ends[number].1 = end }
                }
            }
        }
        ends
    }

    /// Where a trail passes the edge of a frame.
    fn door_px(&self, node: usize, trail: usize, leaving: bool) -> Option<f64> {
        let Some(Cell::Frame(_, sheet)) = self.cells.get(node) else { return None };
        let number = self.trails.iter().position(|own| *own == Some(trail))?;
        let maker = self.links[number].maker;
        let is_door = |cell: &Cell| match cell {
            Cell::Entry(of) => !leaving && *of == maker,
            Cell::Exit(of) => leaving && *of == maker,
            Cell::Step(_) | Cell::Frame(..) => false,
        };
        let door = sheet.cells.iter().position(is_door)?;
        Some(self.x_px[node] - self.boxes_px[node].0 / 2.0 + RIM_PX + sheet.x_px[door])
    }
}

/// What will stand at a node.
enum Content<'d> {
    Cell(Cell),
    /// A use by its full name, with its steps and what flows in it, into it and out of it.
    Use(String, Vec<usize>, Vec<Flow<'d>>),
}

/// The nodes of a sheet before they are placed: entries first, exits last.
struct Rows<'d> {
    cells: Vec<Content<'d>>,
    /// By the number of a step: its node, or that of its frame.
    of_step: BTreeMap<usize, usize>,
    /// By the step that makes what comes in, and by the one that makes what goes out.
    entries: BTreeMap<usize, usize>,
    exits: BTreeMap<usize, usize>,
}

impl<'d> Rows<'d> {
    fn of(prefix: &str, steps: &[usize], flows: &[Flow], drawing: &DiGraph<Drawn, Arrow>) -> Self {
        let empty = || (BTreeMap::new(), BTreeMap::new(), BTreeMap::new());
        let (of_step, entries, exits) = empty();
        let mut rows = Self { cells: Vec::new(), of_step, entries, exits };
        for flow in flows.iter().filter(|flow| flow.from.is_none()) {
            if !rows.entries.contains_key(&flow.maker) {
                rows.entries.insert(flow.maker, rows.cells.len());
                rows.cells.push(Content::Cell(Cell::Entry(flow.maker)));
            }
        }
        let mut frames: BTreeMap<String, usize> = BTreeMap::new();
        for step in steps {
            let name = &drawing[NodeIndex::new(*step)].name;
            let inner = name.strip_prefix(prefix).unwrap_or(name).split_once(INSIDE);
            let new = rows.cells.len();
            let node = inner.map_or(new, |(used, _)| *frames.entry(format!("{prefix}{used}")).or_insert(new));
            match (inner, rows.cells.get_mut(node)) {
                (Some(_), Some(Content::Use(_, steps, _))) => steps.push(*step),
                (Some((used, _)), _) => {
                    rows.cells.push(Content::Use(format!("{prefix}{used}"), vec![*step], Vec::new()));
                }
                (None, _) => rows.cells.push(Content::Cell(Cell::Step(*step))),
            }
            rows.of_step.insert(*step, node);
        }
        for flow in flows.iter().filter(|flow| flow.to.is_none()) {
            if !rows.exits.contains_key(&flow.maker) {
                rows.exits.insert(flow.maker, rows.cells.len());
                rows.cells.push(Content::Cell(Cell::Exit(flow.maker)));
            }
        }
        rows
    }

    /// What flows between the nodes; hands on what goes on inside of frames.
    fn links(&mut self, flows: &[Flow<'d>]) -> Vec<Link> {
        let mut links: BTreeMap<(usize, usize, usize), Link> = BTreeMap::new();
        for flow in flows {
            let from = flow.from.map_or_else(|| self.entries[&flow.maker], |step| self.of_step[&step]);
            let to = flow.to.map_or_else(|| self.exits[&flow.maker], |step| self.of_step[&step]);
            if from == to && matches!(self.cells[from], Content::Use(..)) {
                self.hand_on(from, *flow);
                continue;
            }
            self.hand_on(from, Flow { to: None, ..*flow });
            self.hand_on(to, Flow { from: None, ..*flow });
            let new = || Link { from, to, maker: flow.maker, lists: true, ..Link::default() };
            let link = links.entry((from, to, flow.maker)).or_insert_with(new);
            if !link.labels.contains(&flow.arrow.label) {
                link.labels.push(flow.arrow.label.clone());
            }
            link.gathers |= flow.arrow.gathers;
            link.back |= flow.arrow.back;
            link.lists &= flow.arrow.lists();
        }
        links.into_values().collect()
    }

    /// Numbers the nodes anew so that links lead from lower numbers to higher ones, unless they go in a circle: a use stands
    /// where its inputs are there, and not where the first of its steps is. Exits stay the last.
    fn put_in_order(&mut self, mut links: Vec<Link>) -> Vec<Link> {
        let count = self.cells.len();
        let (mut open, mut below) = (vec![0_usize; count], vec![Vec::new(); count]);
        for link in links.iter().filter(|link| link.from != link.to) {
            open[link.to] += 1;
            below[link.from].push(link.to);
        }
        let first_exit = count - self.exits.len();
        let mut left: BTreeSet<usize> = (0..first_exit).collect();
        let mut ready: BTreeSet<usize> = left.iter().copied().filter(|node| open[*node] == 0).collect();
        let mut order = Vec::with_capacity(count);
        // In a circle the first that is left comes next.
        while let Some(node) = ready.first().or_else(|| left.first()).copied() {
            ready.remove(&node);
            left.remove(&node);
            order.push(node);
            for to in std::mem::take(&mut below[node]) {
                open[to] -= 1;
                if open[to] == 0 && left.contains(&to) {
                    ready.insert(to);
                }
            }
        }
        order.extend(first_exit..count);
        let mut number = vec![0; count];
        order.iter().enumerate().for_each(|(new, old)| number[*old] = new);
        for link in &mut links {
            (link.from, link.to) = (number[link.from], number[link.to]);
        }
        let mut cells: Vec<Option<Content>> = std::mem::take(&mut self.cells).into_iter().map(Some).collect();
        self.cells = order.iter().filter_map(|old| cells[*old].take()).collect();
        links
    }

    fn hand_on(&mut self, node: usize, flow: Flow<'d>) {
        if let Content::Use(_, _, flows) = &mut self.cells[node] {
            flows.push(flow);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SMALL: Sizes = Sizes { step: &|_| (80.0, 40.0), head: &|_| 0.0 };

    fn drawing(names: &[&str], arrows: &[(usize, usize)]) -> DiGraph<Drawn, Arrow> {
        let mut graph = DiGraph::new();
        let step = |name: &&str| Drawn {
            name: (*name).to_owned(),
            stage: "emit".to_owned(),
            over: None,
            target: false,
            keep: true,
            needed: true,
        };
        let nodes: Vec<_> = names.iter().map(|name| graph.add_node(step(name))).collect();
        for (from, to) in arrows {
            let label = format!("{from} to {to}");
            let arrow = Arrow { output: String::new(), input: Some("in"), label, gathers: false, back: false };
            graph.add_edge(nodes[*from], nodes[*to], arrow);
        }
        graph
    }

    /// All boxes of steps in a sheet, with the frames they stand in: left, top, right, bottom.
    fn boxes(sheet: &Sheet, (x, y): (f64, f64), found: &mut Vec<(Option<usize>, [f64; 4])>) {
        for (node, cell) in sheet.cells.iter().enumerate() {
            let (left, top, width, height) = sheet.box_px(node);
            let place = [x + left, y + top, x + left + width, y + top + height];
            match cell {
                Cell::Step(step) => found.push((Some(*step), place)),
                Cell::Frame(_, inner) => {
                    found.push((None, place));
                    boxes(inner, (place[0] + RIM_PX, place[1] + HEAD_PX), found);
                }
                Cell::Entry(_) | Cell::Exit(_) => {}
            }
        }
    }

    #[test]
    fn a_frame_holds_its_steps_and_no_others() {
        let names = ["a", "u/x", "u/v/y", "b", "u/v/z", "u/w", "end"];
        let arrows = [(0, 1), (1, 2), (0, 3), (3, 4), (2, 4), (4, 5), (5, 6), (2, 6)];
        let drawing = drawing(&names, &arrows);
        let sheet = Sheet::of(&drawing, &SMALL);
        let mut found = Vec::new();
        boxes(&sheet, (0.0, 0.0), &mut found);
        let frames: Vec<[f64; 4]> = found.iter().filter(|(step, _)| step.is_none()).map(|(_, place)| *place).collect();
        assert_eq!(frames.len(), 2);
        let inside = |frame: &[f64; 4], own: &[f64; 4]| {
            own[0] > frame[0] && own[1] > frame[1] && own[2] < frame[2] && own[3] < frame[3]
        };
        let apart = |frame: &[f64; 4], own: &[f64; 4]| {
            own[2] < frame[0] || own[0] > frame[2] || own[3] < frame[1] || own[1] > frame[3]
        };
        for (step, own) in found.iter().filter_map(|(step, place)| Some(((*step)?, place))) {
            for (frame, prefix) in frames.iter().zip(["u/", "u/v/"]) {
                let fits = if names[step].starts_with(prefix) { inside(frame, own) } else { apart(frame, own) };
                assert!(fits, "{} and {prefix}: {own:?} {frame:?}", names[step]);
            }
        }
        assert!(sheet.links.iter().all(|link| !link.labels.is_empty()));
    }

    #[test]
    fn a_use_stands_below_what_feeds_it() {
        // The first step of the use needs nothing; another reads from outside.
        let drawing = drawing(&["u/x", "face", "u/y"], &[(1, 2), (0, 2)]);
        let sheet = Sheet::of(&drawing, &SMALL);
        assert!(matches!(sheet.cells[0], Cell::Step(1)) && matches!(sheet.cells[1], Cell::Frame(..)));
        let points = sheet.way_px(0).unwrap();
        assert!(points[0].1 < points[points.len() - 1].1);
    }

    #[test]
    fn what_enters_a_frame_goes_on_inside_from_the_same_place() {
        let drawing = drawing(&["a", "u/x", "u/y"], &[(0, 1), (0, 2)]);
        let sheet = Sheet::of(&drawing, &SMALL);
        // One arrow to the frame, from whose door two lead on.
        assert_eq!(sheet.links.len(), 1);
        let Cell::Frame(name, inner) = &sheet.cells[1] else { panic!("a frame") };
        assert_eq!((name.as_str(), inner.links.len()), ("u", 2));
        let (x, y) = *sheet.way_px(0).unwrap().last().unwrap();
        let (left, top, ..) = sheet.box_px(1);
        let (inner_x, inner_y) = inner.way_px(0).unwrap()[0];
        assert!((x - (left + RIM_PX + inner_x)).abs() < 1e-9 && (y - (top + HEAD_PX + inner_y)).abs() < 1e-9);
    }
}
