//! `oracle/superpoint_*.npz`: network F, moved Gaussians, property losses and all their gradients, of the f64 reference and
//! of the device, against float64 automatic differentiation.
//!
//! The file's networks' gradients but the heads' are stored in f32, so the reference can agree to [`STORED_F32_ERROR`] only.
//! On the device everything runs in the kernels of training except: moved rotations and the Gaussians' own gradients of
//! motion, which exist only inside the kernel that projects; for `grad_motion_*` the device sums poses' gradients per
//! superpoint and runs network F backward, from the reference's gradients per Gaussian.

mod case;
mod device;
mod reference;
mod results;

use std::collections::BTreeMap;
use std::path::Path;

use engine::Result;
use engine::gpu::Gpu;
use serde::Serialize;

use crate::dev::oracle::case::relative_l2;
use case::{Array, Case};

/// Largest relative error of the device.
pub const GPU_ERROR: f64 = 1e-4;
/// Largest relative error of the f64 reference.
pub const REFERENCE_ERROR: f64 = 1e-9;
/// The same for arrays that the file keeps in f32: rounding alone makes 3e-8.
pub const STORED_F32_ERROR: f64 = 6e-8;
/// A bias' gradient this much smaller than its layer's weights' is a sum over superpoints that cancels (the losses do not see a
/// common motion): what f32 terms leave of it is judged against the layer.
const CANCELLED: f64 = 1e-2;

/// ‖test − truth‖ / ‖truth‖ of one array.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ArrayError {
    /// Of the f64 reference.
    pub reference: f64,
    /// Of the device; absent where no kernel of its own computes it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gpu: Option<f64>,
    /// Whether the file keeps the array in f32.
    pub stored_as_f32: bool,
    /// For a sum that cancels: ‖truth‖ / ‖gradient of its layer's weights‖. The bounds hold for the errors times this.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub share_of_layer: Option<f64>,
}

impl ArrayError {
    fn passes(&self) -> bool {
        let bound = if self.stored_as_f32 { STORED_F32_ERROR } else { REFERENCE_ERROR };
        let share = self.share_of_layer.unwrap_or(1.0);
        self.reference * share <= bound && self.gpu.is_none_or(|e| e * share <= GPU_ERROR)
    }
}

/// What was found for one file: `rel_l2` by array name.
#[derive(Debug, Clone, Default, Serialize)]
pub struct SuperpointCheck {
    /// The file.
    pub file: String,
    /// Poses of network F, moved Gaussians.
    pub outputs: BTreeMap<String, ArrayError>,
    /// Property losses in both forms.
    pub losses: BTreeMap<String, ArrayError>,
    /// Gradients of motion and of the property losses.
    pub gradients: BTreeMap<String, ArrayError>,
}

impl SuperpointCheck {
    /// Whether everything is within its bound.
    pub fn passes(&self) -> bool {
        [&self.outputs, &self.losses, &self.gradients].iter().all(|m| m.values().all(ArrayError::passes))
    }

    /// Some lines for the terminal: per kind the worst array, then every array that is too far.
    pub fn describe(&self) -> String {
        let mut text = format!("{}: relative errors", self.file);
        for (kind, errors) in [("outputs", &self.outputs), ("losses", &self.losses), ("gradients", &self.gradients)] {
            let plain = errors.values().filter(|e| e.share_of_layer.is_none());
            let worst = |of: &dyn Fn(&ArrayError) -> f64| plain.clone().map(of).fold(0.0, f64::max);
            let reference = worst(&|e| if e.stored_as_f32 { 0.0 } else { e.reference });
            let single = worst(&|e| if e.stored_as_f32 { e.reference } else { 0.0 });
            let gpu = worst(&|e| e.gpu.unwrap_or(0.0));
            text += &format!("\n  {kind} ({} arrays): reference {reference:.2e}", errors.len());
            if single > 0.0 {
                text += &format!(" (stored as f32: {single:.2e}, floor {STORED_F32_ERROR:.0e})");
            }
            text += &format!(", gpu {gpu:.2e}");
            for (name, e) in errors {
                if let Some(share) = e.share_of_layer {
                    let gpu = e.gpu.unwrap_or(0.0);
                    text += &format!("\n    {name}: a sum that cancels to {share:.1e} of its layer: ");
                    text += &format!("reference {:.2e}, gpu {gpu:.2e}", e.reference);
                }
            }
            for (name, e) in errors.iter().filter(|(_, e)| !e.passes()) {
                text +=
                    &format!("\n    {name}: reference {:.2e}, gpu {:.2e} (TOO FAR)", e.reference, e.gpu.unwrap_or(0.0));
            }
        }
        text + if self.passes() { "\n  (ok)" } else { "" }
    }
}

