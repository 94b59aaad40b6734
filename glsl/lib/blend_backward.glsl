// Backward of `blend`: from the gradient of the image to the twelve sums per splat from which `deform_project_backward` goes
// on. Included by blend_backward.comp and blend_backward_native.comp, which define `add_to_row`.
//
// The forward pass is replayed front to back with its own arithmetic (lib/blend.glsl), so that exactly its contributions are
// seen. With q_i = g.rgb . c_i + g.a the loss changes with alpha_i by T_i q_i - R_i / (1 - alpha_i), where R_i is what all
// later splats and the background contribute: R starts as g . colour of the finished pixel and loses w_i q_i at each splat.
// 1 - alpha >= 0.01, so nothing blows up, and no second pass from the back is needed.
//
// A tile's list is cut into at most SEGMENTS segments that are replayed side by side, because a small image has few tiles with
// long lists. In front of a segment other than the first, `states` (from `blend_states`) says what the forward pass had: T, and the
// colour and alpha so far, which R has lost.
//
// One subgroup owns SUBTILES subtiles of a segment (shapes as in blend.comp). The splats of the segment come in batches of
// SUBGROUP_SIZE, one per lane; for each subtile the splats that reach it are replayed in order, each lane summing over its
// own pixels. The sums of all lanes are added by a butterfly that halves the number of values per lane at each step (12 or 13
// shuffles at 32 lanes, not 60), and the total joins the row of the splat:
//   STAGE 0: rows in registers, one lane per splat, parameters and totals by subgroupShuffle (lavapipe, AMD);
//   STAGE 1: rows and parameters in the subgroup's slice of shared memory.
// A row leaves the subgroup once per batch: ACCUMULATE 0 stores it as the row of its instance (nobody else writes it, so
// SUBTILES must cover the tile), 1 and 2 add it to the row of the Gaussian.

layout(local_size_x = 128) in;
layout(constant_id = 0) const uint SUBGROUP_SIZE = 32;
layout(constant_id = 1) const uint ACCUMULATE = 0;
layout(constant_id = 2) const uint STAGE = 1;
layout(constant_id = 3) const uint PIXELS_PER_LANE = 2; // of one subtile; at most 16
layout(constant_id = 4) const uint SUBTILES = 4;        // of one subgroup: 1, 2 or 4, at most those of a tile
layout(constant_id = 5) const uint SEGMENTS = 1;        // see segments.glsl
layout(constant_id = 6) const uint LEAST_SEGMENT = 256;
layout(constant_id = 7) const uint ABSOLUTE = 0; // 1: the two sums without sign, too; else zeros

#include "frame.glsl"
#include "dispatch.glsl"
#include "limits.glsl"
// Training always draws exactly.
const uint ALPHA_CUT = 0u;
const uint TILE_CULL = 0u;
const uint TRANSMITTANCE_STOP = 0u;

#include "blend.glsl"

layout(std430, set = 0, binding = 1) readonly buffer RangesBlock { uint ranges[]; };
layout(std430, set = 0, binding = 2) readonly buffer ValuesBlock { uint values[]; };
layout(std430, set = 0, binding = 3) readonly buffer GaussianOfSlotBlock { uint gaussian_of_slot[]; };
layout(std430, set = 0, binding = 4) readonly buffer SplatsBlock { vec4 splats[]; };
layout(std430, set = 0, binding = 5) readonly buffer ColorBlock { vec4 color[]; };
layout(std430, set = 0, binding = 6) readonly buffer ImageGradientBlock { vec4 image_gradient[]; };
// Binding 7 is where the rows go.
layout(std430, set = 0, binding = 8) readonly buffer StatesBlock { vec4 states[]; };

