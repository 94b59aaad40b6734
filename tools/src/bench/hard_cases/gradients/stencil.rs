//! The f64 gradients against central differences of the f64 image.

use engine::error::Result;
use engine::reference::gradient::image::{Gradients, image_gradients, visible_splats};
use engine::reference::gradient::splats::{Upstream, contributions};
use engine::reference::{DeformationAt, Gaussians64, Offset, Pose, ReferenceOptions, render_deformed};
use engine::scene::Camera;
use engine::scene::synthetic::{Random, random_optional};
use glam::{DVec2, DVec3};

use crate::bench::hard_cases::case::{Check, Outcome};

const GAUSSIANS: usize = 10;
const SUPERPOINTS: usize = 3;
/// Pairs of a parameter and a scene, per kind.
const PAIRS: usize = 25;
/// Scenes after which the search for smooth pieces ends.
const SCENES: u64 = 400;
/// Distance of the stencil's points.
const STEP: f64 = 2.0e-4;

/// A small random scene with everything that can move it, and a random dL/d image.
#[derive(Clone)]
struct Scene64 {
    gaussians: Gaussians64,
    group: Vec<u32>,
    poses: Vec<Pose>,
    offsets: Vec<Offset>,
    camera: Camera,
    color: Vec<f64>,
    alpha: Vec<f64>,
}

fn fill<const W: usize>(r: &mut Random, low: f64, high: f64) -> [f64; W] {
    std::array::from_fn(|_| r.range(low, high))
}

impl Scene64 {
    fn random(seed: u64) -> Self {
        let mut r = Random::new(seed);
        let n = GAUSSIANS;
        let sh_degree = (seed % 4) as u32;
        let sh = 3 * ((sh_degree + 1) * (sh_degree + 1)) as usize;
        let gaussians = Gaussians64 {
            mean: (0..n).map(|_| fill(&mut r, -1.0, 1.0)).collect(),
            log_scale: (0..n).map(|_| fill(&mut r, -3.5, -0.7)).collect(),
            rotation: (0..n).map(|_| fill(&mut r, -1.5, 1.5)).collect(),
            opacity_logit: (0..n).map(|_| r.range(-2.0, 5.5)).collect(),
            sh_degree,
            sh: (0..n * sh).map(|_| r.range(-0.7, 0.7)).collect(),
            optional: random_optional(n, seed).map(f64::from),
            antialiased: seed % 3 == 2,
        };
        let pose = |r: &mut Random| {
            let size = [1.0e-9, 1.0e-3, 0.3, 2.0][r.below(4)];
            Pose { rotation: r.normal3() * size, translation: r.normal3() * 0.3 }
        };
        let offset = |r: &mut Random| Offset {
            mean: fill(r, -0.2, 0.2),
            rotation: fill(r, -0.4, 0.4),
            scale: fill(r, -0.02, 0.1),
        };
        let camera = Camera::look_at(r.direction() * 3.5, r.normal3() * 0.2, DVec3::Z, 0.7, [12, 9]);
        let pixels = (camera.width * camera.height) as usize;
        Self {
            gaussians,
            group: (0..n).map(|_| r.below(SUPERPOINTS) as u32).collect(),
            poses: (0..SUPERPOINTS).map(|_| pose(&mut r)).collect(),
            offsets: (0..n).map(|_| offset(&mut r)).collect(),
            camera,
            color: (0..3 * pixels).map(|_| r.range(-1.0, 1.0)).collect(),
            alpha: (0..pixels).map(|_| r.range(-1.0, 1.0)).collect(),
        }
    }

    fn deformation(&self) -> DeformationAt<'_> {
        DeformationAt {
            group: &self.group,
            poses: Some(&self.poses),
            blend: None,
            offsets: Some(&self.offsets),
            time: 0.0,
        }
    }

    fn options() -> ReferenceOptions {
        ReferenceOptions { background: [0.2, 0.5, 0.9], ..ReferenceOptions::default() }
    }

    fn loss(&self) -> Result<f64> {
        let image = render_deformed(&self.gaussians, &self.deformation(), &self.camera, &Self::options())?;
        let sum = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        Ok(sum(&image.rgb, &self.color) + sum(&image.alpha, &self.alpha))
    }

    fn gradients(&self) -> Result<Gradients> {
        let upstream = Upstream { color: &self.color, alpha: Some(&self.alpha) };
        image_gradients(&self.gaussians, &self.deformation(), &self.camera, &Self::options(), &upstream)
    }

    /// Which smooth piece of the function this is: what every pixel blends, in which order, and what is clamped.
    fn piece(&self) -> Result<Vec<u32>> {
        let splats = visible_splats(&self.gaussians, &self.deformation(), &self.camera, &Self::options())?;
        let all: Vec<u32> = (0..splats.len() as u32).collect();
        let mut piece = Vec::new();
        for splat in &splats {
            piece.push(splat.index as u32);
            piece.extend(splat.color.map(|c| u32::from(c > 0.0)));
            // Beyond the image and its margin the tangents are clamped.
            let [w, h] = [self.camera.width, self.camera.height].map(f64::from);
            let beyond =
                [splat.mean.x < -0.15 * w, splat.mean.x > 1.15 * w, splat.mean.y < -0.15 * h, splat.mean.y > 1.15 * h];
            piece.extend(beyond.map(u32::from));
        }
        for y in 0..self.camera.height {
            for x in 0..self.camera.width {
                let found = contributions(&splats, &all, DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5));
                piece.extend(found.iter().map(|c| 2 * c.splat + u32::from(c.clamped)));
                piece.push(u32::MAX);
            }
        }
        Ok(piece)
    }

    /// The 4-point central difference along one parameter; `None` when the stencil leaves the smooth piece.
    fn difference(&self, kind: &Kind, index: usize, step: f64) -> Result<Option<f64>> {
        let here = self.piece()?;
        let mut values = [0.0; 4];
        for (value, factor) in values.iter_mut().zip([-2.0, -1.0, 1.0, 2.0]) {
            let mut moved = self.clone();
            if let Some(number) = (kind.value)(&mut moved, index) {
                *number += factor * step;
            }
            if moved.piece()? != here {
                return Ok(None);
            }
            *value = moved.loss()?;
        }
        Ok(Some((8.0 * (values[2] - values[1]) - (values[3] - values[0])) / (12.0 * step)))
    }
}

