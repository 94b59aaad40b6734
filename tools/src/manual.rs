//! The programs' pages of the manual. Their one source is `tools/docs/*.md`: read on the web, here, and with
//! `spgs help TOPIC`. The pages about the engine are in [`engine::manual`].

use engine::manual::Page;

/// The programs' pages, in reading order.
pub const PAGES: &[Page] = &[
    Page { topic: "commands", text: include_str!("../docs/commands.md") },
    Page { topic: "viewer", text: include_str!("../docs/viewer.md") },
    Page { topic: "video", text: include_str!("../docs/video.md") },
    Page { topic: "editing", text: include_str!("../docs/editing.md") },
    Page { topic: "distilling", text: include_str!("../docs/distilling.md") },
    Page { topic: "posing", text: include_str!("../docs/posing.md") },
    Page { topic: "training", text: include_str!("../docs/training.md") },
    Page { topic: "quality", text: include_str!("../docs/quality.md") },
    Page { topic: "measuring", text: include_str!("../docs/measuring.md") },
    Page { topic: "measured", text: include_str!("../docs/measured.md") },
    Page { topic: "drivers", text: include_str!("../docs/drivers.md") },
];

/// Every page of the manual: the programs', then the engine's.
pub fn pages() -> impl Iterator<Item = &'static Page> {
    PAGES.iter().chain(engine::manual::PAGES)
}

// A page ends with link targets for the web. Those in front of it are for rustdoc: of two targets the first one counts.

pub mod commands {
    //! [data]: ../../../engine/manual/data/index.html
    //! [distilling]: super::distilling
    //! [drivers]: super::drivers
    //! [editing]: super::editing
    //! [formats]: ../../../engine/manual/formats/index.html
    //! [measuring]: super::measuring
    //! [metrics]: ../../../engine/manual/metrics/index.html
    //! [posing]: super::posing
    //! [quality]: super::quality
    //! [training]: super::training
    //! [video]: super::video
    //! [viewer]: super::viewer
    #![doc = include_str!("../docs/commands.md")]
}

pub mod viewer {
    //! [drivers]: super::drivers
    //! [editing]: super::editing
    //! [posing]: super::posing
    //! [video]: super::video
    #![doc = include_str!("../docs/viewer.md")]
}

pub mod video {
    //! [viewer]: super::viewer
    #![doc = include_str!("../docs/video.md")]
}

pub mod editing {
    //! [formats]: ../../../engine/manual/formats/index.html
    //! [viewer]: super::viewer
    #![doc = include_str!("../docs/editing.md")]
}

pub mod distilling {
    //! [formats]: ../../../engine/manual/formats/index.html
    #![doc = include_str!("../docs/distilling.md")]
}

pub mod posing {
    //! [data]: ../../../engine/manual/data/index.html
    #![doc = include_str!("../docs/posing.md")]
}

pub mod training {
    //! [data]: ../../../engine/manual/data/index.html
    //! [metrics]: ../../../engine/manual/metrics/index.html
    #![doc = include_str!("../docs/training.md")]
}

pub mod quality {
    //! [image]: ../../../engine/manual/image/index.html
    //! [measuring]: super::measuring
    #![doc = include_str!("../docs/quality.md")]
}

pub mod measuring {
    //! [image]: ../../../engine/manual/image/index.html
    //! [measured]: super::measured
    //! [quality]: super::quality
    #![doc = include_str!("../docs/measuring.md")]
}

pub mod measured {
    //! [measuring]: super::measuring
    #![doc = include_str!("../docs/measured.md")]
}

pub mod drivers {
    //! [embedding]: ../../../engine/manual/embedding/index.html
    #![doc = include_str!("../docs/drivers.md")]
}
