//! One moment: superpoints, cameras or both from all photos of one time.

use glam::DVec3;

use super::adam::Adam;
use super::bodies::{Bodies, Stand};
use super::coupling::Coupling;
use super::gauge;
use super::sight::Sight;
use super::{Options, Progress, Solve, Watch};
use crate::error::Result;
use crate::reference::Pose;
use crate::train::photo_loss::{PhotoLoss, Twist};

/// Steps in pixels at the beginning and end of a size: the smallest, those between, full size.
const RATES: [[f64; 2]; 3] = [[0.5, 0.1], [0.3, 0.1], [0.2, 0.004]];
/// Largest turn of a superpoint in one step, radians.
const LARGEST_TURN: f64 = 0.1;

/// What is searched for at a moment, and what it is searched with.
pub(super) struct Solver<'s, 'a> {
    pub(super) loss: &'s mut PhotoLoss<'a>,
    pub(super) bodies: &'s Bodies,
    pub(super) coupling: &'s Coupling,
    pub(super) options: &'s Options,
    /// Where smoothness over time wants the superpoints.
    pub(super) expected: Option<&'s [Stand]>,
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

/// What a photo looks like at full size.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct PhotoFound {
    pub(super) loss: f64,
    pub(super) mse: f64,
}

/// Sizes that are gone through.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Sizes {
    All,
    /// All but full size, where there are others.
    Small,
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
        let coarsest = state.sights.iter().map(|s| s.sizes.len()).min().unwrap_or(1) - 1;
        let range = match sizes {
            Sizes::All => 0..=coarsest,
            Sizes::Small => coarsest.min(1)..=coarsest,
            Sizes::Full => 0..=0,
        };
        let mut adam = Adam::new(6 * state.stands.len());
        for size in range.rev() {
            let iterations = (self.options.iterations * if size == 0 { 2 } else { 1 } / (coarsest as u32 + 2)).max(1);
            let [from, to] = RATES[if size == 0 { 2 } else { usize::from(size != coarsest) }];
            for iteration in 0..iterations {
                let share = f64::from(iteration) / f64::from(iterations.max(2) - 1);
                progress.loss = self.iterate(state, &mut adam, size, from * (to / from).powf(share))?;
                progress.iteration += 1;
                if !watch(progress) {
                    return Ok(false);
                }
            }
            if self.options.solve == Solve::Both {
                gauge::fix(self.bodies, state, self.expected);
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
    fn iterate(&mut self, state: &mut State, adam: &mut Adam, size: usize, rate: f64) -> Result<f64> {
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
            self.move_superpoints(state, adam, size, rate, &mut gradient);
        }
        Ok(loss)
    }

    fn move_superpoints(&self, state: &mut State, adam: &mut Adam, size: usize, rate: f64, gradient: &mut [Twist]) {
        let nearest = |x: DVec3| state.sights.iter().map(|s| s.unit_at(size, x)).fold(f64::INFINITY, f64::min);
        let unit: Vec<f64> = state.stands.iter().map(|s| nearest(s.place)).collect();
        self.coupling.add(&state.stands, &unit, self.options.coupling, gradient);
        self.stay_smooth(&state.stands, &unit, gradient);
        let turn_unit: Vec<f64> = unit.iter().zip(&self.bodies.reach).map(|(u, r)| (u / r).min(LARGEST_TURN)).collect();
        let scaled = gradient.iter().zip(turn_unit.iter().zip(&unit));
        let scaled: Vec<f64> = scaled
            .flat_map(|(g, (t, u))| [(g.rotation * *t).to_array(), (g.translation * *u).to_array()].concat())
            .collect();
        let step = adam.step_vectors(&scaled, rate);
        for (j, stand) in state.stands.iter_mut().enumerate() {
            let [turn, shift] = [0, 3].map(|k| DVec3::from_slice(&step[6 * j + k..6 * j + k + 3]));
            *stand = stand.moved(turn * turn_unit[j], shift * unit[j]);
        }
    }

    /// Adds the gradient of λ Σ (‖x − x̂‖² + ρ²‖log R R̂ᵀ‖²)/u²: what is expected goes on as it went.
    fn stay_smooth(&self, stands: &[Stand], unit: &[f64], gradient: &mut [Twist]) {
        let Some(expected) = self.expected else { return };
        for (j, (stand, expected)) in stands.iter().zip(expected).enumerate() {
            let weight = 2.0 * self.options.smoothness / unit[j].powi(2);
            let turn = stand.turn_from(expected) * self.bodies.reach[j].powi(2) * weight;
            gradient[j] = gradient[j] + Twist { rotation: turn, translation: (stand.place - expected.place) * weight };
        }
    }
}
