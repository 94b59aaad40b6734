// Superpoints' properties as weighted means over Gaussians (paper's form): Σ a v / Σ a from the planes of superpoint_sum.
// Include lib/step.glsl first, after the buffer property_sum is declared.
#ifndef SPGS_PROPERTY_MEAN
#define SPGS_PROPERTY_MEAN

vec3 property_plane(uint plane, uint j) {
    uint m = step_data.superpoints;
    return vec3(property_sum[plane * m + j], property_sum[(plane + 1u) * m + j], property_sum[(plane + 2u) * m + j]);
}

// 1 / Σ a; 0 for a superpoint that is nobody's neighbour.
float inverse_weight(uint j) {
    float total = property_sum[j];
    return total > 0.0 ? 1.0 / total : 0.0;
}

void mean_properties(uint j, out vec3 position, out vec3 rotation, out vec3 translation) {
    float inverse = inverse_weight(j);
    position = inverse * property_plane(4u, j);
    rotation = inverse * property_plane(7u, j);
    translation = inverse * property_plane(10u, j);
}

#endif
