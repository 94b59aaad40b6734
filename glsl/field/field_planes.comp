// Input of a deformation field of planes (4D-GS) for the points from push.first_row on: at each resolution, for each
// channel, the product of six planes over pairs of x, y, z, t, interpolated bilinearly; then zeros up to a multiple of 4.
// [rows, columns]. Planes lie [height][width][channels], so that neighbouring threads, which have neighbouring channels, read
// side by side.
#version 460
#extension GL_GOOGLE_include_directive : require

layout(local_size_x = 256) in;
layout(constant_id = 0) const uint SUBGROUP_SIZE = 32;

#include "lib/frame.glsl"
#include "lib/dispatch.glsl"

layout(std430, set = 0, binding = 1) readonly buffer PointBlock { float point[]; }; // [3][points]
layout(std430, set = 0, binding = 2) readonly buffer PlaneBlock { float plane[]; };
// Of each plane: where it starts in `plane` (floats), its width, its height.
layout(std430, set = 0, binding = 3) readonly buffer PlaneSizeBlock { uint plane_size[]; };
layout(std430, set = 0, binding = 4) writeonly buffer EncodingBlock { float encoding[]; };

layout(push_constant) uniform Push {
    uint first_row;
    uint rows;
    uint points;
    uint channels;
    uint scales;
    float low_x;
    float low_y;
    float low_z;
    float high_x;
    float high_y;
    float high_z;
} push;

// Place between the first value (-1) and the last (1), held outside; x the lower index, y the share of the next.
vec2 place_along(float v, uint size) {
    float last = float(size - 1u);
    float place = (v + 1.0) * 0.5 * last;
    place = place >= 0.0 ? min(place, last) : 0.0;
    float low = floor(place);
    return vec2(low, place - low);
}

float bilinear(uint first, uvec2 size, uint channel, vec2 at) {
    vec2 x = place_along(at.x, size.x);
    vec2 y = place_along(at.y, size.y);
    uint x_0 = uint(x.x);
    uint y_0 = uint(y.x);
    uint x_1 = min(x_0 + 1u, size.x - 1u);
    uint y_1 = min(y_0 + 1u, size.y - 1u);
    uint channels = push.channels;
    float low = plane[first + (y_0 * size.x + x_0) * channels + channel] * (1.0 - x.y)
              + plane[first + (y_0 * size.x + x_1) * channels + channel] * x.y;
    float high = plane[first + (y_1 * size.x + x_0) * channels + channel] * (1.0 - x.y)
               + plane[first + (y_1 * size.x + x_1) * channels + channel] * x.y;
    return low * (1.0 - y.y) + high * y.y;
}

void main() {
    uint columns = (push.channels * push.scales + 3u) / 4u * 4u;
    uint item = workgroup_index() * 256u + gl_LocalInvocationIndex;
    if (item >= push.rows * columns) {
        return;
    }
    uint p = push.first_row + item / columns;
    uint column = item % columns;
    uint scale = column / push.channels;
    uint channel = column % push.channels;
    if (scale >= push.scales) {
        encoding[item] = 0.0;
        return;
    }
    vec3 low = vec3(push.low_x, push.low_y, push.low_z);
    vec3 high = vec3(push.high_x, push.high_y, push.high_z);
    vec3 x = vec3(point[p], point[push.points + p], point[2u * push.points + p]);
    // Time is not taken to -1..1, as in the released code.
    vec4 at = vec4((x - low) * 2.0 / (high - low) - 1.0, frame.time);
    vec2 pairs[6] = vec2[6](at.xy, at.xz, at.xw, at.yz, at.yw, at.zw);
    float product = 1.0;
    for (uint i = 0u; i < 6u; i++) {
        uint entry = 3u * (6u * scale + i);
        product *= bilinear(plane_size[entry], uvec2(plane_size[entry + 1u], plane_size[entry + 2u]), channel, pairs[i]);
    }
    encoding[item] = product;
}
