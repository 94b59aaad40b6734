//! Which subgroup size each kernel gets: that of the table where the device can pin it, the device's own elsewhere.
#![allow(clippy::panic, clippy::unwrap_used, reason = "tests")]

use engine::gpu::subgroup_size::{AMD, CHOICES, INTEL, QUALCOMM, SIZES};
use engine::gpu::{Capabilities, DeviceInfo, Kernel};

fn device(vendor: u32, kind: &'static str, [least, usual, most]: [u32; 3]) -> DeviceInfo {
    let capabilities = Capabilities {
        subgroup_size: usual,
        min_subgroup_size: least,
        max_subgroup_size: most,
        max_workgroup_subgroups: 64,
        ..Capabilities::default()
    };
    DeviceInfo { vendor, kind, capabilities, ..DeviceInfo::default() }
}

fn kernel(name: &str) -> &'static Kernel {
    let mut all = engine::kernels();
    all.find(|k| k.name == name).unwrap_or_else(|| panic!("no kernel {name}"))
}

#[test]
fn every_named_kernel_exists_and_fits() {
    for choice in CHOICES {
        assert!(SIZES.contains(&choice.size) && choice.size.is_power_of_two(), "{choice:?}");
        choice.kernels.iter().for_each(|name| assert!(kernel(name).local_size.is_multiple_of(choice.size)));
    }
}

#[test]
fn a_gpu_that_can_choose_gets_the_size_of_the_table() {
    let rdna = device(AMD, "discrete", [32, 64, 64]);
    assert_eq!(rdna.subgroup_size_of(kernel("blend"), None), 32);
    assert_eq!(rdna.subgroup_size_of(kernel("deform_project"), None), 64);
    assert_eq!(rdna.subgroup_size_of(kernel("blend"), Some(64)), 64);
    assert_eq!(rdna.subgroup_size_of(kernel("blend"), Some(16)), 32, "a size that cannot be pinned is not forced");
    assert_eq!(device(INTEL, "integrated", [8, 32, 32]).subgroup_size_of(kernel("blend"), None), 16);
    let adreno = device(QUALCOMM, "integrated", [64, 128, 128]);
    assert_eq!(["blend", "emit_tiles"].map(|name| adreno.subgroup_size_of(kernel(name), None)), [64, 128]);
}

#[test]
fn devices_that_cannot_choose_keep_their_size() {
    let fixed = [
        device(AMD, "discrete", [64, 64, 64]),
        device(0x10DE, "discrete", [32, 32, 32]),
        // lavapipe and SwiftShader, and a software device that could choose.
        device(0x10005, "cpu", [8, 8, 8]),
        device(0x1AE0, "cpu", [4, 4, 4]),
        device(INTEL, "cpu", [8, 8, 32]),
    ];
    for d in fixed {
        for k in engine::kernels() {
            assert_eq!(d.subgroup_size_of(k, None), d.capabilities.subgroup_size, "{} on {d:?}", k.name);
        }
    }
    let mut few = device(INTEL, "integrated", [8, 32, 32]);
    few.capabilities.max_workgroup_subgroups = 8;
    assert_eq!(few.subgroup_size_of(kernel("blend"), None), 16);
    assert_eq!(few.subgroup_size_of(kernel("emit_tiles"), None), 32, "16 subgroups are more than the device pins");
}
