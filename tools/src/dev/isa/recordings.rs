//! Runs of the program, small ones, that between them make every pipeline that it uses: the planners' own list of
//! specialisations, which cannot fall behind them. Nothing is looked at: a device that computes nothing will do.

use engine::error::Result;
use engine::gpu::interface::Constants;
use engine::gpu::{Gpu, Kernel};
use engine::metrics::Planes;
use engine::metrics::lpips::{Lpips, Network, Range, Weights};
use engine::render::blend::{self, BLEND, BlendConstants, Stage};
use engine::render::display::{DisplayMode, DisplayOptions, Screen};
use engine::render::quality::KNOBS;
use engine::render::radix_sort::DeviceSort;
use engine::render::segments::Segments;
use engine::render::{
    PixelFormat, Quality, RenderOptions, Renderer, SceneHandle, SceneOptions, View as EmbeddedView, ViewOptions,
};
use engine::scene::parameter::{LIFESPAN, PARAMETERS};
use engine::scene::synthetic::{moving_scene, random_blend, random_optional, random_scene};
use engine::scene::{Camera, MotionSource, NonrigidNetwork, Scene};
use engine::train::blend_backward::blend_backward_native::BLEND_BACKWARD_NATIVE;
use engine::train::blend_backward::{self, Accumulation, BLEND_BACKWARD, BlendBackwardConstants};
use engine::train::config::{Config, Form, LossConfig};
use engine::train::density::reset_opacity::RESET_OPACITY;
use engine::train::gradient::{GradientOptions, scene_gradients};
use engine::train::trainer::Trainer;

use super::fields;
use crate::bench::train;
use crate::cli::camera;

/// Size of the pictures, pixels.
const SIZE: [u32; 2] = [64, 48];
/// Gaussians, superpoints and key times of the scenes.
const COUNTS: [usize; 3] = [300, 8, 4];
/// Gaussians that are many for so few superpoints: workgroups sum over them.
const MANY: u32 = 900;
/// Superpoints of a Gaussian with soft ones.
const SOFT: usize = 3;
/// Tile instances for which there is no room of one size for each list: they lie one behind the other, as in large images.
const PACKED: u64 = 12 * COUNTS[0] as u64;
/// Keys of sorts with few and with many keys per thread, and of one that needs a spine.
const KEYS: [usize; 3] = [100_000, 200_000, 600_000];

