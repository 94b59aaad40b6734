// Where a Gaussian is at the frame's time: rigidly moved by its superpoint, then shifted by its non-rigid offset. Shared by
// `deform_project` and its backward, which declare the buffers mean, log_scale, rotation, superpoint_of_gaussian, pose,
// blend_index, blend_weight and nonrigid_offset and the constants MOTION, BLEND and NONRIGID. Include lib/frame.glsl, quaternion.glsl and projection.glsl
// first.
#ifndef SPGS_PLACE
#define SPGS_PLACE

#include "superpoint_motion.glsl"

// Camera-relative centre d and rotation `turn` of its superpoints; false when a number that enters is unusable, which then moves nothing.
// One way out, here and below: subgroup operations follow, and where lanes meet after early returns is left to compilers.
//
// In two parts, d is exact for a camera and a Gaussian that share a large offset from the origin.
bool place_mean(uint g, uint n, vec3 canonical, out vec3 d, out vec4 turn) {
    precise vec3 relative = (canonical - frame.camera_position_high) - frame.camera_position_low;
    d = relative;
    turn = vec4(1.0, 0.0, 0.0, 0.0);
    bool usable = true;
    uint motion = MOTION;
    if (motion == 1u) {
        vec3 displacement;
        usable = superpoint_motion(g, n, canonical, displacement, turn);
        d += displacement;
    }
    uint nonrigid = NONRIGID;
    if (nonrigid == 1u) {
        vec3 dx = vec3(nonrigid_offset[g], nonrigid_offset[n + g], nonrigid_offset[2u * n + g]);
        usable = usable && within(dx, MAX_ABS_TRANSLATION);
        if (usable) {
            d += dx;
        }
    }
    return usable;
}

// Rotation and standard deviations, with what their backward needs.
struct Shape {
    vec4 unit;    // q0 / |q0|
    float norm;   // |q0|
    vec4 rigid;   // Exp(r) * unit
    vec4 q;       // unit quaternion that is drawn
    float sum;    // |rigid + dq|
    vec3 own;     // exp(log_scale)
    vec3 added;   // own + ds
    vec3 scale;   // at least MIN_SCALE
};

// False when a number that enters is unusable.
bool place_shape(uint g, uint n, vec4 turn, out Shape shape) {
    vec3 log_s = vec3(log_scale[g], log_scale[n + g], log_scale[2u * n + g]);
    vec4 q = rotation[g];
    float norm2 = dot(q, q);
    bool usable = within(log_s, MAX_ABS_LOG_SCALE) && is_finite(norm2) && norm2 > MIN_ROTATION_NORM2;
    shape.norm = sqrt(norm2);
    shape.unit = q / shape.norm;
    shape.rigid = quaternion_product(turn, shape.unit);
    shape.q = shape.rigid;
    shape.sum = 1.0;
    shape.own = exp(log_s);
    shape.added = shape.own;
    shape.scale = shape.own;
    uint nonrigid = NONRIGID;
    if (nonrigid == 1u) {
        vec4 dq = vec4(nonrigid_offset[3u * n + g], nonrigid_offset[4u * n + g], nonrigid_offset[5u * n + g],
                       nonrigid_offset[6u * n + g]);
        vec4 sum = shape.rigid + dq;
        float sum2 = dot(sum, sum);
        shape.added += vec3(nonrigid_offset[7u * n + g], nonrigid_offset[8u * n + g], nonrigid_offset[9u * n + g]);
        usable = usable && is_finite(sum2) && sum2 > MIN_ROTATION_NORM2 && within(shape.added, MAX_SCALE);
        shape.sum = sqrt(sum2);
        shape.q = sum / shape.sum;
        shape.scale = max(shape.added, vec3(MIN_SCALE));
    }
    return usable;
}

#endif
