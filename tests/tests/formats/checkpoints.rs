//! Training runs become playable scenes that are where their networks say; pickles never run anything.

use std::path::Path;

use engine::file::torch::Weights;
use engine::file::{self, Format, ply};
use engine::reference::freeze;
use engine::scene::synthetic::{random_gaussians, random_network};
use engine::scene::{DeformNetwork, Gaussians, Linear, MotionSource, NonrigidNetwork, Scene};
use glam::{DQuat, DVec3};
use tests_harness::data;

use crate::pickle::{self, Numbers, Value, dict, floats};

const N: usize = 40;
const M: usize = 6;
const T: usize = 5;

/// A deterministic number in ±1.
fn noise(i: usize) -> f32 {
    ((i as f32 * 12.9898).sin() * 43758.547).fract()
}

fn many(seed: usize, n: usize, scale: f32) -> Vec<f32> {
    (0..n).map(|i| scale * noise(seed * 7919 + i)).collect()
}

fn layer(name: &str, outputs: usize, inputs: usize, scale: f32, out: &mut Vec<(String, Value)>) {
    let seed = out.len() + 1;
    let bound = scale / (inputs as f32).sqrt();
    out.push((format!("{name}.weight"), floats(&[outputs, inputs], many(seed, outputs * inputs, bound))));
    out.push((format!("{name}.bias"), floats(&[outputs], many(seed + 500, outputs, 0.1 * scale))));
}

/// The folder of a run with Gaussians at rest.
fn run_folder(g: &Gaussians, weights: &[(&str, Vec<u8>)]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let cloud = folder.path().join("point_cloud/iteration_300/point_cloud.ply");
    std::fs::create_dir_all(cloud.parent().unwrap()).unwrap();
    std::fs::create_dir_all(folder.path().join("point_cloud/iteration_7")).unwrap();
    ply::write(&cloud, g).unwrap();
    for (name, bytes) in weights {
        let path = folder.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, bytes).unwrap();
    }
    folder
}

fn named(layers: Vec<(String, &Linear)>, rename: &dyn Fn(&str) -> String) -> Vec<(String, Value)> {
    let both = |(name, l): (String, &Linear)| {
        let name = rename(&name);
        let weight = floats(&[l.outputs, l.inputs], l.weight.clone());
        [(format!("{name}.weight"), weight), (format!("{name}.bias"), floats(&[l.outputs], l.bias.clone()))]
    };
    layers.into_iter().flat_map(both).collect()
}

/// `deform.pth` of SP-GS.
fn sp_gs(network: &DeformNetwork, rotation_width: usize) -> Vec<u8> {
    let rename = |n: &str| {
        n.replace("deform.", "").replace("translation", "gaussian_warp").replace("rotation", "gaussian_rotation")
    };
    let net = named(network.named_layers(), &rename);
    let p2sp: Vec<i64> = (0..N).map(|i| (i * 5 % M) as i64).collect();
    let state = dict(vec![
        ("A", floats(&[N, M], many(1, N * M, 1.0))),
        ("p2sp", Value::Tensor(vec![N], Numbers::I64(p2sp))),
        ("sp_xyz", floats(&[M, 3], many(2, M * 3, 1.0))),
        ("sp_delta_r", floats(&[T, M, rotation_width], many(3, T * M * rotation_width, 0.4))),
        ("sp_delta_t", floats(&[T, M, 3], many(4, T * M * 3, 0.3))),
        ("train_times", floats(&[T], (0..T).map(|k| k as f32 / 4.0).collect())),
        ("is_sp_init", Value::Tensor(vec![], Numbers::Bool(vec![1]))),
    ]);
    pickle::file(&Value::List(vec![Value::Dict(net), state]))
}

fn close(a: [f32; 3], b: DVec3, tolerance: f64) -> bool {
    DVec3::from(a.map(f64::from)).distance(b) <= tolerance
}

