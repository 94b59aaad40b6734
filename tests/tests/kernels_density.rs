//! Density control on the device: each kernel against its twin, whole passes against a plain model of 3DGS's rules.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use engine::gpu::interface::{Interface, KernelOf};
use engine::gpu::{Buffer, Gpu};
use engine::scene::parameter::{LOG_SCALE, MEAN, OPACITY_LOGIT, PARAMETERS, ROTATION, smoothed};
use engine::scene::synthetic::Random;
use engine::train::density::density_decide::{DENSITY_DECIDE, DensityDecideBuffers, DensityDecidePush};
use engine::train::density::density_emit::{DENSITY_EMIT, DensityEmitBuffers, DensityEmitPush};
use engine::train::density::density_histogram::{DENSITY_HISTOGRAM, DensityHistogramBuffers, DensityHistogramPush};
use engine::train::density::density_scan::{DENSITY_SCAN, DensityScanBuffers, DensityScanPush};
use engine::train::density::gather_rows::{GATHER_ROWS, GatherRowsBuffers, GatherRowsPush};
use engine::train::density::reset_opacity::{
    RESET_OPACITY, ResetOpacityBuffers, ResetOpacityConstants, ResetOpacityPush,
};
use engine::train::density::split_children::{SPLIT_CHILDREN, SplitChildrenBuffers, SplitChildrenPush};
use engine::train::density::*;
use engine::train::rng;
use tests_harness::{KernelCase, widths};

/// One Gaussian with everything that has a row.
#[derive(Debug, Clone, PartialEq)]
struct Row {
    mean: [f32; 3],
    log_scale: [f32; 3],
    rotation: [f32; 4],
    opacity_logit: f32,
    gradient: [f32; 2],
    radius: f32,
    /// Two planes of Adam moments.
    moments: [f32; 2],
    superpoint: u32,
    /// Association of three slots.
    neighbor: [u32; 3],
}

fn random_rows(n: usize, seed: u64) -> Vec<Row> {
    let mut random = Random::new(seed);
    (0..n)
        .map(|i| Row {
            mean: [0, 1, 2].map(|_| random.normal() as f32),
            log_scale: [0, 1, 2].map(|_| random.range(-8.0, -1.5) as f32),
            rotation: [0, 1, 2, 3].map(|_| 2.0 * random.normal() as f32),
            opacity_logit: random.range(-6.5, 4.0) as f32,
            // The quotient is a key, and a GPU may round a division down or up: by these views it is exact.
            gradient: [random.range(0.0, 2e-2) as f32, [0.0, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0][random.below(7)]],
            radius: random.range(0.0, 25.0) as f32,
            moments: [random.normal() as f32, random.uniform() as f32],
            superpoint: random.below(30) as u32,
            neighbor: [i as u32, random.below(30) as u32, random.below(30) as u32],
        })
        .collect()
}

fn planes<const W: usize>(rows: &[Row], part: impl Fn(&Row) -> [f32; W]) -> Vec<u32> {
    (0..W).flat_map(|plane| rows.iter().map(|r| part(r)[plane].to_bits()).collect::<Vec<_>>()).collect()
}

/// The arrays of `DensityBuffers` in order, as words.
fn arrays(rows: &[Row]) -> [Vec<u32>; 9] {
    [
        planes(rows, |r| r.mean),
        planes(rows, |r| r.log_scale),
        rows.iter().flat_map(|r| r.rotation.map(f32::to_bits)).collect(),
        planes(rows, |r| [r.opacity_logit]),
        planes(rows, |r| r.gradient),
        planes(rows, |r| [r.radius]),
        planes(rows, |r| r.moments),
        rows.iter().map(|r| r.superpoint).collect(),
        rows.iter().flat_map(|r| r.neighbor).collect(),
    ]
}