const uint ROW = 12u;               // words of a row
const uint SUMS = 12u;              // h, hu, hv, huu, huv, hvv, red, green, blue, pixels, |by x|, |by y|
const uint SUM_PIXELS = 9u;
const uint SUM_BY_X = 10u;          // of h times the derivative of ln alpha by the centre / (2 ln 2), without its sign
const uint SUM_BY_Y = 11u;
const float FAR_VALUE = 1e12;       // gradients and colours past this count as 0: products must stay finite
const float FAR_PRODUCT = 1e24;

#include "segments.glsl"

// First and last + 1 instance of a segment: tile * SEGMENTS + its place in the tile's list.
uvec2 range_of_segment(uint segment) {
    uint segments = SEGMENTS;
    uint tile = segment / segments;
    uint first = ranges[2u * tile];
    uint end = max(ranges[2u * tile + 1u], first);
    if (segments > 1u) {
        uint splats = segment_length(end - first);
        first = min(first + (segment - tile * segments) * splats, end);
        end = min(first + splats, end);
    }
    return uvec2(first, end);
}

#define SEGMENTED
#include "tile_batches.glsl"

shared vec4 staged[3 * 128];
shared float staged_sums[12 * 128];
shared uint staged_row[128];

// The lane's pixels, subtile by subtile: transmittance (negative once closed), what is still to come, gradient.
float transmittance[64];
float to_come[64];
vec4 pixel_gradient[64];

// The lane's splat of the batch and its sums over the subtiles so far.
vec4 own_first;
vec4 own_second;
vec3 own_colour;
float own[12];

// Sums of one splat: over the lane's pixels, then over the subgroup.
float sums[12];

// By bits, so that NaN is not below anything.
bool below(float x, float limit) {
    return (floatBitsToUint(x) & 0x7fffffffu) < floatBitsToUint(limit);
}

bool all_below(vec3 x, float limit) {
    return below(x.x, limit) && below(x.y, limit) && below(x.z, limit);
}

void add_to_row(uint at, float value); // at: word of the target

// Takes up the pixel `at` as the lane's i-th, unless it is outside the image. place: of the segment in the tile's list.
void open_pixel(uint i, uvec2 at, bool in_image, uint place) {
    transmittance[i] = in_image ? 1.0 : -1.0;
    vec4 g = vec4(0.0);
    float r = 0.0;
    float past = 0.0; // of r: what the segments in front contributed
    if (in_image) {
        uint k = at.y * frame.size.x + at.x;
        g = image_gradient[k];
        vec4 c = color[k];
        r = g.x * c.x + g.y * c.y + g.z * c.z + g.w * c.w;
        if (place > 0u) {
            vec4 state = states[(place - 1u) * frame.size.x * frame.size.y + k];
            transmittance[i] = state.w;
            past = g.x * state.x + g.y * state.y + g.z * state.z + g.w * (1.0 - abs(state.w));
        }
    }
    bool usable = all_below(g.xyz, FAR_VALUE) && below(g.w, FAR_VALUE) && below(r, FAR_PRODUCT) && below(past, FAR_PRODUCT);
    pixel_gradient[i] = usable ? g : vec4(0.0);
    to_come[i] = usable ? r - past : 0.0;
}

