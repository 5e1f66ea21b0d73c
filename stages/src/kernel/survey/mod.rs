//! Planning a survey: where images are taken from, and how well they will measure the face.

pub mod face;
pub mod forecast;
pub mod stations;
