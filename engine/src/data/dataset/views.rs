//! From posed frames to views: which stored picture, which camera, what was decided.

use std::path::PathBuf;

use glam::DVec3;
use rayon::prelude::*;

use super::{Dataset, DatasetKind, DatasetOptions, Posed, Source, TimeRule, View};
use crate::data::pixels::{self, ImageSource, MaskColour};
use crate::error::{Error, Result};

/// Largest downscale: pictures of at most 16,384 pixels a side keep some.
const MAX_DOWNSCALE: u32 = 64;

/// The stored picture of a frame.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Stored {
    /// The file, or where it was expected.
    pub(super) path: PathBuf,
    /// The folder's pictures are this many times smaller than the camera file says.
    pub(super) factor: u32,
    /// Mask picture.
    pub(super) mask: Option<PathBuf>,
}

/// Which of the stored sizes (1 for full size) serves a wanted downscale: the largest that divides it, else the largest
/// below it.
pub(super) fn stored_factor(available: &[u32], wanted: u32) -> Option<u32> {
    let usable = || available.iter().copied().filter(|&k| k >= 1 && k <= wanted);
    usable().filter(|k| wanted.is_multiple_of(*k)).max().or_else(|| usable().max())
}

/// The downscale that the options ask for, or the format's.
pub(super) fn downscale(options: &DatasetOptions, default: u32) -> Result<u32> {
    match options.downscale.unwrap_or(default) {
        k if (1..=MAX_DOWNSCALE).contains(&k) => Ok(k),
        k => Err(Error::usage("downscale", k.to_string(), format!("1 to {MAX_DOWNSCALE}"))),
    }
}

pub(super) fn dataset(source: Source, options: &DatasetOptions) -> Result<Dataset> {
    let downscale = downscale(options, source.default_downscale)?;
    let views = |posed: &[Posed]| -> Result<Vec<View>> {
        let all: Vec<Result<View>> = posed.par_iter().map(|p| view(p, downscale, source.kind, options)).collect();
        // The first error in the order of the frames, whichever thread was first.
        all.into_iter().collect()
    };
    let (train, test, val) = (views(&source.train)?, views(&source.test)?, views(&source.val)?);
    if train.is_empty() {
        return Err(Error::usage("training views", "none", "at least one"));
    }
    let times = || train.iter().map(|v| v.time);
    let time_range = [times().fold(f64::INFINITY, f64::min), times().fold(f64::NEG_INFINITY, f64::max)];
    let mut dataset = Dataset {
        kind: source.kind,
        extent: extent(&train),
        is_static: time_range[0] == time_range[1],
        time_range,
        downscale,
        decisions: Vec::new(),
        points: source.points,
        train,
        test,
        val,
    };
    dataset.decisions = decisions(&dataset, source.decisions, options);
    Ok(dataset)
}

/// Size after a downscale, rounded.
pub(super) fn scaled(size: [u32; 2], downscale: u32) -> [u32; 2] {
    size.map(|side| ((side + downscale / 2) / downscale).max(1))
}

fn view(posed: &Posed, downscale: u32, kind: DatasetKind, options: &DatasetOptions) -> Result<View> {
    let (frame, image) = (&posed.frame, &posed.image);
    let stored = pixels::dimensions(&image.path)?;
    let factor = image.factor.max(1);
    let fits = |side: u32, full: u32| {
        let exact = f64::from(full) / f64::from(factor);
        if factor == 1 { side == full } else { (f64::from(side) - exact).abs() <= 1.0 }
    };
    if !(fits(stored[0], frame.size[0]) && fits(stored[1], frame.size[1])) {
        let [w, h] = frame.size;
        let of = if factor == 1 { String::new() } else { format!(" divided by {factor}") };
        let expected = format!("the {w} x {h} pixels of its camera{of}");
        let found = format!("{} x {} pixels", stored[0], stored[1]);
        return Err(Error::corrupt(&image.path, "image size", found, expected));
    }
    let size = scaled(frame.size, downscale);
    let scale = |i: usize| f64::from(stored[i]) / f64::from(frame.size[i]);
    let lens = (!frame.lens.is_pinhole()).then(|| frame.lens.scaled(scale(0), scale(1)));
    let mut camera = frame.pinhole().resized(size[0], size[1]);
    if options.time == TimeRule::Static {
        camera.time = 0.0;
    }
    let used = options.masks.used(kind).filter(|_| image.mask.is_some());
    let image = ImageSource { path: image.path.clone(), stored, size, lens, mask: image.mask.clone(), used };
    Ok(View { name: frame.name.clone(), time: camera.time, camera, image })
}

