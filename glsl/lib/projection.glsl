// Shared by `deform_project` and its backward: limits of valid numbers and the projected covariance. The Rust twin of the
// forward is in engine/src/render/deform_project.rs, line by line.
#ifndef SPGS_PROJECTION
#define SPGS_PROJECTION

const float DILATION_PX2 = 0.3;                  // added to the diagonal of the 2-D covariance
const float ROOT_HALF_LOG2_E = 0.8493218002880191; // sqrt(log2(e) / 2), folded into the Cholesky factor
const float MAX_ABS_MEAN = 1e15;                 // as scene::gaussians: beyond these f32 squares overflow
const float MAX_ABS_LOG_SCALE = 30.0;
const float MAX_ABS_TRANSLATION = 1e15;
const float MAX_ABS_COLOUR = 1e9;
const float MIN_ROTATION_NORM2 = 1e-24;
const float MIN_SCALE = 9.357623e-14;            // exp(-30): what a non-rigid offset leaves at least
const float MAX_SCALE = 1.1e13;                  // a little above exp(30)

// By bits: a compiler may assume that comparisons never see NaN.
bool is_finite(float x) {
    return (floatBitsToUint(x) & 0x7f800000u) != 0x7f800000u;
}

bool is_finite(vec3 v) {
    return all(notEqual(floatBitsToUint(v) & 0x7f800000u, uvec3(0x7f800000u)));
}

// Whether each is at most `limit` from 0. The bits of a size grow with it, and those of infinity and NaN are the largest.
bool within(vec3 v, float limit) {
    return all(lessThanEqual(floatBitsToUint(v) & 0x7fffffffu, uvec3(floatBitsToUint(limit))));
}

// Sums of the projected covariance M M' + dilation, M = J W R S with columns m0, m1, m2, in units of 2^k px.
//
// det(M M') is the sum of the squared 2x2 minors of M (Cauchy-Binet): nothing cancels, so needles keep their width. A
// minor of J W R is f_x f_y / z^2 times the component of (x/z, y/z, 1) along the remaining axis, `minor` here, without z.
// Everything is computed in units of 2^k px, so that a 1e13 px Gaussian does not overflow.
struct Footprint {
    vec2 m0, m1, m2;
    vec3 scale;         // standard deviations / z, in these units
    vec3 minor;         // e1 x e2, e2 x e0, e0 x e1 of the unscaled columns e_k = m_k / scale_k
    float inverse_unit; // 2^-k
    float dilation;
    float xx, xy, yy;   // without dilation
    float minors;       // det without dilation
    float det;          // with dilation
};

// column_k: columns of W R(t); scale: standard deviations / z; tangent: clamped x/z, y/z.
Footprint footprint_of(vec3 column_0, vec3 column_1, vec3 column_2, vec3 scale, vec2 tangent, vec2 focal) {
    Footprint f;
    vec2 m0 = scale.x * focal * (column_0.xy - tangent * column_0.z);
    vec2 m1 = scale.y * focal * (column_1.xy - tangent * column_1.z);
    vec2 m2 = scale.z * focal * (column_2.xy - tangent * column_2.z);
    vec2 longest = max(abs(m0), max(abs(m1), abs(m2)));
    uint unit_bits = floatBitsToUint(max(1.0, max(longest.x, longest.y))) & 0x7f800000u;
    float inverse_unit = uintBitsToFloat(0x7f000000u - min(unit_bits, 0x7e800000u));
    m0 *= inverse_unit;
    m1 *= inverse_unit;
    m2 *= inverse_unit;
    vec3 s = scale * inverse_unit;
    vec3 ray = vec3(tangent, 1.0);
    float area = focal.x * focal.y;
    f.minor = vec3(area * dot(column_0, ray), area * dot(column_1, ray), area * dot(column_2, ray));
    float minor_12 = f.minor.x * s.y * s.z;
    float minor_20 = f.minor.y * s.z * s.x;
    float minor_01 = f.minor.z * s.x * s.y;
    float dilation = DILATION_PX2 * inverse_unit * inverse_unit;
    float xx = m0.x * m0.x + m1.x * m1.x + m2.x * m2.x;
    float xy = m0.x * m0.y + m1.x * m1.y + m2.x * m2.y;
    float yy = m0.y * m0.y + m1.y * m1.y + m2.y * m2.y;
    float minors = minor_12 * minor_12 + minor_20 * minor_20 + minor_01 * minor_01;
    f.minors = minors;
    f.det = minors + dilation * (xx + yy) + dilation * dilation;
    f.m0 = m0;
    f.m1 = m1;
    f.m2 = m2;
    f.scale = s;
    f.inverse_unit = inverse_unit;
    f.dilation = dilation;
    f.xx = xx;
    f.xy = xy;
    f.yy = yy;
    return f;
}

// k times the upper Cholesky factor (l11, l12, l22) of the inverse covariance, in 2^-k / px: u = l11 dx + l12 dy, v = l22 dy.
vec3 footprint_root(Footprint f, float k) {
    float c = f.yy + f.dilation;
    return vec3(k * sqrt(c / f.det), -k * f.xy / (sqrt(c) * sqrt(f.det)), k / sqrt(c));
}

#endif
