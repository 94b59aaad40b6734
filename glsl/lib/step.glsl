// What a training step is: counts, learning rates, Adam's corrections, loss weights; written by the host once per step. The
// Rust mirror is engine/src/train/step.rs (offsets are checked against the SPIR-V). Define STEP_BINDING before including.
#ifndef SPGS_STEP
#define SPGS_STEP

struct Step {
    uvec4 counts;   // gaussians, superpoints, neighbours per Gaussian (slots of the association), iteration
    vec4 rate_0;    // learning rates: mean, log_scale, rotation, opacity_logit
    vec4 rate_1;    // learning rates: sh_0, sh_1..3, network F, association logits
    vec4 rate_2;    // learning rates: network G; y, z, w = 0
    vec4 adam;      // beta_1, beta_2, epsilon, 0
    vec4 bias_0;    // 1/(1 - beta_1^t), 1/sqrt(1 - beta_2^t): Gaussians in xy, network F in zw
    vec4 bias_1;    // the same: association in xy, network G in zw
    vec4 weights;   // lambda of D-SSIM, of the property losses: position, rotation, translation
    vec4 time;      // time (with noise) given to the networks, exact time, statistics on (1) or off (0), 0
};

layout(std430, set = 0, binding = STEP_BINDING) readonly buffer StepBlock { Step step_data; };

#endif
