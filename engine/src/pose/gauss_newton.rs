//! The end of a search: Gauss–Newton with derivatives by differences of images.
//!
//! Where photos fit to some 45 dB, the gradient of the kernels no longer leads on. A splat ends where its α falls below 1/255, and two
//! that change their order of depth change the image at once; no derivative holds these jumps, and by now they weigh as much as
//! what is left. Differences over a tenth of a pixel do hold them. (On a trained model of `robot_dance` the loss falls all the way
//! from where Adam stops to where the superpoints belong, while its gradient says that it rises.)
//!
//! Each round makes J, the derivatives of all pixels by the six numbers of each superpoint that is seen ([`jacobian`]), and solves
//!
//! (Jᵀ W J + H + μ D) δ = −(Jᵀ W r + g),  W = 1 / 3√(r² + ε²)
//!
//! for all superpoints together ([`normal`]): r what photos and images differ by, ε its mean, so that W makes a sum of squares one of
//! absolute differences (iteratively reweighted least squares), H and g of coupling and smoothness, μ and D as Marquardt (1963). A
//! step is taken if the loss of the search falls. It ends where nothing is left but the rounding of 8 bits.
//!
//! It does not begin where photos fit worse than [`WORST`]: there the model's own faults are what is left, and a step that fits them to
//! one photo leads astray.

mod jacobian;
mod normal;

use glam::{DMat3, DVec3};

use super::bodies::Stand;
use super::information::{information, scaled};
use super::sight::{Residual, Sight};
use super::solver::{Solver, State};
use super::uncertainty::LEAST_CHANGE;
use super::{Progress, Watch};
use crate::error::Result;
use crate::train::photo_loss::Twist;
pub(super) use normal::Normal;

/// Half of a difference, pixels, where photos and images differ by `USUAL`; it goes with the root of that, between these.
const STEP: f64 = 0.1;
const USUAL: f64 = 0.006;
const STEPS: [f64; 2] = [0.02, 0.3];
/// Root mean square of the values that differ, beyond which there are no rounds: six levels of 8 bits. Searches for photos that the
/// model shows exactly end at two to three levels, real photos of `robot_dance` at a dozen and more (both calculated from PSNR and the
/// share of values that differ). Rounds gained 0.1 to 0.7 dB there, and four of five lost 1.0 to 2.6 dB in a view of the same moment
/// from elsewhere.
pub(super) const WORST: f64 = 6.0 / 255.0;
/// Mean square of the rounding to 8 bits, 1/12 of a level's square, and a tenth more.
const ROUNDING: f64 = 1.1 / (12.0 * 255.0 * 255.0);
/// A shift along the view changes an image less, and goes so many times as far.
const ALONG: f64 = 4.0;
/// μ of the first round, and its factors after a step that is taken and one that is not.
const FIRST_DAMPING: f64 = 1e-3;
const TAKEN: f64 = 0.3;
const REFUSED: f64 = 5.0;
/// Steps that a round tries.
const MOST_TRIES: usize = 6;
/// Largest change of one number, pixels.
const LARGEST_STEP: f64 = 3.0;
/// A round that gains less than this share of the loss is the last.
const LEAST_GAIN: f64 = 0.01;
/// Random images per photo that tell what is seen.
const SEEN_PROBES: u32 = 4;

/// The largest root mean square of what photos and images differ by.
pub(super) fn largest(residuals: &[Residual]) -> f64 {
    residuals.iter().map(Residual::mean_square).fold(0.0, f64::max).sqrt()
}

/// The numbers of superpoints: turns about their centres and shifts, along the axes of the first photo's camera.
pub(super) struct Numbers {
    /// Rows are the axes, world space.
    pub(super) axes: DMat3,
    /// `[M]` of turn, radians, and shift, world units: a pixel.
    pub(super) units: Vec<[f64; 2]>,
}

impl Numbers {
    /// A superpoint with its six numbers changed.
    pub(super) fn moved(&self, j: usize, stand: &Stand, change: [f64; 6]) -> Stand {
        let [turn, shift] = [0, 3].map(|k| self.axes.transpose() * DVec3::from_slice(&change[k..k + 3]));
        stand.moved(turn * self.units[j][0], shift * self.units[j][1])
    }
}

