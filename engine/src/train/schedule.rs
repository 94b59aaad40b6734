//! What happens at an iteration: a pure function of the configuration and the iteration number (from 1, as the reference
//! code counts). Resuming needs nothing but that number.

use super::config::{Config, decayed};
use super::step::{RATES, Step, bias_corrections};
use crate::scene::parameter::PARAMETERS;

/// The part of the method that a run is in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Stage {
    /// Nothing moves, ever.
    Static,
    /// Gaussians, superpoints, network F.
    Rigid,
    /// Gaussians and network G; network F and the association are frozen.
    Nonrigid,
    /// Gaussians and the key poses of a table.
    Table,
}

/// The schedule of one stage.
#[derive(Debug, Clone)]
pub struct Schedule {
    config: Config,
    stage: Stage,
    extent: f64,
}

/// Sizes that a step depends on.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counts {
    /// N.
    pub gaussians: u32,
    /// M.
    pub superpoints: u32,
    /// K', slots of the association.
    pub slots: u32,
}

impl Schedule {
    /// Of a scaled configuration ([`Config::scaled`]); `extent`: radius of the cameras, world units.
    pub fn new(config: &Config, stage: Stage, extent: f64) -> Self {
        Self { config: config.clone(), stage, extent }
    }

    /// Its configuration, scaled.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// Radius of the cameras, world units.
    pub fn extent(&self) -> f64 {
        self.extent
    }

    /// The stage.
    pub fn stage(&self) -> Stage {
        self.stage
    }

    /// Number of iterations of the stage; those of the rigid one end where [`refit`](crate::distill::refit()) begins.
    pub fn iterations(&self) -> u64 {
        match self.stage {
            Stage::Nonrigid => self.config.nonrigid.iterations,
            Stage::Rigid => self.config.iterations.saturating_sub(self.config.refit_iterations()),
            Stage::Static | Stage::Table => self.config.iterations,
        }
    }

    /// Whether superpoints move the Gaussians at `iteration`.
    pub fn moves(&self, iteration: u64) -> bool {
        match self.stage {
            Stage::Static => false,
            Stage::Rigid => iteration >= self.config.schedule.warm_up.max(1),
            Stage::Nonrigid | Stage::Table => true,
        }
    }

    /// Whether superpoints, association and network F begin at `iteration`.
    pub fn superpoints_begin(&self, iteration: u64) -> bool {
        self.stage == Stage::Rigid && iteration == self.config.schedule.warm_up.max(1)
    }

    /// SH degree in use at `iteration`: grows by one every `sh_degree_interval`; all of it in the non-rigid stage.
    pub fn sh_degree(&self, iteration: u64) -> u32 {
        let most = self.config.gaussians.sh_degree;
        match (self.stage, self.config.schedule.sh_degree_interval) {
            (Stage::Nonrigid | Stage::Table, _) | (_, 0) => most,
            (_, interval) => most.min((iteration / interval).min(3) as u32),
        }
    }

    /// The iterations from which photos of more times take part, and by which all do; 0 and 0: all from the start.
    pub fn window(&self) -> [u64; 2] {
        let s = &self.config.schedule;
        let opens = self.stage == Stage::Rigid && s.time_window > 0;
        if opens { [s.warm_up, s.time_window] } else { [0; 2] }
    }

    /// Iterations until photos have their full size; 0: from the start.
    pub fn coarse_to_fine(&self) -> u64 {
        if self.stage == Stage::Rigid { self.config.schedule.coarse_to_fine } else { 0 }
    }

    fn density_until(&self) -> u64 {
        let d = &self.config.density;
        if self.stage == Stage::Nonrigid { self.config.nonrigid.density_until } else { d.until }
    }

    fn density_from(&self) -> u64 {
        if self.stage == Stage::Nonrigid { 0 } else { self.config.density.from }
    }

