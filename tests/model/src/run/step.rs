//! Runs a subgroup from one point where it may be interrupted to the next.

use super::arithmetic::{binary, unary};
use super::lanes::{Frame, Lanes};
use super::memory::Memory;
use super::random::Random;
use super::{Image, POISON};
use crate::compile::Code;
use crate::error::{ModelError, Result};
use crate::op::{NO_ROW, Op, Orders, Row};

/// Rounds of loops after which a dispatch is given up.
const MAX_ROUNDS: u64 = 1 << 32;

/// Why a subgroup stopped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Stop {
    /// Another may go on.
    Interrupted,
    /// At a workgroup barrier: number, what it orders, whether it is really one of a subgroup.
    Barrier {
        number: u32,
        orders: Orders,
    },
    Done,
}

/// What a subgroup sees beside its own rows.
pub(crate) struct World<'a> {
    pub(crate) code: &'a Code,
    pub(crate) buffers: &'a mut [Memory],
    pub(crate) images: &'a [Option<Image>],
    pub(crate) shared: &'a mut Memory,
    pub(crate) group: u32,
    /// Workgroup barriers passed that order shared memory, and storage.
    pub(crate) shared_epoch: u32,
    pub(crate) storage_epoch: u32,
    pub(crate) random: &'a mut Random,
    pub(crate) rounds: &'a mut u64,
    /// Memory operations until the next interruption.
    pub(crate) left: u32,
    pub(crate) subgroup_barrier_is_workgroup: bool,
}

impl World<'_> {
    pub(super) fn place(&self, pc: usize) -> u16 {
        self.code.place_of_op[pc]
    }

    pub(super) fn place_name(&self, pc: usize) -> String {
        self.code.places[usize::from(self.place(pc))].clone()
    }

    pub(super) fn barrier_name(&self, pc: usize, workgroup: bool, number: u32) -> String {
        let scope = if workgroup { "workgroup" } else { "subgroup" };
        format!("{scope} barrier {number} in {}", self.place_name(pc))
    }

    /// Runs until an interruption, a barrier of the workgroup or the end.
    pub(crate) fn run<const L: usize>(&mut self, lanes: &mut Lanes<L>) -> Result<Stop> {
        let code = self.code;
        loop {
            let pc = lanes.pc;
            lanes.pc += 1;
            match code.ops[pc] {
                Op::Unary { op, d, a } => unary(lanes, op, d, a),
                Op::Binary { op, d, a, b } => binary(lanes, op, d, a, b),
                Op::Select { d, c, a, b } => select(lanes, d, c, [a, b]),
                Op::Move { d, a } => {
                    let value = *lanes.row(a);
                    lanes.set_masked(d, &value);
                }
                Op::Copy { d, a } => {
                    let value = *lanes.row(a);
                    lanes.set(d, value);
                }
                Op::Poison { first, count } => {
                    for row in first..first + count {
                        lanes.set_masked(row, &[POISON; L]);
                    }
                }
                Op::Index { d, a, stride, add } => index(lanes, d, a, stride, add),
                Op::Limit { a, limit, name } => self.limit(lanes, pc, a, limit, name)?,
                Op::PrivateLoad { d, base, at } => private_load(lanes, d, base, at),
                Op::PrivateStore { a, base, at } => private_store(lanes, a, base, at),
                Op::Load { d, place } => {
                    self.load(lanes, pc, d, place)?;
                    if self.interrupted() {
                        return Ok(Stop::Interrupted);
                    }
                }
                Op::Store { a, place } => {
                    self.store(lanes, pc, a, place)?;
                    if self.interrupted() {
                        return Ok(Stop::Interrupted);
                    }
                }
                Op::Atomic { op, d, a, b, place } => {
                    self.atomic(lanes, pc, op, [d, a, b], place)?;
                    if self.interrupted() {
                        return Ok(Stop::Interrupted);
                    }
                }
                Op::Image { binding, at, texel } => self.image(lanes, pc, binding, at, texel)?,
                Op::Barrier { workgroup, orders, number } => {
                    if let Some(stop) = self.barrier(lanes, pc, workgroup, orders, number)? {
                        return Ok(stop);
                    }
                }
                Op::MemoryBarrier { orders } => lanes.also_orders = orders,
                Op::End => return Ok(Stop::Done),
                op => {
                    if !super::group::step(lanes, op) {
                        flow(lanes, op);
                        self.count(op)?;
                    }
                }
            }
        }
    }

    fn count(&mut self, op: Op) -> Result<()> {
        if matches!(op, Op::LoopBack { .. }) {
            *self.rounds += 1;
            if *self.rounds > MAX_ROUNDS {
                return Err(ModelError::Endless(MAX_ROUNDS));
            }
        }
        Ok(())
    }

    fn interrupted(&mut self) -> bool {
        self.left = self.left.saturating_sub(1);
        self.left == 0
    }

    fn limit<const L: usize>(&self, lanes: &Lanes<L>, pc: usize, a: Row, limit: u32, name: u32) -> Result<()> {
        let row = lanes.row(a);
        if row.iter().all(|i| *i < limit) {
            return Ok(());
        }
        match lanes.active().find(|l| row[*l] >= limit) {
            None => Ok(()),
            Some(lane) => Err(ModelError::OutOfBounds {
                memory: self.code.names[name as usize].clone(),
                index: row[lane],
                length: limit,
                place: self.place_name(pc),
            }),
        }
    }

    fn barrier<const L: usize>(
        &self,
        lanes: &mut Lanes<L>,
        pc: usize,
        workgroup: bool,
        orders: Orders,
        number: u32,
    ) -> Result<Option<Stop>> {
        if lanes.mask == 0 {
            return Ok(None);
        }
        if lanes.mask != lanes.all {
            return Err(ModelError::DivergentBarrier {
                barrier: self.barrier_name(pc, workgroup, number),
                active: lanes.mask.count_ones(),
                lanes: lanes.all.count_ones(),
                subgroup: lanes.index.into(),
            });
        }
        if !workgroup {
            lanes.shared_epoch += u32::from(orders.shared);
            lanes.storage_epoch += u32::from(orders.storage);
        }
        if workgroup {
            let also = std::mem::take(&mut lanes.also_orders);
            let orders = Orders { shared: orders.shared | also.shared, storage: orders.storage | also.storage };
            return Ok(Some(Stop::Barrier { number, orders }));
        }
        // Between subgroups it orders nothing, whatever a driver makes of it.
        let nothing = Orders { shared: false, storage: false };
        Ok(self.subgroup_barrier_is_workgroup.then_some(Stop::Barrier { number, orders: nothing }))
    }
}

