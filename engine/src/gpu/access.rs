//! Which barriers a list of operations needs, from what each reads and writes. Pure CPU: no Vulkan names, so that it can
//! be property-tested against brute force, and printed as the barrier plan.
//!
//! Rules. All hazards (read after write, write after read, write after write) on overlapping byte ranges of a buffer are
//! covered by at most one *global* memory barrier per operation: with one dispatch after another there is nothing to gain
//! from per-buffer barriers. A barrier names only the stages of the accesses that conflict, and flushes writes only when
//! one of them is a write (write-after-read needs execution order alone).

use std::fmt::Write as _;

/// A set of pipeline stages that touch buffers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Stages(pub u8);

impl Stages {
    /// No stage.
    pub const NONE: Self = Self(0);
    /// Compute shader.
    pub const COMPUTE: Self = Self(1);
    /// Copies and fills.
    pub const TRANSFER: Self = Self(2);
    /// Indirect dispatch arguments.
    pub const INDIRECT: Self = Self(4);
    /// Host reads of mapped memory.
    pub const HOST: Self = Self(8);
    /// All that the device executes.
    pub const OF_DEVICE: Self = Self(7);
    /// All.
    pub const ALL: Self = Self(15);

    /// Whether every stage of `other` is in `self`.
    pub fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    /// Union.
    #[must_use]
    pub fn union(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// Names joined by `|`.
    pub fn names(self) -> String {
        let all = [
            (Self::COMPUTE, "COMPUTE"),
            (Self::TRANSFER, "TRANSFER"),
            (Self::INDIRECT, "INDIRECT"),
            (Self::HOST, "HOST"),
        ];
        let names: Vec<&str> = all.iter().filter(|(s, _)| self.contains(*s)).map(|(_, n)| *n).collect();
        names.join("|")
    }
}

/// One access of an operation to a byte range of a buffer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Use {
    /// Identity of the buffer.
    pub buffer: u64,
    /// Its name, for the plan.
    pub name: String,
    /// First byte.
    pub start: u64,
    /// One past the last byte.
    pub end: u64,
    /// The stage that accesses it.
    pub stage: Stages,
    /// Whether it writes (an atomic update or read-write counts as a write).
    pub write: bool,
}

/// A global memory barrier before an operation.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Barrier {
    /// Stages waited for.
    pub source: Stages,
    /// Whether their writes are made available and visible (false: execution order only).
    pub flush: bool,
    /// Stages that wait.
    pub destination: Stages,
    /// The conflicts, as text: `pairs (W@emit_tiles)`.
    pub reasons: Vec<String>,
}

impl Barrier {
    /// One line for the plan: `COMPUTE:W->COMPUTE because pairs (W@#3 emit_tiles)`.
    pub fn describe(&self) -> String {
        let mut text = String::new();
        let kind = if self.flush { "W" } else { "exec" };
        let _ = write!(
            text,
            "{}:{kind}->{} because {}",
            self.source.names(),
            self.destination.names(),
            self.reasons.join(", ")
        );
        text
    }
}

#[derive(Debug, Clone)]
struct Pending {
    access: Use,
    label: String,
    /// Stages that are already ordered after this access (and see it, when it is a write).
    ordered_before: Stages,
}

/// Follows a list of operations and says where barriers belong.
#[derive(Debug, Default)]
pub struct HazardTracker {
    pending: Vec<Pending>,
}

impl HazardTracker {
    /// The barrier that must stand before an operation with these accesses, if any; then the operation counts as done.
    pub fn step(&mut self, label: &str, uses: &[Use]) -> Option<Barrier> {
        self.step_beside(&[(label, uses)])
    }

    /// The barrier that must stand before the first of operations that do not conflict with each other, if any; then all of
    /// them count as done.
    pub fn step_beside(&mut self, operations: &[(&str, &[Use])]) -> Option<Barrier> {
        let barrier = self.conflicts(operations.iter().flat_map(|(_, uses)| *uses));
        if let Some(barrier) = &barrier {
            self.apply(barrier);
        }
        operations.iter().for_each(|(label, uses)| self.remember(label, uses));
        barrier
    }

    fn conflicts<'a>(&self, uses: impl Iterator<Item = &'a Use>) -> Option<Barrier> {
        let mut barrier =
            Barrier { source: Stages::NONE, flush: false, destination: Stages::NONE, reasons: Vec::new() };
        for access in uses {
            for p in &self.pending {
                let q = &p.access;
                let overlap = q.buffer == access.buffer && q.start < access.end && access.start < q.end;
                if !overlap || !(q.write || access.write) || p.ordered_before.contains(access.stage) {
                    continue;
                }
                barrier.source = barrier.source.union(q.stage);
                barrier.destination = barrier.destination.union(access.stage);
                barrier.flush |= q.write;
                let reason = format!("{} ({}@{})", access.name, if q.write { "W" } else { "R" }, p.label);
                if !barrier.reasons.contains(&reason) {
                    barrier.reasons.push(reason);
                }
            }
        }
        (barrier.source != Stages::NONE).then_some(barrier)
    }

    fn apply(&mut self, barrier: &Barrier) {
        for p in &mut self.pending {
            if barrier.source.contains(p.access.stage) && (barrier.flush || !p.access.write) {
                p.ordered_before = p.ordered_before.union(barrier.destination);
            }
        }
    }

    fn remember(&mut self, label: &str, uses: &[Use]) {
        for access in uses {
            if access.write {
                // A write that covers an older access replaces it: whoever is ordered after the new one is ordered
                // after the old one too.
                self.pending.retain(|p| {
                    let q = &p.access;
                    !(q.buffer == access.buffer && access.start <= q.start && q.end <= access.end) || p.label == label
                });
            }
            self.pending.push(Pending {
                access: access.clone(),
                label: label.to_owned(),
                ordered_before: Stages::NONE,
            });
        }
    }
}
