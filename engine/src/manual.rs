//! The engine's pages of the manual. Their one source is `engine/docs/*.md`: read on the web, here, and with
//! `spgs help TOPIC`. The pages about the programs are in `tools/docs`.

/// A page of the manual.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Page {
    /// What `spgs help` calls it; also the name of its file without `.md`.
    pub topic: &'static str,
    /// The page, in Markdown.
    pub text: &'static str,
}

impl Page {
    /// The text of its first heading.
    pub fn title(&self) -> &'static str {
        self.text.lines().next().unwrap_or_default().trim_start_matches('#').trim()
    }
}

/// The engine's pages, in reading order.
pub const PAGES: &[Page] = &[
    Page { topic: "image", text: include_str!("../docs/image.md") },
    Page { topic: "model-file", text: include_str!("../docs/model-file.md") },
    Page { topic: "formats", text: include_str!("../docs/formats.md") },
    Page { topic: "data", text: include_str!("../docs/data.md") },
    Page { topic: "metrics", text: include_str!("../docs/metrics.md") },
    Page { topic: "embedding", text: include_str!("../docs/embedding.md") },
    Page { topic: "limits", text: include_str!("../docs/limits.md") },
];

// A page ends with link targets for the web. Those in front of it are for rustdoc: of two targets the first one counts.

pub mod image {
    //! [metrics]: super::metrics
    //! [quality]: ../../../tools/manual/quality/index.html
    #![doc = include_str!("../docs/image.md")]
}

pub mod model_file {
    //! [formats]: super::formats
    #![doc = include_str!("../docs/model-file.md")]
}

pub mod formats {
    //! [model-file]: super::model_file
    //! [limits]: super::limits
    #![doc = include_str!("../docs/formats.md")]
}

pub mod data {
    //! [training]: ../../../tools/manual/training/index.html
    #![doc = include_str!("../docs/data.md")]
}

pub mod metrics {
    //! [image]: super::image
    #![doc = include_str!("../docs/metrics.md")]
}

pub mod embedding {
    //! [drivers]: ../../../tools/manual/drivers/index.html
    #![doc = include_str!("../docs/embedding.md")]
}

pub mod limits {
    //! [drivers]: ../../../tools/manual/drivers/index.html
    //! [formats]: super::formats
    #![doc = include_str!("../docs/limits.md")]
}
