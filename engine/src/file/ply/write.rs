//! Writes the layout that every 3DGS program reads.

use std::io::{self, Write};
use std::path::Path;

use crate::error::Result;
use crate::file::check;
use crate::file::durable::write_atomic;
use crate::scene::Gaussians;

/// Writes a 3DGS `.ply`, durably: binary little-endian f32, `x y z nx ny nz f_dc_0..2 f_rest_* opacity scale_0..2
/// rot_0..3` (62 properties at SH degree 3), normals 0. Reading it back gives the same bits.
///
/// ```
/// use engine::{file::ply, scene::Gaussians};
///
/// let red = Gaussians {
///     mean: vec![[0.0, 0.0, 0.0]],
///     log_scale: vec![[-2.0; 3]],               // standard deviation e^-2
///     rotation: vec![[1.0, 0.0, 0.0, 0.0]],     // w, x, y, z
///     opacity_logit: vec![2.0],                 // opacity = sigmoid(2) = 0.88
///     sh_degree: 0,
///     sh: vec![1.7725, -1.7725, -1.7725],       // (colour − 0.5) / 0.28209479
///     ..Gaussians::default()
/// };
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("red.ply");
/// ply::write(&path, &red)?;
/// assert_eq!(ply::read(&path)?, red);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`crate::Error::Usage`] when the arrays' lengths disagree; [`crate::Error::Io`].
pub fn write(path: &Path, gaussians: &Gaussians) -> Result<()> {
    check::gaussians(gaussians).map_err(|problem| problem.usage(path))?;
    write_atomic(path, |out| {
        out.write_all(header(gaussians).as_bytes())?;
        rows(out, gaussians)
    })
}

fn header(gaussians: &Gaussians) -> String {
    let mut names: Vec<String> = ["x", "y", "z", "nx", "ny", "nz"].iter().map(ToString::to_string).collect();
    names.extend((0..3).map(|i| format!("f_dc_{i}")));
    names.extend((0..3 * (gaussians.sh_coefficients() - 1)).map(|i| format!("f_rest_{i}")));
    names.push("opacity".into());
    names.extend((0..3).map(|i| format!("scale_{i}")));
    names.extend((0..4).map(|i| format!("rot_{i}")));
    let properties: String = names.iter().map(|name| format!("property float {name}\n")).collect();
    format!("ply\nformat binary_little_endian 1.0\nelement vertex {}\n{properties}end_header\n", gaussians.len())
}

fn rows(out: &mut dyn Write, gaussians: &Gaussians) -> io::Result<()> {
    let k = gaussians.sh_coefficients();
    let mut row: Vec<u8> = Vec::with_capacity(4 * (14 + 3 * k));
    for i in 0..gaussians.len() {
        row.clear();
        let sh = &gaussians.sh[i * k * 3..(i + 1) * k * 3];
        let mut put = |values: &[f32]| values.iter().for_each(|v| row.extend_from_slice(&v.to_le_bytes()));
        put(&gaussians.mean[i]);
        put(&[0.0; 3]);
        put(&sh[..3]);
        for channel in 0..3 {
            (1..k).for_each(|j| put(&[sh[j * 3 + channel]]));
        }
        put(&[gaussians.opacity_logit[i]]);
        put(&gaussians.log_scale[i]);
        put(&gaussians.rotation[i]);
        out.write_all(&row)?;
    }
    Ok(())
}
