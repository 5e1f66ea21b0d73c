//! Which step stands in which row: every arrow leads down, long ones by way of a stand-in in each row they pass.
//!
//! # References
//!
//! Sugiyama, Tagawa and Toda (1981), Methods for visual understanding of hierarchical system structures, IEEE Trans.
//! Systems, Man, and Cybernetics 11(2), 109-125: rows, stand-ins, order, then places.

/// Rows of nodes, and the links between nodes of neighbouring rows.
///
/// The first nodes are those of the drawing; stand-ins follow.
pub struct Layers {
    /// The nodes of each row, from the top, in order from the left.
    pub rows: Vec<Vec<usize>>,
    /// The row of each node.
    pub row_of: Vec<usize>,
    /// By node: those linked to it in the row above.
    pub above: Vec<Vec<usize>>,
    /// By node: those linked to it in the row below.
    pub below: Vec<Vec<usize>>,
    /// By arrow: the nodes it passes, both ends included.
    pub trails: Vec<Vec<usize>>,
}

/// How many of the first nodes stand in the first row, and how many of the last ones in the last.
#[derive(Debug, Clone, Copy, Default)]
pub struct Doors {
    /// In the first row.
    pub entries: usize,
    /// In the last row.
    pub exits: usize,
}

impl Layers {
    /// Rows for `count` nodes with these arrows, each from a lower number to a higher one.
    pub fn new(count: usize, arrows: &[(usize, usize)], doors: Doors) -> Self {
        let row_of = rows_of(count, arrows, doors);
        let mut layers = Self {
            rows: vec![Vec::new(); row_of.iter().max().map_or(0, |last| last + 1)],
            row_of: Vec::new(),
            above: Vec::new(),
            below: Vec::new(),
            trails: Vec::new(),
        };
        row_of.iter().for_each(|row| _ = layers.add(*row));
        for (from, to) in arrows {
            let mut trail = vec![*from];
            trail.extend((row_of[*from] + 1..row_of[*to]).map(|row| layers.add(row)));
            trail.push(*to);
            for pair in trail.windows(2) {
                layers.below[pair[0]].push(pair[1]);
                layers.above[pair[1]].push(pair[0]);
            }
            layers.trails.push(trail);
        }
        layers
    }

    fn add(&mut self, row: usize) -> usize {
        let node = self.row_of.len();
        self.row_of.push(row);
        self.above.push(Vec::new());
        self.below.push(Vec::new());
        self.rows[row].push(node);
        node
    }
}

/// As far up as the arrows allow; what nothing leads to stands just above the first that reads from it.
fn rows_of(count: usize, arrows: &[(usize, usize)], doors: Doors) -> Vec<usize> {
    let mut rows = vec![0; count];
    let mut sorted = arrows.to_vec();
    sorted.sort_unstable();
    for (from, to) in &sorted {
        rows[*to] = rows[*to].max(rows[*from] + 1);
    }
    let mut first_reader: Vec<Option<usize>> = vec![None; count];
    let mut is_source = vec![true; count];
    for (from, to) in &sorted {
        is_source[*to] = false;
        let row = first_reader[*from].map_or(rows[*to], |row| row.min(rows[*to]));
        first_reader[*from] = Some(row);
    }
    for node in (doors.entries..count).filter(|node| is_source[*node]) {
        rows[node] = first_reader[node].map_or(0, |row| row - 1);
    }
    let last = rows.iter().copied().max().unwrap_or(0);
    rows[count - doors.exits..].fill(last);
    rows
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_arrow_leads_down_by_one_row_at_a_time() {
        let layers = Layers::new(5, &[(0, 1), (1, 2), (0, 2), (2, 4), (3, 4)], Doors::default());
        assert_eq!(layers.row_of[..5], [0, 1, 2, 2, 3]);
        assert_eq!(layers.trails[2].len(), 3);
        for trail in &layers.trails {
            assert!(trail.windows(2).all(|pair| layers.row_of[pair[1]] == layers.row_of[pair[0]] + 1));
        }
        assert_eq!(layers.rows.iter().map(Vec::len).sum::<usize>(), layers.row_of.len());
    }
}
