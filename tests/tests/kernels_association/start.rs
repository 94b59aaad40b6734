//! Farthest-point sampling and the first association.

use super::case::*;
use engine::gpu::{Memory, Slice};
use engine::reference::gradient::association::nearest;
use engine::train::association::*;
use engine::train::farthest_point::*;
use glam::DVec3;
use tests_harness::shared_gpu;

#[test]
fn farthest_points_are_the_ones_of_a_plain_loop() {
    let gpu = shared_gpu();
    for (n, m, seed) in [(5000_usize, 70_u32, 1234_u64), (1, 1, 7), (40, 40, 3), (1024, 5, 1023)] {
        let mut rng = Rng(n as u64);
        // A coarse lattice: equal distances and equal points.
        let mean: Vec<[f32; 3]> = (0..n).map(|_| rng.vector().map(|x| (x * 6.0).round() / 6.0)).collect();
        let mean_buffer = gpu.buffer_with("mean", bytemuck::cast_slice(&planes(&mean))).unwrap();
        let chosen = gpu.buffer("chosen", 4 * u64::from(m), Memory::Device).unwrap();
        let position = gpu.buffer("position", 12 * u64::from(m), Memory::Device).unwrap();
        let sampling = FarthestPoint::new(&gpu, n as u32, seed).unwrap();
        let mut r = gpu.recorder("farthest points");
        sampling.record(&mut r, &(&mean_buffer).into(), m, &(&chosen).into(), &(&position).into()).unwrap();
        gpu.run(r).unwrap();

        let mut distance = vec![f32::MAX; n];
        let mut next = (seed % n as u64) as usize;
        let mut truth = Vec::new();
        for _ in 0..m {
            truth.push(next as u32);
            for (i, d) in distance.iter_mut().enumerate() {
                let v: [f32; 3] = std::array::from_fn(|c| mean[i][c] - mean[next][c]);
                *d = if i == next { -1.0 } else { d.min(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]) };
            }
            next = (0..n).fold(0, |b, i| if distance[i] > distance[b] { i } else { b });
        }
        assert_eq!(download(&gpu, &chosen, m as usize), truth);
        let places: Vec<f32> = truth.iter().flat_map(|&i| mean[i as usize]).collect();
        assert_eq!(floats(&download(&gpu, &position, 3 * m as usize)), places);
    }
}

#[test]
fn superpoints_start_where_the_gaussians_are() {
    let gpu = shared_gpu();
    // More superpoints than Gaussians: one each.
    for (n, asked, init) in
        [(900, 50, AssociationInit::Code), (900, 50, AssociationInit::Paper), (7, 300, AssociationInit::Code)]
    {
        let case = Case::new(n, 1, 5, 8, 6);
        let mean = gpu.buffer_with("mean", bytemuck::cast_slice(&planes(&case.mean))).unwrap();
        let own = Slice::from(&gpu.buffer("superpoint_of_gaussian", 4 * n as u64, Memory::Device).unwrap());
        let options = AssociationOptions { superpoints: asked, init, seed: 11, ..AssociationOptions::default() };
        let state = SuperpointState::init(&gpu, &(&mean).into(), &own, n as u32, options).unwrap();
        let m = asked.min(n as u32) as usize;
        assert_eq!(state.superpoints() as usize, m);
        let (superpoints, association) = state.download(&gpu, &own).unwrap();
        let points: Vec<DVec3> = case.mean.iter().map(promote).collect();
        let centers: Vec<DVec3> = superpoints.position.iter().map(promote).collect();
        assert!(centers.iter().all(|c| points.contains(c)));
        let k = state.options().neighbors as usize;
        let near = nearest(&points, &centers, k);
        for i in 0..n {
            assert_eq!(association.neighbor[i * 8..][..k], near[i * k..][..k]);
            assert!(association.neighbor[i * 8 + k..][..8 - k].iter().all(|j| *j == NO_SUPERPOINT));
            assert_eq!(superpoints.of_gaussian[i], near[i * k]);
            let seeded = centers[near[i * k] as usize] == points[i];
            let first = match init {
                AssociationInit::Code => 1.0,
                AssociationInit::Paper if seeded => 0.9,
                AssociationInit::Paper => 0.1,
            };
            assert_eq!(association.logit[i * 8..][..8], [first, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1], "Gaussian {i}");
        }
        // Saved and loaded, it is the same.
        let loaded =
            SuperpointState::from_parts(&gpu, &superpoints.position, &association, [&[], &[]], *state.options());
        let again = loaded.unwrap().download(&gpu, &own).unwrap();
        assert_eq!(again, (superpoints, association));
    }
}

#[test]
fn wrong_shapes_are_refused() {
    let gpu = shared_gpu();
    let mean = gpu.buffer_with("mean", &[0; 48]).unwrap();
    let own = Slice::from(&gpu.buffer("superpoint_of_gaussian", 16, Memory::Device).unwrap());
    let fails = |n: u32, options: AssociationOptions| {
        SuperpointState::init(&gpu, &(&mean).into(), &own, n, options).unwrap_err().to_string()
    };
    let default = AssociationOptions::default();
    assert!(fails(0, default).contains("gaussians"));
    assert!(fails(4, AssociationOptions { neighbors: 8, ..default }).contains("neighbors"));
    assert!(fails(4, AssociationOptions { slots: 4, ..default }).contains("slots"));
    assert!(fails(4, AssociationOptions { superpoints: 0, ..default }).contains("superpoints"));
}
