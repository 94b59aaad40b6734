// max(y, 0) of a network's layer, NaN stays NaN: GLSL's max may give either operand then, and a broken weight would look like
// a neuron that is off. Rust twin: `relu` in engine/src/scene/network.rs.
#ifndef SPGS_RELU
#define SPGS_RELU

// By bits, since a compiler may assume that comparisons never see NaN: numbers from -0 down to -infinity are, as integers,
// those up to 0xff800000.
float relu(float y) {
    return floatBitsToInt(y) <= int(0xff800000u) ? 0.0 : y;
}

vec4 relu(vec4 y) {
    return mix(y, vec4(0.0), lessThanEqual(floatBitsToInt(y), ivec4(int(0xff800000u))));
}

#endif
