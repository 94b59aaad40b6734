//! What a compiler says of a pipeline, in the same words for every driver.

use engine::gpu::Statistic;
use serde::{Deserialize, Serialize};

/// What a compiler says of a pipeline; what a driver does not report is 0.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Statistics {
    /// Vector registers of an invocation.
    pub registers: f64,
    /// Registers that were put into memory.
    pub spills: f64,
    /// Bytes of private memory of an invocation (scratch, local memory).
    pub scratch: f64,
    /// Bytes of shared memory of a workgroup.
    pub shared: f64,
    /// Subgroups in flight per SIMD (AMD, in units of 32 lanes on RDNA), per SM (NVIDIA), per core (Qualcomm).
    pub occupancy: f64,
    /// Instructions.
    pub instructions: f64,
    /// Cycles from first to last instruction, estimated.
    pub latency: f64,
    /// Busy cycles of 64 invocations (AMD) or of a subgroup, estimated.
    pub cost: f64,
}

/// A column of the table.
pub(super) struct Column {
    /// Its name in golden files.
    pub(super) name: &'static str,
    /// Names that drivers have for it; all that are there are added.
    reported: &'static [&'static str],
    /// Its value.
    pub(super) get: fn(&Statistics) -> f64,
    set: fn(&mut Statistics, f64),
}

macro_rules! column {
    ($field:ident, $reported:expr) => {
        Column { name: stringify!($field), reported: $reported, get: |s| s.$field, set: |s, v| s.$field = v }
    };
}

/// Every column, in the order of the golden files. RADV's names first, then those of NVK, then those of Turnip.
pub(super) const COLUMNS: [Column; 8] = [
    column!(registers, &["VGPRs", "Number of GPRs", "Registers used"]),
    column!(spills, &["Spilled SGPRs", "Spilled VGPRs", "Spills to memory", "Fills from memory"]),
    column!(scratch, &["Scratch size", "SLM size", "STP Count", "LDP Count"]),
    column!(shared, &["LDS size", "Shared memory size"]),
    column!(occupancy, &["Subgroups per SIMD", "Max warps/SM", "Max Waves Per Core"]),
    column!(instructions, &["Instructions", "Instruction count", "Instruction Count"]),
    column!(latency, &["Latency"]),
    column!(cost, &["Inverse Throughput", "Static cycle count"]),
];

impl Statistics {
    /// From what a driver reports.
    pub fn new(reported: &[Statistic]) -> Self {
        let mut statistics = Self::default();
        for column in &COLUMNS {
            let found = reported.iter().filter(|s| column.reported.contains(&s.name.as_str()));
            (column.set)(&mut statistics, found.fold(0.0, |sum, s| sum + s.value));
        }
        statistics
    }

    /// From the words of a line of a golden file; `None` when they are none.
    pub(super) fn parse(words: &[&str]) -> Option<Self> {
        let mut statistics = Self::default();
        if words.len() != COLUMNS.len() {
            return None;
        }
        for (column, word) in COLUMNS.iter().zip(words) {
            (column.set)(&mut statistics, word.parse().ok()?);
        }
        Some(statistics)
    }
}

/// A pipeline: kernel, specialisation constants from id 1 on, statistics.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// Name of the kernel.
    pub kernel: String,
    /// Specialisation constants but the subgroup size, in the order of the kernel's declaration.
    pub constants: Vec<u32>,
    /// What the compiler says.
    pub statistics: Statistics,
}

impl Row {
    /// `blend[0 1 2 0 0 0 0]`.
    pub fn name(&self) -> String {
        let constants: Vec<String> = self.constants.iter().map(u32::to_string).collect();
        format!("{}[{}]", self.kernel, constants.join(" "))
    }
}
