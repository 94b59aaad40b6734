//! Twin of `glsl/lib/ellipse.glsl`, line by line, in f32: the set of pixels that a splat reaches, u² + v² ≤
//! log2_opacity + log2(1/cut) with u = l11·dx + l12·dy, v = l22·dy. Slightly conservative; NaN gives "empty".

use super::limits::TILE_SIZE;

/// log2(255).
pub const LOG2_255: f32 = 7.994_353_4;
/// Enlarges the threshold.
pub const ELLIPSE_SLACK: f32 = 1e-4;
/// Enlarges an interval, px.
pub const INTERVAL_SLACK_PX: f32 = 1e-3;
/// The same, relative to the lengths that enter it.
pub const INTERVAL_SLACK: f32 = 1e-6;
/// Coefficients and centres past this are refused.
pub const ELLIPSE_FAR_PX: f32 = 1e30;

/// A splat's footprint on the image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ellipse {
    /// Centre, px.
    pub mean: [f32; 2],
    /// Cholesky factor of the conic times sqrt(log2(e)/2), 1/px.
    pub l11: f32,
    /// See `l11`.
    pub l12: f32,
    /// See `l11`.
    pub l22: f32,
    /// log2 of the opacity.
    pub log2_opacity: f32,
    /// log2(1/cut): the smallest α that counts, 1/255 by definition.
    pub log2_cut: f32,
    /// The tiles of the bounding box, not of the ellipse.
    pub boxed: bool,
}

impl Ellipse {
    /// Nothing, as the definition counts tiles.
    pub const NONE: Self =
        Self { mean: [0.0; 2], l11: 0.0, l12: 0.0, l22: 0.0, log2_opacity: 0.0, log2_cut: LOG2_255, boxed: false };

    /// From the first two `vec4` of a splat.
    pub fn of_splat(first: [f32; 4], second: [f32; 4]) -> Self {
        Self {
            mean: [first[0], first[1]],
            l11: first[2],
            l12: first[3],
            l22: second[0],
            log2_opacity: second[1],
            ..Self::NONE
        }
    }

    /// With specialisation constants `ALPHA_CUT` and `TILE_CULL`.
    #[must_use]
    pub fn with_constants(self, alpha_cut: u32, tile_cull: u32) -> Self {
        Self { log2_cut: log2_cut(alpha_cut), boxed: tile_cull == 1, ..self }
    }

    /// Enlarged threshold of u² + v²; not positive when the splat is too faint to reach the cut anywhere.
    pub fn threshold(&self) -> f32 {
        let t = self.log2_opacity + self.log2_cut;
        t + ELLIPSE_SLACK * (t.abs() + 1.0)
    }

    fn is_valid(&self, threshold: f32) -> bool {
        threshold > 0.0
            && threshold < ELLIPSE_FAR_PX
            && self.l11 > 0.0
            && self.l22 > 0.0
            && self.l11 < ELLIPSE_FAR_PX
            && self.l22 < ELLIPSE_FAR_PX
            && self.l12.abs() < ELLIPSE_FAR_PX
            && self.mean[0].abs() < ELLIPSE_FAR_PX
            && self.mean[1].abs() < ELLIPSE_FAR_PX
    }

    /// Range of x (px) of the ellipse over y in \[`y_low`, `y_high`\] (px, both included); low > high when empty.
    pub fn row_interval(&self, y_low: f32, y_high: f32) -> [f32; 2] {
        let t = self.threshold();
        let valid = self.is_valid(t);
        let radius = t.max(0.0).sqrt();
        let v_low = (self.l22 * (y_low - self.mean[1])).max(-radius);
        let v_high = (self.l22 * (y_high - self.mean[1])).min(radius);
        let k = self.l12 / self.l22;
        let v_peak = -k * radius / (1.0 + k * k).sqrt();
        let v_right = v_peak.max(v_low).min(v_high);
        let v_left = (-v_peak).max(v_low).min(v_high);
        let reach_right = (t - v_right * v_right).max(0.0).sqrt();
        let reach_left = (t - v_left * v_left).max(0.0).sqrt();
        let right = (reach_right - k * v_right) / self.l11;
        let left = (-reach_left - k * v_left) / self.l11;
        let largest = (radius + k.abs() * v_right.abs().max(v_left.abs())) / self.l11;
        let slack = INTERVAL_SLACK_PX + INTERVAL_SLACK * (largest + self.mean[0].abs());
        let low = self.mean[0] + left - slack;
        let high = self.mean[0] + right + slack;
        if valid && v_low <= v_high && low <= high { [low, high] } else { [1.0, 0.0] }
    }

