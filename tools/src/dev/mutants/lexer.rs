//! Tokens of a shader and where they stand. Preprocessor lines are left out, but for the bodies of macros with parameters,
//! which are code. A parser would need the macros expanded, and then no longer know the place in the file.

use std::ops::Range;

/// What a token is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    /// Keyword or name.
    Word,
    /// Literal.
    Number,
    /// Operator or bracket.
    Symbol,
}

/// A token and its bytes in the file.
#[derive(Debug, Clone)]
pub(super) struct Token {
    pub(super) kind: Kind,
    pub(super) range: Range<usize>,
}

/// Operators of several characters, longest first.
const SYMBOLS: [&str; 21] = [
    "<<=", ">>=", "++", "--", "+=", "-=", "*=", "/=", "%=", "&=", "|=", "^=", "<<", ">>", "<=", ">=", "==", "!=", "&&",
    "||", "^^",
];

/// The tokens of a shader.
pub(super) fn tokens(text: &str) -> Vec<Token> {
    let (mut at, mut found) = (0, Vec::new());
    while at < text.len() {
        let rest = &text[at..];
        let skipped = blank(rest);
        if skipped > 0 {
            at += skipped;
        } else if rest.starts_with('#') {
            at += directive(rest);
        } else {
            let (kind, length) = token(rest);
            found.push(Token { kind, range: at..at + length });
            at += length;
        }
    }
    found
}

/// Length of white space, a line's continuation or a comment.
fn blank(rest: &str) -> usize {
    if rest.starts_with("//") {
        return rest.find('\n').unwrap_or(rest.len());
    }
    if rest.starts_with("/*") {
        return rest.find("*/").map_or(rest.len(), |end| end + 2);
    }
    rest.find(|c: char| !c.is_whitespace() && c != '\\').unwrap_or(rest.len())
}

/// Length of a preprocessor line; of a macro with parameters only up to its body.
fn directive(rest: &str) -> usize {
    if let Some(define) = rest.strip_prefix("#define ") {
        let name = define.find(|c: char| !is_word(c)).unwrap_or(define.len());
        if define[name..].starts_with('(') {
            let close = define.find(')').map_or(define.len(), |c| c + 1);
            return rest.len() - define.len() + close;
        }
    }
    let mut end = 0;
    loop {
        end += rest[end..].find('\n').unwrap_or(rest.len() - end);
        if !rest[..end].ends_with('\\') {
            return end;
        }
        end += 1;
    }
}

fn token(rest: &str) -> (Kind, usize) {
    let mut chars = rest.chars();
    let (first, second) = (chars.next().unwrap_or(' '), chars.next().unwrap_or(' '));
    if first.is_ascii_digit() || (first == '.' && second.is_ascii_digit()) {
        return (Kind::Number, number(rest));
    }
    if is_word(first) {
        return (Kind::Word, rest.find(|c: char| !is_word(c)).unwrap_or(rest.len()));
    }
    let long = SYMBOLS.iter().find(|s| rest.starts_with(**s));
    (Kind::Symbol, long.map_or(first.len_utf8(), |s| s.len()))
}

/// Length of a literal with its exponent and suffix.
fn number(rest: &str) -> usize {
    let hexadecimal = rest.starts_with("0x");
    let mut previous = ' ';
    for (at, c) in rest.char_indices() {
        let exponent_sign = (c == '-' || c == '+') && matches!(previous, 'e' | 'E') && !hexadecimal;
        if !(c.is_ascii_alphanumeric() || c == '.' || exponent_sign) {
            return at;
        }
        previous = c;
    }
    rest.len()
}

fn is_word(c: char) -> bool {
    c.is_ascii_alphanumeric() || c == '_'
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn comments_and_directives_are_left_out_and_macro_bodies_are_not() {
        let text = "#define A 1 + 2\n#include \"x\"\n// c + d\n/* e */ a[i]++; b <<= 0x1eu-2;\n\
                    #define ROW(r) \\\n    s[r] += 1e-4;\n#if A == 1 \\\n  && B\nx = .5f;\n#endif\n";
        let found: Vec<&str> = tokens(text).into_iter().map(|t| &text[t.range]).collect();
        let expected = [
            "a", "[", "i", "]", "++", ";", "b", "<<=", "0x1eu", "-", "2", ";", "s", "[", "r", "]", "+=", "1e-4", ";",
            "x", "=", ".5f", ";",
        ];
        assert_eq!(found, expected);
    }
}
