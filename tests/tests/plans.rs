//! The barrier plans of all kinds of frames and of training steps are the golden ones, and stay within the budget of dispatches.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use std::path::Path;

use tools::dev::plan;

#[test]
fn every_plan_is_the_golden_one() {
    let gpu = tests_harness::gpu();
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
    for mut plan in plan::plans(&gpu).unwrap() {
        println!("{}: {} dispatches, {} barriers", plan.name, plan.dispatches, plan.barriers);
        let difference = plan::difference(root, &plan).unwrap();
        assert!(difference.is_none(), "{}", difference.unwrap());
        assert!(plan.dispatches <= plan.budget, "{}: {} dispatches", plan.name, plan.dispatches);
        plan.text = plan.text.replacen("deform_project", "deformed_project", 1);
        assert!(plan::difference(root, &plan).unwrap().is_some(), "a changed plan was not noticed");
    }
}
