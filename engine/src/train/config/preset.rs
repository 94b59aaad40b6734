//! The paper's settings by data set, and those that measured better.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::data::dataset::DatasetOptions;

use super::{
    AdamConfig, BudgetConfig, Config, DensityConfig, ExportConfig, Form, GaussiansConfig, LearningRates, LogConfig,
    LossConfig, MotionConfig, NonrigidConfig, RefitConfig, RotationForm, Schedule,
};

/// A named set of values.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Preset {
    /// Synthetic scenes with exact cameras and times (paper, appendix: D-NeRF).
    #[default]
    #[serde(alias = "d-nerf")]
    Dnerf,
    /// Hand-held captures (paper, appendix: HyperNeRF).
    Hypernerf,
    /// Specular objects (NeRF-DS); trained as D-NeRF in the code's scripts.
    #[serde(alias = "nerf-ds")]
    Nerfds,
    /// Twelve cameras, twelve times (NVIDIA Dynamic Scene).
    Nvidia,
}

/// Whose values a configuration starts from.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Method {
    /// The paper's, exactly; what a configuration file without this key means.
    #[default]
    Paper,
    /// The paper's but for what measured better: [`Preset::best`].
    Best,
}

/// What a configuration file is read over, where it does not name it itself.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Base {
    /// The kind of data.
    pub preset: Preset,
    /// Whose values for it.
    pub method: Method,
    /// Whether nothing moves: data of one time, or motion switched off.
    pub is_static: bool,
}

impl Base {
    /// Its values.
    pub fn config(self) -> Config {
        match self.method {
            Method::Paper => self.preset.config(),
            Method::Best if self.is_static => self.preset.best_static(),
            Method::Best => self.preset.best(),
        }
    }
}

impl From<Preset> for Base {
    /// The paper's values.
    fn from(preset: Preset) -> Self {
        Self { preset, ..Self::default() }
    }
}

impl Preset {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Dnerf, Self::Hypernerf, Self::Nerfds, Self::Nvidia];

    /// Its name, as in the configuration file.
    pub fn name(self) -> &'static str {
        match self {
            Self::Dnerf => "dnerf",
            Self::Hypernerf => "hypernerf",
            Self::Nerfds => "nerfds",
            Self::Nvidia => "nvidia",
        }
    }

    /// The paper's values but for what measured better; the table in tools/docs/training.md has the runs that chose each.
    /// A trainer's run of a moving scene with them ends where [`refit`](crate::distill::refit()) begins, on its exported model.
    pub fn best(self) -> Config {
        let mut c = Config { method: Method::Best, ..self.config() };
        c.density.unseen_interval = 5000;
        c.refit.iterations = 10_000;
        c.learning_rate.sh_length_exponent = 0.5;
        if self == Self::Dnerf {
            c.schedule.coarse_to_fine = 17_000;
            c.schedule.window_trial = 10_000;
            // What only full photos show has to grow, too.
            (c.density.until, c.density.unseen_interval) = (25_000, 2500);
            c.motion.network_mean = 400;
            c.motion.lost_objects = true;
            c.refit.error = 0.01;
        } else {
            // A capture has a background, whose Gaussians are large, and few first points.
            c.density =
                DensityConfig { max_radius_px: 0.0, max_extent: 0.0, opacity_reset_interval: 6000, ..c.density };
            (c.density.from, c.density.interval, c.density.prune_interval) = (500, 100, 0);
        }
        c
    }

    /// [`Preset::best`] where nothing moves: photos are full from the start, so that growing for longer only adds Gaussians.
    pub fn best_static(self) -> Config {
        let mut c = self.best();
        (c.density.until, c.density.unseen_interval) = (self.config().density.until, 5000);
        c
    }

    /// The paper's values.
    pub fn config(self) -> Config {
        let mut c = Config { preset: self, ..Config::default() };
        match self {
            Self::Dnerf => {}
            Self::Hypernerf => {
                c.density.from = 1000;
                c.density.interval = 1000;
                c.density.opacity_reset_interval = 6000;
                c.nonrigid.density_until = 0;
                c.motion.time_noise = true;
            }
            Self::Nerfds => c.motion.time_noise = true,
            Self::Nvidia => {
                c = Config { preset: self, ..Self::Hypernerf.config() };
                c.density.opacity_reset_interval = 3000;
                c.density.prune_interval = 8000;
            }
        }
        c
    }
}

