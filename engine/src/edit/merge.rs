//! Two scenes as one: the other one placed and with its own time.

use super::measure::Touched;
use super::similarity::Similarity;
use super::split::{Moves, movable, with_table};
use super::table::{check_keys, resampled, sorted};
use super::time::{ENDLESS, TimeMap, retime};
use super::transform::transform;
use crate::error::{Error, Result};
use crate::scene::parameter::LIFESPAN;
use crate::scene::{Blend, Deformation, Motion, Scene, SuperpointDeformation};

/// Where and when a merged scene is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Placement {
    /// From its world to that of the first.
    pub place: Similarity,
    /// Its time t becomes `rate`·t + `offset`: `[rate, offset]`, with a rate that is not 0.
    pub time: [f64; 2],
}

impl Default for Placement {
    fn default() -> Self {
        Self { place: Similarity::IDENTITY, time: [1.0, 0.0] }
    }
}

/// Adds `other`, placed, after the Gaussians of `scene`. Key times are those of both; networks F and associations, which cannot
/// hold both, go.
///
/// # Errors
/// [`Error::Usage`] for models whose motion is no key-time table; [`Error::Limit`] for more key times than a table may have.
pub fn merge(scene: &mut Scene, mut other: Scene, placement: &Placement) -> Result<Touched> {
    let (n, count, before) = (scene.gaussians.len(), other.gaussians.len(), scene.deformation.key_times().len());
    let mask = vec![true; count];
    let [rate, offset] = placement.time;
    if !(rate != 0.0 && rate.is_finite() && offset.is_finite()) {
        let found = format!("{offset}+{rate}t");
        return Err(Error::usage("merge, time", found, "finite numbers, and a rate other than 0"));
    }
    if scene.gaussians.antialiased != other.gaussians.antialiased {
        let say =
            |antialiased: bool| if antialiased { "an antialiased scene" } else { "a scene that is not antialiased" };
        let [found, expected] = [&other, &*scene].map(|s| say(s.gaussians.antialiased));
        return Err(Error::usage("merge", found, expected));
    }
    transform(&mut other, &mask, &placement.place)?;
    if other.is_dynamic() && placement.time != [1.0, 0.0] {
        retime(&mut other, &mask, TimeMap::Linear { rate: rate.recip(), offset: -offset / rate })?;
    }
    let superpoints = other.deformation.superpoint_count();
    join_motion(scene, &mut other)?;
    let optional = scene.gaussians.optional.present().has(LIFESPAN) || other.gaussians.optional.present().has(LIFESPAN);
    if optional {
        [&mut *scene, &mut other].into_iter().for_each(with_endless_lifespans);
    }
    scene.gaussians.append(&other.gaussians, 0..count);
    // Further tensors with a row for each Gaussian have none for the new ones.
    let rows = |name: &str, shape: &[usize]| name.starts_with("gaussians.") && shape.first() == Some(&n);
    let dropped: Vec<String> =
        scene.extra.iter().filter(|(name, t)| rows(name, &t.shape)).map(|(name, _)| name.clone()).collect();
    dropped.iter().for_each(|name| drop(scene.extra.remove(name)));
    let notes = dropped.iter().map(|name| format!("tensor `{name}` goes: the merged scene has none")).collect();
    let keys_added = scene.deformation.key_times().len() as i64 - before as i64;
    Ok(Touched { gaussians: count, superpoints, keys_added, error_px: None, notes })
}

fn with_endless_lifespans(scene: &mut Scene) {
    let g = &mut scene.gaussians;
    if g.optional.get(LIFESPAN).is_none() {
        g.optional.set(LIFESPAN, [0.5, ENDLESS].repeat(g.len()));
    }
}

fn join_motion(scene: &mut Scene, other: &mut Scene) -> Result<()> {
    let [one, two] = [movable(scene, "a merge")?, movable(other, "a merge")?];
    if one == Moves::Still && two == Moves::Still {
        scene.deformation = Deformation::None;
        return Ok(());
    }
    for (s, rests, range) in
        [(&mut *scene, one == Moves::Still, other.time_range()), (other, two == Moves::Still, [0.0; 2])]
    {
        if rests {
            with_table(s, [range[0] as f32, range[0] as f32]);
        }
    }
    let (n, count) = (scene.gaussians.len(), other.gaussians.len());
    let Some(b) = other.deformation.superpoint_deformation() else { return Ok(()) };
    let Some(a) = scene.deformation.superpoint_deformation_mut() else { return Ok(()) };
    join(a, b, [n, count], [one == Moves::Still, two == Moves::Still])
}

/// Superpoints of `b` behind those of `a`. Who rests has no key times of its own.
fn join(a: &mut SuperpointDeformation, b: &SuperpointDeformation, counts: [usize; 2], rests: [bool; 2]) -> Result<()> {
    let (Some(x), Some(y)) = (&a.table, &b.table) else { return Ok(()) };
    let of = |table: &Motion, rests: bool| if rests { Vec::new() } else { table.times.clone() };
    let times = sorted(of(x, rests[0]).into_iter().chain(of(y, rests[1])).map(f64::from));
    check_keys(times.len(), "merge")?;
    let (x, y) = (resampled(x, &times), resampled(y, &times));
    let widths = [a.superpoints.position.len(), b.superpoints.position.len()];
    a.table = Some(Motion {
        rotation: side_by_side([&x.rotation, &y.rotation], widths, times.len()),
        translation: side_by_side([&x.translation, &y.translation], widths, times.len()),
        times,
    });
    let shift = widths[0] as u32;
    if a.blend.is_some() || b.blend.is_some() {
        a.blend = Some(join_blends(a, b, shift));
    }
    a.superpoints.of_gaussian.truncate(counts[0]);
    a.superpoints.of_gaussian.extend(b.superpoints.of_gaussian.iter().take(counts[1]).map(|j| j + shift));
    a.superpoints.position.extend_from_slice(&b.superpoints.position);
    Ok(())
}

fn side_by_side(rows: [&[[f32; 3]]; 2], widths: [usize; 2], count: usize) -> Vec<[f32; 3]> {
    let row =
        |k: usize| (0..2).flat_map(move |side| rows[side][k * widths[side]..(k + 1) * widths[side]].iter().copied());
    (0..count).flat_map(row).collect()
}

/// Rows of both, with as many slots as the wider one has: slots without weight behind the others.
fn join_blends(a: &SuperpointDeformation, b: &SuperpointDeformation, shift: u32) -> Blend {
    let of = |s: &SuperpointDeformation| s.blend.clone().unwrap_or_else(|| Blend::of_one(&s.superpoints.of_gaussian));
    let (a, b) = (of(a), of(b));
    let neighbors = a.neighbors.max(b.neighbors);
    let mut joined = Blend { neighbors, ..Blend::default() };
    for (blend, shift) in [(&a, 0), (&b, shift)] {
        for i in 0..blend.len() {
            let (index, weight) = blend.row(i);
            let free = neighbors - blend.neighbors;
            joined.index.extend(index.iter().map(|j| j + shift).chain(std::iter::repeat_n(index[0] + shift, free)));
            joined.weight.extend(weight.iter().copied().chain(std::iter::repeat_n(0.0, free)));
        }
    }
    joined
}
