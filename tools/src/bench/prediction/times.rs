//! A prediction: the times of one recording on every GPU that there is a profile of, with everything they follow from.

use serde::Serialize;

use super::demand::{self, Demand};
use super::loops::{LOOPS, USUAL_PATHS};
use super::model::{Cost, costs};
use super::profile::{Constant, HOST_US, HOST_WRITES_GB_PER_S, PROFILES, Profile};
use super::subtiles::Subtiles;
use crate::report::measure::{Beside, Recorded};

/// What was recorded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Kind {
    /// A frame.
    Frame,
    /// A training step.
    Step,
}

/// What the goal is stated for: Gaussians, pixels, the GPU.
const GOAL_GAUSSIANS: u64 = 120_000;
const GOAL_PIXELS: u64 = 640_000;
const GOAL_GPU: &str = "H200";
/// Frames per second, and milliseconds of a step.
const GOAL_FPS: f64 = 8000.0;
const GOAL_STEP_MS: f64 = 1.0;

/// The goal, where the recording is the one that it is stated for.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct Goal {
    /// In words.
    pub(crate) what: String,
    /// Whether the prediction reaches it.
    pub(crate) met: bool,
}

/// An operation: what it asks for, and its time.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct Operation {
    #[serde(flatten)]
    pub(super) demand: Demand,
    #[serde(flatten)]
    pub(super) cost: Cost,
}

/// On one GPU.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct OnGpu {
    /// Its name.
    pub(crate) gpu: &'static str,
    /// On the device, milliseconds.
    pub(crate) device_ms: f64,
    /// With what the host does before and after, one at a time, milliseconds.
    pub(crate) one_at_a_time_ms: f64,
    /// Of frames or steps in flight, per second.
    pub(crate) per_second: f64,
    /// Of frames drawn side by side, where they were recorded.
    pub(crate) side_by_side: Vec<Beside>,
    /// The goal, if there is one for it.
    pub(crate) goal: Option<Goal>,
    /// Dispatches and transfers in order.
    pub(crate) operations: Vec<Operation>,
    /// Where the figures of its data sheet are from.
    pub(crate) data_sheet: &'static str,
    /// Constants of the GPU.
    pub(crate) constants: Vec<Constant>,
}

/// A loop's assumption.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct Assumed {
    /// A round, in words.
    pub(crate) round: &'static str,
    /// Its instructions, or its share of the program's.
    pub(crate) instructions: String,
}

/// A prediction.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct Predicted {
    /// What was recorded.
    pub(crate) of: Kind,
    /// Dispatches, and barriers with the one at the beginning, of the recording.
    pub(crate) dispatches: usize,
    pub(crate) barriers: usize,
    /// What blending does with the lists of tiles, counted for the first measured view.
    pub(crate) subtiles: Subtiles,
    /// One per GPU.
    pub(crate) gpus: Vec<OnGpu>,
    /// Loops of these operations.
    pub(crate) loops: Vec<Assumed>,
}

impl Predicted {
    /// The GPU of a driver's device name, else that of the goal; and whether it is that device.
    pub(crate) fn beside(&self, device: &str) -> Option<(&OnGpu, bool)> {
        let own = Profile::of_device(device).and_then(|p| self.gpus.iter().find(|g| g.gpu == p.name));
        own.map(|gpu| (gpu, true)).or_else(|| Some((self.gpus.first()?, false)))
    }

    /// Adds what this recording of so many frames side by side would take.
    pub(crate) fn add_beside(&mut self, frames: usize, recorded: &[Recorded]) {
        for gpu in self.gpus.iter_mut().filter(|_| !recorded.is_empty()) {
            let profile = PROFILES.iter().find(|p| p.name == gpu.gpu);
            let all = profile.map(|p| on_gpu(self.of, p, recorded, self.subtiles, false));
            gpu.side_by_side.extend(all.map(|all| Beside { frames, fps: frames as f64 * all.per_second }));
        }
    }
}

/// Predicts a recording. subtiles: what was counted of its view. `None` where nothing was recorded.
pub(crate) fn predict(of: Kind, recorded: &[Recorded], subtiles: Subtiles) -> Option<Predicted> {
    let first = recorded.first()?;
    let is_goal = first.work.get("gaussians") == GOAL_GAUSSIANS
        && first.work.get("pixels") == GOAL_PIXELS
        && first.work.get("moving") > 0;
    let gpus: Vec<OnGpu> = PROFILES.iter().map(|p| on_gpu(of, p, recorded, subtiles, is_goal)).collect();
    let compiled = |name: &str| gpus.iter().flat_map(|g| &g.operations).any(|o| o.demand.is_of(name));
    let used = LOOPS.iter().filter(|l| l.kernels().iter().any(|k| compiled(k)));
    let rounds = used.map(|l| Assumed { round: l.round, instructions: l.body.describe() });
    let usual = USUAL_PATHS.iter().filter(|(kernel, _)| compiled(kernel));
    let usual = usual.map(|(kernel, share)| Assumed {
        round: kernel,
        instructions: format!("{:.0} % of its program's instructions on its usual path (counted)", 100.0 * share),
    });
    let loops = rounds.chain(usual).collect();
    let is_dispatch = |r: &&Recorded| matches!(r.operation.task, engine::gpu::RecordedTask::Dispatch { .. });
    Some(Predicted {
        of,
        dispatches: recorded.iter().filter(is_dispatch).count(),
        barriers: 1 + recorded.iter().filter(|r| r.operation.barrier).count(),
        subtiles,
        loops,
        gpus,
    })
}

