//! Structured flow and subgroup operations against the same computation in plain Rust.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use spgs_model::{Dispatch, Options, Program};

const LIMIT: u32 = 40;
const STEP: u32 = 1;

fn collatz(mut n: u32) -> u32 {
    let mut steps = 0;
    for k in 0..LIMIT {
        if n == 1 {
            return steps;
        }
        if n % 7 == 3 && k > 5 {
            break;
        }
        steps += 1;
        if n.is_multiple_of(2) {
            n /= 2;
            continue;
        }
        n = 3 * n + STEP;
        for j in 0..n % 4 {
            if j == 2 {
                return steps + 1000 * j;
            }
            steps += 10;
        }
    }
    loop {
        steps += 100;
        n /= 3;
        if n <= 50 {
            return steps;
        }
    }
}

fn vectors(s: u32) -> u32 {
    let mut own: [u32; 5] = std::array::from_fn(|k| s >> k);
    own[s as usize % 5] = own[s as usize % 5].wrapping_add(17);
    let v = [own[0], own[s as usize % 5], own[4]];
    let mut v = [v[2], v[0], v[1]];
    let by = s % 8;
    v[1] = if by > 3 { v[1].wrapping_add(by) } else { v[1].wrapping_mul(2) };
    v[0] ^ v[1] ^ v[2]
}

/// Rows 2 to 7 of one invocation, from the seeds of its subgroup.
fn subgroup(seeds: &[u32], lane: usize) -> [u32; 6] {
    let s = seeds[lane];
    let active = |l: &usize| !seeds[*l].is_multiple_of(3);
    let lanes: Vec<usize> = (0..seeds.len()).filter(active).collect();
    let part = |l: &usize| seeds[*l] % 100;
    let in_branch = active(&lane);
    let votes = lanes.iter().filter(|l| seeds[**l].is_multiple_of(2)).count() as u32;
    let sum: u32 = lanes.iter().map(part).sum();
    let scan: u32 = lanes.iter().filter(|l| **l <= lane).map(part).sum();
    let largest = seeds.iter().filter(|s| s.is_multiple_of(3)).max().copied().unwrap_or(0);
    let first = if in_branch { seeds[lanes[0]] } else { largest };
    let both = s.is_multiple_of(2) && (s % 3 == 1 || s % 5 == 2);
    let any = seeds.iter().any(|s| s.is_multiple_of(64));
    let inside = |v: u32| if in_branch { v } else { 0 };
    [inside(votes), inside(sum), inside(scan), first, seeds[lane ^ 1], u32::from(both) + 2 * u32::from(any)]
}

#[test]
fn flow_and_subgroup_operations() {
    let bytes = include_bytes!("shaders/flow.spv");
    let words: Vec<u32> = bytes.chunks_exact(4).map(|b| u32::from_le_bytes(b.try_into().unwrap())).collect();
    let push: Vec<u8> = [LIMIT, STEP].iter().flat_map(|v| v.to_le_bytes()).collect();
    for lanes in [4, 8, 16, 32, 64, 128] {
        let program = Program::new(&words, &[lanes]).unwrap();
        for seed in 0..8_u32 {
            let seeds: Vec<u32> = (0..128_u32).map(|i| (i + 77 * seed).wrapping_mul(2_654_435_761) >> 7).collect();
            let mut buffers = [seeds.clone(), vec![0; 8 * 128]];
            let mut dispatch = Dispatch { groups: [1, 1, 1], push: &push, buffers: &mut buffers, image_width: 0 };
            program.run(&mut dispatch, &Options::new(lanes, seed.into())).unwrap();
            for i in 0..128 {
                let first = i / lanes as usize * lanes as usize;
                let row = &buffers[1][8 * i..8 * i + 8];
                let context = format!("{lanes} lanes, seed {seed}, invocation {i}");
                assert_eq!(row[0], collatz(1 + seeds[i] % 1000), "{context}: loops");
                assert_eq!(row[1], vectors(seeds[i]), "{context}: vectors");
                assert_eq!(row[2..], subgroup(&seeds[first..first + lanes as usize], i - first), "{context}: subgroup");
            }
        }
    }
}
