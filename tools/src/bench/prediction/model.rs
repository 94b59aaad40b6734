//! The model: how long a GPU takes for what is asked of it.
//!
//! An operation is busy for the longest of its bytes over the bandwidth, its instructions over the issue rate of the schedulers
//! that have a subgroup, and its atomics over their rate. No operation is shorter than its longest subgroup by itself: its
//! instructions one after the other, and the round trips to memory. Where there are more subgroups than the GPU holds at once, they come in
//! rounds. Operations between two barriers overlap: together they take the sum of their busy times or the longest
//! one's latency; a barrier adds the time from an operation to one that depends on it.

use serde::Serialize;

use super::demand::{Demand, DispatchDemand};
use super::profile::{ATOMICS_PER_CYCLE, COPY_SHARE, ISSUE_SHARE, LAUNCH_US, MEMORY_US, Profile};

/// Time of an operation and what it is made of, microseconds.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Cost {
    /// What it adds to the whole.
    pub(super) us: f64,
    /// Bytes over bandwidth.
    pub(super) bytes_us: f64,
    /// Instructions over issue rate.
    pub(super) issue_us: f64,
    /// Atomics over their rate.
    pub(super) atomics_us: f64,
    /// The longest subgroup by itself.
    pub(super) latency_us: f64,
    /// The largest of these and of the time between operations.
    pub(super) limited_by: &'static str,
}

/// A cost before it is known what the operation adds to the whole.
fn alone(profile: &Profile, d: &Demand) -> Cost {
    let gb_per_s = if d.over_bus { profile.bus_gb_per_s } else { COPY_SHARE * profile.gb_per_s };
    let bytes_us = d.bytes / gb_per_s / 1e3;
    let (issue_us, atomics_us, latency_us) = d.dispatch.as_ref().map_or((0.0, 0.0, MEMORY_US), |d| {
        (issue_us(profile, d), d.atomics / ATOMICS_PER_CYCLE / profile.clock_ghz / 1e3, latency_us(profile, d))
    });
    Cost { us: 0.0, bytes_us, issue_us, atomics_us, latency_us, limited_by: "" }
}

fn issue_us(profile: &Profile, d: &DispatchDemand) -> f64 {
    // Workgroups spread over the processors, their subgroups over the schedulers of one.
    let per_processor = (d.subgroups / d.workgroups.max(1.0)).min(profile.schedulers);
    let schedulers = profile.all_schedulers().min(d.workgroups.max(1.0) * per_processor);
    d.issued / (schedulers.max(1.0) * profile.clock_ghz * ISSUE_SHARE) / 1e3
}

fn latency_us(profile: &Profile, d: &DispatchDemand) -> f64 {
    let rounds = (d.subgroups / (profile.all_schedulers() * d.resident)).max(1.0);
    let round_us = |instructions: f64, cycles: f64, round_trips: f64| {
        (instructions * profile.cycles_alone + cycles) / profile.clock_ghz / 1e3 + round_trips * MEMORY_US
    };
    // The longest subgroup is in the last round at worst; those before it are mean ones.
    let mean = round_us(d.mean.min(d.longest), d.mean_cycles, d.mean_round_trips);
    round_us(d.longest, d.longest_cycles, d.round_trips) + (rounds - 1.0) * mean
}

impl Cost {
    fn busy(&self) -> f64 {
        self.bytes_us.max(self.issue_us).max(self.atomics_us).max(LAUNCH_US)
    }

    fn limit(&self) -> &'static str {
        let all = [
            (self.bytes_us, "bytes"),
            (self.issue_us, "instructions"),
            (self.atomics_us, "atomics"),
            (self.latency_us, "latency"),
        ];
        all.into_iter().max_by(|a, b| a.0.total_cmp(&b.0)).map_or("", |(_, name)| name)
    }
}

