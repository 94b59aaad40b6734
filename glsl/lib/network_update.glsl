// Adam on four weights of a network, not applied where a number is not finite. Include lib/step.glsl, lib/adam.glsl and
// lib/status.glsl first; the includer has the buffers of vec4 `parameter`, `moment_1` and `moment_2` and the constant NETWORK
// (0 network F, 1 network G). Returns the new weights. Rust twin: `update_weight` in engine/src/train/linear/linear_update.rs.
#ifndef SPGS_NETWORK_UPDATE
#define SPGS_NETWORK_UPDATE

// Learning rate, bias corrections and Adam's constants of this network.
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

// at: of the first weight in the three buffers; count: how many of the four are weights; index: the first one's number in the
// network, for reports.
vec4 update_four(NetworkAdam with, uint at, uint count, uint index, vec4 gradient) {
    uint network = NETWORK;
    vec4 values = parameter[at / 4u];
    vec4 first = moment_1[at / 4u];
    vec4 second = moment_2[at / 4u];
    [[unroll]] for (uint c = 0u; c < 4u; c++) {
        vec2 moments = vec2(first[c], second[c]);
        float value = adam_step(with.adam, values[c], gradient[c], moments, with.rate, with.bias);
        bool finite = number_is_finite(gradient[c]) && number_is_finite(value) && number_is_finite(moments.x)
            && number_is_finite(moments.y);
        if (c < count && finite) {
            values[c] = value;
            first[c] = moments.x;
            second[c] = moments.y;
        } else if (c < count) {
            report_not_finite(network == 0u ? STATUS_NETWORK_F : STATUS_NETWORK_G, index + c);
        }
    }
    parameter[at / 4u] = values;
    moment_1[at / 4u] = first;
    moment_2[at / 4u] = second;
    return values;
}

#endif
