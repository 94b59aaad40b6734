//! Superpoints, their association with Gaussians and network F under training.

use super::super::association::nearest_superpoints::softmax;
use super::super::association::{
    AssociationInit, AssociationOptions, Rows as AssociationRows, StepBuffers, SuperpointState,
};
use super::super::config::{Config, Form};
use super::super::density::{NewRows, RowArray};
use super::super::linear::Output;
use super::super::lost::path::{self, FollowedPath, Path};
use super::super::network_f::{Backward, NetworkF};
use super::super::property_loss::PropertyLoss;
use super::super::saved::{NetworkState, Saved, Stored};
use super::super::step::Step;
use super::super::usage::TrainingMemory;
use super::{Numbers, ProjectInputs, Rows, StepInputs, Trained, TrainedDeformation, network_numbers};
use crate::error::{Error, Result};
use crate::gpu::{Buffer, Gpu, Memory, Recorder, Slice};
use crate::render::deformation::{DeformationBuffers, Poses};
use crate::render::scene_buffers::SceneBuffers;
use crate::scene::parameter::MEAN;
use crate::scene::{Association, Blend, DeformNetwork, Deformation, Motion, SuperpointDeformation, Superpoints};

/// Its name in a checkpoint.
const NETWORK_MEAN: &str = "network_f.mean";

/// The model on the device.
#[derive(Debug)]
pub(super) struct SuperpointTraining {
    superpoints: SuperpointState,
    network: NetworkF,
    pose: Buffer,
    /// Of an object that was found lost; network F learns what is left.
    path: Option<FollowedPath>,
}

fn association_options(config: &Config) -> AssociationOptions {
    let m = &config.motion;
    AssociationOptions {
        superpoints: m.superpoints,
        neighbors: m.neighbors_in_use(),
        soft: m.is_soft(),
        slots: m.association_slots,
        init: match m.association_init {
            Form::Code => AssociationInit::Code,
            Form::Paper => AssociationInit::Paper,
        },
        property_loss: match config.loss.prop_loss {
            Form::Code => PropertyLoss::Code,
            Form::Paper => PropertyLoss::Paper,
        },
        seed: config.seed,
    }
}

/// Soft superpoints as [`nearest_superpoints`](super::super::association::nearest_superpoints) makes them.
fn blend_of(association: &Association) -> Blend {
    let neighbors = association.neighbors.max(1);
    let rows = association.logit.chunks_exact(neighbors);
    // Numbers that are not finite ended the run before.
    let weight = rows.flat_map(|row| softmax(row).unwrap_or_else(|| vec![1.0; neighbors])).collect();
    Blend { neighbors, index: association.neighbor.clone(), weight }
}

/// What a checkpoint holds of it.
struct State {
    /// `[M,3]` canonical centres.
    position: Vec<[f32; 3]>,
    /// Association rows with K' slots.
    association: Association,
    /// Moments of the logits, `[N,K']` each.
    association_moments: [Vec<f32>; 2],
    /// Network F.
    network: NetworkState,
    /// Mean of its weights, where one is kept.
    network_mean: Option<Vec<f32>>,
}

impl State {
    fn write(&self, saved: &mut Saved) {
        let shape =
            || vec![self.association.neighbor.len() / self.association.neighbors.max(1), self.association.neighbors];
        saved.put_floats("superpoint_position", vec![self.position.len(), 3], self.position.as_flattened());
        saved.put_indices("neighbor", shape(), &self.association.neighbor);
        saved.put_floats("logit", shape(), &self.association.logit);
        saved.put_floats("logit_moment_1", shape(), &self.association_moments[0]);
        saved.put_floats("logit_moment_2", shape(), &self.association_moments[1]);
        saved.put_network("network_f", &self.network);
        if let Some(mean) = &self.network_mean {
            saved.put_floats(NETWORK_MEAN, vec![mean.len()], mean);
        }
    }

    /// `None` before motion begins.
    fn read(stored: &Stored<'_>) -> Result<Option<Self>> {
        let (saved, n) = (stored.saved, stored.parameters.gaussians.len());
        if !saved.has("superpoint_position") {
            return Ok(None);
        }
        let neighbor = saved.indices("neighbor", None)?;
        let count = Some(neighbor.len());
        let association =
            Association { neighbors: neighbor.len() / n.max(1), neighbor, logit: saved.floats("logit", count)? };
        Ok(Some(Self {
            position: saved.floats("superpoint_position", None)?.as_chunks().0.to_vec(),
            association,
            association_moments: [saved.floats("logit_moment_1", count)?, saved.floats("logit_moment_2", count)?],
            network: saved.network("network_f")?,
            network_mean: saved.has(NETWORK_MEAN).then(|| saved.floats(NETWORK_MEAN, None)).transpose()?,
        }))
    }

