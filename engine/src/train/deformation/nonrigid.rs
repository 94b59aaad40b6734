//! Network G under training, after superpoints that do not learn any more, or alone.

use super::super::association::AssociationOptions;
use super::super::config::Config;
use super::super::density::RowArray;
use super::super::linear::Output;
use super::super::network_g::{Backward, Inputs, NetworkG};
use super::super::saved::{NetworkState, Saved, Stored};
use super::super::usage::TrainingMemory;
use super::superpoints::SuperpointTraining;
use super::{Numbers, ProjectInputs, Rows, StepInputs, Trained, TrainedDeformation, network_numbers};
use crate::error::Result;
use crate::gpu::{Buffer, Gpu, Memory, Recorder, Slice};
use crate::render::deformation::{DeformationBuffers, Offsets};
use crate::render::scene_buffers::SceneBuffers;
use crate::render::superpoint_motion::BlendSlices;
use crate::scene::parameter::MEAN;
use crate::scene::{Deformation, Motion, NonrigidNetwork};

/// Bytes of network G per Gaussian: offset and its gradient, activations of the chunk it is in.
const BYTES_PER_GAUSSIAN: u64 = 256;
const OFFSET: &str = "nonrigid_offset";
const GRADIENT: &str = "nonrigid_gradient";
/// Its arrays in a checkpoint.
const NETWORK: &str = "network_g";

/// The model on the device.
#[derive(Debug)]
pub(super) struct NonrigidTraining {
    /// What moves the Gaussians before; in this stage network F and the association are frozen.
    frozen: Option<Trained>,
    network: NetworkG,
    offset: Buffer,
    gradient: Buffer,
}

/// `float[10][N]`.
fn planes(gpu: &Gpu, name: &str, gaussians: u32) -> Result<Buffer> {
    gpu.buffer(name, u64::from(gaussians.max(1)) * 40, Memory::Device)
}

/// Slices of [`Inputs`].
struct OwnedInputs {
    slices: [Slice; 4],
    moving: bool,
    blend: Option<BlendSlices>,
}

impl OwnedInputs {
    fn of(inputs: &StepInputs<'_>) -> Self {
        let (scene, moved) = (inputs.scene, &inputs.scene.deformation);
        let buffers = [inputs.frame, &scene.parameter[MEAN], &moved.superpoint_of_gaussian, &moved.pose];
        Self { slices: buffers.map(Slice::from), moving: moved.moves(), blend: moved.blend.clone() }
    }

    fn borrow(&self) -> Inputs<'_> {
        let [frame, mean, superpoint_of_gaussian, pose] = &self.slices;
        Inputs { frame, mean, superpoint_of_gaussian, pose, moving: self.moving, blend: self.blend.as_ref() }
    }
}

/// Network G of a checkpoint; `None` where it is of another stage.
fn saved(stored: &Stored<'_>) -> Result<Option<NetworkState>> {
    let saved = stored.saved;
    saved.has(&format!("{NETWORK}.weights")).then(|| saved.network(NETWORK)).transpose()
}

/// `before`, and network G where a checkpoint holds it.
pub(super) fn of_checkpoint(stored: &Stored<'_>, before: Deformation) -> Result<Deformation> {
    match saved(stored)? {
        Some(network) => before.with_nonrigid(network.nonrigid()?),
        None => Ok(before),
    }
}

impl NonrigidTraining {
    /// Network G after what a trained model moved before. Moments start at zero.
    pub(super) fn begin(gpu: &Gpu, config: &Config, stored: &Stored<'_>, network: &NonrigidNetwork) -> Result<Self> {
        let frozen = SuperpointTraining::frozen(gpu, config, stored)?;
        let gaussians = stored.parameters.gaussians.len() as u32;
        let (offset, gradient) = (planes(gpu, OFFSET, gaussians)?, planes(gpu, GRADIENT, gaussians)?);
        let network = NetworkG::new(gpu, network, gaussians.max(1))?.with_scale(config.nonrigid.scale);
        Ok(Self { frozen: frozen.map(|f| Box::new(f) as Trained), network, offset, gradient })
    }

