//! Writes files as `torch.save` does: a zip of a pickle (protocol 2) and raw arrays.

use std::io::Write;

/// Numbers of a tensor.
pub enum Numbers {
    F32(Vec<f32>),
    I64(Vec<i64>),
    Bool(Vec<u8>),
}

/// A value.
pub enum Value {
    Tensor(Vec<usize>, Numbers),
    Dict(Vec<(String, Value)>),
    List(Vec<Value>),
    /// Instructions as they are.
    Raw(Vec<u8>),
}

/// A tensor of floats.
pub fn floats(shape: &[usize], values: Vec<f32>) -> Value {
    assert_eq!(shape.iter().product::<usize>(), values.len());
    Value::Tensor(shape.to_vec(), Numbers::F32(values))
}

/// A dictionary.
pub fn dict(entries: Vec<(&str, Value)>) -> Value {
    Value::Dict(entries.into_iter().map(|(k, v)| (k.to_owned(), v)).collect())
}

/// The pickle and its arrays.
pub fn pickled(value: &Value) -> (Vec<u8>, Vec<Vec<u8>>) {
    let (mut out, mut arrays) = (b"\x80\x02".to_vec(), Vec::new());
    put(value, &mut out, &mut arrays);
    out.push(b'.');
    (out, arrays)
}

/// The whole file.
pub fn file(value: &Value) -> Vec<u8> {
    let (pickle, arrays) = pickled(value);
    archive(&pickle, &arrays)
}

/// The zip of a pickle and arrays, not compressed.
pub fn archive(pickle: &[u8], arrays: &[Vec<u8>]) -> Vec<u8> {
    let mut zip = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    let stored = zip::write::SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
    let mut add = |name: String, content: &[u8]| {
        zip.start_file(name, stored).unwrap();
        zip.write_all(content).unwrap();
    };
    add("archive/data.pkl".into(), pickle);
    add("archive/byteorder".into(), b"little");
    for (i, array) in arrays.iter().enumerate() {
        add(format!("archive/data/{i}"), array);
    }
    zip.finish().unwrap().into_inner()
}

fn text(t: &str, out: &mut Vec<u8>) {
    out.push(b'X');
    out.extend((t.len() as u32).to_le_bytes());
    out.extend(t.as_bytes());
}

fn number(v: usize, out: &mut Vec<u8>) {
    out.push(b'J');
    out.extend((v as u32).to_le_bytes());
}

fn numbers(values: &[usize], out: &mut Vec<u8>) {
    out.push(b'(');
    values.iter().for_each(|&v| number(v, out));
    out.push(b't');
}

fn put(value: &Value, out: &mut Vec<u8>, arrays: &mut Vec<Vec<u8>>) {
    match value {
        Value::Raw(bytes) => out.extend(bytes),
        Value::List(items) => {
            out.extend(b"](");
            items.iter().for_each(|item| put(item, out, arrays));
            out.push(b'e');
        }
        Value::Dict(entries) => {
            // An OrderedDict with attributes, as a state_dict is.
            out.extend(b"ccollections\nOrderedDict\nq\x01)R(");
            for (key, value) in entries {
                text(key, out);
                put(value, out, arrays);
            }
            out.extend(b"u}");
            text("_metadata", out);
            out.extend(b"Nsb");
        }
        Value::Tensor(shape, values) => tensor(shape, values, out, arrays),
    }
}

fn tensor(shape: &[usize], values: &Numbers, out: &mut Vec<u8>, arrays: &mut Vec<Vec<u8>>) {
    let (kind, bytes): (&str, Vec<u8>) = match values {
        Numbers::F32(v) => ("Float", v.iter().flat_map(|v| v.to_le_bytes()).collect()),
        Numbers::I64(v) => ("Long", v.iter().flat_map(|v| v.to_le_bytes()).collect()),
        Numbers::Bool(v) => ("Bool", v.clone()),
    };
    out.extend(b"ctorch._utils\n_rebuild_tensor_v2\n((");
    text("storage", out);
    out.extend(format!("ctorch\n{kind}Storage\n").as_bytes());
    text(&arrays.len().to_string(), out);
    text("cuda:0", out);
    number(shape.iter().product(), out);
    out.extend(b"tQK\x00");
    numbers(shape, out);
    let mut stride = vec![1; shape.len()];
    for i in (0..shape.len().saturating_sub(1)).rev() {
        stride[i] = stride[i + 1] * shape[i + 1];
    }
    numbers(&stride, out);
    out.extend(b"\x89ccollections\nOrderedDict\n)RtR");
    arrays.push(bytes);
}
