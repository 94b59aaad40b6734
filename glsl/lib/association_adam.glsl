// Adam on one logit. Include lib/step.glsl, lib/adam.glsl and lib/status.glsl first, after the buffers logit,
// logit_moment_1 and logit_moment_2 are declared. Rust twin: `update_logit` in engine/src/train/property_loss.rs.
#ifndef SPGS_ASSOCIATION_ADAM
#define SPGS_ASSOCIATION_ADAM

// at: slot of the association; gaussian: for the report when something is not finite, and then nothing changes.
void update_logit(uint at, float gradient, uint gaussian) {
    vec2 moments = vec2(logit_moment_1[at], logit_moment_2[at]);
    float value = adam_update(logit[at], gradient, moments, step_data.rate_association, step_data.bias_association);
    if (number_is_finite(value) && number_is_finite(moments.x) && number_is_finite(moments.y)) {
        logit[at] = value;
        logit_moment_1[at] = moments.x;
        logit_moment_2[at] = moments.y;
    } else {
        report_not_finite(STATUS_ASSOCIATION, gaussian);
    }
}

#endif
