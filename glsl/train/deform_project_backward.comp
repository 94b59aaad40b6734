// From the splats' gradients to those of the Gaussians' parameters, poses and non-rigid offsets, one Gaussian per thread.
// Recomputes the projection. OUTPUT = 0 writes the planes of `gradient`; OUTPUT = 1 takes an Adam step at once, so that no
// gradient is ever stored. A culled Gaussian has gradient 0, but its moments decay and it moves on, as in PyTorch's Adam.
//
// What is not finite is reported and not applied: as a gradient it is 0, as an update the old value and moments stay.
#version 460
#extension GL_GOOGLE_include_directive : require

layout(local_size_x = 128) in;
layout(constant_id = 0) const uint SUBGROUP_SIZE = 32;
layout(constant_id = 1) const uint SH_DEGREE = 3; // active: higher bands are left alone
layout(constant_id = 2) const uint MOTION = 0;    // 0 static, 1 pose table
layout(constant_id = 3) const uint NONRIGID = 0;  // 1: nonrigid_offset is added
layout(constant_id = 4) const uint OUTPUT = 0;    // 0 gradients, 1 Adam
layout(constant_id = 5) const uint MEAN_GRADIENT = 0; // 1: mean_gradient, of other losses, is added
layout(constant_id = 6) const uint OPTIONAL = 0;  // HAS_* of the optional parameters
layout(constant_id = 7) const uint BLEND = 0;     // see lib/superpoint_motion.glsl
layout(constant_id = 8) const uint ANTIALIASED = 0; // 1: as in deform_project

#define STEP_BINDING 1
#define STATUS_BINDING 3
#include "lib/frame.glsl"
#include "lib/dispatch.glsl"
#include "lib/limits.glsl"
#include "lib/step.glsl"
#include "lib/adam.glsl"
#include "lib/status.glsl"
#include "lib/quaternion.glsl"
#include "lib/sh.glsl"
#include "lib/projection.glsl"
#include "lib/lifespan.glsl"
#include "lib/smoothing.glsl"

layout(std430, set = 0, binding = 2) readonly buffer CountersBlock { uint counters[]; };
layout(std430, set = 0, binding = 4) readonly buffer SplatsBlock { vec4 splats[]; };
layout(std430, set = 0, binding = 5) readonly buffer TileCountBlock { uint tile_count[]; };
layout(std430, set = 0, binding = 6) readonly buffer SplatGradientBlock { float splat_gradient[]; };
layout(std430, set = 0, binding = 7) buffer MeanBlock { float mean[]; };
layout(std430, set = 0, binding = 8) buffer LogScaleBlock { float log_scale[]; };
layout(std430, set = 0, binding = 9) buffer RotationBlock { vec4 rotation[]; };
layout(std430, set = 0, binding = 10) buffer OpacityLogitBlock { float opacity_logit[]; };
layout(std430, set = 0, binding = 11) readonly buffer SuperpointOfGaussianBlock { uint superpoint_of_gaussian[]; };
layout(std430, set = 0, binding = 12) readonly buffer PoseBlock { vec4 pose[]; };
layout(std430, set = 0, binding = 13) buffer Sh0Block { float sh_0[]; };
layout(std430, set = 0, binding = 14) buffer Sh1Block { float sh_1[]; };
layout(std430, set = 0, binding = 15) buffer Sh2Block { float sh_2[]; };
layout(std430, set = 0, binding = 16) buffer Sh3Block { float sh_3[]; };
layout(std430, set = 0, binding = 17) buffer Moment1Block { float moment_1[]; };
layout(std430, set = 0, binding = 18) buffer Moment2Block { float moment_2[]; };
layout(std430, set = 0, binding = 19) writeonly buffer GradientBlock { float gradient[]; };
layout(std430, set = 0, binding = 20) writeonly buffer PoseGradientBlock { float pose_gradient[]; };
layout(std430, set = 0, binding = 21) readonly buffer NonrigidOffsetBlock { float nonrigid_offset[]; };
layout(std430, set = 0, binding = 22) writeonly buffer NonrigidGradientBlock { float nonrigid_gradient[]; };
layout(std430, set = 0, binding = 23) buffer DensityBlock { float density[]; };
layout(std430, set = 0, binding = 24) buffer MaxRadiusBlock { float max_radius[]; };
layout(std430, set = 0, binding = 25) readonly buffer MeanGradientBlock { float mean_gradient[]; };
layout(std430, set = 0, binding = 26) buffer OptionalBlock { float optional[]; };
layout(std430, set = 0, binding = 27) readonly buffer BlendIndexBlock { uint blend_index[]; };
layout(std430, set = 0, binding = 28) readonly buffer BlendWeightBlock { float blend_weight[]; };

