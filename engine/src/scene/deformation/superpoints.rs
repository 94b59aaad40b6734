//! Superpoints that move rigidly, from a key-time table or network F, with or without network G after them.

use super::super::gaussians::retain_chunks;
use super::super::network::finite;
use super::super::{Association, Blend, DeformNetwork, Motion, MotionSource, NonrigidNetwork, Superpoints};
use super::source_missing;
use crate::error::{Error, Result};

/// Superpoints and what gives their poses. With neither table nor network they rest; with both, [`MotionSource`] says which
/// one plays.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SuperpointDeformation {
    /// Which superpoint each Gaussian moves with, and the canonical superpoint centres.
    pub superpoints: Superpoints,
    /// Soft superpoints; `None`: each Gaussian moves with one.
    pub blend: Option<Blend>,
    /// Key-time table of poses.
    pub table: Option<Motion>,
    /// Network F, which gives poses at any time.
    pub network: Option<DeformNetwork>,
    /// Sparse association matrix A, which training needs.
    pub association: Option<Association>,
    /// Network G, which adds to each rigidly moved Gaussian.
    pub nonrigid: Option<NonrigidNetwork>,
}

fn problem(tensor: &str, found: impl Into<String>, expected: impl Into<String>) -> Result<()> {
    Err(Error::usage(tensor, found, expected))
}

fn length(tensor: &str, found: usize, expected: usize) -> Result<()> {
    if found == expected { Ok(()) } else { problem(tensor, format!("{found} elements"), expected.to_string()) }
}

fn below(tensor: &str, values: &[u32], count: usize) -> Result<()> {
    match values.iter().position(|&v| v as usize >= count) {
        None => Ok(()),
        Some(i) => {
            let expected = format!("indices below M = {count} (the rows of `superpoints.position`)");
            problem(tensor, format!("{} at element {i}", values[i]), expected)
        }
    }
}

impl SuperpointDeformation {
    /// Superpoints that a key-time table moves.
    pub fn of_table(superpoints: Superpoints, table: Motion) -> Self {
        Self { superpoints, table: Some(table), ..Self::default() }
    }

    /// The superpoints that Gaussian `i` moves with, and their weights ([`Superpoints::slots`]).
    pub fn slots(&self, i: usize) -> impl Iterator<Item = (usize, f64)> + '_ {
        self.superpoints.slots(self.blend.as_ref(), i)
    }

    /// See [`super::Deformation::motion_source`].
    pub(super) fn motion_source(&self, wanted: MotionSource) -> Result<Option<MotionSource>> {
        let missing = |found: &str| Err(source_missing(found, wanted));
        let table = self.table.as_ref().is_some_and(|m| !m.times.is_empty());
        match wanted {
            MotionSource::Auto | MotionSource::Table if table => Ok(Some(MotionSource::Table)),
            MotionSource::Auto | MotionSource::Network if self.network.is_some() => Ok(Some(MotionSource::Network)),
            MotionSource::Auto => Ok(None),
            MotionSource::Table => missing("table, but the model has no key-time table"),
            MotionSource::Network => missing("network, but the model has no network F"),
        }
    }

    pub(super) fn check_shapes(&self, gaussians: usize) -> Result<()> {
        let m = self.superpoints.position.len();
        length("superpoints.of_gaussian", self.superpoints.of_gaussian.len(), gaussians)?;
        below("superpoints.of_gaussian", &self.superpoints.of_gaussian, m)?;
        self.blend.as_ref().map_or(Ok(()), |blend| blend.check_shapes(gaussians, m))?;
        self.table.as_ref().map_or(Ok(()), |table| table.check_shapes(m))
    }

    pub(super) fn check(&self, gaussians: usize) -> Result<()> {
        self.check_shapes(gaussians)?;
        finite("superpoints.position", self.superpoints.position.as_flattened())?;
        self.table.as_ref().map_or(Ok(()), Motion::check)?;
        self.blend.as_ref().map_or(Ok(()), |blend| blend.check(&self.superpoints.of_gaussian))?;
        let m = self.superpoints.position.len();
        self.association.as_ref().map_or(Ok(()), |a| a.check(gaussians, m))?;
        self.network.as_ref().map_or(Ok(()), DeformNetwork::check)?;
        self.nonrigid.as_ref().map_or(Ok(()), NonrigidNetwork::check)
    }

    pub(super) fn retain(&mut self, keep: &[bool]) {
        retain_chunks(&mut self.superpoints.of_gaussian, 1, keep);
        if let Some(blend) = &mut self.blend {
            retain_chunks(&mut blend.index, blend.neighbors, keep);
            retain_chunks(&mut blend.weight, blend.neighbors, keep);
        }
        if let Some(association) = &mut self.association {
            retain_chunks(&mut association.neighbor, association.neighbors, keep);
            retain_chunks(&mut association.logit, association.neighbors, keep);
        }
    }

    pub(super) fn parts(&self) -> Vec<&'static str> {
        let parts = [
            ("superpoints", true),
            ("their blend", self.blend.is_some()),
            ("motion", self.table.is_some()),
            ("association", self.association.is_some()),
            ("network F", self.network.is_some()),
            ("network G", self.nonrigid.is_some()),
        ];
        parts.into_iter().filter_map(|(name, is_there)| is_there.then_some(name)).collect()
    }
}

