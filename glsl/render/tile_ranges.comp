#version 460
#extension GL_GOOGLE_include_directive : require

// First and last + 1 instance of each tile in the tile-sorted instances. Tiles without instances keep their zeros; the
// sentinel id (one past the last tile) is ignored.

#include "lib/frame.glsl"
#include "lib/limits.glsl"
#include "lib/dispatch.glsl"

layout(constant_id = 0) const uint SUBGROUP_SIZE = 32u;

layout(local_size_x = 256) in;

layout(std430, set = 0, binding = 1) readonly buffer CountersBlock { uint counters[]; };
layout(std430, set = 0, binding = 2) readonly buffer KeysBlock { uint keys[]; };
layout(std430, set = 0, binding = 3) writeonly buffer RangesBlock { uint ranges[]; };

void main() {
    uint i = workgroup_index() * SCAN_BLOCK + gl_LocalInvocationID.x;
    uint instances = counters[COUNT_INSTANCES];
    if (i < instances) {
        uint tile = keys[i];
        uint previous = i == 0u ? 0xffffffffu : keys[i - 1u];
        uint next = i + 1u == instances ? 0xffffffffu : keys[i + 1u];
        if (tile < frame.tile_count) {
            if (previous != tile) {
                ranges[2u * tile] = i;
            }
            if (next != tile) {
                ranges[2u * tile + 1u] = i + 1u;
            }
        }
    }
}
