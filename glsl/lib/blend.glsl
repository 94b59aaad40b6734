// One splat at one pixel: the arithmetic of the forward pass, shared with the backward pass, which replays it and must see
// the same contributions. Rust mirror: engine/src/render/blend.rs.
#ifndef SPGS_BLEND
#define SPGS_BLEND

#include "ellipse.glsl"

const float MAX_ALPHA = 0.99;
// 1e-4, less five units in the last place: two splats at the largest alpha leave exactly 1e-4, which is not below it, but
// (1 - 0.99f)^2 rounds to 9.99998e-5.
const float MIN_TRANSMITTANCE = 9.9999e-5;

// Where a pixel is done. TRANSMITTANCE_STOP, declared by the includer: bits of it, 0: 1e-4.
float min_transmittance() {
    uint bits = TRANSMITTANCE_STOP;
    return bits == 0u ? MIN_TRANSMITTANCE : uintBitsToFloat(bits);
}

// u and v of a splat (its mean, l11, l12; l22) at the corner of a subtile. A pixel's follow by sums of small numbers, the same for
// all splats: u + l11 x + l12 y, v + l22 y with (x, y) from the corner.
vec2 splat_at(vec4 first, float l22, vec2 corner) {
    vec2 d = corner - first.xy;
    return vec2(first.z * d.x + first.w * d.y, l22 * d.y);
}

// Alpha of the splat at the pixel, 0 when it is not drawn there. weight = alpha * transmittance; the transmittance becomes
// what is left of it, and negative once the pixel is closed. An open pixel has at least min_transmittance(), a closed one less
// than 0, so one comparison finds both what closes now and what was closed before. Selects, not branches: with several pixels per
// lane some lane nearly always needs the exponential, and lavapipe runs both sides anyway.
float blend_alpha(float log2_alpha, inout float transmittance, out float weight) {
    float least = min_transmittance();
    float cut = -log2_cut();
    float drawn = min(MAX_ALPHA, exp2(log2_alpha));
    float alpha = log2_alpha >= cut ? drawn : 0.0;
    float full = alpha * transmittance;
    float after = transmittance - full;
    float closed = -abs(transmittance);
    bool stop = after < least;
    weight = stop ? 0.0 : full;
    transmittance = stop ? closed : after;
    return stop ? 0.0 : alpha;
}

#endif
