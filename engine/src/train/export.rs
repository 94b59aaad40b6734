//! From a finished run to the model that is played back: it holds what the scene needs, and says what was left out.

use super::bake::{Baked, ROUNDING_SHARE, Views, bake};
use super::parameters::with_sh_degree;
use super::trainer::Trainer;
use crate::error::Result;
use crate::gpu::Gpu;
use crate::render::{RenderOptions, Renderer};
use crate::scene::{Camera, Deformation, Gaussians, MotionSource, Scene, SuperpointDeformation};

/// Smallest α that is drawn: a Gaussian whose opacity is below it shows nowhere.
const MIN_ALPHA: f32 = 1.0 / 255.0;
/// Training cameras through which SH degrees are compared.
const SH_CAMERAS: usize = 12;

/// A model ready to be written.
#[derive(Debug, Clone)]
pub struct Exported {
    /// The model.
    pub scene: Scene,
    /// What it holds and what was left out, one line each, with the measured error.
    pub decisions: Vec<String>,
}

/// Bakes a run's motion and drops what changes nothing visible.
///
/// # Errors
/// Those of the device.
pub fn export(gpu: &Gpu, trainer: &Trainer, cameras: &[Camera]) -> Result<Exported> {
    let config = trainer.config();
    let mut scene = trainer.scene()?;
    let mut decisions = Vec::new();
    drop_invisible(&mut scene, &mut decisions);
    let times = candidate_times(cameras);
    if let (Some(motion), Some(trained)) =
        (trainer.motion_at(&times)?, scene.deformation.superpoint_deformation().cloned())
    {
        let tolerance = config.export.motion_error_px;
        // What no training camera sees keeps its motion, but asks for no key times.
        let views = Views { cameras: cameras.to_vec(), near: f64::from(config.near), everywhere: false };
        let keep = config.export.keep_network;
        let baked = {
            let (superpoints, blend) = (&trained.superpoints, trained.blend.as_ref());
            bake(&mut scene.gaussians, superpoints, blend, &motion, &views, tolerance, !keep)?
        };
        decisions.push(format!(
            "motion table: {} key times of {} candidates; largest error on the training cameras {:.3} px (bound {tolerance} px)",
            baked.deformation.key_times().len(),
            times.len(),
            baked.error_px
        ));
        decisions.extend(soft_superpoints(&baked));
        let all = trained.superpoints.position.len();
        warn_of_idle("superpoints", without_gaussians(&trained), all);
        if !keep {
            decisions.push(format!(
                "superpoints: {} of {}; {} never move and share one or none",
                baked.deformation.superpoint_count(),
                all,
                baked.still
            ));
            decisions.push(
                "left out: network F, association (play-back needs neither; export.keep_network keeps them)".into(),
            );
        }
        if keep && trained.network.is_none() {
            decisions.push("left out: network F, which does not know the path that superpoints follow".into());
        }
        replace_motion(&mut scene, baked.deformation, keep)?;
    }
    drop_sh(gpu, &mut scene, cameras, trainer, &mut decisions)?;
    Ok(Exported { scene, decisions })
}

/// How many superpoints Gaussians move with, and how their weights are kept; nothing where each moves with one.
fn soft_superpoints(baked: &Baked) -> Option<String> {
    let blend = baked.deformation.blend()?;
    let weights = match baked.rounding_px {
        Some(px) => format!("bytes, which moves nothing by more than {px:.3} px"),
        None => format!("floats: rounded to bytes they would take more than {ROUNDING_SHARE} of the motion's bound"),
    };
    let (soft, all) = (blend.soft_count(), blend.len());
    let most = blend.neighbors;
    Some(format!(
        "soft superpoints: {soft} of {all} Gaussians move with more than one, {most} at most; weights as {weights}"
    ))
}

/// Superpoints that no Gaussian moves with.
fn without_gaussians(trained: &SuperpointDeformation) -> usize {
    let mut used = vec![false; trained.superpoints.position.len()];
    let gaussians = trained.superpoints.of_gaussian.len();
    (0..gaussians).flat_map(|i| trained.slots(i)).for_each(|(j, _)| used[j] = true);
    used.iter().filter(|used| !**used).count()
}

