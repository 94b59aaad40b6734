// A step of Adam for the two key poses around the image's time, with terms that hold a key to where it began and to those next
// to it. Gradients and steps are in pixels of what a superpoint moves. One superpoint per thread: it alone changes its keys.
// Nothing changes when the forward pass failed, nor where the image shows nothing of a superpoint.
#version 460
#extension GL_GOOGLE_include_directive : require

layout(local_size_x = 256) in;
layout(constant_id = 0) const uint SUBGROUP_SIZE = 32u;

#define STEP_BINDING 0
#include "lib/step.glsl"
#define STATUS_BINDING 6
#include "lib/status.glsl"
#include "lib/limits.glsl"
#include "lib/dispatch.glsl"
#include "lib/key_pose.glsl"
#include "lib/left_jacobian.glsl"

layout(std430, set = 0, binding = 1) readonly buffer CountersBlock { uint counters[]; };
layout(std430, set = 0, binding = 2) readonly buffer PoseSumBlock { float pose_sum[]; };            // [22][M]
layout(std430, set = 0, binding = 3) readonly buffer KeySuperpointBlock { float key_superpoint[]; }; // [5][M]
layout(std430, set = 0, binding = 4) readonly buffer KeyTwinBlock { uint key_twin[]; };             // [T]
layout(std430, set = 0, binding = 5) buffer KeyBlock { float key[]; };

layout(push_constant) uniform PushBlock {
    uint keys;    // T
    float hold;   // weights of the terms that hold a key
    float smoothness;
} push;

const float BETA_1 = 0.9;
const float BETA_2 = 0.98; // a key is seen in few of the steps
const float EPSILON = 1e-12;
const float LARGEST_TURN = 0.05; // in one step, radians
const uint NO_TWIN = 0xffffffffu;
const uint POSE_SUM_ROTATION = 13u;
const uint POSE_SUM_TRANSLATION = 16u;

// Of a key: turn, shift.
struct Six {
    vec3 turn;
    vec3 shift;
};

uint word_at(uint at, uint word, uint j) {
    return (at * KEY_WORDS + word) * step_data.superpoints + j;
}

vec3 key_words(uint at, uint word, uint j) {
    uint m = step_data.superpoints;
    uint i = word_at(at, word, j);
    return vec3(key[i], key[i + m], key[i + 2u * m]);
}

void set_key_words(uint at, uint word, uint j, vec3 value) {
    uint m = step_data.superpoints;
    uint i = word_at(at, word, j);
    key[i] = value.x;
    key[i + m] = value.y;
    key[i + 2u * m] = value.z;
}

vec3 pose_sums(uint plane, uint j) {
    uint m = step_data.superpoints;
    return vec3(pose_sum[plane * m + j], pose_sum[(plane + 1u) * m + j], pose_sum[(plane + 2u) * m + j]);
}

// From dL/d(left tangent, tau) at the time between keys, where the vector is r.
Six key_gradient(uint at, uint j, float weight, vec3 r, Six by_pose, vec3 center, vec2 scale) {
    vec3 own = key_words(at, KEY_ROTATION, j);
    vec3 arm = center + quaternion_displacement(quaternion_exp(own), center);
    vec3 turn = left_jacobian_transposed(r, by_pose.turn) + left_jacobian_transposed(own, cross(by_pose.shift, arm));
    return Six(turn * (weight * scale.x), by_pose.shift * (weight * scale.y));
}

// How far a key has gone, pixels.
Six way(uint at, uint j, vec2 scale) {
    return Six((key_words(at, KEY_ROTATION, j) - key_words(at, KEY_FIRST_ROTATION, j)) / scale.x,
               (key_words(at, KEY_PLACE, j) - key_words(at, KEY_FIRST_PLACE, j)) / scale.y);
}