#include "lib/place.glsl"
#include "lib/project_backward.glsl"

// The Gaussian's gradients that do not belong to a colour.
struct Gradient {
    vec3 mean;
    vec3 log_scale;
    vec4 rotation;
    float opacity_logit;
    vec3 omega;       // left tangent of the superpoints' rotation
    vec3 translation; // of the moved centre
    vec4 offset_q;
    vec3 offset_s;
    float smoothing;
    float sampling; // px per world unit at the centre
};

// What every number of the Gaussian needs.
struct Target {
    uint g;
    uint n;
    Adam adam;
    vec2 bias;
    bool finite; // nothing had to be left out so far
};

// Hands over the gradient of the number at `plane`; returns the number's new value.
float apply(inout Target t, uint plane, float value, float slope, float rate) {
    uint at = plane * t.n + t.g;
    bool finite = number_is_finite(slope);
    uint kind = OUTPUT;
    if (kind == 0u) {
        gradient[at] = finite ? slope : 0.0;
        t.finite = t.finite && finite;
        return value;
    }
    vec2 moments = vec2(moment_1[at], moment_2[at]);
    float next = adam_step(t.adam, value, slope, moments, rate, t.bias);
    finite = finite && number_is_finite(next) && number_is_finite(moments.x) && number_is_finite(moments.y);
    t.finite = t.finite && finite;
    if (finite) {
        moment_1[at] = moments.x;
        moment_2[at] = moments.y;
    }
    return finite ? next : value;
}

vec3 apply3(inout Target t, uint plane, vec3 value, vec3 slope, float rate) {
    float x = apply(t, plane, value.x, slope.x, rate);
    float y = apply(t, plane + 1u, value.y, slope.y, rate);
    float z = apply(t, plane + 2u, value.z, slope.z, rate);
    return vec3(x, y, z);
}

void report(inout Target t, uint group) {
    if (!t.finite) {
        report_not_finite(group, t.g);
        t.finite = true;
    }
}

// One SH term of bands 1, 2, 3: b its basis value, db the gradient of that, colour dL/d colour, along dL/d direction.
void sh_term_1(inout Target t, uint k, float rate, float b, vec3 db, vec3 colour, inout vec3 along) {
    uint at = 3u * k * t.n + t.g;
    vec3 value = vec3(sh_1[at], sh_1[at + t.n], sh_1[at + 2u * t.n]);
    along += db * dot(value, colour);
    vec3 next = apply3(t, PLANE_SH_1 + 3u * k, value, b * colour, rate);
    uint kind = OUTPUT;
    if (kind == 1u) {
        sh_1[at] = next.x;
        sh_1[at + t.n] = next.y;
        sh_1[at + 2u * t.n] = next.z;
    }
}

void sh_term_2(inout Target t, uint k, float rate, float b, vec3 db, vec3 colour, inout vec3 along) {
    uint at = 3u * k * t.n + t.g;
    vec3 value = vec3(sh_2[at], sh_2[at + t.n], sh_2[at + 2u * t.n]);
    along += db * dot(value, colour);
    vec3 next = apply3(t, PLANE_SH_2 + 3u * k, value, b * colour, rate);
    uint kind = OUTPUT;
    if (kind == 1u) {
        sh_2[at] = next.x;
        sh_2[at + t.n] = next.y;
        sh_2[at + 2u * t.n] = next.z;
    }
}

void sh_term_3(inout Target t, uint k, float rate, float b, vec3 db, vec3 colour, inout vec3 along) {
    uint at = 3u * k * t.n + t.g;
    vec3 value = vec3(sh_3[at], sh_3[at + t.n], sh_3[at + 2u * t.n]);
    along += db * dot(value, colour);
    vec3 next = apply3(t, PLANE_SH_3 + 3u * k, value, b * colour, rate);
    uint kind = OUTPUT;
    if (kind == 1u) {
        sh_3[at] = next.x;
        sh_3[at + t.n] = next.y;
        sh_3[at + 2u * t.n] = next.z;
    }
}