    /// First and last + 1 tile row that the ellipse may reach; \[0, 0\] when there is none. `size` in pixels.
    pub fn tile_row_range(&self, size: [u32; 2]) -> [u32; 2] {
        let t = self.threshold();
        let valid = self.is_valid(t);
        let reach = t.max(0.0).sqrt() / self.l22;
        let slack = INTERVAL_SLACK_PX + INTERVAL_SLACK * (reach + self.mean[1].abs());
        let low = self.mean[1] - reach - slack;
        let high = self.mean[1] + reach + slack;
        let rows = if valid && low <= high { pixels_of_interval(low, high, size[1]) } else { [0, 0] };
        if rows[0] < rows[1] { [rows[0] / TILE_SIZE, (rows[1] - 1) / TILE_SIZE + 1] } else { [0, 0] }
    }

    /// First and last + 1 tile column that the ellipse reaches in one tile row; \[0, 0\] when there is none.
    pub fn tile_columns_of_row(&self, tile_row: u32, size: [u32; 2]) -> [u32; 2] {
        let y_low = (tile_row * TILE_SIZE) as f32 + 0.5;
        let y_high = (tile_row * TILE_SIZE + TILE_SIZE).min(size[1]) as f32 - 0.5;
        let (y_low, y_high) = if self.boxed { (-ELLIPSE_FAR_PX, ELLIPSE_FAR_PX) } else { (y_low, y_high) };
        let x = self.row_interval(y_low, y_high);
        let columns = if x[0] <= x[1] { pixels_of_interval(x[0], x[1], size[0]) } else { [0, 0] };
        if columns[0] < columns[1] { [columns[0] / TILE_SIZE, (columns[1] - 1) / TILE_SIZE + 1] } else { [0, 0] }
    }

    /// The ellipse in the upper and the lower eight rows of a tile row: the range of x of each, \[1, 0\] when it is empty.
    pub fn half_rows_of_tile_row(&self, tile_row: u32) -> [[f32; 2]; 2] {
        let y = (tile_row * TILE_SIZE) as f32 + 0.5;
        [self.row_interval(y, y + 7.0), self.row_interval(y + 8.0, y + 15.0)]
    }

    /// Number of tiles the ellipse reaches: the one definition of `tile_count`.
    pub fn tile_count(&self, size: [u32; 2]) -> u32 {
        let rows = self.tile_row_range(size);
        (rows[0]..rows[1])
            .map(|row| {
                let columns = self.tile_columns_of_row(row, size);
                columns[1] - columns[0]
            })
            .sum()
    }
}

/// The quadrants of 8×8 pixels of a tile that an ellipse reaches, given [`Ellipse::half_rows_of_tile_row`] of the tile's row: bits
/// 0 upper left, 1 upper right, 2 lower left, 3 lower right.
pub fn quadrants_of_tile(half_rows: [[f32; 2]; 2], tile_column: u32) -> u32 {
    let x = (tile_column * TILE_SIZE) as f32 + 0.5;
    let reached = |half: usize, right: usize| {
        let [low, high] = half_rows[half];
        let first = x + [0.0, 8.0][right];
        low <= first + 7.0 && high >= first
    };
    (0..4).map(|q| u32::from(reached(q / 2, q % 2)) << q).sum()
}

/// log2(1/cut) of specialisation constant `ALPHA_CUT`.
pub fn log2_cut(alpha_cut: u32) -> f32 {
    if alpha_cut == 0 { LOG2_255 } else { f32::from_bits(alpha_cut) }
}

/// First and last + 1 pixel whose centre (i + 0.5) lies in \[low, high\], within 0..count; \[0, 0\] when there is none.
pub fn pixels_of_interval(low: f32, high: f32, count: u32) -> [u32; 2] {
    let first = (low - 0.5).ceil().max(0.0);
    let end = ((high - 0.5).floor() + 1.0).min(count as f32);
    if first < end { [first as u32, end as u32] } else { [0, 0] }
}
