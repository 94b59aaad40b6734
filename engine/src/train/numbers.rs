//! The watch over everything that training keeps from step to step: a number that is not finite ends the run before it can
//! spread or reach a checkpoint. (Gradients do not outlive a step; the kernels watch them, see [`super::status`].)

use super::check_finite::check_finite;
use super::deform_project_backward::parameter_planes;
use super::trainer::Trainer;
use crate::error::{Error, Result};
use crate::gpu::{Buffer, Slice};

impl Trainer {
    /// Looks at every parameter, moment and statistic on the device; waits for it.
    ///
    /// # Errors
    /// `NonFinite` naming the buffer, the first bad index in it and the iteration.
    pub fn check_numbers(&self) -> Result<()> {
        check_finite(&self.gpu, &self.kept_numbers()).map_err(|error| match error {
            Error::NonFinite { what, index, value } => {
                Error::NonFinite { what: format!("{what} at iteration {}, first", self.iteration), index, value }
            }
            other => other,
        })
    }

    /// Name, place and length of all floats that the next step depends on.
    fn kept_numbers(&self) -> Vec<(&'static str, Slice, u32)> {
        let (p, s, n) = (&self.parameters, &self.parameters.scene, self.parameters.count());
        let planes = parameter_planes(p.sh_degree);
        let of = |name, buffer: &Buffer, width: u32| (name, Slice::from(buffer), n * width);
        let mut all = vec![
            of("mean", &s.mean, 3),
            of("log_scale", &s.log_scale, 3),
            of("rotation", &s.rotation, 4),
            of("opacity_logit", &s.opacity_logit, 1),
            of("moment_1", &p.moment_1, planes),
            of("moment_2", &p.moment_2, planes),
            of("density", &p.density, 2),
            of("max_radius", &p.max_radius, 1),
        ];
        let bands = (0..=p.sh_degree).zip(&s.sh).zip(["sh_0", "sh_1", "sh_2", "sh_3"]);
        all.extend(bands.map(|((band, buffer), name)| of(name, buffer, 3 * (2 * band + 1))));
        all.extend(self.deformation.iter().flat_map(|m| m.numbers()));
        all
    }
}
