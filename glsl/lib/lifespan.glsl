// When a Gaussian is seen: the share of its opacity is exp(-x^2 / 2), x = (time - middle) / length (the temporal opacity of
// Spacetime Gaussians, Li et al. 2024). Rust: lifespan_share in engine/src/scene/parameter.rs.
#ifndef SPGS_LIFESPAN
#define SPGS_LIFESPAN

const float HALF_LOG2_E = 0.7213475204444817;

// x of a middle and the log of a length.
float lifespan_place(float time, float middle, float log_length) {
    return (time - middle) * exp(-log_length);
}

#endif
