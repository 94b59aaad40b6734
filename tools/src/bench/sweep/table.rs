//! All settings as a table.

use super::measured::Measured;
use crate::report::page::{Align, Standing, Table};

/// The table of the terminal and of the page.
pub(super) fn table(results: &[Measured]) -> Table {
    let photos = results.iter().any(|r| r.photo_psnr.is_some());
    let mut columns = vec![
        ("setting", Align::Left),
        ("ms", Align::Right),
        ("speed", Align::Right),
        ("MB/frame", Align::Right),
        ("dispatches", Align::Right),
        ("PSNR dB", Align::Right),
        ("largest", Align::Right),
        ("> 1/255", Align::Right),
        ("FLIP", Align::Right),
    ];
    if photos {
        columns.push(("PSNR to photos", Align::Right));
    }
    columns.push(("", Align::Left));
    let mut table = Table::new(&columns);
    let exact = results.first().map_or(f64::NAN, Measured::ms);
    for r in results {
        let e = &r.error;
        let mut cells = vec![
            r.setting.name.clone(),
            format!("{:.2}", r.ms()),
            format!("{:.2}×", exact / r.ms()),
            format!("{:.2}", r.bytes as f64 / 1e6),
            r.dispatches.to_string(),
            format!("{:.1}", e.psnr),
            format!("{:.1e}", e.max),
            format!("{:.3} %", 100.0 * e.visible),
            format!("{:.4}", e.flip),
        ];
        if photos {
            cells.push(r.photo_psnr.map_or("–".into(), |p| format!("{p:.2}")));
        }
        cells.push(if r.pareto { "Pareto" } else { "" }.into());
        table.marked(if r.pareto { Standing::Good } else { Standing::Plain }, cells);
    }
    table
}
