// Blends the splats of each tile front to back: the body of the kernels `blend`, `blend_packed` and `blend_states`, which declare the
// constants and buffers and say how a pixel is stored. One subgroup owns one subtile of pixels and shares nothing with the others,
// so a subtile stops as soon as its own pixels are opaque; with STAGE 1 it then only waits for the others of its workgroup.
//
//   subgroup size    4      8     16     32     64    128
//   lane columns     4      8      8      8      8     16
//   pixels per lane  16     8      4      2      1      1    (PIXELS_PER_LANE; these give 8x8, 4x16 or 16x8 px)
//
// A lane's pixels lie below one another, (lane rows) apart, so that l11 dx is shared by all of them. The splats of a tile
// come in batches of SUBGROUP_SIZE, one per lane: each lane asks whether its splat reaches a quadrant that the subtile lies in,
// and the survivors are blended in order, with the parameters broadcast according to STAGE:
//   0 subgroupShuffle: best where it is one instruction on scalar or vector registers (lavapipe, AMD);
//   1 through a slice of shared memory per subgroup: one 16-byte broadcast read replaces four shuffles, which have a
//     quarter of the arithmetic rate on NVIDIA;
//   2 re-read from `splats` at a uniform address (L1 hits).
#ifndef SPGS_BLEND_TILE
#define SPGS_BLEND_TILE

#include "tile_batches.glsl"
#ifdef BLEND_STATES
#include "segments.glsl"

// Keeps a pixel's state at the beginning of a segment: colour so far, transmittance (negative once closed).
void store_state(uint at, vec4 state);
#endif

// What becomes of a finished pixel: at = row * width + column; value: colour over the background, 1 - transmittance.
void store_pixel(uvec2 pixel, uint at, vec4 value);

const float NOWHERE = -1e30; // log2 of an opacity

shared vec4 staged[3 * 128];

// A lane's pixels: their transmittance (negative once no more may be blended) and sums.
float transmittance[16];
vec3 sum_colour[16];
float sum_depth[16];

// Blends one splat into the lane's pixels. first: u and v at the subtile's corner (lib/blend.glsl), l11, l12. pixel: centre of the
// lane's first pixel from the corner; row_step: distance to the next, px.
void blend(vec4 first, vec4 second, vec3 colour, vec2 pixel, float row_step) {
    uint with_depth = WITH_DEPTH;
    float u_0 = first.x + first.z * pixel.x + first.w * pixel.y;
    float v_0 = first.y + second.x * pixel.y;
    [[unroll]] for (uint j = 0u; j < PIXELS_PER_LANE; j++) {
        float down = float(j) * row_step;
        float u = u_0 + first.w * down;
        float v = v_0 + second.x * down;
        float weight;
        blend_alpha(second.y - u * u - v * v, transmittance[j], weight);
        sum_colour[j] += weight * colour;
        if (with_depth == 1u) {
            sum_depth[j] += weight * second.z;
        }
    }
}

// Bits of the quadrants (lib/ellipse.glsl) in which pixels of a subtile lie; low, high: its first and last pixel, from the
// tile's corner.
uint quadrants_of_subtile(uvec2 low, uvec2 high) {
    uint across = (low.x < 8u ? 1u : 0u) | (high.x >= 8u ? 2u : 0u);
    return (low.y < 8u ? across : 0u) | (high.y >= 8u ? across << 2u : 0u);
}

// The lane's splat of a batch: the instance, 0 past the list's end, and what is blended if it reaches the subtile.
struct Candidate {
    uint instance;
    vec4 first;
    vec4 second;
    vec3 colour;
};

uint instance_at(uint at, bool present) {
    uint with_slots = WITH_SLOTS;
    uint instance = present ? values[at] : 0u;
    if (with_slots == 1u) {
        instance = present ? gaussian_of_slot[instance] : 0u;
    }
    return instance;
}

