//! How well one list of numbers foretells another.

/// Pearson's correlation; `None` where one of them does not vary.
pub fn correlation(a: &[f64], b: &[f64]) -> Option<f64> {
    let n = a.len().min(b.len());
    let mean = |v: &[f64]| v[..n].iter().sum::<f64>() / n.max(1) as f64;
    let (of_a, of_b) = (mean(a), mean(b));
    let sums = a.iter().zip(b).fold([0.0; 3], |[xy, xx, yy], (x, y)| {
        let (x, y) = (x - of_a, y - of_b);
        [xy + x * y, xx + x * x, yy + y * y]
    });
    let found = sums[0] / (sums[1] * sums[2]).sqrt();
    found.is_finite().then(|| found.clamp(-1.0, 1.0))
}

/// Spearman's correlation: that of the ranks, equal values sharing theirs.
pub fn rank_correlation(a: &[f64], b: &[f64]) -> Option<f64> {
    correlation(&ranks(a), &ranks(b))
}

fn ranks(values: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|&i, &j| values[i].total_cmp(&values[j]));
    let mut ranks = vec![0.0; values.len()];
    let mut first = 0;
    for same in order.chunk_by(|&i, &j| values[i].total_cmp(&values[j]).is_eq()) {
        let rank = first as f64 + (same.len() as f64 - 1.0) / 2.0;
        same.iter().for_each(|&i| ranks[i] = rank);
        first += same.len();
    }
    ranks
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;

    #[test]
    fn known_correlations_are_found() {
        let a = [1.0, 2.0, 3.0, 4.0, 5.0];
        let squares = a.map(|x| x * x);
        assert!((rank_correlation(&a, &squares).unwrap() - 1.0).abs() < 1e-12);
        // By hand: 60 / √(10·374).
        assert!((correlation(&a, &squares).unwrap() - 60.0 / 3740_f64.sqrt()).abs() < 1e-12);
        assert!((rank_correlation(&a, &a.map(|x| -x)).unwrap() + 1.0).abs() < 1e-12);
        // Equal values share a rank: ranks 0.5, 0.5, 2, 3 against 0, 1, 2, 3 make √0.9.
        let shared = rank_correlation(&[1.0, 1.0, 2.0, 3.0], &[1.0, 2.0, 3.0, 4.0]).unwrap();
        assert!((shared - 0.9_f64.sqrt()).abs() < 1e-12);
        assert_eq!(correlation(&a, &[2.0; 5]), None);
        assert_eq!(correlation(&[], &[]), None);
    }
}
