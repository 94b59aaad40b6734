//! A shader's code as tokens, and the changes that are found in it.

use std::ops::Range;

use serde::{Deserialize, Serialize};

use crate::dev::mutants::lexer::{self, Token};

/// What kind of fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Fault {
    /// Another operator or another of a pair of functions.
    Operator,
    /// Another literal.
    Constant,
    /// A barrier that is not there.
    Barrier,
    /// A comparison or an index off by one, a condition that does not ask.
    Bound,
    /// An assignment that is not there.
    Store,
    /// An atomic operation that is plain or has another operand.
    Atomic,
    /// Another component of a vector.
    Swizzle,
}

/// One change of a text.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Site {
    /// The kind of fault.
    pub(crate) fault: Fault,
    /// The bytes that are replaced.
    pub(crate) range: Range<usize>,
    /// What takes their place.
    pub(crate) with: String,
}

/// A shader's text and the tokens of its code.
pub(super) struct Code<'a> {
    pub(super) text: &'a str,
    pub(super) tokens: Vec<Token>,
}

impl<'a> Code<'a> {
    pub(super) fn of(text: &'a str) -> Self {
        Self { text, tokens: code_tokens(text) }
    }

    /// The text of a token; empty past either end.
    pub(super) fn word(&self, at: usize) -> &'a str {
        self.tokens.get(at).map_or("", |t| &self.text[t.range.clone()])
    }

    pub(super) fn before(&self, at: usize) -> &'a str {
        at.checked_sub(1).map_or("", |before| self.word(before))
    }

    pub(super) fn kind(&self, at: usize) -> Option<lexer::Kind> {
        self.tokens.get(at).map(|t| t.kind)
    }

    pub(super) fn range(&self, at: usize) -> Range<usize> {
        self.tokens.get(at).map_or(self.text.len()..self.text.len(), |t| t.range.clone())
    }

    /// The bracket that closes the one at `open`.
    pub(super) fn close(&self, open: usize) -> Option<usize> {
        close(self.text, &self.tokens, open)
    }

    /// A value ends before this token, so that an operator here has two operands.
    pub(super) fn follows_value(&self, at: usize) -> bool {
        let Some(before) = at.checked_sub(1) else { return false };
        match self.kind(before) {
            Some(lexer::Kind::Number) => true,
            Some(lexer::Kind::Word) => self.word(before) != "return",
            _ => matches!(self.word(before), ")" | "]"),
        }
    }
}

/// The tokens outside declarations that are left alone.
fn code_tokens(text: &str) -> Vec<Token> {
    let all = lexer::tokens(text);
    let (mut at, mut kept) = (0, Vec::with_capacity(all.len()));
    while at < all.len() {
        match &text[all[at].range.clone()] {
            "layout" | "shared" | "struct" => at = end_of_declaration(text, &all, at),
            _ => {
                kept.push(all[at].clone());
                at += 1;
            }
        }
    }
    kept
}

/// The token after the `;` that ends a declaration.
fn end_of_declaration(text: &str, all: &[Token], mut at: usize) -> usize {
    while at < all.len() {
        match &text[all[at].range.clone()] {
            ";" => return at + 1,
            "{" => at = close(text, all, at).unwrap_or(all.len()),
            _ => {}
        }
        at += 1;
    }
    all.len()
}

fn close(text: &str, tokens: &[Token], open: usize) -> Option<usize> {
    let mut depth = 0_usize;
    for (at, token) in tokens.iter().enumerate().skip(open) {
        match &text[token.range.clone()] {
            "(" | "[" | "{" => depth += 1,
            ")" | "]" | "}" => depth = depth.checked_sub(1)?,
            _ => {}
        }
        if depth == 0 {
            return Some(at).filter(|at| *at > open);
        }
    }
    None
}
