//! What a model file holds, for `spgs inspect`.

use std::collections::BTreeMap;
use std::fmt;
use std::path::Path;

use serde::Serialize;

use super::{Format, Loaded, checkpoint, clean, model, ply, read, sog};
use crate::error::Result;
use crate::gpu::mmap::map_file;
use crate::scene::field::{DeformationField, FieldInput};
use crate::scene::{Blend, Gaussians, Rejected, Scene};

/// Range of a parameter over the valid Gaussians.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Statistics {
    /// Tensor name.
    pub name: String,
    /// Smallest value.
    pub min: f64,
    /// Largest value.
    pub max: f64,
    /// Mean value.
    pub mean: f64,
}

/// The key-time table.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MotionDescription {
    /// T.
    pub key_times: usize,
    /// M.
    pub superpoints: usize,
    /// First and last key time.
    pub time_range: [f32; 2],
    /// Largest rotation angle of a pose, radians.
    pub max_rotation: f64,
    /// Largest translation of a pose, world units.
    pub max_translation: f64,
}

/// Soft superpoints.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BlendDescription {
    /// K.
    pub neighbors: usize,
    /// Share of the Gaussians that move with more than one superpoint.
    pub soft: f64,
    /// Mean over the Gaussians of the exponential of their weights' entropy: 1 when each moves with one superpoint, K at most.
    pub mean_superpoints: f64,
}

/// What a model file holds.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Description {
    /// Name of the file.
    pub path: String,
    /// Kind of file.
    pub format: Format,
    /// Size of the file.
    pub bytes: u64,
    /// N in the file.
    pub gaussians: usize,
    /// SH degree.
    pub sh_degree: u32,
    /// Whether splats keep the weight of Gaussians smaller than a pixel.
    pub antialiased: bool,
    /// Gaussians that cannot be rendered.
    pub rejected: Rejected,
    /// Per parameter, over the valid Gaussians.
    pub statistics: Vec<Statistics>,
    /// Smallest and largest centre (canonical), world units; absent without a valid Gaussian.
    pub bounds: Option<[[f32; 3]; 2]>,
    /// Opacity (after the sigmoid) at the quantiles 0, 5, 25, 50, 75, 95 and 100 %; empty without a valid Gaussian.
    pub opacity_quantiles: Vec<f64>,
    /// M, where the scene has superpoints.
    pub superpoints: Option<usize>,
    /// Soft superpoints, where the scene has them.
    pub blend: Option<BlendDescription>,
    /// The key-time table, where there is one.
    pub motion: Option<MotionDescription>,
    /// K' of the association, where there is one.
    pub association_neighbors: Option<usize>,
    /// Whether network F is there.
    pub deform_network: bool,
    /// Whether network G is there.
    pub nonrigid_network: bool,
    /// What moves each Gaussian by itself, in words, where something does.
    pub deformation_field: Option<String>,
    /// Free metadata.
    pub metadata: BTreeMap<String, String>,
    /// Tensors of a `.safetensors`.
    pub tensors: Vec<model::TensorInfo>,
    /// Properties of a `.ply`'s vertices.
    pub properties: Vec<String>,
    /// Levels of detail, the finest first, of a model that has several.
    pub levels: Vec<sog::Level>,
    /// Warnings of the load.
    pub warnings: Vec<String>,
}

