//! The scene that is shown: its renderers, superpoints and what a click finds.

use std::path::PathBuf;
use std::sync::Arc;

use engine::error::Result;
use engine::gpu::Gpu;
use engine::reference;
use engine::render::{Quality, RenderOptions, Renderer};
use engine::scene::{Gaussians, MotionSource, Scene};
use glam::DVec3;

use super::state::{Selection, Settings, Show};
use crate::cli::camera;

/// Golden ratio, for hues that differ as much as they can.
const GOLDEN: f32 = 0.618_034;
/// SH basis of degree 0.
const SH_0: f32 = 0.282_094_8;
/// Colour of what is selected, and its share.
const SELECTED: [f32; 3] = [1.0, 0.55, 0.1];
const SELECTED_SHARE: f32 = 0.6;
/// Opacity of what is hidden, before the sigmoid: far below what is drawn.
const HIDDEN_LOGIT: f32 = -80.0;
/// Points of a superpoint's path.
const PATH_STEPS: usize = 25;

/// A model on the device.
#[derive(Debug)]
pub(super) struct Model {
    pub(super) path: PathBuf,
    pub(super) scene: Arc<Scene>,
    pub(super) center: DVec3,
    pub(super) radius: f64,
    pub(super) time_range: [f64; 2],
    /// Centres of the superpoints at the time of the last [`Model::pose`].
    pub(super) centers: Vec<DVec3>,
    posed_at: Option<f64>,
    /// Centres of the superpoints at evenly spread times.
    pub(super) paths: Vec<Vec<DVec3>>,
    built: (Quality, MotionSource),
    plain: Renderer,
    tinted: Option<(Tint, Renderer)>,
    /// How far off images may be, if that is known.
    expected: Option<Arc<Expected>>,
    /// Which of the two drew last.
    tinted_last: bool,
    marks: Option<Marks>,
}

/// What stands out, and what is not drawn.
#[derive(Debug, Default)]
struct Marks {
    selected: Vec<bool>,
    hidden: Vec<bool>,
    /// The renderers have it.
    drawn: bool,
}

/// How far off images may be, as colours.
#[derive(Debug)]
pub(super) struct Expected {
    /// `[N]`.
    pub(super) each: Vec<[f32; 3]>,
    pub(super) background: [f32; 3],
}

/// What the colours mean when they are not the scene's own.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Tint {
    /// The superpoint.
    Superpoints,
    /// One superpoint in full colour, the rest faded.
    Only(u32),
    /// The error to expect.
    ExpectedError,
}

impl Model {
    pub(super) fn new(gpu: &Gpu, path: PathBuf, scene: Arc<Scene>, settings: &Settings) -> Result<Self> {
        let (center, radius) = camera::whole(&scene);
        let motion = motion_of(&scene, settings);
        let plain = Renderer::new(gpu, &scene, &options(settings, motion, &scene))?;
        let mut model = Self {
            path,
            center,
            radius,
            time_range: scene.time_range(),
            centers: Vec::new(),
            posed_at: None,
            paths: Vec::new(),
            built: (built_quality(settings), motion),
            plain,
            tinted: None,
            expected: None,
            tinted_last: false,
            marks: None,
            scene,
        };
        model.paths = model.sample_paths(motion)?;
        Ok(model)
    }

    /// Says how far off its images may be.
    pub(super) fn expect(&mut self, expected: Option<Arc<Expected>>) {
        self.expected = expected;
    }

    /// What [`Model::expect`] said.
    pub(super) fn expected(&self) -> Option<Arc<Expected>> {
        self.expected.clone()
    }

