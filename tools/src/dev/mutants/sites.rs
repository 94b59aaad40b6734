//! What can be changed in a shader: single faults that a programmer could have made.

use std::ops::Range;

use serde::{Deserialize, Serialize};

use super::lexer::{self, Token};

mod numbers;
mod statements;

/// What kind of fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Fault {
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

/// All kinds, in the order in which mutants are drawn from them.
pub(super) const FAULTS: [Fault; 7] =
    [Fault::Operator, Fault::Constant, Fault::Barrier, Fault::Bound, Fault::Store, Fault::Atomic, Fault::Swizzle];

/// One change of a text.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Site {
    /// The kind of fault.
    pub(super) fault: Fault,
    /// The bytes that are replaced.
    pub(super) range: Range<usize>,
    /// What takes their place.
    pub(super) with: String,
}

/// Operators and functions and what they are mistaken for.
const SWAPS: [(Fault, &str, &str); 34] = [
    (Fault::Operator, "+", "-"),
    (Fault::Operator, "-", "+"),
    (Fault::Operator, "*", "/"),
    (Fault::Operator, "/", "*"),
    (Fault::Operator, "%", "/"),
    (Fault::Operator, "+=", "-="),
    (Fault::Operator, "-=", "+="),
    (Fault::Operator, "*=", "/="),
    (Fault::Operator, "/=", "*="),
    (Fault::Operator, "|=", "&="),
    (Fault::Operator, "&=", "|="),
    (Fault::Operator, "++", "--"),
    (Fault::Operator, "--", "++"),
    (Fault::Operator, "&&", "||"),
    (Fault::Operator, "||", "&&"),
    (Fault::Operator, "&", "|"),
    (Fault::Operator, "|", "&"),
    (Fault::Operator, "^", "|"),
    (Fault::Operator, "<<", ">>"),
    (Fault::Operator, ">>", "<<"),
    (Fault::Operator, "==", "!="),
    (Fault::Operator, "!=", "=="),
    (Fault::Bound, "<", "<="),
    (Fault::Bound, "<=", "<"),
    (Fault::Bound, ">", ">="),
    (Fault::Bound, ">=", ">"),
    (Fault::Operator, "min", "max"),
    (Fault::Operator, "max", "min"),
    (Fault::Operator, "subgroupMin", "subgroupMax"),
    (Fault::Operator, "subgroupMax", "subgroupMin"),
    (Fault::Operator, "subgroupInclusiveAdd", "subgroupExclusiveAdd"),
    (Fault::Operator, "subgroupAny", "subgroupAll"),
    (Fault::Operator, "subgroupAll", "subgroupAny"),
    (Fault::Operator, "sin", "cos"),
];

/// Every change of a shader. Declarations of buffers, constants of specialisation, structures and shared memory stay as they
/// are: the first are checked against Rust, and more memory is no fault.
pub(super) fn sites(text: &str) -> Vec<Site> {
    let code = Code { text, tokens: code_tokens(text) };
    let mut found = Vec::new();
    for at in 0..code.tokens.len() {
        code.swap(at, &mut found);
        code.swizzle(at, &mut found);
        code.index(at, &mut found);
        code.condition(at, &mut found);
        statements::of(&code, at, &mut found);
        numbers::of(&code, at, &mut found);
    }
    found
}

/// A shader's text and the tokens of its code.
struct Code<'a> {
    text: &'a str,
    tokens: Vec<Token>,
}

impl<'a> Code<'a> {
    /// The text of a token; empty past either end.
    fn word(&self, at: usize) -> &'a str {
        self.tokens.get(at).map_or("", |t| &self.text[t.range.clone()])
    }

    fn before(&self, at: usize) -> &'a str {
        at.checked_sub(1).map_or("", |before| self.word(before))
    }

    fn kind(&self, at: usize) -> Option<lexer::Kind> {
        self.tokens.get(at).map(|t| t.kind)
    }

    fn range(&self, at: usize) -> Range<usize> {
        self.tokens.get(at).map_or(self.text.len()..self.text.len(), |t| t.range.clone())
    }

    /// The bracket that closes the one at `open`.
    fn close(&self, open: usize) -> Option<usize> {
        close(self.text, &self.tokens, open)
    }

    /// A value ends before this token, so that an operator here has two operands.
    fn follows_value(&self, at: usize) -> bool {
        let Some(before) = at.checked_sub(1) else { return false };
        match self.kind(before) {
            Some(lexer::Kind::Number) => true,
            Some(lexer::Kind::Word) => self.word(before) != "return",
            _ => matches!(self.word(before), ")" | "]"),
        }
    }

    fn swap(&self, at: usize, found: &mut Vec<Site>) {
        let word = self.word(at);
        let range = self.range(at);
        if matches!(word, "-" | "!" | "~") && !self.follows_value(at) {
            found.push(Site { fault: Fault::Operator, range, with: String::new() });
            return;
        }
        for (fault, _, with) in SWAPS.iter().filter(|(_, from, _)| *from == word) {
            found.push(Site { fault: *fault, range: range.clone(), with: (*with).to_owned() });
        }
    }

    /// `.x` becomes `.y`; the first two components of several change places.
    fn swizzle(&self, at: usize, found: &mut Vec<Site>) {
        let word = self.word(at);
        if self.before(at) != "." || word.len() > 4 || !word.chars().all(|c| "xyzw".contains(c)) {
            return;
        }
        let with = match word {
            "x" => "y".to_owned(),
            "y" => "x".to_owned(),
            "z" => "y".to_owned(),
            "w" => "z".to_owned(),
            _ => format!("{}{}{}", &word[1..2], &word[..1], &word[2..]),
        };
        found.push(Site { fault: Fault::Swizzle, range: self.range(at), with });
    }

    /// `[i]` becomes `[i + 1]` and `[i - 1]`; not the size of an array that is declared.
    fn index(&self, at: usize, found: &mut Vec<Site>) {
        if self.word(at) != "[" || !self.follows_value(at) || self.word(at + 1) == "]" {
            return;
        }
        let type_before = at >= 2 && self.kind(at - 2) == Some(lexer::Kind::Word) && self.word(at - 2) != "return";
        let declared = self.kind(at - 1) == Some(lexer::Kind::Word) && type_before;
        let Some(close) = self.close(at).filter(|_| !declared) else { return };
        let index = self.range(at).end..self.range(close).start;
        for step in ["+ 1", "- 1"] {
            let with = format!("({}) {step}", &self.text[index.clone()]);
            found.push(Site { fault: Fault::Bound, range: index.clone(), with });
        }
    }

    /// `if (…)` always or never: an early return that is left out, a guard that is missing.
    fn condition(&self, at: usize, found: &mut Vec<Site>) {
        let Some(close) = (self.word(at) == "if").then(|| self.close(at + 1)).flatten() else { return };
        for with in ["true", "false"] {
            let range = self.range(at + 1).end..self.range(close).start;
            found.push(Site { fault: Fault::Bound, range, with: with.to_owned() });
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

#[cfg(test)]
mod tests;
