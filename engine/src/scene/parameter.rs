//! The one table of a Gaussian's parameters. Upload, moments, density control, checkpoints, the watch over numbers, learning
//! rates, the constants of the kernels (`glsl/lib/parameters.glsl`) and the model file follow from it.

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

use super::gaussians::retain_chunks;

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
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
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

const PLAIN: Parameter = Parameter {
    name: "",
    width: 1,
    layout: Layout::Planes,
    activation: Activation::Identity,
    learning_rate: "",
    spatial: false,
    new_rows: NewRows::Copy,
    export: "",
};
const SH: Parameter =
    Parameter { activation: Activation::SphericalHarmonics, learning_rate: "sh_rest", export: "sh", ..PLAIN };

/// Every parameter. What follows the SH bands is optional: a scene has it or not.
pub const PARAMETERS: [Parameter; 8] = [
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

/// First plane of a parameter in moments and gradients, `float[P][N]`: one after another, all SH bands counted.
pub const fn first_plane(parameter: usize) -> u32 {
    let (mut plane, mut i) = (0, 0);
    while i < parameter {
        plane += PARAMETERS[i].width;
        i += 1;
    }
    plane
}

/// Numbers of a Gaussian with SH of a degree and no optional parameter: 11 + 3(degree + 1)².
pub const fn required_planes(sh_degree: u32) -> u32 {
    first_plane(SH_0 + sh_degree as usize + 1)
}

/// Numbers of a Gaussian with SH of a degree and these optional parameters. Where there are some, all SH bands count.
pub fn planes(sh_degree: u32, optional: &[usize]) -> u32 {
    optional.iter().max().map_or(required_planes(sh_degree), |last| first_plane(last + 1))
}

/// The kernels' constants, `glsl/lib/parameters.glsl`: place in the table and first plane of each parameter.
pub fn glsl() -> String {
    let mut text = String::from(
        "// Made by `spgs-dev spirv` from the table in engine/src/scene/parameter.rs. Place of each parameter in that table: of its\n\
         // learning rate in Step and of its reports in status; first plane in moments and gradients.\n\
         #ifndef SPGS_PARAMETERS\n#define SPGS_PARAMETERS\n\n",
    );
    text += &format!("const uint PARAMETERS = {}u;\n", PARAMETERS.len());
    for (i, parameter) in PARAMETERS.iter().enumerate() {
        let name = parameter.name.to_uppercase();
        text += &format!("const uint PARAMETER_{name} = {i}u;\nconst uint PLANE_{name} = {}u;\n", first_plane(i));
    }
    text + "\n#endif\n"
}

/// The optional parameters that some Gaussians have, `[N,width]` each.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Optional(BTreeMap<usize, Vec<f32>>);

impl Optional {
    /// Values of a parameter, where the Gaussians have it.
    pub fn get(&self, parameter: usize) -> Option<&[f32]> {
        self.0.get(&parameter).map(Vec::as_slice)
    }

    /// Gives the Gaussians a parameter.
    pub fn set(&mut self, parameter: usize, values: Vec<f32>) {
        self.0.insert(parameter, values);
    }

    /// What there is: place in [`PARAMETERS`] and values.
    pub fn iter(&self) -> impl Iterator<Item = (usize, &[f32])> {
        self.0.iter().map(|(parameter, values)| (*parameter, values.as_slice()))
    }

    /// Places of those that there are.
    pub fn present(&self) -> Vec<usize> {
        self.0.keys().copied().collect()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Those of the Gaussians at these indices, in this order.
    #[must_use]
    pub fn selected(&self, indices: &[usize]) -> Self {
        let chosen = |parameter: usize, values: &[f32]| {
            let width = PARAMETERS[parameter].width as usize;
            indices.iter().flat_map(|&i| values[i * width..(i + 1) * width].iter().copied()).collect()
        };
        Self(self.iter().map(|(parameter, values)| (parameter, chosen(parameter, values))).collect())
    }

    /// Keeps those of the Gaussians for which `keep` holds.
    pub(crate) fn retain(&mut self, keep: &[bool]) {
        self.0.iter_mut().for_each(|(parameter, v)| retain_chunks(v, PARAMETERS[*parameter].width as usize, keep));
    }

    /// Adds those of `other` in `range` after the `own` Gaussians there are. Who lacks a parameter of the other gets zeros.
    pub(crate) fn append(&mut self, own: usize, other: &Self, range: Range<usize>) {
        let present: BTreeSet<usize> = self.0.keys().chain(other.0.keys()).copied().collect();
        for parameter in present {
            let width = PARAMETERS[parameter].width as usize;
            let values = self.0.entry(parameter).or_default();
            values.resize(own * width, 0.0);
            match other.get(parameter) {
                Some(more) => values.extend_from_slice(&more[range.start * width..range.end * width]),
                None => values.resize((own + range.len()) * width, 0.0),
            }
        }
    }
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
        assert_eq!([0, 1, 2, 3].map(required_planes), [14, 23, 38, 59]);
        assert_eq!([MEAN, LOG_SCALE, ROTATION, OPACITY_LOGIT, SH_0, SH_0 + 3].map(first_plane), [0, 3, 6, 10, 11, 38]);
        assert!(in_degree(SH_0, 0) && !in_degree(SH_0 + 1, 0) && in_degree(SH_0 + 3, 3) && in_degree(MEAN, 0));
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
