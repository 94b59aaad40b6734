// Adds the slices of a layer's gradient in order. OUTPUT 0 writes the sums, OUTPUT 1 applies Adam; with MEAN a running mean follows
// the weights.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require

layout(local_size_x = 256) in;
layout(constant_id = 0) const uint SUBGROUP_SIZE = 32;
layout(constant_id = 1) const uint OUTPUT = 1;
layout(constant_id = 2) const uint NETWORK = 1;
layout(constant_id = 3) const uint MEAN = 0;

#define STEP_BINDING 0
#define STATUS_BINDING 8
#include "lib/dispatch.glsl"
#include "lib/limits.glsl"
#include "lib/step.glsl"
#include "lib/adam.glsl"
#include "lib/status.glsl"

layout(std430, set = 0, binding = 1) readonly buffer CountersBlock { uint counters[]; };
layout(std430, set = 0, binding = 2) readonly buffer SliceGradientBlock { vec4 slice_gradient[]; }; // [slices, stride]
layout(std430, set = 0, binding = 3) buffer ParameterBlock { vec4 parameter[]; };
layout(std430, set = 0, binding = 4) buffer Moment1Block { vec4 moment_1[]; };
layout(std430, set = 0, binding = 5) buffer Moment2Block { vec4 moment_2[]; };
layout(std430, set = 0, binding = 6) writeonly buffer GradientBlock { vec4 gradient[]; };
layout(std430, set = 0, binding = 7) buffer MeanBlock { vec4 mean[]; };

layout(push_constant) uniform Push {
    uint weights; // of the layer, with its bias
    uint slices;
    uint slice_stride; // floats, a multiple of 4
    uint first_index;  // number of the layer's first weight in the network, for reports
    float mean_rate;   // how far the mean goes towards the weights
} push;

#include "lib/network_update.glsl"

// Four neighbours per thread; what lies past the last weight is padding.
void main() {
    uint at = 4u * (workgroup_index() * 256u + gl_LocalInvocationIndex);
    uint end = counters[COUNT_FAILED] == 0u ? push.weights : 0u;
    uint kind = OUTPUT;
    vec4 sum = vec4(0.0);
    uint count = at < end ? push.slices : 0u;
    for (uint slice = 0u; slice < count; slice++) {
        sum += slice_gradient[(slice * push.slice_stride + at) / 4u];
    }
    if (at < end && kind == 0u) {
        gradient[at / 4u] = sum;
    } else if (at < end) {
        vec4 values = update_four(network_adam(), at, min(end - at, 4u), push.first_index + at, sum);
        uint with_mean = MEAN;
        if (with_mean == 1u) {
            vec4 before = mean[at / 4u];
            mean[at / 4u] = before + push.mean_rate * (values - before);
        }
    }
}
