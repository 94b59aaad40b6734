// Counter-based random numbers: a value depends on (seed, stream, index, draw) only. Rust mirror, with the same integers:
// engine/src/train/rng.rs.
#ifndef SPGS_RANDOM
#define SPGS_RANDOM

#include "angle.glsl"

// The four-word hash of Jarzynski and Olano, "Hash Functions for GPU Rendering" (JCGT 2020): a linear congruential step per
// word, then two rounds in which every word is mixed into the others.
uvec4 random_hash(uvec4 v) {
    v = v * 1664525u + 1013904223u;
    for (uint round = 0u; round < 2u; round++) {
        v.x += v.y * v.w;
        v.y += v.z * v.x;
        v.z += v.x * v.y;
        v.w += v.y * v.z;
        if (round == 0u) {
            v ^= v >> 16u;
        }
    }
    return v;
}

// 128 random bits.
uvec4 random_words(uvec2 seed, uint stream, uvec2 index, uint draw) {
    uvec4 key = random_hash(uvec4(seed, stream, 0u));
    return random_hash(key ^ uvec4(index, draw, 0u));
}

// Uniform in [0, 1), multiples of 2^-24.
float random_uniform(uint word) {
    return float(word >> 8u) * (1.0 / 16777216.0);
}

// Two standard normals from two words (Box and Muller).
vec2 random_normals(uint a, uint b) {
    float radius = sqrt(-2.0 * log(1.0 - random_uniform(a)));
    return radius * sin_cos(6.2831853 * random_uniform(b)).yx;
}

#endif