fn quat(q: [f32; 4]) -> DQuat {
    let [w, x, y, z] = q.map(f64::from);
    DQuat::from_xyzw(x, y, z, w).normalize()
}

fn same_turn(a: [f32; 4], b: DQuat, tolerance: f64) -> bool {
    1.0 - quat(a).dot(b.normalize()).abs() <= tolerance
}

#[test]
fn sp_gs_keeps_its_superpoints_tables_and_networks() {
    let g = random_gaussians(N, 3, 2);
    let network = random_network(5);
    let nonrigid = NonrigidNetwork::init(4);
    let rename = |n: &str| {
        let n = n.replace("nonrigid.", "").replace("translation", "gaussian_warp");
        n.replace("rotation", "gaussian_rotation").replace("scaling", "gaussian_scaling")
    };
    let fine = pickle::file(&Value::Dict(named(nonrigid.named_layers(), &rename)));
    let weights =
        [("deform/iteration_300/deform.pth", sp_gs(&network, 3)), ("fine_deform/iteration_9/deform.pth", fine)];
    let folder = run_folder(&g, &weights);
    assert_eq!(Format::of_file(folder.path()).unwrap(), Format::Checkpoint);
    let loaded = file::load(folder.path()).unwrap();
    let scene = loaded.scene;
    assert_eq!((&scene.gaussians, loaded.rejected.total()), (&g, 0));
    assert_eq!(
        (scene.deform.as_ref(), scene.nonrigid.as_ref()),
        (Some(&network), Some(&nonrigid)),
        "weights bit for bit"
    );
    let superpoints = scene.superpoints.as_ref().unwrap();
    assert!(superpoints.of_gaussian.iter().enumerate().all(|(i, &j)| j as usize == i * 5 % M));
    let motion = scene.motion.as_ref().unwrap();
    assert_eq!(motion.rotation.as_flattened(), many(3, T * M * 3, 0.4));
    assert_eq!(motion.translation.as_flattened(), many(4, T * M * 3, 0.3));
    let association = scene.association.as_ref().unwrap();
    assert_eq!(association.neighbors, 5);
    let a = many(1, N * M, 1.0);
    for i in 0..N {
        let far = |j: usize| {
            DVec3::from(g.mean[i].map(f64::from)).distance(DVec3::from(superpoints.position[j].map(f64::from)))
        };
        let list: Vec<usize> = association.neighbor[5 * i..5 * i + 5].iter().map(|&j| j as usize).collect();
        let left_out = (0..M).find(|j| !list.contains(j)).unwrap();
        assert!(list.windows(2).all(|w| far(w[0]) <= far(w[1]) + 1e-6) && far(left_out) >= far(list[4]) - 1e-6);
        assert!(list.iter().enumerate().all(|(k, &j)| association.logit[5 * i + k] == a[i * M + j]));
    }
    // The rigid part at a key time, from the definition.
    let rigid = Scene { nonrigid: None, ..scene.clone() };
    let placed = freeze(&rigid, 0.5, MotionSource::Table).unwrap();
    for i in 0..N {
        let pose = 2 * M + i * 5 % M;
        let r =
            DVec3::from_slice(&many(3, T * M * 3, 0.4)[3 * pose..].iter().map(|&v| f64::from(v)).collect::<Vec<_>>());
        let t =
            DVec3::from_slice(&many(4, T * M * 3, 0.3)[3 * pose..].iter().map(|&v| f64::from(v)).collect::<Vec<_>>());
        let turn = DQuat::from_scaled_axis(r);
        assert!(close(placed.mean[i], turn * DVec3::from(g.mean[i].map(f64::from)) + t, 1e-6));
        assert!(same_turn(placed.rotation[i], turn * quat(g.rotation[i]), 1e-9));
    }
    // Weights inside the run find it.
    assert_eq!(file::load(&folder.path().join("deform/iteration_300/deform.pth")).unwrap().scene, scene);
    let described = file::describe(folder.path()).unwrap();
    assert!(described.deform_network && described.nonrigid_network && described.motion.is_some());
}