/// Reads and describes a model.
///
/// # Errors
/// As [`super::load`].
pub fn describe(path: &Path) -> Result<Description> {
    let format = Format::of_file(path)?;
    let (scene, mut warnings) = match format {
        // Weights alone are described too.
        Format::Torch => (Scene::default(), Vec::new()),
        _ => read(path, format)?,
    };
    let (tensors, properties) = match format {
        Format::Ply | Format::CompressedPly => (Vec::new(), ply::properties(&map_file(path)?, path)?),
        Format::Safetensors => (model::tensors(&map_file(path)?, path)?, Vec::new()),
        Format::Torch => {
            let (kind, tensors) = checkpoint::describe_weights(path)?;
            warnings.push(format!("{kind}; to play them, name the folder of the run, which holds the Gaussians"));
            (tensors, Vec::new())
        }
        _ => (Vec::new(), Vec::new()),
    };
    let levels = if format == Format::StreamedSog { sog::levels(path)? } else { Vec::new() };
    let bytes = if path.is_dir() { folder_bytes(path, 2) } else { std::fs::metadata(path).map_or(0, |m| m.len()) };
    let gaussians = scene.gaussians.len();
    let loaded = match format {
        Format::Torch => Loaded { scene, rejected: Rejected::default(), warnings },
        _ => clean(scene, warnings, path),
    };
    let scene = loaded.scene;
    Ok(Description {
        path: path.display().to_string(),
        format,
        bytes,
        gaussians,
        sh_degree: scene.gaussians.sh_degree,
        antialiased: scene.gaussians.antialiased,
        rejected: loaded.rejected,
        statistics: statistics(&scene.gaussians),
        bounds: bounds(&scene.gaussians.mean),
        opacity_quantiles: opacity_quantiles(&scene.gaussians.opacity_logit),
        superpoints: scene.deformation.superpoints().map(|s| s.position.len()),
        blend: scene.deformation.blend().map(blend),
        motion: motion(&scene),
        association_neighbors: scene.deformation.association().map(|a| a.neighbors),
        deform_network: scene.deformation.network().is_some(),
        nonrigid_network: scene.deformation.nonrigid().is_some(),
        deformation_field: scene.deformation.field().map(field),
        metadata: scene.metadata,
        tensors,
        properties,
        levels,
        warnings: loaded.warnings,
    })
}

fn blend(blend: &Blend) -> BlendDescription {
    let soft = blend.soft_count() as f64 / blend.len().max(1) as f64;
    BlendDescription { neighbors: blend.neighbors, soft, mean_superpoints: blend.mean_superpoints() }
}

/// A deformation field in a line.
fn field(field: &DeformationField) -> String {
    let input = match &field.input {
        FieldInput::Waves { octaves, time: None } => format!("centre in {octaves} octaves and time"),
        FieldInput::Waves { octaves, time: Some(_) } => format!("centre in {octaves} octaves and a network of time"),
        FieldInput::Planes(planes) => {
            format!("planes of {} channels at {} resolutions", planes.channels, planes.scales.len())
        }
    };
    let widths: Vec<String> = field.all_layers().map(|l| l.outputs.to_string()).collect();
    let nodes =
        field.nodes.as_ref().map(|n| format!("; {} control nodes, {} per Gaussian", n.position.len(), n.neighbors));
    format!("deformation field: {input}, layers of {}{}", widths.join(", "), nodes.unwrap_or_default())
}

/// Bytes of a folder's files, two folders deep (`point_cloud/iteration_N`).
fn folder_bytes(folder: &Path, depth: u32) -> u64 {
    let bytes = |entry: std::fs::DirEntry| match entry.metadata() {
        Ok(m) if m.is_file() => m.len(),
        Ok(m) if m.is_dir() && depth > 0 => folder_bytes(&entry.path(), depth - 1),
        _ => 0,
    };
    std::fs::read_dir(folder).into_iter().flatten().flatten().map(bytes).sum()
}

fn statistics(g: &Gaussians) -> Vec<Statistics> {
    if g.is_empty() {
        return Vec::new();
    }
    let of = |(name, _, values): (&str, Vec<usize>, &[f32])| {
        let all = || values.iter().map(|&v| f64::from(v));
        Statistics {
            name: format!("gaussians.{name}"),
            min: all().fold(f64::INFINITY, f64::min),
            max: all().fold(f64::NEG_INFINITY, f64::max),
            mean: all().sum::<f64>() / values.len() as f64,
        }
    };
    g.arrays().into_iter().map(of).collect()
}

fn bounds(means: &[[f32; 3]]) -> Option<[[f32; 3]; 2]> {
    let first = *means.first()?;
    Some(means.iter().fold([first, first], |[mut low, mut high], mean| {
        for axis in 0..3 {
            low[axis] = low[axis].min(mean[axis]);
            high[axis] = high[axis].max(mean[axis]);
        }
        [low, high]
    }))
}

/// Quantiles that are reported, in percent.
const QUANTILES: [usize; 7] = [0, 5, 25, 50, 75, 95, 100];

fn opacity_quantiles(logits: &[f32]) -> Vec<f64> {
    let mut sorted = logits.to_vec();
    sorted.sort_unstable_by(f32::total_cmp);
    let Some(last) = sorted.len().checked_sub(1) else { return Vec::new() };
    let sigmoid = |logit: f32| 1.0 / (1.0 + (-f64::from(logit)).exp());
    QUANTILES.iter().map(|percent| sigmoid(sorted[last * percent / 100])).collect()
}

