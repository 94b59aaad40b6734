//! In which order operations are recorded, so that those that do not depend on one another run beside each other. Pure CPU, as
//! [`access`](super::access): what depends on what follows from the same declared accesses.
//!
//! A pipeline barrier waits for all that was recorded before it, whatever its reason. So operations are put into *levels* with
//! a barrier between one level and the next and none within: as many levels as the longest chain of dependences has
//! operations, which is the least. Operations off that chain have a choice; the dearest chooses first, and takes the level
//! that becomes least longer by it. All ties have an order, so a recording has one plan.

use std::cmp::Reverse;

use super::access::{Barrier, HazardTracker, Use};
use super::kernel::Kernel;
use super::operation::{Operation, Work};

/// What a kernel costs; only the order follows from it.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Cost {
    /// Its time alone, in any unit. 0: not worth a choice (a fill, a copy).
    pub time: u32,
    /// How much of a device it keeps busy, percent: what is left runs others at the same time.
    pub share: u32,
}

/// The cost of each kernel.
pub type CostOf = fn(&Kernel) -> Cost;

/// The operations in an order in which independent ones stand beside each other, with the barriers that this order needs. What
/// a host gives when it encodes it gives in the order of the recording, which stays as it is then.
pub(super) fn arrange(operations: Vec<Operation>, cost: CostOf) -> Vec<Operation> {
    let given = |o: &Operation| {
        matches!(o.work, Work::Update { .. } | Work::CopyToImage { .. } | Work::Dispatch { to_image: true, .. })
    };
    if operations.iter().any(given) {
        return operations;
    }
    let cost = |o: &Operation| match &o.work {
        Work::Dispatch { kernel, .. } => cost(kernel),
        _ => Cost::default(),
    };
    let costs: Vec<Cost> = operations.iter().map(cost).collect();
    let uses: Vec<(&str, &[Use])> = operations.iter().map(|o| (o.label.as_str(), o.uses.as_slice())).collect();
    let order = order(&uses, &costs);
    let mut from: Vec<Option<Operation>> = operations.into_iter().map(Some).collect();
    let moved = |(i, barrier): (usize, Option<Barrier>)| Some(Operation { barrier, ..from[i].take()? });
    order.into_iter().filter_map(moved).collect()
}

/// The order of operations, given as label and accesses, and the barrier before each: [`levels`] one after another.
pub fn order(operations: &[(&str, &[Use])], costs: &[Cost]) -> Vec<(usize, Option<Barrier>)> {
    let uses: Vec<&[Use]> = operations.iter().map(|(_, uses)| *uses).collect();
    let (mut order, mut tracker) = (Vec::with_capacity(uses.len()), HazardTracker::default());
    for level in levels(&uses, costs) {
        let label = |(at, i): (usize, &usize)| format!("#{} {}", order.len() + at, operations[*i].0);
        let labels: Vec<String> = level.iter().enumerate().map(label).collect();
        let beside: Vec<(&str, &[Use])> =
            labels.iter().map(String::as_str).zip(level.iter().map(|i| uses[*i])).collect();
        let mut barrier = tracker.step_beside(&beside);
        order.extend(level.iter().map(|i| (*i, barrier.take())));
    }
    order
}

/// The operations by level; within a level the dearest first. Of those that are not worth a choice the ones that wait for nothing
/// are in the first level, the others as late as may be.
pub fn levels(operations: &[&[Use]], costs: &[Cost]) -> Vec<Vec<usize>> {
    let mut plan = Plan::new(operations, costs);
    while let Some(next) = plan.next() {
        let level = plan.best(next);
        plan.place(next, level);
    }
    let mut levels = vec![Vec::new(); plan.load.len()];
    for (operation, level) in plan.level.iter().enumerate() {
        levels[level.unwrap_or_default()].push(operation);
    }
    levels.iter_mut().for_each(|level: &mut Vec<usize>| level.sort_by_key(|i| (Reverse(costs[*i]), *i)));
    levels
}

/// Operations that were put into a level and those that were not yet.
struct Plan<'a> {
    costs: &'a [Cost],
    /// Earlier operations that one waits for.
    before: Vec<Vec<usize>>,
    level: Vec<Option<usize>>,
    /// First and last level that each can be in.
    window: Vec<[usize; 2]>,
    load: Vec<Load>,
}

/// What a level holds.
#[derive(Clone, Copy, Default)]
struct Load {
    longest: u64,
    /// Time times share.
    busy: u64,
}

impl Load {
    fn with(self, cost: Cost) -> Self {
        let (time, share) = (u64::from(cost.time), u64::from(cost.share));
        Self { longest: self.longest.max(time), busy: self.busy + time * share }
    }

    /// A hundred times how long it takes: as its longest operation, but no less than all of them keep the device busy.
    fn time(self) -> u64 {
        self.busy.max(100 * self.longest)
    }
}

impl<'a> Plan<'a> {
    fn new(operations: &[&[Use]], costs: &'a [Cost]) -> Self {
        let mut plan = Self {
            costs,
            before: waits(operations),
            level: vec![None; operations.len()],
            window: vec![[0; 2]; operations.len()],
            load: Vec::new(),
        };
        plan.narrow();
        let count = plan.window.iter().map(|w| w[0] + 1).max().unwrap_or(0);
        plan.load = vec![Load::default(); count];
        plan.narrow();
        plan
    }

    /// The windows, from what is placed.
    fn narrow(&mut self) {
        let end = self.load.len().saturating_sub(1);
        for (i, before) in self.before.iter().enumerate() {
            let ready = before.iter().map(|b| self.window[*b][0] + 1).max().unwrap_or(0);
            self.window[i] = self.level[i].map_or([ready, end], |level| [level; 2]);
        }
        for i in (0..self.before.len()).rev() {
            for b in &self.before[i] {
                let latest = self.window[i][1].saturating_sub(1);
                self.window[*b][1] = self.window[*b][1].min(latest);
            }
        }
    }

    /// First those without a choice, then the dearest.
    fn next(&self) -> Option<usize> {
        let open = (0..self.level.len()).filter(|i| self.level[*i].is_none());
        open.min_by_key(|i| (self.window[*i][0] != self.window[*i][1], Reverse(self.costs[*i]), *i))
    }

    fn best(&self, operation: usize) -> usize {
        let ([first, last], cost) = (self.window[operation], self.costs[operation]);
        if cost.time == 0 {
            // In the last level the host reads, for which nothing should be late.
            let late = last.min(self.load.len().saturating_sub(2)).max(first);
            return if first == 0 { first } else { late };
        }
        let longer = |level: &usize| self.load[*level].with(cost).time() - self.load[*level].time();
        (first..=last).min_by_key(|level| (longer(level), self.load[*level].busy, *level)).unwrap_or(first)
    }

    fn place(&mut self, operation: usize, level: usize) {
        self.level[operation] = Some(level);
        self.load[level] = self.load[level].with(self.costs[operation]);
        if self.window[operation] != [level; 2] {
            self.narrow();
        }
    }
}

/// For each operation the earlier ones that touch the same bytes, where one of the two writes.
fn waits(operations: &[&[Use]]) -> Vec<Vec<usize>> {
    let conflict =
        |a: &Use, b: &Use| a.buffer == b.buffer && a.start < b.end && b.start < a.end && (a.write || b.write);
    let waits = |i: usize| {
        let on = |j: &usize| operations[*j].iter().any(|a| operations[i].iter().any(|b| conflict(a, b)));
        (0..i).filter(on).collect()
    };
    (0..operations.len()).map(waits).collect()
}
