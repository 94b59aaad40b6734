//! Deformation fields of other methods: read from a training run, evaluated by the f64 reference, by the kernels and in
//! pictures, all against the formulas of the methods written out here once more; stored, baked, frozen.

use std::path::Path;

use engine::file::torch::Weights;
use engine::file::{self, ply};
use engine::reference::{self, ReferenceOptions, freeze, freeze_with};
use engine::render::{FieldEvaluator, RenderOptions, Renderer};
use engine::scene::field::FieldInput;
use engine::scene::synthetic::{demo_camera, random_gaussians};
use engine::scene::{Gaussians, MotionSource, Scene};
use glam::{DMat3, DQuat, DVec3};
use tests_harness::data;

use crate::checkpoints::{N, close, layer, many, quat, run_folder, same_turn};
use crate::pickle::{self, Numbers, Value, floats};

/// Where a Gaussian must be.
struct Expected {
    mean: DVec3,
    rotation: DQuat,
    scale: [f64; 3],
}

/// The reference and the kernels are where they must be.
fn check(scene: &Scene, t: f64, expected: &[Expected]) {
    let gpu = tests_harness::shared_gpu();
    let device = FieldEvaluator::new(&gpu, scene).unwrap().offsets(t).unwrap();
    let both = [
        ("reference", freeze(scene, t, MotionSource::Auto).unwrap(), 2e-5),
        ("kernels", freeze_with(&scene.gaussians, &device, t).unwrap(), 2e-4),
    ];
    for (which, placed, tolerance) in both {
        for (i, e) in expected.iter().enumerate() {
            let at = format!("{which}, t {t}, Gaussian {i}");
            assert!(close(placed.mean[i], e.mean, tolerance), "{at}: {:?} {}", placed.mean[i], e.mean);
            assert!(same_turn(placed.rotation[i], e.rotation, tolerance * 0.05), "{at}");
            for (found, scale) in placed.log_scale[i].iter().zip(e.scale) {
                let (found, scale) = (f64::from(*found).exp(), scale.max(reference::SCALE_MIN));
                assert!((found - scale).abs() <= tolerance * scale.max(0.01), "{at}: {found} {scale}");
            }
        }
    }
    let picture = demo_camera(0.0, 48, 40);
    let options = RenderOptions { background: [0.1, 0.2, 0.3], ..RenderOptions::default() };
    let mut renderer = Renderer::new(&gpu, scene, &options).unwrap();
    let image = renderer.render(&picture, t).unwrap();
    let truth = reference::render(
        scene,
        &picture,
        t,
        &ReferenceOptions { background: [0.1, 0.2, 0.3], ..ReferenceOptions::default() },
    )
    .unwrap();
    let squares = image.rgb().zip(&truth.rgb).map(|(a, b)| (a - b).powi(2));
    let mean = squares.sum::<f64>() / truth.rgb.len() as f64;
    assert!(truth.visible > 5 && mean < 1e-8, "picture: mean squared error {mean:e}, {} visible", truth.visible);
}

/// Equal after a round trip through the model file.
fn check_file(scene: &Scene) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("field.safetensors");
    file::save(&path, scene).unwrap();
    let read = file::load(&path).unwrap().scene;
    assert!(read.deformation == scene.deformation && read.gaussians == scene.gaussians);
    assert!(file::describe(&path).unwrap().to_string().contains("deformation field"));
}

fn spread(g: &Gaussians, i: usize) -> [f64; 3] {
    g.log_scale[i].map(|l| f64::from(l).exp())
}

fn promote(v: [f32; 3]) -> DVec3 {
    DVec3::from(v.map(f64::from))
}