    /// Network F as it is looked at: with the mean of its weights, where one is kept.
    fn network_to_show(&self, config: &Config) -> Result<DeformNetwork> {
        let size = config.motion.network_size();
        self.network_mean
            .as_ref()
            .map_or_else(|| self.network.deform(size), |mean| DeformNetwork::from_flat(mean, size))
    }
}

/// The model that a checkpoint holds, without the association; `None` before motion begins.
pub(super) fn of_checkpoint(stored: &Stored<'_>) -> Result<Deformation> {
    let Some(state) = State::read(stored)? else { return Ok(Deformation::None) };
    // What follows a path is where network F does not say: the checkpoint has a table then.
    let table = table_of(stored.saved, state.position.len())?;
    let network = state.network_to_show(stored.config)?;
    let network = table.is_none().then_some(network);
    let of_gaussian = stored.parameters.superpoint_of_gaussian.clone();
    let superpoints = Superpoints { of_gaussian, position: state.position };
    Ok(SuperpointDeformation { superpoints, network, table, ..SuperpointDeformation::default() }.into())
}

/// The key-time table of a checkpoint in which superpoints follow a path.
fn table_of(saved: &Saved, superpoints: usize) -> Result<Option<Motion>> {
    let Some(times) = path::times_of(saved)? else { return Ok(None) };
    let values = Some(3 * superpoints * times.len());
    let rotation = saved.floats("path.table_rotation", values)?.as_chunks().0.to_vec();
    let translation = saved.floats("path.table_translation", values)?.as_chunks().0.to_vec();
    Ok(Some(Motion { times, rotation, translation }))
}

impl SuperpointTraining {
    /// Samples superpoints from the Gaussians as they are and starts network F; those that belong to the path follow it.
    pub(super) fn begin(gpu: &Gpu, config: &Config, scene: &SceneBuffers, path: Option<Path>) -> Result<Self> {
        let superpoints = SuperpointState::init(
            gpu,
            &Slice::from(&scene.parameter[MEAN]),
            &Slice::from(&scene.deformation.superpoint_of_gaussian),
            scene.gaussians,
            association_options(config),
        )?;
        let weights = DeformNetwork::init(config.seed, config.motion.network_size(), config.motion.zero_heads);
        let network = Self::network(gpu, config, &weights, superpoints.superpoints())?;
        let follow = |path: Path| {
            let position: Vec<f32> = bytemuck::pod_collect_to_vec(&gpu.download(&superpoints.position)?);
            FollowedPath::new(gpu, path, position.as_chunks().0)
        };
        let path = path.map(follow).transpose()?;
        Ok(Self { path, ..Self::new(gpu, superpoints, network)? })
    }

    /// Goes on from a checkpoint; `None` before motion begins.
    pub(super) fn restore(gpu: &Gpu, config: &Config, stored: &Stored<'_>) -> Result<Option<Self>> {
        let Some(saved) = State::read(stored)? else { return Ok(None) };
        let [first, second] = &saved.association_moments;
        let options = association_options(config);
        let superpoints =
            SuperpointState::from_parts(gpu, &saved.position, &saved.association, [first, second], options)?;
        let weights = saved.network.deform(config.motion.network_size())?;
        let network = Self::network(gpu, config, &weights, saved.position.len() as u32)?;
        network.upload_moments([&saved.network.moment_1, &saved.network.moment_2])?;
        network.upload_mean(&saved.network_to_show(config)?)?;
        let path = FollowedPath::restore(gpu, stored.saved, saved.position.len())?;
        Ok(Some(Self { path, ..Self::new(gpu, superpoints, network)? }))
    }

    /// A checkpoint's model for a stage that does not train it: network F has the mean of its weights, where one was kept.
    pub(super) fn frozen(gpu: &Gpu, config: &Config, stored: &Stored<'_>) -> Result<Option<Self>> {
        let (Some(saved), Some(made)) = (State::read(stored)?, Self::restore(gpu, config, stored)?) else {
            return Ok(None);
        };
        made.network.upload(&saved.network_to_show(config)?)?;
        Ok(Some(made))
    }

    /// Network F with these weights, and a mean of them where the configuration has one kept.
    fn network(gpu: &Gpu, config: &Config, weights: &DeformNetwork, superpoints: u32) -> Result<NetworkF> {
        let network = NetworkF::new(gpu, weights, superpoints)?;
        let steps = config.scaled().motion.network_mean;
        if steps > 0 { network.with_mean(steps) } else { Ok(network) }
    }

