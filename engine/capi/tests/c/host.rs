//! The example host in C draws what the example host in Rust draws.

use engine::scene::synthetic::{demo_camera, demo_scene};
use glam::DVec3;

use super::*;

#[test]
fn the_c_host_draws_what_the_rust_host_draws() {
    let folder = tempfile::tempdir().unwrap();
    let libraries = ["-lspgs", "-lvulkan", "-lm"];
    let program = compile(&package().join("examples/host.c"), folder.path(), &libraries);
    let shaders = package().join("../examples/shaders");
    let picture = folder.path().join("host.ppm");
    let (shaders, path) = (shaders.to_str().unwrap(), picture.to_str().unwrap());
    let output = run(&program, &[shaders, path, "160", "120"]);
    let (said, failed) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(output.status.success(), "{said}{failed}");
    assert!(failed.is_empty(), "{failed}");
    assert!(said.contains("Gaussians visible"), "{said}");
    let ppm = std::fs::read(&picture).unwrap();
    let pixels = ppm.strip_prefix(b"P6\n160 120\n255\n").unwrap();

    let host = vulkan::Vulkan::new(false).unwrap();
    let gpu = composite::engine_on(&host).unwrap();
    let camera = demo_camera(0.25, 160, 120);
    let mut compositor = composite::Compositor::new(&host, &gpu, &demo_scene(), [160, 120]).unwrap();
    compositor.warm_up(&camera, 0.25).unwrap();
    let expected = compositor.draw(&camera, 0.25, composite::cube(DVec3::new(0.0, 0.0, 0.6), 0.5)).unwrap();
    let off = pixels
        .chunks_exact(3)
        .zip(expected.chunks_exact(4))
        .filter(|(p, q)| p.iter().zip(*q).any(|(a, b)| a.abs_diff(*b) > 2))
        .count();
    // Edges of triangles may fall on either side of a pixel's centre: the two compute their matrices in another order.
    assert!(off <= 160 * 120 / 500, "{off} pixels differ");
}
