// Shapes of network F's layers and where their weights are in training. Rust twin: `Layers` in
// engine/src/train/network_f/layers.rs. Include after the declarations of LAYERS, WIDTH and SKIP_LAYER.
#ifndef SPGS_NETWORK_LAYERS
#define SPGS_NETWORK_LAYERS

const uint ENCODED = 76u;
const uint HEADS = 8u; // outputs of the last layer, r, 0, tau, 0

bool is_hidden(uint layer) {
    uint layers = LAYERS;
    return layer < layers;
}

uint layer_inputs(uint layer) {
    uint width = WIDTH;
    uint skip_layer = SKIP_LAYER;
    return layer == 0u ? ENCODED : layer == skip_layer ? ENCODED + width : width;
}

uint layer_outputs(uint layer) {
    uint width = WIDTH;
    return is_hidden(layer) ? width : HEADS;
}

// Floats of a layer: weights [outputs, inputs], bias, and what is missing to a multiple of 64.
uint layer_floats(uint layer) {
    return (layer_outputs(layer) * (layer_inputs(layer) + 1u) + 63u) / 64u * 64u;
}

#endif
