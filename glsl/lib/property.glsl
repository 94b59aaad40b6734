// Properties that the property losses reconstruct, and plane access. Include lib/quaternion.glsl first, after the buffers
// mean (float[3][N]), superpoint_of_gaussian and pose are declared, and lib/step.glsl is included.
#ifndef SPGS_PROPERTY
#define SPGS_PROPERTY

vec3 canonical_mean(uint i) {
    uint n = step_data.gaussians;
    return vec3(mean[i], mean[n + i], mean[2u * n + i]);
}

// The superpoint Gaussian i moves with, kept in range.
uint own_superpoint(uint i) {
    return min(superpoint_of_gaussian[i], step_data.superpoints - 1u);
}

// Position at the step's time, so(3) vector and translation of a point `x` that moves with superpoint j. `turned` is
// Exp(r) x.
void moved_properties(uint j, vec3 x, out vec3 turned, out vec3 position, out vec3 rotation, out vec3 translation) {
    rotation = pose[2u * j].xyz;
    translation = pose[2u * j + 1u].xyz;
    turned = x + quaternion_displacement(quaternion_exp(rotation), x);
    position = turned + translation;
}

#endif
