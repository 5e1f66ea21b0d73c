//! Disjoint sets of numbers, joined step by step.

/// Disjoint sets of the numbers from 0; the root of a set is its least member, whatever the order of joins.
pub struct UnionFind(Vec<u32>);

impl UnionFind {
    /// Every number by itself.
    pub fn new(count: usize) -> Self {
        Self((0..count as u32).collect())
    }

    /// Sets of vertices that triangles connect.
    pub fn of_triangles<'a>(vertices: usize, triangles: impl IntoIterator<Item = &'a [u32; 3]>) -> Self {
        let mut sets = Self::new(vertices);
        for [a, b, c] in triangles.into_iter().map(|corners| corners.map(|corner| corner as usize)) {
            let root = sets.join(a, b);
            sets.join(root, c);
        }
        sets
    }

    /// The least number of the set a number is in.
    pub fn root(&mut self, number: usize) -> usize {
        let mut at = number;
        while self.0[at] as usize != at {
            self.0[at] = self.0[self.0[at] as usize];
            at = self.0[at] as usize;
        }
        at
    }

    /// Joins the sets of two numbers; returns the root of the union.
    pub fn join(&mut self, a: usize, b: usize) -> usize {
        let (a, b) = (self.root(a), self.root(b));
        self.0[a.max(b)] = a.min(b) as u32;
        a.min(b)
    }

    /// The root of every number.
    pub fn into_roots(mut self) -> Vec<u32> {
        // A root comes before its members, so one pass forward reaches it.
        for number in 0..self.0.len() {
            self.0[number] = self.0[self.0[number] as usize];
        }
        self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn triangles_that_share_a_vertex_are_one_set() {
        let mut sets = UnionFind::of_triangles(9, &[[8, 7, 6], [1, 2, 3], [4, 5, 3]]);
        assert_eq!((0..9).map(|number| sets.root(number)).collect::<Vec<_>>(), [0, 1, 1, 1, 1, 1, 6, 6, 6]);
        assert_eq!(sets.into_roots(), [0, 1, 1, 1, 1, 1, 6, 6, 6]);
    }
}