/// Checks one file. `gpu` `None`: the f64 reference only.
pub fn check(path: &Path, gpu: Option<&Gpu>) -> Result<SuperpointCheck> {
    let mut case = Case::load(path)?;
    let reference = reference::results(&case);
    let device = gpu.map(|gpu| device::results(gpu, &case)).transpose()?;
    let mut found = SuperpointCheck { file: path.display().to_string(), ..SuperpointCheck::default() };
    for (name, ours) in &reference.outputs {
        let theirs = device.as_ref().and_then(|d| d.outputs.get(name));
        found.outputs.insert((*name).into(), case.error(name, ours, theirs, None)?);
    }
    for (name, ours) in &reference.losses {
        let theirs = device.as_ref().and_then(|d| d.losses.get(name)).map(|l| vec![*l]);
        found.losses.insert(name.clone(), case.error(name, &[*ours], theirs.as_ref(), None)?);
    }
    for (kind, ours) in &reference.gradients {
        let theirs = device.as_ref().and_then(|d| d.gradients.get(kind));
        let mut add = |what: &str, ours: &[f64], theirs: Option<&Vec<f64>>, layer: Option<&str>| -> Result<()> {
            let name = format!("grad_{kind}_{what}");
            let layer = layer.map(|l| format!("grad_{kind}_{l}"));
            let error = case.error(&name, ours, theirs, layer.as_deref())?;
            found.gradients.insert(name, error);
            Ok(())
        };
        let own = [
            ("mean", &ours.mean, theirs.map(|t| &t.mean)),
            ("rotation_wxyz", &ours.rotation, theirs.map(|t| &t.rotation)),
            ("logit", &ours.logit, theirs.map(|t| &t.logit)),
        ];
        for (what, ours, theirs) in own {
            if let Some(ours) = ours {
                add(what, ours, theirs.and_then(Option::as_ref), None)?;
            }
        }
        for (tensor, ours) in &ours.network {
            let theirs = theirs.and_then(|t| t.network.get(tensor));
            add(tensor, ours, theirs, Some(&tensor.replace("bias", "weight")))?;
        }
    }
    Ok(found)
}

impl Case {
    /// Both implementations against array `name`; `layer` is the array a cancelling sum is measured against.
    fn error(&mut self, name: &str, ours: &[f64], gpu: Option<&Vec<f64>>, layer: Option<&str>) -> Result<ArrayError> {
        let Array { values, single } = self.array(name)?;
        let norm = |v: &[f64]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
        let share = match layer {
            Some(layer) if layer != name => {
                Some(norm(&values) / norm(&self.array(layer)?.values).max(f64::MIN_POSITIVE))
            }
            _ => None,
        };
        let error = |test: &[f64]| {
            // Exactly nothing is expected of some: then nothing else will do, but no quotient exists.
            if norm(&values) == 0.0 && test.len() == values.len() {
                return if norm(test) == 0.0 { 0.0 } else { f64::INFINITY };
            }
            relative_l2(&values, test)
        };
        Ok(ArrayError {
            reference: error(ours),
            gpu: gpu.map(|g| error(g)),
            stored_as_f32: single,
            share_of_layer: share.filter(|s| *s < CANCELLED),
        })
    }
}
