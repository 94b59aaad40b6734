//! The GPUs that times are predicted for, and what is taken of each: data-sheet figures, and assumptions that say so.
//!
//! No constant is fitted to a measurement of this program, and none may be bent towards a goal. A figure that a GPU disproves is
//! corrected here, with the measurement as its source.

use serde::Serialize;

use super::instructions::Table;

/// A GPU.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Profile {
    /// Its name.
    pub(crate) name: &'static str,
    /// What the driver's name of it contains, lower case.
    pub(super) contains: &'static str,
    /// Who compiled the kernels whose instructions are counted.
    pub(super) table: Table,
    /// SMs or CUs.
    pub(super) processors: f64,
    /// Schedulers of each, each of which issues one instruction of a subgroup of 32 per cycle.
    pub(super) schedulers: f64,
    /// Boost clock, GHz.
    pub(super) clock_ghz: f64,
    /// Peak f32 rate, TFLOP/s; printed for comparison, not used.
    pub(super) tflops: f64,
    /// Peak memory bandwidth, GB/s.
    pub(super) gb_per_s: f64,
    /// To and from the host's memory, one way, GB/s.
    pub(super) bus_gb_per_s: f64,
    /// Cycles per instruction of a subgroup that has a scheduler to itself.
    pub(super) cycles_alone: f64,
    /// From one operation's end over a barrier to the next one's first instruction, µs.
    pub(super) dependency_us: f64,
    /// Where the figures of its data sheet are from.
    pub(super) sheet: &'static str,
    /// What `cycles_alone` is.
    alone_is: &'static str,
}

/// Of the peak bandwidth that copies reach.
pub(super) const COPY_SHARE: f64 = 0.9;
/// Of the issue slots that a busy kernel uses.
pub(super) const ISSUE_SHARE: f64 = 0.7;
/// One round trip to memory, µs.
pub(super) const MEMORY_US: f64 = 0.4;
/// Between operations without a barrier, µs.
pub(super) const LAUNCH_US: f64 = 0.5;
/// 32-bit atomics to different addresses, per cycle of the whole device: 6.3 million in 214 µs of `blend_backward_native` on an
/// H200. `deform_project` and `emit_tiles`, with 478,000 each on counters of tiles, reach no more.
pub(super) const ATOMICS_PER_CYCLE: f64 = 15.0;
/// Submission, and waking up the host at the end, µs.
pub(super) const HOST_US: f64 = 40.0;
/// What one thread of the host writes to memory that the device reads, GB/s.
pub(super) const HOST_WRITES_GB_PER_S: f64 = 10.0;

const SHEET: &str = "data sheet";
const NVIDIA_ALONE: &str = "median of NAK's static cycles per instruction over kernels without loops, Turing";
const AMD_ALONE: &str = "median of ACO's latency per instruction over kernels without loops, Navi 31";

/// The GPUs, the one of the goal first.
pub(crate) const PROFILES: [Profile; 3] = [
    Profile {
        name: "H200",
        contains: "h200",
        table: Table::Nvidia,
        processors: 132.0,
        schedulers: 4.0,
        clock_ghz: 1.98,
        tflops: 67.0,
        gb_per_s: 4800.0,
        bus_gb_per_s: 55.0,
        cycles_alone: 4.7,
        dependency_us: 3.0,
        sheet: "NVIDIA H200 SXM data sheet (67 TFLOP/s is 132 SMs of 128 lanes at 1.98 GHz)",
        alone_is: NVIDIA_ALONE,
    },
    Profile {
        name: "RTX 4090",
        contains: "rtx 4090",
        table: Table::Nvidia,
        processors: 128.0,
        schedulers: 4.0,
        clock_ghz: 2.52,
        tflops: 82.6,
        gb_per_s: 1008.0,
        bus_gb_per_s: 26.0,
        cycles_alone: 4.7,
        dependency_us: 1.5,
        sheet: "NVIDIA Ada GPU architecture white paper",
        alone_is: NVIDIA_ALONE,
    },
    Profile {
        name: "RX 7900 XTX",
        contains: "7900 xtx",
        table: Table::Amd,
        processors: 96.0,
        schedulers: 2.0,
        clock_ghz: 2.5,
        tflops: 61.4,
        gb_per_s: 960.0,
        bus_gb_per_s: 26.0,
        cycles_alone: 10.56,
        dependency_us: 2.0,
        sheet: "AMD product page (61.4 TFLOP/s counts dual issue, which is left out here)",
        alone_is: AMD_ALONE,
    },
];

