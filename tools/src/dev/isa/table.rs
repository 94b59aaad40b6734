//! The table for people.

use std::fmt::Write as _;

use super::statistics::{COLUMNS, Row};

/// One line per pipeline; `widest`: only the one of each kernel with the fewest subgroups in flight, then the highest cost.
pub fn text(rows: &[Row], widest: bool) -> String {
    let mut shown: Vec<&Row> = rows.iter().collect();
    if widest {
        let key = |r: &Row| (-r.statistics.occupancy, r.statistics.cost);
        shown.sort_by(|a, b| {
            a.kernel.cmp(&b.kernel).then(key(b).0.total_cmp(&key(a).0)).then(key(b).1.total_cmp(&key(a).1))
        });
        shown.dedup_by(|b, a| a.kernel == b.kernel);
    }
    let width = shown.iter().map(|r| r.name().len()).max().unwrap_or(0);
    let mut text = format!("{:width$}", "kernel");
    COLUMNS.iter().for_each(|c| {
        let _ = write!(text, " {:>12}", c.name);
    });
    for row in shown {
        let _ = write!(text, "\n{:width$}", row.name());
        COLUMNS.iter().for_each(|c| {
            let _ = write!(text, " {:>12}", (c.get)(&row.statistics));
        });
    }
    text
}
