//! What an implementation computes on a case.

use std::collections::BTreeMap;

use engine::reference::gradient::property::PropertyGradient;
use engine::scene::DeformNetwork;
use engine::train::property_loss::PropertyLoss;

/// Gradients of one loss: flat arrays in the file's order.
#[derive(Debug, Clone, Default)]
pub(super) struct Gradients {
    pub(super) mean: Option<Vec<f64>>,
    pub(super) rotation: Option<Vec<f64>>,
    pub(super) logit: Option<Vec<f64>>,
    /// By tensor name, as `deform_linear.0.weight`.
    pub(super) network: BTreeMap<String, Vec<f64>>,
}

/// What one implementation computes.
#[derive(Debug, Clone, Default)]
pub(super) struct Results {
    pub(super) outputs: BTreeMap<&'static str, Vec<f64>>,
    pub(super) losses: BTreeMap<String, f64>,
    /// By `motion`, `code`, `paper`.
    pub(super) gradients: BTreeMap<&'static str, Gradients>,
}

/// The forms of the property losses with their weights in the file.
pub(super) const FORMS: [(&str, PropertyLoss, [f32; 3]); 2] =
    [("code", PropertyLoss::Code, [1e-3, 100.0, 100.0]), ("paper", PropertyLoss::Paper, [1e-3, 1.0, 1.0])];

/// Tensors of a network-shaped gradient by name.
pub(super) fn tensors(network: &DeformNetwork) -> BTreeMap<String, Vec<f64>> {
    let linear = network.linear.iter().enumerate().map(|(i, l)| (format!("linear.{i}"), l));
    let heads = [("translation".to_owned(), &network.translation), ("rotation".to_owned(), &network.rotation)];
    let widen = |v: &[f32]| v.iter().map(|x| f64::from(*x)).collect::<Vec<f64>>();
    linear
        .chain(heads)
        .flat_map(|(name, l)| {
            [(format!("deform_{name}.weight"), widen(&l.weight)), (format!("deform_{name}.bias"), widen(&l.bias))]
        })
        .collect()
}

/// The losses' names in the file.
pub(super) fn loss_names(form: &str) -> [String; 3] {
    ["position", "rotation", "translation"].map(|p| format!("{form}_loss_{p}"))
}

/// Flat gradient of the means: none in the code's form, which is nothing everywhere.
pub(super) fn flat_mean(g: &PropertyGradient) -> Vec<f64> {
    g.mean.iter().flat_map(|v| v.to_array()).collect()
}
