//! The one table of a Gaussian's parameters. Upload, moments, density control, checkpoints, the watch over numbers, learning
//! rates, the constants of the kernels (`glsl/lib/parameters.glsl`) and the model file follow from it.

mod optional;

use std::borrow::Cow;

use crate::error::{Error, Result};

pub use optional::Optional;

/// How a parameter's numbers lie on the device.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Layout {
    /// `float[width][N]`.
    Planes,
    /// `float[N][width]`.
    Rows,
}

/// What makes of the stored numbers those that are drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Activation {
    /// Nothing.
    Identity,
    /// eˣ.
    Exponential,
    /// 1 / (1 + e⁻ˣ).
    Sigmoid,
    /// Divided by their length.
    UnitQuaternion,
    /// max(0, ½ + Σ coefficient · basis function).
    SphericalHarmonics,
    /// [`lifespan_share`] of the opacity.
    Lifespan,
    /// [`smoothed`].
    Smoothing,
}

impl Activation {
    /// The word for it in the manual's table of tensors.
    pub fn word(self) -> &'static str {
        match self {
            Self::Identity => "",
            Self::Exponential => "log",
            Self::Sigmoid => "sigmoid",
            Self::UnitQuaternion => "normalised",
            Self::SphericalHarmonics => "spherical harmonics",
            Self::Lifespan => "factor exp",
            Self::Smoothing => "added in squares",
        }
    }
}

/// What density control leaves in a new row.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NewRows {
    /// The parent's numbers. (`split_children` then draws the children's centres and divides their scales.)
    Copy,
    /// Zeros.
    Zero,
}

/// A parameter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Parameter {
    /// Name: of the buffer, in GLSL, in reports.
    pub name: &'static str,
    /// Numbers per Gaussian.
    pub width: u32,
    /// Order of the numbers.
    pub layout: Layout,
    /// From stored to drawn.
    pub activation: Activation,
    /// Key of its learning rate in `[learning_rate]` of a training configuration.
    pub learning_rate: &'static str,
    /// Whether that rate grows with the scene: it is multiplied by `learning_rate.spatial_scale`.
    pub spatial: bool,
    /// What clones and children start with.
    pub new_rows: NewRows,
    /// Tensor of the model file that holds it, after `gaussians.`.
    pub export: &'static str,
    /// Numbers that an optional parameter starts with.
    pub start: &'static [f32],
    /// Learning rate of an optional parameter, unless the configuration has another.
    pub rate: f64,
}

/// Centre, world units.
pub const MEAN: usize = 0;
/// Log of the standard deviations, world units.
pub const LOG_SCALE: usize = 1;
/// Quaternion w, x, y, z of any length.
pub const ROTATION: usize = 2;
/// Opacity before the sigmoid.
pub const OPACITY_LOGIT: usize = 3;
/// First of the four bands of SH coefficients; band b has 3(2b + 1) numbers.
pub const SH_0: usize = 4;
/// When a Gaussian is seen: the middle, and the log of the length (a standard deviation), both in units of time.
pub const LIFESPAN: usize = 8;
/// Standard deviation of a low-pass filter in space, world units: see [`smoothed`]. Training measures it, and does not learn it.
pub const SMOOTHING: usize = 9;

const PLAIN: Parameter = Parameter {
    name: "",
    width: 1,
    layout: Layout::Planes,
    activation: Activation::Identity,
    learning_rate: "",
    spatial: false,
    new_rows: NewRows::Copy,
    export: "",
    start: &[],
    rate: 0.0,
};
const SH: Parameter =
    Parameter { activation: Activation::SphericalHarmonics, learning_rate: "sh_rest", export: "sh", ..PLAIN };