    pub(super) fn name(&self) -> String {
        self.path.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned())
    }

    pub(super) fn superpoints(&self) -> usize {
        self.scene.deformation.superpoint_count()
    }

    fn sample_paths(&self, source: MotionSource) -> Result<Vec<Vec<DVec3>>> {
        if !self.scene.is_dynamic() {
            return Ok(Vec::new());
        }
        let [start, end] = self.time_range;
        let time = |i: usize| start + (end - start) * i as f64 / (PATH_STEPS - 1) as f64;
        (0..PATH_STEPS).map(|i| centers(&self.scene, time(i), source)).collect()
    }

    /// Moves the superpoints' centres to a time.
    pub(super) fn pose(&mut self, time: f64, source: MotionSource) -> Result<()> {
        if self.posed_at != Some(time) {
            self.centers = centers(&self.scene, time, source)?;
            self.posed_at = Some(time);
        }
        Ok(())
    }

    /// The renderer for what is shown, at a share of the chosen resolution; made anew when the quality is another.
    pub(super) fn renderer(
        &mut self,
        gpu: &Gpu,
        settings: &Settings,
        selection: Option<Selection>,
        share: f32,
    ) -> Result<&mut Renderer> {
        let motion = motion_of(&self.scene, settings);
        let built = (built_quality(settings), motion);
        if self.built != built {
            self.tinted = None;
            // The old one goes first: the peak is the larger of the two, not the sum.
            self.plain = Renderer::new(gpu, &Scene::default(), &RenderOptions::default())?;
            self.plain = Renderer::new(gpu, &self.scene, &options(settings, motion, &self.scene))?;
            self.built = built;
            self.marks.iter_mut().for_each(|marks| marks.drawn = false);
            self.posed_at = None;
            self.paths = self.sample_paths(motion)?;
        }
        let tint = self.tint(settings, selection);
        if let Some(tint) = tint
            && self.tinted.as_ref().is_none_or(|(shown, _)| *shown != tint)
        {
            let colors = self.colors(tint, settings.show);
            let renderer = match self.tinted.take() {
                Some((_, renderer)) => renderer,
                None => Renderer::new(gpu, &self.without_colors(), &options(settings, motion, &self.scene))?,
            };
            renderer.set_base_colors(&colors)?;
            self.tinted = Some((tint, renderer));
            self.marks.iter_mut().for_each(|marks| marks.drawn = false);
        }
        self.draw_marks()?;
        self.tinted_last = tint.is_some();
        let behind = self.expected.as_ref().filter(|_| tint == Some(Tint::ExpectedError));
        let background = behind.map_or(settings.background, |e| e.background);
        let renderer = self.current();
        renderer.set_background(background);
        renderer.set_depth(settings.show == Show::Depth);
        renderer.set_resolution(settings.resolution * share);
        Ok(renderer)
    }

    /// Says which Gaussians stand out and which are not drawn, from the next frame on.
    pub(super) fn mark(&mut self, selected: Option<&[bool]>, hidden: Option<&[bool]>) {
        let mask = |mask: Option<&[bool]>| mask.unwrap_or_default().to_vec();
        let is_plain = self.marks.is_none() && selected.is_none() && hidden.is_none();
        if !is_plain {
            self.marks = Some(Marks { selected: mask(selected), hidden: mask(hidden), drawn: false });
        }
    }

    fn draw_marks(&mut self) -> Result<()> {
        let Some(marks) = self.marks.as_mut().filter(|marks| !marks.drawn) else { return Ok(()) };
        marks.drawn = true;
        let g = &self.scene.gaussians;
        let k3 = g.sh_coefficients() * 3;
        let is = |mask: &[bool], i: usize| mask.get(i).copied().unwrap_or(false);
        let color = |i: usize| {
            let own = [0, 1, 2].map(|c| 0.5 + SH_0 * g.sh[i * k3 + c]);
            if !is(&marks.selected, i) {
                return own;
            }
            [0, 1, 2].map(|c| own[c] + SELECTED_SHARE * (SELECTED[c] - own[c]))
        };
        let opacity = |i: usize| if is(&marks.hidden, i) { HIDDEN_LOGIT } else { g.opacity_logit[i] };
        let opacities: Vec<f32> = (0..g.len()).map(opacity).collect();
        self.plain.set_base_colors(&(0..g.len()).map(color).collect::<Vec<_>>())?;
        self.plain.set_opacities(&opacities)?;
        if let Some((_, tinted)) = &self.tinted {
            tinted.set_opacities(&opacities)?;
        }
        Ok(())
    }

    /// The renderer of the latest frame.
    pub(super) fn current(&mut self) -> &mut Renderer {
        match &mut self.tinted {
            Some((_, renderer)) if self.tinted_last => renderer,
            _ => &mut self.plain,
        }
    }

    fn tint(&self, settings: &Settings, selection: Option<Selection>) -> Option<Tint> {
        let selected = selection.and_then(|s| s.superpoint).map(Tint::Only);
        let wanted = match settings.show {
            Show::ExpectedError => return self.expected.as_ref().map(|_| Tint::ExpectedError),
            Show::Superpoints => selected.or(Some(Tint::Superpoints)),
            Show::Color => selected,
            _ => None,
        };
        wanted.filter(|_| self.superpoints() > 0)
    }

    /// A colour for each Gaussian.
    fn colors(&self, tint: Tint, show: Show) -> Vec<[f32; 3]> {
        if let (Tint::ExpectedError, Some(expected)) = (tint, &self.expected) {
            return expected.each.clone();
        }
        let groups = self.scene.deformation.superpoint_of_gaussian();
        let g = &self.scene.gaussians;
        let k3 = g.sh_coefficients() * 3;
        let own = |i: usize| [0, 1, 2].map(|c| (0.5 + SH_0 * g.sh[i * k3 + c]).clamp(0.0, 1.0));
        let color = |(i, group): (usize, &u32)| match tint {
            Tint::Superpoints => superpoint_color(*group),
            Tint::Only(selected) if selected == *group && show == Show::Superpoints => superpoint_color(*group),
            Tint::Only(selected) if selected == *group => own(i).map(|v| (0.25 + v).min(1.0)),
            Tint::Only(_) | Tint::ExpectedError => {
                let [r, g, b] = own(i);
                [0.3 * (0.25 * r + 0.5 * g + 0.25 * b); 3]
            }
        };
        groups.iter().enumerate().map(color).collect()
    }

    /// The scene with SH of degree 0, to be coloured otherwise.
    fn without_colors(&self) -> Scene {
        let g = &self.scene.gaussians;
        let gaussians = Gaussians { sh_degree: 0, sh: vec![0.0; 3 * g.len()], ..g.clone() };
        Scene { gaussians, ..Scene::clone(&self.scene) }
    }
}

