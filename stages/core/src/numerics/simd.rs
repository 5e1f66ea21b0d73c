//! Numbers worked on several at a time, in the wider registers of processors that have them.
//!
//! Every lane goes through the same operations in the same order as a single number would, each rounded by itself, so the
//! bits are those of the scalar formula on any processor. What a lane has no value for is NaN.

use std::ops::{Add, Div, Index, Mul, Neg, Sub};

/// Lanes of a block of pixels.
pub const LANES: usize = 8;

/// Work that gains from wide registers. No closure, since those cannot say `#[inline(always)]`, as [`Work::run`] must.
pub trait Work {
    /// What [`Work::run`] returns.
    type Output;

    /// Does the work. Implementations say `#[inline(always)]`, so that wide registers are used.
    fn run(self) -> Self::Output;

    /// Does the same work where a register holds eight numbers, for what is cut to the width of registers.
    #[inline(always)]
    fn run_wide(self) -> Self::Output
    where
        Self: Sized,
    {
        self.run()
    }
}

/// Runs some work compiled for the widest registers there are. Only what is inlined into it is: functions on [`Lanes`] say
/// `#[inline(always)]`.
#[inline(always)]
pub fn vectorised<W: Work>(work: W) -> W::Output {
    pulp::Arch::new().dispatch(Dispatched(work))
}

struct Dispatched<W>(W);

impl<W: Work> pulp::WithSimd for Dispatched<W> {
    type Output = W::Output;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) -> W::Output {
        if S::F64_LANES >= 8 { self.0.run_wide() } else { self.0.run() }
    }
}

/// A function of both of two things; unlike the `map` of arrays it is always inlined.
#[inline(always)]
pub fn both<T, U>([one, other]: [T; 2], f: impl Fn(T) -> U) -> [U; 2] {
    [f(one), f(other)]
}

/// What formulas are written for: a number, or several.
pub trait Number:
    Copy
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + Add<f64, Output = Self>
    + Sub<f64, Output = Self>
    + Mul<f64, Output = Self>
    + Div<f64, Output = Self>
{
    /// The square root; of several numbers, that of each.
    #[must_use]
    fn sqrt(self) -> Self;

    /// One over the number.
    #[must_use]
    fn recip(self) -> Self;

    /// The larger of two numbers.
    #[must_use]
    fn at_least(self, least: Self) -> Self;

    /// The smaller of a number and a bound.
    #[must_use]
    fn at_most(self, most: f64) -> Self;
}

impl Number for f64 {
    #[inline(always)]
    fn sqrt(self) -> Self {
        self.sqrt()
    }

    #[inline(always)]
    fn recip(self) -> Self {
        self.recip()
    }

    #[inline(always)]
    fn at_least(self, least: Self) -> Self {
        if self < least { least } else { self }
    }

    #[inline(always)]
    fn at_most(self, most: f64) -> Self {
        if self > most { most } else { self }
    }
}

/// `N` numbers that go through a formula together.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(align(16))]
pub struct Lanes<const N: usize = LANES>([f64; N]);

impl<const N: usize> Number for Lanes<N> {
    #[inline(always)]
    fn sqrt(self) -> Self {
        self.map(f64::sqrt)
    }

    #[inline(always)]
    fn recip(self) -> Self {
        self.map(f64::recip)
    }

    #[inline(always)]
    fn at_least(self, least: Self) -> Self {
        self.with(least, Number::at_least)
    }

    #[inline(always)]
    fn at_most(self, most: f64) -> Self {
        self.map(|number| number.at_most(most))
    }
}

impl<const N: usize> Lanes<N> {
    /// Lanes without a value.
    pub const NONE: Self = Self([f64::NAN; N]);

    /// The same number in all lanes.
    #[inline(always)]
    pub fn all(value: f64) -> Self {
        Self([value; N])
    }

    /// Lane `i` has the number of `i`.
    #[inline(always)]
    pub fn of(mut value: impl FnMut(usize) -> f64) -> Self {
        let mut lanes = [0.0; N];
        for (i, lane) in lanes.iter_mut().enumerate() {
            *lane = value(i);
        }
        Self(lanes)
    }

    /// The first numbers of a list; lanes beyond its end have no value.
    #[inline(always)]
    pub fn first_of(values: &[f64]) -> Self {
        if let Some(values) = values.first_chunk() {
            return Self(*values);
        }
        Self::of(|lane| values.get(lane).copied().unwrap_or(f64::NAN))
    }

    /// Lane `i` has the whole number of `i`, which must be below 2^52.
    #[inline(always)]
    pub fn of_whole(mut value: impl FnMut(usize) -> u64) -> Self {
        // Taken as the mantissa of 2^52 it is that number more than 2^52.
        Self::of(|i| f64::from_bits((0x433 << 52) | value(i)) - 4_503_599_627_370_496.0)
    }

