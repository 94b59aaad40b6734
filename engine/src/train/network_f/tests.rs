#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
use super::*;

#[test]
fn layers_and_network_are_inverse() {
    for (size, weights) in [(DeformSize::PAPER, 501_254), (DeformSize { layers: 3, width: 64 }, 18_502)] {
        let made = DeformNetwork::init(3, size, false);
        assert_eq!(network(&layers(&made).unwrap(), size), made);
        let flat = made.flatten();
        assert_eq!(flat.len(), weights);
        assert_eq!(DeformNetwork::from_flat(&flat, size).unwrap(), made);
        assert!(DeformNetwork::from_flat(&flat[1..], size).is_err());
    }
    let mut wrong = DeformNetwork::init(3, DeformSize::PAPER, false);
    wrong.linear[5].inputs = 256;
    assert!(layers(&wrong).unwrap_err().to_string().contains("deform.linear.5"));
}