fn upload(gpu: &Gpu, rows: &[Row]) -> DensityBuffers {
    let names =
        ["mean", "log_scale", "rotation", "opacity_logit", "density", "max_radius", "moment", "superpoint", "neighbor"];
    let mut made = names
        .iter()
        .zip(arrays(rows))
        .map(|(name, words)| gpu.buffer_with(name, bytemuck::cast_slice(&words)).unwrap())
        .collect::<Vec<Buffer>>()
        .into_iter();
    let mut next = || made.next().unwrap();
    let parameter = |parameter: usize, buffer: Buffer| {
        let [planes, width] = PARAMETERS[parameter].planes_and_width();
        RowArray { buffer, planes, width, new_rows: NewRows::Copy }
    };
    DensityBuffers {
        parameters: [MEAN, LOG_SCALE, ROTATION, OPACITY_LOGIT].map(|p| parameter(p, next())).to_vec(),
        density: next(),
        max_radius: next(),
        rows: vec![
            RowArray { buffer: next(), planes: 2, width: 1, new_rows: NewRows::Zero },
            RowArray { buffer: next(), planes: 1, width: 1, new_rows: NewRows::Copy },
            RowArray { buffer: next(), planes: 1, width: 3, new_rows: NewRows::Copy },
        ],
    }
}

fn download(gpu: &Gpu, buffers: &DensityBuffers, n: u32) -> [Vec<u32>; 9] {
    let b = buffers;
    let list = [
        (&b.parameters[MEAN].buffer, 3),
        (&b.parameters[LOG_SCALE].buffer, 3),
        (&b.parameters[ROTATION].buffer, 4),
        (&b.parameters[OPACITY_LOGIT].buffer, 1),
        (&b.density, 2),
        (&b.max_radius, 1),
        (&b.rows[0].buffer, 2),
        (&b.rows[1].buffer, 1),
        (&b.rows[2].buffer, 3),
    ];
    list.map(|(buffer, words)| {
        bytemuck::pod_collect_to_vec(&gpu.download(buffer.slice(0, 4 * words * u64::from(n))).unwrap())
    })
}

/// What the rules say, one Gaussian after the other.
fn model(rows: &[Row], options: &DensityOptions) -> (Vec<Row>, [u32; 4]) {
    let gradient = |r: &Row| {
        let g = r.gradient[0] / r.gradient[1];
        if r.gradient[1] > 0.0 && g.is_finite() { g } else { 0.0 }
    };
    let largest = |r: &Row| f64::from(r.log_scale.iter().fold(f32::MIN, |a, b| a.max(*b))).exp();
    let opacity = |r: &Row| 1.0 / (1.0 + f64::from(-r.opacity_logit).exp());
    let too_large = |scale: f64| options.world_size.is_some_and(|share| scale > share * options.extent);
    let splits = |r: &Row| largest(r) > options.percent_dense * options.extent;
    let wants = |r: &Row| gradient(r) >= options.gradient_threshold;
    let gone = |r: &Row| {
        let scale = if wants(r) && splits(r) { largest(r) / 1.6 } else { largest(r) };
        let finite = r.log_scale.iter().all(|s| s.is_finite());
        let radius = !wants(r) && options.max_screen_radius.is_some_and(|m| r.radius > m);
        r.opacity_logit.is_nan() || opacity(r) < options.min_opacity || !finite || too_large(scale) || radius
    };
    let mut growing: Vec<usize> = (0..rows.len()).filter(|&i| !gone(&rows[i]) && wants(&rows[i])).collect();
    growing.sort_by(|&a, &b| gradient(&rows[b]).total_cmp(&gradient(&rows[a])).then(a.cmp(&b)));
    let stay = rows.iter().filter(|r| !gone(r)).count();
    let wanted = growing.len();
    growing.truncate((options.max_gaussians as usize).saturating_sub(stay));
    let (mut out, mut counts) = (Vec::new(), [0, 0, 0, (wanted - growing.len()) as u32]);
    for (i, row) in rows.iter().enumerate() {
        let grows = growing.contains(&i);
        if gone(row) || (!grows && too_large(largest(row))) {
            counts[2] += 1;
            continue;
        }
        let fresh = Row { gradient: [0.0; 2], radius: 0.0, ..row.clone() };
        let new = Row { moments: [0.0; 2], ..fresh.clone() };
        if !grows {
            out.push(fresh);
        } else if splits(row) {
            counts[1] += 1;
            out.extend([0, 1].map(|child| split(&new, i as u32, child, options)));
        } else {
            counts[0] += 1;
            out.extend([fresh, new]);
        }
    }
    (out, counts)
}

