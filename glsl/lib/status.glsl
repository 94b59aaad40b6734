// Where kernels of the training step say that a number is not finite: per parameter group, how many and the first index.
// Rust mirror: engine/src/train/status.rs. Define STATUS_BINDING before including. The host fills counts with 0 and indices
// with 0xffffffff once; whatever is reported stays until the host looks.
#ifndef SPGS_STATUS
#define SPGS_STATUS

#include "lib/parameters.glsl"

layout(std430, set = 0, binding = STATUS_BINDING) buffer StatusBlock { uint status[]; };

// The Gaussians' parameters are groups PARAMETER_*; after them:
const uint STATUS_NETWORK_F = PARAMETERS;
const uint STATUS_ASSOCIATION = PARAMETERS + 1u;
const uint STATUS_NETWORK_G = PARAMETERS + 2u;
const uint STATUS_IMAGE_GRADIENT = PARAMETERS + 3u;
const uint STATUS_POSE = PARAMETERS + 4u;

// group: PARAMETER_* or STATUS_*; index: of the element within the group's array (for Gaussians: the Gaussian).
void report_not_finite(uint group, uint index) {
    atomicAdd(status[2u * group], 1u);
    atomicMin(status[2u * group + 1u], index);
}

// By bits: a compiler may assume that comparisons never see NaN.
bool number_is_finite(float x) {
    return (floatBitsToUint(x) & 0x7f800000u) != 0x7f800000u;
}

#endif
