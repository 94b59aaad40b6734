#version 460
#extension GL_GOOGLE_include_directive : require

// The properties of each Gaussian (paper's form of the property losses): position at the step's time, so(3) vector and
// translation of its superpoint, a row of 9.

layout(constant_id = 0) const uint SUBGROUP_SIZE = 32u;

#define STEP_BINDING 0
#include "lib/step.glsl"
#include "lib/dispatch.glsl"
#include "lib/quaternion.glsl"

layout(local_size_x = 256) in;

layout(std430, set = 0, binding = 1) readonly buffer MeanBlock { float mean[]; };
layout(std430, set = 0, binding = 2) readonly buffer SuperpointOfGaussianBlock { uint superpoint_of_gaussian[]; };
layout(std430, set = 0, binding = 3) readonly buffer PoseBlock { vec4 pose[]; };
layout(std430, set = 0, binding = 4) writeonly buffer PropertyValueBlock { float property_value[]; };

#include "lib/property.glsl"

void main() {
    uint i = workgroup_index() * 256u + gl_LocalInvocationID.x;
    uint n = step_data.gaussians;
    if (i < n) {
        vec3 turned, position, rotation, translation;
        moved_properties(own_superpoint(i), canonical_mean(i), turned, position, rotation, translation);
        for (uint c = 0u; c < 3u; c++) {
            property_value[9u * i + c] = position[c];
            property_value[9u * i + 3u + c] = rotation[c];
            property_value[9u * i + 6u + c] = translation[c];
        }
    }
}
