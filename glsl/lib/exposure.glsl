// A photo's exposure: an affine map of colours, float[photos][EXPOSURE_WORDS]. Rust mirror: engine/src/train/exposure.rs. Include
// lib/step.glsl first and define EXPOSURE_BINDING and EXPOSURE_ACCESS (readonly, or nothing).
#ifndef SPGS_EXPOSURE
#define SPGS_EXPOSURE

layout(std430, set = 0, binding = EXPOSURE_BINDING) EXPOSURE_ACCESS buffer ExposureBlock { float exposure[]; };

const uint EXPOSURE_VALUES = 12u;    // rows of (red, green, blue, 1)
const uint EXPOSURE_MOMENT_1 = 12u;
const uint EXPOSURE_MOMENT_2 = 24u;
const uint EXPOSURE_DECAY = 36u;     // beta_1^t, beta_2^t after t updates
const uint EXPOSURE_WORDS = 40u;
const uint EXPOSURE_THREADS = 256u;
const uint EXPOSURE_PIXELS = 2048u;  // of a workgroup of exposure_backward

// Word at which the step's photo begins.
uint exposure_row() {
    return EXPOSURE_WORDS * step_data.exposure;
}

vec4 exposure_channel(uint row, uint channel) {
    uint at = row + 4u * channel;
    return vec4(exposure[at], exposure[at + 1u], exposure[at + 2u], exposure[at + 3u]);
}

#endif
