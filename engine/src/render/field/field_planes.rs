//! Kernel `field_planes`: products of learned planes, scales·channels of each point, then zeros up to a multiple of 4.

use crate::error::Result;
use crate::gpu::interface::Call;
use crate::gpu::kernel::Tolerance;
use crate::gpu::{Groups, Recorder, Slice};
use crate::render::frame::Frame;
use crate::render::twin::{f32_at, set_f32, struct_at};
use crate::scene::field::{FIELD_PAIRS, FieldPlanes};

crate::gpu_struct! {
    /// Push constants of [`FIELD_PLANES`].
    pub struct FieldPlanesPush {
        /// Point of the first row.
        pub first_row: u32,
        /// Rows to write.
        pub rows: u32,
        /// Points in all: floats from one plane of `point` to the next.
        pub points: u32,
        /// Channels of every plane.
        pub channels: u32,
        /// Resolutions.
        pub scales: u32,
        /// What −1 of each axis is.
        pub low_x: f32,
        /// y.
        pub low_y: f32,
        /// z.
        pub low_z: f32,
        /// What 1 of each axis is.
        pub high_x: f32,
        /// y.
        pub high_y: f32,
        /// z.
        pub high_z: f32,
    }
}

impl FieldPlanesPush {
    /// What the planes say; the rows are the caller's.
    pub fn of(planes: &FieldPlanes) -> Self {
        let [[low_x, low_y, low_z], [high_x, high_y, high_z]] = planes.bounds;
        let (channels, scales) = (planes.channels as u32, planes.scales.len() as u32);
        Self { first_row: 0, rows: 0, points: 0, channels, scales, low_x, low_y, low_z, high_x, high_y, high_z }
    }

    /// Of `encoding`.
    fn columns(&self) -> u32 {
        (self.channels * self.scales).next_multiple_of(4)
    }
}

const THREADS: u32 = 256;

crate::gpu_buffers! {
    /// Buffers of [`FIELD_PLANES`].
    pub struct FieldPlanesBuffers {
        frame: Read Struct(Frame),
        /// `[3][points]`, world units.
        point: Read F32,
        /// All planes ([`pack_planes`]).
        plane: Read F32,
        /// `[scales][6][3]`: first float, width, height of each plane.
        plane_size: Read U32,
        /// `[rows, columns]`
        encoding: Write F32,
    }
}

crate::kernel! {
    /// Bilinear samples of six planes multiplied, for each resolution and channel.
    pub static FIELD_PLANES: FieldPlanesKernel = {
        name: "field_planes",
        doc: "deformation field: products of planes over space and time",
        local_size: THREADS,
        constants: (),
        push: FieldPlanesPush,
        buffers: FieldPlanesBuffers,
        twin: field_planes_twin,
        // Bilinear shares differ by an ulp of the place on a plane of up to some hundred values.
        tolerance: Tolerance { absolute: 1e-4, relative: 1e-4, flips: 0.0 },
        bytes: |work| work.get("rows") * 4 * (3 + work.get("channels") * work.get("scales")),
    }
}

/// Records it.
pub(super) fn record(r: &mut Recorder, push: FieldPlanesPush, buffers: FieldPlanesBuffers<Slice>) -> Result<()> {
    let items = u64::from(push.rows) * u64::from(push.columns());
    let groups = Groups::Direct(items.div_ceil(THREADS.into()));
    r.dispatch(&FIELD_PLANES, (), push, buffers, groups)
}

/// All planes `[height, width, channels]` one after another, and of each its first float, width and height.
pub fn pack_planes(planes: &FieldPlanes) -> (Vec<f32>, Vec<u32>) {
    let (mut values, mut sizes) = (Vec::new(), Vec::new());
    for plane in planes.scales.iter().flatten() {
        sizes.extend([values.len() as u32, plane.width as u32, plane.height as u32]);
        let area = plane.height * plane.width;
        values.extend((0..area).flat_map(|at| (0..planes.channels).map(move |c| plane.values[c * area + at])));
    }
    (values, sizes)
}

/// Lower index and share of the next.
fn place_along(v: f32, size: u32) -> (u32, f32) {
    let last = (size - 1) as f32;
    let place = (v + 1.0) * 0.5 * last;
    let place = if place >= 0.0 { place.min(last) } else { 0.0 };
    (place as u32, place - place.floor())
}

fn field_planes_twin(call: Call<'_, FieldPlanesKernel>) {
    let Call { push: p, buffers: b, .. } = call;
    let frame: Frame = struct_at(b.frame, 0);
    let (low, high) = ([p.low_x, p.low_y, p.low_z], [p.high_x, p.high_y, p.high_z]);
    let columns = p.columns();
    for row in 0..p.rows {
        let at = |axis: usize| {
            let x = f32_at(b.point, axis * p.points as usize + (p.first_row + row) as usize);
            (x - low[axis]) * 2.0 / (high[axis] - low[axis]) - 1.0
        };
        let place = [at(0), at(1), at(2), frame.time];
        for column in 0..columns {
            if column >= p.channels * p.scales {
                set_f32(b.encoding, (row * columns + column) as usize, 0.0);
                continue;
            }
            let (scale, channel) = (column / p.channels, column % p.channels);
            let sample = |i: usize| {
                let entry = 3 * (6 * scale as usize + i);
                let [first, width, height] = [0, 1, 2].map(|k| b.plane_size[entry + k]);
                let [(x0, wx), (y0, wy)] = [(FIELD_PAIRS[i][0], width), (FIELD_PAIRS[i][1], height)]
                    .map(|(c, size)| place_along(place[c], size));
                let (x1, y1) = ((x0 + 1).min(width - 1), (y0 + 1).min(height - 1));
                let value = |y: u32, x: u32| f32_at(b.plane, (first + (y * width + x) * p.channels + channel) as usize);
                let line = |y: u32| value(y, x0) * (1.0 - wx) + value(y, x1) * wx;
                line(y0) * (1.0 - wy) + line(y1) * wy
            };
            let product: f32 = (0..FIELD_PAIRS.len()).map(sample).product();
            set_f32(b.encoding, (row * columns + column) as usize, product);
        }
    }
}
