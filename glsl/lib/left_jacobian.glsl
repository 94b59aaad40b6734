// The left Jacobian of Exp on so(3). Rust twin: left_jacobian_transposed in engine/src/render/quaternion.rs.
#ifndef SPGS_LEFT_JACOBIAN
#define SPGS_LEFT_JACOBIAN

#include "angle.glsl"

// J_l(r)^T w = w - B r x w + C r x (r x w), B = (1 - cos t)/t^2 = (sin(t/2)/t)^2 * 2, C = (t - sin t)/t^3.
vec3 left_jacobian_transposed(vec3 r, vec3 w) {
    float angle2 = dot(r, r);
    float angle = sqrt(angle2);
    float h = angle2 > 1e-12 ? sin_cos(0.5 * angle).x / angle : 0.5;
    float b = 2.0 * h * h;
    // Below one radian the closed form cancels; the first term of the series left out is t^10/6e9.
    float series = 1.0 / 6.0 - angle2 * (1.0 / 120.0 - angle2 * (1.0 / 5040.0 - angle2 * (1.0 / 362880.0 - angle2 * (1.0 / 39916800.0))));
    float c = angle2 < 1.0 ? series : (angle - sin_cos(angle).x) / (angle2 * max(angle, 1.0));
    vec3 turned = cross(r, w);
    return w - b * turned + c * cross(r, turned);
}

#endif
