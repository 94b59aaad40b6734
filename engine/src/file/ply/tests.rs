//! Every form of PLY, damage, and poison.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use std::fmt::Write as _;

use super::*;
use crate::file::tests::{Values, gaussians};

/// Encodings of the test writer.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Form {
    Ascii,
    Little,
    Big,
}

/// A value with its type, as the test writer stores it.
#[derive(Clone, Copy)]
enum Value {
    F32(f32),
    F64(f64),
    U8(u8),
    I16(i16),
    U32(u32),
}

impl Value {
    fn type_name(self) -> &'static str {
        match self {
            Self::F32(_) => "float",
            Self::F64(_) => "double",
            Self::U8(_) => "uchar",
            Self::I16(_) => "int16",
            Self::U32(_) => "uint",
        }
    }

    fn put(self, form: Form, out: &mut Vec<u8>) {
        macro_rules! put {
            ($v:expr) => {
                match form {
                    Form::Ascii => out.extend(format!("{} ", $v).bytes()),
                    Form::Little => out.extend($v.to_le_bytes()),
                    Form::Big => out.extend($v.to_be_bytes()),
                }
            };
        }
        match self {
            Self::F32(v) => put!(v),
            Self::F64(v) => put!(v),
            Self::U8(v) => put!(v),
            Self::I16(v) => put!(v),
            Self::U32(v) => put!(v),
        }
    }
}

/// Properties of Gaussian `i` by name, in the usual order.
fn row(g: &Gaussians, i: usize) -> Vec<(String, Value)> {
    let k = g.sh_coefficients();
    let sh = &g.sh[i * k * 3..];
    let mut row = Vec::new();
    let mut put = |name: String, v: f32| row.push((name, Value::F32(v)));
    ["x", "y", "z"].iter().zip(g.mean[i]).for_each(|(name, v)| put((*name).into(), v));
    (0..3).for_each(|c| put(format!("f_dc_{c}"), sh[c]));
    for c in 0..3 {
        (1..k).for_each(|j| put(format!("f_rest_{}", c * (k - 1) + j - 1), sh[j * 3 + c]));
    }
    put("opacity".into(), g.opacity_logit[i]);
    (0..3).for_each(|c| put(format!("scale_{c}"), g.log_scale[i][c]));
    (0..4).for_each(|c| put(format!("rot_{c}"), g.rotation[i][c]));
    row
}

fn encoding(form: Form) -> &'static str {
    match form {
        Form::Ascii => "ascii",
        Form::Little => "binary_little_endian",
        Form::Big => "binary_big_endian",
    }
}

/// A list property: name and the row's items.
type List = (&'static str, Vec<Value>);

/// A row: its numbers by name, then its lists.
type Row = (Vec<(String, Value)>, Vec<List>);

/// An element for the test writer.
struct Part {
    name: &'static str,
    rows: Vec<Row>,
}

fn file(form: Form, parts: &[Part]) -> Vec<u8> {
    let mut header = format!("ply\nformat {} 1.0\ncomment made by a test\n", encoding(form));
    let mut body = Vec::new();
    for part in parts {
        writeln!(header, "element {} {}", part.name, part.rows.len()).unwrap();
        if let Some((scalars, lists)) = part.rows.first() {
            scalars.iter().for_each(|(name, v)| writeln!(header, "property {} {name}", v.type_name()).unwrap());
            for (name, _) in lists {
                let all = part.rows.iter().flat_map(|(_, lists)| lists.iter().filter(|l| l.0 == *name));
                let item = all.flat_map(|(_, items)| items.iter()).next().map_or("float", |v| v.type_name());
                writeln!(header, "property list uchar {item} {name}").unwrap();
            }
        }
        for (scalars, lists) in &part.rows {
            scalars.iter().for_each(|(_, v)| v.put(form, &mut body));
            for (_, items) in lists {
                Value::U8(items.len() as u8).put(form, &mut body);
                items.iter().for_each(|v| v.put(form, &mut body));
            }
            if form == Form::Ascii {
                body.push(b'\n');
            }
        }
    }
    header.push_str("end_header\n");
    [header.into_bytes(), body].concat()
}

fn vertices(g: &Gaussians) -> Part {
    Part { name: "vertex", rows: (0..g.len()).map(|i| (row(g, i), Vec::new())).collect() }
}

fn bits(g: &Gaussians) -> Vec<u32> {
    let all = g.mean.as_flattened().iter().chain(g.log_scale.as_flattened()).chain(g.rotation.as_flattened());
    all.chain(&g.opacity_logit).chain(&g.sh).map(|v| v.to_bits()).collect()
}

fn path() -> &'static Path {
    Path::new("test.ply")
}

const FORMS: [Form; 3] = [Form::Ascii, Form::Little, Form::Big];

