// How a projected splat is stored. PACKING is declared by the includer. Rust twin: engine/src/render/splat.rs.
//
//   0, f32                     mean.x mean.y l11 l12 | l22 log2_opacity z 0 | r g b 0      (48 bytes)
//   1, colour and opacity f16  mean.x mean.y l11 l12 | l22 (r g) z (b log2_opacity)        (32 bytes)
//
// The conic stays f32: half precision of it moves alpha by a percent at a splat's rim, and many layers add that up. The buffer
// is one of words: packed halves must not pass through a float, whose small values a device may flush.
#ifndef SPGS_SPLAT
#define SPGS_SPLAT

const float MAX_COLOUR_F16 = 65504.0;

bool splat_is_packed() {
    uint packing = PACKING;
    return packing == 1u;
}

// uvec4 per splat.
uint splat_stride() {
    return splat_is_packed() ? 2u : 3u;
}

// The opacity as it will be read back: what counts and draws must be the same ellipse.
float round_opacity(float log2_opacity) {
    return splat_is_packed() ? unpackHalf2x16(packHalf2x16(vec2(log2_opacity, 0.0))).x : log2_opacity;
}

// first: mean, l11, l12; second: l22, log2_opacity, z.
void pack_splat(vec4 first, vec3 second, vec3 colour, out uvec4 a, out uvec4 b, out uvec4 c) {
    a = floatBitsToUint(first);
    b = uvec4(floatBitsToUint(second), 0u);
    c = uvec4(floatBitsToUint(colour), 0u);
    if (splat_is_packed()) {
        vec3 limited = min(colour, vec3(MAX_COLOUR_F16));
        b.y = packHalf2x16(limited.xy);
        b.w = packHalf2x16(vec2(limited.z, second.y));
    }
}

// second.w is undefined.
void unpack_splat(uvec4 a, uvec4 b, out vec4 first, out vec4 second) {
    first = uintBitsToFloat(a);
    second = uintBitsToFloat(b);
    if (splat_is_packed()) {
        second.y = unpackHalf2x16(b.w).y;
    }
}

vec3 unpack_colour(uvec4 b, uvec4 c) {
    return splat_is_packed() ? vec3(unpackHalf2x16(b.y), unpackHalf2x16(b.w).x) : uintBitsToFloat(c.xyz);
}

#endif
