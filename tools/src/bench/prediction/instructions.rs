//! Instruction counts: the committed tables of `spgs-dev isa`, what Mesa's compilers make of every kernel. They are part of the
//! program, so they cannot be older than it.

use std::sync::OnceLock;

use engine::gpu::subgroup_size::{AMD, CHOICES};
use serde::Serialize;

/// Whose tables are read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Table {
    /// Turing by NAK, for newer GPUs of NVIDIA too: Mesa's packages have no compiler statistics for those.
    Nvidia,
    /// Navi 31 by ACO, at the subgroup size that the engine chooses for each kernel.
    Amd,
}

const TURING: &str = include_str!("../../../../tests/golden/isa/nvk_turing_32.tsv");
const NAVI_32: &str = include_str!("../../../../tests/golden/isa/radv_navi31_32.tsv");
const NAVI_64: &str = include_str!("../../../../tests/golden/isa/radv_navi31_64.tsv");

/// A pipeline of a table.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Compiled {
    /// `blend[0 1 2 0 0 0 0]`.
    pub(super) name: String,
    /// Instructions of the program, each loop's body counted once.
    pub(super) instructions: f64,
    /// Subgroups in flight on a scheduler.
    pub(super) resident: f64,
    /// Cycles from first to last instruction by the compiler's own estimate, which guesses how often loops run.
    pub(super) cycles: f64,
}

/// Warps of an SM that share a scheduler.
const SCHEDULERS_OF_SM: f64 = 4.0;

/// The lines of a table, in its order.
fn parse(text: &str, subgroup_size: u32, table: Table) -> Vec<Compiled> {
    let row = |line: &str| {
        let words: Vec<&str> = line.split('\t').collect();
        // kernel, registers, spills, scratch, shared, occupancy, instructions, latency, cost
        let number = |i: usize| words.get(i)?.parse::<f64>().ok();
        let (occupancy, latency, cost) = (number(5)?, number(7)?, number(8)?);
        let (resident, cycles) = match table {
            Table::Nvidia => (occupancy / SCHEDULERS_OF_SM, cost),
            // In units of 32 lanes.
            Table::Amd => (occupancy * 32.0 / f64::from(subgroup_size), latency),
        };
        Some(Compiled { name: words[0].to_owned(), instructions: number(6)?, resident, cycles })
    };
    text.lines().filter(|l| !l.starts_with('#')).filter_map(row).collect()
}

impl Table {
    /// Threads of a workgroup of `sort_tiles` (`engine::render::sort_tiles::threads`).
    pub(super) fn sort_tiles_threads(self) -> u32 {
        match self {
            Self::Nvidia => 128,
            Self::Amd => 256,
        }
    }

    /// Subgroup size of a kernel on such a GPU.
    pub(super) fn subgroup_size(self, kernel: &str) -> u32 {
        let choice = CHOICES.iter().find(|c| c.vendor == AMD && (c.kernels.is_empty() || c.kernels.contains(&kernel)));
        match self {
            Self::Nvidia => 32,
            Self::Amd => choice.map_or(64, |c| c.size),
        }
    }

    /// Every pipeline at a subgroup size.
    pub(super) fn rows(self, subgroup_size: u32) -> &'static [Compiled] {
        static PARSED: OnceLock<[Vec<Compiled>; 3]> = OnceLock::new();
        let [turing, navi_32, navi_64] = PARSED.get_or_init(|| {
            [parse(TURING, 32, Self::Nvidia), parse(NAVI_32, 32, Self::Amd), parse(NAVI_64, 64, Self::Amd)]
        });
        match (self, subgroup_size) {
            (Self::Nvidia, _) => turing,
            (Self::Amd, 32) => navi_32,
            (Self::Amd, _) => navi_64,
        }
    }

    /// The pipeline of a kernel whose constants agree with these in most places: those that follow from the device
    /// (stage, pixels per lane) have another value where the recording was made on a CPU.
    pub(super) fn compiled(self, kernel: &str, constants: &[u32]) -> Option<&'static Compiled> {
        let agreeing = |row: &Compiled| -> Option<usize> {
            let (name, rest) = row.name.strip_suffix(']')?.split_once('[')?;
            let equal = |(word, constant): (&str, &u32)| word.parse() == Ok(*constant);
            (name == kernel).then(|| rest.split_whitespace().zip(constants).filter(|pair| equal(*pair)).count())
        };
        let rows = self.rows(self.subgroup_size(kernel)).iter();
        // Of equal ones the first.
        rows.filter_map(|row| Some((agreeing(row)?, row))).rev().max_by_key(|(n, _)| *n).map(|(_, row)| row)
    }
}

/// The loop controls of a kernel's SPIR-V, one per loop.
pub(super) fn loops(spirv: &[u8]) -> Vec<u32> {
    const LOOP_MERGE: u32 = 246;
    const HEADER_WORDS: usize = 5;
    let words: Vec<u32> = spirv.chunks_exact(4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
    let (mut at, mut found) = (HEADER_WORDS, Vec::new());
    while let Some(word) = words.get(at) {
        if word & 0xffff == LOOP_MERGE {
            found.push(words.get(at + 3).copied().unwrap_or(0));
        }
        at += (word >> 16).max(1) as usize;
    }
    found
}

/// Whether a kernel has a loop that compilers are not told to unroll.
pub(super) fn has_loop(spirv: &[u8]) -> bool {
    const UNROLL: u32 = 1;
    loops(spirv).iter().any(|control| control & UNROLL == 0)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use super::*;

    #[test]
    fn every_kernel_of_the_engine_is_in_every_table() {
        for kernel in engine::kernels().filter(|k| !k.buffers().1) {
            for table in [Table::Nvidia, Table::Amd] {
                let found = table.compiled(kernel.name, &[]).unwrap_or_else(|| panic!("{}", kernel.name));
                assert!(found.instructions > 0.0 && found.resident > 0.0, "{found:?}");
            }
        }
    }

    #[test]
    fn the_nearest_specialisation_is_taken() {
        // Recorded on a CPU: shuffles, eight pixels per lane; with slots, as in training.
        let found = Table::Nvidia.compiled("blend", &[0, 0, 8, 1, 0, 0, 0]).unwrap();
        assert_eq!(found.name, "blend[0 1 2 1 0 0 0]");
        let found = Table::Amd.compiled("deform_project", &[3, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]).unwrap();
        assert_eq!(found.name, "deform_project[3 1 0 0 0 0 0 0 0 0 0 0]");
        assert_eq!(Table::Nvidia.compiled("no_such_kernel", &[]), None);
    }

    #[test]
    fn loops_are_found_in_the_spirv() {
        let of = |name: &str| has_loop(engine::kernels().find(|k| k.name == name).unwrap().spirv);
        assert!(of("blend") && of("nearest_superpoints"));
        assert!(!of("display") && !of("gather_gradient"));
    }
}
