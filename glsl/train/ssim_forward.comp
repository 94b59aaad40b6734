#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_EXT_control_flow_attributes : require

// SSIM of each pixel and channel and its derivatives by the local moments. With d = x - y,
//   SSIM = l c,  l = 1 - mu_d^2 / (mu_x^2 + mu_y^2 + C1),  c = 1 - var(d) / (var(x) + var(y) + C2),
// which is the usual form with 2 mu_x mu_y = mu_x^2 + mu_y^2 - mu_d^2 and the same for the covariance: four moments instead
// of five, and no cancellation where the images are alike.

layout(local_size_x = 128) in;
layout(constant_id = 0) const uint SUBGROUP_SIZE = 32u;
layout(constant_id = 1) const uint TARGET = 0u; // 0: RGBA8, 1: float bits, 2: RGBA8, some pixels left out
layout(constant_id = 2) const uint STAGE = 1u;  // as lib/ssim.glsl has it

#include "lib/frame.glsl"
#include "lib/dispatch.glsl"
#include "lib/thread.glsl"
#define STEP_BINDING 5
#include "lib/step.glsl"
#define COLOR_BINDING 1
#define TARGET_BINDING 2
#include "lib/image_target.glsl"
#include "lib/ssim.glsl"

layout(std430, set = 0, binding = 3) writeonly buffer SsimMapsBlock { vec4 ssim_maps[]; };
layout(std430, set = 0, binding = 4) writeonly buffer LossPartialBlock { float loss_partial[]; };

// Two of the four moments at a time: with all of them shared memory would leave too few subgroups in flight.
shared vec2 moments[58 * 33];
shared float sums[32]; // one per subgroup: 128 / 4

float total = 0.0; // of SSIM over the thread's pixels

// (rendered, target), zeros outside the image.
vec2 pixel_at(uint channel, ivec2 at) {
    uint kind = TARGET;
    vec2 pixel = vec2(0.0);
    if (at.x >= 0 && at.x < int(image_size.x) && at.y >= 0 && at.y < int(image_size.y)) {
        pixel = image_and_target(kind, uint(at.y) * image_size.x + uint(at.x), channel).xy;
    }
    return pixel;
}

// x, d, d^2, x^2 + y^2.
vec4 moments_of(vec2 pixel) {
    float d = pixel.x - pixel.y;
    return vec4(pixel.x, d, d * d, pixel.x * pixel.x + pixel.y * pixel.y);
}

// SSIM from the moments, and its derivatives by mu_x, by E[x^2 + y^2] and by E[d^2].
vec4 ssim_and_derivatives(vec4 m) {
    float mu_x = m.x;
    float mu_d = m.y;
    float mu_y = mu_x - mu_d;
    float b_1 = mu_x * mu_x + mu_y * mu_y + SSIM_C1;
    float b_2 = max(m.w - mu_x * mu_x - mu_y * mu_y, 0.0) + SSIM_C2;
    float var_d = max(m.z - mu_d * mu_d, 0.0);
    float r_1 = mu_d / b_1;
    float r_2 = var_d / b_2;
    float l = 1.0 - mu_d * r_1;
    float c = 1.0 - r_2;
    float by_sum = l * r_2 / b_2;
    float by_difference = -l / b_2;
    float by_mean = 2.0 * (r_1 * (r_1 * mu_x - 1.0) * c - by_difference * mu_d - by_sum * mu_x);
    return vec4(l * c, by_mean, by_sum, by_difference);
}

// STAGE 0: stores a row of the strip, four columns at a time, zeros in columns that only fill up a row of the maps.
void store_strip(uint channel, uvec2 first) {
    uint size = map_size(image_size);
    uint at = 3u * channel * size + first.y * map_stride(image_size) + first.x / 4u;
    [[unroll]] for (uint q = 0u; q < STRIP_COLUMNS / 4u; q++) {
        vec4 by_mean = vec4(0.0);
        vec4 by_sum = vec4(0.0);
        vec4 by_difference = vec4(0.0);
        [[unroll]] for (uint c = 0u; c < 4u; c++) {
            bool inside = first.x + 4u * q + c < image_size.x;
            vec4 s = ssim_and_derivatives(column_sum[4u * q + c]);
            total += inside ? s.x : 0.0;
            by_mean[c] = inside ? s.y : 0.0;
            by_sum[c] = inside ? s.z : 0.0;
            by_difference[c] = inside ? s.w : 0.0;
        }
        if (first.x + 4u * q < image_size.x) {
            ssim_maps[at + q] = by_mean;
            ssim_maps[at + q + size] = by_sum;
            ssim_maps[at + q + 2u * size] = by_difference;
        }
    }
}

