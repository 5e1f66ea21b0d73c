//! The parameter `window_m` that many stages have: a rectangle in the plane of the wall.

use rockface_core::params::Fault;

/// What is wrong with a window (left, right, bottom, top), metres, as the fault of a parameter `window_m`.
pub fn faults(window_m: Option<[f64; 4]>) -> Vec<Fault> {
    match window_m {
        Some([left, right, bottom, top]) if !(left < right && bottom < top) => {
            let text = format!("[{left}, {right}, {bottom}, {top}] is empty; the order is left, right, bottom, top");
            vec![Fault { path: vec!["window_m".into()], ..Fault::new(text) }]
        }
        _ => Vec::new(),
    }
}
