//! A scene as arrays of 32-bit words, and what is left of it.

use std::collections::BTreeMap;

use bytemuck::Pod;

use crate::scene::parameter::PARAMETERS;
use crate::scene::{Deformation, Scene, SuperpointDeformation};

/// The name of SH coefficients.
pub(super) const SH: &str = "sh";

/// The arrays of a scene by name, each with the words of its rows.
#[derive(Debug, Default)]
pub(super) struct Columns {
    pub(super) numbers: BTreeMap<&'static str, (Vec<f32>, usize)>,
    pub(super) indices: BTreeMap<&'static str, (Vec<u32>, usize)>,
}

impl Columns {
    /// Takes the arrays out of a scene, which is left with all else.
    pub(super) fn take(scene: &mut Scene) -> Self {
        let mut columns = Self::default();
        let g = &mut scene.gaussians;
        let width = 3 * g.sh_coefficients();
        columns.vectors("mean", &mut g.mean);
        columns.vectors("log_scale", &mut g.log_scale);
        columns.vectors("rotation", &mut g.rotation);
        columns.number("opacity_logit", &mut g.opacity_logit, 1);
        columns.number(SH, &mut g.sh, width);
        for parameter in g.optional.present().iter() {
            let values = g.optional.get(parameter).unwrap_or_default().to_vec();
            columns.numbers.insert(PARAMETERS[parameter].name, (values, PARAMETERS[parameter].width as usize));
            g.optional.set(parameter, Vec::new());
        }
        if let Deformation::Superpoints(s) = &mut scene.deformation {
            columns.take_superpoints(s);
        }
        columns
    }

    fn take_superpoints(&mut self, s: &mut SuperpointDeformation) {
        self.index("of_gaussian", &mut s.superpoints.of_gaussian, 1);
        self.vectors("position", &mut s.superpoints.position);
        if let Some(table) = &mut s.table {
            self.number("times", &mut table.times, 1);
            self.vectors("pose_rotation", &mut table.rotation);
            self.vectors("pose_translation", &mut table.translation);
        }
        if let Some(blend) = &mut s.blend {
            self.index("blend_index", &mut blend.index, blend.neighbors);
            self.number("blend_weight", &mut blend.weight, blend.neighbors);
        }
        if let Some(association) = &mut s.association {
            self.index("neighbor", &mut association.neighbor, association.neighbors);
            self.number("logit", &mut association.logit, association.neighbors);
        }
    }

    /// Puts the arrays back.
    pub(super) fn put(mut self, scene: &mut Scene) {
        let g = &mut scene.gaussians;
        g.mean = self.rows("mean");
        g.log_scale = self.rows("log_scale");
        g.rotation = self.rows("rotation");
        g.opacity_logit = self.values("opacity_logit");
        g.sh = self.values(SH);
        for parameter in g.optional.present().iter() {
            g.optional.set(parameter, self.values(PARAMETERS[parameter].name));
        }
        if let Deformation::Superpoints(s) = &mut scene.deformation {
            self.put_superpoints(s);
        }
    }

    fn put_superpoints(&mut self, s: &mut SuperpointDeformation) {
        s.superpoints.of_gaussian = self.of_indices("of_gaussian");
        s.superpoints.position = self.rows("position");
        if let Some(table) = &mut s.table {
            table.times = self.values("times");
            table.rotation = self.rows("pose_rotation");
            table.translation = self.rows("pose_translation");
        }
        if let Some(blend) = &mut s.blend {
            blend.index = self.of_indices("blend_index");
            blend.weight = self.values("blend_weight");
        }
        if let Some(association) = &mut s.association {
            association.neighbor = self.of_indices("neighbor");
            association.logit = self.values("logit");
        }
    }

    fn number(&mut self, name: &'static str, values: &mut Vec<f32>, width: usize) {
        self.numbers.insert(name, (std::mem::take(values), width.max(1)));
    }

    fn index(&mut self, name: &'static str, values: &mut Vec<u32>, width: usize) {
        self.indices.insert(name, (std::mem::take(values), width.max(1)));
    }

    fn vectors<const N: usize>(&mut self, name: &'static str, rows: &mut Vec<[f32; N]>) {
        self.numbers.insert(name, (std::mem::take(rows).into_flattened(), N));
    }

    fn values(&mut self, name: &str) -> Vec<f32> {
        self.numbers.remove(name).unwrap_or_default().0
    }

    fn of_indices(&mut self, name: &str) -> Vec<u32> {
        self.indices.remove(name).unwrap_or_default().0
    }

    fn rows<const N: usize>(&mut self, name: &str) -> Vec<[f32; N]>
    where
        [f32; N]: Pod,
    {
        // Where the capacity is no whole number of rows, they are copied.
        bytemuck::try_cast_vec(self.values(name)).unwrap_or_else(|(_, values)| values.as_chunks().0.to_vec())
    }
}
