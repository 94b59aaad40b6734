//! CPU twin: reads the kernel's buffers, calls the f64 backward of the reference, and writes the results in f32.

use glam::{DMat3, DVec2, DVec3};

use super::{DeformProjectBackward, DeformProjectBackwardBuffers, OUTPUT_ADAM};
use crate::gpu::interface::Call;
use crate::reference::gradient::project::{OneGaussian, OneGradient, View, backward};
use crate::reference::gradient::splats::SplatGradient;
use crate::reference::{Offset, Pose, WeightedPose};
use crate::render::deform_project::MOTION_TABLE;
use crate::render::frame::Frame;
use crate::render::limits::COUNT_FAILED;
use crate::render::superpoint_motion::{Slot, SuperpointMotion};
use crate::render::twin::{f32_at, set_f32, struct_at, vec4_at};
use crate::scene::parameter::{
    LOG_SCALE, MEAN, OPACITY_LOGIT, Optional, PARAMETERS, Present, ROTATION, SH_0, SMOOTHING, first_plane,
};
use crate::train::adam;
use crate::train::deform_project_backward::DEFORM_PROJECT_BACKWARD_THREADS;
use crate::train::status;
use crate::train::step::Step;

/// (0.2)^(1/2), px: the filter of Mip-Splatting.
const ROOT_FILTER_VARIANCE: f32 = 0.447_213_6;

type Words<'a> = DeformProjectBackwardBuffers<&'a mut [u32]>;

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
    optional: Present,
    blend: u32,
    antialiased: bool,
}

pub(super) fn deform_project_backward_twin(call: Call<'_, DeformProjectBackward>) {
    let threads = (call.group_count() * DEFORM_PROJECT_BACKWARD_THREADS) as usize;
    let Call { constants, buffers: mut b, .. } = call;
    let frame: Frame = struct_at(b.frame, 0);
    let job = Job {
        frame,
        step: struct_at(b.step, 0),
        n: frame.gaussians as usize,
        degree: constants.sh_degree as usize,
        moving: constants.motion == MOTION_TABLE,
        nonrigid: constants.nonrigid == 1,
        adam: constants.output == OUTPUT_ADAM,
        with_mean_gradient: constants.mean_gradient == 1,
        optional: Present(constants.optional),
        blend: constants.blend,
        antialiased: constants.antialiased == 1,
    };
    if b.counters[COUNT_FAILED as usize] != 0 {
        return;
    }
    for g in 0..job.n.min(threads) {
        job.one(&mut b, g);
    }
}

/// Planes that gradients are written to or applied with.
struct Planes<'a> {
    moment_1: &'a mut [u32],
    moment_2: &'a mut [u32],
    gradient: &'a mut [u32],
}

impl Job {
    fn one(&self, b: &mut Words<'_>, g: usize) {
        let visible = b.tile_count[g] > 0;
        let gradient = if visible { self.read(b, g).map(|one| self.gradient(b, g, &one)) } else { None };
        if let Some(gradient) = gradient.as_ref().filter(|_| self.step.density_statistics > 0.0) {
            self.statistics(b, g, gradient);
        }
        let sh_values = 3 * (self.degree + 1) * (self.degree + 1);
        let mut gradient = gradient.unwrap_or(OneGradient { sh: vec![0.0; sh_values], ..OneGradient::default() });
        if let Some(extra) = b.mean_gradient.as_ref().filter(|_| self.with_mean_gradient) {
            gradient.mean += DVec3::from_array(self.planes(extra, 0, g));
        }
        // Adam moves it below.
        let canonical = DVec3::from_array(self.planes(b.mean, 0, g));
        self.parameters(b, g, &gradient);
        if self.moving && self.blend > 0 {
            self.blend_gradient(b, &gradient, canonical, g);
        } else if let Some(pose_gradient) = b.pose_gradient.as_mut().filter(|_| self.moving) {
            let pose = gradient.pose(0);
            let values = [pose.omega.to_array(), pose.translation.to_array()].concat();
            self.write(pose_gradient, b.status, status::POSE, &values, g);
        }
        if let Some(nonrigid_gradient) = b.nonrigid_gradient.as_mut().filter(|_| self.nonrigid) {
            let Offset { mean, rotation, scale } = gradient.offset;
            let values = [&mean[..], &rotation, &scale].concat();
            self.write(nonrigid_gradient, b.status, status::NETWORK_G, &values, g);
        }
    }

