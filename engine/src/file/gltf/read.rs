//! Reads `.glb` and `.gltf` (layout: [`super`]).

use std::path::Path;

use glam::{DAffine3, DMat3, DVec3};
use serde_json::Value;

use super::document::{Document, elements};
use super::nodes::{Instance, instances};
use super::{EXTENSION, SPZ, SPZ_ALONE};
use crate::error::{Error, Result};
use crate::file::affine;
use crate::file::check::MAX_SH_DEGREE;
use crate::file::codec::{allocate, check_memory, logit, scene_bytes};
use crate::file::spz;
use crate::scene::Gaussians;

/// glTF's axes as `.spz` names them (left, up, front), in ours.
const LEFT_UP_FRONT: DMat3 = DMat3::from_diagonal(DVec3::new(-1.0, -1.0, 1.0));

/// Where a primitive has its Gaussians.
enum Source<'a> {
    Attributes(&'a Value),
    Spz {
        view: &'a Value,
        attributes: &'a Value,
        /// Its axes in ours.
        axes: DMat3,
    },
}

/// Reads all Gaussians of the default scene of a `.glb` or `.gltf`, with warnings. Values are not judged here (see
/// [`crate::file::load`]).
///
/// # Errors
/// [`Error::Corrupt`] naming the place; what the format allows but is not supported is named as such: sparse accessors,
/// compression other than `.spz`, buffers outside the file's folder or not there.
/// [`Error::Limit`] for more Gaussians than a file of its size can hold.
pub fn parse(bytes: &[u8], path: &Path) -> Result<(Gaussians, Vec<String>)> {
    let document = Document::open(bytes, path)?;
    let mut reader =
        Reader { bytes: bytes.len() as u64 + document.buffer_bytes(), document, path, warnings: Vec::new() };
    Ok((reader.read()?, reader.warnings))
}

struct Reader<'a> {
    document: Document<'a>,
    path: &'a Path,
    /// Of the file and its buffers.
    bytes: u64,
    warnings: Vec<String>,
}

