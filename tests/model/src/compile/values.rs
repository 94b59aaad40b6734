//! Arithmetic, comparisons, conversions, vectors, GLSL.std.450: scalar by scalar.

use rspirv::dr::Instruction;
use rspirv::spirv::{GlslStd450Op as GlOp, Op as SpirvOp};

use super::{Compiler, Value};
use crate::error::{Result, unsupported};
use crate::module::{Id, ids, literals};
use crate::op::{Binary as B, Op, Row, Unary as U};

fn unary(op: SpirvOp) -> Option<U> {
    Some(match op {
        SpirvOp::Not => U::Not,
        SpirvOp::LogicalNot => U::LogicalNot,
        SpirvOp::FNegate => U::Negate,
        SpirvOp::SNegate => U::NegateInt,
        SpirvOp::BitCount => U::BitCount,
        SpirvOp::ConvertUToF => U::FloatOfUint,
        SpirvOp::ConvertSToF => U::FloatOfInt,
        SpirvOp::ConvertFToU => U::UintOfFloat,
        SpirvOp::ConvertFToS => U::IntOfFloat,
        SpirvOp::IsNan => U::IsNan,
        SpirvOp::IsInf => U::IsInf,
        _ => return None,
    })
}

/// The operation, and whether its operands change places.
fn binary(op: SpirvOp) -> Option<(B, bool)> {
    let same = |b| Some((b, false));
    let swapped = |b| Some((b, true));
    match op {
        SpirvOp::FAdd => same(B::Add),
        SpirvOp::FSub => same(B::Subtract),
        SpirvOp::FMul => same(B::Multiply),
        SpirvOp::FDiv => same(B::Divide),
        SpirvOp::FMod => same(B::Remainder),
        SpirvOp::IAdd => same(B::AddInt),
        SpirvOp::ISub => same(B::SubtractInt),
        SpirvOp::IMul => same(B::MultiplyInt),
        SpirvOp::UDiv => same(B::DivideUint),
        SpirvOp::UMod => same(B::RemainderUint),
        SpirvOp::SDiv => same(B::DivideInt),
        SpirvOp::SRem => same(B::RemainderInt),
        SpirvOp::BitwiseAnd | SpirvOp::LogicalAnd => same(B::And),
        SpirvOp::BitwiseOr | SpirvOp::LogicalOr => same(B::Or),
        SpirvOp::BitwiseXor => same(B::Xor),
        SpirvOp::ShiftLeftLogical => same(B::ShiftLeft),
        SpirvOp::ShiftRightLogical => same(B::ShiftRight),
        SpirvOp::ShiftRightArithmetic => same(B::ShiftRightInt),
        SpirvOp::IEqual | SpirvOp::LogicalEqual => same(B::EqualInt),
        SpirvOp::INotEqual | SpirvOp::LogicalNotEqual => same(B::NotEqualInt),
        SpirvOp::ULessThan => same(B::LessUint),
        SpirvOp::UGreaterThan => swapped(B::LessUint),
        SpirvOp::ULessThanEqual => same(B::LessEqualUint),
        SpirvOp::UGreaterThanEqual => swapped(B::LessEqualUint),
        SpirvOp::SLessThan => same(B::LessInt),
        SpirvOp::SGreaterThan => swapped(B::LessInt),
        SpirvOp::SLessThanEqual => same(B::LessEqualInt),
        SpirvOp::SGreaterThanEqual => swapped(B::LessEqualInt),
        SpirvOp::FOrdEqual => same(B::Equal),
        SpirvOp::FOrdNotEqual => same(B::NotEqual),
        SpirvOp::FUnordNotEqual => same(B::UnorderedNotEqual),
        SpirvOp::FOrdLessThan => same(B::Less),
        SpirvOp::FOrdGreaterThan => swapped(B::Less),
        SpirvOp::FOrdLessThanEqual => same(B::LessEqual),
        SpirvOp::FOrdGreaterThanEqual => swapped(B::LessEqual),
        _ => None,
    }
}

