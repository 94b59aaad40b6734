//! One moment: superpoints, cameras or both from all photos of one time.

use glam::{DMat3, DVec3};

use super::adam::Adam;
use super::bodies::{Bodies, Stand};
use super::coupling::Coupling;
use super::gauge;
use super::information::{Block, backward, cholesky, forward, information, scaled};
use super::sight::Sight;
use super::{Options, Progress, Solve, Watch};
use crate::error::Result;
use crate::reference::Pose;
use crate::scene::Scene;
use crate::train::photo_loss::{PhotoLoss, Twist};

/// Steps in pixels of a size: at the beginning of the smallest and of the others, at their ends, and at the very end.
const FIRST_RATE: f64 = 0.5;
const NEXT_RATE: f64 = 0.3;
const LAST_RATE: f64 = 0.1;
const FINAL_RATE: f64 = 0.004;
/// Largest turn of a superpoint in one step, radians; largest shift, pixels.
const LARGEST_TURN: f64 = 0.1;
const LARGEST_SHIFT: f64 = 2.0;
/// λ_A in parts of a size, in units of the usual: neighbours hold on to each other firmly while photos are small, and while full
/// ones begin. At the end, where photos differ by less than `WELL` (their loss), what they say counts more, by the square.
const SMALL: &[f64] = &[30.0, 30.0];
const FULL: &[f64] = &[30.0, 10.0, 3.0, 1.0, 0.3, 0.1, 0.03, 0.01, 0.003];
/// Of `FULL`, the first that does not take superpoints from new places.
const LET_GO: usize = 6;
const WELL: f64 = 0.03;
/// Random images per photo for the metric of steps.
const METRIC_PROBES: u32 = 16;
/// What is known least of a superpoint counts as this share of what is known best.
const RIDGE: f64 = 3e-3;
/// Least difference of values that a photo of 8 bits leaves.
pub(super) const LEAST_DIFFERENCE: f64 = 0.5 / 255.0;

/// What is searched for at a moment, and what it is searched with.
pub(super) struct Solver<'s, 'a> {
    pub(super) loss: &'s mut PhotoLoss<'a>,
    pub(super) scene: &'s Scene,
    pub(super) bodies: &'s Bodies,
    pub(super) coupling: &'s Coupling,
    pub(super) options: &'s Options,
    /// Where smoothness over time wants the superpoints.
    pub(super) expected: Option<&'s [Stand]>,
    /// λ_A of the moment.
    pub(super) strength: f64,
}

/// The state of a search.
pub(super) struct State {
    pub(super) stands: Vec<Stand>,
    pub(super) sights: Vec<Sight>,
    /// Where the search began.
    pub(super) start: Vec<Pose>,
    /// Poses whose rotation vectors the next ones continue.
    pub(super) poses: Vec<Pose>,
}

impl State {
    /// The smallest size that all photos have.
    pub(super) fn coarsest(&self) -> usize {
        self.sights.iter().map(|s| s.sizes.len()).min().unwrap_or(1) - 1
    }
}

/// How a superpoint steps: numbers are taken by the root of what is known of them, so that a step goes as far in each direction as
/// the photos can tell.
struct Metric {
    /// L of the block LLᵀ.
    root: Block,
    /// Makes a step of 1 that of a pixel in the direction that is known best.
    scale: f64,
    /// Of turn, radians, and shift, world units: what moves a superpoint's rim by a pixel.
    units: [f64; 2],
}

impl Metric {
    /// Where nothing is known.
    fn plain(units: [f64; 2]) -> Self {
        let root = std::array::from_fn(|i| std::array::from_fn(|j| if i == j { 1.0 } else { 0.0 }));
        Self { root, scale: 1.0, units }
    }
}

/// What a photo looks like at full size.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct PhotoFound {
    pub(super) loss: f64,
    pub(super) mse: f64,
}

/// A part of a search, at one size.
#[derive(Clone, Copy)]
pub(super) struct Part {
    size: usize,
    iterations: u32,
    /// Steps at its beginning and its end, pixels.
    rates: [f64; 2],
    /// λ_A, one after the other, in units of the usual.
    stages: &'static [f64],
}

impl Part {
    /// The same at half the size before it, where there is one.
    pub(super) fn with_smaller(&self, coarsest: usize) -> impl Iterator<Item = Self> + use<> {
        let part = *self;
        (0..=coarsest.min(1)).rev().map(move |size| Self { size, ..part })
    }
}

