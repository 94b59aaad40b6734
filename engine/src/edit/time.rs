//! The time of a selection: frozen, shifted, stretched, reversed, looped.
//!
//! T'(t) = T(m(t)). Between key times poses are linear in time, and m is linear in pieces: a table with the keys of m and those
//! times that m takes to old keys holds T' exactly, up to rounding of times to f32. Lifespans follow, or are an error.

use super::measure::Touched;
use super::split::{Moves, movable, split};
use super::table::{check_keys, resampled, sorted};
use crate::error::{Error, Result};
use crate::file::codec::sigmoid;
use crate::reference::table_poses;
use crate::scene::parameter::{LIFESPAN, lifespan_share};
use crate::scene::{Motion, Scene};

/// Log length of a lifespan that never shows: the share is 1 at every time.
pub(crate) const ENDLESS: f32 = 20.0;

/// Which old time is shown at a time t.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum TimeMap {
    /// This one, always.
    Freeze(f64),
    /// `rate`·t + `offset`, with a rate that is not 0.
    Linear {
        /// Old time that passes in a unit of new time.
        rate: f64,
        /// Old time at t = 0.
        offset: f64,
    },
    /// From `from` to `to`, again and again.
    Loop {
        /// Old time.
        from: f64,
        /// Later than `from`.
        to: f64,
    },
}

impl TimeMap {
    /// The old time that is shown at `t`.
    pub fn at(self, t: f64) -> f64 {
        match self {
            Self::Freeze(time) => time,
            Self::Linear { rate, offset } => rate * t + offset,
            Self::Loop { from, to } => from + (t - from).rem_euclid(to - from),
        }
    }

    /// Rejects maps that make no sense.
    fn check(self) -> Result<()> {
        let fine = match self {
            Self::Freeze(time) => time.is_finite(),
            Self::Linear { rate, offset } => rate.is_finite() && rate != 0.0 && offset.is_finite(),
            Self::Loop { from, to } => from.is_finite() && to.is_finite() && from < to,
        };
        let expected = "finite numbers, a rate other than 0, a loop that ends after it starts";
        if fine { Ok(()) } else { Err(Error::usage("time", format!("{self:?}"), expected)) }
    }
}

/// Gives the Gaussians of `mask` another time. The scene's range grows where a part moves before or after it.
///
/// # Errors
/// [`Error::Usage`] for models whose motion is no key-time table, for nothing that moves, for maps that make no sense, and for
/// loops of Gaussians with lifespans; [`Error::Limit`] for more key times than a table may have.
pub fn retime(scene: &mut Scene, mask: &[bool], map: TimeMap) -> Result<Touched> {
    map.check()?;
    let gaussians = mask.iter().filter(|m| **m).count();
    if gaussians == 0 || map == (TimeMap::Linear { rate: 1.0, offset: 0.0 }) {
        return Ok(Touched::default());
    }
    let moves = movable(scene, "a change of time")?;
    if moves == Moves::Still && scene.gaussians.optional.get(LIFESPAN).is_none() {
        return Err(Error::usage("time", "a model in which nothing moves", "one that moves"));
    }
    retime_lifespans(scene, mask, map)?;
    let part = split(scene, mask);
    let mut used = vec![false; scene.deformation.superpoint_count()];
    let others = (0..mask.len()).filter(|&i| !mask[i]);
    if let Some(s) = scene.deformation.superpoint_deformation() {
        others.flat_map(|i| s.slots(i)).for_each(|(j, _)| used[j] = true);
    }
    let alone = !used.contains(&true);
    let mut keys_added = 0;
    if let (Moves::Table, Some(table)) = (moves, scene.deformation.table_mut()) {
        let before = table.times.len() as i64;
        *table = retimed(table, &part, map, alone)?;
        keys_added = table.times.len() as i64 - before;
    }
    Ok(Touched { gaussians, superpoints: part.len(), keys_added, ..Touched::default() })
}