Six with_terms(uint at, uint j, vec2 scale, Six gradient) {
    float fade = step_data.key_fade;
    Six own = way(at, j, scale);
    vec3 turn = gradient.turn + fade * push.hold * own.turn;
    vec3 shift = gradient.shift + fade * push.hold * own.shift;
    if (at > 0u) {
        Six next = way(at - 1u, j, scale);
        turn += fade * push.smoothness * (own.turn - next.turn);
        shift += fade * push.smoothness * (own.shift - next.shift);
    }
    if (at + 1u < push.keys) {
        Six next = way(at + 1u, j, scale);
        turn += fade * push.smoothness * (own.turn - next.turn);
        shift += fade * push.smoothness * (own.shift - next.shift);
    }
    return Six(turn, shift);
}

// Adam's step of one part, and its moments; by the gradient's direction.
vec3 adam(uint at, uint j, uint part, vec3 gradient, vec2 decay, float scale) {
    vec3 moment_1 = BETA_1 * key_words(at, KEY_MOMENT_1 + 3u * part, j) + (1.0 - BETA_1) * gradient;
    uint second = word_at(at, KEY_MOMENT_2 + part, j);
    float moment_2 = BETA_2 * key[second] + (1.0 - BETA_2) * dot(gradient, gradient);
    set_key_words(at, KEY_MOMENT_1 + 3u * part, j, moment_1);
    key[second] = moment_2;
    float size = sqrt(moment_2 / (1.0 - decay.y)) + EPSILON;
    return moment_1 * (-step_data.rate_key * scale / ((1.0 - decay.x) * size));
}

void update_key(uint at, uint j, Six gradient, vec2 scale) {
    uint twin = key_twin[at];
    // A vector that begins anew between two keys of one time stays, so that both say the same turn.
    bool anew = twin != NO_TWIN && key_words(twin, KEY_ROTATION, j) != key_words(at, KEY_ROTATION, j);
    if (!anew) {
        uint power = word_at(at, KEY_DECAY, j);
        vec2 decay = vec2(key[power] * BETA_1, key[power + step_data.superpoints] * BETA_2);
        vec3 turn = adam(at, j, 0u, gradient.turn, decay, scale.x);
        vec3 shift = adam(at, j, 1u, gradient.shift, decay, scale.y);
        turn *= min(1.0, LARGEST_TURN / max(length(turn), 1e-30));
        set_key_words(at, KEY_ROTATION, j, key_words(at, KEY_ROTATION, j) + turn);
        set_key_words(at, KEY_PLACE, j, key_words(at, KEY_PLACE, j) + shift);
        key[power] = decay.x;
        key[power + step_data.superpoints] = decay.y;
        if (twin != NO_TWIN) {
            for (uint word = 0u; word < KEY_WORDS; word++) {
                key[word_at(twin, word, j)] = key[word_at(at, word, j)];
            }
        }
    }
}

void main() {
    uint j = workgroup_index() * 256u + gl_LocalInvocationIndex;
    uint m = step_data.superpoints;
    bool failed = counters[COUNT_FAILED] != 0u;
    if (j < m && !failed) {
        float pixels = step_data.pixels;
        Six by_pose = Six(pixels * pose_sums(POSE_SUM_ROTATION, j), pixels * pose_sums(POSE_SUM_TRANSLATION, j));
        vec3 center = vec3(key_superpoint[j], key_superpoint[m + j], key_superpoint[2u * m + j]);
        vec2 scale = vec2(key_superpoint[3u * m + j], key_superpoint[4u * m + j]);
        float total = dot(abs(by_pose.turn) + abs(by_pose.shift), vec3(1.0));
        if (!number_is_finite(total)) {
            report_not_finite(STATUS_POSE, j);
        } else if (total > 0.0 && scale.y > 0.0) {
            uint first = step_data.key_first;
            uint second = step_data.key_second;
            bool between = first != second;
            float weight = between ? step_data.key_weight : 0.0;
            vec3 r = (1.0 - weight) * key_words(first, KEY_ROTATION, j) + weight * key_words(second, KEY_ROTATION, j);
            // Both gradients come before either key moves.
            Six by_first = with_terms(first, j, scale, key_gradient(first, j, 1.0 - weight, r, by_pose, center, scale));
            Six by_second = with_terms(second, j, scale, key_gradient(second, j, weight, r, by_pose, center, scale));
            update_key(first, j, by_first, scale);
            if (between) {
                update_key(second, j, by_second, scale);
            }
        }
    }
}
