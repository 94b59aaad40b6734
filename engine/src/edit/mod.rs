//! Edits of scenes: which Gaussians, and what happens to them.
//!
//! Operations are functions on a [`Scene`] and a mask `[N]`; they change it in place and say what they [`Touched`]. Rigid changes
//! and uniform scales are exact for all times ([`transform`]), also where only a part of a superpoint is selected: it is split.
//! Changes that key times cannot follow exactly ([`transform_in_part`], [`transform_during`]) get more of them, until no point is
//! off by more than a bound in pixels, as the baker measures it.
//!
//! Sources of the formulas: poses μ(t) = Exp(r)μ + τ of SP-GS; Exp(R·r) = R·Exp(r)·Rᵀ.

mod centers;
mod color;
mod during;
mod history;
mod masks;
mod measure;
mod merge;
mod nearest_turn;
mod part;
mod rows;
pub mod script;
pub mod select;
mod session;
mod similarity;
mod split;
mod table;
#[cfg(test)]
mod tests;
mod time;
mod transform;

pub use centers::{centers, centers_of};
pub use color::{Recolor, recolor};
pub use during::{Window, transform_during};
pub use history::{Entry, History};
pub use measure::{BOUND_PX, Bound, Touched};
pub use merge::{Placement, merge};
pub(crate) use nearest_turn::{nearest_turn, outer};
pub use part::transform_in_part;
pub use session::{Session, Step};
pub use similarity::Similarity;
pub(crate) use similarity::unwrapped;
pub(crate) use split::{copy as copy_superpoints, movable};
pub use time::{TimeMap, retime};
pub use transform::{stretch, transform};

use crate::error::Result;
use crate::scene::Scene;

/// Keeps the Gaussians of `mask` `[N]`, with all that belongs to them. Superpoints keep their numbers.
pub fn keep(scene: &mut Scene, mask: &[bool]) -> Touched {
    let gaussians = mask.iter().filter(|kept| !**kept).count();
    if gaussians > 0 {
        scene.retain(mask);
    }
    Touched { gaussians, ..Touched::default() }
}

/// Adds copies of the Gaussians of `mask` after all others; they move with the same superpoints until an edit splits these.
///
/// # Errors
/// [`crate::Error::Usage`] in a model that a deformation field moves.
pub fn duplicate(scene: &mut Scene, mask: &[bool]) -> Result<Touched> {
    let indices: Vec<usize> = (0..mask.len()).filter(|&i| mask[i]).collect();
    if !indices.is_empty() {
        rows::repeat(scene, &indices)?;
    }
    Ok(Touched { gaussians: indices.len(), ..Touched::default() })
}
