//! Superpoints that a search has left in a wrong place are tried where else they may stand.
//!
//! While photos are small, neighbours hold on to each other as they mostly stood in training. Where at this moment they stand otherwise,
//! that leads a superpoint astray, and what it then covers keeps it there. So where a search for superpoints has not ended well, those
//! at which images and photos differ most are tried where they began, and where each neighbour would have taken them since. What lowers
//! the loss stays, and the search goes on from there at full size.
//!
//! Where that does not help and photos nearly fit, the search begins again, at the two largest sizes alone: what neighbours lead astray
//! together, a limb, has no better place that one of them could take by itself.
//!
//! Either counts only if photos then fit well. Where they do not, the model's own faults are what is left, and all stays as it was found.

use glam::DVec3;

use super::adam::Adam;
use super::bodies::Stand;
use super::gauss_newton::{WORST, largest};
use super::project;
use super::solver::{Part, Solver, State};
use super::{Progress, Watch};
use crate::error::Result;
use crate::reference::exp;

/// Root mean square difference where all is found: one level of 8 bits.
const FOUND: f64 = 1.0 / 255.0;
/// A search begins again where differences are at most so many times those of photos that fit well.
const NEARLY: f64 = 2.0;
/// Times that superpoints are tried and the search goes on.
const MOST_ATTEMPTS: usize = 2;
/// Sweeps over the worst superpoints; the last is the first that changes none.
const MOST_SWEEPS: usize = 4;
/// Superpoints of a sweep.
const MOST_TRIED: usize = 16;
/// Share of the loss that a new place must gain, and all of an attempt together. (Wrong places of trained models gained 40 % together;
/// real photos, which none of the models showed well, below 4 %.)
const LEAST_GAIN: f64 = 0.003;
const LEAST_GAIN_OF_ALL: f64 = 0.1;

impl Solver<'_, '_> {
    /// Tries other places where photos do not fit well, and searches on from each attempt; false when the watcher wants an end.
    pub(super) fn try_other_places(
        &mut self,
        state: &mut State,
        end: &Part,
        progress: &mut Progress,
        watch: &mut Watch<'_>,
    ) -> Result<bool> {
        let found = (state.stands.clone(), state.poses.clone());
        for _ in 0..MOST_ATTEMPTS {
            if largest(&self.residuals(state)?) <= WORST {
                return Ok(true);
            }
            match self.reseat(state, progress, watch)? {
                None => return Ok(false),
                Some(false) => break,
                Some(true) => {}
            }
            let mut adam = Adam::new(6 * state.stands.len());
            if !self.search(state, &mut adam, end, progress, watch)? {
                return Ok(false);
            }
        }
        let left = largest(&self.residuals(state)?);
        if left > WORST {
            (state.stands, state.poses) = found;
        }
        if left > WORST && left <= NEARLY * WORST { self.begin_again(state, end, progress, watch) } else { Ok(true) }
    }

    /// Searches once more from the start, without the smallest photos and with neighbours that hold on less; this counts if photos then
    /// fit well. False when the watcher wants an end.
    fn begin_again(
        &mut self,
        state: &mut State,
        end: &Part,
        progress: &mut Progress,
        watch: &mut Watch<'_>,
    ) -> Result<bool> {
        let found = (state.stands.clone(), state.poses.clone());
        (state.stands, state.poses) = (self.bodies.stands(&state.start), state.start.clone());
        let mut adam = Adam::new(6 * state.stands.len());
        for part in end.with_smaller(state.coarsest()) {
            if !self.search(state, &mut adam, &part, progress, watch)? {
                return Ok(false);
            }
        }
        if largest(&self.residuals(state)?) > WORST {
            (state.stands, state.poses) = found;
        }
        Ok(true)
    }

    /// Rounds of Gauss–Newton, and again from other places where they end before all is found; false when the watcher wants an end.
    pub(super) fn refine_all(
        &mut self,
        state: &mut State,
        progress: &mut Progress,
        watch: &mut Watch<'_>,
    ) -> Result<bool> {
        for _ in 0..MOST_ATTEMPTS {
            if !self.refine(state, progress, watch)? {
                return Ok(false);
            }
            let left = largest(&self.residuals(state)?);
            if left <= FOUND || left > WORST {
                return Ok(true);
            }
            match self.reseat(state, progress, watch)? {
                None => return Ok(false),
                Some(false) => return Ok(true),
                Some(true) => {}
            }
        }
        self.refine(state, progress, watch)
    }

