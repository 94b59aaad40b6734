//! The whole shader as one list of blocks: every call is replaced by a copy of what it calls, with ids of its own. SPIR-V for
//! Vulkan has no recursion, so this ends.

use std::collections::HashMap;

use rspirv::dr::{Instruction, Operand};
use rspirv::spirv::{Op, Word};

use super::module::Module;

/// Calls within calls; more is recursion.
const MAX_DEPTH: usize = 64;

/// One copy of a function.
pub(super) struct Frame {
    /// Its name.
    pub(super) function: String,
    /// Calls within which it is.
    depth: usize,
}

/// An instruction and which of its kind it is in its function, from 1.
pub(super) struct Step {
    pub(super) instruction: Instruction,
    pub(super) ordinal: usize,
}

/// Where a block goes.
pub(super) enum End {
    /// On to one block.
    Jump(usize),
    /// To one of several: the selector's value, or `None` for all other values, and the block. Of a condition, 0 is false.
    Branch(Word, Vec<(Option<u32>, usize)>),
    /// Out of the shader.
    Stop,
}

/// Straight code. Operands of `OpPhi` name blocks by their index.
pub(super) struct Block {
    /// Index of its copy of a function.
    pub(super) frame: usize,
    pub(super) steps: Vec<Step>,
    pub(super) end: End,
    /// Its function returns at its end.
    pub(super) returns: bool,
}

/// The expanded shader; block 0 is where it begins.
pub(super) struct Program {
    pub(super) blocks: Vec<Block>,
    pub(super) frames: Vec<Frame>,
    /// Largest id plus 1.
    pub(super) bound: Word,
    /// The module's id of each id that was made here.
    origin: HashMap<Word, Word>,
}

impl Program {
    /// The id in the module.
    pub(super) fn origin(&self, id: Word) -> Word {
        self.origin.get(&id).copied().unwrap_or(id)
    }
}

/// Expands the shader of the entry point.
pub(super) fn flatten(module: &Module) -> Result<Program, String> {
    let program = Program { blocks: Vec::new(), frames: Vec::new(), bound: module.bound(), origin: HashMap::new() };
    let mut expansion = Expansion { module, program };
    expansion.function(module.entry, &[], 0)?;
    Ok(expansion.program)
}

/// Blocks at which a copy of a function returns, with the value, if any.
type Returns = Vec<(usize, Option<Word>)>;

struct Expansion<'a> {
    module: &'a Module,
    program: Program,
}

/// Renaming within one copy of a function.
struct Scope {
    frame: usize,
    ids: HashMap<Word, Word>,
    /// First block of each label; calls split a block into several.
    first: HashMap<Word, usize>,
    /// And its last block.
    last: HashMap<Word, usize>,
    ordinals: HashMap<Op, usize>,
}

