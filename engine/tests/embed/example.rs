//! The example host: a mesh and the scene, hidden and seen by depth.

use engine::scene::synthetic::{demo_camera, demo_scene};
use glam::DVec3;

use super::*;
use crate::composite::{Compositor, cube};

const SIZE: [u32; 2] = [160, 120];

fn differing(a: &[u8], b: &[u8]) -> usize {
    a.chunks_exact(4).zip(b.chunks_exact(4)).filter(|(p, q)| p.iter().zip(*q).any(|(x, y)| x.abs_diff(*y) > 2)).count()
}

/// Mean absolute difference, levels.
fn change(a: &[u8], b: &[u8]) -> f64 {
    a.iter().zip(b).map(|(x, y)| f64::from(x.abs_diff(*y))).sum::<f64>() / a.len() as f64
}

#[test]
fn a_mesh_and_a_scene_hide_each_other() {
    let host = Host::new();
    let camera = demo_camera(0.25, SIZE[0], SIZE[1]);
    let scene = demo_scene();
    let mut compositor = Compositor::new(&host.vulkan, host.gpu(), &scene, SIZE).unwrap();
    compositor.warm_up(&camera, 0.25).unwrap();
    let ahead = camera.rotation.transpose() * DVec3::Z;
    let mut draw = |at: DVec3, size: f64| compositor.draw(&camera, 0.25, cube(at, size)).unwrap();
    // Behind the camera, in front of everything, inside the scene, above the floor and below it.
    let without = draw(camera.position - ahead * 5.0, 0.3);
    let before = draw(camera.position + ahead * 2.0, 0.2);
    let among = draw(DVec3::new(0.0, 0.0, 0.6), 0.5);
    let [above, below] = [0.6, -0.6].map(|z| draw(DVec3::new(0.0, 0.0, z), 0.3));
    let pixels = (SIZE[0] * SIZE[1]) as usize;
    let seen = [&before, &among].map(|p| differing(p, &without));
    println!("pixels that the mesh changes: {seen:?} of {pixels}");
    // The cube in front shows whole: a square of 0.4 at distance 2.
    let edge = 0.4 / 2.0 * camera.fx;
    assert!(seen[0] as f64 > 0.9 * edge * edge && (seen[0] as f64) < 3.0 * edge * edge, "{seen:?}");
    assert!(seen[1] > 50 && seen[1] < pixels / 2, "{seen:?}");
    let [above, below] = [above, below].map(|p| change(&p, &without));
    println!("change by the cube above the floor {above:.2}, below it {below:.2}");
    assert!(below < 0.15 * above, "the floor hides it: {below} of {above}");
    // In front, the cube's own colours: the centre pixel is the mesh's, not the scene's.
    let centre = 4 * (60 * 160 + 80);
    assert!(before[centre + 3] == 255 && differing(&before[centre..centre + 4], &without[centre..centre + 4]) == 1);
    drop(compositor);
}

/// The committed SPIR-V of the example's shaders is that of their sources.
#[test]
fn shaders_of_the_example_are_fresh() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/shaders");
    for name in ["mesh.vert", "mesh.frag", "composite.vert", "composite.frag"] {
        let out = tempfile::NamedTempFile::new().unwrap();
        let status = std::process::Command::new("glslc")
            .args(["--target-env=vulkan1.2", "-O0", "-o"])
            .args([out.path(), &folder.join(name)])
            .status()
            .expect("glslc (ci/setup --tests installs it)");
        assert!(status.success());
        let fresh = std::fs::read(out.path()).unwrap() == std::fs::read(folder.join(format!("{name}.spv"))).unwrap();
        assert!(fresh, "{name}.spv is stale: glslc --target-env=vulkan1.2 -O0 {name} -o {name}.spv");
    }
}
