//! A palette of SH coefficients: Gaussians with similar ones share a row.

/// Rows that 16-bit labels can name.
const MAX_ROWS: usize = 65_536;

/// Rows of a palette and, of each Gaussian, its row.
pub(super) struct Palette {
    /// `[rows, width]`.
    pub(super) rows: Vec<f32>,
    pub(super) labels: Vec<u16>,
}

/// Divides `[N, width]` values into at most 65,536 groups, each by the middle of its widest coordinate (median cut), and
/// gives every group its mean. Few Gaussians keep their own row each.
pub(super) fn palette(values: &[f32], width: usize) -> Palette {
    let n = values.len() / width;
    let mut indices: Vec<u32> = (0..n as u32).collect();
    let mut groups = Vec::new();
    let mut labels = vec![0; n];
    split(values, width, &mut indices, MAX_ROWS, &mut |group: &[u32]| {
        let label = groups.len() / width;
        group.iter().for_each(|&i| labels[i as usize] = label as u16);
        for c in 0..width {
            let sum: f64 = group.iter().map(|&i| f64::from(values[i as usize * width + c])).sum();
            groups.push((sum / group.len() as f64) as f32);
        }
    });
    Palette { rows: groups, labels }
}

/// Divides `group` into at most `parts` groups.
fn split(values: &[f32], width: usize, group: &mut [u32], parts: usize, emit: &mut impl FnMut(&[u32])) {
    if group.is_empty() {
        return;
    }
    let value = |i: u32, c: usize| values[i as usize * width + c];
    let spread = |c: usize| {
        let (mut sum, mut squares) = (0.0, 0.0);
        for &i in group.iter() {
            let v = f64::from(value(i, c));
            (sum, squares) = (sum + v, squares + v * v);
        }
        squares - sum * sum / group.len() as f64
    };
    let spreads = (0..width).map(|c| (spread(c), c));
    let (widest, axis) = spreads.max_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((0.0, 0));
    if parts <= 1 || group.len() == 1 || widest <= 0.0 {
        return emit(group);
    }
    let middle = group.len() / 2;
    group.select_nth_unstable_by(middle, |&a, &b| value(a, axis).total_cmp(&value(b, axis)));
    let (low, high) = group.split_at_mut(middle);
    split(values, width, low, parts / 2, emit);
    split(values, width, high, parts - parts / 2, emit);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_rows_are_kept_and_many_are_grouped() {
        let values: Vec<f32> = (0..300).map(|i| (i / 3 % 50) as f32).collect();
        let p = palette(&values, 3);
        assert!((0..100).all(|i| p.rows[3 * usize::from(p.labels[i])] == values[3 * i]), "{:?}", p.rows);
        let many: Vec<f32> = (0..70_000).map(|i| (i as f32).sin()).collect();
        let p = palette(&many, 1);
        let worst = (0..70_000).map(|i| (p.rows[usize::from(p.labels[i])] - many[i]).abs()).fold(0.0, f32::max);
        assert!(p.rows.len() <= 65_536 && worst < 1e-3, "{} rows, {worst}", p.rows.len());
    }
}
