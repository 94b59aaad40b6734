//! The PLY header: elements, properties, and where the body begins.

use std::path::Path;

use crate::error::{Error, Result};

/// Number type of a property.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Number {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Number {
    fn from_name(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    /// Bytes in a binary file.
    pub(super) fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    pub(super) fn is_integer(self) -> bool {
        !matches!(self, Self::F32 | Self::F64)
    }
}

/// One property of an element.
#[derive(Debug, Clone)]
pub(super) struct Property {
    pub(super) name: String,
    /// Type of the value, or of the list's items.
    pub(super) number: Number,
    /// Type of the item count, for a list.
    pub(super) list: Option<Number>,
}

/// One element: `count` rows of the properties.
#[derive(Debug, Clone)]
pub(super) struct Element {
    pub(super) name: String,
    pub(super) count: u64,
    pub(super) properties: Vec<Property>,
}

impl Element {
    /// Bytes of a row in a binary file; `None` when it holds lists.
    pub(super) fn stride(&self) -> Option<usize> {
        self.properties.iter().map(|p| if p.list.is_some() { None } else { Some(p.number.size()) }).sum()
    }

    /// Fewest bytes that a row can take in a binary file (empty lists).
    pub(super) fn least_row(&self) -> usize {
        self.properties.iter().map(|p| p.list.unwrap_or(p.number).size()).sum()
    }
}

/// How numbers are stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Encoding {
    Ascii,
    Little,
    Big,
}

/// A parsed header.
#[derive(Debug, Clone)]
pub(super) struct Header {
    pub(super) encoding: Encoding,
    pub(super) elements: Vec<Element>,
    /// Index of the element `vertex`.
    pub(super) vertex: usize,
    /// First byte of the body.
    pub(super) body: usize,
    /// Line number of the body's first line, from 1.
    pub(super) body_line: usize,
}

/// Longest header accepted, bytes: real ones are below 10 KiB; without a bound a corrupt file is searched to its end.
const MAX_HEADER: usize = 1 << 20;

/// Parses the header of a 3DGS file.
pub(super) fn parse(bytes: &[u8], path: &Path) -> Result<Header> {
    let mut lines = Lines { bytes: &bytes[..bytes.len().min(MAX_HEADER)], next: 0, number: 0 };
    let mut state = State { path, encoding: None, elements: Vec::new() };
    let magic = lines.next_line();
    if magic.as_ref().is_none_or(|l| l.text != b"ply") {
        let first = &bytes[..bytes.len().min(8)];
        return Err(Error::corrupt(path, "byte 0", format!("{:?}", first.escape_ascii().to_string()), "`ply`"));
    }
    while let Some(line) = lines.next_line() {
        let text = std::str::from_utf8(line.text)
            .map_err(|_| line.corrupt(path, format!("`{}`", line.text.escape_ascii()), "UTF-8 text"))?;
        if text.trim() == "end_header" {
            return state.finish(&line, lines.next, lines.number + 1);
        }
        state.statement(text, &line)?;
    }
    let end = lines.bytes.len();
    Err(Error::corrupt(path, format!("byte {end}"), "no further line", "a header that ends with `end_header`"))
}

struct State<'a> {
    path: &'a Path,
    encoding: Option<Encoding>,
    elements: Vec<Element>,
}

impl State<'_> {
    fn statement(&mut self, text: &str, line: &Line<'_>) -> Result<()> {
        let words: Vec<&str> = text.split_ascii_whitespace().collect();
        match words.as_slice() {
            [] | ["comment" | "obj_info", ..] => Ok(()),
            ["format", name, "1.0"] if self.encoding.is_none() => {
                self.encoding = Some(match *name {
                    "ascii" => Encoding::Ascii,
                    "binary_little_endian" => Encoding::Little,
                    "binary_big_endian" => Encoding::Big,
                    other => {
                        let expected = "ascii, binary_little_endian or binary_big_endian";
                        return Err(line.corrupt(self.path, format!("format `{other}`"), expected));
                    }
                });
                Ok(())
            }
            ["element", name, count] => {
                let count = count
                    .parse()
                    .map_err(|_| line.corrupt(self.path, format!("`{count}`"), "a count of rows (0 to 2^64 − 1)"))?;
                if self.elements.iter().any(|e| e.name == *name) {
                    return Err(line.corrupt(self.path, format!("a second element `{name}`"), "each element once"));
                }
                self.elements.push(Element { name: (*name).into(), count, properties: Vec::new() });
                Ok(())
            }
            ["property", "list", count, item, name] => self.property(Some(count), item, name, line),
            ["property", item, name] => self.property(None, item, name, line),
            _ => {
                let expected = "`format <encoding> 1.0` once, `element <name> <count>`, `property <type> <name>`, \
                                `property list <type> <type> <name>`, `comment` or `end_header`";
                Err(line.corrupt(self.path, format!("`{}`", text.trim()), expected))
            }
        }
    }

    fn property(&mut self, count: Option<&str>, item: &str, name: &str, line: &Line<'_>) -> Result<()> {
        let path = self.path;
        let number = |word: &str| {
            Number::from_name(word)
                .ok_or_else(|| line.corrupt(path, format!("type `{word}`"), "a PLY type from char to double"))
        };
        let list = count.map(&number).transpose()?;
        if list.is_some_and(|n| !n.is_integer()) {
            return Err(line.corrupt(path, format!("list count type `{}`", count.unwrap_or("")), "an integer type"));
        }
        let number = number(item)?;
        let Some(element) = self.elements.last_mut() else {
            return Err(line.corrupt(path, format!("property `{name}`"), "an `element` line before it"));
        };
        if element.name == "vertex" && element.properties.iter().any(|p| p.name == name) {
            return Err(line.corrupt(path, format!("a second property `{name}`"), "each property once"));
        }
        element.properties.push(Property { name: name.into(), number, list });
        Ok(())
    }

    fn finish(self, line: &Line<'_>, body: usize, body_line: usize) -> Result<Header> {
        let expected = "a line `format ascii|binary_little_endian|binary_big_endian 1.0`";
        let encoding = self.encoding.ok_or_else(|| line.corrupt(self.path, "end of the header", expected))?;
        let vertex = self.elements.iter().position(|e| e.name == "vertex");
        let vertex = vertex.ok_or_else(|| line.corrupt(self.path, "end of the header", "an element `vertex`"))?;
        Ok(Header { encoding, elements: self.elements, vertex, body, body_line })
    }
}

/// A line of the header with its place.
struct Line<'a> {
    text: &'a [u8],
    number: usize,
    byte: usize,
}

impl Line<'_> {
    fn corrupt(&self, path: &Path, found: impl Into<String>, expected: impl Into<String>) -> Error {
        Error::corrupt(path, format!("line {} (byte {})", self.number, self.byte), found, expected)
    }
}

/// Lines that end in `\n` or `\r\n`. A last line without an end is not a line: the header is cut there.
struct Lines<'a> {
    bytes: &'a [u8],
    next: usize,
    number: usize,
}

impl<'a> Lines<'a> {
    fn next_line(&mut self) -> Option<Line<'a>> {
        let rest = self.bytes.get(self.next..)?;
        let length = rest.iter().position(|&b| b == b'\n')?;
        let line = &rest[..length];
        let byte = self.next;
        self.next += length + 1;
        self.number += 1;
        Some(Line { text: line.strip_suffix(b"\r").unwrap_or(line), number: self.number, byte })
    }
}