#[test]
fn quaternions_that_are_added_move_each_gaussian() {
    let g = random_gaussians(N, 3, 1);
    let mut network = random_network(5);
    network.rotation = Linear { outputs: 4, weight: vec![0.0; 1024], bias: vec![0.0; 4], inputs: 256 };
    let folder = run_folder(&g, &[("deform/iteration_300/deform.pth", sp_gs(&network, 4))]);
    let loaded = file::load(folder.path()).unwrap();
    assert!(loaded.warnings.iter().any(|w| w.contains("SP-GS before 2025")), "{:?}", loaded.warnings);
    let (rotation, translation) = (many(3, T * M * 4, 0.4), many(4, T * M * 3, 0.3));
    for k in 0..T {
        let placed = freeze(&loaded.scene, k as f64 / 4.0, MotionSource::Auto).unwrap();
        for i in 0..N {
            let pose = k * M + i * 5 % M;
            let t = DVec3::from_slice(&translation[3 * pose..].iter().map(|&v| f64::from(v)).collect::<Vec<_>>());
            let d: Vec<f64> = rotation[4 * pose..4 * pose + 4].iter().map(|&v| f64::from(v)).collect();
            let sum = quat(g.rotation[i]) + DQuat::from_xyzw(d[1], d[2], d[3], d[0]);
            assert!(close(placed.mean[i], DVec3::from(g.mean[i].map(f64::from)) + t, 1e-5), "time {k}, Gaussian {i}");
            assert!(same_turn(placed.rotation[i], sum, 1e-6), "time {k}, Gaussian {i}");
        }
    }
}

/// A network in plain f64.
struct Plain<'a>(&'a [(String, Value)]);

impl Plain<'_> {
    fn get(&self, name: &str) -> &[f32] {
        match &self.0.iter().find(|(n, _)| n == name).unwrap().1 {
            Value::Tensor(_, Numbers::F32(v)) => v,
            _ => panic!("{name}"),
        }
    }

    fn linear(&self, name: &str, x: &[f64]) -> Vec<f64> {
        let (w, b) = (self.get(&format!("{name}.weight")), self.get(&format!("{name}.bias")));
        let row = |o: usize| x.iter().enumerate().map(|(i, x)| f64::from(w[o * x_len(x, b, w) + i]) * x).sum::<f64>();
        fn x_len(_: &f64, b: &[f32], w: &[f32]) -> usize {
            w.len() / b.len()
        }
        (0..b.len()).map(|o| row(o) + f64::from(b[o])).collect()
    }
}

fn relu(x: Vec<f64>) -> Vec<f64> {
    x.into_iter().map(|v| v.max(0.0)).collect()
}

fn encode(x: &[f64], octaves: u32) -> Vec<f64> {
    let mut out = x.to_vec();
    for k in 0..octaves {
        out.extend(x.iter().map(|v| (v * f64::from(1 << k)).sin()));
        out.extend(x.iter().map(|v| (v * f64::from(1 << k)).cos()));
    }
    out
}

fn deformable(timenet: bool) -> Vec<(String, Value)> {
    let encoding = 63 + if timenet { 30 } else { 21 };
    let mut out = Vec::new();
    if timenet {
        layer("timenet.0", 256, 13, 1.0, &mut out);
        layer("timenet.2", 30, 256, 1.0, &mut out);
    }
    for i in 0..8 {
        layer(
            &format!("linear.{i}"),
            256,
            [encoding, encoding + 256, 256][if i == 0 {
                0
            } else if i == 5 {
                1
            } else {
                2
            }],
            1.5,
            &mut out,
        );
    }
    layer("gaussian_warp", 3, 256, 1.0, &mut out);
    layer("gaussian_rotation", 4, 256, 1.0, &mut out);
    layer("gaussian_scaling", 3, 256, 0.01, &mut out);
    out
}

