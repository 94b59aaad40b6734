//! Tables, for the page and for the terminal.

use std::fmt::Write as _;

use super::encode::escape;

/// How a column is set.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Align {
    /// Text.
    Left,
    /// Numbers.
    Right,
}

/// What a row's colour says.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Standing {
    /// Nothing.
    #[default]
    Plain,
    /// Passed, or among the best.
    Good,
    /// Failed.
    Bad,
}

/// A table of text cells.
#[derive(Debug, Clone)]
pub struct Table {
    columns: Vec<(String, Align)>,
    rows: Vec<(Standing, Vec<String>)>,
}

impl Table {
    /// An empty table with these columns.
    pub fn new<N: AsRef<str>>(columns: &[(N, Align)]) -> Self {
        Self { columns: columns.iter().map(|(name, a)| (name.as_ref().to_owned(), *a)).collect(), rows: Vec::new() }
    }

    /// Appends a row.
    pub fn row(&mut self, cells: impl IntoIterator<Item = String>) {
        self.marked(Standing::Plain, cells);
    }

    /// Appends a row with a colour.
    pub fn marked(&mut self, standing: Standing, cells: impl IntoIterator<Item = String>) {
        let mut cells: Vec<String> = cells.into_iter().collect();
        cells.resize(self.columns.len(), String::new());
        self.rows.push((standing, cells));
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.rows.len()
    }

    /// Whether there is no row.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    pub(super) fn html(&self) -> String {
        let class = |i: usize| if self.columns[i].1 == Align::Right { " class=\"n\"" } else { "" };
        let mut h = String::from("<table>\n<tr>");
        for (i, (name, _)) in self.columns.iter().enumerate() {
            let _ = write!(h, "<th{}>{}</th>", class(i), escape(name));
        }
        h.push_str("</tr>\n");
        for (standing, cells) in &self.rows {
            h.push_str(match standing {
                Standing::Plain => "<tr>",
                Standing::Good => "<tr class=\"good\">",
                Standing::Bad => "<tr class=\"bad\">",
            });
            for (i, cell) in cells.iter().enumerate() {
                let _ = write!(h, "<td{}>{}</td>", class(i), escape(cell));
            }
            h.push_str("</tr>\n");
        }
        h + "</table>\n"
    }

    /// Columns padded with blanks, one line per row, for the terminal.
    pub fn text(&self) -> String {
        let names: Vec<String> = self.columns.iter().map(|c| c.0.clone()).collect();
        let lines = || std::iter::once(&names).chain(self.rows.iter().map(|r| &r.1));
        let width = |i: usize| lines().map(|l| l[i].chars().count()).max().unwrap_or(0);
        let widths: Vec<usize> = (0..self.columns.len()).map(width).collect();
        let mut text = String::new();
        for line in lines() {
            let mut out = String::new();
            for (i, cell) in line.iter().enumerate() {
                let _ = match self.columns[i].1 {
                    Align::Left => write!(out, "{cell:<0$}  ", widths[i]),
                    Align::Right => write!(out, "{cell:>0$}  ", widths[i]),
                };
            }
            text.push_str(out.trim_end());
            text.push('\n');
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample() -> Table {
        let mut t = Table::new(&[("name", Align::Left), ("ms", Align::Right)]);
        t.row(["a<b".into(), "1.50".into()]);
        t.marked(Standing::Bad, ["µ".into(), "12.25".into(), "too many".into()]);
        t.row(["short".into()]);
        t
    }

    #[test]
    fn numbers_are_aligned_and_rows_have_as_many_cells_as_columns() {
        let html = sample().html();
        assert!(html.contains("<td>a&lt;b</td><td class=\"n\">1.50</td>") && html.contains("<tr class=\"bad\">"));
        assert!(!html.contains("too many"));
        assert_eq!(html.matches("<td").count(), 6);
    }

    #[test]
    fn text_columns_line_up() {
        assert_eq!(sample().text(), "name      ms\na<b     1.50\nµ      12.25\nshort\n");
    }
}