fn select<const L: usize>(lanes: &mut Lanes<L>, d: Row, c: Row, [a, b]: [Row; 2]) {
    let (c, a, b) = (lanes.row(c), lanes.row(a), lanes.row(b));
    let mut out = [0; L];
    for i in 0..L {
        out[i] = if c[i] != 0 { a[i] } else { b[i] };
    }
    lanes.set(d, out);
}

fn index<const L: usize>(lanes: &mut Lanes<L>, d: Row, a: Row, stride: u32, add: Row) {
    let mut out = *lanes.row(a);
    if stride != 1 {
        out.iter_mut().for_each(|x| *x = x.saturating_mul(stride));
    }
    if add != NO_ROW {
        out.iter_mut().zip(lanes.row(add)).for_each(|(x, y)| *x = x.saturating_add(*y));
    }
    lanes.set(d, out);
}

/// The index has been checked where it counts; lanes that are not active may hold any.
fn private_load<const L: usize>(lanes: &mut Lanes<L>, d: Row, base: Row, at: Row) {
    let mut out = [POISON; L];
    for lane in lanes.active() {
        let row = base.saturating_add(lanes.row(at)[lane]);
        out[lane] = lanes.rows.get(row as usize).map_or(POISON, |r| r[lane]);
    }
    lanes.set(d, out);
}

fn private_store<const L: usize>(lanes: &mut Lanes<L>, a: Row, base: Row, at: Row) {
    for lane in lanes.active() {
        let row = base.saturating_add(lanes.row(at)[lane]);
        let value = lanes.row(a)[lane];
        if let Some(r) = lanes.rows.get_mut(row as usize) {
            r[lane] = value;
        }
    }
}

/// Masks and jumps.
fn flow<const L: usize>(lanes: &mut Lanes<L>, op: Op) {
    match op {
        Op::If { f, c, to } => {
            let yes = lanes.truth(c);
            lanes.frames[usize::from(f)] = Frame { a: lanes.mask & !yes, b: 0 };
            lanes.mask &= yes;
            jump_if_empty(lanes, to);
        }
        Op::Else { f, to } => {
            let frame = &mut lanes.frames[usize::from(f)];
            frame.b = lanes.mask;
            lanes.mask = frame.a;
            jump_if_empty(lanes, to);
        }
        Op::EndIf { f } => lanes.mask |= lanes.frames[usize::from(f)].b,
        Op::SkipIfEmpty { to } => jump_if_empty(lanes, to),
        Op::Loop { f } | Op::Call { f } => lanes.frames[usize::from(f)] = Frame::default(),
        Op::Break { f } | Op::Return { f } => {
            lanes.frames[usize::from(f)].a |= lanes.mask;
            lanes.mask = 0;
        }
        Op::BreakIf { f, c, when, to } => {
            let yes = lanes.truth(c);
            let leave = lanes.mask & if when { yes } else { !yes };
            lanes.frames[usize::from(f)].a |= leave;
            lanes.mask &= !leave;
            jump_if_empty(lanes, to);
        }
        Op::Continue { f } => {
            lanes.frames[usize::from(f)].b |= lanes.mask;
            lanes.mask = 0;
        }
        Op::LoopContinue { f, to } => {
            lanes.mask |= std::mem::take(&mut lanes.frames[usize::from(f)].b);
            jump_if_empty(lanes, to);
        }
        Op::LoopBack { to } if lanes.mask != 0 => lanes.pc = to as usize,
        Op::LoopEnd { f } | Op::CallEnd { f } => lanes.mask = lanes.frames[usize::from(f)].a,
        _ => {}
    }
}

fn jump_if_empty<const L: usize>(lanes: &mut Lanes<L>, to: u32) {
    if lanes.mask == 0 {
        lanes.pc = to as usize;
    }
}
