//! What a training step moves and keeps: amounts of work for the roofline, device memory by purpose.

use super::target::Target;
use super::trainer::{StepReport, Trainer};
use crate::gpu::kernel::Workload;
use crate::gpu::{Buffer, Commands};
use crate::render::limits::TILE_SIZE;

/// Device memory of a training run by purpose, bytes.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize)]
pub struct TrainingMemory {
    /// What is learnt: Gaussians, association, weights of the networks; with the Gaussians' superpoints and their poses.
    pub parameters: u64,
    /// Adam's two moments of each.
    pub moments: u64,
    /// Gradients of what is learnt and of the splats, rows of tile instances included. (The Gaussians' own gradients are
    /// never stored: Adam is fused into the kernel that computes them.)
    pub gradients: u64,
    /// Images: photos, rendering, its gradient, intermediate maps of the loss.
    pub images: u64,
    /// Everything else: sort arrays, tile instances, splats, activations, statistics.
    pub other: u64,
}

impl TrainingMemory {
    /// Optimiser state and gradients in units of the parameters.
    pub fn state_ratio(&self) -> f64 {
        (self.moments + self.gradients) as f64 / self.parameters.max(1) as f64
    }

    /// All of it.
    pub fn total(&self) -> u64 {
        self.parameters + self.moments + self.gradients + self.images + self.other
    }
}

impl Trainer {
    /// A recording of the last step's image size; `None` before the first step.
    pub fn commands(&self) -> Option<&Commands> {
        self.targets.last().and_then(Target::recorded)
    }

    /// Amounts of work of a step, from which kernels derive the bytes that they move.
    pub fn workload(&self, step: &StepReport) -> Workload {
        let size = self.targets.last().map_or([0, 0], |t| t.size);
        let tiles = u64::from(size[0].div_ceil(TILE_SIZE)) * u64::from(size[1].div_ceil(TILE_SIZE));
        let degree = u64::from(self.parameters.scene.sh_degree);
        let has_offsets = self.deformation.as_ref().is_some_and(|m| m.project_inputs().offset.is_some());
        let association = self.association();
        Workload(
            [
                ("gaussians", u64::from(step.gaussians)),
                ("superpoints", u64::from(step.superpoints)),
                ("visible", u64::from(step.visible)),
                ("instances", step.instances),
                ("tiles", tiles),
                ("pixels", u64::from(size[0]) * u64::from(size[1])),
                ("sh_degree", degree),
                ("sh_coefficients", (degree + 1) * (degree + 1)),
                ("sh_bytes", 12 * (degree + 1) * (degree + 1)),
                ("mean_bytes", 12),
                ("optional_bytes", 4 * u64::from(self.parameters.scene.present.planes())),
                ("splat_bytes", 48),
                ("moving", u64::from(self.parameters.scene.deformation.moves())),
                ("nonrigid", u64::from(has_offsets)),
                ("neighbors", association.map_or(0, |a| a.neighbors.into())),
                ("slots", association.map_or(0, |a| a.slots.into())),
            ]
            .into_iter()
            .collect(),
        )
    }

    /// Device memory by purpose; what other users of the same device hold counts as "other".
    pub fn memory(&self) -> TrainingMemory {
        let (p, sum) = (&self.parameters, |list: &[&Buffer]| list.iter().map(|b| b.bytes()).sum::<u64>());
        let mut used = TrainingMemory {
            parameters: p.scene.bytes(),
            images: self.photos.bytes(),
            moments: sum(&[&p.moment_1, &p.moment_2]),
            gradients: sum(&[&self.splat_gradient, &self.pose_gradient]),
            ..TrainingMemory::default()
        };
        if let Some(model) = &self.deformation {
            model.add_memory(&mut used);
        }
        for t in &self.targets {
            used.gradients += t.instance_gradient.as_ref().map_or(0, Buffer::bytes);
            used.images += t.frames[0].color.bytes() + t.image_gradient.bytes() + t.image_loss.bytes();
            used.images += t.shape.states.as_ref().map_or(0, |s| s.buffer.bytes);
        }
        used.other = self.gpu.memory_used().0.saturating_sub(used.total());
        used
    }
}

impl TrainingMemory {
    /// A network's weights with their moments, `bytes` together, and a gradient of the weights' size.
    pub(super) fn add_network(&mut self, bytes: u64) {
        self.parameters += bytes / 3;
        self.moments += bytes - bytes / 3;
        self.gradients += bytes / 3;
    }
}