#[test]
fn deformable_3dgs_is_where_its_network_says_at_the_key_times() {
    for timenet in [false, true] {
        let g = random_gaussians(N, 8, 1);
        let weights = deformable(timenet);
        let net = Plain(&weights);
        let at = |i: usize, t: f64| {
            let mut encoding = encode(&g.mean[i].map(f64::from), 10);
            encoding.extend(if timenet {
                net.linear("timenet.2", &relu(net.linear("timenet.0", &encode(&[t], 6))))
            } else {
                encode(&[t], 10)
            });
            let mut h = encoding.clone();
            for l in 0..8 {
                if l == 5 {
                    h = [encoding.clone(), h].concat();
                }
                h = relu(net.linear(&format!("linear.{l}"), &h));
            }
            (net.linear("gaussian_warp", &h), net.linear("gaussian_rotation", &h))
        };
        let expected: Vec<_> = [0.0, 0.25, 1.0].map(|t| (0..N).map(|i| at(i, t)).collect::<Vec<_>>()).into();
        let folder = run_folder(&g, &[("deform/iteration_300/deform.pth", pickle::file(&Value::Dict(weights)))]);
        let loaded = file::load(folder.path()).unwrap();
        assert!(loaded.warnings.iter().any(|w| w.contains("evaluated at")), "{:?}", loaded.warnings);
        let motion = loaded.scene.motion.as_ref().unwrap();
        assert!(motion.times.len() >= 5 && motion.times.contains(&0.25), "{:?}", motion.times);
        let largest = expected[1].iter().flat_map(|(warp, _)| warp).fold(0.0f64, |m, v| m.max(v.abs()));
        assert!(largest > 0.02, "the test's network must move something: {largest}");
        for (t, expected) in [0.0, 0.25, 1.0].into_iter().zip(&expected) {
            let placed = freeze(&loaded.scene, t, MotionSource::Auto).unwrap();
            for (i, (warp, turn)) in expected.iter().enumerate() {
                let mean = DVec3::from(g.mean[i].map(f64::from)) + DVec3::from_slice(warp);
                assert!(close(placed.mean[i], mean, 2e-5), "t {t}, Gaussian {i}: {:?} {mean}", placed.mean[i]);
                let sum = quat(g.rotation[i]) + DQuat::from_xyzw(turn[1], turn[2], turn[3], turn[0]);
                assert!(same_turn(placed.rotation[i], sum, 1e-6), "t {t}, Gaussian {i}");
            }
        }
    }
}

