// How a Gaussian's superpoints move it. The includer has lib/frame.glsl, lib/quaternion.glsl, the buffers
// `superpoint_of_gaussian`, `pose`, `blend_index` and `blend_weight` and the constant BLEND: 0 when each Gaussian moves with one superpoint, else K,
// 2 to 4, of soft superpoints. Rust twin: engine/src/render/superpoint_motion.rs.
//
// blend_index uint[ceil(K / 2)][N]: two u16 superpoints per word. blend_weight float[K - 1][N]: all weights but the last, which
// is what they leave of 1.
#ifndef SPGS_SUPERPOINT_MOTION
#define SPGS_SUPERPOINT_MOTION

const float MAX_ABS_POSE = 1e15;

// As `within` of lib/projection.glsl.
bool pose_within(vec3 v) {
    return all(lessThanEqual(floatBitsToUint(v) & 0x7fffffffu, uvec3(floatBitsToUint(MAX_ABS_POSE))));
}

// Pose of a superpoint at the frame's time: r and tau interpolated between two keys; false when it is unusable.
bool read_pose(uint superpoint, out vec4 turn, out vec3 translation) {
    turn = vec4(1.0, 0.0, 0.0, 0.0);
    translation = vec3(0.0);
    bool usable = superpoint < frame.superpoints;
    if (usable) {
        uint first = 2u * (frame.first_key * frame.superpoints + superpoint);
        uint second = 2u * (frame.second_key * frame.superpoints + superpoint);
        float weight = frame.key_weight;
        vec3 r = pose[first].xyz * (1.0 - weight) + pose[second].xyz * weight;
        translation = pose[first + 1u].xyz * (1.0 - weight) + pose[second + 1u].xyz * weight;
        usable = pose_within(r) && pose_within(translation);
        if (usable) {
            turn = quaternion_exp(r);
        }
    }
    return usable;
}

uint blend_superpoint(uint g, uint n, uint slot) {
    return (blend_index[(slot / 2u) * n + g] >> (16u * (slot & 1u))) & 0xffffu;
}

vec4 blend_weights(uint g, uint n) {
    uint slots = BLEND;
    vec4 weight = vec4(0.0);
    float rest = 1.0;
    for (uint slot = 0u; slot + 1u < slots; slot++) {
        weight[slot] = blend_weight[slot * n + g];
        rest -= weight[slot];
    }
    weight[slots - 1u] = max(rest, 0.0);
    return weight;
}

// Weights count as equal within this: the last one is rounded apart from the others.
const float EQUAL_WEIGHTS = 1e-6;

// The slot with the largest weight, the first of equals.
uint heaviest_slot(vec4 weight) {
    uint heaviest = 0u;
    float most = weight.x;
    for (uint slot = 1u; slot < 4u; slot++) {
        bool heavier = weight[slot] > most + EQUAL_WEIGHTS;
        heaviest = heavier ? slot : heaviest;
        most = heavier ? weight[slot] : most;
    }
    return heaviest;
}

// A weight with the sign that brings rotation `turn` to the side of the heaviest slot's.
float signed_weight(float weight, vec4 turn, vec4 heaviest) {
    return dot(turn, heaviest) < 0.0 ? -weight : weight;
}

// Sum of weighted, sign-aligned rotations (not normalised) and weighted displacement of x by a Gaussian's soft superpoints.
bool blend_motion(uint g, uint n, vec3 x, vec4 weight, out vec4 sum, out vec3 displacement) {
    uint slots = BLEND;
    sum = vec4(0.0);
    displacement = vec3(0.0);
    vec4 heaviest;
    vec3 translation;
    bool usable = read_pose(blend_superpoint(g, n, heaviest_slot(weight)), heaviest, translation);
    for (uint slot = 0u; slot < slots; slot++) {
        vec4 turn;
        usable = read_pose(blend_superpoint(g, n, slot), turn, translation) && usable;
        sum += signed_weight(weight[slot], turn, heaviest) * turn;
        displacement += weight[slot] * (quaternion_displacement(turn, x) + translation);
    }
    return usable;
}

// Displacement of x and rotation `turn` by the superpoints of Gaussian g; false, and neither, when a pose is unusable.
bool superpoint_motion(uint g, uint n, vec3 x, out vec3 displacement, out vec4 turn) {
    uint slots = BLEND;
    bool usable;
    if (slots == 0u) {
        vec3 translation;
        usable = read_pose(superpoint_of_gaussian[g], turn, translation);
        displacement = usable ? quaternion_displacement(turn, x) + translation : vec3(0.0);
    } else {
        vec4 sum;
        usable = blend_motion(g, n, x, blend_weights(g, n), sum, displacement);
        // The heaviest weight is at least 1 / K and nothing points away from it.
        turn = usable ? sum / sqrt(dot(sum, sum)) : vec4(1.0, 0.0, 0.0, 0.0);
        displacement = usable ? displacement : vec3(0.0);
    }
    return usable;
}

#endif