impl Expansion<'_> {
    /// Appends a copy of a function; its first block comes next in `blocks`.
    fn function(&mut self, index: usize, arguments: &[Word], depth: usize) -> Result<Returns, String> {
        if depth > MAX_DEPTH {
            return Err(format!("calls within calls, more than {MAX_DEPTH}"));
        }
        let module = self.module;
        let function = &module.functions()[index];
        let id = function.def.as_ref().and_then(|d| d.result_id).unwrap_or(0);
        let name = module.name(id).map_or_else(|| format!("%{id}"), str::to_owned);
        self.program.frames.push(Frame { function: name, depth });
        let mut scope = Scope {
            frame: self.program.frames.len() - 1,
            ids: HashMap::new(),
            first: HashMap::new(),
            last: HashMap::new(),
            ordinals: HashMap::new(),
        };
        let parameters = function.parameters.iter().filter_map(|p| p.result_id);
        scope.ids.extend(parameters.zip(arguments.iter().copied()));
        for block in &function.blocks {
            for made in block.instructions.iter().filter_map(|i| i.result_id) {
                let fresh = self.fresh(made);
                scope.ids.insert(made, fresh);
            }
            let label = block.label.as_ref().and_then(|l| l.result_id).ok_or("a block without a label")?;
            scope.first.insert(label, self.block(scope.frame));
        }
        let mut returns = Returns::new();
        for block in &function.blocks {
            let label = block.label.as_ref().and_then(|l| l.result_id).unwrap_or(0);
            let first = scope.first[&label];
            let last = self.body(&mut scope, first, &block.instructions, &mut returns)?;
            scope.last.insert(label, last);
        }
        self.resolve_phis(&scope);
        Ok(returns)
    }

    fn fresh(&mut self, id: Word) -> Word {
        let fresh = self.program.bound;
        self.program.bound += 1;
        self.program.origin.insert(fresh, id);
        fresh
    }

    fn block(&mut self, frame: usize) -> usize {
        self.program.blocks.push(Block { frame, steps: Vec::new(), end: End::Stop, returns: false });
        self.program.blocks.len() - 1
    }

    /// Copies a block's code; returns the block in which it ends.
    fn body(
        &mut self,
        scope: &mut Scope,
        first: usize,
        instructions: &[Instruction],
        returns: &mut Returns,
    ) -> Result<usize, String> {
        let mut at = first;
        for instruction in instructions {
            let op = instruction.class.opcode;
            match op {
                Op::FunctionCall => at = self.call(scope, at, instruction)?,
                Op::SelectionMerge | Op::LoopMerge | Op::Line | Op::NoLine => {}
                Op::Branch | Op::BranchConditional | Op::Switch => {
                    self.program.blocks[at].end = branch(scope, instruction).ok_or("a branch without a target")?;
                }
                Op::Return | Op::ReturnValue => {
                    self.program.blocks[at].returns = true;
                    returns.push((at, instruction.operands.first().and_then(|o| renamed(scope, o))));
                }
                Op::Unreachable | Op::Kill => {}
                _ => {
                    let ordinal = scope.ordinals.entry(op).or_default();
                    *ordinal += 1;
                    let ordinal = *ordinal;
                    let mut copy = instruction.clone();
                    copy.result_id = copy.result_id.map(|id| scope.ids[&id]);
                    for operand in &mut copy.operands {
                        // Labels in `OpPhi` keep their names until all blocks are known.
                        if let Some(id) = operand.id_ref_any_mut() {
                            *id = scope.ids.get(id).copied().unwrap_or(*id);
                        }
                    }
                    self.program.blocks[at].steps.push(Step { instruction: copy, ordinal });
                }
            }
        }
        Ok(at)
    }

    /// Expands a call at the end of block `at`; returns the block that goes on after it.
    fn call(&mut self, scope: &Scope, at: usize, call: &Instruction) -> Result<usize, String> {
        let mut ids = call.operands.iter().filter_map(|o| renamed(scope, o));
        let callee = ids.next().and_then(|id| self.module.function(id)).ok_or("a call of no function")?;
        let arguments: Vec<Word> = ids.collect();
        let after = self.block(scope.frame);
        let entry = self.program.blocks.len();
        self.program.blocks[at].end = End::Jump(entry);
        let returns = self.function(callee, &arguments, self.program.frames[scope.frame].depth + 1)?;
        let mut merged = Vec::new();
        for (block, value) in returns {
            self.program.blocks[block].end = End::Jump(after);
            if let Some(value) = value {
                merged.extend([Operand::IdRef(value), Operand::LiteralBit32(block as u32)]);
            }
        }
        if !merged.is_empty() {
            let result = call.result_id.map(|id| scope.ids[&id]);
            let instruction = Instruction::new(Op::Phi, call.result_type, result, merged);
            self.program.blocks[after].steps.push(Step { instruction, ordinal: 0 });
        }
        Ok(after)
    }

    /// Replaces labels by the index of the block that they end in.
    fn resolve_phis(&mut self, scope: &Scope) {
        for block in self.program.blocks.iter_mut().filter(|b| b.frame == scope.frame) {
            for phi in block.steps.iter_mut().filter(|s| s.instruction.class.opcode == Op::Phi) {
                for parent in phi.instruction.operands.iter_mut().skip(1).step_by(2) {
                    if let Operand::IdRef(label) = parent {
                        *parent = Operand::LiteralBit32(scope.last.get(label).map_or(u32::MAX, |b| *b as u32));
                    }
                }
            }
        }
    }
}

fn renamed(scope: &Scope, operand: &Operand) -> Option<Word> {
    operand.id_ref_any().map(|id| scope.ids.get(&id).copied().unwrap_or(id))
}

fn branch(scope: &Scope, instruction: &Instruction) -> Option<End> {
    let operands = &instruction.operands;
    let target = |i: usize| operands.get(i)?.id_ref_any().and_then(|label| scope.first.get(&label).copied());
    if instruction.class.opcode == Op::Branch {
        return target(0).map(End::Jump);
    }
    let selector = renamed(scope, operands.first()?)?;
    if instruction.class.opcode == Op::BranchConditional {
        return Some(End::Branch(selector, vec![(Some(0), target(2)?), (None, target(1)?)]));
    }
    let mut targets = Vec::new();
    for i in (2..operands.len()).step_by(2) {
        let Operand::LiteralBit32(value) = operands[i] else { continue };
        targets.push((Some(value), target(i + 1)?));
    }
    targets.push((None, target(1)?));
    Some(End::Branch(selector, targets))
}
