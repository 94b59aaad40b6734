// One step of Adam (Kingma and Ba 2015) on one value. Rust twin: `update` in engine/src/train/adam.rs, line by line.
// Include lib/step.glsl first.
#ifndef SPGS_ADAM
#define SPGS_ADAM

struct Adam {
    float beta_1;
    float beta_2;
    float epsilon;
};

Adam adam_of_step() {
    return Adam(step_data.beta_1, step_data.beta_2, step_data.epsilon);
}

// `adam_update` for kernels with many values, which load the constants once.
float adam_step(Adam adam, float value, float gradient, inout vec2 moments, float rate, vec2 bias) {
    moments.x = adam.beta_1 * moments.x + (1.0 - adam.beta_1) * gradient;
    moments.y = adam.beta_2 * moments.y + (1.0 - adam.beta_2) * gradient * gradient;
    return value - rate * (moments.x * bias.x) / (sqrt(moments.y) * bias.y + adam.epsilon);
}

// moments: first and second; bias: 1/(1 - beta_1^t), 1/sqrt(1 - beta_2^t). Returns the new value, updates the moments.
float adam_update(float value, float gradient, inout vec2 moments, float rate, vec2 bias) {
    return adam_step(adam_of_step(), value, gradient, moments, rate, bias);
}

#endif