fn split(parent: &Row, index: u32, child: u32, options: &DensityOptions) -> Row {
    let words = rng::words(options.seed, options.iteration, [index, child], 0);
    let unit = |w: u32| f64::from(w >> 8) / 16_777_216.0;
    let polar = |a: u32, b: u32| ((-2.0 * (1.0 - unit(a)).ln()).sqrt(), std::f64::consts::TAU * unit(b));
    let ((r, a), (s, b)) = (polar(words[0], words[1]), polar(words[2], words[3]));
    let scale = parent.log_scale.map(|s| f64::from(s).exp());
    let normal = glam::DVec3::new(r * a.cos() * scale[0], r * a.sin() * scale[1], s * b.cos() * scale[2]);
    let q = parent.rotation.map(f64::from);
    let offset = glam::DQuat::from_xyzw(q[1], q[2], q[3], q[0]).normalize() * normal;
    Row {
        mean: [0, 1, 2].map(|k| (f64::from(parent.mean[k]) + offset[k]) as f32),
        log_scale: parent.log_scale.map(|s| (f64::from(s) - 1.6_f64.ln()) as f32),
        ..parent.clone()
    }
}

/// Runs a pass and compares everything with the model; returns the new count.
fn check(gpu: &Gpu, rows: &[Row], options: &DensityOptions) -> u32 {
    let outcome = Density::new(gpu).run(upload(gpu, rows), rows.len() as u32, options).unwrap();
    let (expected, [cloned, split, pruned, refused]) = model(rows, options);
    assert_eq!(
        [outcome.new_count, outcome.cloned, outcome.split, outcome.pruned, outcome.refused],
        [expected.len() as u32, cloned, split, pruned, refused],
        "{options:?}"
    );
    assert!(outcome.new_count <= options.max_gaussians.max(rows.len() as u32));
    let found = download(gpu, &outcome.buffers, outcome.new_count);
    for (array, (found, expected)) in found.iter().zip(arrays(&expected)).enumerate() {
        assert_eq!(found.len(), expected.len(), "array {array}");
        for (i, (f, e)) in found.iter().zip(expected).enumerate() {
            let (a, b) = (f32::from_bits(*f), f32::from_bits(e));
            let near = array < 2 && (a - b).abs() <= 2e-6 * b.abs().max(1.0);
            assert!(*f == e || near, "array {array} [{i}]: {a} against {b}");
        }
    }
    outcome.new_count
}

fn options() -> DensityOptions {
    DensityOptions {
        percent_dense: 0.02,
        extent: 2.0,
        seed: 0x0123_4567_89ab_cdef,
        iteration: 600,
        ..Default::default()
    }
}

#[test]
fn passes_equal_the_model() {
    let gpu = tests_harness::shared_gpu();
    widths::assert_lanes(&gpu);
    for (n, seed) in [(1, 1), (2, 2), (255, 3), (256, 4), (257, 5), (1000, 6), (3000, 7)] {
        let rows = random_rows(n, seed);
        check(&gpu, &rows, &options());
        check(&gpu, &rows, &DensityOptions { world_size: Some(0.1), max_screen_radius: Some(20.0), ..options() });
        check(&gpu, &rows, &DensityOptions { gradient_threshold: f32::INFINITY, ..options() });
    }
}

#[test]
fn more_than_one_round_of_the_scan() {
    // 70,000 Gaussians are 274 blocks, more than one round of 256.
    let gpu = tests_harness::shared_gpu();
    check(&gpu, &random_rows(70_000, 8), &DensityOptions { gradient_threshold: 1e-2, ..options() });
}

