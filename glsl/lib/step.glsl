// What a training step is: counts, learning rates, Adam's corrections, loss weights; written by the host once per step. The
// Rust mirror is engine/src/train/step.rs (offsets are checked against the SPIR-V). Define STEP_BINDING before including.
#ifndef SPGS_STEP
#define SPGS_STEP

#include "lib/parameters.glsl"

// Learning rates are those of one step; bias: 1/(1 - beta_1^t), 1/sqrt(1 - beta_2^t).
struct Step {
    vec2 bias_gaussians;
    vec2 bias_network_f;
    vec2 bias_association;
    vec2 bias_network_g;
    uint gaussians;
    uint superpoints;
    uint neighbors;           // of a Gaussian: slots of the association
    uint iteration;
    float rate_network_f;
    float rate_association;
    float rate_network_g;
    float weight_dssim;       // lambda of the loss
    float weight_position;    // of the property losses
    float weight_rotation;
    float weight_translation;
    float time;               // given to the networks, with noise
    float exact_time;
    float density_statistics; // 0: not kept, 1: of gradients, 2: of absolute gradients
    float beta_1;             // Adam's constants
    float beta_2;
    float epsilon;
    uint photo;               // word of the photos' buffer where this step's begins
    float rate[(PARAMETERS + 1u) / 2u * 2u]; // of PARAMETER_*
    uint key_first;           // key poses that the image's time lies between
    uint key_second;
    float key_weight;         // of the second
    float rate_key;           // pixels of a step of key poses
    float key_fade;           // of the terms that hold them
    float pixels;             // of the image
    uint exposure;            // number of the photo
    float rate_exposure;
};

layout(std430, set = 0, binding = STEP_BINDING) readonly buffer StepBlock { Step step_data; };

#endif
