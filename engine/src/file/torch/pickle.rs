//! The stack machine: instructions to plain data. Values live in an arena and refer to each other by index, so that nothing
//! recurses however deep a hostile file nests.

use std::collections::BTreeMap;
use std::path::Path;

use crate::error::{Error, Result};
use crate::file::codec::Cursor;

/// Index of a value in the arena.
pub(super) type Id = usize;

/// Element type of an array.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Element {
    F64,
    F32,
    F16,
    BF16,
    I64,
    I32,
    I16,
    I8,
    U8,
    Bool,
}

/// What may be named by a pickle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Global {
    OrderedDict,
    RebuildTensor,
    RebuildParameter,
    Size,
    Storage(Element),
}

/// An array in the file.
#[derive(Debug, Clone)]
pub(super) struct Tensor {
    /// Name of its entry under `data/`.
    pub(super) key: String,
    pub(super) element: Element,
    /// In elements.
    pub(super) offset: u64,
    pub(super) shape: Vec<u64>,
    pub(super) stride: Vec<u64>,
}

/// A value.
#[derive(Debug, Clone)]
pub(super) enum Value {
    None,
    Bool,
    Int(i64),
    Float,
    Text(String),
    Tuple(Vec<Id>),
    List(Vec<Id>),
    Dict(Vec<(Id, Id)>),
    Global(Global),
    Storage { key: String, element: Element },
    Tensor(Tensor),
}

impl Value {
    fn kind(&self) -> &'static str {
        match self {
            Self::None => "None",
            Self::Bool => "a truth value",
            Self::Int(_) => "an integer",
            Self::Float => "a float",
            Self::Text(_) => "a string",
            Self::Tuple(_) => "a tuple",
            Self::List(_) => "a list",
            Self::Dict(_) => "a dictionary",
            Self::Global(_) => "a global",
            Self::Storage { .. } => "a storage",
            Self::Tensor(_) => "a tensor",
        }
    }
}

/// What a pickle says.
#[derive(Debug)]
pub(super) struct Parsed {
    pub(super) values: Vec<Value>,
    pub(super) root: Id,
}

/// Most dimensions of a tensor.
const MAX_RANK: usize = 8;

struct Machine<'a> {
    cursor: Cursor<'a>,
    values: Vec<Value>,
    stack: Vec<Id>,
    /// Heights of the stack at each mark.
    marks: Vec<usize>,
    memo: BTreeMap<u32, Id>,
}

/// Runs a pickle.
pub(super) fn parse(bytes: &[u8], path: &Path) -> Result<Parsed> {
    let cursor = Cursor { unit: "data.pkl, byte", ..Cursor::new(bytes, path) };
    let mut m = Machine { cursor, values: Vec::new(), stack: Vec::new(), marks: Vec::new(), memo: BTreeMap::new() };
    loop {
        if m.cursor.u8("instruction")? == b'.' {
            let root = m.pop()?;
            return Ok(Parsed { values: m.values, root });
        }
        m.cursor.at -= 1;
        m.step()?;
    }
}