#[test]
fn nothing_everything_and_all_pruned() {
    let gpu = tests_harness::shared_gpu();
    let outcome = Density::new(&gpu).run(upload(&gpu, &[]), 0, &options()).unwrap();
    assert_eq!(outcome.new_count, 0);
    let mut rows = random_rows(600, 9);
    rows.iter_mut().for_each(|r| (r.opacity_logit, r.gradient) = (2.0, [1.0, 2.0]));
    assert_eq!(check(&gpu, &rows, &DensityOptions { percent_dense: 1e-9, ..options() }), 1200);
    assert_eq!(check(&gpu, &rows, &DensityOptions { percent_dense: 1e9, ..options() }), 1200);
    let pruned = DensityOptions { min_opacity: 0.95, ..options() };
    let outcome = Density::new(&gpu).run(upload(&gpu, &rows), 600, &pruned).unwrap();
    assert_eq!((outcome.new_count, outcome.pruned), (0, 600));
    // What is left can be passed on.
    let again = Density::new(&gpu).run(outcome.buffers, 0, &pruned).unwrap();
    assert_eq!(again.new_count, 0);
    for i in 0..3 {
        rows[i].log_scale[i] = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY][i];
        rows[3 + i].opacity_logit = [f32::NAN, f32::NEG_INFINITY, f32::INFINITY][i];
        rows[6 + i].gradient = [[f32::NAN, 1.0], [f32::INFINITY, 3.0], [1.0, 0.0]][i];
    }
    check(&gpu, &rows, &options());
}

#[test]
fn the_budget_is_never_exceeded() {
    let gpu = tests_harness::shared_gpu();
    let mut rows = random_rows(900, 10);
    let free = check(&gpu, &rows, &options());
    let stay = check(&gpu, &rows, &DensityOptions { max_gaussians: 0, ..options() });
    assert!(stay < free);
    for max_gaussians in [1, stay - 1, stay, stay + 1, stay + 2, stay + 17, free - 1, free, free + 1] {
        let count = check(&gpu, &rows, &DensityOptions { max_gaussians, ..options() });
        assert_eq!(count, max_gaussians.clamp(stay, free));
    }
    // Ties: the smaller index grows.
    rows.iter_mut().enumerate().for_each(|(i, r)| r.gradient = [[1.0, 4.0], [3.0, 4.0]][usize::from(i % 7 == 3)]);
    let free = check(&gpu, &rows, &options());
    for max_gaussians in [stay + 1, stay + 50, stay + 200, stay + 201, free - 1] {
        let count = check(&gpu, &rows, &DensityOptions { max_gaussians, ..options() });
        assert_eq!(count, max_gaussians);
    }
}

#[test]
fn a_static_scene_has_fewer_arrays() {
    let gpu = tests_harness::shared_gpu();
    let rows = random_rows(300, 11);
    let (expected, _) = model(&rows, &options());
    let mut buffers = upload(&gpu, &rows);
    let empty = RowArray { planes: 0, ..buffers.rows[1].clone() };
    buffers.rows = vec![empty];
    let outcome = Density::new(&gpu).run(buffers, 300, &options()).unwrap();
    assert_eq!((outcome.new_count as usize, outcome.buffers.rows.len()), (expected.len(), 1));
    // Too small a buffer is refused, not read past its end.
    let mut buffers = upload(&gpu, &rows);
    buffers.rows[0].planes = 20;
    assert!(Density::new(&gpu).run(buffers, 300, &options()).is_err());
}

#[test]
fn passes_are_reproducible_and_give_memory_back() {
    let gpu = tests_harness::shared_gpu();
    let rows = random_rows(2000, 12);
    let pass = |seed| {
        let outcome = Density::new(&gpu).run(upload(&gpu, &rows), 2000, &DensityOptions { seed, ..options() }).unwrap();
        download(&gpu, &outcome.buffers, outcome.new_count)
    };
    let before = gpu.buffer_count();
    let first = pass(1);
    assert!(pass(1) == first);
    assert!(pass(2) != first);
    assert_eq!(gpu.buffer_count(), before);
}

fn run<I: Interface<Constants: Default>>(
    gpu: &Gpu,
    kernel: &'static KernelOf<I>,
    push: I::Push,
    buffers: I::Buffers<Vec<u32>>,
    groups: u32,
) -> I::Buffers<Vec<u32>> {
    KernelCase { kernel, constants: I::Constants::default(), push, buffers, groups }
        .check(gpu, &format!("{groups} groups"))
}

