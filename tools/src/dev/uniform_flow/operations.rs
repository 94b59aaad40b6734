//! Which invocations agree on the result of an instruction.

use rspirv::dr::{Instruction, Operand};
use rspirv::spirv::{BuiltIn, GroupOperation, Op};

/// Among whom a value, or the flow that reaches a block, is the same.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Level {
    /// All invocations of the workgroup.
    Workgroup,
    /// All of a subgroup, but subgroups differ.
    Subgroup,
    /// Lanes of a subgroup differ.
    Divergent,
}

/// Of an input that the device fills.
pub(super) fn of_builtin(builtin: BuiltIn) -> Level {
    match builtin {
        BuiltIn::WorkgroupId
        | BuiltIn::NumWorkgroups
        | BuiltIn::WorkgroupSize
        | BuiltIn::NumSubgroups
        | BuiltIn::SubgroupSize => Level::Workgroup,
        BuiltIn::SubgroupId => Level::Subgroup,
        _ => Level::Divergent,
    }
}

/// Whether an operation needs the lanes of a subgroup together.
pub(super) fn is_of_subgroup(op: Op) -> bool {
    let name = format!("{op:?}");
    name.starts_with("GroupNonUniform") || name.starts_with("SubgroupBallot") || name.starts_with("Subgroup")
}

/// Of a subgroup operation; `of` gives the level of its n-th operand.
pub(super) fn of_subgroup_operation(i: &Instruction, of: impl Fn(usize) -> Level) -> Level {
    // What all lanes get is as uniform as what they put in, and at most different between subgroups.
    let shared = |value: Level| value.min(Level::Subgroup);
    match i.class.opcode {
        Op::GroupNonUniformAll | Op::GroupNonUniformAny | Op::GroupNonUniformAllEqual => shared(of(1)),
        Op::GroupNonUniformBroadcast | Op::GroupNonUniformBroadcastFirst => shared(of(1)),
        Op::GroupNonUniformBallot | Op::GroupNonUniformBallotFindLSB | Op::GroupNonUniformBallotFindMSB => {
            Level::Subgroup
        }
        // From one lane for all, or whatever the others put in.
        Op::GroupNonUniformShuffle if of(2) <= Level::Subgroup => shared(of(1)),
        Op::GroupNonUniformShuffle | Op::GroupNonUniformShuffleXor => {
            if of(1) <= Level::Subgroup {
                of(1)
            } else {
                Level::Divergent
            }
        }
        Op::GroupNonUniformElect => Level::Divergent,
        _ => match i.operands.get(1) {
            Some(Operand::GroupOperation(GroupOperation::Reduce)) => shared(of(2).max(Level::Subgroup)),
            _ => Level::Divergent,
        },
    }
}

/// Instructions whose result is not a function of their operands alone.
pub(super) fn is_impure(op: Op) -> bool {
    let name = format!("{op:?}");
    name.starts_with("Atomic") || name.starts_with("Image") || matches!(op, Op::Undef | Op::ReadClockKHR)
}
