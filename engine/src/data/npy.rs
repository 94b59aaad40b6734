//! Matrices of NumPy `.npy` files.

use std::path::Path;

use npyz::{DType, NpyFile, Order, TypeChar};

use crate::error::{Error, Result};

/// Largest file accepted, bytes: some 44 million points of three doubles.
const MAX_FILE: u64 = 1 << 30;

/// A `[rows, columns]` array of float32 or float64, row-major.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Matrix {
    pub(super) columns: usize,
    pub(super) values: Vec<f64>,
}

impl Matrix {
    /// The rows.
    pub(super) fn rows(&self) -> impl ExactSizeIterator<Item = &[f64]> {
        self.values.chunks_exact(self.columns)
    }
}

/// Reads a matrix with `columns` columns and finite values.
pub(super) fn read(path: &Path, columns: usize) -> Result<Matrix> {
    let length = std::fs::metadata(path).map_err(|e| Error::io(path, "open", e))?.len();
    if length > MAX_FILE {
        let what = format!("{} (bytes of a matrix)", path.display());
        return Err(Error::Limit { what, need: length.into(), have: MAX_FILE.into() });
    }
    parse(&std::fs::read(path).map_err(|e| Error::io(path, "read", e))?, path, columns)
}

fn parse(bytes: &[u8], path: &Path, columns: usize) -> Result<Matrix> {
    let expected = format!("float32 or float64 [n, {columns}]");
    let header = |found: String| Error::corrupt(path, "header", found, &expected);
    let file = NpyFile::new(bytes).map_err(|e| header(e.to_string()))?;
    let shape = file.shape().to_vec();
    let row_major = file.order() == Order::C;
    let [rows, found_columns] = shape[..] else { return Err(header(format!("shape {shape:?}"))) };
    if found_columns != columns as u64 || rows == 0 {
        return Err(header(format!("shape {shape:?}")));
    }
    let (kind, size) = match file.dtype() {
        DType::Plain(kind) => (kind.type_char(), kind.size_field()),
        other => return Err(header(format!("type {}", other.descr()))),
    };
    // The count is the header's word: checked against the bytes before memory is taken.
    let needed = u128::from(rows) * columns as u128 * u128::from(size.max(1));
    if needed > bytes.len() as u128 {
        return Err(header(format!("shape {shape:?} in {} bytes", bytes.len())));
    }
    let broken = |e: std::io::Error| Error::corrupt(path, "data", e.to_string(), &expected);
    let mut values: Vec<f64> = match (kind, size) {
        (TypeChar::Float, 4) => file.into_vec::<f32>().map_err(broken)?.into_iter().map(f64::from).collect(),
        (TypeChar::Float, 8) => file.into_vec().map_err(broken)?,
        _ => return Err(header(format!("type {kind:?} of {size} bytes"))),
    };
    if !row_major {
        let rows = values.len() / columns;
        values = (0..values.len()).map(|i| values[(i % columns) * rows + i / columns]).collect();
    }
    if let Some(at) = values.iter().position(|v| !v.is_finite()) {
        let at_text = format!("row {} column {}", at / columns, at % columns);
        return Err(Error::corrupt(path, at_text, values[at].to_string(), "a finite number"));
    }
    Ok(Matrix { columns, values })
}
