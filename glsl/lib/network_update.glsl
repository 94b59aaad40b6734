// Adam on one weight of a network, not applied where a number is not finite. Include lib/step.glsl, lib/adam.glsl and
// lib/status.glsl first; the includer has the buffers `parameter`, `moment_1` and `moment_2` and the constant NETWORK
// (0 network F, 1 network G). Rust twin: `update_weight` in engine/src/train/linear/linear_update.rs.
#ifndef SPGS_NETWORK_UPDATE
#define SPGS_NETWORK_UPDATE

// Learning rate, bias corrections and Adam's constants of this network, loaded once per thread.
struct NetworkAdam {
    float rate;
    vec2 bias;
    Adam adam;
};

NetworkAdam network_adam() {
    uint network = NETWORK;
    float rate = network == 0u ? step_data.rate_network_f : step_data.rate_network_g;
    vec2 bias = network == 0u ? step_data.bias_network_f : step_data.bias_network_g;
    return NetworkAdam(rate, bias, adam_of_step());
}

// at: of the weight in the three buffers; index: its number in the network, for reports.
void update_weight(NetworkAdam with, uint at, uint index, float gradient) {
    uint network = NETWORK;
    vec2 moments = vec2(moment_1[at], moment_2[at]);
    float value = adam_step(with.adam, parameter[at], gradient, moments, with.rate, with.bias);
    bool finite = number_is_finite(gradient) && number_is_finite(value) && number_is_finite(moments.x)
        && number_is_finite(moments.y);
    if (finite) {
        parameter[at] = value;
        moment_1[at] = moments.x;
        moment_2[at] = moments.y;
    } else {
        report_not_finite(network == 0u ? STATUS_NETWORK_F : STATUS_NETWORK_G, index);
    }
}

#endif
