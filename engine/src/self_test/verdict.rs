//! What is known of a device: one small file per device and suite beside the pipeline cache.

use std::path::PathBuf;
use std::sync::OnceLock;
use std::time::{SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::Suite;
use crate::file::durable;
use crate::gpu::kernel::Tolerance;
use crate::gpu::{DeviceInfo, GpuOptions, cache_path};

/// What a verdict holds for. With another driver, other shaders, tolerances or subgroups a device is tested again.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Subject {
    /// Device name.
    pub device: String,
    /// Driver name and version.
    pub driver: String,
    /// Vulkan version of the device.
    pub vulkan: String,
    /// Identity of driver and device for pipelines.
    pub cache_uuid: String,
    /// Subgroup size that kernels use.
    pub subgroup_size: u32,
    /// SHA-256 of all kernels' SPIR-V.
    pub shaders: String,
}

/// The outcome of a suite.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Verdict {
    /// What it holds for.
    pub subject: Subject,
    /// What was tested.
    pub suite: Suite,
    /// Why the device failed; `None`: it passed.
    pub failure: Option<String>,
    /// When, in seconds since 1970.
    pub tested_at: u64,
    /// How long it took, seconds.
    pub seconds: f64,
}

impl Verdict {
    pub(super) fn now(subject: Subject, suite: Suite, failure: Option<String>, seconds: f64) -> Self {
        let tested_at = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs());
        Self { subject, suite, failure, tested_at, seconds }
    }

    /// Seconds since it was made.
    pub fn age_s(&self) -> u64 {
        SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs().saturating_sub(self.tested_at))
    }

    /// Whether the device may be trusted.
    pub fn passed(&self) -> bool {
        self.failure.is_none()
    }
}

impl Subject {
    /// A device as it is now, with the shaders that these options give.
    pub fn of(info: &DeviceInfo, options: &GpuOptions) -> Self {
        Self {
            device: info.name.clone(),
            driver: info.driver.clone(),
            vulkan: info.vulkan.clone(),
            cache_uuid: info.capabilities.cache_uuid.clone(),
            subgroup_size: info.capabilities.subgroup_size,
            shaders: shaders(options, info.capabilities.texel_reads > 0 && options.texel_reads),
        }
    }
}

/// SHA-256 of the SPIR-V of all kernels and what they are judged by, hexadecimal: another test is not answered by an old verdict.
fn shaders(options: &GpuOptions, texel_reads: bool) -> String {
    static COMMITTED: OnceLock<String> = OnceLock::new();
    let committed = COMMITTED.get_or_init(|| {
        let mut hash = Sha256::new();
        hash.update(env!("CARGO_PKG_VERSION"));
        for kernel in crate::kernels() {
            let Tolerance { absolute, relative, flips } = kernel.tolerance;
            hash.update(kernel.spirv);
            [absolute, relative, flips].iter().for_each(|part| hash.update(part.to_le_bytes()));
        }
        hex(&hash.finalize())
    });
    if options.replace_spirv.is_empty() && !texel_reads {
        return committed.clone();
    }
    let mut hash = Sha256::new();
    hash.update(committed);
    if texel_reads {
        // What rewrites them.
        hash.update(include_str!("../gpu/texels.rs"));
    }
    for (name, words) in &options.replace_spirv {
        hash.update(name);
        hash.update(bytemuck::cast_slice::<u32, u8>(words));
    }
    hex(&hash.finalize())
}

fn hex(digest: &[u8]) -> String {
    digest.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Where the verdict of a device is kept; `None` without a cache folder. Shaders and driver are not in the name, so that new ones
/// replace the file.
fn path(info: &DeviceInfo, suite: Suite) -> Option<PathBuf> {
    let key = format!("{} {}", info.name, info.capabilities.subgroup_size);
    let name = &hex(&Sha256::digest(key))[..8];
    let file = format!("self-test-{}-{}-{name}.json", suite.name(), info.capabilities.cache_uuid);
    Some(cache_path(info)?.with_file_name(file))
}

/// What is known of a device with its driver and these shaders. A file that is missing, damaged or of something else is no
/// verdict.
pub fn known(info: &DeviceInfo, options: &GpuOptions, suite: Suite) -> Option<Verdict> {
    let bytes = options.pipeline_cache.then(|| std::fs::read(path(info, suite)?).ok()).flatten()?;
    let verdict: Verdict = serde_json::from_slice(&bytes).ok()?;
    (verdict.subject == Subject::of(info, options) && verdict.suite == suite).then_some(verdict)
}

/// Keeps a verdict. Failing to is no error: the device is tested again at the next start.
pub(super) fn keep(info: &DeviceInfo, options: &GpuOptions, verdict: &Verdict) {
    if !options.pipeline_cache {
        return;
    }
    let Some(path) = path(info, verdict.suite) else { return };
    let written = path.parent().map_or(Ok(()), std::fs::create_dir_all).map_err(|e| e.to_string()).and_then(|()| {
        let text = serde_json::to_vec_pretty(verdict).map_err(|e| e.to_string())?;
        durable::write_atomic(&path, |file| file.write_all(&text)).map_err(|e| e.to_string())
    });
    if let Err(error) = written {
        log::debug!("verdict of the self-test {}: {error}", path.display());
    }
}
