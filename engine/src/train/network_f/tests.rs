#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
use super::*;

#[test]
fn layers_and_network_are_inverse() {
    let made = DeformNetwork::init(3, DeformSize { layers: 3, width: 64 }, false);
    assert_eq!(network(&layers(&made).unwrap(), made.size()), made);
    let flat = made.flatten();
    assert_eq!(flat.len(), 501_254);
    assert_eq!(DeformNetwork::from_flat(&flat, made.size()).unwrap(), made);
    assert!(DeformNetwork::from_flat(&flat[1..], made.size()).is_err());
    let mut wrong = made;
    wrong.linear[5].inputs = 256;
    assert!(layers(&wrong).unwrap_err().to_string().contains("deform.linear.5"));
}
