//! Kernel `display`: a rendered frame as the 8-bit pixels of a window, without a way over the host.
//!
//! Reads `display` (sizes, ranges), `color vec4[H·W]`, `depth float[H·W]`, `ranges uint[2·tiles]`, `counters` and
//! `palette vec4[256]`. Writes `screen uint[H'·W']`, red in the lowest byte (or blue, where the window wants it so). A frame
//! that failed for want of room leaves `screen` as it was.

use super::limits::{COUNT_FAILED, TILE_SIZE};
use super::renderer::{FrameId, Renderer};
use super::twin::{f32_at, struct_at, vec4_at};
use crate::error::Result;
use crate::gpu::interface::Call;
use crate::gpu::kernel::{Tolerance, Workload};
use crate::gpu::{Buffer, Commands, Gpu, Groups, Memory, Suite};

/// Threads per workgroup, one pixel each.
pub const DISPLAY_THREADS: u32 = 256;
/// Colours of [`palette`].
pub const PALETTE_COLORS: u32 = 256;
/// Grey behind depths.
const EMPTY: f32 = 0.02;

crate::gpu_struct! {
    /// What `display` shows and where.
    #[doc(hidden)]
    pub struct Display {
        /// Width and height of the frame (pixels), tiles in x, 0.
        pub source: [u32; 4],
        /// Width and height of the window (pixels), 1 when blue is the lowest byte, 0.
        pub target: [u32; 4],
        /// Nearest depth (world units), one over the range of depths, one over the largest tile count, 0.
        pub range: [f32; 4],
    }
}

/// What of a frame is shown.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
#[repr(u32)]
pub enum DisplayMode {
    /// The picture.
    #[default]
    Color = 0,
    /// Expected depth Σ z w / Σ w, near red, far blue; needs [`RenderOptions::depth`](super::RenderOptions).
    Depth = 1,
    /// 1 − T.
    Opacity = 2,
    /// How many Gaussians each tile blends.
    Tiles = 3,
}

/// How a frame is shown.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DisplayOptions {
    /// What is shown.
    pub mode: DisplayMode,
    /// Window size, pixels.
    pub size: [u32; 2],
    /// Blue is the lowest byte.
    pub bgra: bool,
    /// Depths from the first to the last colour, world units.
    pub depth_range: [f32; 2],
    /// Gaussians of a tile that get the last colour.
    pub tile_range: f32,
}

crate::gpu_constants! {
    /// Specialisation constants of [`DISPLAY`].
    #[doc(hidden)]
    pub struct DisplayConstants {
        /// A [`DisplayMode`].
        mode,
        /// 1: the frame is not of the window's size.
        enlarged,
    }
}

crate::gpu_buffers! {
    /// Buffers of [`DISPLAY`].
    #[doc(hidden)]
    pub struct DisplayBuffers {
        display: Read Struct(Display),
        color: Read F32,
        /// Of a frame with depth.
        depth: optional Read F32,
        ranges: Read U32,
        counters: Read U32,
        palette: Read F32,
        screen: Write U32,
    }
}

crate::kernel! {
    /// Makes pixels of a window from frames.
    #[doc(hidden)]
    pub static DISPLAY: DisplayKernel = {
        name: "display",
        doc: "frame → 8-bit pixels of a window: colours, depth, opacity or tile counts",
        local_size: DISPLAY_THREADS,
        constants: DisplayConstants,
        push: (),
        buffers: DisplayBuffers,
        twin: display_twin,
        tolerance: Tolerance::EXACT,
        bytes: |work: &Workload| work.get("pixels") * (16 + 4),
    }
}

/// Frames on their way to a window: recordings for each frame in flight, and the pixels.
#[derive(Debug)]
pub struct Screen {
    gpu: Gpu,
    palette: Buffer,
    recorded: Option<Recorded>,
}

#[derive(Debug)]
struct Recorded {
    generation: u64,
    /// Of the window, pixels.
    size: [u32; 2],
    mode: DisplayMode,
    screen: Buffer,
    /// For frames of the window's size, and for smaller ones, which are enlarged.
    slots: Vec<(Buffer, [Commands; 2])>,
}

impl Screen {
    /// A screen without pixels.
    pub fn new(gpu: &Gpu) -> Result<Self> {
        gpu.ready_for(Suite::Packed)?;
        let palette = gpu.buffer_with("palette", bytemuck::cast_slice(&palette()))?;
        Ok(Self { gpu: gpu.clone(), palette, recorded: None })
    }

