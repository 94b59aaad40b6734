// Rotations: unit quaternions (w, x, y, z in a vec4's x, y, z, w) and the exponential of so(3). Rust twin:
// engine/src/render/quaternion.rs, line by line.
#ifndef SPGS_QUATERNION
#define SPGS_QUATERNION

#include "angle.glsl"

// a * b: rotates by b, then by a.
vec4 quaternion_product(vec4 a, vec4 b) {
    return vec4(a.x * b.x - a.y * b.y - a.z * b.z - a.w * b.w,
                a.x * b.y + a.y * b.x + a.z * b.w - a.w * b.z,
                a.x * b.z - a.y * b.w + a.z * b.x + a.w * b.y,
                a.x * b.w + a.y * b.z - a.z * b.y + a.w * b.x);
}

// Exp(r) of an so(3) vector r (radians) as (cos(t/2), r sin(t/2)/t), t = |r|. In half angles nothing cancels, so one
// formula serves every t > 0.
vec4 quaternion_exp(vec3 r) {
    float angle2 = dot(r, r);
    float angle = sqrt(angle2);
    vec2 half_angle = sin_cos(0.5 * angle);
    float h = angle2 > 1e-12 ? half_angle.x / angle : 0.5;
    return vec4(half_angle.y, h * r);
}

// (R(e) - I) p for a unit quaternion e = (c, v): 2 c (v x p) + 2 v x (v x p). The displacement rather than the rotated
// point: exactly 0 for e = 1, and rounded relative to the motion instead of relative to |p|.
vec3 quaternion_displacement(vec4 e, vec3 p) {
    vec3 v = e.yzw;
    vec3 a = 2.0 * cross(v, p);
    return e.x * a + cross(v, a);
}

// Columns of the rotation matrix of a unit quaternion.
void quaternion_columns(vec4 q, out vec3 column_0, out vec3 column_1, out vec3 column_2) {
    float w = q.x;
    float x = q.y;
    float y = q.z;
    float z = q.w;
    column_0 = vec3(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y));
    column_1 = vec3(2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x));
    column_2 = vec3(2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y));
}

#endif