fn turned(q: DQuat, d: &[f64]) -> DQuat {
    q + DQuat::from_xyzw(d[1], d[2], d[3], d[0])
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

/// `deform.pth` of Deformable-3DGS; `screw`: 6-DoF.
pub(crate) fn deformable(timenet: bool, screw: bool) -> Vec<(String, Value)> {
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
    for name in if screw { &["branch_w", "branch_v"][..] } else { &["gaussian_warp"] } {
        layer(name, 3, 256, 1.0, &mut out);
    }
    layer("gaussian_rotation", 4, 256, 1.0, &mut out);
    layer("gaussian_scaling", 3, 256, 0.01, &mut out);
    out
}

/// The hidden values of Deformable-3DGS's network; the first layer says how many octaves the point has.
fn hidden(net: &Plain<'_>, prefix: &str, point: [f64; 3], t: f64, timenet: bool) -> Vec<f64> {
    let linear = |name: &str, x: &[f64]| net.linear(&format!("{prefix}{name}"), x);
    let inputs = net.get(&format!("{prefix}linear.0.weight")).len() / 256;
    let mut encoding = encode(&point, ((inputs - if timenet { 30 } else { 21 }) / 6) as u32);
    encoding.extend(if timenet {
        linear("timenet.2", &relu(linear("timenet.0", &encode(&[t], 6))))
    } else {
        encode(&[t], 10)
    });
    let mut h = encoding.clone();
    for l in 0..8 {
        if l == 5 {
            h = [encoding.clone(), h].concat();
        }
        h = relu(linear(&format!("linear.{l}"), &h));
    }
    h
}

/// exp of the twist (w, v)·θ by its power series, of homogeneous 4 × 4 matrices: nothing of the closed form.
fn exponential(w: DVec3, v: DVec3, theta: f64, x: DVec3) -> DVec3 {
    let k = DMat3::from_cols(DVec3::new(0.0, w.z, -w.y), DVec3::new(-w.z, 0.0, w.x), DVec3::new(w.y, -w.x, 0.0));
    let (mut power, mut shift, mut sum) = (DMat3::IDENTITY, DVec3::ZERO, x);
    for i in 1..40 {
        let scale = theta / f64::from(i);
        shift = if i == 1 { v * scale } else { k * shift * scale };
        power = k * power * scale;
        sum += power * x + shift;
    }
    sum
}

/// Where Deformable-3DGS's formulas put the Gaussians.
fn deformable_at(net: &Plain<'_>, g: &Gaussians, t: f64, timenet: bool, screw: bool) -> Vec<Expected> {
    let at = |i: usize| {
        let h = hidden(net, "", g.mean[i].map(f64::from), t, timenet);
        let vector = |name: &str| DVec3::from_slice(&net.linear(name, &h));
        let x = promote(g.mean[i]);
        let mean = if screw {
            let (w, v) = (vector("branch_w"), vector("branch_v"));
            let theta = w.length();
            exponential(w / theta + 1e-5, v / theta + 1e-5, theta, x)
        } else {
            x + vector("gaussian_warp")
        };
        let (dq, ds) = (net.linear("gaussian_rotation", &h), net.linear("gaussian_scaling", &h));
        let own = spread(g, i);
        let scale = [0, 1, 2].map(|a| own[a] + ds[a]);
        Expected { mean, rotation: turned(quat(g.rotation[i]), &dq), scale }
    };
    (0..g.len()).map(at).collect()
}

#[test]
fn deformable_3dgs_is_where_its_network_says() {
    for (timenet, screw) in [(false, false), (true, false), (false, true)] {
        let g = random_gaussians(N, 8, 1);
        let weights = deformable(timenet, screw);
        let net = Plain(&weights);
        let expected = [0.0, 0.25, 1.0].map(|t| (t, deformable_at(&net, &g, t, timenet, screw)));
        let moved = (0..N).map(|i| expected[1].1[i].mean.distance(promote(g.mean[i]))).fold(0.0, f64::max);
        assert!(moved > 0.02, "the test's network must move something: {moved}");
        let folder = run_folder(&g, &[("deform/iteration_300/deform.pth", pickle::file(&Value::Dict(weights)))]);
        let scene = file::load(folder.path()).unwrap().scene;
        assert!(scene.is_dynamic() && scene.deformation.superpoints().is_none());
        for (t, expected) in &expected {
            check(&scene, *t, expected);
        }
        check_file(&scene);
    }
}

/// Real weights (3 octaves of the centre) around Gaussians that they were not trained with.
#[test]
fn the_real_sample_plays() {
    let Some(path) = data("checkpoint_samples/deformable3dgs_deform_iter20000.pth") else { return };
    let bytes = std::fs::read(&path).unwrap();
    let weights = Weights::parse(&bytes, &path).unwrap();
    let value = |name: &str| {
        let shape = weights.shape(name).unwrap();
        let any: Vec<Option<usize>> = shape.iter().map(|_| None).collect();
        (name.to_owned(), floats(&shape, weights.floats(name, &any).unwrap().0))
    };
    let named: Vec<(String, Value)> = weights.names().map(value).collect();
    let g = random_gaussians(N, 8, 1);
    let folder = run_folder(&g, &[("deform/iteration_300/deform.pth", bytes.clone())]);
    let scene = file::load(folder.path()).unwrap().scene;
    let field = scene.deformation.field().unwrap();
    assert!(matches!(field.input, FieldInput::Waves { octaves: 3, time: None }), "{:?}", field.input.width());
    for t in [0.0, 0.4, 1.0] {
        check(&scene, t, &deformable_at(&Plain(&named), &g, t, false, false));
    }
    check_file(&scene);
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
        let (dl, dq) = (head("scales_deform"), head("rotations_deform"));
        let own = spread(&g, i);
        Expected {
            mean: promote(g.mean[i]) + DVec3::from_slice(&head("pos_deform")),
            rotation: turned(stored(&g, i), &dq),
            scale: [0, 1, 2].map(|a| own[a] * dl[a].exp()),
        }
    };
    let expected: Vec<_> = [0.0, 0.5].map(|t| (0..N).map(|i| at(i, t)).collect::<Vec<_>>()).into();
    let moved = (0..N).map(|i| expected[0][i].mean.distance(expected[1][i].mean)).fold(0.0, f64::max);
    assert!(moved > 1e-3, "the test's planes must move something");
    let folder = run_folder(&g, &[("point_cloud/iteration_300/deformation.pth", pickle::file(&Value::Dict(weights)))]);
    let scene = file::load(folder.path()).unwrap().scene;
    for (t, expected) in [0.0, 0.5].into_iter().zip(&expected) {
        check(&scene, t, expected);
    }
    check_file(&scene);
}

