//! Inputs for the render kernels: random and nasty Gaussians as the kernels' buffers, and the tile lists that the sort
//! would produce, made on the CPU.

use engine::render::deform_project::{
    DEFORM_PROJECT, DEFORM_PROJECT_THREADS, DeformProject, DeformProjectBuffers, DeformProjectConstants,
    DeformProjectPush,
};
use engine::render::ellipse::{Ellipse, quadrants_of_tile};
use engine::render::frame::{Frame, FrameOptions};
use engine::render::limits::INSTANCE_QUADRANT_SHIFT;
use engine::render::scan_tiles::tile_change_words;
use engine::render::superpoint_motion::PackedBlend;
use engine::render::twin::vec4_at;
use engine::scene::parameter::Optional;
use engine::scene::synthetic::random_optional;
use engine::scene::{Blend, Camera, Gaussians, Motion, Scene, SuperpointDeformation, Superpoints};
use glam::DVec3;

use crate::KernelCase;

/// A small deterministic random generator (splitmix64).
#[derive(Debug, Clone)]
pub struct Random(pub u64);

impl Random {
    /// 64 random bits.
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// Uniform in \[0, 1).
    pub fn unit(&mut self) -> f32 {
        (self.bits() >> 40) as f32 / (1_u64 << 24) as f32
    }

    /// Uniform in \[low, high).
    pub fn range(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.unit()
    }
}

/// Gaussians as the kernels' buffers (words of float, plane-major), with a pose table when moving.
#[derive(Debug, Clone, Default)]
pub struct RenderInput {
    /// N.
    pub count: usize,
    /// SH degree.
    pub degree: u32,
    /// `[3][N]`.
    pub mean: Vec<f32>,
    /// `[3][N]`.
    pub log_scale: Vec<f32>,
    /// `[N][4]` w, x, y, z.
    pub rotation: Vec<f32>,
    /// `[N]`.
    pub opacity_logit: Vec<f32>,
    /// Bands 0–3, plane-major.
    pub sh: [Vec<f32>; 4],
    /// `[N]`.
    pub superpoint_of_gaussian: Vec<u32>,
    /// `[T][M][2][4]`; empty when static.
    pub pose: Vec<f32>,
    /// M.
    pub superpoints: u32,
    /// Soft superpoints; none: each Gaussian moves with one.
    pub blend: Option<Blend>,
    /// `[10][N]`; empty without non-rigid offsets.
    pub nonrigid_offset: Vec<f32>,
    /// Optional parameters.
    pub optional: Optional,
    /// Whether splats keep the weight of their Gaussians.
    pub antialiased: bool,
}

impl RenderInput {
    /// N random Gaussians around the origin, of ordinary sizes, colours and opacities.
    pub fn random(count: usize, degree: u32, seed: u64) -> Self {
        let mut r = Random(seed);
        let mut fill = |n: usize, low: f32, high: f32| (0..n).map(|_| r.range(low, high)).collect::<Vec<f32>>();
        let band = |l: u32| if l <= degree { 3 * (2 * l as usize + 1) * count } else { 4 };
        Self {
            count,
            degree,
            mean: fill(3 * count, -1.5, 1.5),
            log_scale: fill(3 * count, -5.0, -2.0),
            rotation: fill(4 * count, -1.0, 1.0),
            opacity_logit: fill(count, -4.0, 5.0),
            sh: std::array::from_fn(|l| fill(band(l as u32), -0.6, 0.6)),
            superpoint_of_gaussian: vec![0; count.max(1)],
            pose: Vec::new(),
            superpoints: 0,
            blend: None,
            nonrigid_offset: Vec::new(),
            optional: Optional::default(),
            antialiased: false,
        }
    }

    /// Gives it random non-rigid offsets, some of which leave no scale.
    #[must_use]
    pub fn nonrigid(mut self, seed: u64) -> Self {
        let mut r = Random(seed);
        let bound = [0.05, 0.05, 0.05, 0.3, 0.3, 0.3, 0.3, 0.01, 0.01, 0.01];
        self.nonrigid_offset = (0..10 * self.count).map(|i| bound[i / self.count] * r.range(-1.0, 1.0)).collect();
        self
    }

    /// Gives it every optional parameter, near what it starts with.
    #[must_use]
    pub fn with_optional(mut self, seed: u64) -> Self {
        self.optional = random_optional(self.count, seed);
        self
    }

    /// Lets splats keep the weight of their Gaussians.
    #[must_use]
    pub fn antialiased(mut self) -> Self {
        self.antialiased = true;
        self
    }

    /// Gives it `superpoints` random poses at two keys.
    pub fn moving(mut self, superpoints: u32, seed: u64) -> Self {
        let mut r = Random(seed);
        self.superpoints = superpoints;
        self.superpoint_of_gaussian = (0..self.count).map(|_| (r.bits() % u64::from(superpoints)) as u32).collect();
        self.pose = (0..2 * superpoints * 2)
            .flat_map(|_| [r.range(-0.8, 0.8), r.range(-0.8, 0.8), r.range(-0.8, 0.8), 0.0])
            .collect();
        self
    }

