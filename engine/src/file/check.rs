//! Consistency of a scene, the same for files read and for scenes to be written.

use std::path::Path;

use crate::error::Error;
use crate::scene::network::{
    DeformNetwork, DeformSize, Linear, NONRIGID_HEADS, NONRIGID_LAYERS, NONRIGID_WIDTH, NonrigidNetwork,
};
use crate::scene::{Association, Gaussians, Motion, Scene, Superpoints, Tensor};

/// Prefixes of tensor names that belong to the model format.
pub(crate) const NAMESPACES: [&str; 7] =
    ["gaussians.", "superpoints.", "motion.", "association.", "deform.", "nonrigid.", "field."];

/// Highest SH degree of a model.
pub(crate) const MAX_SH_DEGREE: u32 = 3;

/// What is wrong with which tensor.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Problem {
    tensor: String,
    found: String,
    expected: String,
}

impl Problem {
    /// As the error of a file that was read.
    pub(crate) fn corrupt(self, path: &Path) -> Error {
        Error::corrupt(path, format!("tensor `{}`", self.tensor), self.found, self.expected)
    }

    /// As the error of a caller who wants to write such a scene.
    pub(crate) fn usage(self, path: &Path) -> Error {
        Error::usage(format!("writing {}: tensor `{}`", path.display(), self.tensor), self.found, self.expected)
    }
}

type Check = Result<(), Problem>;

fn problem(tensor: &str, found: impl Into<String>, expected: impl Into<String>) -> Check {
    Err(Problem { tensor: tensor.into(), found: found.into(), expected: expected.into() })
}

fn length(tensor: &str, found: usize, expected: usize) -> Check {
    if found == expected { Ok(()) } else { problem(tensor, format!("{found} elements"), expected.to_string()) }
}

fn finite(tensor: &str, values: &[f32]) -> Check {
    match values.iter().position(|v| !v.is_finite()) {
        None => Ok(()),
        Some(i) => problem(tensor, format!("{} at element {i}", values[i]), "finite numbers"),
    }
}

fn below(tensor: &str, values: &[u32], count: usize) -> Check {
    match values.iter().position(|&v| v as usize >= count) {
        None => Ok(()),
        Some(i) => {
            let expected = format!("indices below M = {count} (the rows of `superpoints.position`)");
            problem(tensor, format!("{} at element {i}", values[i]), expected)
        }
    }
}

/// All arrays hold N elements. The values themselves are judged one Gaussian at a time, by [`Gaussians::is_valid`].
pub(crate) fn gaussians(g: &Gaussians) -> Check {
    let n = g.len();
    if n > u32::MAX as usize {
        return problem("gaussians.mean", format!("N = {n}"), format!("at most {}", u32::MAX));
    }
    if g.sh_degree > MAX_SH_DEGREE {
        return problem("gaussians.sh", format!("SH degree {}", g.sh_degree), "0, 1, 2 or 3");
    }
    length("gaussians.log_scale", g.log_scale.len(), n)?;
    length("gaussians.rotation", g.rotation.len(), n)?;
    length("gaussians.opacity_logit", g.opacity_logit.len(), n)?;
    length("gaussians.sh", g.sh.len(), n * g.sh_coefficients() * 3)
}

/// Everything but the values of the Gaussians.
pub(crate) fn scene(scene: &Scene) -> Check {
    gaussians(&scene.gaussians)?;
    let n = scene.gaussians.len();
    if let Some(s) = &scene.superpoints {
        superpoints(s, n)?;
    }
    let needs_superpoints = [
        ("motion.times", scene.motion.is_some()),
        ("association.neighbor", scene.association.is_some()),
        ("deform.linear.0.weight", scene.deform.is_some()),
    ];
    if let (None, Some((name, _))) = (&scene.superpoints, needs_superpoints.iter().find(|(_, is_some)| *is_some)) {
        let found = format!("nothing, though `{name}` is there");
        return problem("superpoints.of_gaussian", found, "the superpoints that it moves");
    }
    let m = scene.superpoints.as_ref().map_or(0, |s| s.position.len());
    if let Some(table) = &scene.motion {
        motion(table, m)?;
    }
    if let Some(a) = &scene.association {
        association(a, n, m)?;
    }
    if let Some(network) = &scene.deform {
        deform(network)?;
    }
    if let Some(network) = &scene.nonrigid {
        nonrigid(network)?;
    }
    field(scene)?;
    scene.extra.iter().try_for_each(|(name, tensor)| extra(name, tensor))
}

/// A deformation field fits together and is the only thing that moves the scene.
fn field(scene: &Scene) -> Check {
    match scene.check_field() {
        Ok(()) => Ok(()),
        Err(Error::Usage { what, found, expected }) => problem(&what, found, expected),
        Err(other) => problem("field", other.to_string(), "a field that fits together"),
    }
}

fn superpoints(s: &Superpoints, n: usize) -> Check {
    length("superpoints.of_gaussian", s.of_gaussian.len(), n)?;
    finite("superpoints.position", s.position.as_flattened())?;
    below("superpoints.of_gaussian", &s.of_gaussian, s.position.len())
}

