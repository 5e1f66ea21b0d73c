//! Three coordinates as a vector, in the few operations blocks need.

/// A point or vector: x, y, z.
pub type V = [f64; 3];

/// Sum.
pub fn add(a: V, b: V) -> V {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

/// Difference.
pub fn sub(a: V, b: V) -> V {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// Product with a number.
pub fn scaled(a: V, factor: f64) -> V {
    a.map(|x| x * factor)
}

/// Scalar product.
pub fn dot(a: V, b: V) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Vector product.
pub fn cross(a: V, b: V) -> V {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// Square of the distance.
pub fn distance_squared(a: V, b: V) -> f64 {
    let d = sub(a, b);
    dot(d, d)
}

/// Product of a matrix, given by its rows, and a vector.
pub fn product(rows: &[V; 3], v: V) -> V {
    rows.map(|row| dot(row, v))
}