    /// Submits the conversion of a frame behind it; nothing is waited for but the same slot's last conversion. The pixels,
    /// `uint[H,W]`, are complete for what is submitted afterwards.
    ///
    /// # Errors
    /// `Usage` for a frame that is not one of the latest, `OutOfMemory`, `DeviceLost`.
    pub fn submit(&mut self, renderer: &Renderer, frame: FrameId, options: &DisplayOptions) -> Result<&Buffer> {
        let source = renderer.rendered_size();
        let size = options.size;
        let (generation, mode) = (renderer.generation(), options.mode);
        let current = |r: &Recorded| r.generation == generation && r.size == size && r.mode == mode;
        if !self.recorded.as_ref().is_some_and(current) {
            self.recorded = None;
            self.recorded = Some(self.record(renderer, size, mode)?);
        }
        let slot = renderer.slot_index(frame)?;
        let near = options.depth_range[0];
        let display = Display {
            source: [source[0], source[1], source[0].div_ceil(TILE_SIZE), 0],
            target: [options.size[0], options.size[1], u32::from(options.bgra), 0],
            range: [near, 1.0 / (options.depth_range[1] - near).max(1e-6), 1.0 / options.tile_range.max(1.0), 0.0],
        };
        let Some(recorded) = &mut self.recorded else {
            return Err(crate::Error::usage("screen", "no recording", "one per size"));
        };
        let (buffer, commands) = &mut recorded.slots[slot];
        for before in &*commands {
            self.gpu.wait_for(before)?;
        }
        let commands = &mut commands[usize::from(source != size)];
        buffer.write(0, bytemuck::bytes_of(&display))?;
        self.gpu.submit(commands)?;
        Ok(&recorded.screen)
    }

    /// The pixels of the latest frame, `uint[H,W]`; `None` before the first.
    pub fn pixels(&self) -> Option<(&Buffer, [u32; 2])> {
        self.recorded.as_ref().map(|r| (&r.screen, r.size))
    }

    fn record(&self, renderer: &Renderer, size: [u32; 2], mode: DisplayMode) -> Result<Recorded> {
        let pixels = u64::from(size[0]) * u64::from(size[1]);
        let screen = self.gpu.buffer("screen", pixels * 4, Memory::Device)?;
        let mut clear = self.gpu.recorder("clear screen");
        clear.fill(&screen, 0xFF00_0000)?;
        self.gpu.run(clear)?;
        let mut slots = Vec::new();
        for output in renderer.outputs() {
            let display = self.gpu.buffer("display", size_of::<Display>() as u64, Memory::Constants)?;
            let buffers = DisplayBuffers {
                display: display.whole(),
                color: output.color,
                depth: output.depth,
                ranges: output.ranges,
                counters: output.counters,
                palette: self.palette.whole(),
                screen: screen.whole(),
            };
            let commands = |enlarged: u32| {
                let mut recorder = self.gpu.recorder("display");
                let groups = Groups::Direct(pixels.div_ceil(u64::from(DISPLAY_THREADS)));
                let constants = DisplayConstants { mode: mode as u32, enlarged };
                recorder.dispatch(&DISPLAY, constants, (), buffers.clone(), groups)?;
                recorder.finish()
            };
            slots.push((display.clone(), [commands(0)?, commands(1)?]));
        }
        Ok(Recorded { generation: renderer.generation(), size, mode, screen, slots })
    }
}

/// Colours from dark blue over green and yellow to dark red, in the manner of the "turbo" map (A. Mikhailov, 2019): cubic
/// interpolation of nine colours, sampled at [`PALETTE_COLORS`] points.
pub fn palette() -> Vec<[f32; 4]> {
    const ANCHORS: [[f32; 3]; 9] = [
        [0.19, 0.07, 0.23],
        [0.27, 0.35, 0.80],
        [0.24, 0.61, 0.99],
        [0.10, 0.85, 0.79],
        [0.39, 0.98, 0.40],
        [0.75, 0.96, 0.20],
        [0.97, 0.73, 0.21],
        [0.94, 0.36, 0.08],
        [0.55, 0.05, 0.01],
    ];
    let last = ANCHORS.len() - 1;
    let at = |i: isize, c: usize| ANCHORS[i.clamp(0, last as isize) as usize][c];
    let color = |index: u32| {
        let x = index as f32 / (PALETTE_COLORS - 1) as f32 * last as f32;
        let i = (x as usize).min(last - 1);
        let t = x - i as f32;
        let channel = |c: usize| {
            let i = i as isize;
            let [p0, p1, p2, p3] = [at(i - 1, c), at(i, c), at(i + 1, c), at(i + 2, c)];
            let curve = 2.0 * p0 - 5.0 * p1 + 4.0 * p2 - p3 + t * (3.0 * (p1 - p2) + p3 - p0);
            (p1 + 0.5 * t * (p2 - p0 + t * curve)).clamp(0.0, 1.0)
        };
        [channel(0), channel(1), channel(2), 1.0]
    };
    (0..PALETTE_COLORS).map(color).collect()
}

