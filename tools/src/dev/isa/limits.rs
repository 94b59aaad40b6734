//! What is never right, and the exceptions with their reasons.

use super::statistics::Row;
use super::target::Target;

/// A kernel that may have fewer subgroups in flight than the floor.
#[derive(Debug, Clone, Copy)]
pub struct Exception {
    /// Targets whose name begins so.
    pub target: &'static str,
    /// The kernel.
    pub kernel: &'static str,
    /// Fewest that are accepted.
    pub floor: f64,
    /// Why.
    pub why: &'static str,
}

/// The exceptions.
pub const EXCEPTIONS: &[Exception] = &[
    Exception { target: "radv_vega10", kernel: "ssim_forward", floor: 2.0, why: SHARED_ON_GCN },
    Exception { target: "radv_vega10", kernel: "image_loss", floor: 2.0, why: SHARED_ON_GCN },
    Exception { target: "radv_vega10", kernel: "nonrigid_network", floor: 2.0, why: SHARED_ON_GCN },
    Exception {
        target: "radv_vega10",
        kernel: "deform_project_backward",
        floor: 2.0,
        why: "128 of 256 registers hold a Gaussian's parameters and their gradients at SH degree 3 for the fused Adam step",
    },
];

const SHARED_ON_GCN: &str = "16 KiB of shared memory for two waves, of which a compute unit has 64 KiB for four SIMDs: \
                             half of what RDNA has, where eight waves are in flight";

/// Constants that have one value in the recordings on a GPU: kernels by the beginning of their names, constant, why.
const ONE_VALUE: &[(&str, &str, &str)] = &[
    ("", "STAGE", "decided by the kind of device"),
    ("", "PIXELS_PER_LANE", "decided by the subgroup size"),
    ("", "THREADS", "follows from STAGE"),
    ("scan_tiles", "LONG", "long lists have a dispatch of their own on CPU devices only"),
    ("sort_tiles", "SHORTEST", "as LONG of scan_tiles"),
    ("sort_tiles", "LONGEST", "as LONG of scan_tiles"),
    ("sort_tiles", "AT_ONCE", "decided by the kind of device"),
    ("sort_scatter", "RANK_BY_BALLOT", "decided by the subgroup size"),
    ("sort_scatter", "HAS_VALUES", "every sort of the program carries values; sorts without are for tests"),
    ("blend_backward", "ACCUMULATE", "decided by the device's float atomics"),
    ("blend_backward", "SUBTILES", "follows from ACCUMULATE"),
    ("blend_states", "SEGMENTS", "the recordings' pictures have one size"),
    ("blend_", "LEAST_SEGMENT", "one number for all devices; others are for tests"),
    ("blend_", "WITH_SLOTS", "slots are for training, which blends into floats"),
    (
        "linear_forward",
        "VECTORS",
        "networks of the recordings have whole vectors of four in each row, and fields are filled up to them",
    ),
    ("deform_network", "LAYERS", "the length of a loop; nothing is sized by it"),
    ("deform_network", "WIDTH", "as LAYERS"),
    ("deform_network", "SKIP_LAYER", "as LAYERS"),
    ("image_loss", "TARGET", "photos are RGBA8; float targets are for tests"),
    ("ssim_forward", "TARGET", "as image_loss"),
    ("linear_backward", "VECTORS", "the strides of both networks are multiples of four; others are for tests"),
    ("linear_update", "OUTPUT", "training ends in Adam; plain gradients are for tests"),
    ("property_backward", "NEIGHBORS", "the paper's form is recorded with the default"),
    ("property_backward", "SLOTS", "as NEIGHBORS"),
    ("association_update", "NEIGHBORS", "recorded with three soft superpoints"),
    ("association_update", "SLOTS", "as NEIGHBORS"),
    ("association_update", "PROPERTY", "runs without property losses are for tests"),
];

/// The exception that a pipeline comes under, by its place in [`EXCEPTIONS`].
pub fn exception(target: &Target, row: &Row) -> Option<usize> {
    EXCEPTIONS.iter().position(|e| target.name.starts_with(e.target) && row.kernel == e.kernel)
}

/// Whether the program gives a constant of a kernel but one value: what it could be besides is for tests.
pub fn one_value(kernel: &str, constant: &str) -> bool {
    ONE_VALUE.iter().any(|(names, name, _)| kernel.starts_with(names) && *name == constant)
}

/// What is wrong with a pipeline, whatever the golden file says.
pub fn broken(target: &Target, row: &Row) -> Option<String> {
    let s = &row.statistics;
    let name = row.name();
    if s.spills > 0.0 {
        return Some(format!("{}: {name} spills {} registers, expected none", target.name, s.spills));
    }
    if s.scratch > 0.0 {
        return Some(format!(
            "{}: {name} keeps {} bytes in memory per invocation, expected none",
            target.name, s.scratch
        ));
    }
    let floor = exception(target, row).map_or(target.floor, |i| EXCEPTIONS[i].floor);
    (s.occupancy < floor)
        .then(|| format!("{}: {name} has {} subgroups in flight, expected at least {floor}", target.name, s.occupancy))
}