/// The cost of each operation; their sum is the device's time.
pub(super) fn costs(profile: &Profile, demands: &[Demand]) -> Vec<Cost> {
    let mut costs = Vec::with_capacity(demands.len());
    // Of the operations since the last barrier: busy so far, longest latency, what they took so far.
    let (mut busy, mut longest, mut taken) = (0.0, 0.0_f64, 0.0);
    for (i, demand) in demands.iter().enumerate() {
        let mut cost = alone(profile, demand);
        let waits = demand.barrier || i == 0;
        if waits {
            (busy, longest, taken) = (0.0, 0.0, 0.0);
        }
        busy += cost.busy();
        longest = longest.max(cost.latency_us);
        let now = busy.max(longest);
        cost.us = now - taken + if waits { profile.dependency_us } else { 0.0 };
        cost.limited_by =
            if cost.us - cost.busy().max(cost.latency_us) > cost.us / 2.0 { "dependency" } else { cost.limit() };
        taken = now;
        costs.push(cost);
    }
    costs
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use super::super::profile::PROFILES;
    use super::*;

    fn transfer(bytes: f64, barrier: bool) -> Demand {
        Demand { label: "copy".into(), barrier, bytes, over_bus: false, by_host: 0.0, dispatch: None }
    }

    fn kernel(workgroups: f64, instructions: f64) -> Demand {
        let dispatch = DispatchDemand {
            workgroups,
            subgroups: 8.0 * workgroups,
            lanes: 32.0,
            compiled: String::new(),
            instructions,
            resident: 8.0,
            issued: 8.0 * workgroups * instructions,
            longest: instructions,
            mean: instructions,
            longest_cycles: 0.0,
            mean_cycles: 0.0,
            round_trips: 2.0,
            mean_round_trips: 2.0,
            atomics: 0.0,
            uncounted_loop: false,
        };
        Demand { dispatch: Some(dispatch), ..transfer(0.0, true) }
    }

    #[test]
    fn bytes_take_bandwidth_and_a_barrier_its_time() {
        let h200 = &PROFILES[0];
        let us = |d: &[Demand]| costs(h200, d).iter().map(|c| c.us).sum::<f64>();
        // 4.32 GB at 90 % of 4.8 TB/s: a millisecond.
        assert!((us(&[transfer(4.32e9, true)]) - 1000.0 - h200.dependency_us).abs() < 1e-6);
        let one = us(&[transfer(4.32e6, true)]);
        assert!((us(&[transfer(4.32e6, true), transfer(4.32e6, true)]) - 2.0 * one).abs() < 1e-9);
        // Without a barrier the second one adds what it is busy for.
        assert!((us(&[transfer(4.32e6, true), transfer(4.32e6, false)]) - one - 1.0).abs() < 1e-9);
        let host = Demand { over_bus: true, ..transfer(5.5e6, true) };
        assert!((us(&[host]) - 100.0 - h200.dependency_us).abs() < 1e-6);
    }

    #[test]
    fn small_dispatches_are_latency_and_large_ones_instructions() {
        let h200 = &PROFILES[0];
        let cost = |groups| costs(h200, &[kernel(groups, 1000.0)]).remove(0);
        let small = cost(1.0);
        assert_eq!(small.limited_by, "latency");
        assert!((small.latency_us - (1000.0 * 4.7 / 1.98 / 1e3 + 0.8)).abs() < 1e-9, "{small:?}");
        let large = cost(1e5);
        assert_eq!(large.limited_by, "instructions");
        let expected = 8e8 / (528.0 * 1.98e9 * 0.7) * 1e6;
        assert!((large.issue_us / expected - 1.0).abs() < 1e-9, "{large:?}");
        // One workgroup of eight subgroups has the four schedulers of one processor.
        assert!((small.issue_us - 8e3 / (4.0 * 1.98 * 0.7) / 1e3).abs() < 1e-9);
    }

    #[test]
    fn no_device_is_faster_with_more_to_do() {
        for profile in &PROFILES {
            let mut last = 0.0;
            for groups in [1.0, 10.0, 100.0, 1e3, 1e4, 1e5] {
                let us: f64 = costs(profile, &[kernel(groups, 500.0)]).iter().map(|c| c.us).sum();
                assert!(us >= last, "{}: {groups} workgroups take {us}, fewer {last}", profile.name);
                last = us;
            }
        }
    }
}
