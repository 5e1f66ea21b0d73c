//! The order within rows: nodes near those they are linked to, so that few arrows cross.

use super::layers::Layers;

/// How often the rows are gone through, down and up.
const SWEEPS: usize = 24;
/// How often those of a drawing with very many nodes are, which nobody looks at closely.
const FEW_SWEEPS: usize = 4;
/// From how many nodes on these are very many.
const MANY: usize = 2000;

/// Puts the rows in an order with few crossings; the best that was met counts.
pub fn untangle(layers: &mut Layers) {
    let mut places = vec![0; layers.row_of.len()];
    (0..layers.rows.len()).for_each(|row| note_places(layers, row, &mut places));
    let mut best = (crossings(layers, &places), layers.rows.clone());
    let sweeps = if layers.row_of.len() > MANY { FEW_SWEEPS } else { SWEEPS };
    for sweep in 0..sweeps {
        if best.0 == 0 {
            break;
        }
        let down = sweep % 2 == 0;
        let count = layers.rows.len();
        for step in 1..count {
            let row = if down { step } else { count - 1 - step };
            sort_by_neighbours(layers, row, down, &places);
            note_places(layers, row, &mut places);
            swap_neighbours(layers, row, &places);
            note_places(layers, row, &mut places);
        }
        let now = crossings(layers, &places);
        if now < best.0 {
            best = (now, layers.rows.clone());
        }
    }
    layers.rows = best.1;
}

/// Notes the place of every node of a row.
fn note_places(layers: &Layers, row: usize, places: &mut [usize]) {
    layers.rows[row].iter().enumerate().for_each(|(place, node)| places[*node] = place);
}

/// Sorts a row by the mean place of each node's links in the row before; nodes without any keep their place.
fn sort_by_neighbours(layers: &mut Layers, row: usize, down: bool, places: &[usize]) {
    let mean = |(own, node): (usize, &usize)| {
        let links = if down { &layers.above[*node] } else { &layers.below[*node] };
        let sum: usize = links.iter().map(|link| places[*link]).sum();
        if links.is_empty() { own as f64 } else { sum as f64 / links.len() as f64 }
    };
    let mut keyed: Vec<(f64, usize)> =
        layers.rows[row].iter().enumerate().map(|entry| (mean(entry), *entry.1)).collect();
    keyed.sort_by(|one, other| one.0.total_cmp(&other.0));
    layers.rows[row] = keyed.into_iter().map(|(_, node)| node).collect();
}

/// Exchanges two that stand side by side wherever that leaves fewer crossings.
fn swap_neighbours(layers: &mut Layers, row: usize, places: &[usize]) {
    let tangle = |left: usize, right: usize| {
        let pairs = |links: &[Vec<usize>]| {
            let one = &links[left];
            let other = &links[right];
            one.iter()
                .flat_map(|a| other.iter().map(move |b| places[*a] > places[*b]))
                .filter(|crossed| *crossed)
                .count()
        };
        pairs(&layers.above) + pairs(&layers.below)
    };
    let mut order = layers.rows[row].clone();
    for place in 1..order.len() {
        let (left, right) = (order[place - 1], order[place]);
        if tangle(right, left) < tangle(left, right) {
            order.swap(place - 1, place);
        }
    }
    layers.rows[row] = order;
}

/// How many pairs of links cross.
fn crossings(layers: &Layers, places: &[usize]) -> usize {
    let between = |row: &Vec<usize>| {
        let links: Vec<(usize, usize)> =
            row.iter().flat_map(|node| layers.below[*node].iter().map(|to| (places[*node], places[*to]))).collect();
        let crossed = |(n, one): (usize, &(usize, usize))| {
            let crosses =
                |other: &&(usize, usize)| (one.0 < other.0 && one.1 > other.1) || (one.0 > other.0 && one.1 < other.1);
            links[n + 1..].iter().filter(crosses).count()
        };
        links.iter().enumerate().map(crossed).sum::<usize>()
    };
    layers.rows.iter().map(between).sum()
}

#[cfg(test)]
mod tests {
    use super::super::layers::Doors;
    use super::*;

    #[test]
    fn what_can_be_drawn_without_crossings_is() {
        // Two chains side by side, given crosswise.
        let mut layers = Layers::new(6, &[(0, 3), (1, 2), (2, 5), (3, 4)], Doors::default());
        untangle(&mut layers);
        let mut places = vec![0; 6];
        (0..3).for_each(|row| note_places(&layers, row, &mut places));
        assert_eq!(crossings(&layers, &places), 0);
    }
}
