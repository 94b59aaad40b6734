#version 460
#extension GL_GOOGLE_include_directive : require

// Lowers every opacity to a limit and clears its moments. Where Gaussians are smoothed, it is the opacity that the smoothing
// leaves which is lowered: the others would not be seen again.

#include "lib/dispatch.glsl"
#include "lib/smoothing.glsl"

layout(local_size_x = 256) in;
layout(constant_id = 0) const uint SUBGROUP_SIZE = 32u;
layout(constant_id = 1) const uint SMOOTHED = 0; // 1: there is a smoothing

layout(std430, set = 0, binding = 0) buffer OpacityLogitBlock { float opacity_logit[]; };
layout(std430, set = 0, binding = 1) writeonly buffer Moment1Block { float moment_1[]; };
layout(std430, set = 0, binding = 2) writeonly buffer Moment2Block { float moment_2[]; };
layout(std430, set = 0, binding = 3) readonly buffer LogScaleBlock { float log_scale[]; };
layout(std430, set = 0, binding = 4) readonly buffer OptionalBlock { float optional[]; };

layout(push_constant) uniform PushBlock {
    uint gaussians;
    float limit;    // logit
    float opacity;  // the same limit
    uint plane;     // of the opacity's moments
    uint smoothing; // plane in `optional`
} push;

const float MOST = 0.5; // opacity that is always lowered

// Logit of what is lowered to the limit by the smoothing of Gaussian i.
float smoothed_limit(uint i, uint n) {
    vec3 share;
    smoothed(exp(vec3(log_scale[i], log_scale[n + i], log_scale[2u * n + i])), optional[push.smoothing * n + i], share);
    float left = sqrt(share.x) * sqrt(share.y) * sqrt(share.z);
    float opacity = left * MOST > push.opacity ? push.opacity / left : MOST;
    return log(opacity / (1.0 - opacity));
}

void main() {
    uint i = workgroup_index() * 256u + gl_LocalInvocationID.x;
    if (i < push.gaussians) {
        float value = opacity_logit[i];
        float limit = push.limit;
        uint with_smoothing = SMOOTHED;
        if (with_smoothing == 1u) {
            limit = smoothed_limit(i, push.gaussians);
        }
        opacity_logit[i] = value > limit ? limit : value;
        moment_1[push.plane * push.gaussians + i] = 0.0;
        moment_2[push.plane * push.gaussians + i] = 0.0;
    }
}