#ifdef BLEND_STATES
// Stores the state of the lane's pixels, whose first one is `own`, at the beginning of a segment other than the first.
void store_states(uint segment, uvec2 own, uint lane_rows) {
    [[unroll]] for (uint j = 0u; j < PIXELS_PER_LANE; j++) {
        uint y = own.y + j * lane_rows;
        if (own.x < frame.size.x && y < frame.size.y) {
            uint at = ((segment - 1u) * frame.size.y + y) * frame.size.x + own.x;
            store_state(at, vec4(sum_colour[j], transmittance[j]));
        }
    }
}
#endif

Candidate candidate_of(uint instance, uint quadrants, vec2 corner) {
    Candidate c = Candidate(instance, vec4(0.0), vec4(0.0), vec3(0.0));
    if ((instance & quadrants) != 0u) {
        uint stride = splat_stride();
        uint at = stride * (instance & INSTANCE_GAUSSIAN);
        uvec4 a = splats[at];
        uvec4 b = splats[at + 1u];
        uvec4 third = uvec4(0u);
        if (stride == 3u) {
            third = splats[at + 2u];
        }
        unpack_splat(a, b, c.first, c.second);
        c.first.xy = splat_at(c.first, c.second.x, corner);
        c.colour = unpack_colour(b, third);
    }
    return c;
}

