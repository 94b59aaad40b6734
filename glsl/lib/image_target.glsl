// What kernels of the image loss read: rendered image, target and background. Include lib/frame.glsl first and define
// COLOR_BINDING and TARGET_BINDING. Rust twin: engine/src/train/image_loss/pixels.rs.
#ifndef SPGS_IMAGE_TARGET
#define SPGS_IMAGE_TARGET

layout(std430, set = 0, binding = COLOR_BINDING) readonly buffer ColorBlock { float color[]; };
layout(std430, set = 0, binding = TARGET_BINDING) readonly buffer TargetBlock { uint target[]; };

// Beyond it a value counts as not finite: its fourth power must stay a number.
const float MAX_COLOR = 1.0e6;

// By bits, so that NaN fails too.
bool usable(float x) {
    return (floatBitsToUint(x) & 0x7fffffffu) <= floatBitsToUint(MAX_COLOR);
}

// Target value of a channel; kind 0: premultiplied RGBA8 over the background, 1: float bits, four words per pixel.
float target_value(uint kind, uint pixel, uint channel) {
    if (kind == 1u) {
        return uintBitsToFloat(target[4u * pixel + channel]);
    }
    uint word = target[pixel];
    float premultiplied = float((word >> (8u * channel)) & 255u);
    float rest = float(255u - (word >> 24u));
    return (premultiplied + rest * frame.background[channel]) / 255.0;
}

// (rendered, target) of a channel. Where either cannot be used both are the same, so that the pixel takes no part.
vec2 image_and_target(uint kind, uint pixel, uint channel) {
    float x = color[4u * pixel + channel];
    float y = target_value(kind, pixel, channel);
    bool good = usable(y);
    y = good ? y : 0.0;
    return vec2(good && usable(x) ? x : y, y);
}

#endif