// Replays one splat on the lane's pixels of subtile s. corner: of the subtile; pixel: centre of the lane's first one from there;
// row_step: distance to the next, px.
void replay(uint s, vec4 first, vec4 second, vec3 colour, vec2 corner, vec2 pixel, float row_step) {
    vec2 at_corner = splat_at(first, second.x, corner);
    float u_0 = at_corner.x + first.z * pixel.x + first.w * pixel.y;
    float v_0 = at_corner.y + second.x * pixel.y;
    uint pixels = 0u;
    uint absolute = ABSOLUTE;
    [[unroll]] for (uint c = 0u; c < SUMS; c++) {
        sums[c] = 0.0;
    }
    [[unroll]] for (uint j = 0u; j < PIXELS_PER_LANE; j++) {
        uint i = s * PIXELS_PER_LANE + j;
        float down = float(j) * row_step;
        float u = u_0 + first.w * down;
        float v = v_0 + second.x * down;
        float weight;
        float alpha = blend_alpha(second.y - u * u - v * v, transmittance[i], weight);
        vec4 g = pixel_gradient[i];
        float wq = weight * (g.x * colour.x + g.y * colour.y + g.z * colour.z + g.w);
        to_come[i] -= wq;
        // Where alpha is clamped it does not depend on the splat. The quotient does not wait for what is still to come.
        float h = alpha < MAX_ALPHA ? wq - to_come[i] * (alpha / (1.0 - alpha)) : 0.0;
        float hu = h * u;
        float hv = h * v;
        sums[0] += h;
        sums[1] += hu;
        sums[2] += hv;
        sums[3] += hu * u;
        sums[4] += hu * v;
        sums[5] += hv * v;
        if (absolute == 1u) {
            sums[SUM_BY_X] += abs(hu);
            sums[SUM_BY_Y] += abs(hu * first.w + hv * second.x);
        }
        sums[6] += weight * g.x;
        sums[7] += weight * g.y;
        sums[8] += weight * g.z;
        pixels += alpha > 0.0 ? 1u : 0u;
    }
    sums[SUM_PIXELS] = float(pixels);
    sums[SUM_BY_X] *= abs(first.z);
}

// Of two values, one is kept and summed over the pair of lanes, the other given away: the odd lane keeps the second.
float exchange(float even, float odd, uint mask) {
    bool second = (gl_SubgroupInvocationID & mask) != 0u;
    return (second ? odd : even) + subgroupShuffleXor(second ? even : odd, mask);
}

float butterfly(float value, uint mask) {
    return value + subgroupShuffleXor(value, mask);
}

// Adds `sums` over the subgroup. Afterwards lane l of the first min(size, 8) has column l in sums[0], and so on for the
// following columns: 4 lanes: sums[0..2] are columns l, 4 + l, 8 + l; 8 lanes: sums[0..1] are l, 8 + l; more: sums[0].
void reduce() {
    uint size = SUBGROUP_SIZE;
    uint absolute = ABSOLUTE;
    float a[6];
    [[unroll]] for (uint i = 0u; i < 5u; i++) {
        a[i] = exchange(sums[2u * i], sums[2u * i + 1u], 1u);
    }
    a[5] = absolute == 1u ? exchange(sums[SUM_BY_X], sums[SUM_BY_Y], 1u) : 0.0;
    sums[0] = exchange(a[0], a[1], 2u);
    sums[1] = exchange(a[2], a[3], 2u);
    sums[2] = exchange(a[4], a[5], 2u);
    if (size >= 8u) {
        sums[0] = exchange(sums[0], sums[1], 4u);
        sums[1] = butterfly(sums[2], 4u);
    }
    if (size >= 16u) {
        sums[0] = exchange(sums[0], sums[1], 8u);
    }
    for (uint mask = 16u; mask < size; mask *= 2u) {
        sums[0] = butterfly(sums[0], mask);
    }
}

// Column c after `reduce`; every lane must call it, c is a constant.
float total(uint c) {
    uint size = SUBGROUP_SIZE;
    uint wide = min(size, 16u);
    return subgroupShuffle(sums[c / wide], c % wide);
}

// Adds the reduced sums to the row of the splat of lane `source`.
void collect(uint source) {
    uint stage = STAGE;
    uint size = SUBGROUP_SIZE;
    uint lane = gl_SubgroupInvocationID;
    if (stage == 0u) {
        [[unroll]] for (uint c = 0u; c < SUMS; c++) {
            float sum = total(c);
            own[c] += lane == source ? sum : 0.0;
        }
    } else {
        uint wide = min(size, 16u);
        uint row = ROW * (gl_SubgroupID * size + source);
        // At most three columns per lane; k must be a constant for `sums` to stay in registers.
        [[unroll]] for (uint k = 0u; k < 3u; k++) {
            uint c = k * wide + lane;
            if (k * wide < SUMS && lane < wide && c < SUMS) {
                staged_sums[row + c] += sums[k];
            }
        }
    }
}

