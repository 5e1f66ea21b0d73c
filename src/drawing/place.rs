//! Where each node stands: under what it is linked to, as far as the others of its row leave room.

use super::layers::Layers;

/// How often the rows are gone through, down and up.
const SWEEPS: usize = 16;
/// Room between two nodes of a row, px.
const GAP_PX: f64 = 26.0;
/// Room between two stand-ins of arrows, px.
const ARROW_GAP_PX: f64 = 14.0;
/// How much more a stand-in insists on its place than a step: long arrows are to be straight.
const ARROW_WEIGHT: f64 = 4.0;

/// The middle of every node, px from the left edge of the leftmost; `widths_px` by node, 0 for stand-ins.
pub fn places_px(layers: &Layers, widths_px: &[f64]) -> Vec<f64> {
    let mut middle_px = vec![0.0; widths_px.len()];
    for row in &layers.rows {
        let mut left = 0.0;
        for node in row {
            middle_px[*node] = left + widths_px[*node] / 2.0;
            left += widths_px[*node] + GAP_PX;
        }
    }
    let count = layers.rows.len();
    for sweep in 0..SWEEPS {
        for step in 0..count {
            let row = if sweep % 2 == 0 { step } else { count - 1 - step };
            settle(layers, row, widths_px, &mut middle_px);
        }
    }
    let left = (0..middle_px.len()).map(|node| middle_px[node] - widths_px[node] / 2.0).fold(f64::INFINITY, f64::min);
    middle_px.iter().map(|middle| middle - left.min(f64::MAX)).collect()
}

/// Moves the nodes of a row as near to the mean of their links as the room between them allows.
fn settle(layers: &Layers, row: usize, widths_px: &[f64], middle_px: &mut [f64]) {
    let nodes = &layers.rows[row];
    let mut offset = 0.0;
    let mut offsets = Vec::with_capacity(nodes.len());
    let mut wishes = Vec::with_capacity(nodes.len());
    for (place, node) in nodes.iter().enumerate() {
        if place > 0 {
            offset += room_px(nodes[place - 1], *node, widths_px);
        }
        let links: Vec<usize> = layers.above[*node].iter().chain(&layers.below[*node]).copied().collect();
        let sum: f64 = links.iter().map(|link| middle_px[*link]).sum();
        let wish = if links.is_empty() { middle_px[*node] } else { sum / links.len() as f64 };
        let weight = if widths_px[*node] == 0.0 { ARROW_WEIGHT } else { 1.0 };
        offsets.push(offset);
        wishes.push((wish - offset, weight));
    }
    for ((node, place), offset) in nodes.iter().zip(ascending(&wishes)).zip(offsets) {
        middle_px[*node] = place + offset;
    }
}

fn room_px(left: usize, right: usize, widths_px: &[f64]) -> f64 {
    let stand_ins = widths_px[left] == 0.0 && widths_px[right] == 0.0;
    let gap_px = if stand_ins { ARROW_GAP_PX } else { GAP_PX };
    f64::midpoint(widths_px[left], widths_px[right]) + gap_px
}

/// The ascending values that are nearest to the wished ones in the sense of least weighted squares: neighbours out of
/// order are put together at their mean until none is.
fn ascending(wishes: &[(f64, f64)]) -> Vec<f64> {
    let mut blocks: Vec<(f64, f64, usize)> = Vec::new();
    for (wish, weight) in wishes {
        let mut block = (*wish, *weight, 1);
        while let Some(last) = blocks.last().copied().filter(|last| last.0 > block.0) {
            blocks.pop();
            let weight = last.1 + block.1;
            block = ((last.0 * last.1 + block.0 * block.1) / weight, weight, last.2 + block.2);
        }
        blocks.push(block);
    }
    blocks.into_iter().flat_map(|(value, _, count)| std::iter::repeat_n(value, count)).collect()
}

#[cfg(test)]
mod tests {
    use super::super::layers::Doors;
    use super::*;

    #[test]
    fn values_out_of_order_meet_at_their_mean() {
        let found = ascending(&[(1.0, 1.0), (4.0, 1.0), (2.0, 3.0), (9.0, 1.0)]);
        let differs = |(found, wanted): (&f64, f64)| (found - wanted).abs() > 1e-12;
        assert!(!found.iter().zip([1.0, 2.5, 2.5, 9.0]).any(differs), "{found:?}");
    }

    #[test]
    fn nodes_of_a_row_keep_their_distance_and_a_chain_is_straight() {
        let layers = Layers::new(5, &[(0, 1), (0, 2), (0, 3), (2, 4)], Doors::default());
        let widths = [100.0, 80.0, 60.0, 80.0, 50.0];
        let places = places_px(&layers, &widths);
        for row in &layers.rows {
            for pair in row.windows(2) {
                assert!(places[pair[1]] - places[pair[0]] >= room_px(pair[0], pair[1], &widths) - 1e-9);
            }
        }
        assert!((places[2] - places[4]).abs() < 1.0, "{places:?}");
        assert!((places[0] - places[2]).abs() < 1.0, "{places:?}");
    }
}
