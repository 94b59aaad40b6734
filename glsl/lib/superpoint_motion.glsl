// How a Gaussian's superpoints move it. The includer has lib/frame.glsl, lib/quaternion.glsl, the buffers
// `superpoint_of_gaussian`, `pose` and `blend` and the constant BLEND: 0 when each Gaussian moves with one superpoint, else K,
// 2 to 4, of soft superpoints. Rust twin: engine/src/render/superpoint_motion.rs.
//
// `blend` holds planes of words: ceil(K / 2) with two u16 superpoints each, then ceil(K / 2) with two unorm16 weights each;
// the levels of a Gaussian's weights add up to 65535.
#ifndef SPGS_SUPERPOINT_MOTION
#define SPGS_SUPERPOINT_MOTION

const float MAX_ABS_POSE = 1e15;

bool pose_within(vec3 v) {
    uvec3 bits = floatBitsToUint(v) & 0x7f800000u;
    return bits.x != 0x7f800000u && bits.y != 0x7f800000u && bits.z != 0x7f800000u && abs(v.x) <= MAX_ABS_POSE
        && abs(v.y) <= MAX_ABS_POSE && abs(v.z) <= MAX_ABS_POSE;
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
    return (blend[(slot / 2u) * n + g] >> (16u * (slot & 1u))) & 0xffffu;
}

float blend_weight(uint g, uint n, uint slot) {
    uint slots = BLEND;
    uint planes = (slots + 1u) / 2u;
    return float((blend[(planes + slot / 2u) * n + g] >> (16u * (slot & 1u))) & 0xffffu) / 65535.0;
}

// The slot with the largest weight, the first of equals.
uint heaviest_slot(uint g, uint n) {
    uint slots = BLEND;
    uint heaviest = 0u;
    float most = blend_weight(g, n, 0u);
    for (uint slot = 1u; slot < slots; slot++) {
        float weight = blend_weight(g, n, slot);
        heaviest = weight > most ? slot : heaviest;
        most = max(weight, most);
    }
    return heaviest;
}

// Weight with the sign that brings rotation `turn` to the side of the heaviest slot's.
float signed_weight(float weight, vec4 turn, vec4 heaviest) {
    return dot(turn, heaviest) < 0.0 ? -weight : weight;
}

// Sum of weighted, sign-aligned rotations (not normalised) and weighted displacement of x by a Gaussian's soft superpoints.
bool blend_motion(uint g, uint n, vec3 x, out vec4 sum, out vec3 displacement) {
    uint slots = BLEND;
    sum = vec4(0.0);
    displacement = vec3(0.0);
    vec4 heaviest;
    vec3 translation;
    bool usable = read_pose(blend_superpoint(g, n, heaviest_slot(g, n)), heaviest, translation);
    for (uint slot = 0u; slot < slots; slot++) {
        vec4 turn;
        usable = read_pose(blend_superpoint(g, n, slot), turn, translation) && usable;
        float weight = blend_weight(g, n, slot);
        sum += signed_weight(weight, turn, heaviest) * turn;
        displacement += weight * (quaternion_displacement(turn, x) + translation);
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
        usable = blend_motion(g, n, x, sum, displacement);
        // The heaviest weight is at least 1 / K and nothing points away from it.
        turn = usable ? sum / sqrt(dot(sum, sum)) : vec4(1.0, 0.0, 0.0, 0.0);
        displacement = usable ? displacement : vec3(0.0);
    }
    return usable;
}

#endif
