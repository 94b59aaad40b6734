//! Variables that are set in one place before every use, as copies of arguments are: their content is the value that was stored,
//! whatever condition the place stands under.

use std::collections::{HashMap, HashSet};

use rspirv::dr::Operand;
use rspirv::spirv::{Op, Word};

use super::constants::Reach;
use super::flatten::Program;
use super::graph::Dominators;

/// Where a variable is stored to, and the value.
pub(super) type Assignments = HashMap<Word, (usize, Word)>;

/// Position of an instruction: block and place in it.
type Place = (usize, usize);

/// Variables of functions with one store, which comes before all loads.
pub(super) fn assigned_once(program: &Program, reach: &Reach) -> Assignments {
    let mut variables: HashMap<Word, Uses> = HashMap::new();
    let blocks = || program.blocks.iter().enumerate().filter(|(i, _)| reach.reached[*i]);
    let all = || {
        blocks().flat_map(|(b, block)| block.steps.iter().enumerate().map(move |(s, step)| ((b, s), &step.instruction)))
    };
    for (_, i) in all().filter(|(_, i)| i.class.opcode == Op::Variable && i.operands.len() == 1) {
        variables.extend(i.result_id.map(|id| (id, Uses::default())));
    }
    let mut others = HashSet::new();
    for (place, i) in all() {
        let ids: Vec<Word> = i.operands.iter().filter_map(Operand::id_ref_any).collect();
        match (i.class.opcode, ids.as_slice()) {
            (Op::Load, [from, ..]) => variables.entry(*from).or_default().loads.push(place),
            (Op::Store, [to, value, ..]) => variables.entry(*to).or_default().stores.push((place, *value)),
            _ => others.extend(ids),
        }
    }
    let dominators = Dominators::of(reach);
    let once = |(id, uses): (Word, Uses)| match uses.stores.as_slice() {
        [(store, value)] if !others.contains(&id) => {
            let first = |load: &Place| {
                if load.0 == store.0 { load.1 > store.1 } else { dominators.dominates(store.0, load.0) }
            };
            uses.loads.iter().all(first).then_some((id, (store.0, *value)))
        }
        _ => None,
    };
    variables.into_iter().filter_map(once).collect()
}

#[derive(Default)]
struct Uses {
    stores: Vec<(Place, Word)>,
    loads: Vec<Place>,
}
