// How the Gaussians of a workgroup, 256 of them, get into the lists of the tiles that they reach, as pairs (depth, instance): the
// kernels `emit_tiles` and `deform_project`. In what order a list then is, is left to chance; sort_tiles gives it the one that counts.
// The tiles of those that reach few are found by a thread each; for the others the threads run over instances, not Gaussians, so that
// one that covers the whole image is spread over all threads. Where subgroups are wide, what a thread finds goes into a queue in shared
// memory, and the threads run over that too: no lane waits for the atomics of one with more tiles.
//
// An instance is the Gaussian and, beside it, the quadrants of the tile that it reaches, so that whoever walks a tile list need
// not look at its ellipse again.
//
// Include lib/frame.glsl, lib/dispatch.glsl, lib/subgroup.glsl, lib/ellipse.glsl and lib/splat.glsl before; the includer has the buffers
// `splats` and `tile_end`, whose counters are asked for places, and says where a list has room and what is put there.
#ifndef SPGS_TILE_LISTS
#define SPGS_TILE_LISTS

// Where the room of a tile's list begins, less what its counter began with, and where it ends.
uvec2 room_of_list(uint tile);

// A pair that got place `count` of a list.
void put(uint count, uvec2 room, uint depth, uint instance, uint slot);

const uint SERIAL_TILES = 16u; // most instances that one thread finds

// Where subgroups are narrow, lanes wait little for each other, and there is no queue.
const uint QUEUE_SUBGROUP = 16u;
// Its entries: the tile, the quadrants and the Gaussian of the block. An image of more tiles has no queue either.
const uint QUEUE_QUADRANT_SHIFT = 20u;
const uint QUEUE_THREAD_SHIFT = 24u;
const uint QUEUE_TILES = (1u << QUEUE_QUADRANT_SHIFT) - 1u;
const uint ALL_QUADRANTS = 15u;
const uint NO_INSTANCE = 0xffffffffu; // of the tile past those
const uint QUEUE_BATCH = 4u; // that a thread has under way at a time

shared uint queue[SCAN_BLOCK * SERIAL_TILES];
shared uint depth_of_block[SCAN_BLOCK]; // of each Gaussian of the queue
shared uint first_shared[SCAN_BLOCK]; // of each Gaussian, among the instances that all threads find
shared uint slot_of_block[SCAN_BLOCK]; // what the place of each Gaussian's instances, in the queue or among those, is to their slots

// The ellipse of a Gaussian and the bits of its depth, which grow with it.
Ellipse ellipse_of(uint gaussian, out uint depth) {
    uint at = splat_stride() * gaussian;
    vec4 first;
    vec4 second;
    uvec4 b = splats[at + 1u];
    depth = b.z;
    unpack_splat(splats[at], b, first, second);
    return ellipse_of_splat(first, second);
}

// Gaussian of the block that has shared instance `instance`: the last one that starts at or before it, because those
// without shared instances start where the next one does.
uint owner(uint instance) {
    uint low = 0u;
    for (uint step = SCAN_BLOCK / 2u; step != 0u; step /= 2u) {
        low += first_shared[low + step] <= instance ? step : 0u;
    }
    return low;
}

void append(uint tile, uint depth, uint instance, uint slot) {
    uint count = atomicAdd(tile_end[tile * TILE_PITCH], 1u);
    put(count, room_of_list(tile), depth, instance, slot);
}

// The places of a list's end are all asked for before the first is needed: an atomic answers after hundreds of cycles.
void append_queued(uint group, uint first, uint queue_total) {
    uint entry[QUEUE_BATCH];
    uint count[QUEUE_BATCH];
    uvec2 room[QUEUE_BATCH];
    [[unroll]] for (uint i = 0u; i < QUEUE_BATCH; i++) {
        uint k = first + i * SCAN_BLOCK;
        entry[i] = k < queue_total ? queue[k] : NO_INSTANCE;
        uint tile = entry[i] & QUEUE_TILES;
        count[i] = 0u;
        room[i] = uvec2(0u);
        if (entry[i] != NO_INSTANCE) {
            count[i] = atomicAdd(tile_end[tile * TILE_PITCH], 1u);
            room[i] = room_of_list(tile);
        }
    }
    [[unroll]] for (uint i = 0u; i < QUEUE_BATCH; i++) {
        if (entry[i] != NO_INSTANCE) {
            uint from = entry[i] >> QUEUE_THREAD_SHIFT;
            uint quadrants = entry[i] >> QUEUE_QUADRANT_SHIFT & ALL_QUADRANTS;
            uint instance = group * SCAN_BLOCK + from | quadrants << INSTANCE_QUADRANT_SHIFT;
            put(count[i], room[i], depth_of_block[from], instance, slot_of_block[from] + first + i * SCAN_BLOCK);
        }
    }
}

