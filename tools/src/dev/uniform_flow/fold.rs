//! What is known of a value before the shader runs, and how instructions compute with it.

use rspirv::dr::{Instruction, Operand};
use rspirv::spirv::{GlslStd450Op, Op, Word};

/// Knowledge of a scalar of 32 bits or a truth value. Grows from `Unset` upwards only.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Constant {
    /// Nothing reached it yet.
    Unset,
    /// Always this.
    Known(u32),
    /// Not always the same, or not followed.
    Varying,
}

impl Constant {
    /// What is known of a value that is one or the other.
    pub(super) fn join(self, other: Self) -> Self {
        match (self, other) {
            (Self::Unset, x) | (x, Self::Unset) => x,
            (Self::Known(a), Self::Known(b)) if a == b => self,
            _ => Self::Varying,
        }
    }
}

/// The result of an instruction without memory; `of` says what is known of an operand.
pub(super) fn fold(instruction: &Instruction, of: impl Fn(Word) -> Constant) -> Constant {
    let operands: Vec<Constant> = instruction.operands.iter().filter_map(Operand::id_ref_any).map(&of).collect();
    let op = instruction.class.opcode;
    if op == Op::ExtInst {
        return extended(instruction, &operands[1..]);
    }
    match (op, operands.as_slice()) {
        (Op::CopyObject | Op::Bitcast, [a]) => *a,
        // One side can decide alone.
        (Op::LogicalAnd, [Constant::Known(0), _] | [_, Constant::Known(0)]) => Constant::Known(0),
        (Op::LogicalOr, [Constant::Known(1), _] | [_, Constant::Known(1)]) => Constant::Known(1),
        (Op::UMod, [_, Constant::Known(1)]) => Constant::Known(0),
        (Op::Select, [Constant::Known(c), yes, no]) => {
            if *c != 0 {
                *yes
            } else {
                *no
            }
        }
        (Op::Select, [Constant::Unset, ..]) => Constant::Unset,
        (Op::Select, [_, yes, no]) => yes.join(*no),
        (_, [a]) => both(*a, Constant::Known(0), |a, _| unary(op, a)),
        (_, [a, b]) => both(*a, *b, |a, b| binary(op, a, b)),
        _ => Constant::Varying,
    }
}

fn both(a: Constant, b: Constant, compute: impl Fn(u32, u32) -> Option<u32>) -> Constant {
    match (a, b) {
        (Constant::Unset, _) | (_, Constant::Unset) => Constant::Unset,
        (Constant::Known(a), Constant::Known(b)) => compute(a, b).map_or(Constant::Varying, Constant::Known),
        _ => Constant::Varying,
    }
}

fn unary(op: Op, a: u32) -> Option<u32> {
    match op {
        Op::LogicalNot => Some(u32::from(a == 0)),
        Op::Not => Some(!a),
        Op::SNegate => Some(a.wrapping_neg()),
        _ => None,
    }
}

fn binary(op: Op, a: u32, b: u32) -> Option<u32> {
    let truth = |t: bool| Some(u32::from(t));
    match op {
        Op::IAdd => Some(a.wrapping_add(b)),
        Op::ISub => Some(a.wrapping_sub(b)),
        Op::IMul => Some(a.wrapping_mul(b)),
        Op::UDiv => a.checked_div(b),
        Op::UMod => a.checked_rem(b),
        Op::ShiftLeftLogical => a.checked_shl(b),
        Op::ShiftRightLogical => a.checked_shr(b),
        Op::BitwiseAnd => Some(a & b),
        Op::BitwiseOr => Some(a | b),
        Op::BitwiseXor => Some(a ^ b),
        Op::IEqual | Op::LogicalEqual => truth(a == b),
        Op::INotEqual | Op::LogicalNotEqual => truth(a != b),
        Op::ULessThan => truth(a < b),
        Op::ULessThanEqual => truth(a <= b),
        Op::UGreaterThan => truth(a > b),
        Op::UGreaterThanEqual => truth(a >= b),
        Op::SLessThan => truth((a as i32) < b as i32),
        Op::SLessThanEqual => truth(a as i32 <= b as i32),
        Op::SGreaterThan => truth(a as i32 > b as i32),
        Op::SGreaterThanEqual => truth(a as i32 >= b as i32),
        Op::LogicalAnd => truth(a != 0 && b != 0),
        Op::LogicalOr => truth(a != 0 || b != 0),
        _ => None,
    }
}

/// `min` and `max`: the only functions of GLSL in what chooses between ways.
fn extended(instruction: &Instruction, operands: &[Constant]) -> Constant {
    let Some(Operand::LiteralExtInstInteger(number)) = instruction.operands.get(1) else { return Constant::Varying };
    match operands {
        [a, b] if *number == GlslStd450Op::UMin as u32 => both(*a, *b, |a, b| Some(a.min(b))),
        [a, b] if *number == GlslStd450Op::UMax as u32 => both(*a, *b, |a, b| Some(a.max(b))),
        _ => Constant::Varying,
    }
}