/// A kind of parameter.
struct Kind {
    name: &'static str,
    count: fn(&Scene64) -> usize,
    value: fn(&mut Scene64, usize) -> Option<&mut f64>,
    gradient: fn(&Gradients, usize) -> f64,
}

/// `Kind` of an array of arrays with `$w` columns.
macro_rules! rows {
    ($name:literal, $w:literal, $count:expr, $scene:ident.$($at:ident).+, $($of:ident).+ [$($part:ident)?]) => {
        Kind {
            name: $name,
            count: |_| $w * $count,
            value: |$scene, i| Some(&mut $scene.$($at).+[i / $w]$(.$part)?[i % $w]),
            gradient: |g, i| g.$($of).+[i / $w]$(.$part)?[i % $w],
        }
    };
}

fn kinds() -> [Kind; 11] {
    [
        rows!("mean", 3, GAUSSIANS, s.gaussians.mean, mean[]),
        rows!("rotation", 4, GAUSSIANS, s.gaussians.rotation, rotation[]),
        rows!("log_scale", 3, GAUSSIANS, s.gaussians.log_scale, log_scale[]),
        Kind {
            name: "opacity_logit",
            count: |_| GAUSSIANS,
            value: |s, i| s.gaussians.opacity_logit.get_mut(i),
            gradient: |g, i| g.opacity_logit[i],
        },
        Kind {
            name: "sh",
            count: |s| s.gaussians.sh.len(),
            value: |s, i| s.gaussians.sh.get_mut(i),
            gradient: |g, i| g.sh[i],
        },
        Kind {
            name: "optional parameters",
            count: |s| s.gaussians.optional.numbers().count(),
            value: |s, i| s.gaussians.optional.numbers_mut().nth(i),
            gradient: |g, i| g.optional.numbers().nth(i).unwrap_or(f64::NAN),
        },
        rows!("pose rotation", 3, SUPERPOINTS, s.poses, poses[rotation]),
        rows!("pose translation", 3, SUPERPOINTS, s.poses, poses[translation]),
        rows!("non-rigid centre", 3, GAUSSIANS, s.offsets, offsets[mean]),
        rows!("non-rigid rotation", 4, GAUSSIANS, s.offsets, offsets[rotation]),
        rows!("non-rigid scale", 3, GAUSSIANS, s.offsets, offsets[scale]),
    ]
}

/// Worst relative error of a kind over its pairs, and how many there were.
fn worst(kind: &Kind) -> Result<(f64, usize)> {
    let mut random = Random::new(kind.name.len() as u64 + 7);
    let (mut worst, mut done) = (0.0_f64, 0);
    for seed in 1..SCENES {
        let scene = Scene64::random(seed);
        let gradients = scene.gradients()?;
        for _ in 0..3 {
            let index = random.below((kind.count)(&scene));
            let found = (kind.gradient)(&gradients, index);
            if found.abs() < 1.0e-3 {
                continue;
            }
            let Some(first) = scene.difference(kind, index, STEP)? else { continue };
            let relative = |expected: f64| (found - expected).abs() / expected.abs().max(found.abs());
            let mut error = relative(first);
            // Truncation is of order step⁴: a finer stencil decides, until rounding takes over.
            if error > 1.0e-7
                && let Some(finer) = scene.difference(kind, index, 0.25 * STEP)?
            {
                error = error.min(relative(finer));
            }
            worst = worst.max(error);
            done += 1;
            if done == PAIRS {
                return Ok((worst, done));
            }
        }
    }
    Ok((worst, done))
}

/// All kinds.
pub(super) fn judge() -> Result<Outcome> {
    let mut checks = Vec::new();
    let mut fewest = usize::MAX;
    for kind in kinds() {
        let (error, done) = worst(&kind)?;
        fewest = fewest.min(done);
        checks.push(Check::at_most(format!("relative error of {}", kind.name), error, 1.0e-6));
    }
    checks.sort_by(|a, b| b.value.total_cmp(&a.value));
    checks.push(Check::at_least("pairs of the kind with the fewest", fewest as f64, PAIRS as f64));
    Ok(Outcome {
        truth: format!("the truth itself, checked by differences of its images ({PAIRS} pairs per kind)"),
        checks,
    })
}