fn motion(scene: &Scene) -> Option<MotionDescription> {
    let table = scene.deformation.table()?;
    let longest = |vectors: &[[f32; 3]]| {
        let length = |v: &[f32; 3]| v.iter().map(|&c| f64::from(c).powi(2)).sum::<f64>().sqrt();
        vectors.iter().map(length).fold(0.0, f64::max)
    };
    Some(MotionDescription {
        key_times: table.times.len(),
        superpoints: table.superpoint_count(),
        time_range: [*table.times.first()?, *table.times.last()?],
        max_rotation: longest(&table.rotation),
        max_translation: longest(&table.translation),
    })
}

impl Description {
    fn tensors_and_warnings(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for t in &self.tensors {
            writeln!(f, "Tensor          {:<32} {} {:?}, {} bytes", t.name, t.dtype, t.shape, t.bytes)?;
        }
        self.warnings.iter().try_for_each(|warning| writeln!(f, "Warning         {warning}"))
    }
}

impl fmt::Display for Description {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{}: {}, {} bytes", self.path, self.format, self.bytes)?;
        if self.format == Format::Torch {
            return self.tensors_and_warnings(f);
        }
        let antialiased = if self.antialiased { ", antialiased" } else { "" };
        writeln!(f, "Gaussians       {} (SH degree {}{antialiased})", self.gaussians, self.sh_degree)?;
        let r = &self.rejected;
        if r.total() > 0 {
            write!(
                f,
                "  not rendered  {}: {} not finite, {} zero rotation, ",
                r.total(),
                r.not_finite,
                r.zero_rotation
            )?;
            writeln!(f, "{} absurd scale, {} out of range", r.absurd_scale, r.out_of_range)?;
        }
        for level in &self.levels {
            writeln!(f, "  {level}")?;
        }
        for s in &self.statistics {
            writeln!(f, "  {:<24} min {:<12.5} mean {:<12.5} max {:.5}", s.name, s.min, s.mean, s.max)?;
        }
        if let Some([low, high]) = self.bounds {
            writeln!(f, "Bounds          {low:.4?} to {high:.4?}")?;
        }
        if !self.opacity_quantiles.is_empty() {
            let pairs = QUANTILES.iter().zip(&self.opacity_quantiles);
            let text: Vec<String> = pairs.map(|(percent, value)| format!("{percent} %: {value:.3}")).collect();
            writeln!(f, "Opacity         {}", text.join("  "))?;
        }
        match (&self.motion, self.superpoints) {
            (Some(m), _) => {
                let [first, last] = m.time_range;
                write!(
                    f,
                    "Motion          {} superpoints, {} key times from {first} to {last}, ",
                    m.superpoints, m.key_times
                )?;
                writeln!(f, "rotations up to {:.4} rad, translations up to {:.4}", m.max_rotation, m.max_translation)?;
            }
            (None, Some(count)) => writeln!(f, "Superpoints     {count}, no key-time table")?,
            (None, None) => match &self.deformation_field {
                Some(field) => writeln!(f, "Motion          {field}")?,
                None => writeln!(f, "Motion          none (static)")?,
            },
        }
        if let Some(b) = &self.blend {
            let (soft, mean) = (100.0 * b.soft, b.mean_superpoints);
            writeln!(
                f,
                "Blend           up to {} superpoints per Gaussian: {soft:.1} % move with more than one, {mean:.2} in effect",
                b.neighbors
            )?;
        }
        if let Some(neighbors) = self.association_neighbors {
            writeln!(f, "Association     {neighbors} neighbours per Gaussian")?;
        }
        if self.deform_network {
            writeln!(f, "Network F       present")?;
        }
        if self.nonrigid_network {
            writeln!(f, "Network G       present")?;
        }
        for (key, value) in &self.metadata {
            let short: String = value.chars().take(80).collect();
            writeln!(f, "Metadata        {key} = {short}{}", if short.len() < value.len() { "…" } else { "" })?;
        }
        if !self.properties.is_empty() {
            writeln!(f, "Properties      {}", self.properties.join(" "))?;
        }
        self.tensors_and_warnings(f)
    }
}
