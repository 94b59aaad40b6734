#version 460
#extension GL_GOOGLE_include_directive : require

// dL/d(r, translation) of each superpoint: rendering plus property losses; left tangents become gradients of the so(3)
// vector by the transposed left Jacobian.

layout(constant_id = 0) const uint SUBGROUP_SIZE = 32u;
layout(constant_id = 1) const uint PROPERTIES = 1u; // 0: rendering only; 1: the code's property losses; 2: the paper's

#define STEP_BINDING 0
#include "lib/step.glsl"
#define STATUS_BINDING 6
#include "lib/status.glsl"
#include "lib/dispatch.glsl"
#include "lib/quaternion.glsl"
#include "lib/left_jacobian.glsl"

layout(local_size_x = 256) in;

layout(std430, set = 0, binding = 1) readonly buffer PoseBlock { vec4 pose[]; };
layout(std430, set = 0, binding = 2) readonly buffer SuperpointPositionBlock { float superpoint_position[]; };
layout(std430, set = 0, binding = 3) readonly buffer PropertySumBlock { float property_sum[]; };
layout(std430, set = 0, binding = 4) readonly buffer PoseSumBlock { float pose_sum[]; };
layout(std430, set = 0, binding = 5) writeonly buffer SuperpointGradientBlock { float superpoint_gradient[]; };

vec3 property_sums(uint plane, uint j) {
    uint m = step_data.superpoints;
    return vec3(property_sum[plane * m + j], property_sum[(plane + 1u) * m + j], property_sum[(plane + 2u) * m + j]);
}

vec3 pose_sums(uint plane, uint j) {
    uint m = step_data.superpoints;
    return vec3(pose_sum[plane * m + j], pose_sum[(plane + 1u) * m + j], pose_sum[(plane + 2u) * m + j]);
}

void main() {
    uint j = workgroup_index() * 256u + gl_LocalInvocationID.x;
    uint m = step_data.superpoints;
    uint properties = PROPERTIES;
    if (j < m) {
        vec3 r = pose[2u * j].xyz;
        vec3 tangent = pose_sums(13u, j);
        vec3 vector = vec3(0.0);
        vec3 translation = pose_sums(16u, j);
        if (properties == 1u) {
            // The superpoint's own properties reconstruct the Gaussians': minus the weighted residuals pull at it. Its
            // Gaussians' rotation and translation are its own outputs too.
            vec3 x = vec3(superpoint_position[3u * j], superpoint_position[3u * j + 1u], superpoint_position[3u * j + 2u]);
            vec3 pull = -property_sums(4u, j);
            vec3 turned = x + quaternion_displacement(quaternion_exp(r), x);
            tangent += cross(turned, pull);
            vector += property_sums(13u, j) - property_sums(7u, j);
            translation += pull + property_sums(16u, j) - property_sums(10u, j);
        } else if (properties == 2u) {
            tangent += property_sums(13u, j);
            vector += property_sums(16u, j);
            translation += property_sums(19u, j);
        }
        vec3 rotation = vector + left_jacobian_transposed(r, tangent);
        float total = dot(abs(rotation) + abs(translation), vec3(1.0));
        if (!number_is_finite(total)) {
            report_not_finite(STATUS_POSE, j);
            rotation = vec3(0.0);
            translation = vec3(0.0);
        }
        for (uint c = 0u; c < 3u; c++) {
            superpoint_gradient[c * m + j] = rotation[c];
            superpoint_gradient[(3u + c) * m + j] = translation[c];
        }
    }
}