/// The quaternion as it is stored.
fn stored(g: &Gaussians, i: usize) -> DQuat {
    let [w, x, y, z] = g.rotation[i].map(f64::from);
    DQuat::from_xyzw(x, y, z, w)
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
        let mut network = deformable(false, false);
        if turning {
            layer("local_rotation", 4, 256, 1.0, &mut network);
        }
        let net = Plain(&network);
        let at = |j: usize, t: f64| {
            let place = [0, 1, 2].map(|a| f64::from(nodes[5 * j + a]));
            let h = hidden(&net, "", place, t, false);
            let turn = if turning { net.linear("local_rotation", &h) } else { vec![0.0; 4] };
            let [warp, rotation, scaling] =
                ["gaussian_warp", "gaussian_rotation", "gaussian_scaling"].map(|name| net.linear(name, &h));
            (warp, rotation, turn, scaling)
        };
        let sigmoid = |v: f32| 1.0 / (1.0 + (-f64::from(v)).exp());
        let t = 0.5;
        let moved: Vec<_> = (0..m).map(|j| at(j, t)).collect();
        let expected: Vec<Expected> = (0..N)
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
                let (mut to, mut dq, mut scale) = (DVec3::ZERO, [0.0; 4], spread(&g, i));
                for &j in &order[..3] {
                    let w = raw(j) / sum;
                    let node =
                        DVec3::from_slice(&nodes[5 * j..5 * j + 3].iter().map(|&v| f64::from(v)).collect::<Vec<_>>());
                    let (warp, rotation, turn, scaling) = &moved[j];
                    let r = DQuat::from_xyzw(turn[1], turn[2], turn[3], turn[0] + 1.0).normalize();
                    to += w * (r * (x - node) + node + DVec3::from_slice(warp));
                    (0..4).for_each(|c| dq[c] += w * rotation[c]);
                    (0..3).for_each(|a| scale[a] += mask * w * scaling[a]);
                }
                let dq = dq.map(|d| mask * d);
                Expected { mean: x + mask * (to - x), rotation: turned(stored(&g, i), &dq), scale }
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
        check(&scene, t, &expected);
        check_file(&scene);
    }
}