    /// Makes the superpoints soft: `neighbors` of them move each Gaussian, with random weights, some of them 0 or alike. Poses
    /// turn by up to 300°, so that quaternions lie on either side.
    #[must_use]
    pub fn soft(mut self, neighbors: usize, seed: u64) -> Self {
        let mut r = Random(seed);
        let slots = neighbors * self.count;
        let index = (0..slots).map(|_| (r.bits() % u64::from(self.superpoints)) as u32).collect();
        let weight = |r: &mut Random| [0.0, 0.25, 0.25, r.unit(), r.unit()][(r.bits() % 5) as usize];
        let mut weight: Vec<f32> = (0..slots).map(|_| weight(&mut r)).collect();
        weight.iter_mut().step_by(neighbors).for_each(|w| *w = w.max(0.1));
        self.blend = Some(Blend { neighbors, index, weight });
        let turns = self.pose.chunks_exact_mut(4).step_by(2);
        turns.for_each(|r| r[..3].iter_mut().for_each(|x| *x *= 3.8));
        self
    }

    /// K of soft superpoints, or 0.
    pub fn blend_slots(&self) -> u32 {
        self.blend.as_ref().map_or(0, |b| b.neighbors as u32)
    }

    /// Words of `blend_index` and `blend_weight`.
    ///
    /// # Panics
    /// With too many superpoints.
    pub fn blend_words(&self) -> [Option<Vec<u32>>; 2] {
        let Some(blend) = &self.blend else { return [None, None] };
        let packed = PackedBlend::new(blend, self.superpoints as usize).unwrap();
        [Some(packed.index), Some(packed.weight.iter().map(|w| w.to_bits()).collect())]
    }

    /// Words of [`RenderInput::superpoint_of_gaussian`], where a kernel reads them.
    pub fn hard_superpoints(&self) -> Option<Vec<u32>> {
        (!self.pose.is_empty() && self.blend.is_none()).then(|| self.superpoint_of_gaussian.clone())
    }

    /// Puts a nasty value into about a third of the Gaussians: NaN, infinities, zero and huge quaternions, absurd scales,
    /// huge and tiny numbers, superpoints that do not exist.
    pub fn spoil(&mut self, seed: u64) {
        let mut r = Random(seed);
        let n = self.count;
        let nasty = [f32::NAN, f32::INFINITY, -f32::INFINITY, 0.0, -0.0, 1e-42, 1e38, -1e38, 1e15, 29.9, -29.9, 31.0];
        for g in 0..n {
            let value = nasty[(r.bits() % nasty.len() as u64) as usize];
            match r.bits() % 24 {
                0 => self.mean[(r.bits() % 3) as usize * n + g] = value,
                1 => self.log_scale[(r.bits() % 3) as usize * n + g] = value,
                2 => self.rotation[4 * g + (r.bits() % 4) as usize] = value,
                3 => self.rotation[4 * g..4 * g + 4].fill(value),
                4 => self.opacity_logit[g] = value,
                5 => self.sh[0][(r.bits() % 3) as usize * n + g] = value,
                6 => self.superpoint_of_gaussian[g] = u32::MAX - (r.bits() % 3) as u32,
                7 => (0..3).for_each(|c| self.log_scale[c * n + g] = r.range(-30.0, 30.0)),
                _ => {}
            }
        }
    }

    /// The same as a scene, key times 0 and 1.
    pub fn scene(&self) -> Scene {
        let n = self.count;
        let triple =
            |v: &[f32], g: usize, first: usize| -> [f32; 3] { std::array::from_fn(|c| v[(first + c) * n + g]) };
        let sh = (0..n).flat_map(|g| {
            (0..=self.degree as usize)
                .flat_map(move |l| (0..2 * l + 1).flat_map(move |k| triple(&self.sh[l], g, 3 * k)))
        });
        let gaussians = Gaussians {
            mean: (0..n).map(|g| triple(&self.mean, g, 0)).collect(),
            log_scale: (0..n).map(|g| triple(&self.log_scale, g, 0)).collect(),
            rotation: (0..n).map(|g| std::array::from_fn(|c| self.rotation[4 * g + c])).collect(),
            opacity_logit: self.opacity_logit.clone(),
            sh_degree: self.degree,
            sh: sh.collect(),
            optional: self.optional.clone(),
            antialiased: self.antialiased,
        };
        if self.pose.is_empty() {
            return Scene { gaussians, ..Scene::default() };
        }
        let part = |j: usize| self.pose.chunks_exact(8).map(move |p| [p[4 * j], p[4 * j + 1], p[4 * j + 2]]);
        let motion = Motion { times: vec![0.0, 1.0], rotation: part(0).collect(), translation: part(1).collect() };
        let superpoints = Superpoints {
            of_gaussian: self.superpoint_of_gaussian.clone(),
            position: vec![[0.0; 3]; self.superpoints as usize],
        };
        Scene {
            gaussians,
            deformation: SuperpointDeformation {
                blend: self.blend.clone(),
                ..SuperpointDeformation::of_table(superpoints, motion)
            }
            .into(),
            ..Scene::default()
        }
    }

