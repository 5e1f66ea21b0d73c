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
    "planned-pair",
    "stereo-survey",
    "surveyed-rockfall",
    "multi-image-no-change",
    "multi-image-survey",
    "registered-difference",
    "no-change",
    "filtered-no-change",
    "paper-replicate",
    "calibrated-replicate",
    "matcher-search",
    "verdict",
    "judged-noise",
    "no-change-site",
    "adjusting-round",
    "adjusted-noise",
    "noise-verdict",
    "judged-model",
    "calibrated-site",
    "detection-benchmark",
    "hunter-valley-site",
    "paper-search",
    "event-replica",
];