impl Reader<'_> {
    fn read(&mut self) -> Result<Gaussians> {
        let placed = instances(&self.document)?;
        if self.document.list("nodes").iter().any(|node| !node["extensions"]["EXT_mesh_gpu_instancing"].is_null()) {
            self.warn(
                "`EXT_mesh_gpu_instancing` is not followed: of a node's instances one is read, where the node is",
            );
        }
        if let Some(g) = self.gather(&placed)? {
            return Ok(g);
        }
        let count = self.document.list("meshes").len();
        let all: Vec<_> = (0..count).map(|mesh| Instance { mesh, map: DAffine3::IDENTITY }).collect();
        let Some(g) = self.gather(&all)? else {
            let found = format!("no primitive with `{EXTENSION}` or `{SPZ_ALONE}`");
            return Err(self.document.corrupt("meshes", found, "one"));
        };
        self.warn("no node of the scene shows the Gaussians: they are read where they lie");
        Ok(g)
    }

    /// Warns once, however often a mesh is used.
    fn warn(&mut self, text: &str) {
        let text = format!("{}: {text}", self.path.display());
        if !self.warnings.contains(&text) {
            self.warnings.push(text);
        }
    }

    /// The Gaussians of these meshes, if any has some.
    fn gather(&mut self, instances: &[Instance]) -> Result<Option<Gaussians>> {
        check_memory(self.path, "its Gaussians", scene_bytes(self.promised(instances), 0), self.bytes)?;
        let mut all: Option<Gaussians> = None;
        for Instance { mesh, map } in instances {
            let Some(mesh) = self.document.list("meshes").get(*mesh).cloned() else { continue };
            for primitive in elements(&mesh["primitives"]) {
                let Some(source) = self.source(primitive)? else { continue };
                let mut g = self.primitive(&source)?;
                self.place(&mut g, &source, map)?;
                match &mut all {
                    None => all = Some(g),
                    Some(all) => {
                        let need = scene_bytes((all.len() + 2 * g.len()) as u64, all.sh_degree.max(g.sh_degree));
                        check_memory(self.path, "its Gaussians", need, self.bytes)?;
                        all.append(&g, 0..g.len());
                    }
                }
            }
        }
        Ok(all)
    }

    /// How many Gaussians these meshes have by what the file says of itself.
    fn promised(&self, instances: &[Instance]) -> u64 {
        let meshes = self.document.list("meshes");
        let count = |primitive: &Value| {
            let is_gaussians = [EXTENSION, SPZ_ALONE].iter().any(|name| !primitive["extensions"][*name].is_null());
            let position = self.document.accessor(&primitive["attributes"], "POSITION").filter(|_| is_gaussians);
            position.and_then(|accessor| accessor["count"].as_u64()).unwrap_or(0)
        };
        let of_mesh = |mesh: &Value| elements(&mesh["primitives"]).iter().map(count).fold(0, u64::saturating_add);
        let counts: Vec<u64> = meshes.iter().map(of_mesh).collect();
        instances.iter().filter_map(|i| counts.get(i.mesh)).fold(0, |sum, n| sum.saturating_add(*n))
    }

    /// Turns what was read into our axes, under the transforms of its nodes.
    fn place(&mut self, g: &mut Gaussians, source: &Source<'_>, map: &DAffine3) -> Result<()> {
        if !map.is_finite() {
            return Err(self.document.corrupt("nodes", "transforms that are not finite together", "finite numbers"));
        }
        let ours = DAffine3::from_mat3(affine::TURN);
        let own = match source {
            Source::Attributes(_) => DAffine3::IDENTITY,
            // The reader of `.spz` has turned it into our axes already.
            Source::Spz { axes, .. } => DAffine3::from_mat3(*axes),
        };
        if !affine::transform(g, &(ours * *map * own)) {
            self.warn("a node stretches the Gaussians: their view-dependent colours are turned, not stretched");
        }
        Ok(())
    }

    /// Where a primitive has its Gaussians, if it has some.
    fn source<'v>(&mut self, primitive: &'v Value) -> Result<Option<Source<'v>>> {
        let (extensions, attributes) = (&primitive["extensions"], &primitive["attributes"]);
        let (base, alone) = (&extensions[EXTENSION], &extensions[SPZ_ALONE]);
        if base.is_null() {
            let view = &alone["bufferView"];
            return Ok((!alone.is_null()).then_some(Source::Spz { view, attributes, axes: affine::TURN }));
        }
        for (key, expected) in [("colorSpace", "srgb_rec709_display"), ("kernel", "ellipse")] {
            if let Some(other) = base[key].as_str().filter(|value| *value != expected) {
                self.warn(&format!("`{key}` {other} is taken for {expected}"));
            }
        }
        let within = &base["extensions"];
        if let Some(spz) = SPZ.iter().map(|name| &within[*name]).find(|spz| !spz.is_null()) {
            let axes = if base["kernel"].is_null() { affine::TURN } else { LEFT_UP_FRONT };
            return Ok(Some(Source::Spz { view: &spz["bufferView"], attributes, axes }));
        }
        if let Some(other) = within.as_object().and_then(|within| within.keys().next()) {
            // One that compresses leaves the attributes without bytes.
            let is_plain = |accessor: &Value| !accessor["bufferView"].is_null();
            if !self.document.accessor(attributes, "POSITION").is_some_and(is_plain) {
                let expected = format!("Gaussians uncompressed or by `{}`", SPZ[0]);
                return Err(self.document.corrupt("primitive", format!("extension `{other}`"), expected));
            }
            self.warn(&format!("extension `{other}` is left out"));
        }
        Ok(Some(Source::Attributes(attributes)))
    }

    fn primitive(&mut self, source: &Source<'_>) -> Result<Gaussians> {
        match source {
            Source::Attributes(attributes) => self.attributes(attributes),
            Source::Spz { view, attributes, .. } => self.spz(view, attributes),
        }
    }

    fn spz(&mut self, view: &Value, attributes: &Value) -> Result<Gaussians> {
        let index = view.as_u64().and_then(|i| usize::try_from(i).ok());
        let (stream, _) = self.document.view(index, "spz")?;
        let (g, warnings) = spz::parse(stream, self.path).map_err(|error| match error {
            Error::Corrupt { path, at, found, expected } => {
                Error::Corrupt { path, at: format!("glTF bufferViews[{view}], {at}"), found, expected }
            }
            other => other,
        })?;
        let count = self.document.accessor(attributes, "POSITION").map(|accessor| accessor["count"].as_u64());
        for warning in warnings.into_iter().filter(|w| !self.warnings.contains(w)).collect::<Vec<_>>() {
            self.warnings.push(warning);
        }
        if let Some(count) = count.flatten().filter(|&count| count != g.len() as u64) {
            self.warn(&format!("an accessor promises {count} Gaussians, its .spz has {}", g.len()));
        }
        Ok(g)
    }

    fn attributes(&self, attributes: &Value) -> Result<Gaussians> {
        let file = &self.document;
        let name = |attribute: &str| format!("{EXTENSION}:{attribute}");
        let mean = file.floats(attributes, "POSITION", 3)?;
        let n = mean.len() / 3;
        let get = |attribute: String, width: usize| {
            let values = file.floats(attributes, &attribute, width)?;
            let error = || file.corrupt(&attribute, format!("{} elements", values.len() / width), n.to_string());
            if values.len() == n * width { Ok(values) } else { Err(error()) }
        };
        let has = |degree: u32| attributes.get(name(&format!("SH_DEGREE_{degree}_COEF_0"))).is_some();
        let degree = (1..=MAX_SH_DEGREE).take_while(|&d| has(d)).last().unwrap_or(0);
        check_memory(self.path, "its Gaussians", scene_bytes(n as u64, degree), self.bytes)?;
        let (rotation, scale, opacity) = (get(name("ROTATION"), 4)?, get(name("SCALE"), 3)?, get(name("OPACITY"), 1)?);
        let mut out = allocate(n, degree);
        let k3 = out.sh_coefficients() * 3;
        for l in 0..=degree as usize {
            for c in 0..2 * l + 1 {
                let values = get(name(&format!("SH_DEGREE_{l}_COEF_{c}")), 3)?;
                for (sh, value) in out.sh.chunks_exact_mut(k3).zip(values.chunks_exact(3)) {
                    sh[3 * (l * l + c)..][..3].copy_from_slice(value);
                }
            }
        }
        for i in 0..n {
            out.mean[i] = std::array::from_fn(|a| mean[3 * i + a]);
            out.log_scale[i] = std::array::from_fn(|a| scale[3 * i + a].ln());
            out.rotation[i] = [3, 0, 1, 2].map(|a| rotation[4 * i + a]);
            out.opacity_logit[i] = logit(f64::from(opacity[i]));
        }
        Ok(out)
    }
}
