// What kernels of the image loss read: rendered image, target and background. Include lib/frame.glsl and
// lib/step.glsl first and define COLOR_BINDING and TARGET_BINDING. Rust twin: engine/src/train/image_loss/pixels.rs.
#ifndef SPGS_IMAGE_TARGET
#define SPGS_IMAGE_TARGET

layout(std430, set = 0, binding = COLOR_BINDING) readonly buffer ColorBlock { float color[]; };
layout(std430, set = 0, binding = TARGET_BINDING) readonly buffer TargetBlock { uint target[]; };

// Copies of the frame's and the workgroup's values, set once by read_frame: a device may read storage again at every use.
uvec2 image_size;
float background;
uint first_word; // of the target

void read_frame(uint channel) {
    image_size = frame.size;
    background = frame.background[channel];
    first_word = step_data.photo;
}

// Beyond it a value counts as not finite: its fourth power must stay a number.
const float MAX_COLOR = 1.0e6;

// By bits, so that NaN fails too.
bool usable(float x) {
    return (floatBitsToUint(x) & 0x7fffffffu) <= floatBitsToUint(MAX_COLOR);
}

// Target value of a channel; kind 0: premultiplied RGBA8 over the background, 1: float bits, four words per pixel.
float target_value(uint kind, uint pixel, uint channel) {
    if (kind == 1u) {
        return uintBitsToFloat(target[first_word + 4u * pixel + channel]);
    }
    uint word = target[first_word + pixel];
    float premultiplied = float((word >> (8u * channel)) & 255u);
    float rest = float(255u - (word >> 24u));
    return (premultiplied + rest * background) / 255.0;
}

// (rendered, target, 1) of a channel. Where either cannot be used both are the same, so that the pixel takes no part, and
// the last component is 0.
vec3 image_and_target(uint kind, uint pixel, uint channel) {
    float x = color[4u * pixel + channel];
    float y = target_value(kind, pixel, channel);
    bool good = usable(y);
    y = good ? y : 0.0;
    good = good && usable(x);
    return vec3(good ? x : y, y, good ? 1.0 : 0.0);
}

#endif
