// Adds the slices of a layer's gradient in order. OUTPUT 0 writes the sums, OUTPUT 1 applies Adam.
#version 460
#extension GL_GOOGLE_include_directive : require

layout(local_size_x = 256) in;
layout(constant_id = 0) const uint SUBGROUP_SIZE = 32;
layout(constant_id = 1) const uint OUTPUT = 1;
layout(constant_id = 2) const uint NETWORK = 1;

#define STEP_BINDING 0
#define STATUS_BINDING 7
#include "lib/dispatch.glsl"
#include "lib/limits.glsl"
#include "lib/step.glsl"
#include "lib/adam.glsl"
#include "lib/status.glsl"

layout(std430, set = 0, binding = 1) readonly buffer CountersBlock { uint counters[]; };
layout(std430, set = 0, binding = 2) readonly buffer SliceGradientBlock { float slice_gradient[]; }; // [slices, stride]
layout(std430, set = 0, binding = 3) buffer ParameterBlock { float parameter[]; };
layout(std430, set = 0, binding = 4) buffer Moment1Block { float moment_1[]; };
layout(std430, set = 0, binding = 5) buffer Moment2Block { float moment_2[]; };
layout(std430, set = 0, binding = 6) writeonly buffer GradientBlock { float gradient[]; };

layout(push_constant) uniform Push {
    uint weights; // of the layer, with its bias
    uint slices;
    uint slice_stride; // floats
    uint first_index;  // number of the layer's first weight in the network, for reports
} push;

#include "lib/network_update.glsl"

const uint PER_THREAD = 4u;

void main() {
    uint first = workgroup_index() * 256u * PER_THREAD + gl_LocalInvocationIndex;
    uint end = counters[COUNT_FAILED] == 0u ? push.weights : 0u;
    uint kind = OUTPUT;
    NetworkAdam with = network_adam();
    for (uint i = 0u; i < PER_THREAD; i++) {
        uint at = first + i * 256u;
        uint count = at < end ? push.slices : 0u;
        float sum = 0.0;
        for (uint slice = 0u; slice < count; slice++) {
            sum += slice_gradient[slice * push.slice_stride + at];
        }
        if (at < end && kind == 0u) {
            gradient[at] = sum;
        } else if (at < end) {
            update_weight(with, at, push.first_index + at, sum);
        }
    }
}
