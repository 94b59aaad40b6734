//! What training left out of photos because no other photo shows it, as pictures.

use std::path::Path;

use engine::data::dataset::View;
use engine::error::{Error, Result};
use engine::file::picture::{self, Alpha};
use engine::image::Image;
use engine::train::transients::Transients;

use crate::report::files::create_folder;

/// Writes a mask for each photo that something was left out of, white where it was, removes those of an earlier run in the same
/// folder, and says how much; nothing where photos are believed.
pub(super) fn write(out: &Path, photos: &[View], words: Option<&[u32]>) -> Result<Option<String>> {
    let believed = || Ok(Transients::none(photos.len()));
    let transients = words.map_or_else(believed, |words| Transients::from_words(words, photos.len()))?;
    let folder = out.join("transients");
    if words.is_some() {
        create_folder(&folder)?;
    }
    for i in 0..photos.len() {
        let path = folder.join(format!("{i:05}.png"));
        let Some(([width, height], left_out)) = transients.of_photo(i) else {
            remove(&path)?;
            continue;
        };
        let rgba = left_out.iter().flat_map(|l| [f32::from(u8::from(*l)); 4]).collect();
        let mask = Image { width, height, rgba, depth: Vec::new() };
        picture::write_png(&path, &mask, Alpha::Drop)?;
    }
    let found = transients.found();
    Ok(words.map(|_| {
        format!(
            "transients: {:.2} % of the photos is left out, of {} of {} photos; masks in transients/",
            100.0 * found.share,
            found.photos,
            photos.len()
        )
    }))
}

fn remove(mask: &Path) -> Result<()> {
    match std::fs::remove_file(mask) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => Err(Error::io(mask, "remove", e)),
        _ => Ok(()),
    }
}
