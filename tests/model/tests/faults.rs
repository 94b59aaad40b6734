//! Every fault in `shaders/faults.comp` is found and named, at every subgroup size and with several orders.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use spgs_model::{Dispatch, ModelError, Options, Program};

fn words() -> Vec<u32> {
    let bytes = include_bytes!("shaders/faults.spv");
    bytes.chunks_exact(4).map(|b| u32::from_le_bytes(b.try_into().unwrap())).collect()
}

/// The first error over several seeds, and the buffer of the last run.
fn run(fault: u32, options: Options, groups: u32, length: usize) -> (Option<ModelError>, Vec<u32>) {
    let program = Program::new(&words(), &[options.lanes, fault]).unwrap();
    let mut buffers = [vec![0; length]];
    for seed in 0..4 {
        let mut dispatch = Dispatch { groups: [groups, 1, 1], push: &[], buffers: &mut buffers, image_width: 0 };
        if let Err(error) = program.run(&mut dispatch, &Options { seed, ..options }) {
            return (Some(error), buffers[0].clone());
        }
    }
    (None, buffers[0].clone())
}

const SIZES: [u32; 6] = [4, 8, 16, 32, 64, 128];

#[test]
fn a_sound_kernel_has_no_fault() {
    for lanes in SIZES {
        let (error, values) = run(0, Options::new(lanes, 0), 3, 769);
        assert_eq!(error, None, "{lanes} lanes");
        assert!((0..768).all(|i| values[i + 1] == (i as u32 % 256 + 1) % 256), "{lanes} lanes");
        assert_eq!(run(14, Options::new(lanes, 0), 1, 257).0, None, "atomics, {lanes} lanes");
    }
}

#[test]
fn every_fault_is_named() {
    for lanes in SIZES {
        let options = Options::new(lanes, 0);
        let message = |fault, groups| {
            let (error, _) = run(fault, options, groups, 1025);
            error.unwrap_or_else(|| panic!("fault {fault} is not found at {lanes} lanes")).to_string()
        };
        let expect = |fault: u32, groups: u32, parts: &[&str]| {
            let text = message(fault, groups);
            assert!(parts.iter().all(|p| text.contains(p)), "fault {fault}, {lanes} lanes: {text}");
        };
        for fault in [1, 2] {
            expect(fault, 1, &["race on `cells`", "read in read_neighbor", "written in main"]);
        }
        expect(3, 1, &["workgroup barrier", "in wait_for_all in flow that is not uniform"]);
        expect(4, 1, &["waits at barrier", "in wait_for_all"]);
        expect(6, 1, &["`cells`", "read in read_neighbor before anything was written"]);
        expect(7, 1, &["`cells`[256] is past its end (256), in main"]);
        expect(8, 1, &["[4] is past its end (4), in main"]);
        expect(9, 1, &["race on `values`"]);
        expect(10, 2, &["race on `values`", "workgroup 0", "workgroup 1"]);
        expect(12, 1, &["race on `cells`[7]"]);
        expect(13, 1, &["race on `cells`", "updated atomically"]);
        // A buffer that is one word too short.
        let (error, _) = run(0, options, 1, 256);
        assert!(error.unwrap().to_string().contains("`values`[256] is past its end (256), in main"));
    }
}

#[test]
fn a_subgroup_barrier_may_wait_for_the_workgroup() {
    for lanes in SIZES {
        let usual = Options::new(lanes, 0);
        assert_eq!(run(5, usual, 1, 257).0, None);
        let as_lavapipe = Options { subgroup_barrier_is_workgroup: true, ..usual };
        let text = run(5, as_lavapipe, 1, 257).0.unwrap().to_string();
        assert!(text.contains("waits at") && text.contains("in main"), "{text}");
        assert_eq!(run(0, as_lavapipe, 1, 257).0, None);
    }
}

#[test]
fn what_is_undefined_is_poison() {
    for lanes in SIZES {
        let (error, values) = run(11, Options::new(lanes, 0), 1, 257);
        assert_eq!(error, None);
        for i in 0..256 {
            let poison = i % lanes as usize != 0;
            assert_eq!(values[i + 1] != i as u32, poison, "{lanes} lanes, invocation {i}");
        }
    }
}

#[test]
fn the_order_of_invocations_may_be_any() {
    let (error, values) = run(0, Options { shuffle_invocations: true, ..Options::new(32, 0) }, 1, 257);
    assert_eq!(error, None);
    assert!((0..256).all(|i| values[i + 1] == (i as u32 + 1) % 256));
}

#[test]
fn a_size_that_no_device_has_is_refused() {
    let program = Program::new(&words(), &[3]).unwrap();
    let mut dispatch = Dispatch { groups: [1, 1, 1], push: &[], buffers: &mut [vec![0; 257]], image_width: 0 };
    assert!(matches!(program.run(&mut dispatch, &Options::new(3, 0)), Err(ModelError::Unsupported(_))));
    assert!(matches!(Program::new(&[1, 2, 3], &[]), Err(ModelError::Unsupported(_))));
}
