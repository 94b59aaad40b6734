//! What can be reached under one choice of the specialisation constants: constants are followed through values and scalar
//! variables, and a branch on a known value has one way.

use std::collections::HashMap;

use rspirv::dr::{Instruction, Operand};
use rspirv::spirv::{Op, Word};

use super::flatten::{Block, End, Program};
use super::fold::{Constant, fold};
use super::module::Module;

/// What can happen.
pub(super) struct Reach {
    /// Of each block.
    pub(super) reached: Vec<bool>,
    /// Whereto each block can go on.
    pub(super) successors: Vec<Vec<usize>>,
    values: HashMap<Word, Constant>,
}

impl Reach {
    /// What is known of a value.
    pub(super) fn value(&self, id: Word) -> Constant {
        self.values.get(&id).copied().unwrap_or(Constant::Varying)
    }
}

/// Follows the constants; `chosen`: a specialisation constant and its value, the others are unknown.
pub(super) fn reach(module: &Module, program: &Program, chosen: Option<(Word, u32)>) -> Reach {
    let mut state = State {
        values: HashMap::new(),
        memory: HashMap::new(),
        reached: vec![false; program.blocks.len()],
        open: vec![false; program.blocks.len()],
        changed: true,
    };
    state.declare(module.declarations(), chosen);
    state.reached[0] = true;
    loop {
        while std::mem::take(&mut state.changed) {
            for (index, block) in program.blocks.iter().enumerate() {
                if state.reached[index] {
                    state.block(index, block);
                }
            }
        }
        // A branch on what is never set is undefined; both ways count then.
        let undecided: Vec<usize> = (0..program.blocks.len())
            .filter(|i| state.reached[*i] && !state.open[*i] && state.selector(&program.blocks[*i]) == Constant::Unset)
            .collect();
        if undecided.is_empty() {
            break;
        }
        undecided.into_iter().for_each(|i| state.open[i] = true);
        state.changed = true;
    }
    let successors = (0..program.blocks.len()).map(|i| state.successors(i, &program.blocks[i])).collect();
    Reach { reached: state.reached, successors, values: state.values }
}

struct State {
    values: HashMap<Word, Constant>,
    /// Of variables of functions that are only stored to whole.
    memory: HashMap<Word, Constant>,
    reached: Vec<bool>,
    /// Every way out of the block counts.
    open: Vec<bool>,
    changed: bool,
}

impl State {
    fn declare(&mut self, declarations: &[Instruction], chosen: Option<(Word, u32)>) {
        for i in declarations {
            let Some(id) = i.result_id else { continue };
            let value = match (i.class.opcode, i.operands.as_slice()) {
                (Op::ConstantTrue, _) => Constant::Known(1),
                (Op::ConstantFalse | Op::ConstantNull, _) => Constant::Known(0),
                (Op::Constant, [Operand::LiteralBit32(bits)]) => Constant::Known(*bits),
                (Op::SpecConstant, _) => match chosen {
                    Some((chosen, value)) if chosen == id => Constant::Known(value),
                    _ => Constant::Varying,
                },
                _ => Constant::Varying,
            };
            self.values.insert(id, value);
        }
    }

    fn value(&self, id: Word) -> Constant {
        self.values.get(&id).copied().unwrap_or(Constant::Unset)
    }

    fn grow(&mut self, id: Word, value: Constant) {
        let old = self.value(id);
        if old.join(value) != old {
            self.values.insert(id, old.join(value));
            self.changed = true;
        }
    }

    fn grow_memory(&mut self, variable: Word, value: Constant) {
        let old = self.memory.get(&variable).copied().unwrap_or(Constant::Unset);
        if old.join(value) != old {
            self.memory.insert(variable, old.join(value));
            self.changed = true;
        }
    }

    fn block(&mut self, index: usize, block: &Block) {
        for step in &block.steps {
            self.step(&step.instruction);
        }
        for next in self.successors(index, block) {
            self.changed |= !std::mem::replace(&mut self.reached[next], true);
        }
    }

    fn step(&mut self, i: &Instruction) {
        let id = |n: usize| i.operands.get(n).and_then(Operand::id_ref_any).unwrap_or(0);
        match (i.class.opcode, i.result_id) {
            (Op::Variable, Some(variable)) => {
                self.memory.entry(variable).or_insert(Constant::Unset);
                if i.operands.len() > 1 {
                    let initial = self.value(id(1));
                    self.grow_memory(variable, initial);
                }
            }
            (Op::Load, Some(result)) => {
                let loaded = self.memory.get(&id(0)).copied().unwrap_or(Constant::Varying);
                self.grow(result, loaded);
            }
            (Op::Store, _) if self.memory.contains_key(&id(0)) => {
                let stored = self.value(id(1));
                self.grow_memory(id(0), stored);
            }
            (Op::Phi, Some(result)) => self.phi(result, i),
            (_, result) => {
                if let Some(result) = result {
                    let value = fold(i, |operand| self.value(operand));
                    self.grow(result, value);
                }
                // Whoever else gets a variable's address may change it.
                for variable in i.operands.iter().filter_map(Operand::id_ref_any) {
                    if self.memory.contains_key(&variable) {
                        self.grow_memory(variable, Constant::Varying);
                    }
                }
            }
        }
    }

    fn phi(&mut self, result: Word, phi: &Instruction) {
        for pair in phi.operands.chunks_exact(2) {
            // A parent that cannot be reached adds nothing. One that is reached but goes elsewhere may: more is then taken to
            // be possible than is.
            if let [value, Operand::LiteralBit32(parent)] = pair
                && self.reached.get(*parent as usize).is_some_and(|r| *r)
            {
                let value = value.id_ref_any().map_or(Constant::Varying, |v| self.value(v));
                self.grow(result, value);
            }
        }
    }

    fn selector(&self, block: &Block) -> Constant {
        match &block.end {
            End::Branch(selector, _) => self.value(*selector),
            _ => Constant::Varying,
        }
    }

    fn successors(&self, index: usize, block: &Block) -> Vec<usize> {
        match &block.end {
            _ if !self.reached[index] => Vec::new(),
            End::Stop => Vec::new(),
            End::Jump(to) => vec![*to],
            End::Branch(selector, targets) => match self.value(*selector) {
                Constant::Known(value) => {
                    let target = targets.iter().find(|(v, _)| v.is_none_or(|v| v == value));
                    target.map(|(_, to)| *to).into_iter().collect()
                }
                Constant::Unset if !self.open[index] => Vec::new(),
                _ => targets.iter().map(|(_, to)| *to).collect(),
            },
        }
    }
}
