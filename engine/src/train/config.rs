//! Every hyper-parameter of training, with unit, default and source; read from TOML, written beside the model.
//!
//! Where the paper ("paper") and its released code ("code", SP_GS fa1c609) disagree there is a named switch with one default
//! and the reason for it. Iterations are given for a run of [`Schedule::reference_iterations`]; a run of another length
//! scales them in proportion (see [`Config::scaled`]).

mod density;
mod motion;
mod preset;
mod run;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::data::dataset::DatasetOptions;
use crate::error::{Error, Result};
use crate::scene::Blend;
use crate::scene::parameter::{PARAMETERS, Present, REQUIRED};
pub use density::DensityConfig;
pub use motion::{MotionConfig, RotationForm};
pub use preset::{Base, Method, Preset};
pub use run::{BudgetConfig, ExportConfig, LogConfig};

/// Which form of a formula is used where paper and code disagree.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Form {
    /// As the paper's equations say.
    Paper,
    /// As the released code does.
    Code,
}

/// All of it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// The preset that these values started from.
    pub preset: Preset,
    /// Whose values for it: the paper's, or what measured better.
    pub method: Method,
    /// Length of the run, in iterations of one image each.
    pub iterations: u64,
    /// Seed of every random choice (image order, first points, time noise, split positions, network weights).
    pub seed: u64,
    /// Bit-identical results from run to run: fixed reduction orders instead of float atomics.
    pub deterministic: bool,
    /// Colour behind the scene; images with alpha are composited on it. The released code uses black everywhere.
    pub background: [f32; 3],
    /// Gaussians nearer than this to the camera plane are not drawn, world units (the reference rasteriser's 0.2).
    pub near: f32,
    /// When things happen.
    pub schedule: Schedule,
    /// The Gaussians' model.
    pub gaussians: GaussiansConfig,
    /// Superpoints, network F and the association.
    pub motion: MotionConfig,
    /// The non-rigid stage.
    pub nonrigid: NonrigidConfig,
    /// The end of a run, without network F.
    pub refit: RefitConfig,
    /// Weights of the losses.
    pub loss: LossConfig,
    /// Step sizes.
    pub learning_rate: LearningRates,
    /// Adam's constants.
    pub adam: AdamConfig,
    /// Adaptive density control.
    pub density: DensityConfig,
    /// Hard limits.
    pub budget: BudgetConfig,
    /// How the data set is read.
    pub data: DatasetOptions,
    /// What is measured and written during the run.
    pub log: LogConfig,
    /// What the exported model keeps.
    pub export: ExportConfig,
}

/// When things happen; iterations.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Schedule {
    /// The length of run that the other iterations are meant for (paper: 40 k).
    pub reference_iterations: u64,
    /// Whether a run of another length scales them in proportion; off: they are taken as they stand.
    pub scale: bool,
    /// Iterations without motion; then superpoints are initialised (paper and code: 3 k).
    pub warm_up: u64,
    /// Photos begin at 24 to 47 pixels on their shorter side, or where 64 pixels are opaque on average, and double until they are full
    /// after this many iterations; 0: they always are (paper and code).
    pub coarse_to_fine: u64,
    /// Photos are drawn from a window of times that opens as far as motion is followed, and is open after this many iterations
    /// at the latest; 0: from all at once (paper and code). For objects that move by more than their size between most
    /// photos. The rate of network F begins to fall after as many: what comes last is learnt as fast as what came first.
    pub time_window: u64,
    /// After so many iterations a beginning with such a window is tried ([`try_window`](super::window_trial::try_window)); until
    /// then one photo of eight is kept aside, to choose by. 0: never, and none.
    pub window_trial: u64,
    /// Where that window begins, as a share of the time range.
    pub time_window_centre: f64,
    /// The SH degree grows by one every so often (code: 1000); 0: all of it from the start.
    pub sh_degree_interval: u64,
    /// The noise on time fades to nothing over this many iterations (code: 20 k).
    pub time_noise_iterations: u64,
}

/// The Gaussians' model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GaussiansConfig {
    /// Largest SH degree, 0–3.
    pub sh_degree: u32,
    /// First points where the data has none: uniform in a cube. Paper: 10 k (appendix); code: 100 k. Default 10 k, as the
    /// paper: density control fills in what is missing, and far fewer are pruned again.
    pub random_points: u32,
    /// Half the edge of that cube, world units (code: 1.3).
    pub random_extent: f32,
    /// Optional parameters that are trained, by name; none by default.
    pub optional: Vec<String>,
    /// At most this many of the data's points are used (evenly thinned).
    pub max_points: u32,
    /// Opacity of the first Gaussians (3DGS: 0.1).
    pub initial_opacity: f32,
    /// Whether splats keep the weight of Gaussians smaller than a pixel ([`Gaussians::antialiased`](crate::scene::Gaussians)):
    /// for a model that is shown at other sizes than its photos'. Training then measures each Gaussian's
    /// [smoothing](crate::scene::parameter::SMOOTHING) too, each epoch: √0.2 px of the photo that shows it largest, at that photo's
    /// time (Mip-Splatting, Yu et al. 2024). Paper and code: no.
    pub antialiased: bool,
}

