//! Writes `.glb` (layout: [`super`]).

use std::path::Path;

use serde_json::{Map, Value, json};

use super::{BIN, EXTENSION, FLOAT, JSON, MAGIC, TURN};
use crate::error::{Error, Result};
use crate::file::check;
use crate::file::codec::{SH_C0, bounds, sigmoid, unit};
use crate::file::durable::write_atomic;
use crate::scene::Gaussians;

/// The buffer and what describes it.
#[derive(Default)]
struct Parts {
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
    attributes: Map<String, Value>,
}

impl Parts {
    fn add(&mut self, name: String, kind: &str, values: impl Iterator<Item = f32>, more: Value) {
        let start = self.bytes.len();
        values.for_each(|v| self.bytes.extend_from_slice(&v.to_le_bytes()));
        let length = self.bytes.len() - start;
        let width = match kind {
            "VEC4" => 4,
            "VEC3" => 3,
            _ => 1,
        };
        let mut accessor = json!({
            "bufferView": self.views.len(), "componentType": FLOAT, "count": length / 4 / width, "type": kind,
        });
        if let (Some(accessor), Value::Object(more)) = (accessor.as_object_mut(), more) {
            accessor.extend(more);
        }
        self.attributes.insert(name, self.accessors.len().into());
        self.accessors.push(accessor);
        self.views.push(json!({ "buffer": 0, "byteOffset": start, "byteLength": length, "target": 34962 }));
    }
}

/// Writes a `.glb`, durably; centres and SH keep their bits.
///
/// # Errors
/// [`Error::Usage`] when the arrays' lengths disagree or there is no Gaussian (an accessor has elements);
/// [`Error::Limit`] beyond the 4 GiB of a `.glb`; [`Error::Io`].
pub fn write(path: &Path, gaussians: &Gaussians) -> Result<()> {
    check::gaussians(gaussians).map_err(|problem| problem.usage(path))?;
    if gaussians.is_empty() {
        return Err(Error::usage(
            format!("writing {}", path.display()),
            "no Gaussian",
            "at least one: glTF has no empty arrays",
        ));
    }
    let need = gaussians.len() as u128 * (64 + 12 * gaussians.sh_coefficients() as u128) + 65_536;
    if need > u128::from(u32::MAX) {
        return Err(Error::Limit {
            what: format!("writing {}: bytes of a .glb", path.display()),
            need,
            have: u32::MAX.into(),
        });
    }
    let parts = parts(gaussians);
    let mut description = serde_json::to_vec(&description(&parts))
        .map_err(|e| Error::usage("glTF description", e.to_string(), "finite numbers"))?;
    description.resize(description.len().next_multiple_of(4), b' ');
    let total = 12 + 8 + description.len() + 8 + parts.bytes.len();
    write_atomic(path, |out| {
        out.write_all(&MAGIC)?;
        out.write_all(&2u32.to_le_bytes())?;
        out.write_all(&(total as u32).to_le_bytes())?;
        for (kind, chunk) in [(JSON, &description), (BIN, &parts.bytes)] {
            out.write_all(&(chunk.len() as u32).to_le_bytes())?;
            out.write_all(&kind.to_le_bytes())?;
            out.write_all(chunk)?;
        }
        Ok(())
    })
}

fn parts(g: &Gaussians) -> Parts {
    let mut parts = Parts::default();
    let k3 = g.sh_coefficients() * 3;
    let ends = bounds(&g.mean);
    let more = json!({ "min": ends.map(|b| b[0]), "max": ends.map(|b| b[1]) });
    parts.add("POSITION".into(), "VEC3", g.mean.as_flattened().iter().copied(), more);
    // For programs that only know points.
    let color = |i: usize| {
        let c = |c: usize| (0.5 + SH_C0 * f64::from(g.sh[i * k3 + c])).clamp(0.0, 1.0) as f32;
        [c(0), c(1), c(2), sigmoid(g.opacity_logit[i]) as f32]
    };
    parts.add("COLOR_0".into(), "VEC4", (0..g.len()).flat_map(color), Value::Null);
    let xyzw = g.rotation.iter().flat_map(|&q| {
        let [w, x, y, z] = unit(q).map(|c| c as f32);
        [x, y, z, w]
    });
    parts.add(format!("{EXTENSION}:ROTATION"), "VEC4", xyzw, Value::Null);
    let scales = g.log_scale.as_flattened().iter().map(|s| f64::from(*s).exp() as f32);
    parts.add(format!("{EXTENSION}:SCALE"), "VEC3", scales, Value::Null);
    let opacities = g.opacity_logit.iter().map(|&o| sigmoid(o) as f32);
    parts.add(format!("{EXTENSION}:OPACITY"), "SCALAR", opacities, Value::Null);
    for degree in 0..=g.sh_degree as usize {
        for n in 0..2 * degree + 1 {
            let at = 3 * (degree * degree + n);
            let values = g.sh.chunks_exact(k3).flat_map(|sh| sh[at..at + 3].iter().copied());
            parts.add(format!("{EXTENSION}:SH_DEGREE_{degree}_COEF_{n}"), "VEC3", values, Value::Null);
        }
    }
    parts
}

fn description(parts: &Parts) -> Value {
    json!({
        "asset": { "version": "2.0", "generator": concat!("spgs ", env!("CARGO_PKG_VERSION")) },
        "extensionsUsed": [EXTENSION],
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "mesh": 0, "rotation": TURN }],
        "meshes": [{ "primitives": [{
            "mode": 0,
            "attributes": parts.attributes,
            "extensions": { EXTENSION: {
                "kernel": "ellipse",
                "colorSpace": "srgb_rec709_display",
                "projection": "perspective",
                "sortingMethod": "cameraDistance",
            } },
        }] }],
        "buffers": [{ "byteLength": parts.bytes.len() }],
        "bufferViews": parts.views,
        "accessors": parts.accessors,
    })
}
