//! A path that superpoints follow, on the device and in checkpoints.

use glam::DVec3;

use super::add_path::{self, AddPathBuffers, AddPathPush};
use crate::error::{Error, Result};
use crate::gpu::{Buffer, Gpu, Recorder, Slice};
use crate::train::saved::Saved;

/// Where an object goes.
#[derive(Debug, Clone)]
pub(in crate::train) struct Path {
    /// The object's centre as its Gaussians stand, world units; superpoints within `reach` are its own.
    pub(in crate::train) centre: DVec3,
    pub(in crate::train) reach: f64,
    /// Ascending, and where the centre is then from where it stands.
    pub(in crate::train) times: Vec<f32>,
    pub(in crate::train) offsets: Vec<[f32; 3]>,
}

/// The path, and which superpoints follow it.
#[derive(Debug)]
pub(in crate::train) struct FollowedPath {
    times: Vec<f32>,
    offsets: Vec<[f32; 3]>,
    follows: Vec<u32>,
    /// Of the three.
    buffers: [Buffer; 3],
}

impl FollowedPath {
    /// Of superpoints `[M,3]`, those within reach.
    pub(in crate::train) fn new(gpu: &Gpu, path: Path, superpoints: &[[f32; 3]]) -> Result<Self> {
        let near = |p: &[f32; 3]| (DVec3::from_array(p.map(f64::from)) - path.centre).length() <= path.reach;
        let follows = superpoints.iter().map(|p| u32::from(near(p))).collect();
        Self::from_parts(gpu, path.times, path.offsets, follows)
    }

    fn from_parts(gpu: &Gpu, times: Vec<f32>, offsets: Vec<[f32; 3]>, follows: Vec<u32>) -> Result<Self> {
        let buffers = [
            gpu.buffer_with("path_time", bytemuck::cast_slice(&times))?,
            gpu.buffer_with("path_offset", bytemuck::cast_slice(&offsets))?,
            gpu.buffer_with("follows", bytemuck::cast_slice(&follows))?,
        ];
        Ok(Self { times, offsets, follows, buffers })
    }

    /// Its times.
    pub(in crate::train) fn times(&self) -> &[f32] {
        &self.times
    }

    /// Bytes on the device.
    pub(in crate::train) fn bytes(&self) -> u64 {
        self.buffers.iter().map(Buffer::bytes).sum()
    }

    /// Records: `pose vec4[M][2]` moved along at `step.exact_time`.
    pub(in crate::train) fn record(&self, r: &mut Recorder, step: &Slice, pose: &Slice) -> Result<()> {
        let push = AddPathPush { superpoints: self.follows.len() as u32, times: self.times.len() as u32 };
        let [path_time, path_offset, follows] = self.buffers.each_ref().map(Slice::from);
        add_path::record(
            r,
            push,
            AddPathBuffers { step: step.clone(), path_time, path_offset, follows, pose: pose.clone() },
        )
    }

    /// Adds it to a checkpoint.
    pub(in crate::train) fn save(&self, saved: &mut Saved) {
        saved.put_floats("path.time", vec![self.times.len()], &self.times);
        saved.put_floats("path.offset", vec![self.offsets.len(), 3], self.offsets.as_flattened());
        saved.put_indices("path.follows", vec![self.follows.len()], &self.follows);
    }

    /// Of a checkpoint with this many superpoints; `None` where nothing follows a path.
    ///
    /// # Errors
    /// `Usage` naming the array that does not fit; `OutOfMemory`.
    pub(in crate::train) fn restore(gpu: &Gpu, saved: &Saved, superpoints: usize) -> Result<Option<Self>> {
        let Some(times) = times_of(saved)? else { return Ok(None) };
        let offsets = saved.floats("path.offset", Some(3 * times.len()))?.as_chunks().0.to_vec();
        let follows = saved.indices("path.follows", Some(superpoints))?;
        Self::from_parts(gpu, times, offsets, follows).map(Some)
    }
}

/// Times of the path of a checkpoint; `None` where there is none.
///
/// # Errors
/// `Usage` for times that do not ascend.
pub(in crate::train) fn times_of(saved: &Saved) -> Result<Option<Vec<f32>>> {
    if !saved.has("path.time") {
        return Ok(None);
    }
    let times = saved.floats("path.time", None)?;
    if times.is_empty() || !times.is_sorted_by(|a, b| a < b) {
        return Err(Error::usage(
            "path.time",
            format!("{} times, not all later than the one before", times.len()),
            "ascending times",
        ));
    }
    Ok(Some(times))
}