    /// The numbers of `yes` where a condition holds, elsewhere those of `no`.
    #[inline(always)]
    #[must_use]
    pub fn choose(self, condition: impl Fn(f64) -> bool, yes: Self, no: Self) -> Self {
        Self::of(|i| if condition(self.0[i]) { yes.0[i] } else { no.0[i] })
    }

    /// A function of the numbers, lane by lane.
    #[inline(always)]
    #[must_use]
    pub fn map(self, f: impl Fn(f64) -> f64) -> Self {
        Self::of(|i| f(self.0[i]))
    }

    /// A function of two numbers, lane by lane.
    #[inline(always)]
    #[must_use]
    pub fn with(self, other: Self, f: impl Fn(f64, f64) -> f64) -> Self {
        Self::of(|i| f(self.0[i], other.0[i]))
    }

    /// These numbers where those of `measure` are below a bound, elsewhere none.
    #[inline(always)]
    #[must_use]
    pub fn where_below(self, measure: Self, bound: f64) -> Self {
        self.with(measure, |value, measure| if measure < bound { value } else { f64::NAN })
    }

    /// These numbers where those of `measure` are positive, elsewhere none.
    #[inline(always)]
    #[must_use]
    pub fn where_positive(self, measure: Self) -> Self {
        self.with(measure, |value, measure| if measure > 0.0 { value } else { f64::NAN })
    }

    /// Whether a condition holds in every lane; all are looked at, without a branch for each.
    #[inline(always)]
    #[must_use]
    pub fn every(self, condition: impl Fn(f64) -> bool) -> bool {
        let mut every = true;
        for lane in self.0 {
            every &= condition(lane);
        }
        every
    }

    /// Replaces the number in one lane.
    #[inline(always)]
    pub fn set(&mut self, lane: usize, value: f64) {
        self.0[lane] = value;
    }

    /// The numbers rounded to 32 bits, in the order of the lanes.
    #[inline(always)]
    pub fn narrowed(self) -> [f32; N] {
        let mut narrowed = [0.0; N];
        for (lane, narrowed) in narrowed.iter_mut().enumerate() {
            *narrowed = self.0[lane] as f32;
        }
        narrowed
    }

    /// The numbers in the order of the lanes.
    #[inline(always)]
    pub fn each(self) -> [f64; N] {
        self.0
    }
}

impl<const N: usize> From<[f64; N]> for Lanes<N> {
    #[inline(always)]
    fn from(values: [f64; N]) -> Self {
        Self(values)
    }
}

impl<const N: usize> Index<usize> for Lanes<N> {
    type Output = f64;

    #[inline(always)]
    fn index(&self, lane: usize) -> &f64 {
        &self.0[lane]
    }
}

impl<const N: usize> Neg for Lanes<N> {
    type Output = Self;

    #[inline(always)]
    fn neg(self) -> Self {
        self.map(|a| -a)
    }
}

macro_rules! operator {
    ($name:ident, $method:ident, $op:tt) => {
        impl<const N: usize> $name for Lanes<N> {
            type Output = Self;

            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                self.with(other, |a, b| a $op b)
            }
        }

        impl<const N: usize> $name<f64> for Lanes<N> {
            type Output = Self;

            #[inline(always)]
            fn $method(self, other: f64) -> Self {
                self.map(|a| a $op other)
            }
        }
    };
}

operator!(Add, add, +);
operator!(Sub, sub, -);
operator!(Mul, mul, *);
operator!(Div, div, /);

#[cfg(test)]
#[allow(clippy::float_cmp)] // to the bit
mod tests {
    use super::*;

    fn polynomial<T: Number>(x: T, y: T) -> T {
        (x * 0.3 + y) * x - (-y) / (x * x + 1.5) + 0.1
    }

    struct Polynomial([Lanes; 2]);

    impl Work for Polynomial {
        type Output = Lanes;

        #[inline(always)]
        fn run(self) -> Lanes {
            polynomial(self.0[0], self.0[1])
        }
    }

    #[test]
    fn lanes_have_the_bits_of_single_numbers() {
        let x = Lanes::<LANES>::of(|i| 0.37 * i as f64 - 1.1);
        let y = x.map(|x| x * x - 0.7);
        let found = vectorised(Polynomial([x, y]));
        for lane in 0..LANES {
            assert_eq!(found[lane].to_bits(), polynomial(x[lane], y[lane]).to_bits());
        }
    }

    #[test]
    fn what_fails_a_condition_has_no_value() {
        let x = Lanes::from([-1.0, 0.0, 1.0, f64::NAN]);
        assert_eq!(x.where_positive(x).each().map(f64::is_nan), [true, true, false, true]);
        assert_eq!(x.where_below(x, 0.5).each().map(f64::is_nan), [false, false, true, true]);
    }
}
