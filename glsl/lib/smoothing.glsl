// Gaussians blurred in space, by a standard deviation sigma of their own: the 3-D filter of Mip-Splatting (Yu et al. 2024). The
// integral stays. Rust: smoothed in engine/src/scene/parameter.rs.
#ifndef SPGS_SMOOTHING
#define SPGS_SMOOTHING

const float ROOT_FILTER_VARIANCE = 0.4472135955; // (0.2)^(1/2), px of the photo that shows a Gaussian largest

// Standard deviations of the blurred Gaussian. `share`: squares of the old over those of the new.
vec3 smoothed(vec3 scale, float sigma, out vec3 share) {
    vec3 wide = sqrt(scale * scale + sigma * sigma);
    vec3 ratio = scale / wide;
    share = ratio * ratio;
    return wide;
}

#endif