    /// Whether density statistics are kept.
    pub fn density_statistics(&self, iteration: u64) -> bool {
        self.config.density.enabled && iteration <= self.density_until()
    }

    /// [`Step::density_statistics`].
    fn statistics(&self, iteration: u64) -> f32 {
        match (self.density_statistics(iteration), self.config.density.absolute_gradient) {
            (false, _) => 0.0,
            (true, false) => 1.0,
            (true, true) => 2.0,
        }
    }

    /// Whether Gaussians grow after `iteration`.
    pub fn grows(&self, iteration: u64) -> bool {
        let d = &self.config.density;
        d.enabled
            && iteration > self.density_from()
            && iteration < self.density_until()
            && iteration.is_multiple_of(d.interval)
    }

    /// Whether Gaussians are pruned after `iteration`, when they grow or at the interval for pruning alone.
    pub fn prunes(&self, iteration: u64) -> bool {
        let d = &self.config.density;
        match d.prune_interval {
            0 => self.grows(iteration),
            interval => d.enabled && iteration < self.density_until() && iteration.is_multiple_of(interval),
        }
    }

    /// Whether what the photos show least goes after `iteration`; what is left has an interval to make up for it.
    pub fn prunes_unseen(&self, iteration: u64) -> bool {
        let (d, interval) = (&self.config.density, self.config.density.unseen_interval);
        let is_late = iteration >= self.density_until() && iteration.saturating_add(interval) <= self.iterations();
        d.enabled && self.stage != Stage::Nonrigid && interval > 0 && is_late && iteration.is_multiple_of(interval)
    }

    /// Whether size limits apply when pruning: only once opacities were reset.
    pub fn prunes_large(&self, iteration: u64) -> bool {
        let interval = self.config.density.opacity_reset_interval;
        interval > 0 && iteration > interval
    }

    /// Whether photos are looked at for transients after `iteration`.
    pub fn marks_transients(&self, iteration: u64) -> bool {
        let (factor, from) = (self.config.loss.transients, self.config.loss.transients_from);
        let times = if from > 0 && iteration.is_multiple_of(from) { iteration / from } else { 0 };
        factor > 0.0 && times.is_power_of_two()
    }

    /// Whether opacities are reset after `iteration`.
    pub fn resets_opacity(&self, iteration: u64) -> bool {
        let d = &self.config.density;
        let white = self.config.background == [1.0; 3] && self.stage != Stage::Nonrigid && iteration == d.from;
        let regular = d.opacity_reset_interval > 0 && iteration.is_multiple_of(d.opacity_reset_interval);
        d.enabled && iteration < self.density_until() && (regular || white)
    }

    /// Standard deviation of the noise on time at `iteration`, in units of time; `spacing`: between frames.
    pub fn time_noise(&self, iteration: u64, spacing: f64) -> f64 {
        let m = &self.config.motion;
        if !m.time_noise || self.stage != Stage::Rigid {
            return 0.0;
        }
        let fading = 1.0 - iteration as f64 / self.config.schedule.time_noise_iterations.max(1) as f64;
        m.time_noise_scale * spacing * fading.max(0.0)
    }

    /// The factor on the rates of centres and scales.
    pub fn spatial_scale(&self) -> f64 {
        match self.config.learning_rate.spatial_scale {
            0.0 => self.extent,
            given => given,
        }
    }

