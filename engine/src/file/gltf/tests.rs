//! Round trip; axes.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use super::*;
use crate::file::codec::{sigmoid, unit};
use crate::scene::synthetic::random_gaussians;

#[test]
fn a_written_file_is_read_back() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.glb");
    for degree in 0..4 {
        let g = random_gaussians(50, 3, degree);
        write(&path, &g).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let back = parse(&bytes, &path).unwrap();
        assert_eq!((&back.mean, &back.sh, back.sh_degree), (&g.mean, &g.sh, degree), "these keep their bits");
        for i in 0..50 {
            let far = |a: f32, b: f32| (a - b).abs() > 1e-5 * b.abs().max(1.0);
            assert!(!(0..3).any(|a| far(back.log_scale[i][a], g.log_scale[i][a])));
            assert!((sigmoid(back.opacity_logit[i]) - sigmoid(g.opacity_logit[i])).abs() < 2e-6);
            let dot: f64 = unit(back.rotation[i]).iter().zip(unit(g.rotation[i])).map(|(a, b)| a * b).sum();
            assert!(dot > 1.0 - 1e-6);
        }
        // Without the node's turn the same numbers are in glTF's axes.
        let text = String::from_utf8_lossy(&bytes).into_owned();
        assert!(text.contains("\"rotation\":[1.0,0.0,0.0,0.0]"));
        let at = bytes.windows(12).position(|w| w == b"[1.0,0.0,0.0").unwrap();
        let mut plain = bytes.clone();
        plain[at..at + 17].copy_from_slice(b"[0.0,0.0,0.0,1.0]");
        let other = parse(&plain, &path).unwrap();
        assert_eq!(other.mean[7], [g.mean[7][0], -g.mean[7][1], -g.mean[7][2]]);
    }
}