#[test]
fn what_is_written_is_read_back_bit_for_bit() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("a.ply");
    for degree in 0..=3 {
        for n in [0, 1, 5, 9000] {
            let mut g = gaussians(n, degree);
            if n > 1 {
                // Any bits must survive, NaN payloads and denormals too.
                g.mean[0] = [f32::from_bits(0x7fc1_2345), f32::NEG_INFINITY, -0.0];
                g.sh[1] = f32::from_bits(1);
            }
            write(&file, &g).unwrap();
            let back = read(&file).unwrap();
            assert_eq!(bits(&back), bits(&g), "degree {degree}, {n} Gaussians");
            assert_eq!((back.sh_degree, back.len()), (degree, n));
            let length = std::fs::metadata(&file).unwrap().len() as usize;
            assert_eq!(
                properties(&std::fs::read(&file).unwrap(), &file).unwrap().len(),
                17 + [0, 9, 24, 45][degree as usize]
            );
            assert!(length >= n * 4 * (17 + [0, 9, 24, 45][degree as usize]));
        }
    }
}

#[test]
fn every_form_order_and_extra_is_read() {
    for form in FORMS {
        for degree in 0..=3 {
            let g = gaussians(4, degree);
            assert_eq!(bits(&parse(&file(form, &[vertices(&g)]), path()).unwrap()), bits(&g), "{form:?} {degree}");

            let mut v = Values(u64::from(degree));
            let mut order: Vec<usize> = (0..row(&g, 0).len() + 3).collect();
            (1..order.len()).rev().for_each(|i| order.swap(i, v.bits() as usize % (i + 1)));
            let shuffled = |lists: bool| Part {
                name: "vertex",
                rows: (0..g.len())
                    .map(|i| {
                        let mut values = row(&g, i);
                        values.push(("red".into(), Value::U8(250)));
                        values.push(("label".into(), Value::I16(-3)));
                        values.push(("confidence".into(), Value::F64(0.1)));
                        let values = order.iter().map(|&j| values[j].clone()).collect();
                        let items = (0..i).map(|j| Value::I16(j as i16)).collect();
                        (values, if lists { vec![("tracks", items)] } else { Vec::new() })
                    })
                    .collect(),
            };
            let other = |name| Part {
                name,
                rows: (0..3)
                    .map(|i| {
                        let items = (0..i).map(Value::U32).collect();
                        (vec![("weight".into(), Value::F64(1.5))], vec![("vertex_indices", items)])
                    })
                    .collect(),
            };
            let plain = |name| Part {
                name,
                rows: vec![(vec![("a".into(), Value::U8(1)), ("b".into(), Value::F64(2.0))], vec![])],
            };
            for lists in [false, true] {
                let parts = [plain("camera"), other("chunk"), shuffled(lists), other("face"), plain("end")];
                assert_eq!(
                    bits(&parse(&file(form, &parts), path()).unwrap()),
                    bits(&g),
                    "{form:?} {degree} lists {lists}"
                );
            }
        }
    }
}

#[test]
fn other_number_types_are_converted() {
    for form in FORMS {
        let mut g = gaussians(2, 0);
        (g.mean[0], g.mean[1]) = ([200.0, -300.0, 0.1], [1.0, 2.0, 3.0e30]);
        let part = Part {
            name: "vertex",
            rows: (0..2)
                .map(|i| {
                    let mut r = row(&g, i);
                    r[0].1 = Value::U8(g.mean[i][0] as u8);
                    r[1].1 = Value::I16(g.mean[i][1] as i16);
                    r[2].1 = Value::F64(f64::from(g.mean[i][2]));
                    (r, vec![])
                })
                .collect(),
        };
        assert_eq!(bits(&parse(&file(form, &[part]), path()).unwrap()), bits(&g), "{form:?}");
    }
}

#[test]
fn windows_line_ends_are_read() {
    let g = gaussians(3, 1);
    let text = String::from_utf8(file(Form::Ascii, &[vertices(&g)])).unwrap().replace('\n', "\r\n");
    assert_eq!(bits(&parse(text.as_bytes(), path()).unwrap()), bits(&g));
    let binary = file(Form::Little, &[vertices(&g)]);
    let body = binary.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
    let header = String::from_utf8(binary[..body].to_vec()).unwrap().replace('\n', "\r\n");
    assert_eq!(bits(&parse(&[header.as_bytes(), &binary[body..]].concat(), path()).unwrap()), bits(&g));
}

