//! The two images of a stereo pair; a `Side` indexes arrays that hold one element for each of them.

use std::ops::{Index, IndexMut};

use rockface_core::choice;

choice! {
    /// An image of a pair.
    pub enum Side {
        /// The first (left) image.
        First = "first",
        /// The second (right) image.
        Second = "second",
    }
}

impl Side {
    /// Both sides, in the order of the arrays.
    pub const BOTH: [Self; 2] = [Self::First, Self::Second];

    /// The other image of the pair.
    #[inline(always)]
    #[must_use]
    pub fn other(self) -> Self {
        match self {
            Self::First => Self::Second,
            Self::Second => Self::First,
        }
    }

    /// The array that holds `here` for this side and `there` for the other one.
    #[inline(always)]
    pub fn array<T>(self, here: T, there: T) -> [T; 2] {
        match self {
            Self::First => [here, there],
            Self::Second => [there, here],
        }
    }
}

impl<T> Index<Side> for [T; 2] {
    type Output = T;

    #[inline(always)]
    fn index(&self, side: Side) -> &T {
        let [first, second] = self;
        match side {
            Side::First => first,
            Side::Second => second,
        }
    }
}

impl<T> IndexMut<Side> for [T; 2] {
    #[inline(always)]
    fn index_mut(&mut self, side: Side) -> &mut T {
        let [first, second] = self;
        match side {
            Side::First => first,
            Side::Second => second,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrays_are_built_and_indexed_by_side() {
        for (place, side) in Side::BOTH.into_iter().enumerate() {
            let mut values = side.array('h', 't');
            assert_eq!((values[side], values[side.other()]), ('h', 't'));
            assert_eq!((values[place], values[1 - place]), ('h', 't'));
            values[side] = 'x';
            assert_eq!(values[place], 'x');
        }
    }
}
