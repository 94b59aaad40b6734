//! What makes recorded numbers comparable: program, commit, command and device.

use engine::gpu::Gpu;
use engine::scene::Scene;
use serde_json::{Value, json};

/// The beginning of every record: its kind, where it has one, and where the numbers that follow come from.
pub fn record(kind: Option<&str>, gpu: &Gpu, numbers: Value) -> Value {
    let mut record = match kind {
        Some(kind) => json!({ "kind": kind }),
        None => json!({}),
    };
    record["program"] = json!({ "name": "spgs", "version": env!("CARGO_PKG_VERSION"), "commit": commit() });
    record["command"] = json!(std::env::args().collect::<Vec<_>>().join(" "));
    record["device"] = json!(gpu.info());
    if let (Some(record), Value::Object(numbers)) = (record.as_object_mut(), numbers) {
        record.extend(numbers);
    }
    record
}

/// A scene in a record.
pub fn scene(name: &str, scene: &Scene) -> Value {
    json!({
        "name": name,
        "gaussians": scene.gaussians.len(),
        "sh_degree": scene.gaussians.sh_degree,
        "superpoints": scene.deformation.superpoint_count(),
        "key_times": scene.deformation.key_times().len(),
    })
}

/// The commit of the source tree: given at build time as `SPGS_COMMIT`, else asked of git where the tree still is.
pub fn commit() -> Option<String> {
    if let Some(commit) = option_env!("SPGS_COMMIT") {
        return Some(commit.to_owned());
    }
    let git = |args: &[&str]| {
        let out =
            std::process::Command::new("git").args(["-C", env!("CARGO_MANIFEST_DIR")]).args(args).output().ok()?;
        out.status.success().then(|| String::from_utf8_lossy(&out.stdout).trim().to_owned())
    };
    let commit = git(&["rev-parse", "HEAD"])?;
    let clean = git(&["status", "--porcelain"]).is_some_and(|s| s.is_empty());
    Some(if clean { commit } else { commit + "-modified" })
}
