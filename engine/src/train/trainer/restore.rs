//! What a run goes on from and what it leaves: checkpoints, scenes, poses.

use super::{Moving, Nonrigid, Trainer, TrainingData};
use crate::error::Result;
use crate::gpu::{Gpu, Memory, Slice};
use crate::scene::{Motion, NonrigidNetwork, Scene};
use crate::train::association::SuperpointState;
use crate::train::checkpoint::{Checkpoint, MotionState, NetworkState};
use crate::train::config::Config;
use crate::train::network_f::NetworkF;
use crate::train::network_g::NetworkG;
use crate::train::parameters::ParameterState;
use crate::train::schedule::Stage;
use crate::train::step::Step;

impl Trainer {
    /// Goes on from a checkpoint.
    ///
    /// # Errors
    /// As [`Trainer::new`].
    pub fn resume(gpu: &Gpu, data: &TrainingData, checkpoint: &Checkpoint) -> Result<Self> {
        let c = checkpoint;
        let mut trainer = Self::assemble(gpu, &c.config, data, c.stage, c.iteration, &c.parameters)?;
        trainer.restore_motion(c)?;
        if let Some(g) = &c.nonrigid {
            trainer.set_nonrigid(&g.nonrigid()?)?;
            if let Some(own) = &trainer.nonrigid {
                own.network.upload_moments([&g.moment_1, &g.moment_2])?;
            }
        }
        Ok(trainer)
    }

    /// Begins the non-rigid stage on a trained model: all Gaussians and network G are trained, network F and the association
    /// are not. Moments start at zero.
    ///
    /// # Errors
    /// As [`Trainer::new`].
    pub fn nonrigid(gpu: &Gpu, config: &Config, data: &TrainingData, trained: &Checkpoint) -> Result<Self> {
        let state = ParameterState {
            superpoint_of_gaussian: trained.parameters.superpoint_of_gaussian.clone(),
            ..ParameterState::new(&trained.parameters.gaussians, trained.parameters.gaussians.sh_degree)
        };
        let mut trainer = Self::assemble(gpu, config, data, Stage::Nonrigid, 0, &state)?;
        trainer.restore_motion(trained)?;
        let mut network = NonrigidNetwork::init(config.seed);
        if !config.nonrigid.scale {
            network.scaling.weight.fill(0.0);
        }
        trainer.set_nonrigid(&network)?;
        Ok(trainer)
    }

    fn set_nonrigid(&mut self, network: &NonrigidNetwork) -> Result<()> {
        let n = self.parameters.count().max(1);
        let buffer = |name: &str| self.gpu.buffer(name, u64::from(n) * 40, Memory::Device);
        let (offset, gradient) = (buffer("nonrigid_offset")?, buffer("nonrigid_gradient")?);
        let network = NetworkG::new(&self.gpu, network, n)?.with_scale(self.config.nonrigid.scale);
        self.nonrigid = Some(Nonrigid { network, offset, gradient });
        Ok(())
    }

    fn restore_motion(&mut self, checkpoint: &Checkpoint) -> Result<()> {
        let gpu = self.gpu.clone();
        if let Some(m) = &checkpoint.motion {
            let [first, second] = &m.association_moments;
            let options = self.association_options();
            let superpoints = SuperpointState::from_parts(&gpu, &m.position, &m.association, [first, second], options)?;
            let network =
                NetworkF::new(&gpu, &m.network.deform(self.config.motion.network_size())?, m.position.len() as u32)?;
            network.upload_moments([&m.network.moment_1, &m.network.moment_2])?;
            self.set_motion(superpoints, network)?;
        }
        Ok(())
    }

    /// Everything that the next step depends on.
    ///
    /// # Errors
    /// `NonFinite` when a number has gone bad: that is no state to go on from; `DeviceLost`, `OutOfMemory`.
    pub fn checkpoint(&self) -> Result<Checkpoint> {
        self.check_numbers()?;
        let motion = self.moving.as_ref().map(|m| self.motion_state(m)).transpose()?;
        Ok(Checkpoint {
            config: self.config.clone(),
            stage: self.schedule.stage(),
            iteration: self.iteration,
            parameters: self.parameters.download(&self.gpu)?,
            motion,
            nonrigid: self.nonrigid.as_ref().map(nonrigid_state).transpose()?,
        })
    }

    fn motion_state(&self, m: &Moving) -> Result<MotionState> {
        let of_gaussian = Slice::from(&self.parameters.scene.superpoint_of_gaussian);
        let (superpoints, association) = m.superpoints.download(&self.gpu, &of_gaussian)?;
        let [moment_1, moment_2] = m.network.download_moments()?;
        Ok(MotionState {
            position: superpoints.position,
            association,
            association_moments: m.superpoints.download_moments(&self.gpu)?,
            network: NetworkState { weights: m.network.download()?.flatten(), moment_1, moment_2 },
        })
    }

    /// The scene as it is: Gaussians at the SH degree in use, superpoints, association, network F.
    ///
    /// # Errors
    /// `DeviceLost`, `OutOfMemory`.
    pub fn scene(&self) -> Result<Scene> {
        let degree = self.schedule.sh_degree(self.iteration.max(1)).min(self.parameters.sh_degree);
        let gaussians =
            crate::train::parameters::with_sh_degree(&self.parameters.download_gaussians(&self.gpu)?, degree);
        let mut scene = Scene { gaussians, ..Scene::default() };
        if let Some(m) = &self.moving {
            let of_gaussian = Slice::from(&self.parameters.scene.superpoint_of_gaussian);
            let (superpoints, association) = m.superpoints.download(&self.gpu, &of_gaussian)?;
            scene.superpoints = Some(superpoints);
            // Those in use come first; the rest are remembered for training, or were never there.
            scene.association = Some(association.first(m.superpoints.neighbors() as usize));
            scene.deform = Some(m.network.download()?);
        }
        scene.nonrigid = self.nonrigid.as_ref().map(|g| g.network.download()).transpose()?;
        Ok(scene)
    }

    /// Poses of network F at `times`, as a table; `None` before motion begins.
    ///
    /// # Errors
    /// `DeviceLost`, `OutOfMemory`.
    pub fn motion_at(&self, times: &[f32]) -> Result<Option<Motion>> {
        let Some(m) = &self.moving else { return Ok(None) };
        let count = m.superpoints.superpoints();
        let mut motion = Motion { times: times.to_vec(), ..Motion::default() };
        let mut r = self.gpu.recorder("poses");
        let position = Slice::from(&m.superpoints.position);
        m.network.record_forward(&mut r, count, &Slice::from(&self.step), &position, &Slice::from(&m.pose))?;
        let mut commands = r.finish()?;
        for &time in times {
            let step = Step { superpoints: count, time, exact_time: time, ..Step::default() };
            self.step.write(0, bytemuck::bytes_of(&step))?;
            self.gpu.submit(&mut commands)?;
            self.gpu.wait_for(&commands)?;
            let poses: Vec<[f32; 4]> = bytemuck::pod_collect_to_vec(&self.gpu.download(&m.pose)?);
            for pair in poses.chunks_exact(2).take(count as usize) {
                motion.rotation.push([pair[0][0], pair[0][1], pair[0][2]]);
                motion.translation.push([pair[1][0], pair[1][1], pair[1][2]]);
            }
        }
        Ok(Some(motion))
    }
}

fn nonrigid_state(g: &Nonrigid) -> Result<NetworkState> {
    let [moment_1, moment_2] = g.network.download_moments()?;
    Ok(NetworkState { weights: g.network.download()?.flatten(), moment_1, moment_2 })
}
