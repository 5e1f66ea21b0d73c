//! The parts that come with the program: chains of steps that pipelines use by name.

use rockface_core::PartText;

macro_rules! parts {
    ($($name:literal),* $(,)?) => {
        /// Every part, in the order of the catalogue.
        pub static PARTS: &[PartText] = &[
            $(PartText {
                name: concat!("rockface/", $name),
                text: include_str!(concat!("../../pipelines/parts/", $name, ".yaml")),
            }),*
        ];
    };
}

parts![
    "stereo-site",
    "synthetic-site",
    "references",
    "stereo-survey",
    "multi-image-survey",
    "registered-difference",
    "no-change",
    "filtered-no-change",
    "verdict",
    "calibrated-site",
    "detection-benchmark",
    "hunter-valley-site",
    "paper-replicate",
    "paper-search",
    "event-replica",
];