    /// Hands over the gradients of all parameters.
    fn parameters(&self, b: &mut Words<'_>, g: usize, gradient: &OneGradient) {
        let mut planes = Planes {
            moment_1: b.moment_1.as_deref_mut().unwrap_or_default(),
            moment_2: b.moment_2.as_deref_mut().unwrap_or_default(),
            gradient: b.gradient.as_deref_mut().unwrap_or_default(),
        };
        let (mean, slopes_of_sh) = (gradient.mean.to_array(), &gradient.sh);
        let band = |band: usize| &slopes_of_sh[3 * band * band..][..3 * (2 * band + 1)];
        let sh = [Some(&mut *b.sh_0), b.sh_1.as_deref_mut(), b.sh_2.as_deref_mut(), b.sh_3.as_deref_mut()];
        let bands = sh.into_iter().flatten().enumerate().take(self.degree + 1);
        let mut all: Vec<(usize, &mut [u32], &[f64])> = bands.map(|(i, v)| (SH_0 + i, v, band(i))).collect();
        all.extend([
            (MEAN, &mut *b.mean, &mean[..]),
            (LOG_SCALE, &mut *b.log_scale, &gradient.log_scale),
            (ROTATION, &mut *b.rotation, &gradient.rotation),
            (OPACITY_LOGIT, &mut *b.opacity_logit, std::slice::from_ref(&gradient.opacity_logit)),
        ]);
        // A culled Gaussian has no gradient of its optional parameters.
        let optional = self.optional_slopes(gradient);
        let n = self.n;
        let mut rest = b.optional.as_deref_mut().unwrap_or_default();
        for (parameter, slopes) in &optional {
            let (values, others) = rest.split_at_mut(slopes.len() * n);
            all.push((*parameter, values, slopes));
            rest = others;
        }
        for (parameter, values, slopes) in all {
            if parameter == SMOOTHING && self.adam {
                self.measure_smoothing(values, planes.moment_1, gradient.sampling, g);
                continue;
            }
            let good = self.apply(parameter, values, &mut planes, slopes, g);
            report(b.status, good, parameter, g);
        }
    }

    /// The smoothing of Gaussian `g`, from the most pixels per world unit that a photo had.
    fn measure_smoothing(&self, values: &mut [u32], moment_1: &mut [u32], sampling: f64, g: usize) {
        let moment = first_plane(SMOOTHING, self.optional) as usize * self.n + g;
        let sampling = sampling as f32;
        let before = f32_at(moment_1, moment);
        let most = if sampling.is_finite() { before.max(sampling) } else { before };
        let now = self.step.rate[SMOOTHING] == 1.0 && most > 0.0;
        if now {
            set_f32(values, g, ROOT_FILTER_VARIANCE / most);
        }
        set_f32(moment_1, moment, if now { 0.0 } else { most });
    }

    /// Gradients of the optional parameters, zero where there are none.
    fn optional_slopes(&self, gradient: &OneGradient) -> Vec<(usize, Vec<f64>)> {
        let zeros = |parameter: usize| vec![0.0; PARAMETERS[parameter].width as usize];
        let of = |parameter: usize| gradient.optional.get(parameter).map_or(zeros(parameter), <[f64]>::to_vec);
        self.optional.iter().map(|parameter| (parameter, of(parameter))).collect()
    }

    /// Numbers `first` and the following of Gaussian `g` in a buffer of planes.
    fn planes<const W: usize>(&self, words: &[u32], first: usize, g: usize) -> [f64; W] {
        std::array::from_fn(|k| f64::from(f32_at(words, (first + k) * self.n + g)))
    }

    /// Gaussian `g`; `None` when something that enters is unusable.
    fn read(&self, b: &Words<'_>, g: usize) -> Option<OneGaussian> {
        let sh = [Some(&*b.sh_0), b.sh_1.as_deref(), b.sh_2.as_deref(), b.sh_3.as_deref()];
        let sh = sh.into_iter().flatten().enumerate().take(self.degree + 1);
        let sh = sh.flat_map(|(band, words)| (0..3 * (2 * band + 1)).map(move |k| self.planes::<1>(words, k, g)[0]));
        let offset = b.nonrigid_offset.as_ref().filter(|_| self.nonrigid).map(|words| Offset {
            mean: self.planes(words, 0, g),
            rotation: self.planes(words, 3, g),
            scale: self.planes(words, 7, g),
        });
        let mut optional = Optional::default();
        for parameter in self.optional.iter() {
            let (first, width) = (self.optional.planes_before(parameter), PARAMETERS[parameter].width);
            let words = b.optional.as_deref()?;
            let value = |p: u32| self.planes::<1>(words, p as usize, g)[0];
            optional.set(parameter, (first..first + width).map(value).collect());
        }
        let poses = if self.moving { self.poses(b, g)? } else { Vec::new() };
        let one = OneGaussian {
            mean: DVec3::from_array(self.planes(b.mean, 0, g)),
            rotation: vec4_at(b.rotation, g).map(f64::from),
            log_scale: self.planes(b.log_scale, 0, g),
            opacity_logit: f64::from(f32_at(b.opacity_logit, g)),
            sh: sh.collect(),
            sh_degree: self.degree as u32,
            poses,
            offset,
            optional,
            antialiased: self.antialiased,
        };
        let long = one.rotation.iter().map(|x| x * x).sum::<f64>() > 1e-24;
        let sane = one.mean.is_finite() && one.log_scale.iter().all(|s| s.abs() <= 30.0) && long;
        sane.then_some(one)
    }

