//! The watch over everything that training keeps from step to step: a number that is not finite ends the run before it can
//! spread or reach a checkpoint. (Gradients do not outlive a step; the kernels watch them, see [`super::status`].)

use super::check_finite::check_finite;
use super::trainer::Trainer;
use crate::error::{Error, Result};
use crate::gpu::{Buffer, Slice};
use crate::scene::parameter::{PARAMETERS, in_degree};

impl Trainer {
    /// Looks at every parameter, moment and statistic on the device; waits for it.
    ///
    /// # Errors
    /// `NonFinite` naming the buffer, the first bad index in it and the iteration; `Usage` while steps are in flight.
    pub fn check_numbers(&self) -> Result<()> {
        self.settled()?;
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
        let of = |name, buffer: &Buffer, width: u32| (name, Slice::from(buffer), n * width);
        let parameters = PARAMETERS.iter().zip(&s.parameter).enumerate().filter(|(i, _)| in_degree(*i, p.sh_degree));
        let mut all: Vec<_> = parameters.map(|(_, (p, buffer))| of(p.name, buffer, p.width)).collect();
        all.extend(s.optional.iter().map(|buffer| of("optional", buffer, s.present.planes())));
        all.extend([
            of("moment_1", &p.moment_1, p.planes()),
            of("moment_2", &p.moment_2, p.planes()),
            of("density", &p.density, 2),
            of("max_radius", &p.max_radius, 1),
        ]);
        all.extend(self.deformation.iter().flat_map(|m| m.numbers()));
        all
    }
}