// Replays the batch on subtile s of the subgroup, whose first pixel is `corner`.
void walk(uint s, uvec2 corner, uvec2 extent, bool valid, vec2 offset, float row_step) {
    uint stage = STAGE;
    uint size = SUBGROUP_SIZE;
    uint slice = gl_SubgroupID * size;
    vec2 low = vec2(corner) + 0.5;
    vec2 high = low + vec2(extent - 1u);
    vec2 x = ellipse_row_interval(ellipse_of_splat(own_first, own_second), low.y, high.y);
    bool open = false;
    [[unroll]] for (uint j = 0u; j < PIXELS_PER_LANE; j++) {
        open = open || transmittance[s * PIXELS_PER_LANE + j] > 0.0;
    }
    open = subgroupAny(open);
    uvec4 survivors = subgroupBallot(open && valid && x.x <= high.x && x.y >= low.x && x.x <= x.y);
    for (uint word = 0u; word < (size + 31u) / 32u; word++) {
        uint mask = survivors[word];
        // A loop that tests at its end, as in blend.comp.
        if (mask != 0u) {
            do {
                uint source = 32u * word + uint(findLSB(mask));
                mask &= mask - 1u;
                if (stage == 0u) {
                    vec4 first = subgroupShuffle(own_first, source);
                    vec4 second = vec4(subgroupShuffle(own_second.xy, source), 0.0, 0.0);
                    replay(s, first, second, subgroupShuffle(own_colour, source), vec2(corner), offset + 0.5, row_step);
                } else {
                    uint at = slice + source;
                    replay(s, staged[at], staged[128u + at], staged[256u + at].xyz, vec2(corner), offset + 0.5, row_step);
                }
                // Skipping costs a device that runs both sides a vote for nothing.
                if (stage == 0u || subgroupAny(sums[SUM_PIXELS] > 0.0)) {
                    reduce();
                    collect(source);
                }
            } while (mask != 0u);
        }
    }
}

// Hands the rows of the batch to `add_to_row`. row: of the lane's splat.
void deliver(bool valid, uint row) {
    uint stage = STAGE;
    uint size = SUBGROUP_SIZE;
    uint slice = gl_SubgroupID * size;
    uint lane = gl_SubgroupInvocationID;
    if (stage == 0u) {
        if (valid && own[SUM_PIXELS] > 0.0) {
            for (uint c = 0u; c < SUMS; c++) {
                add_to_row(ROW * row + c, own[c]);
            }
        }
    } else {
        subgroupBarrier();
        // Neighbouring lanes write neighbouring words.
        for (uint k = lane; k < ROW * size; k += size) {
            uint from = k / ROW;
            uint c = k - ROW * from;
            if (c < SUMS && staged_sums[ROW * (slice + from) + SUM_PIXELS] > 0.0) {
                add_to_row(ROW * staged_row[slice + from] + c, staged_sums[ROW * slice + k]);
            }
        }
        subgroupBarrier();
    }
}

// Loads the batch: one splat per lane.
void load(bool valid, uint index, uint row) {
    uint stage = STAGE;
    uint size = SUBGROUP_SIZE;
    uint at = gl_SubgroupID * size + gl_SubgroupInvocationID;
    own_first = vec4(0.0);
    own_second = vec4(0.0);
    own_colour = vec3(0.0);
    if (valid) {
        own_first = splats[3u * index];
        own_second = splats[3u * index + 1u];
        own_colour = splats[3u * index + 2u].xyz;
    }
    own_colour = all_below(own_colour, FAR_VALUE) ? own_colour : vec3(0.0);
    if (stage == 0u) {
        [[unroll]] for (uint c = 0u; c < SUMS; c++) {
            own[c] = 0.0;
        }
    } else {
        staged[at] = own_first;
        staged[128u + at] = own_second;
        staged[256u + at] = vec4(own_colour, 0.0);
        staged_row[at] = row;
        [[unroll]] for (uint c = 0u; c < ROW; c++) {
            staged_sums[ROW * at + c] = 0.0;
        }
        subgroupBarrier();
    }
}

