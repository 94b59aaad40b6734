// Where a Gaussian's superpoints take its centre, as deform_project does. The includer has lib/frame.glsl,
// lib/quaternion.glsl, the buffers `mean`, `superpoint_of_gaussian`, `pose`, `blend_index` and `blend_weight` and the constants MOTION
// (0: the centre itself) and BLEND. Rust twin: `moved_centre` in engine/src/render/nonrigid_network.rs.
#ifndef SPGS_MOVED_CENTRE
#define SPGS_MOVED_CENTRE

#include "superpoint_motion.glsl"

// Zero where deform_project rejects the Gaussian.
vec3 moved_centre(uint g) {
    uint motion = MOTION;
    uint n = frame.gaussians;
    vec3 centre = vec3(mean[g], mean[n + g], mean[2u * n + g]);
    bool usable = pose_within(centre);
    if (motion == 1u && usable) {
        vec3 displacement;
        vec4 turn;
        usable = superpoint_motion(g, n, centre, displacement, turn);
        centre += displacement;
    }
    return usable ? centre : vec3(0.0);
}

#endif
