//! Recording of a sort's passes.

use super::{SortPlan, rank_by_ballot};
use crate::error::Result;
use crate::gpu::{Groups, Recorder, Slice};
use crate::render::sort_histogram::{SORT_HISTOGRAM, SortHistogramBuffers};
use crate::render::sort_scatter::{SORT_SCATTER, SortScatterBuffers};
use crate::render::sort_spine::{SORT_SPINE, SPINE_GROUPS, SortSpineBuffers};

/// Where keys and values lie, which go back and forth, and what counts them.
pub(crate) struct SortSlices {
    /// The number of keys is word `count_word`.
    pub(crate) counters: Slice,
    pub(crate) count_word: u32,
    pub(crate) keys: [Slice; 2],
    pub(crate) values: [Slice; 2],
    /// One per pass: the first is counted, the others are zero where the plan does not count them apart.
    pub(crate) histograms: Vec<Slice>,
}

/// All passes, labelled `sort_scatter WHAT PASS`; `groups` of `sort_scatter`, one per partition.
pub(crate) fn record(
    r: &mut Recorder,
    what: &str,
    plan: &SortPlan,
    s: &SortSlices,
    groups: impl Fn() -> Groups,
) -> Result<()> {
    let by_ballot = rank_by_ballot(r.subgroup_size_of(&SORT_SCATTER));
    for pass in 0..plan.digits.len() {
        let (from, to) = (pass % 2, (pass + 1) % 2);
        let histogram = s.histograms[pass].clone();
        if plan.counted_apart && pass > 0 {
            let (counters, keys) = (s.counters.clone(), s.keys[from].clone());
            let buffers = SortHistogramBuffers { counters, keys, histogram: histogram.clone() };
            let label = format!("sort_histogram {what} {pass}");
            let push = plan.histogram_push(pass, s.count_word);
            r.dispatch_labelled(&label, &SORT_HISTOGRAM, (), push, buffers, groups())?;
        }
        if plan.prescanned {
            let buffers = SortSpineBuffers { counters: s.counters.clone(), histogram: histogram.clone() };
            let label = format!("sort_spine {what} {pass}");
            let spine = Groups::Direct(SPINE_GROUPS.into());
            r.dispatch_labelled(&label, &SORT_SPINE, (), plan.spine_push(s.count_word), buffers, spine)?;
        }
        let buffers = SortScatterBuffers {
            counters: s.counters.clone(),
            histogram,
            keys_in: s.keys[from].clone(),
            values_in: Some(s.values[from].clone()),
            keys_out: s.keys[to].clone(),
            values_out: Some(s.values[to].clone()),
            next_histogram: s.histograms.get(pass + 1).filter(|_| !plan.counted_apart).cloned(),
        };
        let label = format!("sort_scatter {what} {pass}");
        let constants = plan.scatter_constants(pass, true, by_ballot);
        r.dispatch_labelled(
            &label,
            &SORT_SCATTER,
            constants,
            plan.scatter_push(pass, s.count_word),
            buffers,
            groups(),
        )?;
    }
    Ok(())
}
