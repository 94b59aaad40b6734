//! What moves the Gaussians of a scene. A scene has one model of its motion, or none:
//!
//! | variant | what moves a Gaussian at a time |
//! |---|---|
//! | [`Deformation::None`] | nothing |
//! | [`Deformation::Superpoints`] | the pose of its superpoint, from a key-time table or network F; then network G, where there is one |
//! | [`Deformation::Nonrigid`] | network G alone |
//! | [`Deformation::Field`] | a perceptron that sees each Gaussian's centre, or control nodes ([`super::field`]) |
//!
//! Callers ask the enum and need not know the model. `CONTRIBUTING.md` lists the files that another model touches.

pub mod superpoints;

use super::{Association, Blend, DeformNetwork, DeformationField, Motion, MotionSource, NonrigidNetwork, Superpoints};
use crate::error::{Error, Result};

pub use superpoints::SuperpointDeformation;

/// The motion of a scene.
#[derive(Debug, Clone, Default, PartialEq)]
pub enum Deformation {
    /// The Gaussians stay where they are.
    #[default]
    None,
    /// Superpoints move rigidly and take their Gaussians along.
    Superpoints(Box<SuperpointDeformation>),
    /// Network G moves each Gaussian from where it rests.
    Nonrigid(Box<NonrigidNetwork>),
    /// Motion that is each Gaussian's own.
    Field(Box<DeformationField>),
}

impl From<SuperpointDeformation> for Deformation {
    fn from(superpoints: SuperpointDeformation) -> Self {
        Self::Superpoints(Box::new(superpoints))
    }
}

impl From<NonrigidNetwork> for Deformation {
    fn from(network: NonrigidNetwork) -> Self {
        Self::Nonrigid(Box::new(network))
    }
}

impl From<DeformationField> for Deformation {
    fn from(field: DeformationField) -> Self {
        Self::Field(Box::new(field))
    }
}

impl Deformation {
    /// Whether anything moves. Superpoints that have neither poses nor network G rest.
    pub fn moves(&self) -> bool {
        match self {
            Self::None => false,
            Self::Superpoints(s) => s.table.is_some() || s.network.is_some() || s.nonrigid.is_some(),
            Self::Nonrigid(_) | Self::Field(_) => true,
        }
    }

    /// First and last time: of the key-time table; 0 and 1 of networks and fields, which are trained on that; both 0 when
    /// nothing moves.
    pub fn time_range(&self) -> [f64; 2] {
        match self.table().map(|t| (t.times.first(), t.times.last())) {
            Some((Some(first), Some(last))) => [f64::from(*first), f64::from(*last)],
            _ if self.moves() => [0.0, 1.0],
            _ => [0.0, 0.0],
        }
    }

    /// Whether sizes change over time, and not only centres and rotations.
    pub fn changes_scales(&self) -> bool {
        self.nonrigid().is_some() || self.field().is_some()
    }

    /// Superpoints with what gives their poses.
    pub fn superpoint_deformation(&self) -> Option<&SuperpointDeformation> {
        if let Self::Superpoints(s) = self { Some(s) } else { None }
    }

    /// Superpoints with what gives their poses, to be changed.
    pub fn superpoint_deformation_mut(&mut self) -> Option<&mut SuperpointDeformation> {
        if let Self::Superpoints(s) = self { Some(s) } else { None }
    }

    /// Superpoints: their centres, and which one each Gaussian moves with.
    pub fn superpoints(&self) -> Option<&Superpoints> {
        Some(&self.superpoint_deformation()?.superpoints)
    }

    /// Superpoints, to be changed.
    pub fn superpoints_mut(&mut self) -> Option<&mut Superpoints> {
        Some(&mut self.superpoint_deformation_mut()?.superpoints)
    }

    /// M, the number of superpoints; 0 without.
    pub fn superpoint_count(&self) -> usize {
        self.superpoints().map_or(0, |s| s.position.len())
    }

    /// `[N]` the superpoint of each Gaussian; empty without superpoints.
    pub fn superpoint_of_gaussian(&self) -> &[u32] {
        self.superpoints().map_or(&[], |s| &s.of_gaussian)
    }

    /// Soft superpoints: `None` when each Gaussian moves with one.
    pub fn blend(&self) -> Option<&Blend> {
        self.superpoint_deformation()?.blend.as_ref()
    }

    /// The key-time table.
    pub fn table(&self) -> Option<&Motion> {
        self.superpoint_deformation()?.table.as_ref()
    }

    /// The key-time table, to be changed.
    pub fn table_mut(&mut self) -> Option<&mut Motion> {
        self.superpoint_deformation_mut()?.table.as_mut()
    }

    /// Key times of the table; none without one.
    pub fn key_times(&self) -> &[f32] {
        self.table().map_or(&[], |t| &t.times)
    }

    /// The sparse association matrix.
    pub fn association(&self) -> Option<&Association> {
        self.superpoint_deformation()?.association.as_ref()
    }

    /// Network F.
    pub fn network(&self) -> Option<&DeformNetwork> {
        self.superpoint_deformation()?.network.as_ref()
    }

