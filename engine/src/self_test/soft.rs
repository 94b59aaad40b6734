//! Several superpoints that move a Gaussian together.

use super::frame::{BACKGROUND, SEED, scene, watched_frames};
use crate::error::Result;
use crate::gpu::Gpu;
use crate::render::RenderOptions;
use crate::scene::NonrigidNetwork;
use crate::scene::synthetic::random_blend;

/// Superpoints of a Gaussian: an odd number leaves half a word of the last pair.
const NEIGHBORS: usize = 3;

/// Frames with network G after soft superpoints, each dispatch against its twin.
pub(super) fn test(gpu: &Gpu) -> Result<()> {
    let mut scene = scene();
    let gaussians = scene.gaussians.len();
    if let Some(s) = scene.deformation.superpoint_deformation_mut() {
        let blend = random_blend(gaussians, s.superpoints.position.len(), NEIGHBORS, SEED);
        s.superpoints.of_gaussian = blend.of_gaussian();
        s.blend = Some(blend);
        s.nonrigid = Some(NonrigidNetwork::init(SEED));
    }
    watched_frames(gpu, &scene, &RenderOptions { background: BACKGROUND, ..RenderOptions::default() })
}
