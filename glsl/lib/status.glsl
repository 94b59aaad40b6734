// Where kernels of the training step say that a number is not finite: per parameter group, how many and the first index.
// Rust mirror: engine/src/train/status.rs. Define STATUS_BINDING before including. The host fills counts with 0 and indices
// with 0xffffffff once; whatever is reported stays until the host looks.
#ifndef SPGS_STATUS
#define SPGS_STATUS

layout(std430, set = 0, binding = STATUS_BINDING) buffer StatusBlock { uint status[]; };

const uint STATUS_MEAN = 0u;
const uint STATUS_LOG_SCALE = 1u;
const uint STATUS_ROTATION = 2u;
const uint STATUS_OPACITY_LOGIT = 3u;
const uint STATUS_SH = 4u;
const uint STATUS_NETWORK_F = 5u;
const uint STATUS_ASSOCIATION = 6u;
const uint STATUS_NETWORK_G = 7u;
const uint STATUS_IMAGE_GRADIENT = 8u;
const uint STATUS_POSE = 9u;

// group: STATUS_*; index: of the element within the group's array (for Gaussians: the Gaussian).
void report_not_finite(uint group, uint index) {
    atomicAdd(status[2u * group], 1u);
    atomicMin(status[2u * group + 1u], index);
}

// By bits: a compiler may assume that comparisons never see NaN.
bool number_is_finite(float x) {
    return (floatBitsToUint(x) & 0x7f800000u) != 0x7f800000u;
}

#endif