/// The non-rigid stage (network G).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct NonrigidConfig {
    /// Whether G changes scales too. Paper: translation and rotation only; code: scale as well, the default: it made the
    /// published numbers. Off: the scaling head is zero and stays so.
    pub scale: bool,
    /// Iterations of the stage (paper: 20 k).
    pub iterations: u64,
    /// Density control goes on until this iteration of the stage (code: 10 k for D-NeRF and NeRF-DS, none for HyperNeRF).
    pub density_until: u64,
    /// Learning rate of G at the start (code: 8e-4).
    pub rate: f64,
    /// Learning rate of G at the end (code: 1.6e-6).
    pub rate_final: f64,
}

/// The end of a run: motion made of few rigid parts, whose key poses are trained in place of network F
/// ([`refit`](crate::distill::refit())). Not in paper or code.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RefitConfig {
    /// The last iterations of a run that moves are these; 0: network F is trained to the end (paper and code).
    pub iterations: u64,
    /// How far the parts may be from where network F has the Gaussians, as a share of the photos' shorter side.
    pub error: f64,
    /// With more Gaussians superpoints stay as they are: parts take long to find (39 s for 15,610 on two busy cores).
    pub most_divided: u32,
}

/// Weights of the losses.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LossConfig {
    /// λ: image loss = (1−λ) L1 + λ (1−SSIM) (paper: 0.2).
    pub lambda_dssim: f32,
    /// Form of the property reconstruction loss. Paper: v' = round trip Gaussian → superpoint → Gaussian; code: v' = Σ a·(output
    /// of network F). Default code: it made the published numbers and needs no second pass over the Gaussians.
    pub prop_loss: Form,
    /// λ of the position property (paper and code: 1e-3).
    pub lambda_position: f32,
    /// λ of the rotation property. Paper: 1; code: 100. Default 100, the weight that belongs to the default form.
    pub lambda_rotation: f32,
    /// λ of the translation property. Paper: 1; code: 100. Default 100.
    pub lambda_translation: f32,
    /// Pixels of a photo whose error is more than this many times what its Gaussians leave in all photos take no part
    /// ([`transients`](super::transients)); 0: all do (paper and code).
    pub transients: f32,
    /// Photos are looked at for such pixels after so many iterations, after twice as many, four times as many, and so on.
    pub transients_from: u64,
    /// λ that holds a photo's exposure to none ([`exposure`](super::exposure)).
    pub lambda_exposure: f32,
}

/// Step sizes. Log-linear from the first to the `_final` value.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LearningRates {
    /// Centres at the start, before `spatial_scale` (3DGS: 1.6e-4).
    pub mean: f64,
    /// Centres at the end (3DGS: 1.6e-6).
    pub mean_final: f64,
    /// Iterations over which it decays (code: 30 k).
    pub mean_iterations: u64,
    /// Factor on the centres' and scales' rates. 0: the extent of the data set's cameras, as 3DGS; code: 5 for every scene,
    /// the default.
    pub spatial_scale: f64,
    /// Log scales, before `spatial_scale` (code: 1e-3; times 5 this is 3DGS's 5e-3).
    pub log_scale: f64,
    /// Quaternions (1e-3).
    pub rotation: f64,
    /// Opacity logits (0.05).
    pub opacity_logit: f64,
    /// SH degree 0 (2.5e-3).
    pub sh_0: f64,
    /// SH degrees 1–3 (2.5e-3 / 20).
    pub sh_rest: f64,
    /// A run shorter than `schedule.reference_iterations` has its SH rates multiplied by (reference / iterations)^this: with
    /// Adam they are what a colour moves by in a step, and it has as far to go. 0: they stay (paper and code).
    pub sh_length_exponent: f64,
    /// What is left of the rates of scales, quaternions, opacities and SH when the centres' has fallen (3DGS: 1, they stay).
    pub final_share: f64,
    /// Those of optional parameters, by name; the table of parameters has one for each that is not here.
    pub optional: BTreeMap<String, f64>,
    /// Network F at the start (1e-3).
    pub deform: f64,
    /// Network F at the end. Paper: 1e-5; code: 1.6e-6. Default 1e-5, as the paper: the code's value is that of the centres,
    /// passed by accident, and stops F early.
    pub deform_final: f64,
    /// Iterations over which F's rate decays (40 k).
    pub deform_iterations: u64,
    /// A photo's exposure: an affine map of colours that belongs to the photo, not the scene (3DGS, `train_test_exp`: 0.01, to 0.001).
    /// 0: photos are taken as they are.
    pub exposure: f64,
    /// The same at the end.
    pub exposure_final: f64,
    /// Association values (code: 1e-3).
    pub association: f64,
    /// Whether the association's rate decays as F's. Paper: silent; code: means to, but never does. Default no, as the code.
    pub association_decay: bool,
}

