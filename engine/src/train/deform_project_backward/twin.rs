//! CPU twin: reads the kernel's buffers, calls the f64 backward of the reference, and writes the results in f32.

use glam::{DMat3, DVec2, DVec3};

use super::{OUTPUT_ADAM, PLANE_SH};
use crate::gpu::kernel::TwinCall;
use crate::reference::gradient::project::{OneGaussian, OneGradient, View, backward};
use crate::reference::gradient::splats::SplatGradient;
use crate::reference::{Offset, Pose};
use crate::render::frame::Frame;
use crate::render::limits::COUNT_FAILED;
use crate::render::twin::{f32_at, group_count, set_f32, spec, struct_at, vec4_at};
use crate::train::adam;
use crate::train::deform_project_backward::DEFORM_PROJECT_BACKWARD_THREADS;
use crate::train::status;
use crate::train::step::Step;

/// Bindings by name.
mod at {
    pub(super) const STATUS: usize = 3;
    pub(super) const SPLATS: usize = 4;
    pub(super) const TILE_COUNT: usize = 5;
    pub(super) const SPLAT_GRADIENT: usize = 6;
    pub(super) const MEAN: usize = 7;
    pub(super) const LOG_SCALE: usize = 8;
    pub(super) const ROTATION: usize = 9;
    pub(super) const OPACITY_LOGIT: usize = 10;
    pub(super) const GROUP: usize = 11;
    pub(super) const POSE: usize = 12;
    pub(super) const SH: usize = 13;
    pub(super) const MOMENT_1: usize = 17;
    pub(super) const MOMENT_2: usize = 18;
    pub(super) const GRADIENT: usize = 19;
    pub(super) const POSE_GRADIENT: usize = 20;
    pub(super) const OFFSET: usize = 21;
    pub(super) const OFFSET_GRADIENT: usize = 22;
    pub(super) const DENSITY: usize = 23;
    pub(super) const MAX_RADIUS: usize = 24;
    pub(super) const MEAN_GRADIENT: usize = 25;
}

/// What a call is about.
struct Job {
    frame: Frame,
    step: Step,
    n: usize,
    degree: usize,
    moving: bool,
    nonrigid: bool,
    adam: bool,
    with_mean_gradient: bool,
}

pub(super) fn deform_project_backward_twin(call: &mut TwinCall<'_>) {
    let frame: Frame = struct_at(&call.buffers[0], 0);
    let job = Job {
        frame,
        step: struct_at(&call.buffers[1], 0),
        n: frame.gaussians as usize,
        degree: spec(call, 1) as usize,
        moving: spec(call, 2) == 1,
        nonrigid: spec(call, 3) == 1,
        adam: spec(call, 4) == OUTPUT_ADAM,
        with_mean_gradient: spec(call, 5) == 1,
    };
    if call.buffers[2][COUNT_FAILED as usize] != 0 {
        return;
    }
    let threads = (group_count(call) * DEFORM_PROJECT_BACKWARD_THREADS) as usize;
    for g in 0..job.n.min(threads) {
        job.one(call.buffers, g);
    }
}

