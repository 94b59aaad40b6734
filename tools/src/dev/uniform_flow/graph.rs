//! Control dependence: which branches decide whether a block runs.
//!
//! Block B depends on the branch at the end of A when B post-dominates one way out of A but not A itself, and on everything
//! that A depends on. Early returns, `break` and `continue` need no case of their own.

use super::constants::Reach;

/// For each block the branches that it depends on, as blocks, itself perhaps among them.
pub(super) struct Dependence {
    sets: Vec<Vec<u64>>,
}

impl Dependence {
    pub(super) fn of(reach: &Reach) -> Self {
        let after = immediate_postdominators(reach);
        let count = reach.successors.len();
        let mut sets = vec![vec![0u64; count.div_ceil(64)]; count];
        for (branch, ways) in reach.successors.iter().enumerate().filter(|(_, ways)| ways.len() > 1) {
            for way in ways {
                let mut at = *way;
                while at != after[branch] && at != count {
                    sets[at][branch / 64] |= 1 << (branch % 64);
                    at = after[at];
                }
            }
        }
        close(&mut sets);
        Self { sets }
    }

    /// The branches that decide whether `block` runs.
    pub(super) fn branches(&self, block: usize) -> impl Iterator<Item = usize> + '_ {
        bits(self.sets[block].iter().copied())
    }

    /// Those that decide whether `from` runs but not whether `to` does.
    pub(super) fn left_behind(&self, from: usize, to: usize) -> impl Iterator<Item = usize> + '_ {
        bits(self.sets[from].iter().zip(&self.sets[to]).map(|(from, to)| from & !to))
    }
}

/// The bits that are set, from the lowest. This is most of what the analysis does: it goes from one bit to the next.
fn bits(set: impl Iterator<Item = u64>) -> impl Iterator<Item = usize> {
    set.enumerate().flat_map(|(word, mut rest)| {
        std::iter::from_fn(move || {
            let bit = rest.trailing_zeros() as usize;
            rest &= rest.wrapping_sub(1);
            (bit < 64).then_some(word * 64 + bit)
        })
    })
}

/// Adds what the branches of each set depend on themselves.
fn close(sets: &mut [Vec<u64>]) {
    let mut changed = true;
    while std::mem::take(&mut changed) {
        for block in 0..sets.len() {
            for branch in bits(sets[block].clone().into_iter()) {
                let more = sets[branch].clone();
                for (mine, more) in sets[block].iter_mut().zip(more) {
                    changed |= *mine | more != *mine;
                    *mine |= more;
                }
            }
        }
    }
}

/// The next block that every way from each block to the end goes through; the number of blocks stands for the end.
fn immediate_postdominators(reach: &Reach) -> Vec<usize> {
    immediate_dominators(&backwards(reach, &exits(reach)), reach.successors.len())
}

/// Which blocks every way to a block goes through.
pub(super) struct Dominators {
    before: Vec<usize>,
}

impl Dominators {
    pub(super) fn of(reach: &Reach) -> Self {
        Self { before: immediate_dominators(&reach.successors, 0) }
    }

    /// Whether every way to `block`, which can be reached, goes through `through`.
    pub(super) fn dominates(&self, through: usize, block: usize) -> bool {
        let mut at = block;
        while at != through && at != 0 {
            at = self.before[at];
        }
        at == through
    }
}

/// Cooper, Harvey and Kennedy's algorithm, on the nodes that `root` leads to; `usize::MAX` for the others.
fn immediate_dominators(next: &[Vec<usize>], root: usize) -> Vec<usize> {
    let order = postorder(next, root);
    let mut rank = vec![0; next.len()];
    order.iter().enumerate().for_each(|(i, node)| rank[*node] = i);
    let mut previous = vec![Vec::new(); next.len()];
    order.iter().for_each(|node| next[*node].iter().for_each(|to| previous[*to].push(*node)));
    let mut before = vec![usize::MAX; next.len()];
    before[root] = root;
    let mut changed = true;
    while std::mem::take(&mut changed) {
        for &node in order.iter().rev().filter(|n| **n != root) {
            let known = previous[node].iter().copied().filter(|p| before[*p] != usize::MAX);
            let found = known.reduce(|a, b| common(a, b, &before, &rank)).unwrap_or(usize::MAX);
            changed |= before[node] != found;
            before[node] = found;
        }
    }
    before
}

fn common(mut a: usize, mut b: usize, before: &[usize], rank: &[usize]) -> usize {
    while a != b {
        if rank[a] < rank[b] {
            a = before[a];
        } else {
            b = before[b];
        }
    }
    a
}

/// Blocks from which the end comes next. A loop without a way out gets one, so that every block has an end.
fn exits(reach: &Reach) -> Vec<bool> {
    let mut exits: Vec<bool> =
        reach.reached.iter().zip(&reach.successors).map(|(reached, next)| *reached && next.is_empty()).collect();
    loop {
        let mut ends = vec![false; exits.len() + 1];
        postorder(&backwards(reach, &exits), exits.len()).into_iter().for_each(|b| ends[b] = true);
        match (0..exits.len()).rev().find(|b| reach.reached[*b] && !ends[*b]) {
            Some(stuck) => exits[stuck] = true,
            None => return exits,
        }
    }
}

/// The graph with all edges turned round and the end as its last node.
fn backwards(reach: &Reach, exits: &[bool]) -> Vec<Vec<usize>> {
    let end = exits.len();
    let mut turned = vec![Vec::new(); end + 1];
    for block in 0..end {
        reach.successors[block].iter().for_each(|next| turned[*next].push(block));
        if exits[block] {
            turned[end].push(block);
        }
    }
    turned
}

/// Nodes that `root` leads to, each after those that it leads to itself.
fn postorder(next: &[Vec<usize>], root: usize) -> Vec<usize> {
    let mut order = Vec::new();
    let mut seen = vec![false; next.len()];
    let mut stack = vec![(root, 0)];
    seen[root] = true;
    while let Some((node, child)) = stack.pop() {
        match next[node].get(child) {
            Some(&to) => {
                stack.push((node, child + 1));
                if !std::mem::replace(&mut seen[to], true) {
                    stack.push((to, 0));
                }
            }
            None => order.push(node),
        }
    }
    order
}
