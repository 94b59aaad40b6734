//! Extension records of `.spz` (layout: [`super`]).

use std::path::Path;

use glam::{DMat3, DVec3};

use super::HEADER_4;
use crate::error::{Error, Result};
use crate::file::affine::TURN;
use crate::file::codec::{Cursor, u32_at};

/// Most bytes of extension records after the attributes.
pub(super) const MAX_EXTENSIONS: usize = 16 << 20;
/// `SPZ_ADOBE_safe_orbit_camera`: two elevations and a distance that a viewer should keep.
const ORBIT: u32 = 0xadbe_0002;
/// `SPZ_ADOBE_coordinate_system`: the file's axes.
const AXES: u32 = 0xadbe_0003;

/// What a file's extension records say.
pub(super) struct Extensions {
    /// The file's axes in ours.
    pub(super) axes: DMat3,
    /// What is not used.
    pub(super) left_out: Vec<String>,
}

impl Default for Extensions {
    fn default() -> Self {
        Self { axes: TURN, left_out: Vec::new() }
    }
}

/// The records of version 4, which end where the table begins.
pub(super) fn before_table(bytes: &[u8], table: usize, path: &Path) -> Result<Extensions> {
    let Some(bytes) = bytes.get(..table) else {
        let at = format!("byte 16 (offset of the table, {table})");
        return Err(Error::corrupt(path, at, format!("{} bytes", bytes.len()), "a place in the file"));
    };
    let mut cursor = Cursor { at: HEADER_4.min(table), ..Cursor::new(bytes, path) };
    let mut extensions = Extensions::default();
    for (kind, content) in records(&mut cursor)? {
        extensions.add(kind, content, &cursor)?;
    }
    Ok(extensions)
}

/// The records of versions 2 and 3, the rest of the unpacked data. The first writers put no lengths there; the Gaussians are
/// whole all the same.
pub(super) fn after_attributes(cursor: &mut Cursor<'_>) -> Result<Extensions> {
    let mut extensions = Extensions::default();
    let length = cursor.bytes.len() - cursor.at;
    match records(cursor) {
        Ok(found) => found.into_iter().try_for_each(|(kind, content)| extensions.add(kind, content, cursor))?,
        Err(_) => {
            extensions.left_out.push(format!("what follows its attributes ({length} bytes, no extension records)"))
        }
    }
    Ok(extensions)
}

/// Types and contents of all records to the end.
fn records<'a>(cursor: &mut Cursor<'a>) -> Result<Vec<(u32, &'a [u8])>> {
    let mut records = Vec::new();
    while cursor.at < cursor.bytes.len() {
        let kind = cursor.u32("type of an extension record")?;
        let length = cursor.u32("length of an extension record")? as usize;
        records.push((kind, cursor.take(length, "extension record")?));
    }
    Ok(records)
}

impl Extensions {
    fn add(&mut self, kind: u32, content: &[u8], cursor: &Cursor<'_>) -> Result<()> {
        if kind == AXES {
            let code = (content.len() == 4).then(|| u32_at(content, 0));
            self.axes = code.and_then(axes).ok_or_else(|| {
                let found = code.map_or_else(|| format!("{} bytes", content.len()), |code| code.to_string());
                cursor.corrupt(content.len(), "extension record, axes", found, "0 to 16, in 4 bytes")
            })?;
            return Ok(());
        }
        let name = if kind == ORBIT { ", limits of an orbiting camera" } else { "" };
        self.left_out.push(format!("its extension record {kind:#010x} ({} bytes{name})", content.len()));
        Ok(())
    }
}

/// Our axes (right, down, front) of the file's x, y and z. Codes 1 to 8 are named after left or right, down or up, back or
/// front; 9 to 16 after left or right, front or back, down or up. 0 says nothing.
fn axes(code: u32) -> Option<DMat3> {
    let bits = match code {
        0 => return Some(TURN),
        1..=16 => code - 1,
        _ => return None,
    };
    let sign = |bit: u32| if bits & bit != 0 { 1.0 } else { -1.0 };
    let (right, down) = (DVec3::X * sign(1), DVec3::Y * -sign(2));
    Some(if bits & 8 == 0 {
        DMat3::from_cols(right, down, DVec3::Z * sign(4))
    } else {
        DMat3::from_cols(right, DVec3::Z * -sign(4), down)
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use super::*;

    /// The names of the codes, as Niantic's library lists them.
    const NAMES: [&str; 16] = [
        "LDB", "RDB", "LUB", "RUB", "LDF", "RDF", "LUF", "RUF", "LFD", "RFD", "LFU", "RFU", "LBD", "RBD", "LBU", "RBU",
    ];

    #[test]
    fn axes_are_what_their_names_say() {
        for (code, name) in (1..).zip(NAMES) {
            let direction = |letter| match letter {
                'L' => DVec3::NEG_X,
                'R' => DVec3::X,
                'U' => DVec3::NEG_Y,
                'D' => DVec3::Y,
                'B' => DVec3::NEG_Z,
                _ => DVec3::Z,
            };
            let [x, y, z] = <[char; 3]>::try_from(name.chars().collect::<Vec<_>>()).unwrap().map(direction);
            assert_eq!(axes(code), Some(DMat3::from_cols(x, y, z)), "{name}");
        }
        assert_eq!((axes(0), axes(4), axes(17)), (Some(TURN), Some(TURN), None));
    }
}