#[test]
fn four_d_gs_is_where_its_planes_say() {
    let g = random_gaussians(N, 8, 1);
    let (channels, width) = (4, 8);
    let sizes = [[6usize, 5, 7, 4], [12, 10, 14, 4]];
    let pairs = [[0usize, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]];
    let mut weights =
        vec![("deformation_net.grid.aabb".to_owned(), floats(&[2, 3], vec![1.5, 1.5, 1.5, -1.5, -1.5, -1.5]))];
    for (s, size) in sizes.iter().enumerate() {
        for (p, [a, b]) in pairs.iter().enumerate() {
            let shape = [1, channels, size[*b], size[*a]];
            let values = many(s * 6 + p, shape.iter().product(), 0.5).iter().map(|v| 1.0 + v).collect();
            weights.push((format!("deformation_net.grid.grids.{s}.{p}"), floats(&shape, values)));
        }
    }
    layer("deformation_net.feature_out.0", width, channels * 2, 2.0, &mut weights);
    for (head, outputs) in [("pos_deform", 3), ("scales_deform", 3), ("rotations_deform", 4)] {
        layer(&format!("deformation_net.{head}.1"), width, width, 2.0, &mut weights);
        layer(&format!("deformation_net.{head}.3"), outputs, width, 1.0, &mut weights);
    }
    let net = Plain(&weights);
    let at = |i: usize, t: f64| {
        let mut point: Vec<f64> = g.mean[i].iter().map(|&v| (f64::from(v) - 1.5) * 2.0 / -3.0 - 1.0).collect();
        point.push(t);
        let mut features = Vec::new();
        for (s, size) in sizes.iter().enumerate() {
            for c in 0..channels {
                let mut product = 1.0;
                for (p, [a, b]) in pairs.iter().enumerate() {
                    let values = net.get(&format!("deformation_net.grid.grids.{s}.{p}"));
                    let place = |axis: usize| {
                        ((point[axis] + 1.0) / 2.0 * (size[axis] - 1) as f64).clamp(0.0, (size[axis] - 1) as f64)
                    };
                    let (x, y) = (place(*a), place(*b));
                    let value = |x: usize, y: usize| {
                        let (x, y) = (x.min(size[*a] - 1), y.min(size[*b] - 1));
                        f64::from(values[(c * size[*b] + y) * size[*a] + x])
                    };
                    let (x0, y0) = (x as usize, y as usize);
                    let (wx, wy) = (x - x0 as f64, y - y0 as f64);
                    let low = value(x0, y0) * (1.0 - wx) + value(x0 + 1, y0) * wx;
                    let high = value(x0, y0 + 1) * (1.0 - wx) + value(x0 + 1, y0 + 1) * wx;
                    product *= low * (1.0 - wy) + high * wy;
                }
                features.push(product);
            }
        }
        let h = relu(net.linear("deformation_net.feature_out.0", &features));
        let head = |name: &str| {
            let name = format!("deformation_net.{name}");
            net.linear(&format!("{name}.3"), &relu(net.linear(&format!("{name}.1"), &h)))
        };
        (head("pos_deform"), head("rotations_deform"))
    };
    let expected: Vec<_> = [0.0, 0.5].map(|t| (0..N).map(|i| at(i, t)).collect::<Vec<_>>()).into();
    let moved = (0..N).map(|i| DVec3::from_slice(&expected[0][i].0).distance(DVec3::from_slice(&expected[1][i].0)));
    assert!(moved.fold(0.0, f64::max) > 1e-3, "the test's planes must move something");
    let folder = run_folder(&g, &[("point_cloud/iteration_300/deformation.pth", pickle::file(&Value::Dict(weights)))]);
    let scene = file::load(folder.path()).unwrap().scene;
    for (t, expected) in [0.0, 0.5].into_iter().zip(&expected) {
        let placed = freeze(&scene, t, MotionSource::Auto).unwrap();
        for (i, (offset, turn)) in expected.iter().enumerate() {
            let mean = DVec3::from(g.mean[i].map(f64::from)) + DVec3::from_slice(offset);
            assert!(close(placed.mean[i], mean, 2e-5), "t {t}, Gaussian {i}: {:?} {mean}", placed.mean[i]);
            let raw = g.rotation[i].map(f64::from);
            let sum = DQuat::from_xyzw(raw[1] + turn[1], raw[2] + turn[2], raw[3] + turn[3], raw[0] + turn[0]);
            assert!(same_turn(placed.rotation[i], sum, 1e-6), "t {t}, Gaussian {i}");
        }
    }
}

/// A PLY with further properties `fea_*`.
fn with_features(path: &Path, g: &Gaussians, features: &[f32], width: usize) {
    ply::write(path, g).unwrap();
    let bytes = std::fs::read(path).unwrap();
    let body = bytes.windows(11).position(|w| w == b"end_header\n").unwrap();
    let names: String = (0..width).map(|i| format!("property float fea_{i}\n")).collect();
    let mut out = [&bytes[..body], names.as_bytes(), b"end_header\n"].concat();
    for (i, row) in bytes[body + 11..].chunks_exact((bytes.len() - body - 11) / g.len()).enumerate() {
        out.extend(row);
        out.extend(features[i * width..(i + 1) * width].iter().flat_map(|v| v.to_le_bytes()));
    }
    std::fs::write(path, out).unwrap();
}