impl Solver<'_, '_> {
    /// Up to `options.rounds` rounds at full size, where photos fit well; false when the watcher wants an end.
    pub(super) fn refine(&mut self, state: &mut State, progress: &mut Progress, watch: &mut Watch<'_>) -> Result<bool> {
        let mut damping = FIRST_DAMPING;
        for round in 0..self.options.rounds {
            let residuals = self.residuals(state)?;
            let left = largest(&residuals);
            if left.powi(2) <= ROUNDING || left > WORST {
                break;
            }
            progress.round = round + 1;
            let numbers = self.numbers(state);
            let step = (STEP * (left / USUAL).sqrt()).clamp(STEPS[0], STEPS[1]);
            let Some(mut normal) = self.photos(state, &residuals, &numbers, step, progress, watch)? else {
                return Ok(false);
            };
            let before =
                self.add_neighbours(&state.stands, &numbers, &mut normal) + self.photo_loss(state, progress)?;
            let mut gain = 0.0;
            for _ in 0..MOST_TRIES {
                let change = normal.solve(damping);
                let moved = |(j, stand): (usize, &Stand)| {
                    numbers.moved(j, stand, change[j].map(|x| x.clamp(-LARGEST_STEP, LARGEST_STEP)))
                };
                let tried = state.stands.iter().enumerate().map(moved).collect();
                let stood = std::mem::replace(&mut state.stands, tried);
                let energy = self.add_neighbours(&state.stands, &numbers, &mut Normal::new(stood.len()));
                let after = energy + self.photo_loss(state, progress)?;
                gain = 1.0 - after / before.max(1e-12);
                if gain > 0.0 {
                    damping *= TAKEN;
                    break;
                }
                state.stands = stood;
                damping *= REFUSED;
            }
            state.poses = self.bodies.poses(&state.stands, &state.poses);
            if gain < LEAST_GAIN {
                break;
            }
        }
        Ok(true)
    }

    fn numbers(&self, state: &State) -> Numbers {
        let axes = state.sights.first().map_or(DMat3::IDENTITY, |sight| sight.camera.rotation);
        Numbers { axes, units: self.units(state, 0) }
    }

    /// The loss of all photos, times pixels.
    fn photo_loss(&mut self, state: &mut State, progress: &mut Progress) -> Result<f64> {
        let found = self.measure(state)?;
        progress.loss = found.iter().map(|f| f.loss).sum();
        let pixels = state.sights.iter().map(|s| f64::from(s.camera.width) * f64::from(s.camera.height));
        Ok(found.iter().zip(pixels).map(|(f, pixels)| f.loss * pixels).sum())
    }

    /// What each photo at full size and its image differ by.
    pub(super) fn residuals(&mut self, state: &State) -> Result<Vec<Residual>> {
        let poses = self.bodies.poses(&state.stands, &state.poses);
        let residual = |sight: &Sight| {
            let image = self.loss.image(&sight.camera_at(0), &poses)?;
            Ok(sight.sizes[0].residual(&image, self.options.background))
        };
        state.sights.iter().map(residual).collect()
    }

    /// Jᵀ W J and −Jᵀ W r of all photos; `None` when the watcher wants an end.
    fn photos(
        &mut self,
        state: &State,
        residuals: &[Residual],
        numbers: &Numbers,
        step: f64,
        progress: &Progress,
        watch: &mut Watch<'_>,
    ) -> Result<Option<Normal>> {
        let poses = self.bodies.poses(&state.stands, &state.poses);
        let (axes, units) = (numbers.axes, &numbers.units);
        let blocks = information(self.loss, &state.stands, &poses, &state.sights, 0, axes, units, SEEN_PROBES)?;
        let is_seen = |j: usize| (0..6).map(|k| blocks[j][k][k]).sum::<f64>() > LEAST_CHANGE.powi(2);
        let steps = [step, step, step, step, step, step * ALONG];
        let mut normal = Normal::new(poses.len());
        for (sight, residual) in state.sights.iter().zip(residuals) {
            let camera = sight.camera_at(0);
            let windows = jacobian::windows(self.scene, &camera, &poses, self.options.near);
            let mut columns = Vec::new();
            for (j, window) in windows.into_iter().enumerate().filter(|(j, _)| is_seen(*j)) {
                let Some(window) = window else { continue };
                let at = |change| self.bodies.pose_of(j, &numbers.moved(j, &state.stands[j], change), &poses[j]);
                columns.extend(jacobian::columns(self.loss, &camera, &poses, j, window, steps, at)?);
                if !watch(progress) {
                    return Ok(None);
                }
            }
            normal.add_photo(&columns, residual, camera.width);
        }
        Ok(Some(normal))
    }

    /// Adds coupling and smoothness; their energy.
    fn add_neighbours(&self, stands: &[Stand], numbers: &Numbers, normal: &mut Normal) -> f64 {
        let unit: Vec<f64> = numbers.units.iter().map(|u| u[1]).collect();
        let mut gradient = vec![Twist::default(); stands.len()];
        let energy = self.strength * self.coupling.add(stands, &unit, self.strength, &mut gradient)
            + self.stay_smooth(stands, &unit, &mut gradient);
        self.coupling.add_hessian(stands, numbers, self.strength, normal);
        if self.expected.is_some() {
            let curvature = 2.0 * self.options.smoothness;
            for (j, [turn, shift]) in numbers.units.iter().enumerate() {
                let by_turn = (self.bodies.reach[j] * turn / shift).powi(2);
                normal.add_diagonal(j, [by_turn, by_turn, by_turn, 1.0, 1.0, 1.0].map(|c| c * curvature));
            }
        }
        for (j, (twist, units)) in gradient.iter().zip(&numbers.units).enumerate() {
            normal.add_gradient(j, scaled(*twist, numbers.axes, units));
        }
        energy
    }
}
