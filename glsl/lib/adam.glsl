// One step of Adam (Kingma and Ba 2015) on one value. Rust twin: `update` in engine/src/train/adam.rs, line by line.
// Include lib/step.glsl first.
#ifndef SPGS_ADAM
#define SPGS_ADAM

// moments: first and second; bias: 1/(1 - beta_1^t), 1/sqrt(1 - beta_2^t). Returns the new value, updates the moments.
float adam_update(float value, float gradient, inout vec2 moments, float rate, vec2 bias) {
    vec4 a = step_data.adam;
    moments.x = a.x * moments.x + (1.0 - a.x) * gradient;
    moments.y = a.y * moments.y + (1.0 - a.y) * gradient * gradient;
    return value - rate * (moments.x * bias.x) / (sqrt(moments.y) * bias.y + a.z);
}

#endif