    fn new(gpu: &Gpu, superpoints: SuperpointState, network: NetworkF) -> Result<Self> {
        let pose = gpu.buffer("pose", u64::from(superpoints.superpoints()) * 32, Memory::Device)?;
        Ok(Self { superpoints, network, pose, path: None })
    }

    /// Poses at the times of the path; `None` where nothing follows one.
    fn table_along_path(&self, gpu: &Gpu) -> Result<Option<Motion>> {
        let Some(path) = &self.path else { return Ok(None) };
        let step = gpu.buffer("path step", size_of::<Step>() as u64, Memory::Constants)?;
        self.table_at(gpu, &step, path.times())
    }

    /// Records poses, with the mean of network F's weights where they are not for a step.
    fn record_poses(&self, r: &mut Recorder, step: &Buffer, for_step: bool) -> Result<()> {
        let (position, count) = (Slice::from(&self.superpoints.position), self.superpoints.superpoints());
        let (step, pose) = (Slice::from(step), Slice::from(&self.pose));
        if for_step {
            self.network.record_forward(r, count, &step, &position, &pose)?;
        } else {
            self.network.record_mean(r, count, &step, &position, &pose)?;
        }
        self.path.as_ref().map_or(Ok(()), |path| path.record(r, &step, &pose))
    }

    fn step_buffers(inputs: &StepInputs<'_>) -> StepBuffers {
        StepBuffers {
            step: Slice::from(inputs.step),
            counters: inputs.counters.clone(),
            failed: Slice::from(inputs.failed),
            status: Slice::from(inputs.status_beside),
            mean: Slice::from(&inputs.scene.parameter[MEAN]),
            superpoint_of_gaussian: Slice::from(&inputs.scene.deformation.superpoint_of_gaussian),
            pose: Slice::from(&inputs.scene.deformation.pose),
        }
    }
}

impl TrainedDeformation for SuperpointTraining {
    fn attach(&self, buffers: &mut DeformationBuffers) {
        buffers.superpoints = self.superpoints.superpoints();
        buffers.poses = Poses::Given;
        buffers.pose = self.pose.clone();
        buffers.blend = self.superpoints.blend();
    }

    fn record_forward(&self, r: &mut Recorder, inputs: &StepInputs<'_>) -> Result<()> {
        self.record_poses(r, inputs.step, true)?;
        self.superpoints.record_blend(r, &Self::step_buffers(inputs))
    }

    fn record_before_loss(&self, r: &mut Recorder, inputs: &StepInputs<'_>) -> Result<()> {
        self.superpoints.record_before(r, &Self::step_buffers(inputs))
    }

    fn record_backward(&self, r: &mut Recorder, inputs: &StepInputs<'_>) -> Result<()> {
        let shared = Self::step_buffers(inputs);
        self.superpoints.record_reduce_pose(r, &shared, &Slice::from(inputs.pose_gradient))?;
        let count = self.superpoints.superpoints();
        let backward = Backward {
            step: &shared.step,
            counters: &shared.counters,
            status: &Slice::from(inputs.status),
            superpoint_gradient: &Slice::from(&self.superpoints.gradient),
            plane_stride: count,
        };
        self.network.record_backward(r, count, Output::Adam, &backward)?;
        self.superpoints.record_commit(r, &shared)
    }