impl Job {
    fn one(&self, buffers: &mut [Vec<u32>], g: usize) {
        let visible = buffers[at::TILE_COUNT][g] > 0;
        let gradient = if visible { self.read(buffers, g).map(|one| self.gradient(buffers, g, &one)) } else { None };
        if let Some(gradient) = gradient.as_ref().filter(|_| self.step.density_statistics > 0.0) {
            self.statistics(buffers, g, gradient);
        }
        let sh_values = 3 * (self.degree + 1) * (self.degree + 1);
        let mut gradient = gradient.unwrap_or(OneGradient { sh: vec![0.0; sh_values], ..OneGradient::default() });
        if self.with_mean_gradient {
            let extra = |axis: usize| f64::from(f32_at(&buffers[at::MEAN_GRADIENT], axis * self.n + g));
            gradient.mean += DVec3::new(extra(0), extra(1), extra(2));
        }
        let mut good = true;
        for band in 0..=self.degree {
            let first = 3 * band * band;
            let rate = if band == 0 { self.step.rate_sh_0 } else { self.step.rate_sh_rest };
            let values = &gradient.sh[first..first + 3 * (2 * band + 1)];
            good &= self.apply(buffers, at::SH + band, PLANE_SH[band], values, rate, g);
        }
        report(buffers, good, 4, g);
        let Step {
            rate_mean: mean,
            rate_log_scale: log_scale,
            rate_rotation: rotation,
            rate_opacity_logit: opacity,
            ..
        } = self.step;
        let geometry: [(usize, usize, &[f64], f32); 4] = [
            (at::MEAN, 0, &gradient.mean.to_array(), mean),
            (at::LOG_SCALE, 3, &gradient.log_scale, log_scale),
            (at::ROTATION, 6, &gradient.rotation, rotation),
            (at::OPACITY_LOGIT, 10, &[gradient.opacity_logit], opacity),
        ];
        for (group, (binding, first, values, rate)) in geometry.into_iter().enumerate() {
            let good = self.apply(buffers, binding, first, values, rate, g);
            report(buffers, good, group, g);
        }
        if self.moving {
            let values = [gradient.omega.to_array(), gradient.translation.to_array()].concat();
            self.write(buffers, at::POSE_GRADIENT, 9, &values, g);
        }
        if self.nonrigid {
            let Offset { mean, rotation, scale } = gradient.offset;
            let values = [&mean[..], &rotation, &scale].concat();
            self.write(buffers, at::OFFSET_GRADIENT, 7, &values, g);
        }
    }

    /// Word of number `k` of a parameter of Gaussian `g`: planes, but for the quaternion.
    fn word(&self, binding: usize, k: usize, g: usize) -> usize {
        if binding == at::ROTATION { 4 * g + k } else { k * self.n + g }
    }

    /// Gaussian `g`; `None` when something that enters is unusable.
    fn read(&self, buffers: &[Vec<u32>], g: usize) -> Option<OneGaussian> {
        let number = |binding: usize, k: usize| f64::from(f32_at(&buffers[binding], self.word(binding, k, g)));
        let three = |binding: usize, first: usize| [0, 1, 2].map(|k| number(binding, first + k));
        let sh = (0..=self.degree).flat_map(|band| (0..3 * (2 * band + 1)).map(move |k| (at::SH + band, k)));
        let offset = Offset {
            mean: if self.nonrigid { three(at::OFFSET, 0) } else { [0.0; 3] },
            rotation: if self.nonrigid { [3, 4, 5, 6].map(|k| number(at::OFFSET, k)) } else { [0.0; 4] },
            scale: if self.nonrigid { three(at::OFFSET, 7) } else { [0.0; 3] },
        };
        let pose = if self.moving { Some(self.pose(buffers, g)?) } else { None };
        let one = OneGaussian {
            mean: three(at::MEAN, 0).into(),
            rotation: [0, 1, 2, 3].map(|k| number(at::ROTATION, k)),
            log_scale: three(at::LOG_SCALE, 0),
            opacity_logit: number(at::OPACITY_LOGIT, 0),
            sh: sh.map(|(binding, k)| number(binding, k)).collect(),
            sh_degree: self.degree as u32,
            pose,
            offset: self.nonrigid.then_some(offset),
        };
        let long = one.rotation.iter().map(|x| x * x).sum::<f64>() > 1e-24;
        let sane = one.mean.is_finite() && one.log_scale.iter().all(|s| s.abs() <= 30.0) && long;
        sane.then_some(one)
    }

    fn pose(&self, buffers: &[Vec<u32>], g: usize) -> Option<Pose> {
        let Frame { superpoints, first_key: first, second_key: second, .. } = self.frame;
        let superpoint = buffers[at::GROUP][g];
        if superpoint >= superpoints {
            return None;
        }
        let vector = |key: u32, part: u32| {
            let [x, y, z, _] = vec4_at(&buffers[at::POSE], (2 * (key * superpoints + superpoint) + part) as usize);
            DVec3::new(x.into(), y.into(), z.into())
        };
        let weight = f64::from(self.frame.key_weight);
        let lerp = |part: u32| vector(first, part) * (1.0 - weight) + vector(second, part) * weight;
        Some(Pose { rotation: lerp(0), translation: lerp(1) })
    }

