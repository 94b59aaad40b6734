// A rendered frame as 8-bit pixels of a window: colours, or what the frame knows beside them. A frame whose tile instances
// did not fit changes nothing, so that the picture before it stays.
#version 460
#extension GL_GOOGLE_include_directive : require

layout(local_size_x = 256) in;
layout(constant_id = 0) const uint SUBGROUP_SIZE = 32;
layout(constant_id = 1) const uint MODE = 0;
layout(constant_id = 2) const uint ENLARGED = 0; // the frame has not the window's size

#include "lib/dispatch.glsl"
#include "lib/limits.glsl"

const uint MODE_COLOUR = 0u;
const uint MODE_DEPTH = 1u;
const uint MODE_OPACITY = 2u;
const uint MODE_TILES = 3u;
const float EMPTY = 0.02;        // grey behind depths

struct Display {
    uvec4 source; // width, height (px), tiles_x, 0
    uvec4 target; // width, height (px), 1 when blue comes first, 0
    vec4 range;   // depth that is nearest, one over the range of depths, one over the largest tile count, 0
};

layout(std430, set = 0, binding = 0) readonly buffer DisplayBlock { Display display; };
layout(std430, set = 0, binding = 1) readonly buffer ColorBlock { vec4 color[]; };
layout(std430, set = 0, binding = 2) readonly buffer DepthBlock { float depth[]; };
layout(std430, set = 0, binding = 3) readonly buffer RangesBlock { uint ranges[]; };
layout(std430, set = 0, binding = 4) readonly buffer CountersBlock { uint counters[]; };
layout(std430, set = 0, binding = 5) readonly buffer PaletteBlock { vec4 palette[]; };
layout(std430, set = 0, binding = 6) writeonly buffer ScreenBlock { uint screen[]; };

// Clamped to 0 to 1; NaN becomes 0, as in the pictures that are written.
vec3 unit(vec3 v) {
    return mix(vec3(0.0), clamp(v, 0.0, 1.0), equal(v, v));
}

vec3 from_palette(float x) {
    return palette[min(uint(clamp(x, 0.0, 1.0) * 255.0 + 0.5), 255u)].xyz;
}

// Written out: a driver may form mix() as a + (b - a) w, which makes NaN of an infinite a.
vec4 between(vec4 a, vec4 b, float w) {
    return a * (1.0 - w) + b * w;
}

// Bilinear, with the pixel centres of a smaller source at +0.5.
vec4 enlarged(uvec2 at) {
    vec2 scale = vec2(display.source.xy) / vec2(display.target.xy);
    vec2 p = (vec2(at) + 0.5) * scale - 0.5;
    vec2 most = vec2(display.source.xy - 1u);
    vec2 low = clamp(floor(p), vec2(0.0), most);
    uvec2 a = uvec2(low);
    uvec2 b = uvec2(min(low + 1.0, most));
    vec2 w = clamp(p - low, 0.0, 1.0);
    uint width = display.source.x;
    vec4 top = between(color[a.y * width + a.x], color[a.y * width + b.x], w.x);
    vec4 bottom = between(color[b.y * width + a.x], color[b.y * width + b.x], w.x);
    return between(top, bottom, w.y);
}

void main() {
    uint index = workgroup_index() * 256u + gl_LocalInvocationID.x;
    uint width = display.target.x;
    if (index >= width * display.target.y || counters[COUNT_FAILED] != 0u) {
        return;
    }
    uvec2 at = uvec2(index % width, index / width);
    uvec2 nearest = min(uvec2((vec2(at) + 0.5) * vec2(display.source.xy) / vec2(display.target.xy)),
                        display.source.xy - 1u);
    uint from = nearest.y * display.source.x + nearest.x;
    uint mode = MODE;
    uint is_enlarged = ENLARGED;
    vec3 shown = vec3(0.0);
    if (mode == MODE_COLOUR) {
        shown = is_enlarged == 1u ? enlarged(at).xyz : color[index].xyz;
    } else if (mode == MODE_DEPTH) {
        float alpha = color[from].w;
        float z = depth[from] / max(alpha, 1e-6);
        shown = mix(vec3(EMPTY), from_palette(1.0 - (z - display.range.x) * display.range.y), alpha);
    } else if (mode == MODE_OPACITY) {
        shown = vec3(color[from].w);
    } else {
        uvec2 tile = nearest / TILE_SIZE;
        uint of_tile = tile.y * display.source.z + tile.x;
        float count = float(ranges[2u * of_tile + 1u] - ranges[2u * of_tile]);
        float grey = dot(unit(color[from].xyz), vec3(0.25, 0.5, 0.25));
        uvec2 inside = nearest % TILE_SIZE;
        float line = inside.x == 0u || inside.y == 0u ? 0.8 : 1.0;
        shown = line * (0.85 * from_palette(sqrt(count * display.range.z)) + 0.15 * grey);
    }
    uvec3 level = uvec3(unit(shown) * 255.0 + 0.5);
    level = display.target.z == 1u ? level.zyx : level;
    screen[index] = level.x | level.y << 8 | level.z << 16 | 0xff000000u;
}