bool has_queue() {
    uint size = SUBGROUP_SIZE;
    return size >= QUEUE_SUBGROUP && frame.tile_count <= QUEUE_TILES;
}

// The `count` instances of one Gaussian, row by row: into the queue from `at` on, or straight into their lists, as slots from `at` on.
void emit_serially(uint thread, uint gaussian, Ellipse e, uint depth, uint count, uint at) {
    bool queued = has_queue();
    depth_of_block[thread] = depth;
    Extent extent = extent_of(e);
    uvec2 rows = tile_row_range(e, frame.size);
    uint end = at + count;
    for (uint row = rows.x; row < rows.y; row++) {
        uvec2 columns = tile_columns_of_row(e, extent, row, frame.size);
        vec4 half_rows = half_rows_of_tile_row(e, extent, row);
        for (uint column = columns.x; column < columns.y && at < end; column++) {
            uint tile = row * frame.tiles.x + column;
            uint quadrants = quadrants_of_tile(half_rows, column);
            if (queued) {
                queue[at] = tile | quadrants << QUEUE_QUADRANT_SHIFT | thread << QUEUE_THREAD_SHIFT;
            } else {
                append(tile, depth, gaussian | quadrants << INSTANCE_QUADRANT_SHIFT, at);
            }
            at++;
        }
    }
    // The count may have promised more than there are.
    for (; queued && at < end; at++) {
        queue[at] = NO_INSTANCE;
    }
}

// Instance k of a Gaussian, its tiles in row-major order; none when the count promised more than there are.
void emit_one(uint gaussian, uint k, uint slot) {
    uint depth;
    Ellipse e = ellipse_of(gaussian, depth);
    Extent extent = extent_of(e);
    uvec2 rows = tile_row_range(e, frame.size);
    uint row = rows.x;
    uint column = 0u;
    for (; row < rows.y; row++) {
        uvec2 columns = tile_columns_of_row(e, extent, row, frame.size);
        uint n = columns.y - columns.x;
        column = columns.x + k;
        if (k < n) {
            break;
        }
        k -= n;
    }
    if (row < rows.y) {
        uint quadrants = quadrants_of_tile(half_rows_of_tile_row(e, extent, row), column);
        append(row * frame.tiles.x + column, depth, gaussian | quadrants << INSTANCE_QUADRANT_SHIFT, slot);
    }
}

// The workgroup's Gaussians. Those of a thread: Gaussian g with `count` tiles, the first of whose slots is `slot`. Of one with at
// most SERIAL_TILES its ellipse and depth are given; of the others they are read from `splats`.
void append_block(uint group, uint t, uint g, uint count, Ellipse e, uint depth, uint slot) {
    bool serial = count <= SERIAL_TILES;
    uint queue_total = 0u;
    uint in_queue = 0u;
    bool queued = has_queue();
    if (queued) {
        in_queue = workgroup_exclusive_add(serial ? count : 0u, queue_total);
    }
    uint shared_total;
    uint in_shared = workgroup_exclusive_add(serial ? 0u : count, shared_total);
    first_shared[t] = in_shared;
    slot_of_block[t] = slot - (serial ? in_queue : in_shared);
    if (serial && count != 0u) {
        emit_serially(t, g, e, depth, count, queued ? in_queue : slot);
    }
    barrier();

    for (uint first = t; first < queue_total; first += SCAN_BLOCK * QUEUE_BATCH) {
        append_queued(group, first, queue_total);
    }
    for (uint k = t; k < shared_total; k += SCAN_BLOCK) {
        uint from = owner(k);
        emit_one(group * SCAN_BLOCK + from, k - first_shared[from], slot_of_block[from] + k);
    }
}

#endif
