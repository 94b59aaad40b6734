// Blends the splats of each tile front to back into an image in the format of a host's picture; see
// lib/blend_tile.glsl.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_vote : require
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_KHR_shader_subgroup_shuffle : require
#extension GL_EXT_control_flow_attributes : require

layout(local_size_x = 128) in;
layout(constant_id = 0) const uint SUBGROUP_SIZE = 32;
layout(constant_id = 1) const uint WITH_DEPTH = 0;
layout(constant_id = 2) const uint STAGE = 1;
layout(constant_id = 3) const uint PIXELS_PER_LANE = 2; // at most 16
layout(constant_id = 4) const uint WITH_SLOTS = 0;      // values are slots, as emit_tiles writes them for training
layout(constant_id = 5) const uint ALPHA_CUT = 0;       // see lib/ellipse.glsl
layout(constant_id = 6) const uint TRANSMITTANCE_STOP = 0; // see lib/blend.glsl
layout(constant_id = 7) const uint PACKING = 0;         // see lib/splat.glsl
layout(constant_id = 8) const uint FORMAT = 0;          // of the pixels: 0 rgba8 unorm, 1 bgra8 unorm, 2 rgba16 float
const uint TILE_CULL = 0u;                              // subtiles are tested exactly

#include "lib/frame.glsl"
#include "lib/dispatch.glsl"
#include "lib/limits.glsl"
#include "lib/ellipse.glsl"
#include "lib/blend.glsl"
#include "lib/splat.glsl"

layout(std430, set = 0, binding = 1) readonly buffer RangesBlock { uint ranges[]; };
layout(std430, set = 0, binding = 2) readonly buffer ValuesBlock { uint values[]; };
layout(std430, set = 0, binding = 3) readonly buffer SplatsBlock { uvec4 splats[]; };
layout(std430, set = 0, binding = 4) writeonly buffer PixelsBlock { uint pixels[]; };
layout(std430, set = 0, binding = 5) writeonly buffer DepthBlock { float depth[]; };
layout(std430, set = 0, binding = 6) readonly buffer GaussianOfSlotBlock { uint gaussian_of_slot[]; };

#include "lib/blend_tile.glsl"

// Largest finite half.
const float HALF_MAX = 65504.0;

// Four halves, rounded to nearest, ties to even. packHalf2x16 may round otherwise, and is slow where it is no instruction
// (lavapipe).
uvec2 pack_halves(vec4 value) {
    vec4 clamped = clamp(value, -HALF_MAX, HALF_MAX);
    vec4 size = abs(clamped);
    // 2^E, at least 2^-14, below which halves lie as far apart as there. Floats from 2^(E + 13) on lie as halves from 2^E on do:
    // the sum is rounded to a half's mantissa, in its last bits.
    uvec4 exponent = max(floatBitsToUint(size) & 0x7f800000u, 0x38800000u);
    uvec4 far = exponent + (13u << 23u);
    precise vec4 sum = size + uintBitsToFloat(far);
    // The exponent's bias goes from 127 to 15; the mantissa carries into it.
    uvec4 halves = ((exponent - 0x38800000u) >> 13u) + (floatBitsToUint(sum) - far);
    halves |= (floatBitsToUint(clamped) >> 16u) & 0x8000u;
    return uvec2(halves.x | halves.y << 16u, halves.z | halves.w << 16u);
}

void store_pixel(uvec2 pixel, uint at, vec4 value) {
    uint format = FORMAT;
    if (format == 2u) {
        uvec2 words = pack_halves(value);
        pixels[2u * at] = words.x;
        pixels[2u * at + 1u] = words.y;
    } else {
        vec4 ordered = format == 1u ? value.zyxw : value;
        pixels[at] = packUnorm4x8(clamp(ordered, 0.0, 1.0));
    }
}