impl Compiler<'_> {
    /// An instruction that is neither flow nor a call.
    pub(super) fn instruction(&mut self, i: &Instruction) -> Result<()> {
        let op = i.class.opcode;
        let named = ids(i);
        if let Some(op) = unary(op) {
            let a = self.operand(named[0])?;
            for (d, a) in self.result(i).into_iter().zip(a) {
                self.emit(Op::Unary { op, d, a });
            }
        } else if let Some((op, swapped)) = binary(op) {
            let (mut a, mut b) = (self.operand(named[0])?, self.operand(named[1])?);
            if swapped {
                std::mem::swap(&mut a, &mut b);
            }
            let d = self.result(i);
            for (d, (a, b)) in d.into_iter().zip(a.into_iter().zip(b)) {
                self.emit(Op::Binary { op, d, a, b });
            }
        } else if !self.vectors(i)? && !self.subgroup(i)? && !self.memory_instruction(i)? {
            return unsupported(format!("Op{op:?}"));
        }
        Ok(())
    }

    fn rename(&mut self, i: &Instruction, rows: Vec<Row>) {
        self.set(i.result_id.unwrap_or(0), Value::Rows(rows));
    }

    fn vectors(&mut self, i: &Instruction) -> Result<bool> {
        let (named, numbers) = (ids(i), literals(i));
        match i.class.opcode {
            SpirvOp::Bitcast | SpirvOp::CopyObject | SpirvOp::CopyLogical => {
                let rows = self.operand(named[0])?;
                self.rename(i, rows);
            }
            SpirvOp::CompositeConstruct => {
                let parts = named.iter().map(|n| self.operand(*n)).collect::<Result<Vec<_>>>()?;
                self.rename(i, parts.concat());
            }
            SpirvOp::CompositeExtract => {
                let rows = self.operand(named[0])?;
                let (first, end) = self.part_of(named[0], &numbers);
                self.rename(i, rows[first..end].to_vec());
            }
            SpirvOp::CompositeInsert => {
                let (part, mut rows) = (self.operand(named[0])?, self.operand(named[1])?);
                let (first, end) = self.part_of(named[1], &numbers);
                rows[first..end].copy_from_slice(&part);
                self.rename(i, rows);
            }
            SpirvOp::VectorShuffle => {
                let both = [self.operand(named[0])?, self.operand(named[1])?].concat();
                let rows = numbers.iter().map(|n| both.get(*n as usize).copied().unwrap_or(both[0])).collect();
                self.rename(i, rows);
            }
            SpirvOp::Undef => {
                let zero = self.constant(0)?;
                let size = self.module.size(i.result_type.unwrap_or(0));
                self.rename(i, vec![zero; size as usize]);
            }
            SpirvOp::Select => {
                let [c, a, b] = [self.operand(named[0])?, self.operand(named[1])?, self.operand(named[2])?];
                for (k, d) in self.result(i).into_iter().enumerate() {
                    let c = c[if c.len() == 1 { 0 } else { k }];
                    self.emit(Op::Select { d, c, a: a[k], b: b[k] });
                }
            }
            SpirvOp::Dot => {
                let (a, b) = (self.operand(named[0])?, self.operand(named[1])?);
                let d = self.result(i)[0];
                self.dot(d, &a, &b);
            }
            SpirvOp::VectorTimesScalar | SpirvOp::MatrixTimesScalar => {
                let (a, b) = (self.operand(named[0])?, self.operand(named[1])?[0]);
                for (d, a) in self.result(i).into_iter().zip(a) {
                    self.emit(Op::Binary { op: B::Multiply, d, a, b });
                }
            }
            SpirvOp::VectorTimesMatrix => {
                let (v, m) = (self.operand(named[0])?, self.operand(named[1])?);
                let columns: Vec<Vec<Row>> = m.chunks_exact(v.len()).map(<[Row]>::to_vec).collect();
                for (d, column) in self.result(i).into_iter().zip(columns) {
                    self.dot(d, &v, &column);
                }
            }
            SpirvOp::MatrixTimesVector => {
                let (m, v) = (self.operand(named[0])?, self.operand(named[1])?);
                let rows = m.len() / v.len();
                for (r, d) in self.result(i).into_iter().enumerate() {
                    let row: Vec<Row> = (0..v.len()).map(|c| m[c * rows + r]).collect();
                    self.dot(d, &row, &v);
                }
            }
            SpirvOp::Any | SpirvOp::All => {
                let a = self.operand(named[0])?;
                let op = if i.class.opcode == SpirvOp::Any { B::Or } else { B::And };
                let d = self.result(i)[0];
                self.emit(Op::Copy { d, a: a[0] });
                for b in &a[1..] {
                    self.emit(Op::Binary { op, d, a: d, b: *b });
                }
            }
            SpirvOp::ExtInst => self.extended(i)?,
            _ => return Ok(false),
        }
        Ok(true)
    }

    /// First and end of the rows of a part of a value.
    fn part_of(&self, id: Id, indices: &[u32]) -> (usize, usize) {
        let mut ty = self.module.type_of.get(&id).copied().unwrap_or(0);
        let mut first = 0;
        for &index in indices {
            first += self.module.offset(ty, index, false);
            ty = self.module.part(ty, index);
        }
        (first as usize, (first + self.module.size(ty)) as usize)
    }

    /// A row until the next ones are asked for.
    fn scratch(&mut self) -> Row {
        let row = self.rows(1);
        self.scope.free.push(row);
        row
    }

    /// d = a . b, from the first component on.
    fn dot(&mut self, d: Row, a: &[Row], b: &[Row]) {
        let product = self.scratch();
        for (k, (a, b)) in a.iter().zip(b).enumerate() {
            let to = if k == 0 { d } else { product };
            self.emit(Op::Binary { op: B::Multiply, d: to, a: *a, b: *b });
            if k > 0 {
                self.emit(Op::Binary { op: B::Add, d, a: d, b: product });
            }
        }
    }

    fn extended(&mut self, i: &Instruction) -> Result<()> {
        let number = literals(i)[0];
        let Some(op) = GlOp::from_u32(number) else { return unsupported(format!("GLSL.std.450 {number}")) };
        let arguments = ids(i)[1..].iter().map(|a| self.operand(*a)).collect::<Result<Vec<_>>>()?;
        let d = self.result(i);
        let simple = match op {
            GlOp::Sqrt => U::Sqrt,
            GlOp::InverseSqrt => U::InverseSqrt,
            GlOp::Exp => U::Exp,
            GlOp::Exp2 => U::Exp2,
            GlOp::Log => U::Log,
            GlOp::Log2 => U::Log2,
            GlOp::Sin => U::Sin,
            GlOp::Cos => U::Cos,
            GlOp::Floor => U::Floor,
            GlOp::Ceil => U::Ceil,
            GlOp::Fract => U::Fract,
            GlOp::Round | GlOp::RoundEven => U::Round,
            GlOp::Trunc => U::Trunc,
            GlOp::FAbs => U::Abs,
            GlOp::SAbs => U::AbsInt,
            GlOp::FSign => U::Sign,
            GlOp::FindILsb => U::LowestBit,
            GlOp::FindUMsb => U::HighestBit,
            _ => return self.extended_of_many(op, &arguments, &d),
        };
        for (d, a) in d.into_iter().zip(&arguments[0]) {
            self.emit(Op::Unary { op: simple, d, a: *a });
        }
        Ok(())
    }

    fn extended_of_many(&mut self, op: GlOp, arguments: &[Vec<Row>], d: &[Row]) -> Result<()> {
        let two = match op {
            GlOp::FMin | GlOp::NMin => B::Min,
            GlOp::FMax | GlOp::NMax => B::Max,
            GlOp::UMin => B::MinUint,
            GlOp::UMax => B::MaxUint,
            GlOp::SMin => B::MinInt,
            GlOp::SMax => B::MaxInt,
            GlOp::Pow => B::Pow,
            GlOp::Atan2 => B::Atan2,
            _ => return self.extended_special(op, arguments, d),
        };
        for (k, d) in d.iter().enumerate() {
            self.emit(Op::Binary { op: two, d: *d, a: arguments[0][k], b: arguments[1][k] });
        }
        Ok(())
    }

    fn extended_special(&mut self, op: GlOp, x: &[Vec<Row>], d: &[Row]) -> Result<()> {
        match op {
            GlOp::FClamp | GlOp::NClamp | GlOp::UClamp | GlOp::SClamp => {
                let (low, high) = match op {
                    GlOp::UClamp => (B::MaxUint, B::MinUint),
                    GlOp::SClamp => (B::MaxInt, B::MinInt),
                    _ => (B::Max, B::Min),
                };
                for (k, d) in d.iter().enumerate() {
                    self.emit(Op::Binary { op: low, d: *d, a: x[0][k], b: x[1][k] });
                    self.emit(Op::Binary { op: high, d: *d, a: *d, b: x[2][k] });
                }
            }
            GlOp::Fma => {
                for (k, d) in d.iter().enumerate() {
                    self.emit(Op::Binary { op: B::Multiply, d: *d, a: x[0][k], b: x[1][k] });
                    self.emit(Op::Binary { op: B::Add, d: *d, a: *d, b: x[2][k] });
                }
            }
            GlOp::FMix => {
                let (rest, one) = (self.scratch(), self.constant(1.0_f32.to_bits())?);
                for (k, d) in d.iter().enumerate() {
                    // a (1 - t) + b t
                    self.emit(Op::Binary { op: B::Subtract, d: rest, a: one, b: x[2][k] });
                    self.emit(Op::Binary { op: B::Multiply, d: rest, a: x[0][k], b: rest });
                    self.emit(Op::Binary { op: B::Multiply, d: *d, a: x[1][k], b: x[2][k] });
                    self.emit(Op::Binary { op: B::Add, d: *d, a: rest, b: *d });
                }
            }
            GlOp::Length => {
                self.dot(d[0], &x[0], &x[0]);
                self.emit(Op::Unary { op: U::Sqrt, d: d[0], a: d[0] });
            }
            GlOp::Normalize => {
                let length = self.scratch();
                self.dot(length, &x[0], &x[0]);
                self.emit(Op::Unary { op: U::InverseSqrt, d: length, a: length });
                for (d, a) in d.iter().zip(&x[0]) {
                    self.emit(Op::Binary { op: B::Multiply, d: *d, a: *a, b: length });
                }
            }
            GlOp::Cross => self.cross(&x[0], &x[1], d),
            GlOp::PackHalf2x16 => {
                self.emit(Op::Binary { op: B::PackHalf, d: d[0], a: x[0][0], b: x[0][1] });
            }
            GlOp::UnpackHalf2x16 => {
                self.emit(Op::Unary { op: U::HalfLow, d: d[0], a: x[0][0] });
                self.emit(Op::Unary { op: U::HalfHigh, d: d[1], a: x[0][0] });
            }
            GlOp::PackUnorm4x8 => self.pack_unorm(&x[0], d[0])?,
            GlOp::UnpackUnorm4x8 => self.unpack_unorm(x[0][0], d)?,
            _ => return unsupported(format!("{op:?} of GLSL.std.450")),
        }
        Ok(())
    }

    fn cross(&mut self, a: &[Row], b: &[Row], d: &[Row]) {
        let product = self.scratch();
        for k in 0..3 {
            let (i, j) = ((k + 1) % 3, (k + 2) % 3);
            self.emit(Op::Binary { op: B::Multiply, d: d[k], a: a[i], b: b[j] });
            self.emit(Op::Binary { op: B::Multiply, d: product, a: a[j], b: b[i] });
            self.emit(Op::Binary { op: B::Subtract, d: d[k], a: d[k], b: product });
        }
    }

    /// round(clamp(x, 0, 1) * 255), one byte each.
    fn pack_unorm(&mut self, x: &[Row], d: Row) -> Result<()> {
        let [zero, one, largest] =
            [self.constant(0)?, self.constant(1.0_f32.to_bits())?, self.constant(255.0_f32.to_bits())?];
        let byte = self.scratch();
        self.emit(Op::Copy { d, a: zero });
        for (k, a) in x.iter().enumerate() {
            self.emit(Op::Binary { op: B::Max, d: byte, a: *a, b: zero });
            self.emit(Op::Binary { op: B::Min, d: byte, a: byte, b: one });
            self.emit(Op::Binary { op: B::Multiply, d: byte, a: byte, b: largest });
            self.emit(Op::Unary { op: U::Round, d: byte, a: byte });
            self.emit(Op::Unary { op: U::UintOfFloat, d: byte, a: byte });
            let shift = self.constant(8 * k as u32)?;
            self.emit(Op::Binary { op: B::ShiftLeft, d: byte, a: byte, b: shift });
            self.emit(Op::Binary { op: B::Or, d, a: d, b: byte });
        }
        Ok(())
    }

    fn unpack_unorm(&mut self, a: Row, d: &[Row]) -> Result<()> {
        let [mask, largest] = [self.constant(255)?, self.constant(255.0_f32.to_bits())?];
        for (k, d) in d.iter().enumerate() {
            let shift = self.constant(8 * k as u32)?;
            self.emit(Op::Binary { op: B::ShiftRight, d: *d, a, b: shift });
            self.emit(Op::Binary { op: B::And, d: *d, a: *d, b: mask });
            self.emit(Op::Unary { op: U::FloatOfUint, d: *d, a: *d });
            self.emit(Op::Binary { op: B::Divide, d: *d, a: *d, b: largest });
        }
        Ok(())
    }
}