    /// Goes on from a checkpoint; `None` where it is of another stage.
    pub(super) fn restore(gpu: &Gpu, config: &Config, stored: &Stored<'_>) -> Result<Option<Self>> {
        let Some(saved) = saved(stored)? else { return Ok(None) };
        let made = Self::begin(gpu, config, stored, &saved.nonrigid()?)?;
        made.network.upload_moments([&saved.moment_1, &saved.moment_2])?;
        Ok(Some(made))
    }
}

impl TrainedDeformation for NonrigidTraining {
    fn attach(&self, buffers: &mut DeformationBuffers) {
        if let Some(frozen) = &self.frozen {
            frozen.attach(buffers);
        }
        buffers.offsets = Offsets::Given(Slice::from(&self.offset));
    }

    fn record_forward(&self, r: &mut Recorder, inputs: &StepInputs<'_>) -> Result<()> {
        if let Some(frozen) = &self.frozen {
            frozen.record_forward(r, inputs)?;
        }
        let own = OwnedInputs::of(inputs);
        self.network.record_forward(r, inputs.scene.gaussians, &own.borrow(), &Slice::from(&self.offset))
    }

    fn record_backward(&self, r: &mut Recorder, inputs: &StepInputs<'_>) -> Result<()> {
        let backward = Backward {
            step: &Slice::from(inputs.step),
            counters: inputs.counters,
            status: &Slice::from(inputs.status),
            nonrigid_gradient: &Slice::from(&self.gradient),
        };
        let own = OwnedInputs::of(inputs);
        self.network.record_backward(r, inputs.scene.gaussians, Output::Adam, &own.borrow(), &backward)
    }

    fn project_inputs(&self) -> ProjectInputs<'_> {
        ProjectInputs { offset: Some((&self.offset, &self.gradient)), mean_gradient: None }
    }

    fn association(&self) -> Option<&AssociationOptions> {
        self.frozen.as_ref()?.association()
    }

    fn numbers(&self) -> Vec<Numbers> {
        let mut all = self.frozen.as_ref().map_or(Vec::new(), |f| f.numbers());
        all.extend(network_numbers(
            ["network G weight", "network G moment_1", "network G moment_2"],
            self.network.state(),
        ));
        all
    }

    fn density_rows(&self) -> Vec<RowArray> {
        self.frozen.as_ref().map_or(Vec::new(), |f| f.density_rows())
    }

    fn bytes_per_gaussian(&self) -> u64 {
        BYTES_PER_GAUSSIAN + self.frozen.as_ref().map_or(0, |f| f.bytes_per_gaussian())
    }

    fn resized(mut self: Box<Self>, gpu: &Gpu, gaussians: u32, rows: &mut Rows<'_>) -> Result<Option<Trained>> {
        self.frozen = match self.frozen.take() {
            Some(frozen) => frozen.resized(gpu, gaussians, rows)?,
            None => None,
        };
        self.offset = planes(gpu, OFFSET, gaussians)?;
        self.gradient = planes(gpu, GRADIENT, gaussians)?;
        self.network.grow(gaussians.max(1))?;
        Ok(Some(self))
    }

    fn add_memory(&self, used: &mut TrainingMemory) {
        if let Some(frozen) = &self.frozen {
            frozen.add_memory(used);
        }
        used.gradients += self.gradient.bytes();
        used.add_network(self.network.bytes()[0]);
    }

    fn download(&self, gpu: &Gpu, scene: &SceneBuffers) -> Result<Deformation> {
        let rigid = self.frozen.as_ref().map_or(Ok(Deformation::None), |f| f.download(gpu, scene))?;
        rigid.with_nonrigid(self.network.download()?)
    }

    fn save(&self, gpu: &Gpu, scene: &SceneBuffers, saved: &mut Saved) -> Result<()> {
        if let Some(frozen) = &self.frozen {
            frozen.save(gpu, scene, saved)?;
        }
        let [moment_1, moment_2] = self.network.download_moments()?;
        let weights = self.network.download()?.flatten();
        saved.put_network(NETWORK, &NetworkState { weights, moment_1, moment_2 });
        Ok(())
    }

    fn table_at(&self, gpu: &Gpu, step: &Buffer, times: &[f32]) -> Result<Option<Motion>> {
        self.frozen.as_ref().map_or(Ok(None), |f| f.table_at(gpu, step, times))
    }
}