// All active bands, one term at a time so that few registers live; returns dL/d direction.
vec3 sh_backward(inout Target t, vec3 d, vec3 colour) {
    vec3 along = vec3(0.0);
    uint g = t.g;
    uint n = t.n;
    vec3 value = vec3(sh_0[g], sh_0[n + g], sh_0[2u * n + g]);
    vec3 next = apply3(t, PLANE_SH_0, value, SH_0 * colour, step_data.rate[PARAMETER_SH_0]);
    uint kind = OUTPUT;
    if (kind == 1u) {
        sh_0[g] = next.x;
        sh_0[n + g] = next.y;
        sh_0[2u * n + g] = next.z;
    }
    report(t, PARAMETER_SH_0);
    float x = d.x;
    float y = d.y;
    float z = d.z;
    float xx = x * x;
    float yy = y * y;
    float zz = z * z;
    uint degree = SH_DEGREE;
    if (degree >= 1u) {
        float b[3];
        sh_band_1(d, b);
        float rate = step_data.rate[PARAMETER_SH_1];
        sh_term_1(t, 0u, rate, b[0], vec3(0.0, -SH_1, 0.0), colour, along);
        sh_term_1(t, 1u, rate, b[1], vec3(0.0, 0.0, SH_1), colour, along);
        sh_term_1(t, 2u, rate, b[2], vec3(-SH_1, 0.0, 0.0), colour, along);
        report(t, PARAMETER_SH_1);
    }
    if (degree >= 2u) {
        float b[5];
        sh_band_2(d, b);
        float rate = step_data.rate[PARAMETER_SH_2];
        sh_term_2(t, 0u, rate, b[0], SH_2A * vec3(y, x, 0.0), colour, along);
        sh_term_2(t, 1u, rate, b[1], -SH_2A * vec3(0.0, z, y), colour, along);
        sh_term_2(t, 2u, rate, b[2], SH_2B * vec3(-2.0 * x, -2.0 * y, 4.0 * z), colour, along);
        sh_term_2(t, 3u, rate, b[3], -SH_2A * vec3(z, 0.0, x), colour, along);
        sh_term_2(t, 4u, rate, b[4], SH_2C * vec3(2.0 * x, -2.0 * y, 0.0), colour, along);
        report(t, PARAMETER_SH_2);
    }
    if (degree >= 3u) {
        float b[7];
        sh_band_3(d, b);
        float rate = step_data.rate[PARAMETER_SH_3];
        sh_term_3(t, 0u, rate, b[0], -SH_3A * vec3(6.0 * x * y, 3.0 * (xx - yy), 0.0), colour, along);
        sh_term_3(t, 1u, rate, b[1], SH_3B * vec3(y * z, x * z, x * y), colour, along);
        sh_term_3(t, 2u, rate, b[2], -SH_3C * vec3(-2.0 * x * y, 4.0 * zz - xx - 3.0 * yy, 8.0 * y * z), colour, along);
        sh_term_3(t, 3u, rate, b[3], SH_3D * vec3(-6.0 * x * z, -6.0 * y * z, 6.0 * zz - 3.0 * (xx + yy)), colour, along);
        sh_term_3(t, 4u, rate, b[4], -SH_3C * vec3(4.0 * zz - 3.0 * xx - yy, -2.0 * x * y, 8.0 * x * z), colour, along);
        sh_term_3(t, 5u, rate, b[5], SH_3E * vec3(2.0 * x * z, -2.0 * y * z, xx - yy), colour, along);
        sh_term_3(t, 6u, rate, b[6], -SH_3A * vec3(3.0 * (xx - yy), -6.0 * x * y, 0.0), colour, along);
        report(t, PARAMETER_SH_3);
    }
    return along;
}

// Density statistics of a visible Gaussian.
void gather_statistics(uint g, uint n, vec2 mean2d, float radius) {
    float change = length(mean2d * 0.5 * vec2(frame.size)); // per unit of normalised device coordinates
    density[g] += number_is_finite(change) ? change : 0.0;
    density[n + g] += 1.0;
    float before = max_radius[g];
    before = number_is_finite(before) ? before : 0.0;
    max_radius[g] = number_is_finite(radius) ? max(before, radius) : before;
}