#[test]
fn kernels_equal_twins() {
    let gpu = tests_harness::shared_gpu();
    for (n, seed) in [(1_u32, 20), (300, 21), (2049, 22)] {
        let [mean, log_scale, rotation, opacity_logit, density, max_radius, moments, ..] =
            arrays(&random_rows(n as usize, seed));
        let groups = n.div_ceil(256) + 1;
        let push = DensityDecidePush {
            gaussians: n,
            gradient_threshold: 2e-4,
            min_opacity_logit: -5.0,
            dense_log_scale: -3.5,
            world_log_scale: -1.8,
            max_screen_radius: 20.0,
            accept_key: 3e-4_f32.to_bits(),
            accept_index: n / 2,
        };
        let zeros = |words: u32| vec![0; words as usize];
        let buffers = DensityDecideBuffers {
            log_scale: log_scale.clone(),
            opacity_logit: opacity_logit.clone(),
            density: density.clone(),
            max_radius,
            action: zeros(n),
            row_block: zeros(n.div_ceil(256)),
            totals: zeros(8),
        };
        let done = run(&gpu, &DENSITY_DECIDE, push, buffers.clone(), groups);
        // As large as the limit is small enough to be cloned.
        let cloned = done.action.iter().position(|a| *a == ACTION_CLONE);
        if let Some(i) = cloned {
            let largest = (0..3).map(|axis| f32::from_bits(log_scale[axis * n as usize + i])).fold(f32::MIN, f32::max);
            let tie = DensityDecidePush { dense_log_scale: largest, ..push };
            assert_eq!(run(&gpu, &DENSITY_DECIDE, tie, buffers, groups).action[i], ACTION_CLONE);
        } else {
            assert_eq!(n, 1, "none is cloned");
        }
        let DensityDecideBuffers { action, row_block, totals, .. } = done;
        for by_index in [0, 1] {
            let tie_key = f32::from_bits(density[0]) / f32::from_bits(density[n as usize]);
            let push = DensityHistogramPush {
                gaussians: n,
                by_index,
                tie_key: tie_key.to_bits(),
                prefix_mask: 0xf << 28,
                prefix: [0x3 << 28, 0xf << 28][by_index as usize],
                shift: 10,
            };
            let (density, action) = (density.clone(), action.clone());
            let buffers = DensityHistogramBuffers { density, action, histogram: zeros(2048) };
            run(&gpu, &DENSITY_HISTOGRAM, push, buffers, groups);
        }
        let push = DensityScanPush { blocks: n.div_ceil(256) };
        let row_block = run(&gpu, &DENSITY_SCAN, push, DensityScanBuffers { row_block }, 1).row_block;
        let rows = totals[1] + 2 * (totals[2] + totals[3]);
        let push = DensityEmitPush { gaussians: n, rows };
        let buffers = DensityEmitBuffers { action, row_block, source: zeros(rows) };
        let source = run(&gpu, &DENSITY_EMIT, push, buffers, groups).source;
        let gather = |old: &[u32], planes: u32, width: u32, zero_new: u32| {
            let push = GatherRowsPush { old_count: n, new_count: rows, planes, width, zero_new };
            let (old_rows, new_rows) = (old.to_vec(), zeros(rows * planes * width));
            let buffers = GatherRowsBuffers { source: source.clone(), old_rows, new_rows };
            let groups = (rows * width).div_ceil(256) + 1;
            run(&gpu, &GATHER_ROWS, push, buffers, groups).new_rows
        };
        gather(&moments, 2, 1, 1);
        let rotation = gather(&rotation, 1, 4, 0);
        let (mean, log_scale) = (gather(&mean, 3, 1, 0), gather(&log_scale, 3, 1, 0));
        let push = SplitChildrenPush { rows, seed_low: 3, seed_high: 4, iteration: 5 };
        let buffers = SplitChildrenBuffers { source: source.clone(), rotation, mean, log_scale };
        run(&gpu, &SPLIT_CHILDREN, push, buffers, rows.div_ceil(256) + 1);
        let push = ResetOpacityPush { gaussians: n, limit: -4.6, opacity: 0.01, plane: 1, smoothing: 0 };
        let buffers = ResetOpacityBuffers {
            opacity_logit,
            moment_1: moments.clone(),
            moment_2: moments,
            log_scale: None,
            optional: None,
        };
        let reset = run(&gpu, &RESET_OPACITY, push, buffers, groups);
        assert!(reset.opacity_logit.iter().all(|w| f32::from_bits(*w) <= -4.6));
    }
}

