#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
use super::*;

#[test]
fn layers_and_network_are_inverse() {
    let made = NonrigidNetwork::init(3);
    let layers = made.device_layers().unwrap();
    let lengths: Vec<usize> = layers.iter().map(Vec::len).collect();
    let expected: Vec<usize> = shapes().iter().map(|s| s.parameters() as usize).collect();
    assert_eq!(lengths, expected);
    assert_eq!(NonrigidNetwork::from_device_layers(&layers).unwrap(), made);
    assert!(NonrigidNetwork::from_device_layers(&layers[..3]).is_err());
    let flat = made.flatten();
    assert_eq!(flat.len(), 14_410);
    assert_eq!(NonrigidNetwork::from_flat(&flat).unwrap(), made);
    let packed = nonrigid_network::pack_parameters(&made).unwrap();
    assert_eq!(packed.len(), shapes().iter().map(|s| s.parameters().next_multiple_of(64) as usize).sum::<usize>());
}