// Whether the subgroup has pixels that are not opaque.
bool any_open() {
    uint pixels_per_lane = PIXELS_PER_LANE;
    uint subtiles = SUBTILES;
    bool pixel_open = false;
    [[unroll]] for (uint i = 0u; i < subtiles * pixels_per_lane; i++) {
        pixel_open = pixel_open || transmittance[i] > 0.0;
    }
    return subgroupAny(pixel_open);
}

void main() {
    uint size = SUBGROUP_SIZE;
    uint accumulate = ACCUMULATE;
    uint pixels_per_lane = PIXELS_PER_LANE;
    uint subtiles = SUBTILES;
    uint columns = size >= 128u ? 16u : min(size, 8u);
    uint lane_rows = size / columns;
    uvec2 extent = uvec2(columns, lane_rows * pixels_per_lane);
    uint across = TILE_SIZE / columns;
    uint per_tile = across * (TILE_SIZE / extent.y) / subtiles; // subgroups
    uint subgroup = workgroup_index() * (128u / size) + gl_SubgroupID;
    uint per_list = SEGMENTS;
    uint segment = subgroup / per_tile;
    uint segments = per_list * frame.tile_count;
    uint tile = segment / per_list;
    uint place = segment - tile * per_list;
    uvec2 range = segment < segments ? range_of_segment(segment) : uvec2(0u);
    bool open = range.x < range.y; // the subgroup has pixels that are not opaque
    uint inside = (subgroup - segment * per_tile) * subtiles; // first subtile
    uvec2 origin = TILE_SIZE * uvec2(tile % frame.tiles.x, tile / frame.tiles.x);
    uint lane = gl_SubgroupInvocationID;
    uvec2 of_lane = uvec2(lane % columns, lane / columns);
    float row_step = float(lane_rows);
    uvec2 corner[4];
    [[unroll]] for (uint s = 0u; s < 4u; s++) {
        corner[s] = origin + extent * uvec2((inside + s) % across, (inside + s) / across);
    }
    [[unroll]] for (uint s = 0u; s < SUBTILES; s++) {
        [[unroll]] for (uint j = 0u; j < PIXELS_PER_LANE; j++) {
            uvec2 at = corner[s] + of_lane + uvec2(0u, j * lane_rows);
            open_pixel(s * PIXELS_PER_LANE + j, at, open && at.x < frame.size.x && at.y < frame.size.y, place);
        }
    }
    if (per_list > 1u) {
        // Segments behind opaque pixels have nothing to do.
        open = any_open();
    }

    uint stage = STAGE;
    uint base = range.x;
    uint end = range.y;
    uint batches = batches_to_walk(segment, per_tile, segments, stage != 0u);
    for (uint batch = 0u; batch < batches; batch++) {
        bool valid = open && base + lane < end;
        uint row = valid ? values[base + lane] : 0u;
        uint index = row & INSTANCE_GAUSSIAN;
        if (accumulate == 0u && valid) {
            index = gaussian_of_slot[row] & INSTANCE_GAUSSIAN;
        }
        row = accumulate == 0u ? row : index;
        load(valid, index, row);
        // Written out, so that the subtile is a constant and the pixels stay in registers.
        walk(0u, corner[0], extent, valid, vec2(of_lane), row_step);
        if (subtiles > 1u) {
            walk(1u, corner[1], extent, valid, vec2(of_lane), row_step);
        }
        if (subtiles > 2u) {
            walk(2u, corner[2], extent, valid, vec2(of_lane), row_step);
            walk(3u, corner[3], extent, valid, vec2(of_lane), row_step);
        }
        deliver(valid, row);
        open = any_open();
        base += size;
        if (stage == 0u && !open) {
            break;
        }
    }
}
