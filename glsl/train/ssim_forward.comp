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
layout(constant_id = 1) const uint TARGET = 0u; // 0: RGBA8, 1: float bits

#include "lib/frame.glsl"
#include "lib/dispatch.glsl"
#include "lib/thread.glsl"
#define STEP_BINDING 5
#include "lib/step.glsl"
#define COLOR_BINDING 1
#define TARGET_BINDING 2
#include "lib/image_target.glsl"
#include "lib/ssim.glsl"

layout(std430, set = 0, binding = 3) writeonly buffer SsimMapsBlock { float ssim_maps[]; };
layout(std430, set = 0, binding = 4) writeonly buffer LossPartialBlock { float loss_partial[]; };

// Two of the four moments at a time: with all of them shared memory would leave too few subgroups in flight.
shared vec2 moments[58 * 33];
shared float sums[32]; // one per subgroup: 128 / 4

// Row pass: moments (x, d, d^2, x^2 + y^2) of a run of pixels.
void convolve_row(uint task, uvec2 corner, uint channel, out vec4 sum[ROW_RUN]) {
    uint kind = TARGET;
    uint row = task % TILE_ROWS;
    uint first = ROW_RUN * (task / TILE_ROWS);
    int y = int(corner.y + row) - int(WINDOW_RADIUS);
    int x = int(corner.x + first) - int(WINDOW_RADIUS);
    bool row_inside = y >= 0 && y < int(image_size.y);
    [[unroll]] for (uint j = 0u; j < ROW_RUN; j++) {
        sum[j] = vec4(0.0);
    }
    [[unroll]] for (uint i = 0u; i < ROW_INPUTS; i++) {
        int column = x + int(i);
        vec4 m = vec4(0.0);
        if (row_inside && column >= 0 && column < int(image_size.x)) {
            vec3 v = image_and_target(kind, uint(y) * image_size.x + uint(column), channel);
            float d = v.x - v.y;
            m = vec4(v.x, d, d * d, v.x * v.x + v.y * v.y);
        }
        [[unroll]] for (uint k = 0u; k < WINDOW_SIZE; k++) {
            if (i >= k && i - k < ROW_RUN) {
                sum[i - k] += WINDOW[k] * m;
            }
        }
    }
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

// Column pass: two moments of a run of pixels.
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

// Results of a run of pixels. Returns the sum of their SSIM.
float store_run(uint task, uvec2 corner, uint channel, vec2 low[COLUMN_RUN], vec2 high[COLUMN_RUN]) {
    uint first = COLUMN_RUN * (task / LOSS_TILE_WIDTH);
    uint pixels = image_size.x * image_size.y;
    uint x = corner.x + task % LOSS_TILE_WIDTH;
    float total = 0.0;
    [[unroll]] for (uint j = 0u; j < COLUMN_RUN; j++) {
        uint y = corner.y + first + j;
        if (x < image_size.x && y < image_size.y) {
            vec4 s = ssim_and_derivatives(vec4(low[j], high[j]));
            uint at = 3u * channel * pixels + y * image_size.x + x;
            ssim_maps[at] = s.y;
            ssim_maps[at + pixels] = s.z;
            ssim_maps[at + 2u * pixels] = s.w;
            total += s.x;
        }
    }
    return total;
}

void main() {
    uint group = workgroup_index();
    uint channel = group % 3u;
    read_frame(channel);
    uvec2 tiles = loss_tiles(image_size);
    uint groups = 3u * tiles.x * tiles.y;
    uint tile = group / 3u;
    uvec2 corner = uvec2(LOSS_TILE_WIDTH, LOSS_TILE_HEIGHT) * uvec2(tile % tiles.x, tile / tiles.x);
    uint thread = thread_index();
    uint size = SUBGROUP_SIZE;

    bool has_row = thread < ROW_TASKS;
    uint row_at = row_of(thread);
    vec4 row[ROW_RUN];
    if (has_row) {
        convolve_row(thread, corner, channel, row);
        [[unroll]] for (uint j = 0u; j < ROW_RUN; j++) {
            moments[row_at + j] = row[j].xy;
        }
    }
    barrier();
    vec2 low[COLUMN_RUN];
    convolve_column(thread, low);
    barrier();
    if (has_row) {
        [[unroll]] for (uint j = 0u; j < ROW_RUN; j++) {
            moments[row_at + j] = row[j].zw;
        }
    }
    barrier();
    vec2 high[COLUMN_RUN];
    convolve_column(thread, high);
    float total = store_run(thread, corner, channel, low, high);
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
