//! `spgs compare`: metrics of two pictures, or of the pictures of two folders.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use engine::error::{Error, Result};
use engine::file::picture::{self, Alpha};
use engine::image::Image;
use engine::metrics::{Planes, flip};
use serde::Serialize;
use serde_json::json;

use crate::cli::args::{CompareArgs, Global};
use crate::cli::{gpu_session, output, progress};
use crate::report::error_image;
use crate::report::files::create_folder;
use crate::report::scores::{self, AllScores, Scorer};

/// Extensions of pictures in a folder.
const EXTENSIONS: [&str; 4] = ["png", "jpg", "jpeg", "exr"];

/// A reference and what is compared with it.
#[derive(Debug, Clone)]
struct Pair {
    name: String,
    reference: PathBuf,
    test: PathBuf,
}

/// Scores of one pair.
#[derive(Debug, Serialize)]
struct PairScores {
    name: String,
    width: usize,
    height: usize,
    #[serde(flatten)]
    scores: AllScores,
}

/// Compares, prints, and writes the error images last: a mistake in the last picture leaves nothing behind.
pub fn run(args: &CompareArgs, global: &Global) -> Result<()> {
    let (pairs, folders) = pairs(args)?;
    let weights = scores::read_weights(&args.lpips_weights)?;
    let gpu = if args.lpips_weights.is_empty() { None } else { Some(gpu_session::open(global)?) };
    let scorer = Scorer::new(gpu.as_ref(), &weights)?;
    let bar = progress::bar(pairs.len() as u64, global.quiet || args.json);
    let mut all = Vec::with_capacity(pairs.len());
    for pair in &pairs {
        let (reference, test) = read_pair(pair, args.background)?;
        let (scores, _) = scorer.score(&reference, &test)?;
        all.push(PairScores { name: pair.name.clone(), width: reference.width, height: reference.height, scores });
        bar.inc(1);
    }
    bar.finish_and_clear();
    if let Some(gpu) = &gpu {
        gpu_session::report_validation(gpu);
    }
    if let Some(out) = &args.out {
        write_errors(out, &pairs, args.background)?;
    }
    report(args, &all, &scores::notes(&weights, &all.iter().map(|p| p.scores).collect::<Vec<_>>()), folders)
}

fn report(args: &CompareArgs, all: &[PairScores], notes: &[String], folders: bool) -> Result<()> {
    let list: Vec<AllScores> = all.iter().map(|p| p.scores).collect();
    let mean = AllScores::mean(&list);
    if args.json {
        let mut record = json!({ "reference": args.reference, "test": args.test });
        let extra = match all {
            [one] if !folders => json!(one),
            _ => json!({ "images": all, "mean": mean }),
        };
        if let (Some(record), serde_json::Value::Object(extra)) = (record.as_object_mut(), extra) {
            record.extend(extra);
            record.insert("notes".into(), json!(notes));
        }
        return output::json(&record);
    }
    let width = all.iter().map(|p| p.name.chars().count()).max().unwrap_or(0).max(4);
    output::line(&scores::header(width));
    all.iter().for_each(|p| output::line(&scores::line(&p.name, width, &p.scores)));
    if let (Some(mean), true) = (mean, folders) {
        output::line(&scores::line("mean", width, &mean));
    }
    notes.iter().for_each(|n| output::line(n));
    Ok(())
}

/// What is compared with what, and whether folders were given.
fn pairs(args: &CompareArgs) -> Result<(Vec<Pair>, bool)> {
    let is_folder = |path: &Path| std::fs::metadata(path).map(|m| m.is_dir()).map_err(|e| Error::io(path, "open", e));
    match [is_folder(&args.reference)?, is_folder(&args.test)?] {
        [false, false] => {
            let name = args.test.file_stem().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
            Ok((vec![Pair { name, reference: args.reference.clone(), test: args.test.clone() }], false))
        }
        [true, true] => Ok((folder_pairs(&args.reference, &args.test)?, true)),
        [reference_is, _] => {
            let kind = |folder: bool| if folder { "a folder" } else { "an image" };
            Err(Error::corrupt(&args.test, "what to compare", kind(!reference_is), kind(reference_is)))
        }
    }
}