#[test]
fn a_cut_at_every_byte_is_an_error() {
    let g = gaussians(3, 1);
    let face = || Part { name: "face", rows: vec![(vec![], vec![("i", vec![Value::U32(1), Value::U32(2)])]); 2] };
    for form in FORMS {
        for parts in [vec![vertices(&g)], vec![face(), vertices(&g)], vec![vertices(&g), face()]] {
            let whole = file(form, &parts);
            let text = String::from_utf8_lossy(&whole).trim_end().len();
            for cut in 0..whole.len() {
                match parse(&whole[..cut], path()) {
                    Err(Error::Corrupt { .. }) => {}
                    Err(other) => panic!("{form:?} cut at {cut}: {other}"),
                    // In text, white space at the end means nothing and a last number may lose digits unnoticed.
                    Ok(_) => assert!(form == Form::Ascii && cut + 16 > text, "{form:?} cut at {cut} accepted"),
                }
            }
            assert!(parse(&[&whole[..], b"7"].concat(), path()).is_err(), "{form:?}: a further byte is accepted");
        }
    }
}

#[test]
fn lying_headers_name_the_place() {
    let g = gaussians(3, 0);
    let text = |form: Form| file(form, &[vertices(&g)]);
    let edit = |form: Form, from: &str, to: &str| {
        let whole = text(form);
        let at = whole.windows(from.len()).position(|w| w == from.as_bytes()).unwrap();
        [&whole[..at], to.as_bytes(), &whole[at + from.len()..]].concat()
    };
    let huge = u64::MAX.to_string();
    for (from, to, expected) in [
        ("element vertex 3", format!("element vertex {huge}"), "bytes to the end of the file"),
        ("element vertex 3", "element vertex 4".into(), "bytes to the end of the file"),
        ("element vertex 3", "element vertex 2".into(), "more bytes"),
        ("element vertex 3", "element vertex -3".into(), "line 4 (byte "),
        ("element vertex 3", "element vertices 3".into(), "an element `vertex`"),
        ("property float opacity", "property float alpha".into(), "no property `opacity`"),
        ("property float opacity", "property half opacity".into(), "type `half`"),
        ("property float opacity", "property float x".into(), "second property `x`"),
        ("property float opacity", "property list uchar float opacity".into(), "is a list"),
        ("property float opacity", "property float f_rest_0\nproperty float opacity".into(), "1 properties `f_rest_*`"),
        ("property float opacity", "prperty float opacity".into(), "`prperty float opacity`"),
        ("1.0", "2.0".into(), "binary_little_endian 2.0"),
        ("binary_little_endian", "binary_middle_endian".into(), "format `binary_middle_endian`"),
        ("ply\n", "plyx\n".into(), "expected `ply`"),
    ] {
        let message = parse(&edit(Form::Little, from, &to), path()).unwrap_err().to_string();
        assert!(message.contains(expected) && message.starts_with("test.ply: at "), "{to}: {message}");
    }
    for (from, to, expected) in [
        ("element vertex 3", format!("element vertex {huge}"), "lines of 14 numbers"),
        ("element vertex 3", "element vertex 4".into(), "expected row 3 of the 4"),
        ("element vertex 3", "element vertex 2".into(), "another line"),
    ] {
        let message = parse(&edit(Form::Ascii, from, &to), path()).unwrap_err().to_string();
        assert!(message.contains(expected), "{to}: {message}");
    }
    // A wrong word in row 1 is named by its line: 18 lines of header, rows from line 19 on.
    let mut lines: Vec<String> = String::from_utf8(text(Form::Ascii)).unwrap().lines().map(Into::into).collect();
    assert_eq!(lines.len(), 22);
    lines[20] = lines[20].replacen(' ', " 1,5 ", 1);
    let message = parse(lines.join("\n").as_bytes(), path()).unwrap_err().to_string();
    assert!(message.contains("line 21 (`y`): found `1,5`"), "{message}");
    lines[20] = "1 2 3".into();
    let message = parse(lines.join("\n").as_bytes(), path()).unwrap_err().to_string();
    assert!(message.contains("line 21: found 3 numbers, expected a further number, for `f_dc_0`"), "{message}");
}

#[test]
fn lying_lists_are_errors() {
    let header = "ply\nformat binary_little_endian 1.0\nelement face 1\nproperty list int double i\n\
                  element vertex 0\nproperty float x\nend_header\n";
    for count in [-1i32, 1, i32::MAX] {
        let body = count.to_le_bytes();
        let with_model = header.replace("property float x", &model_properties());
        let message = parse(&[with_model.as_bytes(), &body].concat(), path()).unwrap_err().to_string();
        assert!(message.contains("element `face` row 0"), "{message}");
    }
}

fn model_properties() -> String {
    let names: Vec<String> =
        row(&gaussians(1, 0), 0).iter().map(|(name, _)| format!("property float {name}")).collect();
    names.join("\n")
}

#[test]
fn known_foreign_kinds_are_named() {
    let header = |properties: &str| format!("ply\nformat ascii 1.0\nelement vertex 0\n{properties}\nend_header\n");
    let message = |properties: &str| parse(header(properties).as_bytes(), path()).unwrap_err().to_string();
    assert!(message("property uint packed_position").contains("binary_little_endian"));
    assert!(message("property float x\nproperty float y\nproperty float z").contains("a mesh or a point cloud"));
}