#[test]
fn a_field_is_baked_into_a_table_within_its_bound() {
    let g = random_gaussians(N, 8, 1);
    let folder =
        run_folder(&g, &[("deform/iteration_300/deform.pth", pickle::file(&Value::Dict(deformable(true, false))))]);
    let scene = file::load(folder.path()).unwrap().scene;
    let at = |name: &str| folder.path().join(name);
    let text = |path: &Path| path.to_str().unwrap().to_owned();
    let convert = |out: &str, more: &[&str]| {
        let paths = [text(folder.path()), text(&at(out))];
        let args: Vec<&str> = paths.iter().map(String::as_str).chain(more.iter().copied()).collect();
        crate::convert::convert(&args).unwrap();
    };
    convert("baked.safetensors", &["--bake", "--bake-error", "0.5", "--views", "1"]);
    let baked = file::load(&at("baked.safetensors")).unwrap().scene;
    assert!(baked.deformation.field().is_none() && baked.deformation.superpoints().is_some());
    let keys = baked.deformation.table().unwrap().times.len();
    assert!((3..=129).contains(&keys), "{keys}");
    // Most of these lie between the times that the tool looks at.
    let mut worst = 0.0_f64;
    for t in (0..=37).map(|i| f64::from(i) / 37.0) {
        let one = freeze(&baked, t, MotionSource::Auto).unwrap();
        let two = freeze(&scene, t, MotionSource::Auto).unwrap();
        let far = one.mean.iter().zip(&two.mean).map(|(a, b)| promote(*a).distance(promote(*b))).fold(0.0, f64::max);
        worst = worst.max(far);
    }
    println!("{keys} key times, at most {worst} from the field");
    // Half a pixel of 800 where the scene's two units fill about half of the width.
    assert!(worst < 0.006, "{worst}");
    // A moment is what the field says, sizes included.
    convert("moment.ply", &["--time", "0.37", "--views", "1"]);
    let moment = ply::read(&at("moment.ply")).unwrap();
    let truth = freeze(&scene, 0.37, MotionSource::Auto).unwrap();
    for i in 0..N {
        assert!(close(moment.mean[i], promote(truth.mean[i]), 2e-4), "Gaussian {i}");
        assert!((moment.log_scale[i][0] - truth.log_scale[i][0]).abs() < 1e-2, "Gaussian {i}");
    }
}

#[test]
fn fields_that_do_not_fit_are_refused_by_name() {
    let g = random_gaussians(N, 8, 0);
    let weights = pickle::file(&Value::Dict(deformable(false, false)));
    let scene = file::load(run_folder(&g, &[("deform/iteration_300/deform.pth", weights)]).path()).unwrap().scene;
    let folder = tempfile::tempdir().unwrap();
    let message = |change: &dyn Fn(&mut Scene)| {
        let mut broken = scene.clone();
        change(&mut broken);
        file::save(&folder.path().join("x.safetensors"), &broken).unwrap_err().to_string()
    };
    let field = |change: &'static dyn Fn(&mut engine::scene::DeformationField)| {
        message(&|s: &mut Scene| change(s.deformation.field_mut().unwrap()))
    };
    let found = field(&|f| f.layers[3].weight[5] = f32::NAN);
    assert!(found.contains("field.layer.3.weight") && found.contains("finite"), "{found}");
    let found = field(&|f| f.head.outputs = 11);
    assert!(found.contains("field.head"), "{found}");
    let network = engine::scene::NonrigidNetwork::init(1);
    let found = scene.deformation.clone().with_nonrigid(network).unwrap_err().to_string();
    assert!(found.contains("only one of them"), "{found}");
    let gpu = tests_harness::shared_gpu();
    let source = |motion| Renderer::new(&gpu, &scene, &RenderOptions { motion, ..RenderOptions::default() });
    assert!(source(MotionSource::Table).unwrap_err().to_string().contains("--bake"));
    source(MotionSource::Network).unwrap();
    freeze(&scene, 0.5, MotionSource::Network).unwrap();
    let mut broken = scene.clone();
    broken.deformation.field_mut().unwrap().layers[1].inputs = 7;
    assert_eq!(Renderer::new(&gpu, &broken, &RenderOptions::default()).unwrap_err().exit_code(), 2);
}
