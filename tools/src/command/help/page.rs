//! A page of the manual as plain text: Markdown without links, with wide tables as lists.

/// Characters of a line.
const WIDTH: usize = 100;

/// A Markdown page for the terminal.
pub(super) fn plain(markdown: &str) -> String {
    let lines: Vec<&str> = markdown.lines().collect();
    let mut out = String::new();
    let mut i = 0;
    while i < lines.len() {
        let line = lines[i];
        let block = |takes: fn(&str) -> bool| lines[i..].iter().take_while(|l| takes(l)).count();
        if line.starts_with("```") {
            i += 1;
            while i < lines.len() && !lines[i].starts_with("```") {
                out += format!("    {}", lines[i]).trim_end();
                out.push('\n');
                i += 1;
            }
        } else if line.starts_with('#') {
            let text = inline(line.trim_start_matches('#').trim());
            let under = if line.starts_with("##") { "-" } else { "=" };
            out += &format!("{text}\n{}\n", under.repeat(text.chars().count()));
        } else if line.starts_with('|') {
            let count = block(|l| l.starts_with('|'));
            out += &table(&lines[i..i + count]);
            i += count - 1;
        } else if line.trim().is_empty() {
            if !out.is_empty() && !out.ends_with("\n\n") {
                out.push('\n');
            }
        } else if !line.starts_with("<!--") && !is_definition(line) {
            let first = if line.starts_with("- ") { "- " } else { "" };
            let rest = lines[i + 1..].iter().take_while(|l| is_text(l) && !l.starts_with("- ")).count();
            let text: Vec<&str> = lines[i..=i + rest].iter().map(|l| l.trim()).collect();
            let text = inline(text.join(" ").strip_prefix(first).unwrap_or_default());
            out += &wrapped(&text, first, if first.is_empty() { "" } else { "  " });
            i += rest;
        }
        i += 1;
    }
    out
}

/// Whether a line continues a paragraph.
fn is_text(line: &str) -> bool {
    !line.trim().is_empty() && !["```", "#", "|", "<!--"].iter().any(|s| line.starts_with(s)) && !is_definition(line)
}

/// `[name]: target`
fn is_definition(line: &str) -> bool {
    line.starts_with('[') && line.contains("]: ")
}

/// Without marks of bold text and without what links point at.
fn inline(text: &str) -> String {
    let mut out = String::new();
    let mut code = false;
    let mut rest = text;
    while let Some(c) = rest.chars().next() {
        code ^= c == '`';
        if !code && let Some(after) = rest.strip_prefix("**") {
            rest = after;
            continue;
        }
        if !code
            && c == '['
            && let Some((inside, after)) = link(rest)
        {
            out += &inline(inside);
            rest = after;
            continue;
        }
        out.push(c);
        rest = &rest[c.len_utf8()..];
    }
    out
}

/// The text of the link that `text` begins with, and what follows the link.
fn link(text: &str) -> Option<(&str, &str)> {
    let (inside, after) = text.strip_prefix('[')?.split_once(']')?;
    let close = match after.chars().next()? {
        '(' => ')',
        '[' => ']',
        _ => return None,
    };
    Some((inside, after.split_once(close)?.1))
}

fn wrapped(text: &str, first: &str, further: &str) -> String {
    let mut out = String::new();
    let mut line = first.to_owned();
    let mut begins = true;
    for word in text.split_whitespace() {
        if !begins && line.chars().count() + 1 + word.chars().count() > WIDTH {
            out += &line;
            out.push('\n');
            line = further.to_owned();
            begins = true;
        }
        if !begins {
            line.push(' ');
        }
        line += word;
        begins = false;
    }
    out + &line + "\n"
}

/// The cells of a row.
fn cells(row: &str) -> Vec<String> {
    let row = row.trim().trim_start_matches('|').replace("\\|", "\u{0}");
    let row = row.strip_suffix('|').unwrap_or(&row);
    row.split('|').map(|cell| inline(cell.trim()).replace('\u{0}', "|")).collect()
}

/// Columns side by side where they fit; else each row as its first cell and the others below it.
fn table(lines: &[&str]) -> String {
    let mut rows: Vec<Vec<String>> = lines.iter().map(|l| cells(l)).collect();
    if rows.len() < 2 {
        return String::new();
    }
    rows.remove(1);
    let columns = rows.iter().map(Vec::len).max().unwrap_or_default();
    let cell = |row: &[String], c: usize| row.get(c).cloned().unwrap_or_default();
    let widths: Vec<usize> =
        (0..columns).map(|c| rows.iter().map(|r| cell(r, c).chars().count()).max().unwrap_or_default()).collect();
    let mut out = String::new();
    if widths.iter().map(|w| w + 2).sum::<usize>() <= WIDTH {
        for row in &rows {
            let line: String = (0..columns).map(|c| format!("{:w$}  ", cell(row, c), w = widths[c])).collect();
            out += line.trim_end();
            out.push('\n');
        }
        return out;
    }
    for row in &rows[1..] {
        out += &wrapped(&cell(row, 0), "", "  ");
        for c in (1..columns).filter(|&c| !cell(row, c).is_empty()) {
            let head = cell(&rows[0], c);
            let head = if columns == 2 || head.is_empty() { String::new() } else { format!("{head}: ") };
            out += &wrapped(&format!("{head}{}", cell(row, c)), "    ", "      ");
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn marks_and_targets_are_left_out() {
        let page = "# Title\n\nA **bold** [link][x] and [another](y.md), `[N,3]` and\nmore.\n\n- one\n  more\n- two\n\n\
                    ```sh\nspgs demo\n```\n<!-- no -->\n[x]: z.md\n";
        let expected =
            "Title\n=====\n\nA bold link and another, `[N,3]` and more.\n\n- one more\n- two\n\n    spgs demo\n";
        assert_eq!(plain(page), expected);
    }

    #[test]
    fn tables_are_columns_or_lists() {
        assert_eq!(plain("| a | b |\n|---|---|\n| `x\\|y` | 2 |\n"), "a      b\n`x|y`  2\n");
        let long = "word ".repeat(40);
        let text = plain(&format!("| a | b | c |\n|---|---|---|\n| x | {long} | 3 |\n"));
        assert!(text.starts_with("x\n    b: word word") && text.ends_with("\n    c: 3\n"), "{text}");
        assert!(text.lines().all(|l| l.chars().count() <= WIDTH), "{text}");
    }
}
