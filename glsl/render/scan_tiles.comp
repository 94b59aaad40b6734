#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_KHR_shader_subgroup_vote : require
#extension GL_EXT_control_flow_attributes : require

// Where the list of each tile begins: sums twice over what deform_project has counted, from changes to counts and from counts
// to starts. One workgroup: 4,096 tiles at a time, sixteen neighbours per thread, all on their way from memory at once.
//
// Each list begins empty: what counted the changes of a tile becomes the end of its list, which emit_tiles moves. After the last
// tile stands the end of all lists. A frame that has more instances than there is room for fails here: its lists have no room, so
// nothing is emitted and nothing blended.

#include "lib/frame.glsl"
#include "lib/limits.glsl"
#include "lib/dispatch.glsl"
#include "lib/subgroup.glsl"

layout(local_size_x = 256) in;

layout(std430, set = 0, binding = 1) buffer CountersBlock { uint counters[]; };
layout(std430, set = 0, binding = 2) buffer TileChangeBlock { uint tile_change[]; };
layout(std430, set = 0, binding = 3) writeonly buffer TileStartBlock { uint tile_start[]; };
layout(std430, set = 0, binding = 4) writeonly buffer IndirectBlock { uint indirect[]; };

layout(constant_id = 1) const uint LONG = 0; // with lists of more pairs, `indirect` dispatches a workgroup per tile; 0: no such dispatch

const uint TILES_OF_THREAD = 16u; // at a time
const uint TILES_AT_ONCE = SCAN_THREADS * TILES_OF_THREAD;

shared uint all_instances; // to process: none when the frame failed
shared uint some_are_long;

void main() {
    uint thread = thread_index();
    uint tiles = frame.tile_count;
    if (thread == 0u) {
        // A step of training may have failed before it began, with the one before it.
        uint counted = counters[COUNT_INSTANCES_LOW];
        bool failed = counters[COUNT_INSTANCES_HIGH] != 0u || counted > frame.instance_capacity
            || counters[COUNT_FAILED] != 0u;
        counters[COUNT_FAILED] = failed ? FAILED_INSTANCES : 0u;
        all_instances = failed ? 0u : counted;
        counters[COUNT_INSTANCES] = all_instances;
        some_are_long = 0u;
    }
    barrier();
    uint instances = all_instances;
    uint longest = 0u;
    uint count_before = 0u; // of the last tile of the block before
    uint start_before = 0u;
    for (uint first = 0u; first < tiles; first += TILES_AT_ONCE) {
        uint own = first + thread * TILES_OF_THREAD;
        uint change[TILES_OF_THREAD];
        [[unroll]] for (uint i = 0u; i < TILES_OF_THREAD; i++) {
            uint word = tile_change[min(own + i, tiles) * TILE_PITCH];
            change[i] = own + i < tiles ? word : 0u;
        }
        uint sum = 0u;
        [[unroll]] for (uint i = 0u; i < TILES_OF_THREAD; i++) {
            sum += change[i];
        }
        uint change_of_block;
        uint count = count_before + workgroup_exclusive_add(sum, change_of_block);
        uint running = count;
        uint instances_here = 0u;
        [[unroll]] for (uint i = 0u; i < TILES_OF_THREAD; i++) {
            running += change[i];
            longest = max(longest, running);
            instances_here += running;
        }
        uint instances_of_block;
        uint start = start_before + workgroup_exclusive_add(instances_here, instances_of_block);
        [[unroll]] for (uint i = 0u; i < TILES_OF_THREAD; i++) {
            uint tile = own + i;
            count += change[i];
            if (tile < tiles) {
                // At most where all end, whatever was counted: nothing is written past the room there is.
                uint begin = min(start, instances);
                tile_start[tile] = begin;
                tile_change[tile * TILE_PITCH] = begin;
            }
            start += count;
        }
        count_before += change_of_block;
        start_before += instances_of_block;
    }
    if (thread == 0u) {
        tile_start[tiles] = instances;
    }
    uint long_from = LONG;
    if (long_from != 0u) {
        uint any_long = subgroupAny(longest > long_from) ? 1u : 0u;
        if (gl_SubgroupInvocationID == 0u) {
            atomicOr(some_are_long, any_long);
        }
        barrier();
        if (thread == 0u) {
            uvec3 groups = folded_groups(instances != 0u && some_are_long != 0u ? tiles : 0u);
            indirect[0] = groups.x;
            indirect[1] = groups.y;
            indirect[2] = groups.z;
        }
    }
}