    /// Network F, to be changed.
    pub fn network_mut(&mut self) -> Option<&mut DeformNetwork> {
        self.superpoint_deformation_mut()?.network.as_mut()
    }

    /// Network G.
    pub fn nonrigid(&self) -> Option<&NonrigidNetwork> {
        match self {
            Self::Superpoints(s) => s.nonrigid.as_ref(),
            Self::Nonrigid(network) => Some(network),
            Self::None | Self::Field(_) => None,
        }
    }

    /// Network G, to be changed.
    pub fn nonrigid_mut(&mut self) -> Option<&mut NonrigidNetwork> {
        match self {
            Self::Superpoints(s) => s.nonrigid.as_mut(),
            Self::Nonrigid(network) => Some(network),
            Self::None | Self::Field(_) => None,
        }
    }

    /// The deformation field.
    pub fn field(&self) -> Option<&DeformationField> {
        if let Self::Field(field) = self { Some(field) } else { None }
    }

    /// The deformation field, to be changed.
    pub fn field_mut(&mut self) -> Option<&mut DeformationField> {
        if let Self::Field(field) = self { Some(field) } else { None }
    }

    /// The same motion followed by network G.
    ///
    /// # Errors
    /// `Usage` beside a deformation field, which moves each Gaussian already.
    pub fn with_nonrigid(self, network: NonrigidNetwork) -> Result<Self> {
        match self {
            Self::None | Self::Nonrigid(_) => Ok(network.into()),
            Self::Superpoints(s) => Ok(SuperpointDeformation { nonrigid: Some(network), ..*s }.into()),
            Self::Field(_) => Err(field_beside_others()),
        }
    }

    /// Takes network G away and returns it.
    pub fn take_nonrigid(&mut self) -> Option<NonrigidNetwork> {
        match std::mem::take(self) {
            Self::Superpoints(mut s) => {
                let network = s.nonrigid.take();
                *self = Self::Superpoints(s);
                network
            }
            Self::Nonrigid(network) => Some(*network),
            other => {
                *self = other;
                None
            }
        }
    }

    /// What gives the poses of superpoints when `wanted` is asked for: `Table`, `Network`, or `None` where there are none.
    /// A field counts as a network, and so it may be asked for as one.
    ///
    /// # Errors
    /// `Usage` when the scene lacks what is asked for.
    pub fn motion_source(&self, wanted: MotionSource) -> Result<Option<MotionSource>> {
        let missing = |found: &str| Err(source_missing(found, wanted));
        match (self, wanted) {
            (Self::Superpoints(s), _) => s.motion_source(wanted),
            (_, MotionSource::Auto) | (Self::Field(_), MotionSource::Network) => Ok(None),
            (Self::Field(_), MotionSource::Table) => {
                missing("table, but a deformation field moves the model (`spgs convert --bake` makes a table)")
            }
            (_, MotionSource::Table) => missing("table, but the model does not move"),
            (_, MotionSource::Network) => missing("network, but the model does not move"),
        }
    }

    /// Rejects arrays that do not fit together, for a scene of `gaussians`. What a device can bear is not looked at: numbers
    /// that are not finite.
    ///
    /// # Errors
    /// `Usage` naming the tensor, what was found and what is possible.
    pub fn check_shapes(&self, gaussians: usize) -> Result<()> {
        match self {
            Self::None => Ok(()),
            Self::Superpoints(s) => s.check_shapes(gaussians),
            Self::Nonrigid(network) => network.check_shapes(),
            Self::Field(field) => field.check(gaussians),
        }
    }

    /// Rejects what no model file may hold: arrays that do not fit together, numbers that are not finite, key times that do
    /// not increase.
    ///
    /// # Errors
    /// As [`Deformation::check_shapes`].
    pub fn check(&self, gaussians: usize) -> Result<()> {
        match self {
            Self::None => Ok(()),
            Self::Superpoints(s) => s.check(gaussians),
            Self::Nonrigid(network) => network.check(),
            Self::Field(field) => field.check(gaussians),
        }
    }

    /// Keeps the Gaussians for which `keep` is true, in all arrays that have a row for each.
    pub fn retain(&mut self, keep: &[bool]) {
        match self {
            Self::None | Self::Nonrigid(_) => {}
            Self::Superpoints(s) => s.retain(keep),
            Self::Field(field) => field.retain(keep),
        }
    }

    /// The parts in words, as an export that cannot hold them names them.
    pub fn parts(&self) -> Vec<&'static str> {
        match self {
            Self::None => Vec::new(),
            Self::Superpoints(s) => s.parts(),
            Self::Nonrigid(_) => vec!["network G"],
            Self::Field(_) => vec!["deformation field"],
        }
    }
}

/// What says that a model lacks the source that was asked for.
fn source_missing(found: &str, wanted: MotionSource) -> Error {
    let expected = match wanted {
        MotionSource::Auto => "a model that moves",
        MotionSource::Table => "a model with a key-time table",
        MotionSource::Network => "a model with network F",
    };
    Error::usage("motion", found, expected)
}

/// What says that a field is there, and something else that moves the same Gaussians.
pub(crate) fn field_beside_others() -> Error {
    Error::usage("field", "a deformation field beside superpoints or network G", "only one of them")
}
