//! Key poses of superpoints that are trained themselves, with no network behind them: what is [learnt](learn_keys), where they
//! [stand](interpolate_keys) at a step's time, and both in f64 ([`definition`]), which the kernels are measured against.

pub mod definition;
pub mod interpolate_keys;
pub mod learn_keys;
mod state;
pub mod words;

use glam::DVec3;

use crate::error::{Error, Result};
use crate::gpu::kernel::Kernel;
use crate::scene::Motion;

pub(in crate::train) use state::{KeyState, PoseSums};

/// Kernels of this module.
pub static KERNELS: &[&Kernel] = &[&interpolate_keys::INTERPOLATE_KEYS.kernel, &learn_keys::LEARN_KEYS.kernel];

/// Adam's decays: a key is seen in few of the steps, so its second moment follows quickly.
const BETA: [f64; 2] = [0.9, 0.98];
const EPSILON: f64 = 1e-12;
/// Largest turn in one step, radians.
const LARGEST_TURN: f64 = 0.05;

/// Words of a key and a superpoint on the device, `glsl/lib/key_pose.glsl`: rotation vector.
const KEY_ROTATION: usize = 0;
/// Place of the superpoint's centre.
const KEY_PLACE: usize = 3;
/// Both of them as they began.
const KEY_FIRST_ROTATION: usize = 6;
const KEY_FIRST_PLACE: usize = 9;
/// First moments of rotation and place.
const KEY_MOMENT_1: usize = 12;
/// Second moments, one of each.
const KEY_MOMENT_2: usize = 18;
/// β₁ᵗ, β₂ᵗ after t updates.
const KEY_DECAY: usize = 20;
/// All of them: the state is planes `[T][KEY_WORDS][M]`.
pub const KEY_WORDS: usize = 22;
/// Words of a superpoint that stay, planes `[5][M]`: centre, radians of a pixel, world units of a pixel (0: it does not learn).
pub const SUPERPOINT_WORDS: usize = 5;
/// In place of a key's twin, where it has none.
pub const NO_TWIN: u32 = u32::MAX;

/// How key poses learn.
#[derive(Debug, Clone, PartialEq)]
pub struct KeyOptions {
    /// `[M]` canonical centres that superpoints turn about.
    pub center: Vec<DVec3>,
    /// `[M]` root mean square distance of what they move from there, world units, above 0.
    pub reach: Vec<f64>,
    /// `[M]` world units of a pixel; 0: the superpoint stays as it is.
    pub unit: Vec<f64>,
    /// Pixels of a step, at the start and at the end.
    pub rate_px: [f64; 2],
    /// λ of ½d², d the way of a key from where it began, pixels; fades to 0.
    pub hold: f64,
    /// λ of ½‖d − d'‖² for keys that follow each other; fades to 0.
    pub smooth: f64,
    /// Steps until the rate has fallen and those terms have faded.
    pub iterations: u64,
}

impl KeyOptions {
    /// # Errors
    /// `Usage` for another number of superpoints than the table has, no key, or a rate that is not above 0.
    fn check(&self, table: &Motion) -> Result<()> {
        let (m, count) = (self.center.len(), table.rotation.len());
        let lengths = [self.reach.len(), self.unit.len(), table.superpoint_count()];
        if m == 0 || table.times.is_empty() || lengths != [m; 3] || count != table.times.len() * m {
            let found = format!("{count} poses of {} key times, {lengths:?} and {m} superpoints", table.times.len());
            return Err(Error::usage("key poses to train", found, "as many of each, at least one"));
        }
        if !self.rate_px.iter().all(|rate| rate.is_finite() && *rate > 0.0) {
            return Err(Error::usage("rate of key poses", format!("{:?} pixels", self.rate_px), "two above 0"));
        }
        Ok(())
    }

    /// Share of the steps that are done at one of them.
    fn share(&self, iteration: u64) -> f64 {
        (iteration as f64 / self.iterations.max(1) as f64).min(1.0)
    }

    /// Pixels of a step, falling exponentially.
    fn rate(&self, iteration: u64) -> f64 {
        let [from, to] = self.rate_px;
        from * (to / from).powf(self.share(iteration))
    }

    /// What is left of the terms that hold keys.
    fn fade(&self, iteration: u64) -> f64 {
        1.0 - self.share(iteration)
    }

    /// Radians and world units of a pixel, of a superpoint.
    fn scale(&self, j: usize) -> [f64; 2] {
        let unit = self.unit[j];
        [unit / self.reach[j].max(1e-12), unit]
    }
}

/// The other one of two keys that are one f32 apart: two keys of one time are one key.
fn twin_of(times: &[f32], key: usize) -> Option<usize> {
    let next = |k: usize| k + 1 < times.len() && times[k + 1] <= times[k].next_up();
    if next(key) { Some(key + 1) } else { key.checked_sub(1).filter(|k| next(*k)) }
}