// Gradient of the canonical centre through the rotations of soft superpoints, less `moved` itself.
vec3 blend_mean_gradient(uint g, uint n, vec3 moved) {
    uint slots = BLEND;
    vec4 weight = blend_weights(g, n);
    vec3 sum = vec3(0.0);
    for (uint slot = 0u; slot < slots; slot++) {
        vec4 turn;
        vec3 translation;
        read_pose(blend_superpoint(g, n, slot), turn, translation);
        sum += weight[slot] * quaternion_displacement(quaternion_conjugate(turn), moved);
    }
    return sum;
}

// The geometry's gradients of a visible Gaussian; `direction` is the colour's gradient of d.
Gradient geometry_backward(uint g, uint n, vec3 canonical, vec3 d, vec4 turn, Shape shape, vec3 direction) {
    vec3 axis_0;
    vec3 axis_1;
    vec3 axis_2;
    quaternion_columns(shape.q, axis_0, axis_1, axis_2);
    mat3 rows = mat3(frame.world_to_camera_0.xyz, frame.world_to_camera_1.xyz, frame.world_to_camera_2.xyz);
    vec3 column_0 = axis_0 * rows;
    vec3 column_1 = axis_1 * rows;
    vec3 column_2 = axis_2 * rows;
    vec3 p = d * rows;
    vec2 focal = frame.intrinsics.xy;
    vec2 slope = p.xy / p.z;
    vec2 tangent = min(max(slope, frame.tan_limit.xz), frame.tan_limit.yw);
    float sigma = 0.0;
    vec3 share = vec3(1.0);
    vec3 scale = shape.scale;
    uint has = OPTIONAL;
    if ((has & HAS_SMOOTHING) != 0u) {
        sigma = optional[OPTIONAL_SMOOTHING(has) * n + g];
        scale = smoothed(shape.scale, sigma, share);
    }
    Footprint footprint = footprint_of(column_0, column_1, column_2, scale / p.z, tangent, focal);
    uint row = 12u * g;
    vec2 h1 = vec2(splat_gradient[row + 1u], splat_gradient[row + 2u]);
    vec3 h2 = vec3(splat_gradient[row + 3u], splat_gradient[row + 4u], splat_gradient[row + 5u]);
    uint antialiased = ANTIALIASED;
    float area = antialiased == 1u ? splat_gradient[row] : 0.0;
    FootprintGradient f = footprint_backward(footprint, column_0, column_1, column_2, tangent, focal, h1, h2, area);
    float statistics = step_data.density_statistics;
    if (statistics > 0.0) {
        vec2 absolute = TWO_LN_2 * vec2(splat_gradient[row + 10u], splat_gradient[row + 11u]);
        gather_statistics(g, n, statistics > 1.0 ? absolute : f.mean2d, footprint_radius(footprint));
    }

    // A clamped tangent is constant, but J still depends on 1/z.
    bvec2 inside = equal(slope, tangent);
    vec2 slope_gradient = vec2(inside.x ? f.tangent.x : 0.0, inside.y ? f.tangent.y : 0.0) + focal * f.mean2d;
    float along_z = -(dot(slope_gradient, slope) + f.relative.x + f.relative.y + f.relative.z);
    vec3 p_gradient = vec3(slope_gradient, along_z) / p.z;
    vec3 moved = rows * p_gradient + direction;

    Gradient o;
    // Blurred, s' follows s by (s / s')^2, and the opacity, by Pi s / s', the rest of the way.
    vec3 relative = share * f.relative + (1.0 - share) * splat_gradient[row];
    o.sampling = max(focal.x, focal.y) / p.z;
    vec3 per_sigma = sigma / (scale * scale);
    o.smoothing = dot(f.relative - splat_gradient[row], per_sigma);
    vec3 free = relative / shape.scale; // dL / d standard deviation
    vec3 local = f.local;
    o.offset_q = vec4(0.0);
    uint nonrigid = NONRIGID;
    if (nonrigid == 1u) {
        free = vec3(shape.scale.x > shape.added.x ? 0.0 : free.x, shape.scale.y > shape.added.y ? 0.0 : free.y,
                    shape.scale.z > shape.added.z ? 0.0 : free.z);
        o.offset_q = quaternion_gradient(shape.q, shape.sum, local);
        local = quaternion_tangent(shape.rigid, o.offset_q);
    }
    o.offset_s = free;
    o.log_scale = nonrigid == 1u ? free * shape.own : relative;
    o.rotation = quaternion_gradient(shape.unit, shape.norm, local);
    o.translation = moved;
    o.mean = moved;
    o.omega = vec3(0.0);
    uint motion = MOTION;
    uint slots = BLEND;
    if (motion == 1u) {
        o.omega = local + quaternion_displacement(shape.rigid, local);
        if (slots == 0u) {
            vec3 turned = canonical + quaternion_displacement(turn, canonical);
            o.omega += cross(turned, moved);
            o.mean = moved + quaternion_displacement(quaternion_conjugate(turn), moved);
        } else {
            o.mean = moved + blend_mean_gradient(g, n, moved);
        }
    }
    o.opacity_logit = splat_gradient[row] / (1.0 + exp(opacity_logit[g]));
    return o;
}

