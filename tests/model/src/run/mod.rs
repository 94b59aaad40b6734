//! Runs a dispatch: workgroups and subgroups in random order.

mod access;
mod arithmetic;
mod group;
mod lanes;
mod memory;
mod random;
mod step;

use rspirv::spirv::{BuiltIn, ImageFormat};

use crate::compile::Code;
use crate::error::{ModelError, Result, unsupported};
use crate::op::Orders;
use crate::{Dispatch, Options};
use lanes::{Lanes, State};
use memory::Memory;
use random::Random;
use step::{Stop, World};

/// What variables and shared memory hold before anything is written, and what is undefined: a NaN.
pub(crate) const POISON: u32 = 0x7FC0_BAD1;

/// A storage image in memory.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Image {
    pub(crate) width: u32,
    pub(crate) format: ImageFormat,
}

/// A workgroup that has begun.
struct Group<const L: usize> {
    id: u32,
    subgroups: Vec<Lanes<L>>,
    shared: Memory,
    shared_epoch: u32,
    storage_epoch: u32,
    /// The barrier at which each subgroup waits.
    waits: Vec<Option<(usize, u32, Orders)>>,
}

/// Runs the dispatch with `L` lanes.
pub(crate) fn run<const L: usize>(code: &Code, dispatch: &mut Dispatch<'_>, options: &Options) -> Result<()> {
    let mut random = Random(options.seed);
    let mut buffers = Vec::new();
    let mut images = Vec::new();
    for (binding, words) in (0..).zip(dispatch.buffers.iter_mut()) {
        let info = code.buffers.get(&binding);
        let traced = info.is_some_and(|i| !i.read_only);
        buffers.push(Memory::new(std::mem::take(words), traced));
        images.push(info.and_then(|i| i.image).map(|format| Image { width: dispatch.image_width, format }));
    }
    let mut rounds = 0;
    let done = run_groups::<L>(code, dispatch, options, &mut random, &mut rounds, (&mut buffers, &images));
    for (words, memory) in dispatch.buffers.iter_mut().zip(buffers) {
        *words = memory.words;
    }
    done
}

fn run_groups<const L: usize>(
    code: &Code,
    dispatch: &Dispatch<'_>,
    options: &Options,
    random: &mut Random,
    rounds: &mut u64,
    (buffers, images): (&mut [Memory], &[Option<Image>]),
) -> Result<()> {
    let mut order: Vec<u32> = (0..dispatch.groups.iter().product()).collect();
    random.shuffle(&mut order);
    let mut pool: Vec<Group<L>> = Vec::new();
    let mut active: Vec<Group<L>> = Vec::new();
    loop {
        while active.len() < options.groups_in_flight.max(1) as usize
            && let Some(id) = order.pop()
        {
            let mut group = pool.pop().unwrap_or_else(|| Group::new(code));
            group.begin(code, dispatch, options, id, random)?;
            active.push(group);
        }
        if active.is_empty() {
            return Ok(());
        }
        let at = random.below(active.len());
        let group = &mut active[at];
        let Some(subgroup) = group.pick(random) else {
            group.pass_barrier(code)?;
            continue;
        };
        let mut world = World {
            code,
            buffers: &mut *buffers,
            images,
            shared: &mut group.shared,
            group: group.id,
            shared_epoch: group.shared_epoch,
            storage_epoch: group.storage_epoch,
            left: burst(random, options.burst),
            random: &mut *random,
            rounds: &mut *rounds,
            subgroup_barrier_is_workgroup: options.subgroup_barrier_is_workgroup,
        };
        let lanes = &mut group.subgroups[subgroup];
        match world.run(lanes)? {
            Stop::Interrupted => {}
            Stop::Barrier { number, orders } => {
                lanes.state = State::Waiting;
                group.waits[subgroup] = Some((lanes.pc - 1, number, orders));
            }
            Stop::Done => lanes.state = State::Done,
        }
        if group.subgroups.iter().all(|s| s.state == State::Done) {
            pool.push(active.swap_remove(at));
        }
    }
}

/// Memory operations that a subgroup does before another may: often few.
fn burst(random: &mut Random, longest: u32) -> u32 {
    let longest = if random.below(3) == 0 { longest.min(4) } else { longest };
    1 + random.below(longest.max(1) as usize) as u32
}

impl<const L: usize> Group<L> {
    fn new(code: &Code) -> Self {
        let subgroups = code.local_size.div_ceil(L as u32);
        Self {
            id: 0,
            subgroups: (0..subgroups).map(|i| Lanes::new(code.rows, code.frames, i as u8)).collect(),
            shared: Memory::new(vec![POISON; code.shared_words as usize], true),
            shared_epoch: 0,
            storage_epoch: 0,
            waits: vec![None; subgroups as usize],
        }
    }

