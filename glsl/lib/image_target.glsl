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

// Word of the target with a channel; kind 0 and 2: premultiplied RGBA8 over the background, 1: float bits, four words per pixel.
uint target_word(uint kind, uint pixel, uint channel) {
    return target[first_word + (kind == 1u ? 4u * pixel + channel : pixel)];
}

float target_value(uint kind, uint word, uint channel) {
    if (kind == 1u) {
        return uintBitsToFloat(word);
    }
    float premultiplied = float((word >> (8u * channel)) & 255u);
    float rest = float(255u - (word >> 24u));
    return (premultiplied + rest * background) / 255.0;
}

// What a pixel is for the loss, the last component of image_and_target.
const float UNUSABLE = 0.0;
const float TAKES_PART = 1.0;
const float MASKED = 2.0;

// A colour without opacity, which no photo has: its mask leaves this pixel out. Of kind 2 alone.
const uint LEFT_OUT = 0x00ffffffu;

// (rendered, target, what it is) of a channel. Where either cannot be used, and where a mask leaves the pixel out, both are the
// same, so that it takes no part.
vec3 image_and_target(uint kind, uint pixel, uint channel) {
    float x = color[4u * pixel + channel];
    uint word = target_word(kind, pixel, channel);
    float y = target_value(kind, word, channel);
    bool masked = kind == 2u && word == LEFT_OUT;
    bool good = usable(x) && usable(y);
    y = usable(y) ? y : 0.0;
    y = masked ? (good ? x : 0.0) : y;
    return vec3(good ? x : y, y, !good ? UNUSABLE : (masked ? MASKED : TAKES_PART));
}

#endif
