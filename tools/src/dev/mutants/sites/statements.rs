//! Statements that are left out or changed: barriers, assignments, atomic operations.

use super::code::{Code, Fault, Site};
use crate::dev::mutants::lexer::Kind;

const ASSIGNMENTS: [&str; 11] = ["=", "+=", "-=", "*=", "/=", "%=", "&=", "|=", "^=", "<<=", ">>="];

pub(super) fn of(code: &Code<'_>, at: usize, found: &mut Vec<Site>) {
    barrier(code, at, found);
    store(code, at, found);
    atomic(code, at, found);
}

fn starts_statement(code: &Code<'_>, at: usize) -> bool {
    code.kind(at) == Some(Kind::Word) && matches!(code.before(at), "" | ";" | "{" | "}")
}

fn barrier(code: &Code<'_>, at: usize, found: &mut Vec<Site>) {
    let word = code.word(at);
    let is_barrier = word == "barrier" || word.contains("Barrier");
    if is_barrier && code.word(at + 1) == "(" && code.word(at + 3) == ";" {
        let range = code.range(at).start..code.range(at + 3).end;
        found.push(Site { fault: Fault::Barrier, range, with: String::new() });
    }
}

/// `a[i] = b;` is left out. Not `float a = b;`, which would not compile.
fn store(code: &Code<'_>, at: usize, found: &mut Vec<Site>) {
    if !starts_statement(code, at) || code.kind(at + 1) == Some(Kind::Word) {
        return;
    }
    let mut next = at + 1;
    while matches!(code.word(next), "[" | "." | "(") || code.kind(next) == Some(Kind::Word) {
        next = match code.word(next) {
            "." => next + 1,
            "[" | "(" => code.close(next).unwrap_or(next) + 1,
            _ => next + 1,
        };
    }
    if !ASSIGNMENTS.contains(&code.word(next)) {
        return;
    }
    if let Some(end) = (next..code.tokens.len()).find(|end| code.word(*end) == ";") {
        let range = code.range(at).start..code.range(end).end;
        found.push(Site { fault: Fault::Store, range, with: String::new() });
    }
}

/// `atomicAdd(a, b)` adds one more; as a statement of its own it also becomes `a += b`.
fn atomic(code: &Code<'_>, at: usize, found: &mut Vec<Site>) {
    let name = code.word(at);
    if !name.starts_with("atomic") || code.word(at + 1) != "(" {
        return;
    }
    let Some(close) = code.close(at + 1) else { return };
    let Some(comma) = top_level_comma(code, at + 2, close) else { return };
    let place = &code.text[code.range(at + 2).start..code.range(comma).start];
    let operand = code.range(comma).end..code.range(close).start;
    let value = code.text[operand.clone()].trim();
    let more = if name == "atomicMin" { "- 1" } else { "+ 1" };
    found.push(Site { fault: Fault::Atomic, range: operand.clone(), with: format!(" ({value}) {more}") });
    let plain = match name {
        "atomicAdd" => format!("{place} += {value}"),
        "atomicOr" => format!("{place} |= {value}"),
        "atomicMin" => format!("{place} = min({place}, {value})"),
        "atomicMax" => format!("{place} = max({place}, {value})"),
        _ => return,
    };
    if starts_statement(code, at) && code.word(close + 1) == ";" {
        let range = code.range(at).start..code.range(close).end;
        found.push(Site { fault: Fault::Atomic, range, with: plain });
    }
}

fn top_level_comma(code: &Code<'_>, mut at: usize, end: usize) -> Option<usize> {
    while at < end {
        match code.word(at) {
            "," => return Some(at),
            "(" | "[" => at = code.close(at)?,
            _ => {}
        }
        at += 1;
    }
    None
}
