//! The rules, applied to what the analysis found.

use std::collections::BTreeSet;

use rspirv::spirv::{BuiltIn, Op, Word};

use super::constants::{self, Reach};
use super::flatten::{Block, End, Program, Step};
use super::levels::Levels;
use super::module::{Global, Module};
use super::operations::{Level, is_of_subgroup};

/// Breaches under one choice of a specialisation constant, each once.
pub(super) fn breaches(module: &Module, program: &Program, chosen: Option<(Word, u32)>) -> BTreeSet<String> {
    let reach = constants::reach(module, program, chosen);
    let blocks: Vec<(usize, &Block)> = program.blocks.iter().enumerate().filter(|(i, _)| reach.reached[*i]).collect();
    let mut found = BTreeSet::new();
    if !blocks.iter().any(|(_, b)| b.steps.iter().any(|s| limit(s.instruction.class.opcode).is_some())) {
        return found;
    }
    let levels = Levels::analyse(module, program, &reach);
    let rules = Rules { program, levels };
    for (index, block) in blocks {
        found.extend(block.steps.iter().filter_map(|step| rules.operation(index, block, step)));
        found.extend(rules.early_return(index, block));
    }
    found.extend(two_numberings(module, program, &reach));
    found
}

/// How uniform the flow must be that an operation sits in.
fn limit(op: Op) -> Option<Level> {
    match op {
        Op::ControlBarrier => Some(Level::Workgroup),
        op if is_of_subgroup(op) => Some(Level::Subgroup),
        _ => None,
    }
}

struct Rules<'a> {
    program: &'a Program,
    levels: Levels<'a>,
}

impl Rules<'_> {
    /// Rules 1 and 2.
    fn operation(&self, index: usize, block: &Block, step: &Step) -> Option<String> {
        let op = step.instruction.class.opcode;
        let limit = limit(op).filter(|limit| self.levels.control(index) > *limit)?;
        let function = &self.program.frames[block.frame].function;
        let branch = self.describe(self.first(self.levels.causes(index, limit).collect(), limit)?);
        Some(format!("Op{op:?} {} of {function} depends on {branch}", step.ordinal))
    }

    /// Rule 3: a return that depends on a branch of its own function.
    fn early_return(&self, index: usize, block: &Block) -> Option<String> {
        let limit = Level::Workgroup;
        let own = |b: &usize| block.returns && self.program.blocks[*b].frame == block.frame;
        let cause = self.first(self.levels.causes(index, limit).filter(own).collect(), limit)?;
        let function = &self.program.frames[block.frame].function;
        Some(format!("a return of {function} depends on {}", self.describe(cause)))
    }

    /// Of these branches the one that all still reach together, if there is one.
    fn first(&self, causes: Vec<usize>, limit: Level) -> Option<usize> {
        causes.iter().find(|b| self.levels.control(**b) <= limit).or(causes.first()).copied()
    }

    fn describe(&self, branch: usize) -> String {
        let block = &self.program.blocks[branch];
        let source = match &block.end {
            End::Branch(selector, _) => self.levels.source(*selector),
            _ => "nothing".to_owned(),
        };
        let who = match self.levels.branch(branch) {
            Level::Divergent => "lanes",
            _ => "subgroups",
        };
        format!("a branch of {} on {source}, in which {who} differ", self.program.frames[block.frame].function)
    }
}

/// Rule 4.
fn two_numberings(module: &Module, program: &Program, reach: &Reach) -> Option<String> {
    let mut loaded = BTreeSet::new();
    for (_, block) in program.blocks.iter().enumerate().filter(|(i, _)| reach.reached[*i]) {
        for i in block.steps.iter().map(|s| &s.instruction) {
            for id in i.operands.iter().filter_map(|o| o.id_ref_any()) {
                if let Some(Global::Builtin(builtin)) = module.global(id) {
                    loaded.insert(builtin);
                }
            }
        }
    }
    let first = |list: &[BuiltIn]| list.iter().find(|b| loaded.contains(b)).copied();
    let by_subgroup = first(&[BuiltIn::SubgroupId, BuiltIn::SubgroupLocalInvocationId])?;
    let by_workgroup =
        first(&[BuiltIn::LocalInvocationId, BuiltIn::LocalInvocationIndex, BuiltIn::GlobalInvocationId])?;
    Some(format!("invocations are numbered by {by_subgroup:?} and by {by_workgroup:?}"))
}