    /// Starts workgroup `id`: inputs, constants and poison.
    fn begin(
        &mut self,
        code: &Code,
        dispatch: &Dispatch<'_>,
        options: &Options,
        id: u32,
        random: &mut Random,
    ) -> Result<()> {
        self.id = id;
        (self.shared_epoch, self.storage_epoch) = (0, 0);
        self.shared.clear(POISON);
        self.waits.fill(None);
        let mut place: Vec<u32> = (0..code.local_size).collect();
        if options.shuffle_invocations {
            random.shuffle(&mut place);
        }
        for (s, lanes) in self.subgroups.iter_mut().enumerate() {
            let first = s * L;
            let count = place.len().min(first + L) - first;
            lanes.reset(if count >= 128 { u128::MAX } else { (1 << count) - 1 });
            for (row, word) in &code.presets.constants {
                lanes.set(*row, [*word; L]);
            }
            for (row, word) in &code.presets.push {
                let at = 4 * *word as usize;
                let bytes = dispatch.push.get(at..at + 4).map_or([0; 4], |b| [b[0], b[1], b[2], b[3]]);
                lanes.set(*row, [u32::from_le_bytes(bytes); L]);
            }
            for (first, count) in &code.presets.private {
                (*first..first + count).for_each(|row| lanes.set(row, [POISON; L]));
            }
            for (row, built_in) in &code.presets.inputs {
                let local = std::array::from_fn(|lane| place.get(first + lane).copied().unwrap_or(0));
                input(lanes, *row, *built_in, (id, dispatch.groups, code.local_size), &local)?;
            }
        }
        Ok(())
    }

    /// A subgroup that can go on.
    fn pick(&self, random: &mut Random) -> Option<usize> {
        let ready = self.subgroups.iter().filter(|s| s.state == State::Ready).count();
        if ready == 0 {
            return None;
        }
        let nth = random.below(ready);
        (0..self.subgroups.len()).filter(|s| self.subgroups[*s].state == State::Ready).nth(nth)
    }

    /// All subgroups wait or have ended: they must wait at the same barrier.
    fn pass_barrier(&mut self, code: &Code) -> Result<()> {
        let Some((subgroup, (pc, number, orders))) = self.waits.iter().enumerate().find_map(|(s, w)| w.map(|w| (s, w)))
        else {
            return unsupported("a workgroup that neither runs nor waits");
        };
        let name =
            |pc: usize, number: u32| format!("barrier {number} in {}", code.places[usize::from(code.place_of_op[pc])]);
        for (other, wait) in self.waits.iter().enumerate() {
            let where_other = match wait {
                Some((at, ..)) if *at == pc => continue,
                Some((at, number, _)) => format!("waits at {}", name(*at, *number)),
                None => "has ended".to_owned(),
            };
            return Err(ModelError::BarrierMismatch {
                barrier: name(pc, number),
                subgroup: subgroup as u32,
                other: other as u32,
                where_other,
            });
        }
        self.shared_epoch += u32::from(orders.shared);
        self.storage_epoch += u32::from(orders.storage);
        self.waits.fill(None);
        self.subgroups.iter_mut().for_each(|s| s.state = State::Ready);
        Ok(())
    }
}

/// Sets a built-in variable. `local`: the invocation's index in its workgroup.
fn input<const L: usize>(
    lanes: &mut Lanes<L>,
    row: u32,
    built_in: BuiltIn,
    (id, groups, local_size): (u32, [u32; 3], u32),
    local: &[u32; L],
) -> Result<()> {
    let group = [id % groups[0], id / groups[0] % groups[1], id / groups[0] / groups[1]];
    let mut three = |values: [[u32; L]; 3]| (row..).zip(values).for_each(|(r, v)| lanes.set(r, v));
    match built_in {
        BuiltIn::WorkgroupId => three(group.map(|g| [g; L])),
        BuiltIn::NumWorkgroups => three(groups.map(|g| [g; L])),
        BuiltIn::LocalInvocationId => three([*local, [0; L], [0; L]]),
        BuiltIn::GlobalInvocationId => {
            three([local.map(|l| group[0] * local_size + l), [group[1]; L], [group[2]; L]]);
        }
        BuiltIn::LocalInvocationIndex => lanes.set(row, *local),
        BuiltIn::SubgroupId => lanes.set(row, [lanes.index.into(); L]),
        BuiltIn::NumSubgroups => lanes.set(row, [local_size.div_ceil(L as u32); L]),
        BuiltIn::SubgroupSize => lanes.set(row, [L as u32; L]),
        BuiltIn::SubgroupLocalInvocationId => lanes.set(row, std::array::from_fn(|i| i as u32)),
        other => return unsupported(format!("the built-in {other:?}")),
    }
    Ok(())
}