    /// Whether other places of superpoints gain enough; otherwise they stay. `None` when the watcher wants an end.
    fn reseat(&mut self, state: &mut State, progress: &mut Progress, watch: &mut Watch<'_>) -> Result<Option<bool>> {
        let began = self.bodies.stands(&state.start);
        let stood = state.stands.clone();
        let first = self.total_loss(state)?;
        let mut loss = first;
        for _ in 0..MOST_SWEEPS {
            let before = loss;
            for j in self.worst(state)? {
                loss = self.best_place(state, j, &began, loss)?;
                progress.loss = loss;
                if !watch(progress) {
                    return Ok(None);
                }
            }
            if loss >= before {
                break;
            }
        }
        let gains = loss < (1.0 - LEAST_GAIN_OF_ALL) * first;
        if !gains {
            state.stands = stood;
        }
        Ok(Some(gains))
    }

    /// Puts a superpoint where the loss is least of where it stands, where it began and where neighbours have gone; the loss there.
    fn best_place(&mut self, state: &mut State, j: usize, began: &[Stand], loss: f64) -> Result<f64> {
        let carried = self.coupling.neighbours(j).map(|k| began[j].carried(&began[k], &state.stands[k]));
        let places: Vec<Stand> = std::iter::once(began[j]).chain(carried).collect();
        let (mut least, mut best) = (loss * (1.0 - LEAST_GAIN), None);
        let stood = state.stands[j];
        for place in places {
            state.stands[j] = place;
            let tried = self.total_loss(state)?;
            if tried < least {
                (least, best) = (tried, Some(place));
            }
        }
        state.stands[j] = best.unwrap_or(stood);
        Ok(if best.is_some() { least } else { loss })
    }

    /// Of all photos at full size.
    fn total_loss(&mut self, state: &mut State) -> Result<f64> {
        Ok(self.measure(state)?.iter().map(|f| f.loss).sum())
    }

    /// Superpoints at whose Gaussians images and photos differ most, the worst first.
    fn worst(&mut self, state: &State) -> Result<Vec<usize>> {
        let differences = self.differences(state)?;
        let mean = |j: usize| differences[j][0] / differences[j][1];
        let mut worst: Vec<usize> = (0..differences.len()).filter(|&j| differences[j][1] > 0.0).collect();
        worst.sort_by(|&a, &b| mean(b).total_cmp(&mean(a)).then(a.cmp(&b)));
        worst.truncate(MOST_TRIED);
        Ok(worst)
    }

    /// `[M]` sums of what images and photos differ by at the pixels of a superpoint's Gaussians, times their opacities, and of these.
    fn differences(&mut self, state: &State) -> Result<Vec<[f64; 2]>> {
        let residuals = self.residuals(state)?;
        let poses = self.bodies.poses(&state.stands, &state.poses);
        let placed: Vec<_> = poses.iter().map(|p| (exp(p.rotation), p.translation)).collect();
        let mut sums = vec![[0.0; 2]; poses.len()];
        let Some(s) = self.scene.deformation.superpoint_deformation() else { return Ok(sums) };
        let g = &self.scene.gaussians;
        for (i, (mean, logit)) in g.mean.iter().zip(&g.opacity_logit).enumerate() {
            let x = DVec3::from_array(mean.map(f64::from));
            let x: DVec3 = s.slots(i).map(|(j, w)| w * (placed[j].0 * x + placed[j].1)).sum();
            let opacity = 1.0 / (1.0 + f64::from(-logit).exp());
            for (sight, residual) in state.sights.iter().zip(&residuals) {
                let camera = sight.camera_at(0);
                let Some(difference) = project(&camera, x).and_then(|at| residual.at(at, camera.width)) else {
                    continue;
                };
                for (j, w) in s.slots(i) {
                    sums[j] = [sums[j][0] + w * opacity * difference, sums[j][1] + w * opacity];
                }
            }
        }
        Ok(sums)
    }
}