/// Every parameter. What follows the SH bands is optional: a scene has it or not. On the device all optional ones that a scene
/// has share a buffer of planes, and clones and children have their parent's.
pub const PARAMETERS: [Parameter; 10] = [
    Parameter { name: "mean", width: 3, learning_rate: "mean", spatial: true, export: "mean", ..PLAIN },
    Parameter {
        name: "log_scale",
        width: 3,
        activation: Activation::Exponential,
        learning_rate: "log_scale",
        spatial: true,
        export: "log_scale",
        ..PLAIN
    },
    Parameter {
        name: "rotation",
        width: 4,
        layout: Layout::Rows,
        activation: Activation::UnitQuaternion,
        learning_rate: "rotation",
        export: "rotation",
        ..PLAIN
    },
    Parameter {
        name: "opacity_logit",
        activation: Activation::Sigmoid,
        learning_rate: "opacity_logit",
        export: "opacity_logit",
        ..PLAIN
    },
    Parameter { name: "sh_0", width: 3, learning_rate: "sh_0", ..SH },
    Parameter { name: "sh_1", width: 9, ..SH },
    Parameter { name: "sh_2", width: 15, ..SH },
    Parameter { name: "sh_3", width: 21, ..SH },
    Parameter {
        name: "lifespan",
        width: 2,
        activation: Activation::Lifespan,
        learning_rate: "lifespan",
        export: "lifespan",
        // Four times as long as a scene: nearly always there.
        start: &[0.5, 1.386_294_4],
        rate: 1e-3,
        ..PLAIN
    },
    Parameter { name: "smoothing", activation: Activation::Smoothing, export: "smoothing", start: &[0.0], ..PLAIN },
];

/// Parameters that every scene has: those up to the SH bands.
pub const REQUIRED: usize = SH_0 + 4;

impl Parameter {
    /// Planes and words per row, as density control takes them.
    pub const fn planes_and_width(&self) -> [u32; 2] {
        match self.layout {
            Layout::Planes => [self.width, 1],
            Layout::Rows => [1, self.width],
        }
    }

    /// Where number `k` of Gaussian `i` of `n` stands on the device.
    pub const fn word(&self, k: usize, i: usize, n: usize) -> usize {
        match self.layout {
            Layout::Planes => k * n + i,
            Layout::Rows => i * self.width as usize + k,
        }
    }

    /// `[N,width]` in the order of the device.
    pub fn to_device<'a>(&self, rows: Cow<'a, [f32]>) -> Cow<'a, [f32]> {
        match self.layout {
            Layout::Rows => rows,
            Layout::Planes => transposed(&rows, self.width as usize).into(),
        }
    }

    /// The order of the device as `[N,width]`.
    pub fn from_device(&self, words: Vec<f32>) -> Vec<f32> {
        match self.layout {
            Layout::Rows => words,
            Layout::Planes => transposed(&words, words.len() / self.width as usize),
        }
    }
}

/// Rows of `width` values as columns.
pub(crate) fn transposed(rows: &[f32], width: usize) -> Vec<f32> {
    (0..width).flat_map(|k| rows.iter().skip(k).step_by(width).copied()).collect()
}

/// Whether SH of this degree has a parameter; true for all that are no SH band.
pub const fn in_degree(parameter: usize, sh_degree: u32) -> bool {
    parameter < SH_0 || parameter >= REQUIRED || parameter <= SH_0 + sh_degree as usize
}

/// First plane of a parameter in moments and gradients, `float[P][N]`. Optional ones follow the bands up to SH degree 3.
pub fn first_plane(parameter: usize, optional: Present) -> u32 {
    let required = |end: usize| PARAMETERS[..end].iter().map(|p| p.width).sum::<u32>();
    if parameter < REQUIRED { required(parameter) } else { required(REQUIRED) + optional.planes_before(parameter) }
}

/// Numbers of a Gaussian with SH of a degree and these optional parameters: 11 + 3(degree + 1)² without any. Where there are
/// some, all SH bands count.
pub fn planes(sh_degree: u32, optional: Present) -> u32 {
    let last = if optional.is_empty() { SH_0 + sh_degree as usize + 1 } else { PARAMETERS.len() };
    first_plane(last, optional)
}

/// Share of a Gaussian's opacity at a time: exp(−½((time − middle) / length)²), as the temporal opacity of Spacetime
/// Gaussians (Li et al. 2024).
pub fn lifespan_share(middle: f64, log_length: f64, time: f64) -> f64 {
    (-0.5 * ((time - middle) * (-log_length).exp()).powi(2)).exp()
}