float checked(inout bool finite, float x) {
    bool ok = number_is_finite(x);
    finite = finite && ok;
    return ok ? x : 0.0;
}

// Planes first .. first + 5 of Gaussian g: left tangent of a superpoint's rotation, and translation.
bool write_pose(uint first, uint g, uint n, vec3 omega, vec3 translation) {
    bool finite = true;
    uint at = first * n + g;
    pose_gradient[at] = checked(finite, omega.x);
    pose_gradient[at + n] = checked(finite, omega.y);
    pose_gradient[at + 2u * n] = checked(finite, omega.z);
    pose_gradient[at + 3u * n] = checked(finite, translation.x);
    pose_gradient[at + 4u * n] = checked(finite, translation.y);
    pose_gradient[at + 5u * n] = checked(finite, translation.z);
    return finite;
}

// What each slot of a Gaussian's soft superpoints gets: its pose's gradient, and that of its weight with the others held. With
// turn = sum / |sum|: dL/dsum = 2 (0, omega) turn / |sum|, normal to sum.
bool write_blend_gradient(uint g, uint n, vec3 canonical, Gradient o) {
    uint slots = BLEND;
    vec4 sum;
    vec3 displacement;
    vec4 weight = blend_weights(g, n);
    bool usable = blend_motion(g, n, canonical, weight, sum, displacement);
    float norm2 = dot(sum, sum);
    vec4 sum_gradient = usable ? quaternion_product(vec4(0.0, o.omega), sum) * (2.0 / norm2) : vec4(0.0);
    vec4 heaviest;
    vec3 translation;
    read_pose(blend_superpoint(g, n, heaviest_slot(weight)), heaviest, translation);
    bool finite = true;
    for (uint slot = 0u; slot < slots; slot++) {
        vec4 turn;
        read_pose(blend_superpoint(g, n, slot), turn, translation);
        float own = usable ? weight[slot] : 0.0;
        float side = signed_weight(1.0, turn, heaviest);
        vec3 moved = quaternion_displacement(turn, canonical);
        vec3 omega = 0.5 * side * quaternion_product(sum_gradient, quaternion_conjugate(turn)).yzw
                   + cross(canonical + moved, o.translation);
        float of_weight = dot(o.translation, moved + translation) + side * dot(sum_gradient, turn);
        finite = write_pose(7u * slot, g, n, own * omega, own * o.translation) && finite;
        pose_gradient[(7u * slot + 6u) * n + g] = checked(finite, usable ? of_weight : 0.0);
    }
    return finite;
}

void write_pose_gradient(uint g, uint n, vec3 canonical, Gradient o) {
    uint slots = BLEND;
    bool finite = slots == 0u ? write_pose(0u, g, n, o.omega, o.translation)
                              : write_blend_gradient(g, n, canonical, o);
    if (!finite) {
        report_not_finite(STATUS_POSE, g);
    }
}

void write_nonrigid_gradient(uint g, uint n, Gradient o) {
    bool finite = true;
    nonrigid_gradient[g] = checked(finite, o.translation.x);
    nonrigid_gradient[n + g] = checked(finite, o.translation.y);
    nonrigid_gradient[2u * n + g] = checked(finite, o.translation.z);
    nonrigid_gradient[3u * n + g] = checked(finite, o.offset_q.x);
    nonrigid_gradient[4u * n + g] = checked(finite, o.offset_q.y);
    nonrigid_gradient[5u * n + g] = checked(finite, o.offset_q.z);
    nonrigid_gradient[6u * n + g] = checked(finite, o.offset_q.w);
    nonrigid_gradient[7u * n + g] = checked(finite, o.offset_s.x);
    nonrigid_gradient[8u * n + g] = checked(finite, o.offset_s.y);
    nonrigid_gradient[9u * n + g] = checked(finite, o.offset_s.z);
    if (!finite) {
        report_not_finite(STATUS_NETWORK_G, g);
    }
}

