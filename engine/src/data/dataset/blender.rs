//! NeRF `transforms*.json`: D-NeRF's folder of splits, and the single file of nerfstudio and instant-ngp.

use std::path::{Path, PathBuf};

use super::views::Stored;
use super::{DatasetKind, DatasetOptions, Posed, Source, SplitRule};
use crate::data::json;
use crate::data::{LLFF_HOLD, transforms};
use crate::error::{Error, Result};

/// `transforms_train.json`, `transforms_test.json` and `transforms_val.json`; all but the first may be absent.
pub(super) fn read_splits(folder: &Path, options: &DatasetOptions) -> Result<Source> {
    if !matches!(options.split, SplitRule::Auto | SplitRule::Lists) {
        return Err(Error::usage("split rule of transforms_*.json", format!("{:?}", options.split), "auto or lists"));
    }
    let mut decisions = Vec::new();
    let mut split = |name: &str| -> Result<Vec<Posed>> {
        let path = folder.join(format!("transforms_{name}.json"));
        if name != "train" && !path.is_file() {
            decisions.push(format!("no transforms_{name}.json"));
            return Ok(Vec::new());
        }
        let file = transforms::frames(&json::text(&path)?, &path, None)?;
        decisions.extend(file.assumed);
        file.frames.into_iter().map(|frame| posed(&path, frame)).collect()
    };
    let (train, test, val) = (split("train")?, split("test")?, split("val")?);
    Ok(Source { kind: DatasetKind::Blender, train, test, val, points: None, default_downscale: 1, decisions })
}

/// One `transforms.json`. Auto split: nerfstudio's `train_filenames`, `test_filenames`, `val_filenames` when given, else
/// every 8th frame is a test frame.
pub(super) fn read_single(folder: &Path, options: &DatasetOptions) -> Result<Source> {
    let path = folder.join("transforms.json");
    let file = transforms::frames(&json::text(&path)?, &path, None)?;
    let mut decisions = file.assumed;
    let lists = ["train_filenames", "test_filenames", "val_filenames"].map(|key| names(&file.top, key));
    let has_lists = lists[0].as_ref().is_some_and(|l| !l.is_empty());
    let rule = match options.split {
        SplitRule::Auto if has_lists => SplitRule::Lists,
        SplitRule::Auto => SplitRule::Hold(LLFF_HOLD),
        SplitRule::Lists if !has_lists => {
            return Err(Error::corrupt(&path, "key `train_filenames`", "nothing", "a list of file names"));
        }
        rule => rule,
    };
    let (mut train, mut test, mut val) = (Vec::new(), Vec::new(), Vec::new());
    for (i, frame) in file.frames.into_iter().enumerate() {
        let listed = |list: usize| lists[list].as_ref().is_some_and(|l| l.contains(&frame.name));
        let to = match rule {
            SplitRule::Lists => [&mut train, &mut test, &mut val].into_iter().zip(0..).find(|(_, l)| listed(*l)),
            _ => match rule.place(i) {
                Some(true) => Some((&mut train, 0)),
                Some(false) => Some((&mut test, 1)),
                None => None,
            },
        };
        if let Some((split, _)) = to {
            split.push(posed(&path, frame)?);
        }
    }
    decisions.push(rule.describe());
    Ok(Source { kind: DatasetKind::Nerfstudio, train, test, val, points: None, default_downscale: 1, decisions })
}

fn names(top: &json::Keys, key: &str) -> Option<Vec<String>> {
    let list = top.get(key)?.as_array()?;
    Some(list.iter().filter_map(|v| v.as_str().map(str::to_owned)).collect())
}

fn posed(camera_file: &Path, frame: crate::data::frame::Frame) -> Result<Posed> {
    let folder = camera_file.parent().unwrap_or(Path::new(""));
    let Some(path) = transforms::find_image(camera_file, &frame.name) else {
        let missing = std::io::Error::from(std::io::ErrorKind::NotFound);
        let mut name = folder.join(&frame.name).into_os_string();
        name.push("{,.png,.jpg,.jpeg}");
        return Err(Error::io(Path::new(&name), "open image", missing));
    };
    let mask = frame.mask.as_ref().map(|m| folder.join(m)).or_else(|| beside(&path));
    Ok(Posed { frame, image: Stored { path, factor: 1, mask } })
}

/// `masks/NAME` beside the picture.
fn beside(picture: &Path) -> Option<PathBuf> {
    Some(picture.parent()?.join("masks").join(picture.file_name()?)).filter(|p| p.is_file())
}
