//! Superpoints, network F and the association.

use serde::{Deserialize, Serialize};

use super::Form;
use crate::scene::DeformSize;

/// How network F's rotation output is understood.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RotationForm {
    /// An so(3) vector r: μ(t) = Exp(r)μ + τ, R(t) = Exp(r)R.
    #[default]
    So3,
}

/// Superpoints, network F and the association.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MotionConfig {
    /// Off: the scene is trained as plain 3DGS. A data set with one time only is always trained so.
    pub enabled: bool,
    /// Superpoints M. Paper: not stated (ablation 50–500); code: 300, the default.
    pub superpoints: u32,
    /// How a superpoint turns its Gaussians. Paper: a transform of the Lie algebra; code since 2025: so(3) vectors, the only
    /// value here. The code's earlier form (`quaternion_add`: a quaternion added to each Gaussian's own, centres not turned)
    /// is no rigid motion, so the model file's key-time table cannot hold what it learns.
    pub rotation: RotationForm,
    /// Superpoints that a Gaussian moves with, 1 to 4. 1: its own one only (paper and code). More: soft superpoints, weighted by
    /// the softmax of its association with the nearest; `neighbors` is then this number.
    pub blend: u32,
    /// Superpoints K that a Gaussian is associated with. Paper: not stated (ablation 1–6); code: 5, the default.
    pub neighbors: u32,
    /// Slots per Gaussian that remember association values, ≥ `neighbors`: a superpoint that leaves the neighbourhood and
    /// comes back finds its value as long as its slot was not needed.
    pub association_slots: u32,
    /// First association values. Paper: 0.9 for the Gaussian's own superpoint, 0.1 else; code: 1.0 and 0.1. Default code: it
    /// made the published numbers.
    pub association_init: Form,
    /// Whether network F's heads start at zero, so that motion starts from rest. Paper: yes; code: no (its initialiser is
    /// never called). Default yes: a canonical space that already fits is not thrown away at the end of warm-up.
    pub zero_heads: bool,
    /// Hidden layers of network F, 1 to 8, and their width, a multiple of 32 up to 256. Paper and code: 8 layers of 256, the
    /// default; the paper's ablation loses 0.3 dB with 8 of 128.
    pub network_layers: u32,
    /// See `network_layers`.
    pub network_width: u32,
    /// Steps over which network F's weights are averaged for all that is looked at: evaluations, the model, the viewer. The network
    /// that is trained keeps its own. Scaled with the schedule. Not in paper or code. 0: off.
    pub network_mean: u64,
    /// Noise on time (annealed smooth training). Paper: not mentioned; code: yes unless `--is_blender`. Default yes for real
    /// captures, no for synthetic data (see the presets), where times are exact.
    pub time_noise: bool,
    /// Whether objects that the static warm-up loses are looked for: what goes far beyond its size in the course of the photos
    /// is otherwise never found. When motion begins, one, where cut-out photos show that something is missing; before the last
    /// iterations without network F ([`RefitConfig`](super::RefitConfig)), where photos differ from the images, unless
    /// each has an exposure of its own. Not in paper or code.
    pub lost_objects: bool,
    /// Size of that noise at the start, in units of the frame spacing (code: 0.1).
    pub time_noise_scale: f64,
}

impl MotionConfig {
    /// Whether several superpoints move a Gaussian together.
    pub fn is_soft(&self) -> bool {
        self.blend > 1
    }

    /// Superpoints in use per Gaussian.
    pub fn neighbors_in_use(&self) -> u32 {
        if self.is_soft() { self.blend } else { self.neighbors }
    }

    /// How large network F is.
    pub fn network_size(&self) -> DeformSize {
        DeformSize { layers: self.network_layers as usize, width: self.network_width as usize }
    }
}
