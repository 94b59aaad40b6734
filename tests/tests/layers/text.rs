//! Rust source as tokens, without comments and strings.

/// Rust source without comments and without the contents of strings and character literals.
pub(crate) fn code_only(text: &str) -> String {
    let c: Vec<char> = text.chars().collect();
    let mut out = String::with_capacity(text.len());
    let mut i = 0;
    while i < c.len() {
        let rest = &c[i..];
        if rest.starts_with(&['/', '/']) {
            i += rest.iter().position(|&x| x == '\n').unwrap_or(rest.len());
        } else if rest.starts_with(&['/', '*']) {
            i += block_comment(rest);
        } else if let Some(length) = raw_string(rest) {
            i += length;
        } else if c[i] == '"' {
            i += quoted(rest, '"');
        } else if c[i] == '\'' && (rest.get(1) == Some(&'\\') || rest.get(2) == Some(&'\'')) {
            i += quoted(rest, '\'');
        } else {
            out.push(c[i]);
            i += 1;
        }
    }
    out
}

fn block_comment(c: &[char]) -> usize {
    let (mut depth, mut i) = (0, 0);
    while i < c.len() {
        if c[i..].starts_with(&['/', '*']) {
            (depth, i) = (depth + 1, i + 2);
        } else if c[i..].starts_with(&['*', '/']) {
            (depth, i) = (depth - 1, i + 2);
            if depth == 0 {
                return i;
            }
        } else {
            i += 1;
        }
    }
    i
}

fn raw_string(c: &[char]) -> Option<usize> {
    let hashes = c.strip_prefix(&['r'])?.iter().take_while(|&&x| x == '#').count();
    if c.get(1 + hashes) != Some(&'"') {
        return None;
    }
    let mut end = vec!['"'];
    end.extend(vec!['#'; hashes]);
    let body = &c[2 + hashes..];
    let at = body.windows(end.len()).position(|w| w == end.as_slice()).unwrap_or(body.len());
    Some(2 + hashes + at + end.len())
}

fn quoted(c: &[char], quote: char) -> usize {
    let mut i = 1;
    while i < c.len() && c[i] != quote {
        i += if c[i] == '\\' { 2 } else { 1 };
    }
    i + 1
}

/// Identifiers and single punctuation characters; `::` is one token.
pub(crate) fn tokens(code: &str) -> Vec<String> {
    let mut out: Vec<String> = Vec::new();
    let mut word = String::new();
    let mut previous = ' ';
    for ch in code.chars().chain([' ']) {
        if ch.is_alphanumeric() || ch == '_' {
            word.push(ch);
        } else {
            if !word.is_empty() {
                out.push(std::mem::take(&mut word));
            }
            if ch == ':' && previous == ':' && out.last().is_some_and(|t| t == ":") {
                *out.last_mut().unwrap() = "::".into();
            } else if !ch.is_whitespace() {
                out.push(ch.into());
            }
        }
        previous = ch;
    }
    out
}
