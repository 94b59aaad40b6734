//! Structured flow: selections, loops, breaks, continues, returns, phis.

use rspirv::dr::Instruction;
use rspirv::spirv::Op as SpirvOp;

use super::Compiler;
use crate::error::{Result, unsupported};
use crate::module::{Block, Function, Id, ids};
use crate::op::Op;

/// What encloses the block that is being compiled.
#[derive(Debug, Clone)]
pub(crate) enum Construct {
    Selection { merge: Id },
    Loop { header: Id, merge: Id, target: Id, frame: u16, continuing: bool },
}

/// How a branch leaves a construct.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Exit {
    /// To what follows anyway.
    Through,
    Break(u16),
    Continue(u16),
}

impl Compiler<'_> {
    /// The blocks of a function that has been entered.
    pub(super) fn body(&mut self, function: &Function) -> Result<()> {
        let returns = function.blocks.iter().filter_map(|b| b.instructions.last());
        let returns = returns.filter(|i| matches!(i.class.opcode, SpirvOp::Return | SpirvOp::ReturnValue)).count();
        let last = function.blocks.last().and_then(|b| b.instructions.last()).map(|i| i.class.opcode);
        // A single return that the flow always reaches needs no mask of its own.
        let single = returns == 1 && matches!(last, Some(SpirvOp::Return | SpirvOp::ReturnValue));
        if single {
            return self.chain(function, function.blocks[0].label);
        }
        let f = self.new_frame();
        self.scope.call_frame = Some(f);
        self.emit(Op::Call { f });
        self.scope.skips.push(Vec::new());
        self.chain(function, function.blocks[0].label)?;
        self.end_skips();
        self.emit(Op::CallEnd { f });
        Ok(())
    }

    fn new_frame(&mut self) -> u16 {
        self.frame += 1;
        self.code.frames = self.code.frames.max(self.frame);
        self.frame - 1
    }

    /// Operations that skip to the end of the construct go to here.
    fn end_skips(&mut self) {
        let here = self.here();
        for at in self.scope.skips.pop().unwrap_or_default() {
            self.go_to(at, here);
        }
    }

    fn go_to(&mut self, at: usize, target: u32) {
        match &mut self.code.ops[at] {
            Op::If { to, .. }
            | Op::Else { to, .. }
            | Op::SkipIfEmpty { to }
            | Op::BreakIf { to, .. }
            | Op::LoopContinue { to, .. }
            | Op::LoopBack { to } => *to = target,
            _ => {}
        }
    }

    fn skip_to_end(&mut self, op: Op) {
        let at = self.emit(op);
        if let Some(skips) = self.scope.skips.last_mut() {
            skips.push(at);
        }
    }

    /// Blocks from `label` on, until the enclosing construct is left.
    fn chain(&mut self, function: &Function, label: Id) -> Result<()> {
        let mut next = Some(label);
        while let Some(label) = next {
            let Some(block) = function.block_of_label.get(&label).map(|b| &function.blocks[*b]) else {
                return unsupported(format!("no block %{label}"));
            };
            let merge = block.instructions.iter().find(|i| i.class.opcode == SpirvOp::LoopMerge);
            let open =
                self.scope.constructs.iter().any(|c| matches!(c, Construct::Loop { header, .. } if *header == label));
            next = match merge {
                Some(merge) if !open => Some(self.whole_loop(function, label, &ids(merge))?),
                _ => self.block(function, block)?,
            };
        }
        Ok(())
    }

    /// A loop and all in it; returns its merge block.
    fn whole_loop(&mut self, function: &Function, header: Id, merge: &[Id]) -> Result<Id> {
        let [merge, target] = [merge[0], merge[1]];
        let frame = self.new_frame();
        self.loops += 1;
        self.open_loops.push(self.loops);
        self.emit(Op::Loop { f: frame });
        let head = self.here();
        self.scope.constructs.push(Construct::Loop { header, merge, target, frame, continuing: false });
        self.scope.skips.push(Vec::new());
        self.chain(function, header)?;
        self.end_skips();
        let leave = self.emit(Op::LoopContinue { f: frame, to: 0 });
        if let Some(Construct::Loop { continuing, .. }) = self.scope.constructs.last_mut() {
            *continuing = true;
        }
        self.scope.skips.push(Vec::new());
        if target != header {
            self.chain(function, target)?;
        }
        self.end_skips();
        self.emit(Op::LoopBack { to: head });
        let end = self.here();
        self.go_to(leave, end);
        self.emit(Op::LoopEnd { f: frame });
        self.scope.constructs.pop();
        self.open_loops.pop();
        self.frame = frame;
        if !self.scope.skips.is_empty() {
            self.skip_to_end(Op::SkipIfEmpty { to: 0 });
        }
        Ok(merge)
    }

    /// One block; returns the block that follows in this construct.
    fn block(&mut self, function: &Function, block: &Block) -> Result<Option<Id>> {
        for (at, i) in block.instructions.iter().enumerate() {
            let op = i.class.opcode;
            match op {
                SpirvOp::Branch => return self.branch(function, block.label, ids(i)[0]),
                SpirvOp::BranchConditional => {
                    let merge = block.instructions[..at].iter().find(|i| i.class.opcode == SpirvOp::SelectionMerge);
                    return self.conditional(function, block.label, i, merge.map(|m| ids(m)[0]));
                }
                SpirvOp::Return | SpirvOp::ReturnValue => return self.leave_function(i),
                SpirvOp::Unreachable => return Ok(None),
                SpirvOp::Switch | SpirvOp::Kill => return unsupported(format!("Op{op:?}")),
                SpirvOp::SelectionMerge | SpirvOp::LoopMerge | SpirvOp::Variable | SpirvOp::Nop | SpirvOp::Line => {}
                SpirvOp::Phi => self.phi(i),
                SpirvOp::FunctionCall => {
                    self.function_call(i)?;
                    self.release(i, at);
                }
                _ => {
                    self.instruction(i)?;
                    self.release(i, at);
                }
            }
        }
        unsupported(format!("block %{} has no end", block.label))
    }

    fn function_call(&mut self, i: &Instruction) -> Result<()> {
        let named = ids(i);
        let result = self.result(i);
        self.call(named[0], &named[1..], &result)
    }

    fn leave_function(&mut self, i: &Instruction) -> Result<Option<Id>> {
        if i.class.opcode == SpirvOp::ReturnValue {
            let rows = self.operand(ids(i)[0])?;
            for (d, a) in self.scope.result.clone().into_iter().zip(rows) {
                self.emit(Op::Move { d, a });
            }
        }
        if let Some(f) = self.scope.call_frame {
            self.emit(Op::Return { f });
        }
        Ok(None)
    }

    fn exit(&self, target: Id) -> Option<Exit> {
        if let Some(Construct::Selection { merge }) = self.scope.constructs.last()
            && *merge == target
        {
            return Some(Exit::Through);
        }
        let innermost = self.scope.constructs.len().checked_sub(1);
        let at = self.scope.constructs.iter().rposition(|c| matches!(c, Construct::Loop { .. }))?;
        let Construct::Loop { header, merge, target: continue_target, frame, continuing } = &self.scope.constructs[at]
        else {
            return None;
        };
        if target == *merge {
            Some(Exit::Break(*frame))
        } else if *continuing && target == *header {
            Some(Exit::Through)
        } else if !*continuing && target == *continue_target {
            Some(if innermost == Some(at) { Exit::Through } else { Exit::Continue(*frame) })
        } else {
            None
        }
    }

    fn leave(&mut self, exit: Exit) {
        match exit {
            Exit::Through => {}
            Exit::Break(f) => {
                self.emit(Op::Break { f });
            }
            Exit::Continue(f) => {
                self.emit(Op::Continue { f });
            }
        }
    }

    fn branch(&mut self, function: &Function, from: Id, target: Id) -> Result<Option<Id>> {
        self.write_phis(function, from, target)?;
        match self.exit(target) {
            Some(exit) => {
                self.leave(exit);
                Ok(None)
            }
            None => Ok(Some(target)),
        }
    }

    fn conditional(&mut self, function: &Function, from: Id, i: &Instruction, merge: Option<Id>) -> Result<Option<Id>> {
        let named = ids(i);
        let [on_true, on_false] = [named[1], named[2]];
        let c = self.operand(named[0])?[0];
        if let Some(merge) = merge {
            self.selection(function, from, [on_true, on_false], c, merge)?;
            return Ok(Some(merge));
        }
        for (when, leaves, stays) in [(true, on_true, on_false), (false, on_false, on_true)] {
            if let Some(Exit::Break(f)) = self.exit(leaves) {
                if self.has_phis(function, leaves) {
                    return unsupported("a phi of a value that a loop's break brings");
                }
                self.skip_to_end(Op::BreakIf { f, c, when, to: 0 });
                return self.branch(function, from, stays);
            }
        }
        unsupported(format!("a branch without a merge in block %{from}"))
    }

    fn selection(&mut self, function: &Function, from: Id, arms: [Id; 2], c: u32, merge: Id) -> Result<()> {
        let f = self.new_frame();
        self.scope.constructs.push(Construct::Selection { merge });
        self.scope.skips.push(Vec::new());
        let start = self.code.ops.len();
        let op = self.emit(Op::If { f, c, to: 0 });
        self.arm(function, from, arms[0])?;
        self.end_skips();
        let otherwise = self.emit(Op::Else { f, to: 0 });
        self.go_to(op, otherwise as u32);
        self.scope.skips.push(Vec::new());
        self.arm(function, from, arms[1])?;
        self.end_skips();
        let end = self.emit(Op::EndIf { f });
        self.go_to(otherwise, end as u32);
        self.scope.constructs.pop();
        self.frame = f;
        let leaves = |o: &Op| matches!(o, Op::Break { .. } | Op::Continue { .. } | Op::Return { .. });
        if self.code.ops[start..].iter().any(leaves) && !self.scope.skips.is_empty() {
            self.skip_to_end(Op::SkipIfEmpty { to: 0 });
        }
        Ok(())
    }

    fn arm(&mut self, function: &Function, from: Id, target: Id) -> Result<()> {
        match self.branch(function, from, target)? {
            Some(label) => self.chain(function, label),
            None => Ok(()),
        }
    }

    fn phis(function: &Function, target: Id) -> impl Iterator<Item = &Instruction> {
        let block = function.block_of_label.get(&target).map(|b| &function.blocks[*b]);
        block.into_iter().flat_map(|b| b.instructions.iter().take_while(|i| i.class.opcode == SpirvOp::Phi))
    }

    fn has_phis(&self, function: &Function, target: Id) -> bool {
        Self::phis(function, target).next().is_some()
    }

    /// Writes the phis of `target` for lanes that come from `from`.
    fn write_phis(&mut self, function: &Function, from: Id, target: Id) -> Result<()> {
        let block: Vec<&Instruction> = Self::phis(function, target).collect();
        for i in &block {
            let named = ids(i);
            let Some(pair) = named.chunks_exact(2).find(|pair| pair[1] == from) else {
                return unsupported(format!("a phi without a value from %{from}"));
            };
            if block.iter().any(|p| p.result_id == Some(pair[0])) {
                return unsupported("phis that take turns");
            }
            let rows = self.operand(pair[0])?;
            for (d, a) in self.phi_rows(i).into_iter().zip(rows) {
                self.emit(Op::Move { d, a });
            }
        }
        Ok(())
    }

    fn phi_rows(&mut self, i: &Instruction) -> Vec<u32> {
        let id = i.result_id.unwrap_or(0);
        if let Some(rows) = self.scope.phis.get(&id) {
            return rows.clone();
        }
        let rows: Vec<u32> = (0..self.module.size(i.result_type.unwrap_or(0))).map(|_| self.rows(1)).collect();
        self.scope.phis.insert(id, rows.clone());
        rows
    }

    fn phi(&mut self, i: &Instruction) {
        let rows = self.phi_rows(i);
        let id = i.result_id.unwrap_or(0);
        self.set(id, super::Value::Rows(rows));
    }
}
