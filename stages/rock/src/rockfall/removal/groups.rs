//! Things that hang together, grouped by a union-find.

/// Disjoint groups of the numbers from 0.
pub struct Groups(Vec<u32>);

impl Groups {
    /// Every number by itself.
    pub fn new(count: usize) -> Self {
        Self((0..count as u32).collect())
    }

    /// Groups of vertices that triangles join.
    pub fn of_triangles<'a>(vertices: usize, triangles: impl IntoIterator<Item = &'a [u32; 3]>) -> Self {
        let mut groups = Self::new(vertices);
        for t in triangles {
            groups.join(t[0], t[1]);
            groups.join(t[1], t[2]);
        }
        groups
    }

    /// The least number of the group a number is in.
    pub fn of(&mut self, mut number: u32) -> u32 {
        while self.0[number as usize] != number {
            let above = self.0[self.0[number as usize] as usize];
            self.0[number as usize] = above;
            number = above;
        }
        number
    }

    /// Makes one group of two.
    pub fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.of(a), self.of(b));
        self.0[a.max(b) as usize] = a.min(b);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn triangles_that_share_a_vertex_are_one_group() {
        let mut groups = Groups::of_triangles(9, &[[8, 7, 6], [1, 2, 3], [4, 5, 3]]);
        assert_eq!((0..9).map(|n| groups.of(n)).collect::<Vec<_>>(), [0, 1, 1, 1, 1, 1, 6, 6, 6]);
    }
}