/// A kind of run.
pub type Recording = (&'static str, fn(&Gpu) -> Result<()>);

/// All of them.
pub const RECORDINGS: &[Recording] = &[
    ("kernels without specialisations", plain),
    ("frames", frames),
    ("frames with each knob", knobs),
    ("frames of deformation fields", field_frames),
    ("sorts", sorts),
    ("frames on the screen", screens),
    ("frames in a host's images", embedded),
    ("training", training),
    ("training on large pictures", whole_lists),
    ("opacity resets", opacity_resets),
    ("training of network G", nonrigid_training),
    ("gradients of scenes", gradients),
    ("metrics", metrics),
];

/// What has but the subgroup size is made whether or not a run here gets to it.
fn plain(gpu: &Gpu) -> Result<()> {
    engine::kernels().filter(|k| k.spec.len() == 1).try_for_each(|k| gpu.compile(k, &[]))
}

fn camera(scene: &Scene) -> Camera {
    camera::default_camera(scene, SIZE)
}

fn draw(gpu: &Gpu, scene: &Scene, options: &RenderOptions) -> Result<Renderer> {
    let mut renderer = Renderer::new(gpu, scene, options)?;
    renderer.draw(&camera(scene), 0.5)?;
    Ok(renderer)
}

fn moving() -> Scene {
    let [n, m, t] = COUNTS;
    moving_scene(n, m, t, 1, true)
}

/// Each Gaussian moves with several superpoints.
fn soft(scene: &Scene) -> Scene {
    let mut scene = scene.clone();
    let [n, m, _] = COUNTS;
    if let Some(superpoints) = scene.deformation.superpoint_deformation_mut() {
        let blend = random_blend(n, m, SOFT, 1);
        superpoints.superpoints.of_gaussian = blend.of_gaussian();
        superpoints.blend = Some(blend);
    }
    scene
}

fn frames(gpu: &Gpu) -> Result<()> {
    let moving = moving();
    let deformation = moving.deformation.clone().with_nonrigid(NonrigidNetwork::init(1))?;
    let nonrigid = Scene { deformation, ..moving.clone() };
    for scene in [&moving, &nonrigid] {
        draw(gpu, &soft(scene), &RenderOptions::default())?;
    }
    let mut antialiased = moving.clone();
    antialiased.gaussians.antialiased = true;
    draw(gpu, &antialiased, &RenderOptions::default())?;
    for (_, quality) in Quality::PRESETS {
        let options = RenderOptions { quality, ..RenderOptions::default() };
        for degree in 0..4 {
            draw(gpu, &random_scene(COUNTS[0], 1, degree), &options)?;
        }
        for scene in [&moving, &nonrigid] {
            for motion in [MotionSource::Table, MotionSource::Network] {
                draw(gpu, scene, &RenderOptions { motion, ..options.clone() })?;
            }
        }
        let mut optional = moving.clone();
        optional.gaussians.optional = random_optional(optional.gaussians.len(), 1);
        draw(gpu, &optional, &options)?;
        draw(gpu, &moving, &RenderOptions { max_instances: Some(PACKED), ..options.clone() })?;
        draw(gpu, &moving, &RenderOptions { depth: true, ..options })?;
    }
    Ok(())
}

fn knobs(gpu: &Gpu) -> Result<()> {
    let scene = moving();
    for knob in KNOBS {
        for value in knob.values {
            let mut quality = Quality::EXACT;
            quality.set(knob.name, value)?;
            let motion = if knob.name == "network" { MotionSource::Network } else { MotionSource::Table };
            let options = RenderOptions { quality, motion, ..RenderOptions::default() };
            draw(gpu, &scene, &RenderOptions { max_instances: Some(PACKED), ..options.clone() })?;
            draw(gpu, &scene, &options)?;
        }
    }
    Ok(())
}

fn field_frames(gpu: &Gpu) -> Result<()> {
    for scene in fields::scenes(COUNTS[0]) {
        draw(gpu, &scene, &RenderOptions::default())?;
    }
    Ok(())
}

fn sorts(gpu: &Gpu) -> Result<()> {
    KEYS.into_iter().try_for_each(|keys| DeviceSort::new(gpu, &vec![0; keys], 32)?.run().map(drop))
}

fn screens(gpu: &Gpu) -> Result<()> {
    let scene = moving();
    let mut renderer = draw(gpu, &scene, &RenderOptions { depth: true, ..RenderOptions::default() })?;
    let mut screen = Screen::new(gpu)?;
    for mode in [DisplayMode::Color, DisplayMode::Depth, DisplayMode::Opacity, DisplayMode::Tiles] {
        let frame = renderer.submit(&camera(&scene), 0.0)?;
        let options = DisplayOptions { mode, size: SIZE, bgra: false, depth_range: [0.2, 10.0], tile_range: 100.0 };
        screen.submit(&renderer, frame, &options)?;
    }
    gpu.wait_idle()
}

fn embedded(gpu: &Gpu) -> Result<()> {
    let scene = moving();
    let formats = [PixelFormat::Rgba8, PixelFormat::Bgra8, PixelFormat::Rgba16F, PixelFormat::Rgba32F];
    let cut = Quality { alpha_cut: 1.0 / 64.0, ..Quality::HIGH };
    let stopped = Quality { stop: 0.01, ..Quality::HIGH };
    for quality in Quality::PRESETS.into_iter().map(|(_, quality)| quality).chain([cut, stopped]) {
        let handle = SceneHandle::upload(gpu, &scene, &SceneOptions { quality, ..SceneOptions::default() })?;
        for format in formats {
            for (storage, depth) in [(false, false), (false, true), (true, false), (true, true)] {
                if storage && format == PixelFormat::Bgra8 {
                    continue;
                }
                let options = ViewOptions { format, storage, depth, ..ViewOptions::default() };
                EmbeddedView::new(gpu, &handle, &options)?.prepare(&camera(&scene), 0.0)?;
            }
        }
    }
    Ok(())
}

/// Configurations whose steps differ in kernels or their constants.
fn variants(base: &Config) -> Vec<Config> {
    let with = |change: fn(&mut Config)| {
        let mut config = base.clone();
        change(&mut config);
        config
    };
    let mut all = vec![
        base.clone(),
        with(|c| c.deterministic = true),
        with(|c| c.loss.prop_loss = Form::Paper),
        with(|c| c.motion.association_init = Form::Paper),
        with(|c| c.loss.lambda_dssim = 0.0),
        with(|c| c.gaussians.optional = vec![PARAMETERS[LIFESPAN].name.to_owned()]),
        with(|c| (c.motion.neighbors, c.motion.association_slots) = (1, 1)),
        with(|c| c.motion.blend = SOFT as u32),
        with(|c| c.gaussians.antialiased = true),
        with(|c| c.motion.network_mean = 100),
        with(|c| (c.motion.network_layers, c.motion.network_width) = (2, 32)),
    ];
    for degree in 0..3 {
        all.push(Config {
            gaussians: engine::train::config::GaussiansConfig { sh_degree: degree, ..base.gaussians.clone() },
            ..base.clone()
        });
    }
    all
}

fn training(gpu: &Gpu) -> Result<()> {
    let steps = |superpoints, gaussians, variants: fn(&Config) -> Vec<Config>| {
        let case = train::synthetic(gpu, superpoints, [0.0; 3], gaussians, SIZE)?;
        for config in variants(&case.config) {
            let mut trainer = Trainer::new(gpu, &config, &case.data, &case.first)?;
            trainer.step()?;
            trainer.step()?;
        }
        Ok(())
    };
    let [gaussians, superpoints, _] = COUNTS.map(|count| count as u32);
    steps(0, gaussians, variants)?;
    steps(superpoints, gaussians, variants)?;
    steps(superpoints, MANY, |base| {
        vec![base.clone(), Config { loss: LossConfig { prop_loss: Form::Paper, ..base.loss.clone() }, ..base.clone() }]
    })
}

/// Pictures of many tiles, whose lists are not cut.
fn whole_lists(gpu: &Gpu) -> Result<()> {
    let stage = Stage::of_device(gpu);
    let size = gpu.subgroup_size_of(&BLEND);
    let pixels_per_lane = blend::pixels_per_lane(size);
    let slots = BlendConstants { stage: stage as u32, pixels_per_lane, with_slots: 1, ..BlendConstants::default() };
    gpu.compile(&BLEND.kernel, &slots.to_words())?;
    let mut ways: Vec<(_, &'static Kernel, _)> =
        vec![(Accumulation::Instances, &BLEND_BACKWARD.kernel, blend_backward::subtiles_of_tile(size))];
    if gpu.info().capabilities.float_atomics {
        ways.push((Accumulation::NativeAtomics, &BLEND_BACKWARD_NATIVE.kernel, 1));
    }
    ways.into_iter().try_for_each(|(way, kernel, subtiles)| {
        [false, true].into_iter().try_for_each(|absolute| {
            let constants = BlendBackwardConstants::new(way, stage, size, subtiles, Segments::WHOLE, absolute);
            gpu.compile(kernel, &constants.to_words())
        })
    })
}

/// A run has the first after thousands of steps.
fn opacity_resets(gpu: &Gpu) -> Result<()> {
    [0, 1].into_iter().try_for_each(|smoothed| gpu.compile(&RESET_OPACITY.kernel, &[smoothed]))
}

fn nonrigid_training(gpu: &Gpu) -> Result<()> {
    for superpoints in [0, COUNTS[1] as u32] {
        let case = train::synthetic(gpu, superpoints, [0.0; 3], COUNTS[0] as u32, SIZE)?;
        let mut rigid = Trainer::new(gpu, &case.config, &case.data, &case.first)?;
        rigid.step()?;
        rigid.step()?;
        let trained = rigid.checkpoint()?;
        for deterministic in [false, true] {
            let config = Config { deterministic, ..case.config.clone() };
            Trainer::nonrigid(gpu, &config, &case.data, &trained)?.step()?;
        }
        let mut config = case.config.clone();
        config.motion.blend = SOFT as u32;
        let mut soft = Trainer::new(gpu, &config, &case.data, &case.first)?;
        soft.step()?;
        soft.step()?;
        Trainer::nonrigid(gpu, &config, &case.data, &soft.checkpoint()?)?.step()?;
    }
    Ok(())
}

fn gradients(gpu: &Gpu) -> Result<()> {
    let [n, m, t] = COUNTS;
    let options = GradientOptions { near: 0.2, background: [0.0; 3] };
    let image_gradient = vec![0.0; 4 * (SIZE[0] * SIZE[1]) as usize];
    let moving = moving_scene(n, m, t, 1, false);
    for scene in [random_scene(n, 1, 3), soft(&moving), moving] {
        scene_gradients(gpu, &scene, &camera(&scene), 0.0, &options, &image_gradient)?;
    }
    Ok(())
}

fn metrics(gpu: &Gpu) -> Result<()> {
    for network in Network::ALL {
        let side = network.smallest_side();
        let picture = Planes { width: side, height: side, rgb: std::array::from_fn(|_| vec![0.5; side * side]) };
        Lpips::new(gpu, &Weights::zero(network))?.distance(&picture, &picture, Range::MinusOneToOne)?;
    }
    Ok(())
}
