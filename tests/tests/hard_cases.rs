//! The table of `spgs bench hard-cases` as a test: every bound of every case holds.

use tools::bench::hard_cases::{Bound, Context, GROUPS, cases};

#[test]
fn every_hard_case_holds() {
    let gpu = tests_harness::gpu();
    let context = Context { gpu: &gpu, runs: 5, frames: 200 };
    let mut missed = Vec::new();
    let (mut bounded, mut seen) = (0, [0_usize; GROUPS.len()]);
    for case in cases() {
        let row = case.run(&context).unwrap();
        let bounds = row.checks.iter().filter(|c| c.bound != Bound::Shown).count();
        println!("{:2} {:36} {:8.1} ms  {}", row.number, row.name, row.ms, row.truth);
        assert!(bounds > 0 || row.name == "so3_lerp_against_geodesic", "{} checks nothing", row.name);
        assert!(row.error.is_some() || !row.truth.is_empty(), "{} does not say what the truth is", row.name);
        bounded += bounds;
        seen[row.number - 1] += 1;
        if !row.pass {
            missed.push(format!("{} `{}`: {:?} {:?}", row.number, row.name, row.error, row.checks));
        }
    }
    assert!(missed.is_empty(), "{}", missed.join("\n"));
    assert!(seen.iter().all(|n| *n > 0) && bounded > 300, "{seen:?}, {bounded} bounds");
}