impl Motion {
    /// T·M poses for M superpoints.
    fn check_shapes(&self, m: usize) -> Result<()> {
        let t = self.times.len();
        for (name, values) in [("motion.rotation", &self.rotation), ("motion.translation", &self.translation)] {
            if values.len() != t * m {
                let expected = format!("T·M = {t}·{m} (M = rows of `superpoints.position`)");
                return problem(name, format!("{} poses", values.len()), expected);
            }
        }
        Ok(())
    }

    /// Finite poses at finite, increasing times; at least one.
    fn check(&self) -> Result<()> {
        if self.times.is_empty() {
            return problem("motion.times", "no key time", "at least one");
        }
        finite("motion.times", &self.times)?;
        if let Some(i) = self.times.windows(2).position(|w| w[0] >= w[1]) {
            let found = format!("{} then {} at element {}", self.times[i], self.times[i + 1], i + 1);
            return problem("motion.times", found, "strictly increasing times");
        }
        finite("motion.rotation", self.rotation.as_flattened())?;
        finite("motion.translation", self.translation.as_flattened())
    }
}

impl Blend {
    /// K superpoints that are there for each of `gaussians`.
    ///
    /// # Errors
    /// `Usage` naming the tensor and element.
    pub(crate) fn check_shapes(&self, gaussians: usize, m: usize) -> Result<()> {
        let most = Self::MOST_NEIGHBORS;
        if !(1..=most).contains(&self.neighbors) {
            return problem("superpoints.blend_index", format!("K = {}", self.neighbors), format!("K = 1 to {most}"));
        }
        length("superpoints.blend_index", self.index.len(), gaussians * self.neighbors)?;
        length("superpoints.blend_weight", self.weight.len(), gaussians * self.neighbors)?;
        below("superpoints.blend_index", &self.index, m)
    }

    /// Weights that can be normalised, and of which each Gaussian's superpoint has the largest. Shapes are right.
    fn check(&self, of_gaussian: &[u32]) -> Result<()> {
        const WEIGHT: &str = "superpoints.blend_weight";
        finite(WEIGHT, &self.weight)?;
        if let Some(i) = self.weight.iter().position(|&w| w < 0.0) {
            return problem(WEIGHT, format!("{} at element {i}", self.weight[i]), "weights of at least 0");
        }
        for (i, (weight, &own)) in self.weight.chunks_exact(self.neighbors).zip(of_gaussian).enumerate() {
            if weight.iter().all(|&w| w == 0.0) {
                let at = i * self.neighbors;
                return problem(WEIGHT, format!("a sum of 0 from element {at} on"), "weights with a sum above 0");
            }
            if let Some(heaviest) = self.heaviest(i).filter(|j| *j != own) {
                let expected = format!("{heaviest}, which has the largest weight in `superpoints.blend_index`");
                return problem("superpoints.of_gaussian", format!("{own} at element {i}"), expected);
            }
        }
        Ok(())
    }
}

impl Association {
    fn check(&self, gaussians: usize, m: usize) -> Result<()> {
        if self.neighbors == 0 {
            return problem("association.neighbor", "K' = 0", "at least one neighbour");
        }
        length("association.neighbor", self.neighbor.len(), gaussians * self.neighbors)?;
        length("association.logit", self.logit.len(), gaussians * self.neighbors)?;
        finite("association.logit", &self.logit)?;
        below("association.neighbor", &self.neighbor, m)
    }
}
