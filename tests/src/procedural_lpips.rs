//! Weights for LPIPS made by a formula, in a file as a user has it: the real ones belong to their publishers.

use std::path::Path;

use engine::file::tensors;
use engine::metrics::lpips::{Network, Weights, WeightsFile};

/// Shapes of the convolutions, in their order.
fn shapes(network: Network) -> Vec<[usize; 4]> {
    match network {
        Network::Alex => {
            vec![[64, 3, 11, 11], [192, 64, 5, 5], [384, 192, 3, 3], [256, 384, 3, 3], [256, 256, 3, 3]]
        }
        Network::Vgg => {
            let widths = [3, 64, 64, 128, 128, 256, 256, 256, 512, 512, 512, 512, 512, 512];
            widths.windows(2).map(|w| [w[1], w[0], 3, 3]).collect()
        }
    }
}

fn head_widths(network: Network) -> [usize; 5] {
    match network {
        Network::Alex => [64, 192, 384, 256, 256],
        Network::Vgg => [64, 128, 256, 512, 512],
    }
}

/// The `lpips` package's names, without its aliases.
pub fn names(network: Network) -> Vec<String> {
    let layers: &[&[usize]] = match network {
        Network::Alex => &[&[0], &[3], &[6], &[8], &[10]],
        Network::Vgg => &[&[0, 2], &[5, 7], &[10, 12, 14], &[17, 19, 21], &[24, 26, 28]],
    };
    let mut names = Vec::new();
    for (i, slice) in layers.iter().enumerate() {
        for layer in *slice {
            names.extend(["weight", "bias"].map(|kind| format!("net.slice{}.{layer}.{kind}", i + 1)));
        }
    }
    names.extend((0..5).map(|i| format!("lin{i}.model.1.weight")));
    names
}

/// Writes tensors of these names, in the oracle's way: element k of tensor j is sin(0.7 k + 1.3 j), scaled by
/// 1.5/sqrt(elements per output channel) for convolutions and 0.1 for biases, its absolute value for heads.
///
/// # Panics
/// When the file cannot be written.
pub fn write(path: &Path, network: Network, names: &[String]) {
    let (shapes, heads) = (shapes(network), head_widths(network));
    let mut all: Vec<(&str, Vec<usize>, Vec<f32>)> = Vec::new();
    let mut conv = 0;
    for (j, name) in names.iter().enumerate() {
        let sine = |k: usize| (0.7 * k as f64 + 1.3 * j as f64).sin();
        let list = |n: usize, f: &dyn Fn(f64) -> f64| (0..n).map(|k| f(sine(k)) as f32).collect::<Vec<f32>>();
        let (shape, values) = if name.starts_with("lin") {
            let i = name.chars().find_map(|c| c.to_digit(10)).unwrap() as usize;
            (vec![1, heads[i], 1, 1], list(heads[i], &f64::abs))
        } else if name.ends_with("bias") {
            conv += 1;
            (vec![shapes[conv - 1][0]], list(shapes[conv - 1][0], &|v| 0.1 * v))
        } else {
            let per_output: usize = shapes[conv][1..].iter().product();
            let scale = 1.5 / (per_output as f64).sqrt();
            (shapes[conv].to_vec(), list(per_output * shapes[conv][0], &|v| scale * v))
        };
        all.push((name, shape, values));
    }
    let tensors = all.iter().map(|(n, s, v)| tensors::floats(*n, s.clone(), v)).collect();
    tensors::write(path, ["test", "1"], tensors, &Default::default()).unwrap();
}

/// Weights as they are read from the file that [`write()`] makes.
///
/// # Panics
/// When the file cannot be written or read.
pub fn weights(network: Network, names: &[String]) -> Weights {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("weights.safetensors");
    write(&path, network, names);
    WeightsFile::read(&path).unwrap().get(network).unwrap().clone()
}
