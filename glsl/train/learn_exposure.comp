// A step of Adam for the exposure of the step's photo, which is held to its start, from the sums of the workgroups in a fixed
// order. One workgroup. Nothing changes when the forward pass failed.
#version 460
#extension GL_GOOGLE_include_directive : require

layout(local_size_x = 256) in;
layout(constant_id = 0) const uint SUBGROUP_SIZE = 32u;

#include "lib/frame.glsl"
#include "lib/limits.glsl"
#define STEP_BINDING 1
#include "lib/step.glsl"
#define EXPOSURE_BINDING 2
#define EXPOSURE_ACCESS
#include "lib/exposure.glsl"
#define STATUS_BINDING 5
#include "lib/status.glsl"

layout(std430, set = 0, binding = 3) readonly buffer ExposurePartialBlock { float exposure_partial[]; }; // [groups][12]
layout(std430, set = 0, binding = 4) readonly buffer CountersBlock { uint counters[]; };

layout(push_constant) uniform PushBlock {
    float hold; // weight of the term that holds the map to the identity
} push;

const float BETA_1 = 0.9;
const float BETA_2 = 0.99; // a photo is seen in few of the steps
const float EPSILON = 1e-12;
const uint LANES = 16u;    // of a value; 12 of 16 columns are used

shared float sums[EXPOSURE_THREADS];
shared vec2 decay; // of this step: one thread alone reads and writes the photo's

void main() {
    uint thread = gl_LocalInvocationIndex;
    uint value = thread % 16u;
    uint lane = thread / 16u;
    uint groups = (frame.size.x * frame.size.y + EXPOSURE_PIXELS - 1u) / EXPOSURE_PIXELS;
    float sum = 0.0;
    for (uint g = lane; g < groups; g += LANES) {
        sum += value < EXPOSURE_VALUES ? exposure_partial[g * EXPOSURE_VALUES + value] : 0.0;
    }
    sums[thread] = sum;
    uint row = exposure_row();
    if (thread == 0u) {
        decay = vec2(BETA_1, BETA_2) * vec2(exposure[row + EXPOSURE_DECAY], exposure[row + EXPOSURE_DECAY + 1u]);
    }
    barrier();
    bool failed = counters[COUNT_FAILED] != 0u;
    if (gl_WorkGroupID.x == 0u && lane == 0u && value < EXPOSURE_VALUES && !failed) {
        float gradient = 0.0;
        for (uint l = 0u; l < LANES; l++) {
            gradient += sums[16u * l + value];
        }
        float own = exposure[row + value];
        gradient += push.hold * (own - (value % 5u == 0u ? 1.0 : 0.0));
        if (!number_is_finite(gradient)) {
            report_not_finite(STATUS_IMAGE_GRADIENT, step_data.exposure);
        } else {
            float moment_1 = BETA_1 * exposure[row + EXPOSURE_MOMENT_1 + value] + (1.0 - BETA_1) * gradient;
            float moment_2 = BETA_2 * exposure[row + EXPOSURE_MOMENT_2 + value] + (1.0 - BETA_2) * gradient * gradient;
            exposure[row + EXPOSURE_MOMENT_1 + value] = moment_1;
            exposure[row + EXPOSURE_MOMENT_2 + value] = moment_2;
            float size = sqrt(moment_2 / (1.0 - decay.y)) + EPSILON;
            exposure[row + value] = own - step_data.rate_exposure * moment_1 / ((1.0 - decay.x) * size);
        }
        if (value == 0u) {
            exposure[row + EXPOSURE_DECAY] = decay.x;
            exposure[row + EXPOSURE_DECAY + 1u] = decay.y;
        }
    }
}
