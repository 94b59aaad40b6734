//! Other literals: 0 for 1, one more, one less, 1 % more, twice as much.

use super::code::{Code, Fault, Site};
use crate::dev::mutants::lexer::Kind;

pub(super) fn of(code: &Code<'_>, at: usize, found: &mut Vec<Site>) {
    if code.kind(at) != Some(Kind::Number) {
        return;
    }
    let others = others(code.word(at));
    found.extend(others.into_iter().map(|with| Site { fault: Fault::Constant, range: code.range(at), with }));
}

fn others(literal: &str) -> Vec<String> {
    let hexadecimal = literal.strip_prefix("0x");
    if hexadecimal.is_none() && literal.contains(['.', 'e', 'E']) {
        return literal.trim_end_matches('f').parse::<f64>().map_or_else(|_| Vec::new(), floats);
    }
    let digits = literal.trim_end_matches(['u', 'U']);
    let suffix = &literal[digits.len()..];
    let value = match hexadecimal {
        Some(_) => u32::from_str_radix(&digits[2..], 16),
        None => digits.parse(),
    };
    value.map_or_else(|_| Vec::new(), |value| integers(value).map(|other| format!("{other}{suffix}")).collect())
}

fn floats(value: f64) -> Vec<String> {
    let others = match value {
        0.0 => vec![1.0],
        1.0 => vec![0.0, 1.01],
        _ => vec![value * 1.01, value * 2.0],
    };
    others.into_iter().map(|other: f64| format!("{other:?}")).collect()
}

fn integers(value: u32) -> impl Iterator<Item = u32> {
    [value.checked_sub(1), value.checked_add(1)].into_iter().flatten()
}