    fn gradient(&self, buffers: &[Vec<u32>], g: usize, one: &OneGaussian) -> OneGradient {
        let row = std::array::from_fn(|i| f32_at(&buffers[at::SPLAT_GRADIENT], 12 * g + i));
        let splat = SplatGradient::from_row(row);
        let drawn = vec4_at(&buffers[at::SPLATS], 3 * g + 2);
        let color = std::array::from_fn(|c| if drawn[c] > 0.0 { splat.color[c] } else { 0.0 });
        backward(one, &self.view(), &splat, color)
    }

    fn view(&self) -> View {
        let f = &self.frame;
        let v = |v: &[f32]| DVec3::new(v[0].into(), v[1].into(), v[2].into());
        let rows = [&f.world_to_camera_0, &f.world_to_camera_1, &f.world_to_camera_2].map(|row| v(row));
        View {
            rotation: DMat3::from_cols(rows[0], rows[1], rows[2]).transpose(),
            position: v(&f.camera_position_high) + v(&f.camera_position_low),
            focal: DVec2::new(f.intrinsics[0].into(), f.intrinsics[1].into()),
            tangent: f.tan_limit.map(f64::from),
        }
    }

    fn statistics(&self, buffers: &mut [Vec<u32>], g: usize, gradient: &OneGradient) {
        let half = DVec2::new(self.frame.size[0].into(), self.frame.size[1].into()) * 0.5;
        let finite = |x: f32| if x.is_finite() { x } else { 0.0 };
        let change = finite((gradient.mean2d * half).length() as f32);
        let density = &mut buffers[at::DENSITY];
        let (sum, views) = (f32_at(density, g) + change, f32_at(density, self.n + g) + 1.0);
        set_f32(density, g, sum);
        set_f32(density, self.n + g, views);
        let radius = finite((3.0 * gradient.variance.sqrt()).ceil() as f32);
        let before = finite(f32_at(&buffers[at::MAX_RADIUS], g));
        set_f32(&mut buffers[at::MAX_RADIUS], g, before.max(radius));
    }

    /// Hands over the gradients of one parameter, whose planes start at `first`; whether all was finite.
    fn apply(
        &self,
        buffers: &mut [Vec<u32>],
        binding: usize,
        first: usize,
        gradient: &[f64],
        rate: f32,
        g: usize,
    ) -> bool {
        let mut good = true;
        for (k, &slope) in gradient.iter().enumerate() {
            let (word, plane) = (self.word(binding, k, g), (first + k) * self.n + g);
            let slope = slope as f32;
            if !self.adam {
                good &= slope.is_finite();
                set_f32(&mut buffers[at::GRADIENT], plane, if slope.is_finite() { slope } else { 0.0 });
                continue;
            }
            let mut moments = [f32_at(&buffers[at::MOMENT_1], plane), f32_at(&buffers[at::MOMENT_2], plane)];
            let value = f32_at(&buffers[binding], word);
            let bias = self.step.bias_gaussians;
            let next = adam::update(&self.step, value, slope, &mut moments, rate, bias);
            if [slope, next, moments[0], moments[1]].iter().all(|x| x.is_finite()) {
                set_f32(&mut buffers[binding], word, next);
                set_f32(&mut buffers[at::MOMENT_1], plane, moments[0]);
                set_f32(&mut buffers[at::MOMENT_2], plane, moments[1]);
            } else {
                good = false;
            }
        }
        good
    }

    fn write(&self, buffers: &mut [Vec<u32>], binding: usize, group: usize, values: &[f64], g: usize) {
        let good = values.iter().all(|&x| (x as f32).is_finite());
        for (k, &value) in values.iter().enumerate() {
            let value = value as f32;
            set_f32(&mut buffers[binding], k * self.n + g, if value.is_finite() { value } else { 0.0 });
        }
        report(buffers, good, group, g);
    }
}

fn report(buffers: &mut [Vec<u32>], good: bool, group: usize, g: usize) {
    if !good {
        status::report(&mut buffers[at::STATUS], group, g as u32);
    }
}
