//! JSON whose values stay untyped until used, so that a wrong one can be named.

use std::path::Path;

use serde::de::DeserializeOwned;
use serde_json::Value;

use crate::error::{Error, Result};

/// Largest file accepted, bytes: some 90,000 frames. Parsed values take up to 16 times the text.
const MAX_FILE: u64 = 64 << 20;

/// Keys and values of an object.
pub(super) type Keys = serde_json::Map<String, Value>;

/// The text of a camera file.
pub(super) fn text(path: &Path) -> Result<Vec<u8>> {
    let length = std::fs::metadata(path).map_err(|e| Error::io(path, "open", e))?.len();
    if length > MAX_FILE {
        let what = format!("{} (bytes of a camera file)", path.display());
        return Err(Error::Limit { what, need: length.into(), have: MAX_FILE.into() });
    }
    std::fs::read(path).map_err(|e| Error::io(path, "read", e))
}

/// Whatever value a file holds; `expected` names the format.
pub(super) fn value(path: &Path, expected: &str) -> Result<Value> {
    any(&text(path)?, path, expected)
}

/// The object that a file holds; `expected` names the format.
pub(super) fn file(path: &Path, expected: &str) -> Result<Keys> {
    object(&text(path)?, path, expected)
}

/// An object in memory. Python writes `NaN` and `Infinity`, which JSON does not have: they become `null`, so that the error can name the key
/// instead of a column.
pub(super) fn object(text: &[u8], path: &Path, expected: &str) -> Result<Keys> {
    any(text, path, expected)
}

fn any<T: DeserializeOwned>(text: &[u8], path: &Path, expected: &str) -> Result<T> {
    let syntax = |e: serde_json::Error| {
        let at = format!("line {} column {}", e.line(), e.column());
        Error::corrupt(path, at, e.to_string(), expected)
    };
    serde_json::from_slice(text).or_else(|first| {
        let replaced = without_non_finite(text);
        if replaced == text { Err(syntax(first)) } else { serde_json::from_slice(&replaced).map_err(syntax) }
    })
}

fn without_non_finite(text: &[u8]) -> Vec<u8> {
    let mut out = Vec::with_capacity(text.len());
    let (mut i, mut in_string) = (0, false);
    while let Some(&byte) = text.get(i) {
        if in_string && byte == b'\\' {
            out.extend(&text[i..text.len().min(i + 2)]);
            i += 2;
            continue;
        }
        in_string ^= byte == b'"';
        let literal: Option<&[u8]> = [b"NaN".as_slice(), b"-Infinity", b"Infinity", b"-NaN"]
            .into_iter()
            .find(|literal| !in_string && text[i..].starts_with(literal));
        match literal {
            Some(literal) => {
                out.extend(b"null");
                i += literal.len();
            }
            None => {
                out.push(byte);
                i += 1;
            }
        }
    }
    out
}

/// A finite number.
pub(super) fn finite(value: &Value) -> Option<f64> {
    value.as_f64().filter(|v| v.is_finite())
}

/// A value as text, shortened.
pub(super) fn show(value: &Value) -> String {
    let text = value.to_string();
    match text.char_indices().nth(60) {
        Some((end, _)) => format!("`{}…`", &text[..end]),
        None => format!("`{text}`"),
    }
}