    fn project_inputs(&self) -> ProjectInputs<'_> {
        // The paper's form of the property losses pulls at the centres too.
        ProjectInputs { mean_gradient: self.superpoints.mean_gradient(), ..ProjectInputs::default() }
    }

    fn property_loss(&self) -> Option<&Buffer> {
        Some(&self.superpoints.property_loss)
    }

    fn association(&self) -> Option<&AssociationOptions> {
        Some(self.superpoints.options())
    }

    fn numbers(&self) -> Vec<Numbers> {
        let (rows, count) = (self.superpoints.rows(), self.superpoints.gaussians() * self.superpoints.options().slots);
        let mut all = vec![
            ("association logit", Slice::from(&rows.logit), count),
            ("association moment_1", Slice::from(&rows.moment_1), count),
            ("association moment_2", Slice::from(&rows.moment_2), count),
            ("superpoint position", Slice::from(&self.superpoints.position), 3 * self.superpoints.superpoints()),
        ];
        all.extend(network_numbers(
            ["network F weight", "network F moment_1", "network F moment_2"],
            self.network.state(),
        ));
        all
    }

    fn density_rows(&self) -> Vec<RowArray> {
        let (rows, width) = (self.superpoints.rows(), self.superpoints.options().slots);
        let row = |buffer: &Buffer, new_rows| RowArray { buffer: buffer.clone(), planes: 1, width, new_rows };
        vec![
            row(&rows.neighbor, NewRows::Copy),
            row(&rows.logit, NewRows::Copy),
            row(&rows.moment_1, NewRows::Zero),
            row(&rows.moment_2, NewRows::Zero),
        ]
    }

    fn bytes_per_gaussian(&self) -> u64 {
        let options = self.superpoints.options();
        32 * u64::from(options.slots) + 40 * u64::from(options.blend_slots())
    }

    fn resized(mut self: Box<Self>, gpu: &Gpu, gaussians: u32, rows: &mut Rows<'_>) -> Result<Option<Trained>> {
        if gaussians == 0 {
            return Ok(None);
        }
        let mut next = || rows.next().ok_or_else(|| Error::usage("density control", "too few arrays", "all of them"));
        let rows = AssociationRows { neighbor: next()?, logit: next()?, moment_1: next()?, moment_2: next()? };
        self.superpoints.resize(gpu, gaussians, rows)?;
        Ok(Some(self))
    }

    fn add_memory(&self, used: &mut TrainingMemory) {
        let rows = self.superpoints.rows();
        used.parameters += self.superpoints.position.bytes() + rows.neighbor.bytes() + rows.logit.bytes();
        used.moments += rows.moment_1.bytes() + rows.moment_2.bytes();
        used.gradients += self.superpoints.gradient.bytes();
        used.parameters += self.path.as_ref().map_or(0, FollowedPath::bytes);
        used.add_network(self.network.bytes()[0]);
    }

    fn download(&self, gpu: &Gpu, scene: &SceneBuffers) -> Result<Deformation> {
        let of_gaussian = Slice::from(&scene.deformation.superpoint_of_gaussian);
        let (mut superpoints, association) = self.superpoints.download(gpu, &of_gaussian)?;
        // Neighbours in use come first; the rest are remembered for training, or were never there.
        let association = association.first(self.superpoints.neighbors() as usize);
        let blend = self.superpoints.blend().map(|_| blend_of(&association));
        if let Some(blend) = &blend {
            superpoints.of_gaussian = blend.of_gaussian();
        }
        let table = self.table_along_path(gpu)?;
        let network = if table.is_none() { Some(self.network.download_mean()?) } else { None };
        Ok(Deformation::from(SuperpointDeformation {
            superpoints,
            blend,
            table,
            network,
            association: Some(association),
            ..SuperpointDeformation::default()
        }))
    }

    fn save(&self, gpu: &Gpu, scene: &SceneBuffers, saved: &mut Saved) -> Result<()> {
        let of_gaussian = Slice::from(&scene.deformation.superpoint_of_gaussian);
        let (superpoints, association) = self.superpoints.download(gpu, &of_gaussian)?;
        let [moment_1, moment_2] = self.network.download_moments()?;
        let state = State {
            position: superpoints.position,
            association,
            association_moments: self.superpoints.download_moments(gpu)?,
            network: NetworkState { weights: self.network.download()?.flatten(), moment_1, moment_2 },
            network_mean: self
                .network
                .has_mean()
                .then(|| self.network.download_mean())
                .transpose()?
                .map(|n| n.flatten()),
        };
        state.write(saved);
        if let (Some(path), Some(table)) = (&self.path, self.table_along_path(gpu)?) {
            path.save(saved);
            let shape = || vec![table.times.len(), table.rotation.len() / table.times.len().max(1), 3];
            saved.put_floats("path.table_rotation", shape(), table.rotation.as_flattened());
            saved.put_floats("path.table_translation", shape(), table.translation.as_flattened());
        }
        Ok(())
    }

    fn table_at(&self, gpu: &Gpu, step_buffer: &Buffer, times: &[f32]) -> Result<Option<Motion>> {
        let count = self.superpoints.superpoints();
        let mut motion = Motion { times: times.to_vec(), ..Motion::default() };
        let mut r = gpu.recorder("poses");
        self.record_poses(&mut r, step_buffer, false)?;
        let mut commands = r.finish()?;
        for &time in times {
            let step = Step { superpoints: count, time, exact_time: time, ..Step::default() };
            step_buffer.write(0, bytemuck::bytes_of(&step))?;
            gpu.submit(&mut commands)?;
            gpu.wait_for(&commands)?;
            let poses: Vec<[f32; 4]> = bytemuck::pod_collect_to_vec(&gpu.download(&self.pose)?);
            for pair in poses.chunks_exact(2).take(count as usize) {
                motion.rotation.push([pair[0][0], pair[0][1], pair[0][2]]);
                motion.translation.push([pair[1][0], pair[1][1], pair[1][2]]);
            }
        }
        Ok(Some(motion))
    }
}
