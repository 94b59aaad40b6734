#version 460
#extension GL_GOOGLE_include_directive : require

// Lowers every opacity to a limit and clears its moments.

#include "lib/dispatch.glsl"

layout(local_size_x = 256) in;
layout(constant_id = 0) const uint SUBGROUP_SIZE = 32u;

layout(std430, set = 0, binding = 0) buffer OpacityLogitBlock { float opacity_logit[]; };
layout(std430, set = 0, binding = 1) writeonly buffer Moment1Block { float moment_1[]; };
layout(std430, set = 0, binding = 2) writeonly buffer Moment2Block { float moment_2[]; };

layout(push_constant) uniform PushBlock {
    uint gaussians;
    float limit;  // logit
    uint plane;   // of the opacity's moments
} push;

void main() {
    uint i = workgroup_index() * 256u + gl_LocalInvocationID.x;
    if (i < push.gaussians) {
        float value = opacity_logit[i];
        opacity_logit[i] = value > push.limit ? push.limit : value;
        moment_1[push.plane * push.gaussians + i] = 0.0;
        moment_2[push.plane * push.gaussians + i] = 0.0;
    }
}
