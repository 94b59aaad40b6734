//! Subgroup operations. They see the active lanes; a value asked of any other lane is poison.

use super::POISON;
use super::lanes::{Bits, Lanes};
use crate::op::{Extent, Op, Reduction, Row};

/// Runs `op` if it is one of these.
pub(super) fn step<const L: usize>(lanes: &mut Lanes<L>, op: Op) -> bool {
    match op {
        Op::Ballot { d, a } => {
            let votes = lanes.truth(a) & lanes.mask;
            for word in 0..4 {
                lanes.set(d + word, [(votes >> (32 * word)) as u32; L]);
            }
        }
        Op::Elect { d } => {
            let lowest = lanes.mask & lanes.mask.wrapping_neg();
            lanes.set(d, std::array::from_fn(|i| u32::from((lowest >> i) & 1 == 1)));
        }
        Op::Any { d, a } => lanes.set(d, [u32::from(lanes.truth(a) & lanes.mask != 0); L]),
        Op::All { d, a } => lanes.set(d, [u32::from(lanes.truth(a) & lanes.mask == lanes.mask); L]),
        Op::First { d, a } => {
            let value = lanes.active().next().map_or(POISON, |l| lanes.row(a)[l]);
            lanes.set(d, [value; L]);
        }
        Op::Shuffle { d, a, lane } => shuffle(lanes, d, a, |lanes, l| lanes.row(lane)[l]),
        Op::ShuffleXor { d, a, mask } => shuffle(lanes, d, a, |lanes, l| l as u32 ^ lanes.row(mask)[l]),
        Op::Group { op, extent, d, a } => reduce(lanes, op, extent, d, a),
        _ => return false,
    }
    true
}

fn shuffle<const L: usize>(lanes: &mut Lanes<L>, d: Row, a: Row, from: impl Fn(&Lanes<L>, usize) -> u32) {
    let mut out = [POISON; L];
    let values = lanes.row(a);
    for lane in Bits(lanes.mask) {
        let source = from(lanes, lane);
        if lanes.is_active(source) {
            out[lane] = values[source as usize];
        }
    }
    lanes.set(d, out);
}

fn apply(op: Reduction, x: u32, y: u32) -> u32 {
    let (a, b) = (f32::from_bits(x), f32::from_bits(y));
    match op {
        Reduction::AddInt => x.wrapping_add(y),
        Reduction::Add => (a + b).to_bits(),
        Reduction::MinUint => x.min(y),
        Reduction::MaxUint => x.max(y),
        Reduction::Min => a.min(b).to_bits(),
        Reduction::Max => a.max(b).to_bits(),
        Reduction::And => x & y,
        Reduction::Or => x | y,
    }
}

fn identity(op: Reduction) -> u32 {
    match op {
        Reduction::AddInt | Reduction::MaxUint | Reduction::Or => 0,
        Reduction::Add => (-0.0_f32).to_bits(),
        Reduction::MinUint | Reduction::And => u32::MAX,
        Reduction::Min => f32::INFINITY.to_bits(),
        Reduction::Max => f32::NEG_INFINITY.to_bits(),
    }
}

fn reduce<const L: usize>(lanes: &mut Lanes<L>, op: Reduction, extent: Extent, d: Row, a: Row) {
    let mut so_far = identity(op);
    let mut out = [POISON; L];
    for lane in lanes.active() {
        let before = so_far;
        so_far = apply(op, so_far, lanes.row(a)[lane]);
        out[lane] = if extent == Extent::Exclusive { before } else { so_far };
    }
    if extent == Extent::Reduce {
        out = [so_far; L];
    }
    lanes.set(d, out);
}
