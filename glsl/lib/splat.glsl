// How a projected splat is stored. PACKING, declared by the includer, = colour + 4 * conic; colour 0 f32, 1 f16, 2 unorm8;
// conic 0 f32, 1 f16. Rust twin: engine/src/render/splat.rs.
//
//   conic f32, colour f32 or f16    mean.x mean.y l11 l12 | l22 log2_opacity z 0 | r g b 0      (48 bytes)
//   conic f32, colour unorm8        mean.x mean.y l11 l12 | l22 log2_opacity z (r g b)          (32 bytes, as below)
//   conic f16, colour f32           mean.x mean.y (l11 l12) (l22 log2_opacity) | r g z b
//   conic f16, colour f16           mean.x mean.y (l11 l12) (l22 log2_opacity) | (r g) (b 0) z 0
//   conic f16, colour unorm8        mean.x mean.y (l11 l12) (l22 log2_opacity) | (r g b) 0 z 0
//
// The buffer is one of words: packed halves must not pass through a float, whose small values a device may flush.
#ifndef SPGS_SPLAT
#define SPGS_SPLAT

const float MIN_CONIC_F16 = 6.103515625e-5; // the smallest normal half: a Gaussian of 14,000 px looks flat anyway
const float MAX_COLOUR_F16 = 65504.0;

uint packed_colour() {
    uint packing = PACKING;
    return packing & 3u;
}

bool conic_is_packed() {
    uint packing = PACKING;
    return packing >= 4u;
}

// uvec4 per splat.
uint splat_stride() {
    return conic_is_packed() || packed_colour() == 2u ? 2u : 3u;
}

// The conic and opacity as they will be read back: what counts and draws must be the same ellipse.
void round_conic(inout float l11, inout float l12, inout float l22, inout float log2_opacity) {
    if (conic_is_packed()) {
        vec2 a = unpackHalf2x16(packHalf2x16(vec2(max(l11, MIN_CONIC_F16), l12)));
        vec2 b = unpackHalf2x16(packHalf2x16(vec2(max(l22, MIN_CONIC_F16), log2_opacity)));
        l11 = a.x;
        l12 = a.y;
        l22 = b.x;
        log2_opacity = b.y;
    }
}

// first: mean, l11, l12; second: l22, log2_opacity, z.
void pack_splat(vec4 first, vec3 second, vec3 colour, out uvec4 a, out uvec4 b, out uvec4 c) {
    uint format = packed_colour();
    uvec3 packed = floatBitsToUint(colour);
    if (format == 1u) {
        vec3 limited = min(colour, vec3(MAX_COLOUR_F16));
        packed = uvec3(packHalf2x16(limited.xy), packHalf2x16(vec2(limited.z, 0.0)), 0u);
    } else if (format == 2u) {
        packed = uvec3(packUnorm4x8(vec4(colour, 0.0)), 0u, 0u);
    }
    a = floatBitsToUint(first);
    b = uvec4(floatBitsToUint(second), 0u);
    c = uvec4(packed, 0u);
    if (conic_is_packed()) {
        a.z = packHalf2x16(first.zw);
        a.w = packHalf2x16(second.xy);
        b = uvec4(packed.x, packed.y, floatBitsToUint(second.z), packed.z);
    } else if (format == 2u) {
        b.w = packed.x;
    } else if (format == 1u) {
        c = uvec4(floatBitsToUint(vec3(unpackHalf2x16(packed.x), unpackHalf2x16(packed.y).x)), 0u);
    }
}

// second.w is undefined.
void unpack_splat(uvec4 a, uvec4 b, out vec4 first, out vec4 second) {
    first = uintBitsToFloat(a);
    second = uintBitsToFloat(b);
    if (conic_is_packed()) {
        first.zw = unpackHalf2x16(a.z);
        second.xy = unpackHalf2x16(a.w);
    }
}

vec3 unpack_colour(uvec4 b, uvec4 c) {
    uint format = packed_colour();
    if (!conic_is_packed()) {
        return format == 2u ? unpackUnorm4x8(b.w).xyz : uintBitsToFloat(c.xyz);
    }
    if (format == 2u) {
        return unpackUnorm4x8(b.x).xyz;
    }
    return format == 1u ? vec3(unpackHalf2x16(b.x), unpackHalf2x16(b.y).x) : uintBitsToFloat(b.xyw);
}

#endif