/// A colour of its own for each superpoint, the same in every session.
pub(super) fn superpoint_color(index: u32) -> [f32; 3] {
    let hue = (index as f32 * GOLDEN).fract();
    let value = [0.95, 0.75, 0.85][index as usize % 3];
    let saturation = [0.75, 0.6, 0.5][index as usize / 3 % 3];
    let channel = |shift: f32| {
        let x = ((hue + shift).fract() * 6.0 - 3.0).abs() - 1.0;
        value * (1.0 - saturation + saturation * x.clamp(0.0, 1.0))
    };
    [channel(0.0), channel(2.0 / 3.0), channel(1.0 / 3.0)]
}

fn centers(scene: &Scene, time: f64, source: MotionSource) -> Result<Vec<DVec3>> {
    let Some(superpoints) = scene.deformation.superpoints() else { return Ok(Vec::new()) };
    let position = superpoints.position.iter().map(|p| DVec3::from_array(p.map(f64::from)));
    Ok(match reference::poses(scene, time, source)? {
        Some(poses) => position.zip(poses).map(|(p, q)| reference::exp(q.rotation) * p + q.translation).collect(),
        None => position.collect(),
    })
}

/// What a renderer is built with; the resolution changes without.
fn built_quality(settings: &Settings) -> Quality {
    Quality { resolution: 1.0, ..settings.quality }
}

/// Nothing moves by any motion before a model is there.
fn motion_of(scene: &Scene, settings: &Settings) -> MotionSource {
    if scene.gaussians.is_empty() { MotionSource::Auto } else { settings.motion }
}

fn options(settings: &Settings, motion: MotionSource, scene: &Scene) -> RenderOptions {
    RenderOptions {
        background: settings.background,
        near: settings.near.unwrap_or_else(|| camera::near(scene)),
        motion,
        quality: built_quality(settings),
        profile: true,
        ..RenderOptions::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbouring_superpoints_have_distinct_colours() {
        for i in 0..60 {
            let a = superpoint_color(i);
            assert!(a.iter().all(|v| (0.0..=1.0).contains(v)));
            for j in i + 1..i + 4 {
                let b = superpoint_color(j);
                let distance: f32 = a.iter().zip(b).map(|(x, y)| (x - y).abs()).sum();
                assert!(distance > 0.2, "{i} {j}: {a:?} {b:?}");
            }
        }
    }
}