/// The table with another time for `part`; with `alone` no other superpoint needs the old key times.
fn retimed(table: &Motion, part: &[usize], map: TimeMap, alone: bool) -> Result<Motion> {
    let old = || table.times.iter().map(|&t| f64::from(t));
    let [first, last] = [old().next().unwrap_or(0.0), old().next_back().unwrap_or(0.0)];
    let mut knots: Vec<f64> = match map {
        TimeMap::Freeze(_) => old().collect(),
        TimeMap::Linear { rate, offset } => old().map(|t| (t - offset) / rate).collect(),
        TimeMap::Loop { from, to } => rounds(&table.times, from, to, [first, last])?,
    };
    if !alone {
        knots.extend(old());
    }
    let times = sorted(knots);
    check_keys(times.len(), "time")?;
    let (m, mut made) = (table.superpoint_count(), resampled(table, &times));
    for (k, &time) in times.iter().enumerate() {
        let poses = table_poses(table, shown(map, time));
        for &j in part {
            made.rotation[k * m + j] = poses[j].rotation.as_vec3().to_array();
            made.translation[k * m + j] = poses[j].translation.as_vec3().to_array();
        }
    }
    Ok(made)
}

/// The old time at a key. A round of a loop ends, at the loop's end, one f32 before the next one begins.
fn shown(map: TimeMap, key: f32) -> f64 {
    let time = f64::from(key);
    let TimeMap::Loop { from, to } = map else { return map.at(time) };
    let begins = (from + ((time - from) / (to - from)).round() * (to - from)) as f32;
    match key {
        key if key == begins => from,
        key if key == begins.next_down() => to,
        _ => map.at(time),
    }
}

/// Key times of all rounds of a loop within a range: the old ones of it, and two beside each other where a round begins.
fn rounds(times: &[f32], from: f64, to: f64, [first, last]: [f64; 2]) -> Result<Vec<f64>> {
    let length = to - from;
    let (begin, end) = (((first - from) / length).floor(), ((last - from) / length).ceil());
    let inside: Vec<f64> = times.iter().map(|&t| f64::from(t)).filter(|t| *t > from && *t < to).collect();
    let count = (end - begin).max(1.0) * (inside.len() + 2) as f64;
    check_keys(if count < 1e9 { count as usize } else { usize::MAX }, "time loop")?;
    let mut knots = vec![first, last];
    for round in begin as i64..=end as i64 {
        let start = from + round as f64 * length;
        knots.extend(inside.iter().map(|t| t + round as f64 * length));
        knots.extend([f64::from((start as f32).next_down()), f64::from(start as f32)]);
    }
    knots.retain(|t| (first..=last).contains(t));
    Ok(knots)
}

fn retime_lifespans(scene: &mut Scene, mask: &[bool], map: TimeMap) -> Result<()> {
    let g = &mut scene.gaussians;
    let Some(mut lifespans) = g.optional.get(LIFESPAN).map(<[f32]>::to_vec) else { return Ok(()) };
    for (i, row) in lifespans.chunks_exact_mut(2).enumerate().filter(|(i, _)| mask[*i]) {
        let [middle, log_length] = [f64::from(row[0]), f64::from(row[1])];
        match map {
            TimeMap::Freeze(time) => {
                let opacity = sigmoid(g.opacity_logit[i]) * lifespan_share(middle, log_length, time);
                // The logit of nothing at all has no number: this is 1e-13 of it.
                g.opacity_logit[i] = (opacity / (1.0 - opacity)).ln().max(-30.0) as f32;
                row.copy_from_slice(&[0.5, ENDLESS]);
            }
            TimeMap::Linear { rate, offset } => {
                row.copy_from_slice(&[((middle - offset) / rate) as f32, (log_length - rate.abs().ln()) as f32]);
            }
            TimeMap::Loop { .. } => {
                let found = format!("Gaussian {i}, which has a lifespan");
                return Err(Error::usage("time loop", found, "Gaussians without: a lifespan is one stretch of time"));
            }
        }
    }
    g.optional.set(LIFESPAN, lifespans);
    Ok(())
}
