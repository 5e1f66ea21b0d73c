//! Elementary functions that give the same bits on every machine: the platform's own differ in the last digit.

pub use libm::{acos, asin, atan, atan2, cbrt, cos, erfc, exp, lgamma, log, log10, pow, sin, sincos, tan};
