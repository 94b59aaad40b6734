//! Dense layers over many Gaussians on the CPU: 16 at a time, so that each weight is read once for all of them and the
//! inner loop is one multiply-add over a row of 16.

use crate::scene::Linear;

/// Gaussians that are evaluated together.
pub(super) const LANES: usize = 16;

/// A value of each of the Gaussians.
pub(super) type Row = [f32; LANES];

/// W x + b.
pub(super) fn dense(layer: &Linear, input: &[Row]) -> Vec<Row> {
    let output = |o: usize| {
        let mut sum = [layer.bias[o]; LANES];
        for (w, x) in layer.weight[o * layer.inputs..(o + 1) * layer.inputs].iter().zip(input) {
            for lane in 0..LANES {
                sum[lane] += w * x[lane];
            }
        }
        sum
    };
    (0..layer.outputs).map(output).collect()
}

/// max(0, x).
pub(super) fn relu(mut rows: Vec<Row>) -> Vec<Row> {
    rows.iter_mut().flatten().for_each(|v| *v = v.max(0.0));
    rows
}

/// `[x, sin(2⁰x), cos(2⁰x), sin(2¹x), …]`, each over all of `x` before the next.
pub(super) fn encode(x: &[Row], frequencies: usize) -> Vec<Row> {
    let mut out = x.to_vec();
    for k in 0..frequencies {
        let scale = (1u64 << k) as f32;
        out.extend(x.iter().map(|row| row.map(|v| (scale * v).sin())));
        out.extend(x.iter().map(|row| row.map(|v| (scale * v).cos())));
    }
    out
}

/// Component `axis` of up to 16 vectors; the rest 0.
pub(super) fn row(vectors: &[[f32; 3]], axis: usize) -> Row {
    std::array::from_fn(|lane| vectors.get(lane).map_or(0.0, |v| v[axis]))
}
