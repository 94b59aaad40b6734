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

void main() {
    uint at = workgroup_index() * 256u + gl_LocalInvocationIndex;
    bool runs = at < push.weights && counters[COUNT_FAILED] == 0u;
    uint count = runs ? push.slices : 0u;
    float sum = 0.0;
    for (uint slice = 0u; slice < count; slice++) {
        sum += slice_gradient[slice * push.slice_stride + at];
    }
    uint kind = OUTPUT;
    if (runs && kind == 0u) {
        gradient[at] = sum;
    } else if (runs) {
        update_weight(at, push.first_index + at, sum);
    }
}