/// Pictures of the same name, whatever their format.
fn folder_pairs(reference: &Path, test: &Path) -> Result<Vec<Pair>> {
    let (references, tests) = (pictures(reference)?, pictures(test)?);
    for (folder, here, there) in [(test, &tests, &references), (reference, &references, &tests)] {
        let missing: Vec<&str> = there.keys().filter(|n| !here.contains_key(*n)).map(String::as_str).collect();
        if let Some(first) = missing.first() {
            let found = format!("{} of the {} images, not `{first}`", there.len() - missing.len(), there.len());
            return Err(Error::corrupt(folder, "images", found, "an image of every name in the other folder"));
        }
    }
    let pair = |((name, reference), (_, test))| Pair { name, reference, test };
    Ok(references.into_iter().zip(tests).map(pair).collect())
}

/// Pictures of a folder by name without extension; at least one.
fn pictures(folder: &Path) -> Result<BTreeMap<String, PathBuf>> {
    let mut found = BTreeMap::new();
    for entry in std::fs::read_dir(folder).map_err(|e| Error::io(folder, "list", e))? {
        let path = entry.map_err(|e| Error::io(folder, "list", e))?.path();
        let extension = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
        let (Some(extension), Some(stem)) = (extension, path.file_stem()) else { continue };
        if EXTENSIONS.contains(&extension.as_str()) && path.is_file() {
            let name = stem.to_string_lossy().into_owned();
            if let Some(other) = found.insert(name.clone(), path.clone()) {
                let names = format!("{} and {}", other.display(), path.display());
                return Err(Error::corrupt(folder, format!("image `{name}`"), names, "one image of each name"));
            }
        }
    }
    if found.is_empty() {
        return Err(Error::corrupt(folder, "images", "none", "at least one .png, .jpg or .exr"));
    }
    Ok(found)
}

fn read_pair(pair: &Pair, background: [f32; 3]) -> Result<(Planes, Planes)> {
    let (reference, test) = (read(&pair.reference, background)?, read(&pair.test, background)?);
    if [reference.width, reference.height] != [test.width, test.height] {
        let size = |p: &Planes| format!("{} x {} pixels", p.width, p.height);
        let expected = format!("{} as in {}", size(&reference), pair.reference.display());
        return Err(Error::corrupt(&pair.test, "image size", size(&test), expected));
    }
    Ok((reference, test))
}

/// A picture over the background; EXR has its background in its colours already.
fn read(path: &Path, background: [f32; 3]) -> Result<Planes> {
    let mut image = picture::read(path)?;
    if !path.extension().is_some_and(|e| e.eq_ignore_ascii_case("exr")) {
        over(&mut image, background);
    }
    Planes::clamped(&image).map_err(|error| match error {
        Error::NonFinite { index, value, .. } => {
            let (pixel, channel) = (index / 4, ["R", "G", "B", "A"][index % 4]);
            let at = format!("pixel ({}, {})", pixel % image.width as usize, pixel / image.width as usize);
            Error::corrupt(path, at, format!("{channel} = {value}"), "finite values")
        }
        other => other,
    })
}

fn over(image: &mut Image, background: [f32; 3]) {
    for pixel in image.rgba.chunks_exact_mut(4).filter(|p| p[3] < 1.0) {
        let alpha = pixel[3];
        for (value, behind) in pixel[..3].iter_mut().zip(background) {
            *value = *value * alpha + (1.0 - alpha) * behind;
        }
    }
}

/// Writes the map of FLIP of each pair: to a file for one pair and a name ending in `.png`, else into a folder, with the
/// absolute differences.
fn write_errors(out: &Path, pairs: &[Pair], background: [f32; 3]) -> Result<()> {
    let single = out.extension().is_some_and(|e| e.eq_ignore_ascii_case("png"));
    if single && pairs.len() > 1 {
        return Err(Error::usage("--out", out.display().to_string(), "a folder, for the images of two folders"));
    }
    if !single {
        create_folder(out)?;
    }
    for pair in pairs {
        let (reference, test) = read_pair(pair, background)?;
        let map = flip(&reference, &test, engine::metrics::PIXELS_PER_DEGREE)?;
        if single {
            picture::write_png(out, &error_image::flip(&map), Alpha::Drop)?;
        } else {
            let file = |kind: &str| out.join(format!("{}_{kind}.png", pair.name));
            picture::write_png(&file("flip"), &error_image::flip(&map), Alpha::Drop)?;
            picture::write_png(&file("error"), &error_image::absolute(&reference, &test), Alpha::Drop)?;
        }
    }
    Ok(())
}
