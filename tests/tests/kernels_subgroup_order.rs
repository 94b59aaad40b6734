//! The self-test's own kernel against its twin.
#![allow(clippy::unwrap_used, reason = "tests")]

use engine::self_test::{SUBGROUP_ORDER, SubgroupOrderBuffers, SubgroupOrderPush};
use tests_harness::KernelCase;

#[test]
fn subgroups_are_what_the_kernels_take_them_for() {
    let gpu = tests_harness::shared_gpu();
    for groups in [1, 24] {
        let invocations = 256 * groups;
        let buffers = SubgroupOrderBuffers { probe: vec![0; 10 * invocations as usize], tally: vec![0; 35] };
        let push = SubgroupOrderPush { invocations };
        let case = KernelCase { kernel: &SUBGROUP_ORDER, constants: (), push, buffers, groups };
        case.check(&gpu, &format!("{groups} workgroups"));
    }
}