/// 1.1 × the largest distance of a camera centre from their mean.
fn extent(views: &[View]) -> f64 {
    let mean = views.iter().map(|v| v.camera.position).sum::<DVec3>() / views.len() as f64;
    1.1 * views.iter().map(|v| v.camera.position.distance(mean)).fold(0.0, f64::max)
}

fn decisions(dataset: &Dataset, of_format: Vec<String>, options: &DatasetOptions) -> Vec<String> {
    let mut lines = vec![format!("format: {}", dataset.kind.name())];
    let (train, test, val) = (dataset.train.len(), dataset.test.len(), dataset.val.len());
    lines.push(format!("frames: {train} train, {test} test, {val} val"));
    lines.extend(of_format);
    let [first, last] = dataset.time_range;
    let distinct = distinct_times(&dataset.train);
    lines.push(match (options.time, dataset.is_static) {
        (TimeRule::Static, _) => "time: 0 for all frames, as asked for: trained as a static scene".into(),
        (_, true) => format!("time: all training frames at {first}: trained as a static scene"),
        (_, false) => format!("time: {first} to {last}, {distinct} distinct in training"),
    });
    lines.push(size_line(dataset));
    let all = || dataset.train.iter().chain(&dataset.test).chain(&dataset.val);
    let undistorted = all().filter(|v| v.image.lens.is_some()).count();
    if undistorted > 0 {
        lines.push(format!(
            "undistortion: of {undistorted} of {} images, on load (focal lengths and principal point kept{})",
            train + test + val,
            beyond_the_photo(dataset),
        ));
    }
    let masks = all().filter(|v| v.image.mask.is_some()).count();
    if masks > 0 {
        let use_of_them = match options.masks.used(dataset.kind) {
            None => "training does not use them",
            Some(MaskColour::White) => "training leaves out what is black in them",
            Some(MaskColour::Black) => "training leaves out what is white in them",
        };
        lines.push(format!("masks: {masks} of {} images have one; {use_of_them} (data.masks)", train + test + val));
    }
    if dataset.points.is_none() {
        lines.push("points: none in the data set, random ones are used".into());
    }
    lines.push(format!("extent: {:.6} (1.1 × largest distance of a training camera from their mean)", dataset.extent));
    lines
}

fn distinct_times(views: &[View]) -> usize {
    let mut times: Vec<f64> = views.iter().map(|v| v.time).collect();
    times.sort_unstable_by(f64::total_cmp);
    times.dedup();
    times.len()
}

fn size_line(dataset: &Dataset) -> String {
    let Some(first) = dataset.train.first() else { return String::new() };
    let [w, h] = first.image.size;
    let [sw, sh] = first.image.stored;
    let same = dataset.train.iter().chain(&dataset.test).all(|v| v.image.size == first.image.size);
    let others = if same { "" } else { " (first image; sizes differ)" };
    format!("images: {w} x {h}, from stored {sw} x {sh}, downscale {}{others}", dataset.downscale)
}

/// How much of the undistorted pictures the photos do not show.
fn beyond_the_photo(dataset: &Dataset) -> String {
    let worst = dataset.train.iter().filter_map(|v| v.image.share_beyond_the_photo()).fold(0.0, f64::max);
    if worst > 0.0 {
        format!("; up to {:.2} % of an image repeats the photo's edge", 100.0 * worst)
    } else {
        String::new()
    }
}