// Mean, log scale, rotation and opacity.
void apply_geometry(inout Target t, vec3 canonical, Gradient o) {
    uint g = t.g;
    uint n = t.n;
    uint kind = OUTPUT;
    vec3 new_mean = apply3(t, PLANE_MEAN, canonical, o.mean, step_data.rate[PARAMETER_MEAN]);
    report(t, PARAMETER_MEAN);
    vec3 log_s = vec3(log_scale[g], log_scale[n + g], log_scale[2u * n + g]);
    vec3 new_log_scale = apply3(t, PLANE_LOG_SCALE, log_s, o.log_scale, step_data.rate[PARAMETER_LOG_SCALE]);
    report(t, PARAMETER_LOG_SCALE);
    vec4 q = rotation[g];
    float rotation_rate = step_data.rate[PARAMETER_ROTATION];
    vec3 q_wxy = apply3(t, PLANE_ROTATION, q.xyz, o.rotation.xyz, rotation_rate);
    float q_z = apply(t, PLANE_ROTATION + 3u, q.w, o.rotation.w, rotation_rate);
    report(t, PARAMETER_ROTATION);
    float opacity_rate = step_data.rate[PARAMETER_OPACITY_LOGIT];
    float logit = apply(t, PLANE_OPACITY_LOGIT, opacity_logit[g], o.opacity_logit, opacity_rate);
    report(t, PARAMETER_OPACITY_LOGIT);
    if (kind == 1u) {
        mean[g] = new_mean.x;
        mean[n + g] = new_mean.y;
        mean[2u * n + g] = new_mean.z;
        log_scale[g] = new_log_scale.x;
        log_scale[n + g] = new_log_scale.y;
        log_scale[2u * n + g] = new_log_scale.z;
        rotation[g] = vec4(q_wxy, q_z);
        opacity_logit[g] = logit;
    }
}

#include "lib/optional_backward.glsl"

void main() {
    uint g = workgroup_index() * 128u + gl_LocalInvocationIndex;
    uint n = frame.gaussians;
    if (g < n && counters[COUNT_FAILED] == 0u) {
        Target t = Target(g, n, adam_of_step(), step_data.bias_gaussians, true);
        vec3 canonical = vec3(mean[g], mean[n + g], mean[2u * n + g]);
        bool visible = tile_count[g] > 0u;
        vec3 d = vec3(0.0, 0.0, 1.0);
        vec4 turn = vec4(1.0, 0.0, 0.0, 0.0);
        Shape shape;
        vec3 colour = vec3(0.0);
        if (visible) {
            visible = place_mean(g, n, canonical, d, turn) && place_shape(g, n, turn, shape);
        }
        if (visible) {
            // The colour that was drawn says which channels were clamped at 0.
            vec3 drawn = splats[3u * g + 2u].rgb;
            uint row = 12u * g;
            colour = vec3(drawn.r > 0.0 ? splat_gradient[row + 6u] : 0.0, drawn.g > 0.0 ? splat_gradient[row + 7u] : 0.0,
                          drawn.b > 0.0 ? splat_gradient[row + 8u] : 0.0);
        }
        float distance = sqrt(dot(d, d));
        vec3 view = d / distance;
        vec3 along = sh_backward(t, view, colour);
        Gradient o = Gradient(vec3(0.0), vec3(0.0), vec4(0.0), 0.0, vec3(0.0), vec3(0.0), vec4(0.0), vec3(0.0), 0.0, 0.0);
        if (visible) {
            vec3 direction = (along - view * dot(view, along)) / distance;
            o = geometry_backward(g, n, canonical, d, turn, shape, direction);
        }
        uint with_mean_gradient = MEAN_GRADIENT;
        if (with_mean_gradient == 1u) {
            o.mean += vec3(mean_gradient[g], mean_gradient[n + g], mean_gradient[2u * n + g]);
        }
        apply_geometry(t, canonical, o);
        optional_backward(t, visible ? splat_gradient[12u * g] : 0.0, o);
        uint motion = MOTION;
        if (motion == 1u) {
            write_pose_gradient(g, n, canonical, o);
        }
        uint nonrigid = NONRIGID;
        if (nonrigid == 1u) {
            write_nonrigid_gradient(g, n, o);
        }
    }
}
