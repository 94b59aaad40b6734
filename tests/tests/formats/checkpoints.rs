//! Training runs become playable scenes that are where their networks say; pickles never run anything.

use std::path::Path;

use engine::file::torch::Weights;
use engine::file::{self, Format, ply};
use engine::reference::freeze;
use engine::scene::synthetic::{random_gaussians, random_network};
use engine::scene::{DeformNetwork, Gaussians, Linear, MotionSource, NonrigidNetwork};
use glam::{DQuat, DVec3};
use tests_harness::data;

use crate::fields::deformable;
use crate::pickle::{self, Numbers, Value, dict, floats};

pub(crate) const N: usize = 40;
const M: usize = 6;
const T: usize = 5;

/// A deterministic number in ±1.
fn noise(i: usize) -> f32 {
    ((i as f32 * 12.9898).sin() * 43758.547).fract()
}

pub(crate) fn many(seed: usize, n: usize, scale: f32) -> Vec<f32> {
    (0..n).map(|i| scale * noise(seed * 7919 + i)).collect()
}

pub(crate) fn layer(name: &str, outputs: usize, inputs: usize, scale: f32, out: &mut Vec<(String, Value)>) {
    let seed = out.len() + 1;
    let bound = scale / (inputs as f32).sqrt();
    out.push((format!("{name}.weight"), floats(&[outputs, inputs], many(seed, outputs * inputs, bound))));
    out.push((format!("{name}.bias"), floats(&[outputs], many(seed + 500, outputs, 0.1 * scale))));
}

/// The folder of a run with Gaussians at rest.
pub(crate) fn run_folder(g: &Gaussians, weights: &[(&str, Vec<u8>)]) -> tempfile::TempDir {
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

pub(crate) fn close(a: [f32; 3], b: DVec3, tolerance: f64) -> bool {
    DVec3::from(a.map(f64::from)).distance(b) <= tolerance
}

pub(crate) fn quat(q: [f32; 4]) -> DQuat {
    let [w, x, y, z] = q.map(f64::from);
    DQuat::from_xyzw(x, y, z, w).normalize()
}

pub(crate) fn same_turn(a: [f32; 4], b: DQuat, tolerance: f64) -> bool {
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
        (scene.deformation.network(), scene.deformation.nonrigid()),
        (Some(&network), Some(&nonrigid)),
        "weights bit for bit"
    );
    let superpoints = scene.deformation.superpoints().unwrap();
    assert!(superpoints.of_gaussian.iter().enumerate().all(|(i, &j)| j as usize == i * 5 % M));
    let motion = scene.deformation.table().unwrap();
    assert_eq!(motion.rotation.as_flattened(), many(3, T * M * 3, 0.4));
    assert_eq!(motion.translation.as_flattened(), many(4, T * M * 3, 0.3));
    let association = scene.deformation.association().unwrap();
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
    let mut rigid = scene.clone();
    rigid.deformation.take_nonrigid();
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

#[test]
fn what_cannot_be_played_is_named() {
    let g = random_gaussians(5, 1, 0);
    let message = |weights: &[(&str, Vec<u8>)]| file::load(run_folder(&g, weights).path()).unwrap_err().to_string();
    let other = pickle::file(&dict(vec![("weight", floats(&[1], vec![0.0]))]));
    assert!(message(&[("deform/iteration_300/deform.pth", other)]).contains("no known method"));
    let mut small = deformable(false, false);
    small[0].1 = floats(&[256, 43], vec![0.0; 256 * 43]);
    let small = pickle::file(&Value::Dict(small));
    assert!(
        message(&[("deform/iteration_300/deform.pth", small)])
            .contains("found [256, 43], expected [256, 3 + 6 L + 21]")
    );
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