// Convolves 16 columns of a row. first: WINDOW_RADIUS before them.
void convolve_row(uint channel, ivec2 first) {
    clear_row_sums();
    [[unroll]] for (uint i = 0u; i < STRIP_INPUTS; i++) {
        add_input(i, moments_of(pixel_at(channel, first + ivec2(i, 0))));
    }
}

void walk_strip(uint channel, uvec2 corner) {
    clear_column_sums();
    uint end = min(corner.y + STRIP_ROWS, image_size.y);
    uint rounds = corner.y < end ? end - corner.y + 2u * WINDOW_RADIUS : 0u;
    for (uint r = 0u; r < rounds; r++) {
        convolve_row(channel, ivec2(corner + uvec2(0u, r)) - int(WINDOW_RADIUS));
        add_row_sums();
        if (r >= 2u * WINDOW_RADIUS) {
            store_strip(channel, corner + uvec2(0u, r - 2u * WINDOW_RADIUS));
        }
    }
}

// STAGE 1, column pass: two moments of a run of pixels.
void convolve_column(uint task, out vec2 sum[COLUMN_RUN]) {
    uint column = task % LOSS_TILE_WIDTH;
    uint first = COLUMN_RUN * (task / LOSS_TILE_WIDTH);
    [[unroll]] for (uint j = 0u; j < COLUMN_RUN; j++) {
        sum[j] = vec2(0.0);
    }
    [[unroll]] for (uint i = 0u; i < COLUMN_INPUTS; i++) {
        vec2 m = moments[(first + i) * ROW_STRIDE + column];
        [[unroll]] for (uint k = 0u; k < WINDOW_SIZE; k++) {
            if (i >= k && i - k < COLUMN_RUN) {
                sum[i - k] += WINDOW[k] * m;
            }
        }
    }
}

// Results of a run of pixels; zeros as in STAGE 0.
void store_run(uint task, uvec2 corner, uint channel, vec2 low[COLUMN_RUN], vec2 high[COLUMN_RUN]) {
    uint size = map_size(image_size);
    uint stride = map_stride(image_size);
    uvec2 first = corner + uvec2(task % LOSS_TILE_WIDTH, COLUMN_RUN * (task / LOSS_TILE_WIDTH));
    uint c = first.x % 4u;
    [[unroll]] for (uint j = 0u; j < COLUMN_RUN; j++) {
        uint y = first.y + j;
        if (first.x < 4u * stride && y < image_size.y) {
            vec4 s = first.x < image_size.x ? ssim_and_derivatives(vec4(low[j], high[j])) : vec4(0.0);
            uint at = 3u * channel * size + y * stride + first.x / 4u;
            ssim_maps[at][c] = s.y;
            ssim_maps[at + size][c] = s.z;
            ssim_maps[at + 2u * size][c] = s.w;
            total += s.x;
        }
    }
}

void convolve_tile(uint channel, uvec2 corner, uint thread) {
    bool has_row = thread < ROW_TASKS;
    uint row_at = row_of(thread);
    if (has_row) {
        uvec2 first = corner + uvec2(ROW_RUN * (thread / TILE_ROWS), thread % TILE_ROWS);
        convolve_row(channel, ivec2(first) - int(WINDOW_RADIUS));
        [[unroll]] for (uint j = 0u; j < ROW_RUN; j++) {
            moments[row_at + j] = row_sum[j].xy;
        }
    }
    barrier();
    vec2 low[COLUMN_RUN];
    convolve_column(thread, low);
    barrier();
    if (has_row) {
        [[unroll]] for (uint j = 0u; j < ROW_RUN; j++) {
            moments[row_at + j] = row_sum[j].zw;
        }
    }
    barrier();
    vec2 high[COLUMN_RUN];
    convolve_column(thread, high);
    store_run(thread, corner, channel, low, high);
}

void main() {
    uint group = workgroup_index();
    uint channel = group % 3u;
    read_frame(channel);
    uint groups = 3u * loss_groups(image_size);
    uint thread = thread_index();
    uint size = SUBGROUP_SIZE;
    uint stage = STAGE;
    if (stage == 0u) {
        walk_strip(channel, strip_corner(group / 3u, thread, image_size));
    } else {
        convolve_tile(channel, tile_corner(group / 3u, image_size), thread);
    }
    float of_subgroup = subgroupAdd(total);
    if (gl_SubgroupInvocationID == 0u) {
        sums[gl_SubgroupID] = of_subgroup;
    }
    barrier();
    if (thread == 0u && group < groups) {
        float sum = 0.0;
        for (uint s = 0u; s < LOSS_THREADS / size; s++) {
            sum += sums[s];
        }
        loss_partial[group] = sum;
    }
}
