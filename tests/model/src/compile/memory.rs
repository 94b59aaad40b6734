//! Pointers, loads, stores, atomics, barriers.

use rspirv::dr::Instruction;
use rspirv::spirv::{Op as SpirvOp, Scope};

use super::{Compiler, Pointer, Target, Value};
use crate::error::{Result, unsupported};
use crate::module::{Id, Type, ids};
use crate::op::{Atomic, NO_ROW, Op, Orders, Place, Row, Space};

// Bits of memory semantics (SPIR-V 3.25).
const UNIFORM_MEMORY: u32 = 0x40;
const WORKGROUP_MEMORY: u32 = 0x100;

impl Compiler<'_> {
    pub(super) fn memory_instruction(&mut self, i: &Instruction) -> Result<bool> {
        let named = ids(i);
        match i.class.opcode {
            SpirvOp::AccessChain | SpirvOp::InBoundsAccessChain => self.access_chain(i, &named)?,
            SpirvOp::Load => self.load(i, named[0])?,
            SpirvOp::Store => {
                let (pointer, rows) = (self.pointer(named[0])?, self.operand(named[1])?);
                self.store(&pointer, &rows)?;
            }
            SpirvOp::ControlBarrier => self.control_barrier(i, &named)?,
            SpirvOp::MemoryBarrier => {
                if self.word(named[0]) != Scope::Subgroup as u32 {
                    let orders = self.orders(named[1]);
                    self.emit(Op::MemoryBarrier { orders });
                }
            }
            SpirvOp::ImageWrite => {
                let (at, texel) = (self.operand(named[1])?, self.operand(named[2])?);
                let Target::Image(binding) = self.pointer(named[0])?.target else {
                    return unsupported("a write to no image");
                };
                let texel = self.in_a_run(&texel);
                self.emit(Op::Image { binding, at: [at[0], at[1]], texel });
            }
            op => return self.atomic(i, op, &named),
        }
        Ok(true)
    }

    fn word(&self, constant: Id) -> u32 {
        self.module.constants.get(&constant).map_or(0, |c| c[0])
    }

    fn orders(&self, semantics: Id) -> Orders {
        let bits = self.word(semantics);
        Orders { shared: bits & WORKGROUP_MEMORY != 0, storage: bits & UNIFORM_MEMORY != 0 }
    }

    fn control_barrier(&mut self, i: &Instruction, named: &[Id]) -> Result<()> {
        let workgroup = match self.word(named[0]) {
            s if s == Scope::Workgroup as u32 => true,
            s if s == Scope::Subgroup as u32 => false,
            s => return unsupported(format!("a barrier of scope {s}")),
        };
        let orders = self.orders(named[2]);
        // The address names the instruction in its module: all inlined copies have one number.
        let key = self.barriers.len() as u32 + 1;
        let number = *self.barriers.entry(std::ptr::from_ref(i) as usize).or_insert(key);
        self.emit(Op::Barrier { workgroup, orders, number });
        Ok(())
    }

    fn access_chain(&mut self, i: &Instruction, named: &[Id]) -> Result<()> {
        let mut p = self.pointer(named[0])?;
        // Push constants have a row for each scalar, like private variables.
        let laid_out = matches!(p.target, Target::Buffer(_));
        let result = i.result_id.unwrap_or(0);
        let mut made = Vec::new();
        for index in &named[1..] {
            if let Some(words) = self.module.constants.get(index) {
                if self.module.elements(p.ty).is_some_and(|n| words[0] >= n) {
                    return unsupported(format!("the constant index {} is past the end", words[0]));
                }
                p.base += self.module.offset(p.ty, words[0], laid_out);
            } else {
                let a = self.operand(*index)?[0];
                if let Some(limit) = self.module.elements(p.ty) {
                    self.emit(Op::Limit { a, limit, name: p.name });
                }
                let stride = self.module.stride(p.ty, laid_out);
                if stride == 1 && p.at == NO_ROW {
                    p.at = a;
                } else {
                    let d = self.rows(1);
                    made.push(d);
                    self.emit(Op::Index { d, a, stride, add: p.at });
                    p.at = d;
                }
            }
            let member = self.module.constants.get(index).map_or(0, |w| w[0]);
            p.ty = self.module.part(p.ty, member);
        }
        self.own(result, &made);
        self.set(result, Value::Pointer(p));
        Ok(())
    }

    fn place(&self, p: &Pointer, offset: u32, count: u32) -> Place {
        let space = if let Target::Buffer(b) = p.target { Space::Buffer(b) } else { Space::Shared };
        Place { space, count: count as u8, base: p.base + offset, at: p.at }
    }

    /// Runs of neighbouring words of a value: offset of the first, its number, count.
    fn runs(&self, p: &Pointer) -> Vec<(u32, u32, u32)> {
        let offsets = self.module.scalar_offsets(p.ty, matches!(p.target, Target::Buffer(_)));
        let mut runs: Vec<(u32, u32, u32)> = Vec::new();
        for (k, offset) in (0..).zip(offsets) {
            match runs.last_mut() {
                Some((first, _, count)) if *first + *count == offset && *count < 16 => *count += 1,
                _ => runs.push((offset, k, 1)),
            }
        }
        runs
    }

    fn load(&mut self, i: &Instruction, pointer: Id) -> Result<()> {
        let p = self.pointer(pointer)?;
        let result = i.result_id.unwrap_or(0);
        if let Type::Image(_) = self.module.ty(p.ty) {
            self.set(result, Value::Pointer(p));
            return Ok(());
        }
        let size = self.module.size(p.ty);
        let facts = &self.facts[&self.scope.function];
        if p.target == Target::Private && p.at == NO_ROW && (facts.alias.contains(&result) || self.is_constant(&p)) {
            self.set(result, Value::Rows((p.base..p.base + size).collect()));
            return Ok(());
        }
        let rows = self.result(i);
        match p.target {
            Target::Private if p.at == NO_ROW => {
                for (d, a) in rows.into_iter().zip(p.base..) {
                    self.emit(Op::Copy { d, a });
                }
            }
            Target::Private => {
                for (d, base) in rows.into_iter().zip(p.base..) {
                    self.emit(Op::PrivateLoad { d, base, at: p.at });
                }
            }
            _ => {
                for (offset, k, count) in self.runs(&p) {
                    let place = self.place(&p, offset, count);
                    self.emit(Op::Load { d: rows[k as usize], place });
                }
            }
        }
        Ok(())
    }

    /// Inputs and push constants never change.
    fn is_constant(&self, p: &Pointer) -> bool {
        p.base < self.first_private
    }

    /// The same rows one after another, until the next rows are asked for.
    fn in_a_run(&mut self, rows: &[Row]) -> Row {
        if rows.windows(2).all(|w| w[1] == w[0] + 1) { rows[0] } else { self.copies(rows) }
    }

    fn copies(&mut self, rows: &[Row]) -> Row {
        let first = self.rows(rows.len() as u32);
        for (d, a) in (first..).zip(rows) {
            self.emit(Op::Copy { d, a: *a });
            self.scope.free.push(d);
        }
        first
    }

    pub(super) fn store(&mut self, p: &Pointer, rows: &[Row]) -> Result<()> {
        match p.target {
            Target::Private if p.at == NO_ROW => {
                let targets = p.base..p.base + rows.len() as u32;
                // The value may be made of the variable's own rows in another order.
                let overlaps = rows.len() > 1 && rows.iter().zip(p.base..).any(|(a, d)| *a != d && targets.contains(a));
                let rows: Vec<Row> = if overlaps {
                    let first = self.copies(rows);
                    (first..first + rows.len() as u32).collect()
                } else {
                    rows.to_vec()
                };
                for (a, d) in rows.into_iter().zip(p.base..) {
                    self.emit(Op::Move { d, a });
                }
            }
            Target::Private => {
                for (a, base) in rows.iter().zip(p.base..) {
                    self.emit(Op::PrivateStore { a: *a, base, at: p.at });
                }
            }
            Target::Image(_) => return unsupported("a store to an image"),
            _ => {
                for (offset, k, count) in self.runs(p) {
                    let a = self.in_a_run(&rows[k as usize..][..count as usize]);
                    let place = self.place(p, offset, count);
                    self.emit(Op::Store { a, place });
                }
            }
        }
        Ok(())
    }

    fn atomic(&mut self, i: &Instruction, op: SpirvOp, named: &[Id]) -> Result<bool> {
        let op = match op {
            SpirvOp::AtomicIAdd => Atomic::AddInt,
            SpirvOp::AtomicFAddEXT => Atomic::Add,
            SpirvOp::AtomicUMin => Atomic::MinUint,
            SpirvOp::AtomicUMax => Atomic::MaxUint,
            SpirvOp::AtomicAnd => Atomic::And,
            SpirvOp::AtomicOr => Atomic::Or,
            SpirvOp::AtomicXor => Atomic::Xor,
            SpirvOp::AtomicExchange => Atomic::Exchange,
            SpirvOp::AtomicCompareExchange => Atomic::CompareExchange,
            SpirvOp::AtomicLoad => Atomic::Load,
            SpirvOp::AtomicStore => Atomic::Store,
            _ => return Ok(false),
        };
        let p = self.pointer(named[0])?;
        if !matches!(p.target, Target::Shared | Target::Buffer(_)) {
            return unsupported("an atomic on private memory");
        }
        // pointer, scope, semantics (two for compare-exchange), value, comparator
        let (value, comparator) =
            if op == Atomic::CompareExchange { (named.get(4), named.get(5)) } else { (named.get(3), None) };
        let a = value.map_or(Ok(NO_ROW), |v| self.operand(*v).map(|r| r[0]))?;
        let b = comparator.map_or(Ok(NO_ROW), |v| self.operand(*v).map(|r| r[0]))?;
        let d = if i.result_id.is_some() { self.result(i)[0] } else { NO_ROW };
        let place = self.place(&p, 0, 1);
        self.emit(Op::Atomic { op, d, a, b, place });
        Ok(true)
    }
}