#[test]
fn sc_gs_follows_its_nodes() {
    for turning in [false, true] {
        let g = random_gaussians(N, 8, 1);
        let (m, hyper) = (7, 2);
        let nodes = many(31, m * (3 + hyper), 1.0);
        let (radius, weight) = (many(32, m, 0.3), many(33, m, 1.0));
        let features = many(34, N * (hyper + 1), 1.0);
        let mut network = deformable(false);
        if turning {
            layer("local_rotation", 4, 256, 1.0, &mut network);
        }
        let net = Plain(&network);
        let at = |j: usize, t: f64| {
            let place: Vec<f64> = nodes[5 * j..5 * j + 3].iter().map(|&v| f64::from(v)).collect();
            let encoding = [encode(&place, 10), encode(&[t], 10)].concat();
            let mut h = encoding.clone();
            for l in 0..8 {
                if l == 5 {
                    h = [encoding.clone(), h].concat();
                }
                h = relu(net.linear(&format!("linear.{l}"), &h));
            }
            let turn = if turning { net.linear("local_rotation", &h) } else { vec![0.0; 4] };
            (net.linear("gaussian_warp", &h), net.linear("gaussian_rotation", &h), turn)
        };
        let sigmoid = |v: f32| 1.0 / (1.0 + (-f64::from(v)).exp());
        let t = 0.5;
        let moved: Vec<_> = (0..m).map(|j| at(j, t)).collect();
        let expected: Vec<(DVec3, DQuat)> = (0..N)
            .map(|i| {
                let x = DVec3::from(g.mean[i].map(f64::from));
                let full = [&g.mean[i][..], &features[3 * i..3 * i + 2]].concat();
                let squared = |j: usize| (0..5).map(|c| f64::from(full[c] - nodes[5 * j + c]).powi(2)).sum::<f64>();
                let mut order: Vec<usize> = (0..m).collect();
                order.sort_by(|&a, &b| squared(a).total_cmp(&squared(b)));
                let raw = |j: usize| {
                    sigmoid(weight[j]) * (-squared(j) / (2.0 * f64::from(radius[j]).exp().powi(2))).exp() + 1e-7
                };
                let sum: f64 = order[..3].iter().map(|&j| raw(j)).sum();
                let mask = sigmoid(features[3 * i + 2]);
                let (mut to, mut dq) = (DVec3::ZERO, [0.0; 4]);
                for &j in &order[..3] {
                    let w = raw(j) / sum;
                    let node =
                        DVec3::from_slice(&nodes[5 * j..5 * j + 3].iter().map(|&v| f64::from(v)).collect::<Vec<_>>());
                    let (warp, rotation, turn) = &moved[j];
                    let r = DQuat::from_xyzw(turn[1], turn[2], turn[3], turn[0] + 1.0).normalize();
                    to += w * (r * (x - node) + node + DVec3::from_slice(warp));
                    (0..4).for_each(|c| dq[c] += w * rotation[c]);
                }
                let q = g.rotation[i].map(f64::from);
                let sum = [0, 1, 2, 3].map(|c| q[c] + mask * dq[c]);
                (x + mask * (to - x), DQuat::from_xyzw(sum[1], sum[2], sum[3], sum[0]))
            })
            .collect();
        let mut state: Vec<(String, Value)> =
            network.into_iter().map(|(name, value)| (format!("network.{name}"), value)).collect();
        state.push(("nodes".into(), floats(&[m, 5], nodes.clone())));
        state.push(("_node_radius".into(), floats(&[m], radius.clone())));
        state.push(("_node_weight".into(), floats(&[m, 1], weight.clone())));
        let folder = run_folder(&g, &[("deform/iteration_300/deform.pth", pickle::file(&Value::Dict(state)))]);
        with_features(&folder.path().join("point_cloud/iteration_300/point_cloud.ply"), &g, &features, 3);
        let scene = file::load(folder.path()).unwrap().scene;
        let placed = freeze(&scene, t, MotionSource::Auto).unwrap();
        for (i, (mean, turn)) in expected.iter().enumerate() {
            assert!(close(placed.mean[i], *mean, 2e-5), "Gaussian {i}: {:?} {mean}", placed.mean[i]);
            assert!(same_turn(placed.rotation[i], *turn, 1e-6), "Gaussian {i}");
        }
    }
}