impl Machine<'_> {
    fn corrupt(&self, found: impl Into<String>, expected: impl Into<String>) -> Error {
        self.cursor.corrupt(1, "instruction", found, expected)
    }

    fn push(&mut self, value: Value) -> Result<()> {
        self.values.push(value);
        self.stack.push(self.values.len() - 1);
        Ok(())
    }

    /// The top of the stack, above the last mark.
    fn pop(&mut self) -> Result<Id> {
        let floor = self.marks.last().copied().unwrap_or(0);
        if self.stack.len() <= floor {
            return Err(self.corrupt("an empty stack", "a value"));
        }
        self.stack.pop().ok_or_else(|| self.corrupt("an empty stack", "a value"))
    }

    /// Everything above the last mark, and the mark.
    fn pop_to_mark(&mut self) -> Result<Vec<Id>> {
        let mark = self.marks.pop().ok_or_else(|| self.corrupt("no mark", "one"))?;
        Ok(self.stack.split_off(mark))
    }

    fn top(&self) -> Result<Id> {
        self.stack.last().copied().ok_or_else(|| self.corrupt("an empty stack", "a value"))
    }

    fn pop_n(&mut self, n: usize) -> Result<Vec<Id>> {
        let mut ids = (0..n).map(|_| self.pop()).collect::<Result<Vec<_>>>()?;
        ids.reverse();
        Ok(ids)
    }

    fn step(&mut self) -> Result<()> {
        match self.cursor.u8("instruction")? {
            0x80 => self.protocol(),
            // FRAME only groups bytes.
            0x95 => self.cursor.take(8, "frame").map(|_| ()),
            b'(' => {
                self.marks.push(self.stack.len());
                Ok(())
            }
            b'0' => self.pop().map(|_| ()),
            b'1' => self.pop_to_mark().map(|_| ()),
            b'N' => self.push(Value::None),
            0x88 | 0x89 => self.push(Value::Bool),
            code @ (b'K' | b'M' | b'J' | 0x8a) => self.integer(code),
            b'G' => {
                self.cursor.take(8, "float")?;
                self.push(Value::Float)
            }
            code @ (b'X' | 0x8c) => self.text(code),
            code @ (b')' | b't' | 0x85 | 0x86 | 0x87) => self.tuple(code),
            b']' => self.push(Value::List(Vec::new())),
            b'}' => self.push(Value::Dict(Vec::new())),
            code @ (b'a' | b'e') => self.append(code),
            code @ (b's' | b'u') => self.set_items(code),
            code @ (b'q' | b'r' | 0x94) => self.memoize(code),
            code @ (b'h' | b'j') => self.recall(code),
            b'c' => self.global_by_lines(),
            0x93 => self.global_by_stack(),
            b'Q' => self.storage(),
            b'R' => self.call(),
            b'b' => self.build(),
            other => {
                let text = format!("instruction 0x{other:02x}, which weights do not need");
                Err(self.corrupt(text, "one that only makes plain data"))
            }
        }
    }

    fn protocol(&mut self) -> Result<()> {
        match self.cursor.u8("protocol")? {
            2..=5 => Ok(()),
            other => Err(self.corrupt(format!("protocol {other}"), "2 to 5")),
        }
    }

    fn integer(&mut self, code: u8) -> Result<()> {
        let value = match code {
            b'K' => i64::from(self.cursor.u8("integer")?),
            b'M' => i64::from(self.cursor.u8("integer")?) | i64::from(self.cursor.u8("integer")?) << 8,
            b'J' => i64::from(self.cursor.u32("integer")? as i32),
            _ => {
                let length = usize::from(self.cursor.u8("length of an integer")?);
                let bytes = self.cursor.take(length, "integer")?;
                if length > 8 {
                    return Err(self.corrupt(format!("an integer of {length} bytes"), "at most 8"));
                }
                let negative = bytes.last().is_some_and(|b| b & 0x80 != 0);
                let mut all = [if negative { 0xff } else { 0 }; 8];
                all[..length].copy_from_slice(bytes);
                i64::from_le_bytes(all)
            }
        };
        self.push(Value::Int(value))
    }

    fn text(&mut self, code: u8) -> Result<()> {
        let length = if code == b'X' { self.cursor.u32("length")? as usize } else { self.cursor.u8("length")?.into() };
        let bytes = self.cursor.take(length, "string")?;
        let text = std::str::from_utf8(bytes).map_err(|_| self.corrupt("bytes that are no text", "UTF-8"))?;
        self.push(Value::Text(text.to_owned()))
    }

    fn tuple(&mut self, code: u8) -> Result<()> {
        let items = match code {
            b')' => Vec::new(),
            b't' => self.pop_to_mark()?,
            _ => self.pop_n(usize::from(code - 0x84))?,
        };
        self.push(Value::Tuple(items))
    }

    fn append(&mut self, code: u8) -> Result<()> {
        let items = if code == b'a' { vec![self.pop()?] } else { self.pop_to_mark()? };
        let list = self.top()?;
        match &mut self.values[list] {
            Value::List(list) => {
                list.extend(items);
                Ok(())
            }
            other => {
                let found = other.kind();
                Err(self.corrupt(found, "a list to append to"))
            }
        }
    }

    fn set_items(&mut self, code: u8) -> Result<()> {
        let items = if code == b's' { self.pop_n(2)? } else { self.pop_to_mark()? };
        let dict = self.top()?;
        match &mut self.values[dict] {
            Value::Dict(dict) if items.len() % 2 == 0 => {
                dict.extend(items.chunks_exact(2).map(|pair| (pair[0], pair[1])));
                Ok(())
            }
            other => {
                let found = format!("{} and {} values", other.kind(), items.len());
                Err(self.corrupt(found, "a dictionary and pairs"))
            }
        }
    }

    fn memoize(&mut self, code: u8) -> Result<()> {
        let key = match code {
            b'q' => u32::from(self.cursor.u8("index")?),
            b'r' => self.cursor.u32("index")?,
            _ => self.memo.len() as u32,
        };
        let value = self.top()?;
        self.memo.insert(key, value);
        Ok(())
    }

    fn recall(&mut self, code: u8) -> Result<()> {
        let key = if code == b'h' { u32::from(self.cursor.u8("index")?) } else { self.cursor.u32("index")? };
        let value = self.memo.get(&key).copied();
        let value = value.ok_or_else(|| self.corrupt(format!("index {key}"), "a remembered value"))?;
        self.stack.push(value);
        Ok(())
    }

    fn line(&mut self) -> Result<String> {
        let rest = &self.cursor.bytes[self.cursor.at..];
        let length = rest.iter().take(256).position(|&b| b == b'\n');
        let length = length.ok_or_else(|| self.corrupt("no end of a name", "one within 256 bytes"))?;
        let text = String::from_utf8_lossy(self.cursor.take(length, "name")?).into_owned();
        self.cursor.take(1, "end of a name")?;
        Ok(text)
    }

    fn global_by_lines(&mut self) -> Result<()> {
        let (module, name) = (self.line()?, self.line()?);
        self.global(&module, &name)
    }

    fn global_by_stack(&mut self) -> Result<()> {
        let pair = self.pop_n(2)?;
        match (&self.values[pair[0]], &self.values[pair[1]]) {
            (Value::Text(module), Value::Text(name)) => {
                let (module, name) = (module.clone(), name.clone());
                self.global(&module, &name)
            }
            _ => Err(self.corrupt("a global without names", "two strings")),
        }
    }

    /// Only what weights need has a meaning.
    fn global(&mut self, module: &str, name: &str) -> Result<()> {
        let storage = |name: &str| {
            Some(match name.strip_suffix("Storage")? {
                "Double" => Element::F64,
                "Float" => Element::F32,
                "Half" => Element::F16,
                "BFloat16" => Element::BF16,
                "Long" => Element::I64,
                "Int" => Element::I32,
                "Short" => Element::I16,
                "Char" => Element::I8,
                "Byte" => Element::U8,
                "Bool" => Element::Bool,
                _ => return None,
            })
        };
        let known = match (module, name) {
            ("collections", "OrderedDict") => Some(Global::OrderedDict),
            ("torch._utils", "_rebuild_tensor_v2") => Some(Global::RebuildTensor),
            ("torch._utils", "_rebuild_parameter") => Some(Global::RebuildParameter),
            ("torch", "Size") => Some(Global::Size),
            ("torch", name) => storage(name).map(Global::Storage),
            _ => None,
        };
        match known {
            Some(global) => self.push(Value::Global(global)),
            None => {
                let expected = "only tensors, lists and dictionaries (this reader never runs code)";
                Err(self.corrupt(format!("a call of `{module}.{name}`"), expected))
            }
        }
    }

    /// `('storage', type, key, location, count)`.
    fn storage(&mut self) -> Result<()> {
        let id = self.pop()?;
        let value = |id: &Id| &self.values[*id];
        if let Value::Tuple(items) = value(&id) {
            let parts: Vec<&Value> = items.iter().map(value).collect();
            if let [Value::Text(kind), Value::Global(Global::Storage(element)), Value::Text(key), _, Value::Int(_)] =
                parts[..]
                && kind == "storage"
            {
                let storage = Value::Storage { key: key.clone(), element: *element };
                return self.push(storage);
            }
        }
        Err(self.corrupt("another persistent id", "('storage', type, key, location, count)"))
    }

    fn call(&mut self) -> Result<()> {
        let pair = self.pop_n(2)?;
        let Value::Tuple(arguments) = &self.values[pair[1]] else {
            return Err(self.corrupt(self.values[pair[1]].kind(), "a tuple of arguments"));
        };
        let arguments = arguments.clone();
        match (&self.values[pair[0]], arguments.as_slice()) {
            (Value::Global(Global::OrderedDict), []) => self.push(Value::Dict(Vec::new())),
            (Value::Global(Global::Size), [sizes]) => {
                self.stack.push(*sizes);
                Ok(())
            }
            (Value::Global(Global::RebuildParameter), [data, ..]) if matches!(self.values[*data], Value::Tensor(_)) => {
                self.stack.push(*data);
                Ok(())
            }
            (Value::Global(Global::RebuildTensor), [storage, offset, shape, stride, ..]) => {
                let tensor = self.tensor(*storage, *offset, *shape, *stride)?;
                self.push(Value::Tensor(tensor))
            }
            (function, _) => {
                let found = format!("a call of {function:?} with {} arguments", arguments.len());
                Err(self.corrupt(found, "one of a tensor or dictionary"))
            }
        }
    }

    fn tensor(&self, storage: Id, offset: Id, shape: Id, stride: Id) -> Result<Tensor> {
        let number = |id: Id| match self.values[id] {
            Value::Int(v) if v >= 0 => Ok(v as u64),
            _ => Err(self.corrupt("a size that is no number ≥ 0", "one")),
        };
        let numbers = |id: Id| match &self.values[id] {
            Value::Tuple(items) if items.len() <= MAX_RANK => {
                items.iter().map(|&i| number(i)).collect::<Result<Vec<_>>>()
            }
            other => Err(self.corrupt(other.kind(), format!("a tuple of at most {MAX_RANK} numbers"))),
        };
        let Value::Storage { key, element } = &self.values[storage] else {
            return Err(self.corrupt(self.values[storage].kind(), "a storage"));
        };
        let (shape, stride) = (numbers(shape)?, numbers(stride)?);
        if shape.len() != stride.len() {
            return Err(self.corrupt(format!("{} sizes, {} strides", shape.len(), stride.len()), "as many"));
        }
        Ok(Tensor { key: key.clone(), element: *element, offset: number(offset)?, shape, stride })
    }

    /// Attributes of a dictionary (PyTorch keeps version numbers there) are of no use.
    fn build(&mut self) -> Result<()> {
        self.pop()?;
        let object = self.top()?;
        match &self.values[object] {
            Value::Dict(_) => Ok(()),
            other => Err(self.corrupt(format!("attributes for {}", other.kind()), "for a dictionary")),
        }
    }
}