/// Sizes that are gone through.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Sizes {
    All,
    /// All, with half the iterations.
    Again,
    Full,
}

impl Solver<'_, '_> {
    /// Searches from coarse to fine; false when the watcher wants an end.
    pub(super) fn solve(
        &mut self,
        state: &mut State,
        sizes: Sizes,
        progress: &mut Progress,
        watch: &mut Watch<'_>,
    ) -> Result<bool> {
        let coarsest = state.coarsest();
        let range = match sizes {
            Sizes::All | Sizes::Again => 0..=coarsest,
            Sizes::Full => 0..=0,
        };
        let all = self.options.iterations / if sizes == Sizes::Again { 2 } else { 1 };
        let mut adam = Adam::new(6 * state.stands.len());
        for size in range.rev() {
            let part = Part {
                size,
                iterations: (all * if size == 0 { 2 } else { 1 } / (coarsest as u32 + 2)).max(1),
                rates: [
                    if size == coarsest && size > 0 { FIRST_RATE } else { NEXT_RATE },
                    if size == 0 { FINAL_RATE } else { LAST_RATE },
                ],
                stages: if size == 0 { FULL } else { SMALL },
            };
            if !self.search(state, &mut adam, &part, progress, watch)? {
                return Ok(false);
            }
            if self.options.solve == Solve::Both {
                gauge::fix(self.bodies, state, self.expected);
            }
        }
        if self.options.solve != Solve::Superpoints {
            return Ok(true);
        }
        let iterations = (all * 2 / (coarsest as u32 + 2)).max(1);
        let end = Part { size: 0, iterations, rates: [NEXT_RATE, FINAL_RATE], stages: &FULL[LET_GO..] };
        Ok(self.try_other_places(state, &end, progress, watch)? && self.refine_all(state, progress, watch)?)
    }

