//! Consistency of a scene, the same for files read and for scenes to be written.

use std::path::Path;

use super::model::deformation;
use crate::error::Error;
use crate::scene::parameter::{PARAMETERS, Parameter};
use crate::scene::{Gaussians, Scene, Tensor};

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

/// A scene's own complaint: what it names is the tensor.
impl From<Error> for Problem {
    fn from(error: Error) -> Self {
        match error {
            Error::Usage { what, found, expected } => Self { tensor: what, found, expected },
            other => {
                Self { tensor: "scene".into(), found: other.to_string(), expected: "parts that fit together".into() }
            }
        }
    }
}

type Check = Result<(), Problem>;

fn problem(tensor: &str, found: impl Into<String>, expected: impl Into<String>) -> Check {
    Err(Problem { tensor: tensor.into(), found: found.into(), expected: expected.into() })
}

fn length(tensor: &str, found: usize, expected: usize) -> Check {
    if found == expected { Ok(()) } else { problem(tensor, format!("{found} elements"), expected.to_string()) }
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
    length("gaussians.sh", g.sh.len(), n * g.sh_coefficients() * 3)?;
    g.optional.iter().try_for_each(|(parameter, values)| {
        let Parameter { export, width, .. } = PARAMETERS[parameter];
        length(&format!("gaussians.{export}"), values.len(), n * width as usize)
    })
}

/// Everything but the values of the Gaussians.
pub(crate) fn scene(scene: &Scene) -> Check {
    gaussians(&scene.gaussians)?;
    scene.deformation.check(scene.gaussians.len())?;
    scene.extra.iter().try_for_each(|(name, tensor)| extra(name, tensor))
}

/// Names that the format gives a meaning, which therefore cannot be further tensors.
fn is_known(name: &str) -> bool {
    let parameter = |rest: &str| PARAMETERS.iter().any(|p| p.export == rest);
    name == "__metadata__" || name.strip_prefix("gaussians.").is_some_and(parameter) || deformation::is_known(name)
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