    /// The step's data for the kernels. `time`: given to the networks, and exact.
    pub fn step(&self, iteration: u64, counts: Counts, time: [f64; 2]) -> Step {
        let (c, r) = (&self.config, &self.config.learning_rate);
        let before = iteration - 1;
        let open = self.window()[1].max(self.coarse_to_fine());
        let deform =
            decayed(r.deform, r.deform_final, before.saturating_sub(open), r.deform_iterations.saturating_sub(open));
        let association =
            if r.association_decay { r.association * deform / r.deform.max(1e-30) } else { r.association };
        let exposure = match self.stage {
            Stage::Static | Stage::Rigid => decayed(r.exposure, r.exposure_final, before, self.iterations()),
            Stage::Nonrigid | Stage::Table => r.exposure_final,
        };
        let nonrigid = decayed(c.nonrigid.rate, c.nonrigid.rate_final, before, c.nonrigid.iterations);
        let bias = |t: u64| bias_corrections(c.adam.beta_1, c.adam.beta_2, t);
        // Network F and the association take their first step at the end of warm-up.
        let motion = bias((iteration + 1).saturating_sub(c.schedule.warm_up.max(1)).max(1));
        let all = bias(iteration);
        Step {
            gaussians: counts.gaussians,
            superpoints: counts.superpoints,
            neighbors: counts.slots,
            iteration: iteration as u32,
            rate: self.rates(before),
            rate_network_f: deform as f32,
            rate_association: association as f32,
            rate_network_g: nonrigid as f32,
            rate_exposure: exposure as f32,
            weight_dssim: c.loss.lambda_dssim,
            weight_position: c.loss.lambda_position,
            weight_rotation: c.loss.lambda_rotation,
            weight_translation: c.loss.lambda_translation,
            time: time[0] as f32,
            exact_time: time[1] as f32,
            density_statistics: self.statistics(iteration),
            beta_1: c.adam.beta_1 as f32,
            beta_2: c.adam.beta_2 as f32,
            epsilon: c.adam.epsilon as f32,
            bias_gaussians: all,
            bias_network_f: motion,
            bias_association: motion,
            bias_network_g: all,
            ..Step::default()
        }
    }

    /// Learning rates of the Gaussians' parameters.
    fn rates(&self, before: u64) -> [f32; RATES] {
        let mut rates = [0.0; RATES];
        for (rate, parameter) in rates.iter_mut().zip(&PARAMETERS) {
            let [first, last] = self.config.learning_rate.of(parameter.learning_rate).unwrap_or_default();
            let scale = if parameter.spatial { self.spatial_scale() } else { 1.0 };
            *rate = decayed(first * scale, last * scale, before, self.mean_iterations()) as f32;
        }
        rates
    }

