// Positional encoding of (x, y, z, t): which number element e of [p, sin 2^k p, cos 2^k p, .., t, sin 2^k t, cos 2^k t, ..]
// is, with 10 octaves of p = (x, y, z). Include lib/angle.glsl first. Rust twin: `encoded` in engine/src/render/nonrigid_network.rs.
#ifndef SPGS_ENCODING
#define SPGS_ENCODING

const uint POSITION_ELEMENTS = 63u; // 3 + 3 * 2 * 10

struct EncodedElement {
    uint axis;   // 0, 1, 2 of the position, 3 time
    uint octave; // k
    uint part;   // 0 the number itself, 1 sine, 2 cosine
};

EncodedElement encoded_element(uint e) {
    EncodedElement found;
    if (e < POSITION_ELEMENTS) {
        uint wave = e < 3u ? 0u : e - 3u;
        found = EncodedElement(e < 3u ? e : wave % 3u, wave / 6u, e < 3u ? 0u : 1u + wave % 6u / 3u);
    } else {
        uint wave = e == POSITION_ELEMENTS ? 0u : e - POSITION_ELEMENTS - 1u;
        found = EncodedElement(3u, wave / 2u, e == POSITION_ELEMENTS ? 0u : 1u + wave % 2u);
    }
    return found;
}

float encoded_value(EncodedElement e, float x) {
    vec2 wave = sin_cos(x * float(1u << e.octave));
    return e.part == 0u ? x : e.part == 1u ? wave.x : wave.y;
}

#endif