/// The opacity that is drawn is at most the limit, and what was at or above it is at the limit, or where it was at half.
#[test]
fn the_opacity_reset_leaves_what_is_smoothed_to_be_seen() {
    let gpu = tests_harness::shared_gpu();
    let n = 500;
    let rows = random_rows(n, 31);
    let opacity_logit = planes(&rows, |r| [r.opacity_logit]);
    // The smoothing is the second plane, as if there were a first one.
    let sigma = |i: usize| 0.01 * (1 + i % 7) as f32;
    let optional: Vec<u32> = (0..2 * n).map(|k| f32::to_bits(if k < n { f32::NAN } else { sigma(k - n) })).collect();
    let case = KernelCase {
        kernel: &RESET_OPACITY,
        constants: ResetOpacityConstants { smoothed: 1 },
        push: ResetOpacityPush { gaussians: n as u32, limit: f32::NAN, opacity: 0.01, plane: 0, smoothing: 1 },
        buffers: ResetOpacityBuffers {
            opacity_logit: opacity_logit.clone(),
            moment_1: vec![0; n],
            moment_2: vec![0; n],
            log_scale: Some(planes(&rows, |r| r.log_scale)),
            optional: Some(optional),
        },
        groups: 2,
    };
    let result = case.run(&gpu);
    let tolerance = RESET_OPACITY.kernel.tolerance;
    let mut at_limit = 0;
    for (i, row) in rows.iter().enumerate() {
        let [gpu, twin] = [&result.gpu, &result.twin].map(|side| f32::from_bits(side.opacity_logit[i]));
        assert!((gpu - twin).abs() <= tolerance.absolute + tolerance.relative * twin.abs(), "{gpu} {twin}");
        let left = smoothed(row.log_scale.map(|s| f64::from(s).exp()), sigma(i).into()).1;
        let drawn = |logit: f32| left / (1.0 + (-f64::from(logit)).exp());
        let most = (0.5 * left).min(0.01);
        let expected = drawn(row.opacity_logit).min(most);
        assert!((drawn(gpu) - expected).abs() <= 1e-4 * expected, "Gaussian {i}: {} for {expected}", drawn(gpu));
        at_limit += usize::from(most == 0.01 && expected == most);
    }
    assert!(at_limit > n / 8, "{at_limit} of {n} are lowered to the limit and not below");
}

#[test]
fn the_opacity_reset_lowers_and_forgets() {
    let gpu = tests_harness::shared_gpu();
    let rows = random_rows(500, 30);
    let upload = |name: &str, words: &[u32]| gpu.buffer_with(name, bytemuck::cast_slice(words)).unwrap();
    let opacity = upload("opacity_logit", &planes(&rows, |r| [r.opacity_logit]));
    let ones = vec![1.0_f32.to_bits(); 14 * 500];
    let moments = [upload("moment_1", &ones), upload("moment_2", &ones)];
    let rows_of = |opacity_logit| OpacityRows {
        gaussians: 500,
        opacity_logit,
        moments: [&moments[0], &moments[1]],
        smoothing: None,
    };
    reset_opacity(&gpu, rows_of(&opacity), 0.01).unwrap();
    let floats = |b: &Buffer| bytemuck::pod_collect_to_vec::<u8, f32>(&gpu.download(b).unwrap());
    let limit = (0.01_f64 / 0.99).ln() as f32;
    for (found, row) in floats(&opacity).iter().zip(&rows) {
        assert_eq!(*found, row.opacity_logit.min(limit));
    }
    for moment in &moments {
        for (i, m) in floats(moment)[..14 * 500].iter().enumerate() {
            assert_eq!(*m, if i / 500 == 10 { 0.0 } else { 1.0 }, "{i}");
        }
    }
}