    /// What moves Gaussian `g`; `None` when a pose is unusable.
    fn poses(&self, b: &Words<'_>, g: usize) -> Option<Vec<WeightedPose>> {
        let motion = SuperpointMotion {
            superpoint_of_gaussian: b.superpoint_of_gaussian.as_deref().unwrap_or_default(),
            pose: b.pose.as_deref()?,
            slots: self.blend,
            blend_index: b.blend_index.as_deref().unwrap_or_default(),
            blend_weight: b.blend_weight.as_deref().unwrap_or_default(),
        };
        let vector = |v: [f32; 3]| DVec3::from_array(v.map(f64::from));
        let weighted = |slot: &Slot| {
            let [rotation, translation] = motion.pose(&self.frame, slot.superpoint)?.map(vector);
            Some(WeightedPose { weight: slot.weight.into(), pose: Pose { rotation, translation } })
        };
        motion.slots(g, self.n).iter().map(weighted).collect()
    }

    /// Planes of each slot of soft superpoints. The kernel leaves out of a weight's gradient what all slots have in common:
    /// that of the canonical centre, which no weight moves.
    fn blend_gradient(&self, b: &mut Words<'_>, gradient: &OneGradient, canonical: DVec3, g: usize) {
        let moved: DVec3 = gradient.poses.iter().map(|p| p.translation).sum();
        let common = moved.dot(canonical);
        let slot = |k: usize| {
            let pose = gradient.pose(k);
            let weight = if gradient.poses.is_empty() { 0.0 } else { pose.weight - common };
            [pose.omega.to_array().as_slice(), &pose.translation.to_array(), &[weight]].concat()
        };
        let values: Vec<f64> = (0..self.blend as usize).flat_map(slot).collect();
        if let Some(pose_gradient) = b.pose_gradient.as_mut() {
            self.write(pose_gradient, b.status, status::POSE, &values, g);
        }
    }

    fn gradient(&self, b: &Words<'_>, g: usize, one: &OneGaussian) -> OneGradient {
        let row = std::array::from_fn(|i| f32_at(b.splat_gradient, 12 * g + i));
        let splat = SplatGradient::from_row(row);
        let drawn = vec4_at(b.splats, 3 * g + 2);
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
            time: f.time.into(),
        }
    }

    fn statistics(&self, b: &mut Words<'_>, g: usize, gradient: &OneGradient) {
        let (Some(density), Some(max_radius)) = (b.density.as_mut(), b.max_radius.as_mut()) else { return };
        let half = DVec2::new(self.frame.size[0].into(), self.frame.size[1].into()) * 0.5;
        let finite = |x: f32| if x.is_finite() { x } else { 0.0 };
        let row: [f32; 12] = std::array::from_fn(|i| f32_at(b.splat_gradient, 12 * g + i));
        let absolute = DVec2::from_array(SplatGradient::from_row(row).absolute);
        let by_centre = if self.step.density_statistics > 1.0 { absolute } else { gradient.mean2d };
        let change = finite((by_centre * half).length() as f32);
        let (sum, views) = (f32_at(density, g) + change, f32_at(density, self.n + g) + 1.0);
        set_f32(density, g, sum);
        set_f32(density, self.n + g, views);
        let radius = finite((3.0 * gradient.variance.sqrt()).ceil() as f32);
        let before = finite(f32_at(max_radius, g));
        set_f32(max_radius, g, before.max(radius));
    }

    /// Hands over the gradients of one parameter; whether all was finite.
    fn apply(&self, parameter: usize, values: &mut [u32], planes: &mut Planes<'_>, slopes: &[f64], g: usize) -> bool {
        let (first, rate) = (first_plane(parameter, self.optional) as usize, self.step.rate[parameter]);
        let mut good = true;
        for (k, &slope) in slopes.iter().enumerate() {
            let (word, plane) = (PARAMETERS[parameter].word(k, g, self.n), (first + k) * self.n + g);
            let slope = slope as f32;
            if !self.adam {
                good &= slope.is_finite();
                set_f32(planes.gradient, plane, if slope.is_finite() { slope } else { 0.0 });
                continue;
            }
            let mut moments = [f32_at(planes.moment_1, plane), f32_at(planes.moment_2, plane)];
            let bias = self.step.bias_gaussians;
            let next = adam::update(&self.step, f32_at(values, word), slope, &mut moments, rate, bias);
            if [slope, next, moments[0], moments[1]].iter().all(|x| x.is_finite()) {
                set_f32(values, word, next);
                set_f32(planes.moment_1, plane, moments[0]);
                set_f32(planes.moment_2, plane, moments[1]);
            } else {
                good = false;
            }
        }
        good
    }

    /// Writes the planes of a gradient that is not applied here.
    fn write(&self, to: &mut [u32], status: &mut [u32], group: usize, values: &[f64], g: usize) {
        let good = values.iter().all(|&x| (x as f32).is_finite());
        for (k, &value) in values.iter().enumerate() {
            let value = value as f32;
            set_f32(to, k * self.n + g, if value.is_finite() { value } else { 0.0 });
        }
        report(status, good, group, g);
    }
}

fn report(status: &mut [u32], good: bool, group: usize, g: usize) {
    if !good {
        status::report(status, group, g as u32);
    }
}