    /// Searches at one size; false when the watcher wants an end.
    pub(super) fn search(
        &mut self,
        state: &mut State,
        adam: &mut Adam,
        part: &Part,
        progress: &mut Progress,
        watch: &mut Watch<'_>,
    ) -> Result<bool> {
        let &Part { size, iterations, rates: [from, to], stages } = part;
        let (mut metric, mut stage) = (Vec::new(), None);
        for iteration in 0..iterations {
            let now = iteration as usize * stages.len() / iterations as usize;
            if self.options.solve != Solve::Camera && stage != Some(now) {
                stage = Some(now);
                let least = (progress.loss / state.sights.len() as f64 / WELL).min(1.0).powi(2);
                self.strength = self.options.coupling * stages[now].max(least);
                metric = self.metric(state, size, progress.loss)?;
            }
            let share = f64::from(iteration) / f64::from(iterations.max(2) - 1);
            progress.loss = self.iterate(state, adam, &metric, size, from * (to / from).powf(share))?;
            progress.iteration += 1;
            if !watch(progress) {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// Every photo at full size, where things stand.
    pub(super) fn measure(&mut self, state: &mut State) -> Result<Vec<PhotoFound>> {
        let poses = self.bodies.poses(&state.stands, &state.poses);
        let measured = state.sights.iter_mut().map(|sight| {
            let camera = sight.camera_at(0);
            let e = self.loss.evaluate(&mut sight.sizes[0].photo, &camera, &poses, false)?;
            Ok(PhotoFound { loss: e.loss, mse: e.mse })
        });
        measured.collect()
    }

    /// One step; the loss before it.
    fn iterate(
        &mut self,
        state: &mut State,
        adam: &mut Adam,
        metric: &[Metric],
        size: usize,
        rate: f64,
    ) -> Result<f64> {
        let (by_camera, by_poses) = (self.options.solve != Solve::Superpoints, self.options.solve != Solve::Camera);
        state.poses = self.bodies.poses(&state.stands, &state.poses);
        let mut loss = 0.0;
        let mut gradient = vec![Twist::default(); state.stands.len()];
        for sight in &mut state.sights {
            let camera = sight.camera_at(size);
            let e = self.loss.evaluate(&mut sight.sizes[size].photo, &camera, &state.poses, by_camera)?;
            loss += e.loss;
            let pixels = f64::from(camera.width) * f64::from(camera.height);
            for ((sum, twist), stand) in gradient.iter_mut().zip(&e.poses).zip(&state.stands) {
                let own = twist.about(stand.place);
                *sum = *sum + Twist { rotation: own.rotation * pixels, translation: own.translation * pixels };
            }
            if let Some(by_camera) = &e.camera {
                sight.step(by_camera, pixels, size, rate);
            }
        }
        if by_poses {
            self.move_superpoints(state, adam, metric, rate, &mut gradient);
        }
        Ok(loss)
    }

    fn move_superpoints(
        &self,
        state: &mut State,
        adam: &mut Adam,
        metric: &[Metric],
        rate: f64,
        gradient: &mut [Twist],
    ) {
        let unit: Vec<f64> = metric.iter().map(|m| m.units[1]).collect();
        self.coupling.add(&state.stands, &unit, self.strength, gradient);
        self.stay_smooth(&state.stands, &unit, gradient);
        let rows = gradient.iter().zip(metric);
        let whitened: Vec<f64> =
            rows.flat_map(|(g, m)| forward(&m.root, scaled(*g, DMat3::IDENTITY, &m.units))).collect();
        let step = adam.step_vectors(&whitened, |j| rate * metric[j].scale);
        for ((stand, m), step) in state.stands.iter_mut().zip(metric).zip(step.as_chunks::<6>().0) {
            let step = backward(&m.root, *step);
            let [turn, shift] = [0, 3].map(|k| DVec3::from_slice(&step[k..k + 3]));
            let [turn, shift] = [turn * m.units[0], shift * m.units[1]];
            *stand =
                stand.moved(turn.clamp_length_max(LARGEST_TURN), shift.clamp_length_max(LARGEST_SHIFT * m.units[1]));
        }
    }

    /// In which metric each superpoint steps, from what photos of a size say of it, and its neighbours.
    fn metric(&mut self, state: &State, size: usize, loss: f64) -> Result<Vec<Metric>> {
        let units = self.units(state, size);
        let (axes, probes) = (DMat3::IDENTITY, METRIC_PROBES);
        let poses = self.bodies.poses(&state.stands, &state.poses);
        let mut blocks = information(self.loss, &state.stands, &poses, &state.sights, size, axes, &units, probes)?;
        // |r|/3 curves like r²/(6s) where differences are about s.
        let typical = (loss / state.sights.len().max(1) as f64).max(LEAST_DIFFERENCE);
        blocks.iter_mut().flatten().flatten().for_each(|v| *v /= 3.0 * typical);
        self.coupling.add_curvature(&units, self.strength, &mut blocks);
        let metric = |(block, units): (&Block, &[f64; 2])| {
            let root = cholesky(block, RIDGE)?;
            let largest = (0..6).map(|k| block[k][k]).fold(0.0, f64::max);
            Some(Metric { root, scale: largest.sqrt(), units: *units })
        };
        Ok(blocks.iter().zip(&units).map(|pair| metric(pair).unwrap_or_else(|| Metric::plain(*pair.1))).collect())
    }

    /// Of turn, radians, and shift, world units, of each superpoint: what moves its rim by a pixel of a size.
    pub(super) fn units(&self, state: &State, size: usize) -> Vec<[f64; 2]> {
        let nearest = |x: DVec3| state.sights.iter().map(|s| s.unit_at(size, x)).fold(f64::INFINITY, f64::min);
        let unit = |(stand, reach): (&Stand, &f64)| {
            let shift = nearest(stand.place);
            [(shift / reach).min(LARGEST_TURN), shift]
        };
        state.stands.iter().zip(&self.bodies.reach).map(unit).collect()
    }

    /// λ Σ (‖x − x̂‖² + ρ²‖log R R̂ᵀ‖²)/u², whose gradient is added: what is expected goes on as it went.
    pub(super) fn stay_smooth(&self, stands: &[Stand], unit: &[f64], gradient: &mut [Twist]) -> f64 {
        let Some(expected) = self.expected else { return 0.0 };
        let mut energy = 0.0;
        for (j, (stand, expected)) in stands.iter().zip(expected).enumerate() {
            let weight = 2.0 * self.options.smoothness / unit[j].powi(2);
            let (turn, way) = (stand.turn_from(expected), stand.place - expected.place);
            let stiff = self.bodies.reach[j].powi(2) * weight;
            energy += 0.5 * (stiff * turn.length_squared() + weight * way.length_squared());
            gradient[j] = gradient[j] + Twist { rotation: turn * stiff, translation: way * weight };
        }
        energy
    }
}
