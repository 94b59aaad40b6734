//! Networks F and G that run in every frame.

use super::frame::{BACKGROUND, SEED, scene, watched_frames};
use crate::error::Result;
use crate::gpu::Gpu;
use crate::render::RenderOptions;
use crate::scene::{DeformNetwork, DeformSize, MotionSource, NonrigidNetwork};

/// Frames whose poses and offsets come from networks, each dispatch against its twin.
pub(super) fn test(gpu: &Gpu) -> Result<()> {
    let mut scene = scene();
    if let Some(s) = scene.deformation.superpoint_deformation_mut() {
        s.network = Some(DeformNetwork::init(SEED, DeformSize::PAPER, false));
        s.nonrigid = Some(NonrigidNetwork::init(SEED));
    }
    let options = RenderOptions { background: BACKGROUND, motion: MotionSource::Network, ..RenderOptions::default() };
    watched_frames(gpu, &scene, &options)
}