/// Standard deviations of a Gaussian blurred by an isotropic one of `sigma`, and what that leaves of its opacity, so that its
/// integral stays: s'² = s² + σ², Π s / s' (the 3-D filter of Mip-Splatting, Yu et al. 2024, equation 7).
pub fn smoothed(scale: [f64; 3], sigma: f64) -> ([f64; 3], f64) {
    let wide = scale.map(|s| s.hypot(sigma));
    (wide, (0..3).map(|k| scale[k] / wide[k]).product())
}

/// Which optional parameters a scene has: bit k is parameter [`REQUIRED`] + k.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash)]
pub struct Present(pub u32);

impl Present {
    /// Those of these names.
    ///
    /// # Errors
    /// `Usage` for the name of no optional parameter that can be learnt.
    pub fn of_names(names: &[String]) -> Result<Self> {
        let mut made = Self::default();
        for name in names {
            let learnt = |place: &usize| *place >= REQUIRED && !PARAMETERS[*place].learning_rate.is_empty();
            let place = PARAMETERS.iter().position(|p| p.name == name).filter(learnt);
            let known = || (REQUIRED..PARAMETERS.len()).filter(learnt).map(|p| PARAMETERS[p].name);
            let known = || known().collect::<Vec<_>>().join(", ");
            let place = place.ok_or_else(|| Error::usage("optional parameter", name.as_str(), known()))?;
            made = made.with(place);
        }
        Ok(made)
    }

    /// With this one too.
    #[must_use]
    pub fn with(self, parameter: usize) -> Self {
        Self(self.0 | 1 << (parameter - REQUIRED))
    }

    /// Whether there is none.
    pub fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Whether this parameter is among them.
    pub fn has(self, parameter: usize) -> bool {
        parameter >= REQUIRED && self.0 >> (parameter - REQUIRED) & 1 == 1
    }

    /// Their places in [`PARAMETERS`].
    pub fn iter(self) -> impl Iterator<Item = usize> {
        (REQUIRED..PARAMETERS.len()).filter(move |&parameter| self.has(parameter))
    }

    /// Planes of those before this one, in the buffer that they share.
    pub fn planes_before(self, parameter: usize) -> u32 {
        self.iter().filter(|&p| p < parameter).map(|p| PARAMETERS[p].width).sum()
    }

    /// All their planes.
    pub fn planes(self) -> u32 {
        self.planes_before(PARAMETERS.len())
    }
}

