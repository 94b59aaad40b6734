// Sine and cosine that keep f32 accuracy (about 1e-7 absolute) for |x| up to 12,000: Vulkan promises 2^-11 only, and only
// within [-pi, pi], while network F encodes positions by sin(2^9 x). Rust twin: engine/src/render/angle.rs, line by line.
#ifndef SPGS_ANGLE
#define SPGS_ANGLE

// pi / 2 = HIGH + MIDDLE + LOW; HIGH has 8 significant bits and MIDDLE 11, so that k * HIGH and k * MIDDLE are exact for
// k < 2^13 (Cody-Waite reduction).
const float HALF_PI_HIGH = 1.5703125;
const float HALF_PI_MIDDLE = 0.0004837512969970703;
const float HALF_PI_LOW = 7.549789954891882e-8;
const float TWO_OVER_PI = 0.6366197723675814;

// (sin x, cos x). Beyond |x| = 12,000 the result is still a point near the unit circle, but its angle loses accuracy as
// the spacing of f32 itself grows. Not finite in, anything in [-1.1, 1.1] or NaN out.
vec2 sin_cos(float x) {
    precise float k = floor(x * TWO_OVER_PI + 0.5);
    precise float r = ((x - k * HALF_PI_HIGH) - k * HALF_PI_MIDDLE) - k * HALF_PI_LOW;
    r = min(max(r, -0.8), 0.8);
    precise float z = r * r;
    // Taylor polynomials: on |r| <= pi/4 the first omitted terms are 2e-9 and 1e-10.
    precise float s = r + r * z * (-1.0 / 6.0 + z * (1.0 / 120.0 + z * (-1.0 / 5040.0 + z * (1.0 / 362880.0))));
    precise float c = 1.0 + z * (-0.5 + z * (1.0 / 24.0 + z * (-1.0 / 720.0 + z * (1.0 / 40320.0 - z * (1.0 / 3628800.0)))));
    precise float turns = k - 4.0 * floor(k * 0.25); // k mod 4: 0, 1, 2 or 3
    bool odd = turns == 1.0 || turns == 3.0;
    float sine = odd ? c : s;
    float cosine = odd ? s : c;
    return vec2(turns >= 2.0 ? -sine : sine, turns == 1.0 || turns == 2.0 ? -cosine : cosine);
}

#endif
