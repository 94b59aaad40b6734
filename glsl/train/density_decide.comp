#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_KHR_shader_subgroup_vote : require

// What becomes of each Gaussian: pruned, kept, cloned or split. Counts, and new rows per block of 256.

#include "lib/dispatch.glsl"
#include "lib/subgroup.glsl"
#include "lib/density.glsl"

layout(local_size_x = 256) in;

layout(std430, set = 0, binding = 0) readonly buffer LogScaleBlock { float log_scale[]; };
layout(std430, set = 0, binding = 1) readonly buffer OpacityLogitBlock { float opacity_logit[]; };
layout(std430, set = 0, binding = 2) readonly buffer DensityBlock { float density[]; };
layout(std430, set = 0, binding = 3) readonly buffer MaxRadiusBlock { float max_radius[]; };
layout(std430, set = 0, binding = 4) writeonly buffer ActionBlock { uint action[]; };
layout(std430, set = 0, binding = 5) writeonly buffer RowBlockBlock { uint row_block[]; };
layout(std430, set = 0, binding = 6) buffer TotalsBlock { uint totals[]; };

layout(push_constant) uniform PushBlock {
    uint gaussians;
    float gradient_threshold;
    float min_opacity_logit;
    float dense_log_scale;  // largest log scale that is cloned
    float world_log_scale;  // a larger one is pruned
    float max_screen_radius; // a larger one is pruned, px
    uint accept_key;        // growth is granted to gradient bits above this,
    uint accept_index;      // and, at equality, to indices up to this
} push;

bool not_finite(float x) {
    return (floatBitsToUint(x) & 0x7f800000u) == 0x7f800000u;
}

uint decide(uint i, out bool refused) {
    uint n = push.gaussians;
    vec3 scale = vec3(log_scale[i], log_scale[n + i], log_scale[2u * n + i]);
    float largest = max(scale.x, max(scale.y, scale.z));
    // Phrased so that a Gaussian that is not finite is pruned.
    bool usable = opacity_logit[i] >= push.min_opacity_logit && !not_finite(scale.x) && !not_finite(scale.y)
        && !not_finite(scale.z);
    float g = mean_gradient(density[i], density[n + i]);
    bool grows = usable && g >= push.gradient_threshold;
    bool clone = largest <= push.dense_log_scale;
    // By what the new rows will have: a split divides scales by 1.6.
    bool outgrown = grows && largest - (clone ? 0.0 : SPLIT_LOG_SCALE) > push.world_log_scale;
    uint key = floatBitsToUint(g);
    bool accepted = key > push.accept_key || (key == push.accept_key && i <= push.accept_index);
    bool granted = grows && !outgrown && accepted;
    refused = grows && !outgrown && !accepted;
    bool too_large =
        outgrown || largest > push.world_log_scale || (!refused && max_radius[i] > push.max_screen_radius);
    uint unchanged = !usable || too_large ? ACTION_PRUNE : ACTION_KEEP;
    return granted ? (clone ? ACTION_CLONE : ACTION_SPLIT) : unchanged;
}

void count(uint word, bool hit) {
    uint n = subgroupAdd(hit ? 1u : 0u);
    if (gl_SubgroupInvocationID == 0u && n != 0u) {
        atomicAdd(totals[word], n);
    }
}

void main() {
    uint group = workgroup_index();
    uint thread = thread_index();
    uint i = group * SCAN_THREADS + thread;
    bool real = i < push.gaussians;
    uint what = ACTION_PRUNE;
    bool refused = false;
    if (real) {
        what = decide(i, refused);
        action[i] = what;
    }
    uint total;
    workgroup_exclusive_add(real ? rows_of_action(what) : 0u, total);
    if (thread == 0u && group * SCAN_THREADS < push.gaussians) {
        row_block[group] = total;
    }
    count(0u, real && what == ACTION_PRUNE);
    count(1u, real && what == ACTION_KEEP);
    count(2u, real && what == ACTION_CLONE);
    count(3u, real && what == ACTION_SPLIT);
    count(4u, real && refused);
}
