#version 460
#extension GL_GOOGLE_include_directive : require

// One step of Adam on a flat array. Twin: engine/src/train/adam.rs.

#include "lib/dispatch.glsl"
#include "lib/limits.glsl"

layout(local_size_x = 256) in;
layout(constant_id = 0) const uint SUBGROUP_SIZE = 32u;

#define STEP_BINDING 0
#include "lib/step.glsl"
#include "lib/adam.glsl"
layout(std430, set = 0, binding = 1) readonly buffer CountersBlock { uint counters[]; };
layout(std430, set = 0, binding = 2) readonly buffer GradientBlock { float gradient[]; };
layout(std430, set = 0, binding = 3) buffer ValueBlock { float value[]; };
layout(std430, set = 0, binding = 4) buffer Moment1Block { float moment_1[]; };
layout(std430, set = 0, binding = 5) buffer Moment2Block { float moment_2[]; };
#define STATUS_BINDING 6
#include "lib/status.glsl"

layout(push_constant) uniform PushBlock {
    uint count;
    uint rate;  // which of rate_0, rate_1, rate_2
    uint bias;  // which pair of bias_0, bias_1
    uint group; // STATUS_*
} push;

void main() {
    uint i = workgroup_index() * 256u + gl_LocalInvocationID.x;
    if (i >= push.count || counters[COUNT_FAILED] != 0u) {
        return;
    }
    uint column = push.rate & 3u;
    float rate = push.rate < 4u ? step_data.rate_0[column]
        : push.rate < 8u ? step_data.rate_1[column] : step_data.rate_2[column];
    vec4 pair = push.bias < 2u ? step_data.bias_0 : step_data.bias_1;
    vec2 bias = (push.bias & 1u) == 0u ? pair.xy : pair.zw;
    vec2 moments = vec2(moment_1[i], moment_2[i]);
    float g = gradient[i];
    float updated = adam_update(value[i], g, moments, rate, bias);
    bool good = number_is_finite(g) && number_is_finite(updated) && number_is_finite(moments.x) && number_is_finite(moments.y);
    if (good) {
        value[i] = updated;
        moment_1[i] = moments.x;
        moment_2[i] = moments.y;
    } else {
        report_not_finite(push.group, i);
    }
}
