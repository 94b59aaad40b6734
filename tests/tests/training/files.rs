//! Checkpoint files: whatever happens to one, reading it is an answer or an error.

use engine::train::checkpoint::Checkpoint;
use tests_harness::render_case::Random;

use crate::common::{PosedOptions, advance, config, gpu, load, posed, trainer};

/// A small checkpoint with motion: its bytes.
fn sample(folder: &std::path::Path) -> Vec<u8> {
    let posed = posed(&PosedOptions::default());
    let (_, data) = load(&posed);
    let gpu = gpu();
    let config = config("[schedule]\nwarm_up = 2\n[gaussians]\nrandom_points = 20\n[density]\nenabled = false");
    let mut trainer = trainer(&gpu, &config, &data).unwrap();
    advance(&mut trainer, 3).unwrap();
    let checkpoint = trainer.checkpoint().unwrap();
    let path = checkpoint.save(folder).unwrap();
    assert_eq!(Checkpoint::load(&path).unwrap(), checkpoint, "what is written is read");
    std::fs::read(path).unwrap()
}

#[test]
fn every_damage_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let bytes = sample(folder.path());
    let path = folder.path().join("damaged.safetensors");
    let refuse = |bytes: &[u8], what: String| {
        std::fs::write(&path, bytes).unwrap();
        match Checkpoint::load(&path) {
            Err(e) => assert!(e.to_string().contains("damaged.safetensors"), "{what}: {e}"),
            Ok(_) => panic!("{what}: accepted"),
        }
    };
    let mut random = Random(5);
    let n = bytes.len();
    let lengths = (0..64).chain((0..40).map(|_| (random.bits() % n as u64) as usize)).chain(n - 24..n);
    for length in lengths.collect::<Vec<_>>() {
        refuse(&bytes[..length], format!("{length} of {n} bytes"));
    }
    for k in 0..150 {
        // A third of them in the header, the first few kilobytes.
        let range = if k % 3 == 0 { 6000.min(n) } else { n };
        let bit = (random.bits() % (8 * range as u64)) as usize;
        let mut copy = bytes.clone();
        copy[bit / 8] ^= 1 << (bit % 8);
        refuse(&copy, format!("bit {bit}"));
    }
    refuse(&[&bytes[..], &[0]].concat(), "one byte more".into());
}
