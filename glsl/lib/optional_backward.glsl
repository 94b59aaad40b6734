// Backward of the optional parameters; part of deform_project_backward.comp, which defines what it uses.
#ifndef SPGS_OPTIONAL_BACKWARD
#define SPGS_OPTIONAL_BACKWARD

// Hands over the gradient of one optional number; `plane`: in the buffer `optional`.
void apply_optional(inout Target t, uint plane, float slope, float rate) {
    uint at = plane * t.n + t.g;
    float next = apply(t, PLANE_OPTIONAL + plane, optional[at], slope, rate);
    uint kind = OUTPUT;
    if (kind == 1u) {
        optional[at] = next;
    }
}

// Measures the smoothing. The first moment, which nothing else uses, keeps the most pixels per world unit that a photo had;
// where `rate` is 1 the smoothing follows from that, and it is measured anew.
void measure_smoothing(Target t, uint plane, float sampling) {
    uint at = plane * t.n + t.g;
    uint moment = (PLANE_OPTIONAL + plane) * t.n + t.g;
    float most = number_is_finite(sampling) ? max(moment_1[moment], sampling) : moment_1[moment];
    bool now = step_data.rate[PARAMETER_SMOOTHING] == 1.0 && most > 0.0;
    if (now) {
        optional[at] = ROOT_FILTER_VARIANCE / most;
    }
    moment_1[moment] = now ? 0.0 : most;
}

// Optional parameters. opacity: dL / d ln opacity.
void optional_backward(inout Target t, float opacity, Gradient o) {
    uint has = OPTIONAL;
    if ((has & HAS_LIFESPAN) != 0u) {
        uint plane = OPTIONAL_LIFESPAN(has);
        float log_length = optional[(plane + 1u) * t.n + t.g];
        float x = lifespan_place(frame.time, optional[plane * t.n + t.g], log_length);
        float rate = step_data.rate[PARAMETER_LIFESPAN];
        // Gaussians that are not seen have no gradient, wherever their lifespan is.
        bool seen = opacity != 0.0;
        apply_optional(t, plane, seen ? opacity * x * exp(-log_length) : 0.0, rate);
        apply_optional(t, plane + 1u, seen ? opacity * x * x : 0.0, rate);
        report(t, PARAMETER_LIFESPAN);
    }
    if ((has & HAS_SMOOTHING) != 0u) {
        uint plane = OPTIONAL_SMOOTHING(has);
        uint kind = OUTPUT;
        if (kind == 0u) {
            apply_optional(t, plane, o.smoothing, 0.0);
            report(t, PARAMETER_SMOOTHING);
        } else {
            measure_smoothing(t, plane, o.sampling);
        }
    }
}

#endif