impl Default for Config {
    /// The paper's values for `dnerf`.
    fn default() -> Self {
        Self {
            preset: Preset::Dnerf,
            method: Method::Paper,
            iterations: 40_000,
            seed: 0,
            deterministic: false,
            background: [0.0; 3],
            near: 0.2,
            schedule: Schedule::default(),
            gaussians: GaussiansConfig::default(),
            motion: MotionConfig::default(),
            nonrigid: NonrigidConfig::default(),
            refit: RefitConfig::default(),
            loss: LossConfig::default(),
            learning_rate: LearningRates::default(),
            adam: AdamConfig::default(),
            density: DensityConfig::default(),
            budget: BudgetConfig::default(),
            data: DatasetOptions::default(),
            log: LogConfig::default(),
            export: ExportConfig::default(),
        }
    }
}

impl Default for Schedule {
    fn default() -> Self {
        Self {
            reference_iterations: 40_000,
            scale: true,
            warm_up: 3000,
            coarse_to_fine: 0,
            time_window: 0,
            window_trial: 0,
            time_window_centre: 0.5,
            sh_degree_interval: 1000,
            time_noise_iterations: 20_000,
        }
    }
}

impl Default for GaussiansConfig {
    fn default() -> Self {
        Self {
            sh_degree: 3,
            random_points: 10_000,
            random_extent: 1.3,
            optional: Vec::new(),
            max_points: 200_000,
            initial_opacity: 0.1,
            antialiased: false,
        }
    }
}

impl Default for MotionConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            superpoints: 300,
            rotation: RotationForm::So3,
            blend: 1,
            neighbors: 5,
            association_slots: 8,
            association_init: Form::Code,
            zero_heads: true,
            network_layers: 8,
            network_width: 256,
            network_mean: 0,
            time_noise: false,
            lost_objects: false,
            time_noise_scale: 0.1,
        }
    }
}

impl Default for NonrigidConfig {
    fn default() -> Self {
        Self { scale: true, iterations: 20_000, density_until: 10_000, rate: 8e-4, rate_final: 1.6e-6 }
    }
}

impl Default for LossConfig {
    fn default() -> Self {
        Self {
            lambda_dssim: 0.2,
            prop_loss: Form::Code,
            lambda_position: 1e-3,
            lambda_rotation: 100.0,
            lambda_translation: 100.0,
            transients: 0.0,
            transients_from: 4000,
            lambda_exposure: 1e-3,
        }
    }
}

impl Default for RefitConfig {
    fn default() -> Self {
        Self { iterations: 0, error: 0.005, most_divided: 30_000 }
    }
}

impl Default for LearningRates {
    fn default() -> Self {
        Self {
            mean: 1.6e-4,
            mean_final: 1.6e-6,
            mean_iterations: 30_000,
            spatial_scale: 5.0,
            log_scale: 1e-3,
            rotation: 1e-3,
            opacity_logit: 0.05,
            sh_0: 2.5e-3,
            sh_rest: 1.25e-4,
            sh_length_exponent: 0.0,
            final_share: 1.0,
            optional: BTreeMap::new(),
            deform: 1e-3,
            deform_final: 1e-5,
            deform_iterations: 40_000,
            exposure: 0.0,
            exposure_final: 1e-3,
            association: 1e-3,
            association_decay: false,
        }
    }
}

impl Default for AdamConfig {
    fn default() -> Self {
        Self { beta_1: 0.9, beta_2: 0.999, epsilon: 1e-15 }
    }
}

impl Default for DensityConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            from: 500,
            until: 15_000,
            interval: 100,
            opacity_reset_interval: 3000,
            prune_interval: 0,
            gradient_threshold: 2e-4,
            absolute_gradient: false,
            clone_extent: 0.01,
            min_opacity: 0.005,
            max_radius_px: 20.0,
            max_extent: 0.1,
            unseen_interval: 0,
            unseen_share: 0.01,
        }
    }
}

impl Default for BudgetConfig {
    fn default() -> Self {
        Self { max_gaussians: 2_000_000, max_bytes: 0, image_bytes: 4 << 30, photo_bytes: 2 << 30 }
    }
}

impl Default for LogConfig {
    fn default() -> Self {
        Self {
            evaluate_interval: 1000,
            evaluate_views: 4,
            interval: 10,
            checkpoint_interval: 1000,
            finite_interval: 100,
        }
    }
}

impl Default for ExportConfig {
    fn default() -> Self {
        Self { motion_error_px: 0.1, keep_network: false, sh_error: 0.5 }
    }
}