    fn mean_iterations(&self) -> u64 {
        match self.stage {
            Stage::Nonrigid => self.config.nonrigid.iterations,
            _ => self.config.learning_rate.mean_iterations,
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use super::*;
    use crate::scene::parameter::{LOG_SCALE, MEAN};

    fn schedule(stage: Stage) -> Schedule {
        Schedule::new(&Config::default(), stage, 4.0)
    }

    #[test]
    fn the_paper_s_schedule() {
        let s = schedule(Stage::Rigid);
        assert!(!s.moves(2999) && s.moves(3000) && s.superpoints_begin(3000) && !s.superpoints_begin(3001));
        assert_eq!([999, 1000, 2999, 3000, 40_000].map(|i| s.sh_degree(i)), [0, 1, 2, 3, 3]);
        let grown: Vec<u64> = (1..40_000).filter(|&i| s.grows(i)).collect();
        assert_eq!((grown[0], *grown.last().unwrap(), grown.len()), (600, 14_900, 144));
        assert_eq!((1..40_000).filter(|&i| s.resets_opacity(i)).collect::<Vec<_>>(), [3000, 6000, 9000, 12_000]);
        assert!(!s.prunes_large(3000) && s.prunes_large(3100));
        assert!((1..=40_000).all(|i| !s.prunes_unseen(i)));
    }

    #[test]
    fn the_rigid_stage_ends_where_the_refit_begins() {
        let mut config = Config::default();
        config.refit.iterations = 10_000;
        let iterations = |config: &Config, stage| Schedule::new(config, stage, 4.0).iterations();
        let all = |config: &Config| [Stage::Rigid, Stage::Static, Stage::Table].map(|stage| iterations(config, stage));
        assert_eq!(all(&config), [30_000, 40_000, 40_000]);
        assert_eq!(iterations(&config, Stage::Nonrigid), 20_000);
        let short = Config { iterations: 6000, ..config.clone() }.scaled();
        assert_eq!((short.refit_iterations(), all(&short)), (1500, [4500, 6000, 6000]));
        // At least one iteration is network F's.
        let shortest = Config { iterations: 1, ..config.clone() }.scaled();
        assert_eq!((shortest.refit_iterations(), iterations(&shortest, Stage::Rigid)), (0, 1));
        config.export.keep_network = true;
        assert_eq!((config.refit_iterations(), iterations(&config, Stage::Rigid)), (0, 40_000));
        config.refit.iterations = 40_000;
        let error = config.check().unwrap_err().to_string();
        assert!(error.contains("refit.iterations") && error.contains("40000"), "{error}");
    }

    #[test]
    fn what_is_hardly_seen_goes_after_growth_and_with_time_to_make_up_for_it() {
        let unseen = |stage, interval| {
            let mut config = Config::default();
            config.density.unseen_interval = interval;
            let s = Schedule::new(&config, stage, 4.0);
            (1..=40_000).filter(|&i| s.prunes_unseen(i)).collect::<Vec<_>>()
        };
        for stage in [Stage::Static, Stage::Rigid] {
            assert_eq!(unseen(stage, 5000), [15_000, 20_000, 25_000, 30_000, 35_000]);
        }
        assert_eq!([unseen(Stage::Nonrigid, 5000), unseen(Stage::Rigid, u64::MAX)], [[0; 0]; 2]);
    }

    #[test]
    fn rates_begin_and_end_as_the_table_says() {
        let s = schedule(Stage::Rigid);
        let at = |i: u64| s.step(i, Counts::default(), [0.0; 2]);
        let near = |a: f32, b: f64| assert!((f64::from(a) / b - 1.0).abs() < 1e-3, "{a} {b}");
        near(at(1).rate[MEAN], 8e-4);
        near(at(30_001).rate[MEAN], 8e-6);
        near(at(1).rate[LOG_SCALE], 5e-3);
        near(at(1).rate_network_f, 1e-3);
        near(at(40_001).rate_network_f, 1e-5);
        near(at(1).bias_gaussians[0], 10.0);
        near(at(3000).bias_network_f[0], 10.0);
    }

    #[test]
    fn network_f_s_rate_falls_once_all_times_take_part() {
        let mut config = Config { iterations: 4000, ..Config::default() };
        config.schedule.time_window = 20_000;
        let config = config.scaled();
        let s = Schedule::new(&config, Stage::Rigid, 4.0);
        let rate = |i: u64| f64::from(s.step(i, Counts::default(), [0.0; 2]).rate_network_f);
        assert_eq!([s.window(), Schedule::new(&config, Stage::Static, 4.0).window()], [[300, 2000], [0, 0]]);
        let wanted = [(1, 1e-3), (2001, 1e-3), (3001, 1e-4), (4001, 1e-5)];
        assert!(wanted.iter().all(|&(i, r)| (rate(i) / r - 1.0).abs() < 1e-3), "{:?}", wanted.map(|(i, _)| rate(i)));
    }

    #[test]
    fn every_parameter_has_a_rate() {
        let rates = &Config::default().learning_rate;
        let without = PARAMETERS.iter().find(|p| rates.of(p.learning_rate).is_none());
        assert_eq!(without, None);
    }

    #[test]
    fn time_noise_fades() {
        let mut config = Config::default();
        config.motion.time_noise = true;
        let s = Schedule::new(&config, Stage::Rigid, 1.0);
        assert!((s.time_noise(10_000, 0.01) - 5e-4).abs() < 1e-12);
        assert_eq!(s.time_noise(20_000, 0.01), 0.0);
        assert_eq!(schedule(Stage::Rigid).time_noise(1, 0.01), 0.0);
    }
}