fn on_gpu(of: Kind, profile: &'static Profile, recorded: &[Recorded], subtiles: Subtiles, is_goal: bool) -> OnGpu {
    let demands = demand::of_recording(recorded, profile.table, subtiles);
    let costs = costs(profile, &demands);
    let device_us: f64 = costs.iter().map(|c| c.us).sum();
    let by_host: f64 = demands.iter().map(|d| d.by_host).sum();
    let one_at_a_time_us = device_us + HOST_US + by_host / HOST_WRITES_GB_PER_S / 1e3;
    // Frames and steps are in flight: nothing waits for the host but a photo that is not resident.
    let in_flight_us = device_us + by_host / HOST_WRITES_GB_PER_S / 1e3;
    let per_second = 1e6 / in_flight_us;
    let goal = (is_goal && profile.name == GOAL_GPU).then(|| match of {
        Kind::Frame => Goal { what: format!("at least {GOAL_FPS} FPS in flight"), met: per_second >= GOAL_FPS },
        Kind::Step => {
            Goal { what: format!("at most {GOAL_STEP_MS:.1} ms per step"), met: in_flight_us / 1e3 <= GOAL_STEP_MS }
        }
    });
    OnGpu {
        gpu: profile.name,
        device_ms: device_us / 1e3,
        one_at_a_time_ms: one_at_a_time_us / 1e3,
        per_second,
        side_by_side: Vec::new(),
        goal,
        operations: demands.into_iter().zip(costs).map(|(demand, cost)| Operation { demand, cost }).collect(),
        data_sheet: profile.sheet,
        constants: profile.constants(),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use engine::gpu::kernel::Workload;
    use engine::gpu::{RecordedOperation, RecordedTask};

    use super::*;

    fn transfer(bytes: u64, from_host: bool, gaussians: u64) -> Recorded {
        let task = RecordedTask::Transfer { read: bytes, written: bytes, from_host, to_host: false };
        let operation = RecordedOperation { label: "copy".into(), barrier: true, task };
        let work = Workload([("gaussians", gaussians), ("pixels", GOAL_PIXELS), ("moving", 1)].into());
        Recorded { operation, work }
    }

    #[test]
    fn the_goal_is_judged_where_it_is_stated_for_and_nowhere_else() {
        let of = |kind, bytes, gaussians| {
            let p = predict(kind, &[transfer(bytes, false, gaussians)], Subtiles::ALL).unwrap();
            p.gpus.iter().map(|g| g.goal.as_ref().map(|g| g.met)).collect::<Vec<_>>()
        };
        assert_eq!(of(Kind::Frame, 1 << 20, GOAL_GAUSSIANS), [Some(true), None, None]);
        assert_eq!(of(Kind::Frame, 1 << 30, GOAL_GAUSSIANS), [Some(false), None, None]);
        assert_eq!(of(Kind::Step, 1 << 30, GOAL_GAUSSIANS), [Some(true), None, None]);
        assert_eq!(of(Kind::Step, 1 << 32, GOAL_GAUSSIANS), [Some(false), None, None]);
        assert_eq!(of(Kind::Frame, 1 << 20, GOAL_GAUSSIANS + 1), [None, None, None]);
        assert!(predict(Kind::Frame, &[], Subtiles::ALL).is_none());
    }

    #[test]
    fn a_step_waits_for_what_the_host_writes() {
        let of = |from_host| {
            predict(Kind::Step, &[transfer(10_000_000, from_host, 1)], Subtiles::ALL).unwrap().gpus.remove(0)
        };
        let (device, host) = (of(false), of(true));
        assert!((device.one_at_a_time_ms - device.device_ms - HOST_US / 1e3).abs() < 1e-9);
        // 10 MB at 10 GB/s are a millisecond.
        assert!((host.one_at_a_time_ms - host.device_ms - HOST_US / 1e3 - 1.0).abs() < 1e-9);
        assert!((host.per_second - 1e3 / (host.one_at_a_time_ms - HOST_US / 1e3)).abs() < 1e-9);
        assert!((device.per_second - 1e3 / device.device_ms).abs() < 1e-9);
    }

    #[test]
    fn a_device_is_put_beside_its_own_prediction() {
        let p = predict(Kind::Frame, &[transfer(1, false, 1)], Subtiles::ALL).unwrap();
        let of = |device| p.beside(device).map(|(gpu, own)| (gpu.gpu, own)).unwrap();
        assert_eq!(of("NVIDIA GeForce RTX 4090"), ("RTX 4090", true));
        assert_eq!(of("llvmpipe"), ("H200", false));
    }
}
