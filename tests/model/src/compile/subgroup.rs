//! Subgroup operations.

use rspirv::dr::{Instruction, Operand};
use rspirv::spirv::{GroupOperation, Op as SpirvOp};

use super::Compiler;
use crate::error::{Result, unsupported};
use crate::module::ids;
use crate::op::{Extent, Op, Reduction};

fn reduction(op: SpirvOp) -> Option<Reduction> {
    Some(match op {
        SpirvOp::GroupNonUniformIAdd => Reduction::AddInt,
        SpirvOp::GroupNonUniformFAdd => Reduction::Add,
        SpirvOp::GroupNonUniformUMin => Reduction::MinUint,
        SpirvOp::GroupNonUniformUMax => Reduction::MaxUint,
        SpirvOp::GroupNonUniformFMin => Reduction::Min,
        SpirvOp::GroupNonUniformFMax => Reduction::Max,
        SpirvOp::GroupNonUniformBitwiseAnd | SpirvOp::GroupNonUniformLogicalAnd => Reduction::And,
        SpirvOp::GroupNonUniformBitwiseOr | SpirvOp::GroupNonUniformLogicalOr => Reduction::Or,
        _ => return None,
    })
}

impl Compiler<'_> {
    /// Compiles `i` if it is one of them.
    pub(super) fn subgroup(&mut self, i: &Instruction) -> Result<bool> {
        let named = ids(i);
        let source = named.get(1).and_then(|n| self.operand(*n).ok()).unwrap_or_default();
        if let Some(op) = reduction(i.class.opcode) {
            let extent = i.operands.iter().find_map(|o| match o {
                Operand::GroupOperation(GroupOperation::Reduce) => Some(Extent::Reduce),
                Operand::GroupOperation(GroupOperation::InclusiveScan) => Some(Extent::Inclusive),
                Operand::GroupOperation(GroupOperation::ExclusiveScan) => Some(Extent::Exclusive),
                _ => None,
            });
            let Some(extent) = extent else { return unsupported("a clustered operation") };
            for (d, a) in self.result(i).into_iter().zip(source) {
                self.emit(Op::Group { op, extent, d, a });
            }
            return Ok(true);
        }
        let second = named.get(2).and_then(|n| self.operand(*n).ok()).unwrap_or_default();
        if !format!("{:?}", i.class.opcode).starts_with("GroupNonUniform") {
            return Ok(false);
        }
        let d = self.result(i);
        match i.class.opcode {
            SpirvOp::GroupNonUniformBallot => {
                self.emit(Op::Ballot { d: d[0], a: source[0] });
            }
            SpirvOp::GroupNonUniformElect => {
                self.emit(Op::Elect { d: d[0] });
            }
            SpirvOp::GroupNonUniformAny => {
                self.emit(Op::Any { d: d[0], a: source[0] });
            }
            SpirvOp::GroupNonUniformAll => {
                self.emit(Op::All { d: d[0], a: source[0] });
            }
            op => {
                for (d, a) in d.into_iter().zip(source) {
                    self.emit(match op {
                        SpirvOp::GroupNonUniformShuffle | SpirvOp::GroupNonUniformBroadcast => {
                            Op::Shuffle { d, a, lane: second[0] }
                        }
                        SpirvOp::GroupNonUniformShuffleXor => Op::ShuffleXor { d, a, mask: second[0] },
                        SpirvOp::GroupNonUniformBroadcastFirst => Op::First { d, a },
                        _ => return unsupported(format!("Op{op:?}")),
                    });
                }
            }
        }
        Ok(true)
    }
}
