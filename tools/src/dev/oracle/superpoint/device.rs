//! The kernels of training on a case.

use engine::Result;
use engine::gpu::{Buffer, Gpu, Memory, Slice};
use engine::scene::Association;
use engine::train::association::{AssociationOptions, StepBuffers, SuperpointState};
use engine::train::linear::Output;
use engine::train::network_f::{Backward, NetworkF};
use engine::train::property_loss::PropertyLoss;
use engine::train::property_loss::property_values::{PROPERTY_VALUES, PropertyValuesBuffers};
use engine::train::status;
use engine::train::step::Step;

use super::case::Case;
use super::reference;
use super::results::{FORMS, Gradients, Results, loss_names, tensors};

/// One step on the device: buffers, network F, and the pose gradient per Gaussian that rendering would give.
struct Device<'a> {
    gpu: &'a Gpu,
    case: &'a Case,
    network: NetworkF,
}

fn floats(gpu: &Gpu, buffer: &Buffer, count: usize) -> Result<Vec<f64>> {
    let bytes = gpu.download(buffer.slice(0, 4 * count as u64))?;
    Ok(bytemuck::pod_collect_to_vec::<u8, f32>(&bytes).into_iter().map(f64::from).collect())
}

/// Rows of 3 from planes.
fn rows(planes: &[f64]) -> Vec<f64> {
    let n = planes.len() / 3;
    (0..n).flat_map(|i| [0, 1, 2].map(|c| planes[c * n + i])).collect()
}

impl Device<'_> {
    fn counts(&self) -> (usize, usize) {
        (self.case.of_gaussian.len(), self.case.position.len())
    }

    fn step_buffers(&self, lambda: [f32; 3]) -> Result<StepBuffers> {
        let (n, m) = self.counts();
        let mean: Vec<f32> = (0..3).flat_map(|c| self.case.scene.gaussians.mean.iter().map(move |v| v[c])).collect();
        // With β₁ = 0 Adam's first moment is the gradient, and at rate 0 nothing moves.
        let step = Step {
            gaussians: n as u32,
            superpoints: m as u32,
            neighbors: self.case.neighbors as u32,
            iteration: 1,
            epsilon: 1.0,
            bias_association: [1.0; 2],
            weight_position: lambda[0],
            weight_rotation: lambda[1],
            weight_translation: lambda[2],
            time: self.case.time as f32,
            exact_time: self.case.time as f32,
            ..Step::default()
        };
        let with = |name: &str, bytes: &[u8]| self.gpu.buffer_with(name, bytes).map(Slice::from);
        Ok(StepBuffers {
            step: with("step", bytemuck::bytes_of(&step))?,
            counters: with("counters", &[0; 32])?,
            failed: with("failed", &[0; 32])?,
            status: with("status", bytemuck::cast_slice(&status::clear()))?,
            mean: with("mean", bytemuck::cast_slice(&mean))?,
            superpoint_of_gaussian: with("superpoint_of_gaussian", bytemuck::cast_slice(&self.case.of_gaussian))?,
            pose: Slice::from(self.gpu.buffer("pose", 32 * m as u64, Memory::Device)?),
        })
    }

    fn state(&self, form: PropertyLoss) -> Result<SuperpointState> {
        let case = self.case;
        let association =
            Association { neighbors: case.neighbors, neighbor: case.neighbor.clone(), logit: case.logit.clone() };
        let options = AssociationOptions {
            neighbors: case.neighbors as u32,
            property_loss: form,
            ..AssociationOptions::default()
        };
        SuperpointState::from_parts(self.gpu, &case.position, &association, [&[], &[]], options)
    }

    /// Forward pass of F, association and reductions, backward pass of F.
    fn run(&self, state: &SuperpointState, b: &StepBuffers, pose_gradient: &Slice) -> Result<()> {
        let m = state.superpoints();
        let mut r = self.gpu.recorder("superpoint oracle");
        self.network.record_forward(&mut r, m, &b.step, &Slice::from(&state.position), &b.pose)?;
        state.record_before(&mut r, b)?;
        state.record_reduce_pose(&mut r, b, pose_gradient)?;
        let gradient = Slice::from(&state.gradient);
        let from = Backward {
            step: &b.step,
            counters: &b.counters,
            status: &b.status,
            superpoint_gradient: &gradient,
            plane_stride: m,
        };
        self.network.record_backward(&mut r, m, Output::Gradient, &from)?;
        self.gpu.run(r)?;
        Ok(())
    }

    fn outputs(&self, b: &StepBuffers, out: &mut Results) -> Result<()> {
        let (n, m) = self.counts();
        let pose = floats(self.gpu, &b.pose.buffer, 8 * m)?;
        let vectors = |first: usize| pose.chunks_exact(8).flat_map(|p| p[first..first + 3].to_vec()).collect();
        out.outputs.insert("out_rotation", vectors(0));
        out.outputs.insert("out_translation", vectors(4));
        let values = self.gpu.buffer("property_value", 36 * n as u64, Memory::Device)?;
        let mut r = self.gpu.recorder("moved means");
        let buffers = PropertyValuesBuffers {
            step: b.step.clone(),
            mean: b.mean.clone(),
            superpoint_of_gaussian: b.superpoint_of_gaussian.clone(),
            pose: b.pose.clone(),
            property_value: values.whole(),
        };
        let groups = engine::gpu::Groups::Direct((n as u64).div_ceil(256));
        r.dispatch(&PROPERTY_VALUES, (), (), buffers, groups)?;
        self.gpu.run(r)?;
        let values = floats(self.gpu, &values, 9 * n)?;
        out.outputs.insert("out_mean_t", values.chunks_exact(9).flat_map(|row| row[..3].to_vec()).collect());
        Ok(())
    }
}

pub(super) fn results(gpu: &Gpu, case: &Case) -> Result<Results> {
    let device = Device { gpu, case, network: NetworkF::new(gpu, &case.network, case.position.len() as u32)? };
    let (n, _) = device.counts();
    let mut out = Results::default();

    let motion = reference::motion(case);
    let planes: Vec<f32> = (0..6).flat_map(|c| motion.tangent.iter().map(move |t| t[c / 3][c % 3] as f32)).collect();
    let pose_gradient = Slice::from(gpu.buffer_with("pose_gradient", bytemuck::cast_slice(&planes))?);
    let state = device.state(PropertyLoss::Off)?;
    let buffers = device.step_buffers([0.0; 3])?;
    device.run(&state, &buffers, &pose_gradient)?;
    device.outputs(&buffers, &mut out)?;
    let network = tensors(&device.network.download_gradient()?);
    out.gradients.insert("motion", Gradients { network, ..Gradients::default() });

    let none = Slice::from(gpu.buffer_with("pose_gradient", &vec![0; 24 * n])?);
    for (name, form, lambda) in FORMS {
        let state = device.state(form)?;
        let buffers = device.step_buffers(lambda)?;
        device.run(&state, &buffers, &none)?;
        out.losses.extend(loss_names(name).into_iter().zip(floats(gpu, &state.property_loss, 3)?));
        let [moment, _] = state.download_moments(gpu)?;
        let mean = match state.mean_gradient() {
            Some(gradient) => Some(rows(&floats(gpu, gradient, 3 * n)?)),
            None => None,
        };
        let gradients = Gradients {
            mean,
            rotation: None,
            logit: Some(moment.into_iter().map(f64::from).collect()),
            network: tensors(&device.network.download_gradient()?),
        };
        out.gradients.insert(name, gradients);
    }
    Ok(out)
}