/// The kernels' constants, `glsl/lib/parameters.glsl`: place in the table and first plane of each parameter.
pub fn glsl() -> String {
    let mut text = String::from(
        "// Made by `spgs-dev spirv` from the table in engine/src/scene/parameter.rs. Place of each parameter in that table: of its\n\
         // learning rate in Step and of its reports in status; first plane in moments and gradients.\n\
         #ifndef SPGS_PARAMETERS\n#define SPGS_PARAMETERS\n\n",
    );
    text += &format!("const uint PARAMETERS = {}u;\n", PARAMETERS.len());
    for (i, parameter) in PARAMETERS.iter().enumerate().take(REQUIRED) {
        let (name, plane) = (parameter.name.to_uppercase(), first_plane(i, Present::default()));
        text += &format!("const uint PARAMETER_{name} = {i}u;\nconst uint PLANE_{name} = {plane}u;\n");
    }
    text += &format!(
        "\n// Optional ones: bit of OPTIONAL and first plane in the buffer `optional`; first plane of all in moments and gradients. `has`: a\n\
         // variable with the value of OPTIONAL (naga reads no operations on specialisation constants).\n\
         const uint PLANE_OPTIONAL = {}u;\n",
        first_plane(REQUIRED, Present::default())
    );
    let mut before = String::from("0u");
    for (i, parameter) in PARAMETERS.iter().enumerate().skip(REQUIRED) {
        let (name, bit) = (parameter.name.to_uppercase(), 1_u32 << (i - REQUIRED));
        text += &format!("const uint PARAMETER_{name} = {i}u;\nconst uint HAS_{name} = {bit}u;\n");
        text += &format!("#define OPTIONAL_{name}(has) ({before})\n");
        before += &format!(" + (((has) & {bit}u) != 0u ? {}u : 0u)", parameter.width);
    }
    text + "\n#endif\n"
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use super::*;

    #[test]
    fn constants_name_their_rows() {
        for (i, name) in [(MEAN, "mean"), (LOG_SCALE, "log_scale"), (ROTATION, "rotation"), (SH_0, "sh_0")] {
            assert_eq!(PARAMETERS[i].name, name);
        }
        assert_eq!(PARAMETERS[OPACITY_LOGIT].name, "opacity_logit");
        for band in 0..4 {
            assert_eq!(PARAMETERS[SH_0 + band].width as usize, 3 * (2 * band + 1));
        }
    }

    #[test]
    fn planes_follow_one_another() {
        let none = Present::default();
        assert_eq!([0, 1, 2, 3].map(|degree| planes(degree, none)), [14, 23, 38, 59]);
        let places = [MEAN, LOG_SCALE, ROTATION, OPACITY_LOGIT, SH_0, SH_0 + 3];
        assert_eq!(places.map(|place| first_plane(place, none)), [0, 3, 6, 10, 11, 38]);
        let lifespan = Present::of_names(&["lifespan".into()]).unwrap();
        assert!(lifespan.has(LIFESPAN) && !none.has(LIFESPAN) && !lifespan.has(MEAN));
        assert_eq!((first_plane(LIFESPAN, lifespan), planes(1, lifespan)), (59, 61));
        assert!(Present::of_names(&["mean".into()]).is_err());
        let error = Present::of_names(&["smoothing".into()]).unwrap_err().to_string();
        assert!(error.contains("expected lifespan"), "it is measured, not learnt: {error}");
        let both = lifespan.with(SMOOTHING);
        assert_eq!((first_plane(SMOOTHING, both), planes(1, both), both.planes()), (61, 62, 3));
        assert!(in_degree(SH_0, 0) && !in_degree(SH_0 + 1, 0) && in_degree(SH_0 + 3, 3) && in_degree(MEAN, 0));
    }

    #[test]
    fn the_manual_says_what_each_is() {
        let page = include_str!("../../docs/model-file.md");
        for p in &PARAMETERS {
            let row = page.lines().find(|line| line.starts_with(&format!("| `gaussians.{}` |", p.export)));
            assert!(row.is_some_and(|row| row.contains(p.activation.word())), "{}: {row:?}", p.name);
        }
    }

    /// Files, starts and the shared buffer take them so.
    #[test]
    fn optional_parameters_are_planes_that_start_somewhere() {
        for p in &PARAMETERS[REQUIRED..] {
            assert!(p.layout == Layout::Planes && p.new_rows == NewRows::Copy, "{}", p.name);
            assert_eq!((p.start.len(), p.export), (p.width as usize, p.name));
        }
    }

    #[test]
    fn a_blurred_gaussian_keeps_its_integral() {
        let (wide, share) = smoothed([0.3, 2.0, 0.0], 0.4);
        assert_eq!((wide[0], wide[2], share), (0.5, 0.4, 0.0));
        let (wide, share) = smoothed([0.3, 2.0, 0.1], 0.4);
        let product = |v: [f64; 3]| v.iter().product::<f64>();
        assert!((share * product(wide) - product([0.3, 2.0, 0.1])).abs() < 1e-15);
    }

    #[test]
    fn who_lacks_a_parameter_gets_its_start() {
        let mut two = Optional::default();
        two.set(LIFESPAN, vec![0.1, 0.2, 0.3, 0.4]);
        let mut none = Optional::default();
        none.append(1, &two, 1..2);
        assert_eq!(none.get(LIFESPAN).unwrap(), [0.5, 1.386_294_4, 0.3, 0.4]);
        two.append(2, &Optional::default(), 0..1);
        assert_eq!(two.selected(&[2, 0]).get(LIFESPAN).unwrap(), [0.5, 1.386_294_4, 0.1, 0.2]);
        two.retain(&[false, true, false]);
        assert_eq!(two.to_device(), [0.3, 0.4]);
    }

    #[test]
    fn the_order_of_the_device_is_undone() {
        let rows: Vec<f32> = (0..12).map(|i| i as f32).collect();
        for parameter in [PARAMETERS[MEAN], PARAMETERS[ROTATION]] {
            let words = parameter.to_device(Cow::Borrowed(&rows)).into_owned();
            assert_eq!(words == rows, parameter.layout == Layout::Rows);
            assert_eq!(parameter.from_device(words), rows);
        }
    }
}