void main() {
    uint size = SUBGROUP_SIZE;
    uint stage = STAGE;
    uint with_depth = WITH_DEPTH;
    uint stride = splat_stride();
    uint pixels_per_lane = PIXELS_PER_LANE;
    uint columns = size >= 128u ? 16u : min(size, 8u);
    uint lane_rows = size / columns;
    uint rows = lane_rows * pixels_per_lane;
    uint across = TILE_SIZE / columns;
    uint subtiles = across * (TILE_SIZE / rows);
    uint subtile = workgroup_index() * (128u / size) + gl_SubgroupID;
    uint tile = subtile / subtiles;
    uint tiles = frame.tile_count;
    bool open = tile < tiles; // the subgroup has pixels that are not opaque
    uint inside = subtile - tile * subtiles;
    uvec2 low = uvec2(columns * (inside % across), rows * (inside / across));
    uint quadrants = quadrants_of_subtile(low, low + uvec2(columns - 1u, rows - 1u)) << INSTANCE_QUADRANT_SHIFT;
    uvec2 corner = TILE_SIZE * uvec2(tile % frame.tiles.x, tile / frame.tiles.x) + low;
    uint lane = gl_SubgroupInvocationID;
    uvec2 own = corner + uvec2(lane % columns, lane / columns);
    vec2 pixel = vec2(own - corner) + 0.5;
    float row_step = float(lane_rows);

    [[unroll]] for (uint j = 0u; j < PIXELS_PER_LANE; j++) {
        bool in_image = tile < tiles && own.x < frame.size.x && own.y + j * lane_rows < frame.size.y;
        transmittance[j] = in_image ? 1.0 : -1.0;
        sum_colour[j] = vec3(0.0);
        sum_depth[j] = 0.0;
    }

    uint base = open ? ranges[2u * tile] : 0u;
    uint end = open ? ranges[2u * tile + 1u] : 0u;
#ifdef BLEND_STATES
    uint segment = 1u; // the next one
    uint segment_splats = segment_length(max(end, base) - base);
    uint segment_base = base + segment_splats;
#endif
    uint batches = batches_to_walk(tile, subtiles, tiles, stage == 1u);
    Candidate next = candidate_of(instance_at(base + lane, base + lane < end), quadrants, vec2(corner));
    uint next_but_one = 0u;
    if (stage == 1u) {
        next_but_one = instance_at(base + size + lane, base + size + lane < end);
    }
    for (uint batch = 0u; batch < batches; batch++) {
#ifdef BLEND_STATES
        if (base == segment_base && base < end) {
            store_states(segment, own, lane_rows);
            segment++;
            segment_base += segment_splats;
        }
#endif
        uint instance = next.instance;
        vec4 first = next.first;
        vec4 second = next.second;
        vec3 third = next.colour;
        bool hit = (instance & quadrants) != 0u;
        uvec4 survivors = subgroupBallot(hit);
        uint index = instance & INSTANCE_GAUSSIAN;
        if (stage == 1u) {
            // The next batch comes from memory while this one is blended: a subgroup that waits for each is the tail of the frame.
            uint at = base + 2u * size + lane;
            next = candidate_of(open ? next_but_one : 0u, quadrants, vec2(corner));
            next_but_one = instance_at(at, open && at < end);
            // Compact the survivors into this subgroup's slice. They are blended two at a time, which halves what the loop costs:
            // an odd number gets one more, which is nowhere.
            uint slice = gl_SubgroupID * size;
            uint before = 0u;
            uint count = 0u;
            [[unroll]] for (uint word = 0u; word < 4u; word++) {
                uint start = 32u * word;
                uint below = lane >= start + 32u ? 0xffffffffu : lane > start ? (1u << (lane - start)) - 1u : 0u;
                before += bitCount(survivors[word] & below);
                count += bitCount(survivors[word]);
            }
            if (hit) {
                staged[slice + before] = first;
                staged[128u + slice + before] = second;
                staged[256u + slice + before] = vec4(third, 0.0);
            }
            bool odd = (count & 1u) != 0u;
            if (odd && lane == 0u) {
                staged[slice + count] = vec4(0.0);
                staged[128u + slice + count] = vec4(0.0, NOWHERE, 0.0, 0.0);
                staged[256u + slice + count] = vec4(0.0);
            }
            subgroupBarrier();
            for (uint k = slice; k < slice + count; k += 2u) {
                blend(staged[k], staged[128u + k], staged[256u + k].xyz, pixel, row_step);
                blend(staged[k + 1u], staged[129u + k], staged[257u + k].xyz, pixel, row_step);
            }
            subgroupBarrier();
        } else {
            for (uint word = 0u; word < (size + 31u) / 32u; word++) {
                uint mask = survivors[word];
                // A loop that tests at its end: a device that runs both sides of a branch under a mask (lavapipe) does not pay
                // for a last empty round.
                if (mask != 0u) {
                    do {
                        uint source = 32u * word + uint(findLSB(mask));
                        mask &= mask - 1u;
                        if (stage == 0u) {
                            vec4 a = subgroupShuffle(first, source);
                            vec3 b = subgroupShuffle(second.xyz, source);
                            blend(a, vec4(b, 0.0), subgroupShuffle(third, source), pixel, row_step);
                        } else {
                            uint splat = stride * subgroupShuffle(index, source);
                            uvec4 a = splats[splat];
                            uvec4 b = splats[splat + 1u];
                            uvec4 c = uvec4(0u);
                            if (stride == 3u) {
                                c = splats[splat + 2u];
                            }
                            unpack_splat(a, b, first, second);
                            first.xy = splat_at(first, second.x, vec2(corner));
                            blend(first, second, unpack_colour(b, c), pixel, row_step);
                        }
                    } while (mask != 0u);
                }
            }
        }
        float most = transmittance[0];
        [[unroll]] for (uint j = 1u; j < PIXELS_PER_LANE; j++) {
            most = max(most, transmittance[j]);
        }
        open = subgroupAny(most > 0.0);
        base += size;
        if (stage != 1u) {
            if (!open) {
                break;
            }
            next = candidate_of(instance_at(base + lane, base + lane < end), quadrants, vec2(corner));
        }
    }

#ifdef BLEND_STATES
    // Those that a subgroup of opaque pixels did not walk to.
    for (; segment_base < end; segment_base += segment_splats) {
        store_states(segment, own, lane_rows);
        segment++;
    }
#endif

    [[unroll]] for (uint j = 0u; j < PIXELS_PER_LANE; j++) {
        uint y = own.y + j * lane_rows;
        if (tile < tiles && own.x < frame.size.x && y < frame.size.y) {
            uint at = y * frame.size.x + own.x;
            float rest = abs(transmittance[j]);
            store_pixel(uvec2(own.x, y), at, vec4(sum_colour[j] + rest * frame.background, 1.0 - rest));
#ifndef BLEND_STATES
            if (with_depth == 1u) {
                depth[at] = sum_depth[j];
            }
#endif
        }
    }
}

#endif