    /// Kernel `deform_project` on these Gaussians.
    pub fn deform_project(&self, frame: &Frame) -> KernelCase<DeformProject> {
        let words = |v: &[f32]| v.iter().map(|x| x.to_bits()).collect::<Vec<u32>>();
        let groups = (self.count as u32).div_ceil(DEFORM_PROJECT_THREADS).max(1);
        let (moving, nonrigid) = (!self.pose.is_empty(), !self.nonrigid_offset.is_empty());
        let sh_band = |band: usize| (band <= self.degree as usize).then(|| words(&self.sh[band]));
        let constants = DeformProjectConstants {
            sh_degree: self.degree,
            motion: moving.into(),
            nonrigid: nonrigid.into(),
            optional: self.optional.present().0,
            blend: self.blend_slots(),
            antialiased: self.antialiased.into(),
            ..DeformProjectConstants::default()
        };
        let [blend_index, blend_weight] = self.blend_words();
        let buffers = DeformProjectBuffers {
            frame: bytemuck::cast_slice(&[*frame]).to_vec(),
            mean: words(&self.mean),
            log_scale: words(&self.log_scale),
            rotation: words(&self.rotation),
            opacity_logit: words(&self.opacity_logit),
            superpoint_of_gaussian: self.hard_superpoints(),
            pose: moving.then(|| words(&self.pose)),
            sh_0: words(&self.sh[0]),
            sh_1: sh_band(1),
            sh_2: sh_band(2),
            sh_3: sh_band(3),
            splats: vec![0; 12 * self.count],
            tile_count: vec![0; self.count],
            instance_block: vec![0; (groups + groups.div_ceil(256)) as usize],
            counters: vec![0; 8],
            nonrigid_offset: nonrigid.then(|| words(&self.nonrigid_offset)),
            optional: (!self.optional.is_empty()).then(|| words(&self.optional.to_device())),
            blend_index,
            blend_weight,
            tile_end: vec![0; tile_change_words(frame.tile_count) as usize],
            pairs: None,
        };
        let push = DeformProjectPush { block_capacity: groups };
        KernelCase { kernel: &DEFORM_PROJECT, constants, push, buffers, groups }
    }

    /// Kernel `deform_project` with lists, each of which has room for `frame.tile_room` pairs.
    pub fn deform_project_with_lists(&self, frame: &Frame) -> KernelCase<DeformProject> {
        let mut case = self.deform_project(frame);
        case.constants.lists = 1;
        case.buffers.pairs = Some(vec![0; 2 * (frame.tile_count * frame.tile_room) as usize]);
        case
    }

    /// A frame of these Gaussians.
    ///
    /// # Panics
    /// When the camera is refused.
    pub fn frame(&self, camera: &Camera) -> Frame {
        let options = FrameOptions {
            background: [0.1, 0.2, 0.3],
            time: 0.4,
            gaussians: self.count as u32,
            superpoints: self.superpoints,
            sh_degree: self.degree,
            interval: engine::scene::KeyInterval { first: 0, second: u32::from(self.superpoints > 0), weight: 0.3 },
            ..FrameOptions::default()
        };
        Frame::new(camera, DVec3::ZERO, &options).unwrap()
    }
}

/// A camera that looks at the origin from 4 units away.
pub fn test_camera(width: u32, height: u32) -> Camera {
    Camera::look_at(DVec3::new(1.2, -0.8, -3.7), DVec3::new(0.05, 0.02, 0.0), -DVec3::Y, 0.75, [width, height])
}

/// `ranges` and `values`: per tile the instances of visible Gaussians by depth, ties by index.
pub fn tile_lists(frame: &Frame, splats: &[u32], tile_count: &[u32]) -> (Vec<u32>, Vec<u32>) {
    let size = frame.size;
    let mut visible: Vec<usize> = (0..tile_count.len()).filter(|&g| tile_count[g] > 0).collect();
    visible.sort_by_key(|&g| splats[12 * g + 6]);
    let mut lists = vec![Vec::new(); frame.tile_count as usize];
    for g in visible {
        let e = Ellipse::of_splat(vec4_at(splats, 3 * g), vec4_at(splats, 3 * g + 1));
        let rows = e.tile_row_range(size);
        for row in rows[0]..rows[1] {
            let columns = e.tile_columns_of_row(row, size);
            let half_rows = e.half_rows_of_tile_row(row);
            for column in columns[0]..columns[1] {
                let instance = g as u32 | quadrants_of_tile(half_rows, column) << INSTANCE_QUADRANT_SHIFT;
                lists[(row * frame.tiles[0] + column) as usize].push(instance);
            }
        }
    }
    let (mut ranges, mut values) = (Vec::new(), Vec::new());
    for list in lists {
        let start = values.len() as u32;
        values.extend(list);
        ranges.extend([start, values.len() as u32]);
    }
    (ranges, values)
}