#[test]
fn what_cannot_be_played_is_named() {
    let g = random_gaussians(5, 1, 0);
    let message = |weights: &[(&str, Vec<u8>)]| file::load(run_folder(&g, weights).path()).unwrap_err().to_string();
    let other = pickle::file(&dict(vec![("weight", floats(&[1], vec![0.0]))]));
    assert!(message(&[("deform/iteration_300/deform.pth", other)]).contains("no known method"));
    let mut small = deformable(false);
    small[0].1 = floats(&[256, 42], vec![0.0; 256 * 42]);
    let small = pickle::file(&Value::Dict(small));
    assert!(message(&[("deform/iteration_300/deform.pth", small)]).contains("found [256, 42], expected [256, 84]"));
    // Gaussians without weights stand still, with a warning.
    let still = file::load(run_folder(&g, &[]).path()).unwrap();
    assert!(!still.scene.is_dynamic() && still.warnings[0].contains("stands still"), "{:?}", still.warnings);
}

#[test]
fn the_real_sample_loads() {
    let Some(path) = data("checkpoint_samples/deformable3dgs_deform_iter20000.pth") else { return };
    assert_eq!(Format::of_file(&path).unwrap(), Format::Torch);
    let bytes = std::fs::read(&path).unwrap();
    let weights = Weights::parse(&bytes, &path).unwrap();
    assert_eq!(weights.names().count(), 22);
    let (first, shape) = weights.floats("linear.0.weight", &[None, None]).unwrap();
    assert_eq!(shape, [256, 42]);
    // The first array of the archive, as it lies there.
    let raw = |name: &str| {
        let mut zip = zip::ZipArchive::new(std::fs::File::open(&path).unwrap()).unwrap();
        let mut content = Vec::new();
        std::io::Read::read_to_end(&mut zip.by_name(name).unwrap(), &mut content).unwrap();
        content.chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect::<Vec<f32>>()
    };
    assert_eq!(first, raw("deform/data/0"));
    assert_eq!(weights.floats("gaussian_scaling.bias", &[Some(3)]).unwrap().0, raw("deform/data/21"));
    let described = file::describe(&path).unwrap();
    assert_eq!((described.tensors.len(), described.gaussians), (22, 0));
    assert!(described.to_string().contains("Deformable-3DGS"), "{described}");
    let message = file::load(&path).unwrap_err().to_string();
    assert!(message.contains("without Gaussians"), "{message}");
}

/// Pickles that would run something, were they run.
#[test]
fn pickles_that_call_are_refused_by_name() {
    let path = Path::new("x.pth");
    let message = |instructions: &[u8]| {
        let bytes = pickle::file(&Value::Raw(instructions.to_vec()));
        Weights::parse(&bytes, path).err().expect("refused").to_string()
    };
    assert!(message(b"cos\nsystem\nX\x04\0\0\0true\x85R").contains("a call of `os.system`"));
    assert!(message(b"cbuiltins\neval\nX\x01\0\0\x001\x85R").contains("a call of `builtins.eval`"));
    assert!(message(b"\x8c\x05posix\x8c\x06system\x93").contains("a call of `posix.system`"));
    assert!(message(b"ctorch\nload\n").contains("a call of `torch.load`"));
    assert!(message(b"ccollections\nOrderedDict\n(N)\x81").contains("instruction 0x81"));
    assert!(message(b"(cos\nsystem\no").contains("a call of `os.system`"));
    assert!(message(b"cos\n").contains("end"));
}