/// A constant of the model, for people and for JSON.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct Constant {
    pub(crate) name: &'static str,
    pub(crate) value: f64,
    pub(crate) unit: &'static str,
    /// Data sheet, compiler, or the word "assumption".
    pub(crate) source: &'static str,
}

impl Profile {
    /// The profile of a device by the name that its driver gives; a part of a GPU (MIG) has none.
    pub(crate) fn of_device(name: &str) -> Option<&'static Self> {
        let name = name.to_lowercase();
        PROFILES.iter().find(|p| name.contains(p.contains) && !name.contains("mig "))
    }

    /// Schedulers of the whole device.
    pub(super) fn all_schedulers(&self) -> f64 {
        self.processors * self.schedulers
    }

    /// Everything that the model takes of it.
    pub(crate) fn constants(&self) -> Vec<Constant> {
        let row = |name, value, unit, source| Constant { name, value, unit, source };
        vec![
            row("memory bandwidth, peak", self.gb_per_s, "GB/s", SHEET),
            row("of it that copies reach", COPY_SHARE, "", "assumption (4.3 of 4.8 TB/s was published for an H200)"),
            row("SMs or CUs", self.processors, "", SHEET),
            row("schedulers of each", self.schedulers, "", SHEET),
            row("boost clock", self.clock_ghz, "GHz", SHEET),
            row("f32 rate, peak (not used)", self.tflops, "TFLOP/s", SHEET),
            row("issue slots that are used", ISSUE_SHARE, "", "assumption"),
            row("cycles per instruction, alone", self.cycles_alone, "", self.alone_is),
            row("round trip to memory", MEMORY_US, "µs", "assumption, between an L2 hit and DRAM"),
            row(
                "from operation to dependent operation",
                self.dependency_us,
                "µs",
                "H200: by sorts of 32 keys; others: assumption (drain, barrier, launch)",
            ),
            row("between independent operations", LAUNCH_US, "µs", "assumption"),
            row("atomics per cycle", ATOMICS_PER_CYCLE, "", "measured on an H200 (blend_backward_native)"),
            row("to and from the host", self.bus_gb_per_s, "GB/s", "PCIe 5.0 (H200) or 4.0, 16 lanes, less protocol"),
            row("written by the host", HOST_WRITES_GB_PER_S, "GB/s", "assumption: memcpy by one thread"),
            row("submission and wake-up of the host", HOST_US, "µs", "assumption"),
        ]
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use super::super::instructions::loops;
    use super::*;

    #[test]
    fn a_device_is_found_by_its_drivers_name() {
        let name = |n| Profile::of_device(n).map(|p| p.name);
        assert_eq!(name("NVIDIA H200"), Some("H200"));
        assert_eq!(name("NVIDIA GeForce RTX 4090"), Some("RTX 4090"));
        assert_eq!(name("AMD Radeon RX 7900 XTX (RADV NAVI31)"), Some("RX 7900 XTX"));
        assert_eq!(name("NVIDIA H200 MIG 1g.18gb"), None);
        assert_eq!(name("llvmpipe (LLVM 15.0.6, 256 bits)"), None);
    }

    #[test]
    fn cycles_alone_are_the_median_of_kernels_without_loops() {
        for profile in PROFILES {
            let straight = engine::kernels().filter(|k| !k.buffers().1 && loops(k.spirv).is_empty());
            let rows = straight.filter_map(|k| profile.table.compiled(k.name, &[]));
            let mut each: Vec<f64> = rows.map(|row| row.cycles / row.instructions).collect();
            each.sort_by(f64::total_cmp);
            let median = 0.5 * (each[(each.len() - 1) / 2] + each[each.len() / 2]);
            assert!((profile.cycles_alone / median - 1.0).abs() < 0.01, "{}: {median} of {each:?}", profile.name);
        }
    }

    #[test]
    fn clock_and_units_give_the_rate_of_the_data_sheet() {
        for p in PROFILES {
            // AMD counts two instructions per cycle.
            let lanes = if p.name == "RX 7900 XTX" { 64.0 } else { 32.0 };
            let tflops = p.all_schedulers() * lanes * 2.0 * p.clock_ghz / 1e3;
            assert!((tflops / p.tflops - 1.0).abs() < 0.01, "{}: {tflops}", p.name);
        }
    }
}
