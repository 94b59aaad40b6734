//! First points: `points.npy`, else the scene's COLMAP model, which is also a check of the cameras.

use std::collections::HashMap;
use std::path::Path;

use glam::DVec3;

use super::camera::SceneUnits;
use crate::data::colmap::{self, ModelImage, ModelPoint};
use crate::data::dataset::{Points, Posed};
use crate::data::lens::Lens;
use crate::data::npy;
use crate::error::Result;

/// Grey of points without colour.
const GREY: [u8; 3] = [128; 3];
/// Largest distance of a camera centre from the COLMAP model's, as a share of the cameras' extent, for the model's
/// coordinates to be taken as world units.
const SAME_PLACE: f64 = 0.01;
/// A lens must fit the tracks this much better to take the place of the camera files' lens.
const MUCH_BETTER: f64 = 1.5;

pub(super) fn read(
    folder: &Path,
    scene: &SceneUnits,
    train: &mut [Posed],
    test: &mut [Posed],
    decisions: &mut Vec<String>,
) -> Result<Option<Points>> {
    let path = folder.join("points.npy");
    let mut points = None;
    if path.is_file() {
        let matrix = npy::read(&path, 3)?;
        let place = |row: &[f64]| scene.apply(DVec3::new(row[0], row[1], row[2])).as_vec3().to_array();
        let position: Vec<[f32; 3]> = matrix.rows().map(place).collect();
        decisions.push(format!("points: {} of points.npy, world units (no colours: grey)", position.len()));
        points = Some(Points { colour: vec![GREY; position.len()], position });
    }
    let folders = ["colmap/sparse/0", "colmap/sparse", "colmap", "sparse/0", "sparse"];
    let Some(model) = folders.iter().find_map(|sub| colmap::model_at(&folder.join(sub))) else { return Ok(points) };
    let name = model.strip_prefix(folder).unwrap_or(&model).display().to_string();
    let images = colmap::images(&model)?;
    let Some(model_points) = colmap::points(&model)? else {
        decisions.push(format!("{name}: no points3D file"));
        return Ok(points);
    };
    let Some(fit) = Fit::new(scene, &images, &model_points, train, test) else {
        decisions.push(format!("{name}: ignored, none of its images has the name of a frame"));
        return Ok(points);
    };
    if fit.worst_place > SAME_PLACE {
        let percent = 100.0 * fit.worst_place;
        decisions.push(format!("{name}: ignored, its cameras are up to {percent:.1} % of the extent from the frames'"));
        return Ok(points);
    }
    fit.choose_lens(&name, train, test, decisions);
    if points.is_some() {
        return Ok(points);
    }
    let count = model_points.len();
    decisions.push(format!("points: {count} of {name}, world units (its cameras are where the frames are)"));
    let position = model_points.iter().map(|p| scene.apply(p.position).as_vec3().to_array()).collect();
    Ok(Some(Points { position, colour: model_points.iter().map(|p| p.colour).collect() }))
}

/// How well a COLMAP model and the frames agree.
struct Fit {
    /// Largest distance of a frame's centre from the model's, over the extent of the frames.
    worst_place: f64,
    /// Median distance of tracked points from their pixels, pixels of the model, with the frames' lens.
    frames: f64,
    /// The same with the model's lens.
    model: f64,
    /// The model's lens and image size, if it has one only.
    lens: Option<(Lens, [u32; 2])>,
}

impl Fit {
    fn new(
        scene: &SceneUnits,
        images: &[ModelImage],
        points: &[ModelPoint],
        train: &[Posed],
        test: &[Posed],
    ) -> Option<Self> {
        let stem = |name: &str| Path::new(name).file_stem().map(|s| s.to_string_lossy().into_owned());
        let by_name: HashMap<String, &ModelImage> =
            images.iter().filter_map(|i| Some((stem(&i.frame.name)?, i))).collect();
        let pairs: Vec<(&Posed, &ModelImage)> =
            train.iter().chain(test).filter_map(|p| Some((p, *by_name.get(&p.frame.name)?))).collect();
        let first = pairs.first()?.1;
        let place = |p: &Posed| scene.world(p.frame.position);
        let mean = pairs.iter().map(|(p, _)| place(p)).sum::<DVec3>() / pairs.len() as f64;
        let largest = |distance: &dyn Fn(&(&Posed, &ModelImage)) -> f64| pairs.iter().map(distance).fold(0.0, f64::max);
        let extent = largest(&|(p, _)| place(p).distance(mean)).max(1.0e-9);
        let worst_place = largest(&|(p, i)| place(p).distance(i.frame.position)) / extent;
        let place_of: HashMap<u64, DVec3> = points.iter().map(|p| (p.id, p.position)).collect();
        let one_lens = images.iter().all(|i| i.camera == first.camera) && first.unsupported.is_none();
        let residual = |lens_of: &dyn Fn(&Posed, &ModelImage) -> Lens| {
            let mut distances = Vec::new();
            for (posed, image) in &pairs {
                let lens = lens_of(posed, image);
                for seen in &image.observations {
                    let Some(&point) = place_of.get(&seen.point) else { continue };
                    let local = posed.frame.rotation * (point - place(posed));
                    if local.z > 0.0 {
                        let [u, v] = lens.project(local.x / local.z, local.y / local.z);
                        distances.push((u - seen.pixel[0]).hypot(v - seen.pixel[1]));
                    }
                }
            }
            distances.sort_unstable_by(f64::total_cmp);
            distances.get(distances.len() / 2).copied().unwrap_or(0.0)
        };
        let frames = residual(&|posed, image| {
            let scale = |i: usize| f64::from(image.frame.size[i]) / f64::from(posed.frame.size[i]);
            posed.frame.lens.scaled(scale(0), scale(1))
        });
        let model = residual(&|_, image| image.frame.lens);
        Some(Self { worst_place, frames, model, lens: one_lens.then_some((first.frame.lens, first.frame.size)) })
    }

    /// Takes the model's lens where the camera files' clearly fits its tracks worse: a file that lost a parameter is then
    /// no harm.
    fn choose_lens(&self, name: &str, train: &mut [Posed], test: &mut [Posed], decisions: &mut Vec<String>) {
        let (frames, model) = (self.frames, self.model);
        let measured = format!("median reprojection {frames:.2} px with the lens of camera/*.json, {model:.2} px with");
        match self.lens {
            Some((lens, size)) if frames > MUCH_BETTER * model && frames > 0.5 => {
                for posed in train.iter_mut().chain(test) {
                    let scale = |i: usize| f64::from(posed.frame.size[i]) / f64::from(size[i]);
                    posed.frame.lens = lens.scaled(scale(0), scale(1));
                }
                let [fx, fy] = lens.focal;
                decisions.push(format!("lens: of {name} ({measured} its own; fy/fx {:.4})", fy / fx));
            }
            _ => decisions.push(format!("lens: of camera/*.json ({measured} that of {name})")),
        }
    }
}
