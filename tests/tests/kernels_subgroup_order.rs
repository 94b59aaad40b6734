//! The self-test's own kernel against its twin.
#![allow(clippy::unwrap_used, reason = "tests")]

use engine::self_test::{SUBGROUP_ORDER, SubgroupOrderPush};
use tests_harness::UntypedCase;

#[test]
fn subgroups_are_what_the_kernels_take_them_for() {
    let gpu = tests_harness::gpu();
    for groups in [1, 24] {
        let invocations = 256 * groups;
        let case = UntypedCase {
            kernel: &SUBGROUP_ORDER,
            spec: vec![],
            push: bytemuck::bytes_of(&SubgroupOrderPush { invocations }).to_vec(),
            buffers: vec![vec![0; 10 * invocations as usize], vec![0; 35]],
            groups,
        };
        case.run(&gpu).assert_equal(&SUBGROUP_ORDER, &format!("{groups} workgroups"));
    }
}