/// Says so when more than a tenth of what was trained serves nothing: often a sign of first points where no image sees them.
fn warn_of_idle(what: &str, idle: usize, all: usize) {
    if 10 * idle > all {
        log::warn!(
            "{idle} of {all} {what} serve nothing at the end: are the first points where the images see them (gaussians.random_extent), \
             and is the background theirs (background)?"
        );
    }
}

/// Puts the baked table where the trained motion was. Network G stays; network F and the association if they are to be kept.
fn replace_motion(scene: &mut Scene, mut baked: Deformation, keep: bool) -> Result<()> {
    let nonrigid = scene.deformation.take_nonrigid();
    if let (true, Some(new), Some(trained)) =
        (keep, baked.superpoint_deformation_mut(), scene.deformation.superpoint_deformation_mut())
    {
        (new.network, new.association) = (trained.network.take(), trained.association.take());
    }
    scene.deformation = match nonrigid {
        Some(network) => baked.with_nonrigid(network)?,
        None => baked,
    };
    Ok(())
}

/// The cameras' times and the middles between them.
fn candidate_times(cameras: &[Camera]) -> Vec<f32> {
    let mut times: Vec<f32> = cameras.iter().map(|c| c.time as f32).collect();
    times.sort_by(f32::total_cmp);
    times.dedup();
    let middles: Vec<f32> = times.windows(2).map(|w| w[0].midpoint(w[1])).collect();
    times.extend(middles);
    times.sort_by(f32::total_cmp);
    times.dedup();
    times
}

/// Gaussians with an opacity below 1/255 are drawn nowhere.
fn drop_invisible(scene: &mut Scene, decisions: &mut Vec<String>) {
    let g = &scene.gaussians;
    let shows = |logit: f32| 1.0 / (1.0 + (-logit).exp()) >= MIN_ALPHA;
    let keep: Vec<bool> = g.opacity_logit.iter().map(|&logit| shows(logit)).collect();
    let (before, after) = (g.len(), keep.iter().filter(|k| **k).count());
    if after == before {
        return;
    }
    warn_of_idle("Gaussians", before - after, before);
    decisions.push(format!("left out: {} of {before} Gaussians, with an opacity below 1/255", before - after));
    scene.gaussians.retain(&keep);
    scene.deformation.retain(&keep);
}

/// The lowest SH degree that changes no pixel visibly.
fn drop_sh(
    gpu: &Gpu,
    scene: &mut Scene,
    cameras: &[Camera],
    trainer: &Trainer,
    decisions: &mut Vec<String>,
) -> Result<()> {
    let config = trainer.config();
    let full = scene.gaussians.sh_degree;
    let options = RenderOptions { background: config.background, near: config.near, ..RenderOptions::default() };
    let step = cameras.len().div_ceil(SH_CAMERAS).max(1);
    let sample: Vec<&Camera> = cameras.iter().step_by(step).collect();
    let render = |g: Gaussians, scene: &Scene| -> Result<Vec<Vec<f32>>> {
        let candidate = Scene { gaussians: g, ..scene.clone() };
        let options = RenderOptions { motion: MotionSource::Auto, ..options.clone() };
        let mut renderer = Renderer::new(gpu, &candidate, &options)?;
        sample.iter().map(|c| Ok(renderer.render(c, c.time)?.rgba)).collect()
    };
    if full == 0 || scene.gaussians.is_empty() {
        return Ok(());
    }
    let reference = render(scene.gaussians.clone(), scene)?;
    for degree in 0..full {
        let reduced = with_sh_degree(&scene.gaussians, degree);
        let images = render(reduced.clone(), scene)?;
        let pairs = reference.iter().flatten().zip(images.iter().flatten());
        let largest = pairs.map(|(a, b)| f64::from((a.clamp(0.0, 1.0) - b.clamp(0.0, 1.0)).abs())).fold(0.0, f64::max);
        if largest * 255.0 <= config.export.sh_error {
            decisions.push(format!(
                "left out: SH degrees above {degree} of {full}; largest change of a pixel {:.3}/255",
                largest * 255.0
            ));
            scene.gaussians = reduced;
            return Ok(());
        }
    }
    decisions
        .push(format!("SH degree {full}: every lower one changes a pixel by more than {}/255", config.export.sh_error));
    Ok(())
}