fn motion(table: &Motion, m: usize) -> Check {
    let t = table.times.len();
    if t == 0 {
        return problem("motion.times", "no key time", "at least one");
    }
    finite("motion.times", &table.times)?;
    if let Some(i) = table.times.windows(2).position(|w| w[0] >= w[1]) {
        let found = format!("{} then {} at element {}", table.times[i], table.times[i + 1], i + 1);
        return problem("motion.times", found, "strictly increasing times");
    }
    let name_m = |name: &str, values: &[[f32; 3]]| {
        if values.len() == t * m {
            return finite(name, values.as_flattened());
        }
        let found = format!("{} poses", values.len());
        problem(name, found, format!("T·M = {t}·{m} (M = rows of `superpoints.position`)"))
    };
    name_m("motion.rotation", &table.rotation)?;
    name_m("motion.translation", &table.translation)
}

fn association(a: &Association, n: usize, m: usize) -> Check {
    if a.neighbors == 0 {
        return problem("association.neighbor", "K' = 0", "at least one neighbour");
    }
    length("association.neighbor", a.neighbor.len(), n * a.neighbors)?;
    length("association.logit", a.logit.len(), n * a.neighbors)?;
    finite("association.logit", &a.logit)?;
    below("association.neighbor", &a.neighbor, m)
}

fn deform(network: &DeformNetwork) -> Check {
    let size = network.size();
    size.check()
        .map_err(|e| e.to_string())
        .or_else(|e| problem("deform.linear", e, "layers that network F can have"))?;
    for (i, layer) in network.linear.iter().enumerate() {
        linear(&format!("deform.linear.{i}"), layer, size.layer_inputs(i), size.width)?;
    }
    linear("deform.translation", &network.translation, size.width, 3)?;
    linear("deform.rotation", &network.rotation, size.width, 3)
}

fn nonrigid(network: &NonrigidNetwork) -> Check {
    length("nonrigid.linear", network.linear.len(), NONRIGID_LAYERS)?;
    for (i, layer) in network.linear.iter().enumerate() {
        linear(&format!("nonrigid.linear.{i}"), layer, NonrigidNetwork::layer_inputs(i), NONRIGID_WIDTH)?;
    }
    let [translation, rotation, scaling] = NONRIGID_HEADS;
    linear("nonrigid.translation", &network.translation, NONRIGID_WIDTH, translation)?;
    linear("nonrigid.rotation", &network.rotation, NONRIGID_WIDTH, rotation)?;
    linear("nonrigid.scaling", &network.scaling, NONRIGID_WIDTH, scaling)
}

fn linear(name: &str, layer: &Linear, inputs: usize, outputs: usize) -> Check {
    let (weight, bias) = (format!("{name}.weight"), format!("{name}.bias"));
    if (layer.inputs, layer.outputs) != (inputs, outputs) {
        let found = format!("[{}, {}]", layer.outputs, layer.inputs);
        return problem(&weight, found, format!("[{outputs}, {inputs}]"));
    }
    length(&weight, layer.weight.len(), inputs * outputs)?;
    length(&bias, layer.bias.len(), outputs)?;
    finite(&weight, &layer.weight)?;
    finite(&bias, &layer.bias)
}

/// Names that the format gives a meaning, which therefore cannot be further tensors.
fn is_known(name: &str) -> bool {
    const KNOWN: [&str; 12] = [
        "gaussians.mean",
        "gaussians.log_scale",
        "gaussians.rotation",
        "gaussians.opacity_logit",
        "gaussians.sh",
        "superpoints.of_gaussian",
        "superpoints.position",
        "motion.times",
        "motion.rotation",
        "motion.translation",
        "association.neighbor",
        "association.logit",
    ];
    KNOWN.contains(&name) || is_deform(name) || is_nonrigid(name) || is_field(name) || name == "__metadata__"
}

/// `deform.linear.{0..7}.{weight,bias}`, `deform.{translation,rotation}.{weight,bias}`.
fn is_deform(name: &str) -> bool {
    let Some((layer, "weight" | "bias")) = name.strip_prefix("deform.").and_then(|rest| rest.rsplit_once('.')) else {
        return false;
    };
    let hidden = |i: &str| (0..DeformSize::MOST_LAYERS).any(|layer| layer.to_string() == i);
    matches!(layer, "translation" | "rotation") || layer.strip_prefix("linear.").is_some_and(hidden)
}

/// `nonrigid.linear.{0..2}.{weight,bias}`, `nonrigid.{translation,rotation,scaling}.{weight,bias}`.
pub(crate) fn is_nonrigid(name: &str) -> bool {
    let Some((layer, "weight" | "bias")) = name.strip_prefix("nonrigid.").and_then(|rest| rest.rsplit_once('.')) else {
        return false;
    };
    let hidden = |i: &str| (0..NONRIGID_LAYERS).any(|layer| layer.to_string() == i);
    matches!(layer, "translation" | "rotation" | "scaling") || layer.strip_prefix("linear.").is_some_and(hidden)
}

/// The tensors of [`crate::scene::field`].
fn is_field(name: &str) -> bool {
    const PARTS: [&str; 5] = ["field.layer.", "field.head.", "field.time.", "field.plane.", "field.node."];
    name == "field.bounds" || PARTS.iter().any(|part| name.starts_with(part))
}

fn extra(name: &str, tensor: &Tensor) -> Check {
    if is_known(name) {
        return problem(name, "it among the further tensors", "a name that the format does not define");
    }
    match tensor.shape.iter().try_fold(1usize, |product, &side| product.checked_mul(side)) {
        Some(count) if count == tensor.data.len() => Ok(()),
        _ => problem(
            name,
            format!("{} values for shape {:?}", tensor.data.len(), tensor.shape),
            "as many as the shape says",
        ),
    }
}
