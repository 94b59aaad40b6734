//! Words of buffers and shared memory, and who used each last.
//!
//! Two accesses to a word by different invocations are a race when at least one of them is not atomic, at least one writes,
//! and nothing orders them. What orders: between subgroups of a workgroup, a workgroup barrier whose semantics name that
//! memory (`barrier()` names shared memory alone); between lanes of a subgroup, that or a subgroup barrier. Other subgroup
//! operations order nothing, and between workgroups nothing does. Two lanes that store at once race too, even if they store
//! the same value.

/// No access yet.
const NOBODY: u32 = u32::MAX;
/// Accesses by more than one of them.
const SEVERAL: u32 = u32::MAX - 1;
const SEVERAL_SMALL: u8 = u8::MAX;

/// One invocation at one time.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Stamp {
    pub(crate) group: u32,
    /// Workgroup barriers passed.
    pub(crate) epoch: u32,
    /// Subgroup barriers passed.
    pub(crate) subgroup_epoch: u32,
    pub(crate) subgroup: u8,
    pub(crate) lane: u8,
    /// Function.
    pub(crate) place: u16,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    Read,
    Write,
    Atomic,
}

#[derive(Debug, Clone, Copy)]
struct Trace {
    read: Stamp,
    write: Stamp,
    atomic: Stamp,
}

impl Stamp {
    const NONE: Self = Self { group: NOBODY, epoch: 0, subgroup_epoch: 0, subgroup: 0, lane: 0, place: 0 };
    /// A lane that stands for several at once.
    pub(crate) const SEVERAL_LANES: u8 = SEVERAL_SMALL;

    /// Whether nothing orders the earlier access `self` before `now`.
    fn unordered(&self, now: &Self) -> bool {
        if self.group == NOBODY {
            return false;
        }
        if self.group != now.group {
            return true;
        }
        if self.epoch != now.epoch {
            return false;
        }
        if self.subgroup != now.subgroup || self.subgroup == SEVERAL_SMALL {
            return true;
        }
        self.subgroup_epoch == now.subgroup_epoch && (self.lane != now.lane || self.lane == SEVERAL_SMALL)
    }

    /// Remembers `now` beside what is not ordered before it.
    fn add(&mut self, now: &Self) {
        if self.group != now.group && self.group != NOBODY {
            self.group = SEVERAL;
        } else if self.group == NOBODY || self.epoch != now.epoch {
            *self = *now;
        } else if self.subgroup != now.subgroup {
            self.subgroup = SEVERAL_SMALL;
        } else if self.subgroup_epoch != now.subgroup_epoch {
            *self = *now;
        } else if self.lane != now.lane {
            self.lane = SEVERAL_SMALL;
        }
    }

    fn describe(&self, kind: Kind, places: &[String]) -> String {
        let verb = match kind {
            Kind::Read => "read",
            Kind::Write => "written",
            Kind::Atomic => "updated atomically",
        };
        let number = |v: u32, several: u32| if v == several { "several".to_owned() } else { v.to_string() };
        let place = places.get(usize::from(self.place)).map_or("?", String::as_str);
        format!(
            "{verb} in {place} (workgroup {}, subgroup {}, lane {})",
            number(self.group, SEVERAL),
            number(self.subgroup.into(), SEVERAL_SMALL.into()),
            number(self.lane.into(), SEVERAL_SMALL.into())
        )
    }
}

const CLEAN: Trace = Trace { read: Stamp::NONE, write: Stamp::NONE, atomic: Stamp::NONE };

/// A buffer or the shared memory of a workgroup.
#[derive(Debug, Default)]
pub(crate) struct Memory {
    pub(crate) words: Vec<u32>,
    /// Empty where nothing is ever written.
    traces: Vec<Trace>,
}

/// A race: earlier access, later access.
pub(crate) type Conflict = (String, String);

impl Memory {
    pub(crate) fn new(words: Vec<u32>, traced: bool) -> Self {
        let traces = if traced { vec![CLEAN; words.len()] } else { Vec::new() };
        Self { words, traces }
    }

    /// Another workgroup's: poisoned, nothing written.
    pub(crate) fn clear(&mut self, poison: u32) {
        self.words.fill(poison);
        self.traces.fill(CLEAN);
    }

    pub(crate) fn is_traced(&self) -> bool {
        !self.traces.is_empty()
    }

    pub(crate) fn was_written(&self, word: u32) -> bool {
        let trace = &self.traces[word as usize];
        trace.write.group != NOBODY || trace.atomic.group != NOBODY
    }

    /// Notes an access; the race that it makes, if it does.
    pub(crate) fn note(&mut self, word: u32, kind: Kind, now: &Stamp, places: &[String]) -> Option<Conflict> {
        let trace = self.traces.get_mut(word as usize)?;
        let earlier = if trace.write.unordered(now) {
            Some((&trace.write, Kind::Write))
        } else if kind != Kind::Atomic && trace.atomic.unordered(now) {
            Some((&trace.atomic, Kind::Atomic))
        } else if kind != Kind::Read && trace.read.unordered(now) {
            Some((&trace.read, Kind::Read))
        } else {
            None
        };
        if let Some((stamp, earlier)) = earlier {
            return Some((stamp.describe(earlier, places), now.describe(kind, places)));
        }
        match kind {
            Kind::Read => trace.read.add(now),
            Kind::Write => trace.write.add(now),
            Kind::Atomic => trace.atomic.add(now),
        }
        None
    }
}
