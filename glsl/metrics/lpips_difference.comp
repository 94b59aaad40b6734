// Weighted squared difference of two pictures' features, each divided by its length, pixel by pixel.
#version 460
#extension GL_GOOGLE_include_directive : require

layout(local_size_x = 256) in;
layout(constant_id = 0) const uint SUBGROUP_SIZE = 32;

#include "lib/dispatch.glsl"

// [channels, pixels]
layout(std430, set = 0, binding = 0) readonly buffer FirstBlock { float first[]; };
layout(std430, set = 0, binding = 1) readonly buffer SecondBlock { float second[]; };
// [channels]
layout(std430, set = 0, binding = 2) readonly buffer HeadBlock { float head[]; };
// [pixels]
layout(std430, set = 0, binding = 3) writeonly buffer DistanceOfPixelBlock { float distance_of_pixel[]; };

layout(push_constant) uniform Push {
    uint channels;
    uint pixels;
} push;

const float EPSILON = 1.0e-10;

void main() {
    uint pixel = workgroup_index() * 256u + gl_LocalInvocationIndex;
    if (pixel < push.pixels) {
        vec2 squares = vec2(0.0);
        for (uint c = 0u; c < push.channels; c++) {
            vec2 v = vec2(first[c * push.pixels + pixel], second[c * push.pixels + pixel]);
            squares += v * v;
        }
        vec2 scale = 1.0 / (sqrt(squares) + EPSILON);
        float sum = 0.0;
        for (uint c = 0u; c < push.channels; c++) {
            // Each product is rounded: fused into the difference, one of them would not be, and a picture would differ from itself.
            precise vec2 v = vec2(first[c * push.pixels + pixel], second[c * push.pixels + pixel]) * scale;
            precise float d = v.x - v.y;
            sum += head[c] * d * d;
        }
        distance_of_pixel[pixel] = sum;
    }
}
