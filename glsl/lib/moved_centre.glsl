// Where a Gaussian's superpoint takes its centre: Exp(r) mean + tau, (r, tau) interpolated between the frame's two keys as
// deform_project does. The includer has lib/frame.glsl, lib/quaternion.glsl, the buffers `mean`, `superpoint_of_gaussian` and
// `pose` and the constant MOTION (0: the centre itself). Rust twin: `moved_centre` in engine/src/render/nonrigid_network.rs.
#ifndef SPGS_MOVED_CENTRE
#define SPGS_MOVED_CENTRE

const float MAX_ABS_CENTRE = 1e15; // as deform_project, which refuses what is beyond

bool centre_within(vec3 v) {
    uvec3 bits = floatBitsToUint(v) & 0x7f800000u;
    return bits.x != 0x7f800000u && bits.y != 0x7f800000u && bits.z != 0x7f800000u && abs(v.x) <= MAX_ABS_CENTRE
        && abs(v.y) <= MAX_ABS_CENTRE && abs(v.z) <= MAX_ABS_CENTRE;
}

// Zero where deform_project refuses the Gaussian.
vec3 moved_centre(uint g) {
    uint motion = MOTION;
    uint n = frame.gaussians;
    uint superpoint = motion == 1u ? superpoint_of_gaussian[g] : 0u;
    vec3 centre = vec3(mean[g], mean[n + g], mean[2u * n + g]);
    bool usable = centre_within(centre) && (motion == 0u || superpoint < frame.superpoints);
    if (motion == 1u && usable) {
        uint first = 2u * (frame.first_key * frame.superpoints + superpoint);
        uint second = 2u * (frame.second_key * frame.superpoints + superpoint);
        float weight = frame.key_weight;
        vec3 r = pose[first].xyz * (1.0 - weight) + pose[second].xyz * weight;
        vec3 translation = pose[first + 1u].xyz * (1.0 - weight) + pose[second + 1u].xyz * weight;
        usable = centre_within(r) && centre_within(translation);
        centre += quaternion_displacement(quaternion_exp(r), centre) + translation;
    }
    return usable ? centre : vec3(0.0);
}

#endif