impl LearningRates {
    /// First and last rate of a key of the table of parameters; `None` for a key that is none of theirs.
    pub fn of(&self, key: &str) -> Option<[f64; 2]> {
        let falling = |rate: f64| [rate, rate * self.final_share];
        Some(match key {
            "mean" => [self.mean, self.mean_final],
            "log_scale" => falling(self.log_scale),
            "rotation" => falling(self.rotation),
            "opacity_logit" => falling(self.opacity_logit),
            "sh_0" => falling(self.sh_0),
            "sh_rest" => falling(self.sh_rest),
            optional => {
                let of_table = PARAMETERS[REQUIRED..].iter().find(|p| p.learning_rate == optional)?.rate;
                falling(self.optional.get(optional).copied().unwrap_or(of_table))
            }
        })
    }
}

/// Adam's constants.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AdamConfig {
    /// Decay of the first moment.
    pub beta_1: f64,
    /// Decay of the second moment.
    pub beta_2: f64,
    /// Added to the denominator (3DGS: 1e-15).
    pub epsilon: f64,
}

impl Config {
    /// Reads a TOML file over a preset: the file's own `preset` and `method` if it names them, else those of `fallback`.
    ///
    /// # Errors
    /// [`Error::Corrupt`] naming the file, the line and the key; [`Error::Usage`] for a value out of range; [`Error::Io`].
    pub fn read(path: &Path, fallback: impl Into<Base>) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(|e| Error::io(path, "read", e))?;
        Self::parse(&text, fallback, path)
    }

    /// [`Config::read`] from a text; `path` is for messages.
    ///
    /// # Errors
    /// As [`Config::read`].
    pub fn parse(text: &str, fallback: impl Into<Base>, path: &Path) -> Result<Self> {
        let corrupt = |e: &toml::de::Error| {
            let at =
                e.span().map_or("the file".into(), |s| format!("line {}", text[..s.start].matches('\n').count() + 1));
            let message = e.message().lines().collect::<Vec<_>>().join(" ");
            Error::corrupt(path, at, message, "a training configuration (`spgs train --print-config`)")
        };
        let own: toml::Table = text.parse().map_err(|e| corrupt(&e))?;
        let mut base = fallback.into();
        if let Some(name) = own.get("preset") {
            // A kind of data by its name alone means the paper's values for it.
            let preset = name.clone().try_into::<Preset>().map_err(|e| corrupt(&e))?;
            base = Base { is_static: base.is_static, ..Base::from(preset) };
        }
        if let Some(name) = own.get("method") {
            base.method = name.clone().try_into().map_err(|e| corrupt(&e))?;
        }
        // Parsed once alone, for the places of mistakes; then over the preset.
        base.is_static |= !toml::from_str::<Self>(text).map_err(|e| corrupt(&e))?.motion.enabled;
        let mut merged =
            toml::Table::try_from(base.config()).map_err(|e| Error::usage("preset", e.to_string(), "TOML"))?;
        merge(&mut merged, own);
        let config: Self = merged.try_into().map_err(|e: toml::de::Error| corrupt(&e))?;
        config.check()?;
        Ok(config)
    }

    /// The whole configuration as TOML.
    ///
    /// # Errors
    /// [`Error::Usage`] when a value has no TOML form.
    pub fn to_toml(&self) -> Result<String> {
        toml::to_string_pretty(self)
            .map_err(|e| Error::usage("configuration", e.to_string(), "values that TOML can hold"))
    }

    /// Whether every value makes sense.
    ///
    /// # Errors
    /// [`Error::Usage`] naming the key, what was found and what is allowed.
    pub fn check(&self) -> Result<()> {
        let wrong = |key: &str, found: String, expected: &str| Err(Error::usage(key, found, expected));
        if self.gaussians.sh_degree > 3 {
            return wrong("gaussians.sh_degree", self.gaussians.sh_degree.to_string(), "0 to 3");
        }
        if !(1..=65_536).contains(&self.motion.superpoints) {
            return wrong("motion.superpoints", self.motion.superpoints.to_string(), "1 to 65536");
        }
        if !(1..=7).contains(&self.motion.neighbors) {
            return wrong("motion.neighbors", self.motion.neighbors.to_string(), "1 to 7");
        }
        if !(1..=Blend::MOST_NEIGHBORS as u32).contains(&self.motion.blend) {
            return wrong("motion.blend", self.motion.blend.to_string(), "1 to 4");
        }
        if self.motion.is_soft() && self.loss.prop_loss == Form::Paper {
            return wrong("loss.prop_loss", "paper".into(), "code, as motion.blend is more than 1");
        }
        if !(self.motion.neighbors..=16).contains(&self.motion.association_slots) {
            let found = self.motion.association_slots.to_string();
            return wrong("motion.association_slots", found, "motion.neighbors to 16");
        }
        Present::of_names(&self.gaussians.optional)?;
        let rates: Vec<String> = self.learning_rate.optional.keys().cloned().collect();
        Present::of_names(&rates)?;
        self.motion.network_size().check()?;
        if self.iterations == 0 || self.schedule.reference_iterations == 0 || self.density.interval == 0 {
            return wrong("iterations", "0".into(), "at least 1 (also reference_iterations and density.interval)");
        }
        // Neither is scaled, or both are.
        let length = if self.schedule.scale { self.schedule.reference_iterations } else { self.iterations };
        if self.refit.iterations >= length {
            let found = self.refit.iterations.to_string();
            return wrong("refit.iterations", found, &format!("less than the {length} of the run"));
        }
        if self.budget.max_gaussians == 0 {
            return wrong("budget.max_gaussians", "0".into(), "at least 1");
        }
        for (key, value, low, high) in [
            ("loss.lambda_dssim", f64::from(self.loss.lambda_dssim), 0.0, 1.0),
            ("loss.transients", f64::from(self.loss.transients), 0.0, 1e6),
            ("loss.lambda_position", f64::from(self.loss.lambda_position), 0.0, 1e6),
            ("loss.lambda_rotation", f64::from(self.loss.lambda_rotation), 0.0, 1e6),
            ("loss.lambda_translation", f64::from(self.loss.lambda_translation), 0.0, 1e6),
            ("schedule.time_window_centre", self.schedule.time_window_centre, 0.0, 1.0),
            ("refit.error", self.refit.error, 1e-6, 1.0),
            ("density.max_extent", f64::from(self.density.max_extent), 0.0, 1e12),
            ("density.max_radius_px", f64::from(self.density.max_radius_px), 0.0, 1e9),
            ("density.unseen_share", self.density.unseen_share, 0.0, 0.5),
            ("near", f64::from(self.near), 0.0, 1e6),
            ("gaussians.initial_opacity", f64::from(self.gaussians.initial_opacity), 1e-6, 0.999_999),
            ("gaussians.random_extent", f64::from(self.gaussians.random_extent), 1e-6, 1e9),
            ("adam.beta_1", self.adam.beta_1, 0.0, 0.999_999_9),
            ("adam.beta_2", self.adam.beta_2, 0.0, 0.999_999_9),
            ("adam.epsilon", self.adam.epsilon, 1e-30, 1.0),
            ("learning_rate.mean", self.learning_rate.mean, 0.0, 1.0),
            ("learning_rate.mean_final", self.learning_rate.mean_final, 0.0, 1.0),
            ("learning_rate.spatial_scale", self.learning_rate.spatial_scale, 0.0, 1e6),
            ("learning_rate.log_scale", self.learning_rate.log_scale, 0.0, 1.0),
            ("learning_rate.rotation", self.learning_rate.rotation, 0.0, 1.0),
            ("learning_rate.opacity_logit", self.learning_rate.opacity_logit, 0.0, 10.0),
            ("learning_rate.sh_0", self.learning_rate.sh_0, 0.0, 1.0),
            ("learning_rate.sh_rest", self.learning_rate.sh_rest, 0.0, 1.0),
            ("learning_rate.sh_length_exponent", self.learning_rate.sh_length_exponent, 0.0, 1.0),
            ("learning_rate.final_share", self.learning_rate.final_share, 1e-6, 1.0),
            ("learning_rate.deform", self.learning_rate.deform, 0.0, 1.0),
            ("learning_rate.deform_final", self.learning_rate.deform_final, 0.0, 1.0),
            ("loss.lambda_exposure", f64::from(self.loss.lambda_exposure), 0.0, 1e6),
            ("learning_rate.exposure", self.learning_rate.exposure, 0.0, 1.0),
            ("learning_rate.exposure_final", self.learning_rate.exposure_final, 0.0, 1.0),
            ("learning_rate.association", self.learning_rate.association, 0.0, 1.0),
            ("motion.time_noise_scale", self.motion.time_noise_scale, 0.0, 1e3),
            ("export.motion_error_px", self.export.motion_error_px, 1e-6, 1e6),
            ("export.sh_error", self.export.sh_error, 0.0, 255.0),
        ] {
            if !(low..=high).contains(&value) {
                return wrong(key, value.to_string(), &format!("{low} to {high}"));
            }
        }
        if let Some(c) = self.background.iter().find(|c| !(0.0..=1.0).contains(*c)) {
            return wrong("background", c.to_string(), "three numbers from 0 to 1");
        }
        Ok(())
    }

    /// Iterations without network F at the end of a run that moves; none where the model is to keep network F.
    pub fn refit_iterations(&self) -> u64 {
        if self.export.keep_network { 0 } else { self.refit.iterations.min(self.iterations.saturating_sub(1)) }
    }

    /// The configuration with its schedule in iterations of this run: every one that is given for
    /// `schedule.reference_iterations` times `iterations / reference_iterations`, and with its rates of SH
    /// ([`LearningRates::sh_length_exponent`]). Intervals of density control, logs and checkpoints stay.
    pub fn scaled(&self) -> Self {
        let mut c = self.clone();
        if self.schedule.scale && self.iterations != self.schedule.reference_iterations {
            let ratio = self.iterations as f64 / self.schedule.reference_iterations as f64;
            let scale = |v: &mut u64| {
                if *v > 0 {
                    *v = ((*v as f64 * ratio).round() as u64).max(1);
                }
            };
            [
                &mut c.schedule.warm_up,
                &mut c.schedule.coarse_to_fine,
                &mut c.schedule.time_window,
                &mut c.schedule.window_trial,
                &mut c.schedule.sh_degree_interval,
                &mut c.schedule.time_noise_iterations,
                &mut c.loss.transients_from,
                &mut c.motion.network_mean,
                &mut c.refit.iterations,
                &mut c.density.from,
                &mut c.density.until,
                &mut c.density.opacity_reset_interval,
                &mut c.density.prune_interval,
                &mut c.density.unseen_interval,
                &mut c.learning_rate.mean_iterations,
                &mut c.learning_rate.deform_iterations,
            ]
            .into_iter()
            .for_each(scale);
            let faster = ratio.min(1.0).powf(-self.learning_rate.sh_length_exponent);
            c.learning_rate.sh_0 *= faster;
            c.learning_rate.sh_rest *= faster;
            c.schedule.reference_iterations = self.iterations;
        }
        c
    }

    /// The configuration of network G's stage after this run. It has `iterations`; if `None`, and the schedule scales, as many for those
    /// of this run as `nonrigid.iterations` are for `schedule.reference_iterations`. Growth ends at the same share of the stage.
    pub fn for_nonrigid(&self, iterations: Option<u64>) -> Self {
        let mut c = self.clone();
        let given = self.nonrigid.iterations;
        let scaled = |all: u64, of: u64| ((given as f64 * all as f64 / of.max(1) as f64).round() as u64).max(1);
        c.nonrigid.iterations = match iterations {
            Some(iterations) => iterations,
            None if self.schedule.scale => scaled(self.iterations, self.schedule.reference_iterations),
            None => given,
        };
        let share = c.nonrigid.iterations as f64 / given.max(1) as f64;
        c.nonrigid.density_until = (self.nonrigid.density_until as f64 * share).round() as u64;
        c
    }
}

/// Puts `over` onto `base`, table by table.
fn merge(base: &mut toml::Table, over: toml::Table) {
    for (key, value) in over {
        match (base.get_mut(&key), value) {
            (Some(toml::Value::Table(b)), toml::Value::Table(o)) => merge(b, o),
            (_, value) => {
                base.insert(key, value);
            }
        }
    }
}

/// Log-linear decay from `first` to `last` over `steps`, held afterwards (Plenoxels' schedule, as 3DGS uses it).
pub fn decayed(first: f64, last: f64, step: u64, steps: u64) -> f64 {
    if first <= 0.0 || last <= 0.0 || steps == 0 || first == last {
        return first;
    }
    let t = (step as f64 / steps as f64).clamp(0.0, 1.0);
    (first.ln() * (1.0 - t) + last.ln() * t).exp()
}