fn mix(a: f32, b: f32, w: f32) -> f32 {
    a * (1.0 - w) + b * w
}

/// Clamped to 0 to 1; NaN becomes 0.
fn unit(v: f32) -> f32 {
    if v.is_nan() { 0.0 } else { v.clamp(0.0, 1.0) }
}

/// Bilinear sample for pixel `at` of the window.
fn enlarged(d: &Display, color: &[u32], at: [u32; 2]) -> [f32; 3] {
    let axis = |k: usize| {
        let p = (at[k] as f32 + 0.5) * (d.source[k] as f32 / d.target[k] as f32) - 0.5;
        let most = (d.source[k] - 1) as f32;
        let low = p.floor().clamp(0.0, most);
        (low as usize, (low + 1.0).min(most) as usize, (p - low).clamp(0.0, 1.0))
    };
    let ((x0, x1, wx), (y0, y1, wy)) = (axis(0), axis(1));
    let pixel = |x: usize, y: usize| vec4_at(color, y * d.source[0] as usize + x);
    std::array::from_fn(|c| {
        let top = mix(pixel(x0, y0)[c], pixel(x1, y0)[c], wx);
        mix(top, mix(pixel(x0, y1)[c], pixel(x1, y1)[c], wx), wy)
    })
}

fn display_twin(call: Call<'_, DisplayKernel>) {
    let Call { constants, buffers: b, .. } = call;
    let d: Display = struct_at(b.display, 0);
    if b.counters[COUNT_FAILED as usize] != 0 {
        return;
    }
    for index in 0..d.target[0] * d.target[1] {
        let shown = shown(&b, constants, &d, [index % d.target[0], index / d.target[0]]);
        let mut level = shown.map(|v| (unit(v) * 255.0 + 0.5) as u32);
        if d.target[2] == 1 {
            level.reverse();
        }
        b.screen[index as usize] = level[0] | level[1] << 8 | level[2] << 16 | 0xFF00_0000;
    }
}

fn shown(b: &DisplayBuffers<&mut [u32]>, constants: DisplayConstants, d: &Display, at: [u32; 2]) -> [f32; 3] {
    let nearest: [u32; 2] = std::array::from_fn(|k| {
        let p = (at[k] as f32 + 0.5) * d.source[k] as f32 / d.target[k] as f32;
        (p as u32).min(d.source[k] - 1)
    });
    let from = (nearest[1] * d.source[0] + nearest[0]) as usize;
    let [red, green, blue, alpha] = vec4_at(b.color, from);
    let palette = |x: f32| vec4_at(b.palette, (x.clamp(0.0, 1.0) * 255.0 + 0.5) as usize);
    match constants.mode {
        0 if constants.enlarged == 0 => [red, green, blue],
        0 => enlarged(d, b.color, at),
        1 => {
            let z = f32_at(b.depth.as_deref().unwrap_or_default(), from) / alpha.max(1e-6);
            let [r, g, b, _] = palette(1.0 - (z - d.range[0]) * d.range[1]);
            [r, g, b].map(|v| mix(EMPTY, v, alpha))
        }
        2 => [alpha; 3],
        _ => {
            let tile = (nearest[1] / TILE_SIZE * d.source[2] + nearest[0] / TILE_SIZE) as usize;
            let count = b.ranges[2 * tile + 1].wrapping_sub(b.ranges[2 * tile]) as f32;
            let [r, g, b] = [red, green, blue].map(unit);
            let grey = r * 0.25 + g * 0.5 + b * 0.25;
            let line = if nearest.iter().any(|n| n % TILE_SIZE == 0) { 0.8 } else { 1.0 };
            let [r, g, b, _] = palette((count * d.range[2]).sqrt());
            [r, g, b].map(|v| line * (0.85 * v + 0.15 * grey))
        }
    }
}
