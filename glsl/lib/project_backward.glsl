// Backward of projection and placement in whitened coordinates, where nothing cancels; derivation and f64 truth:
// engine/src/reference/gradient/project.rs and motion.rs. Include lib/projection.glsl and lib/place.glsl first.
#ifndef SPGS_PROJECT_BACKWARD
#define SPGS_PROJECT_BACKWARD

const float TWO_LN_2 = 1.3862943611198906;      // 1 / ROOT_HALF_LOG2_E^2
const float ROOT_TWO_LN_2 = 1.1774100225154747; // 1 / ROOT_HALF_LOG2_E
const float MIN_ROOT = 0.1;                     // px^4 under the root of the eigenvalue, as in 3DGS

// What the splat's footprint passes on.
struct FootprintGradient {
    vec2 mean2d;   // px
    vec2 tangent;  // of the tangents that enter J
    vec3 relative; // dL / d ln(standard deviation)
    vec3 local;    // by a right tangent of the rotation, in the Gaussian's axes
};

// column_k: columns of W R(t); h1: sums of h u, h v; h2: sums of h u^2, h uv, h v^2, in the splats' units of u and v.
//
// With e_k the columns of J W R (px per world unit over z), p_k = L e_k, n_k = scale_k p_k (|n_k| <= 1) and H = (h2):
// dL/d ln scale_k = n_k' H n_k; rotation about axis k: (scale_i^2 - scale_j^2) p_i' H p_j, i, j, k cyclic. The first
// component of L e_k would be a difference of large numbers for a needle; as a sum of minors it is not.
//
// `area`: where antialiased dL / d ln opacity, else 0. The opacity has a factor (det(cov - dilation) / det cov)^(1/2): its
// denominator takes `area` off H's diagonal, its numerator is the sum of the squared minors.
FootprintGradient footprint_backward(Footprint f, vec3 column_0, vec3 column_1, vec3 column_2, vec2 tangent, vec2 focal,
                                     vec2 h1, vec3 h2, float area) {
    vec3 root = footprint_root(f, 1.0);
    float c = f.yy + f.dilation;
    vec3 e_x = focal.x * (vec3(column_0.x, column_1.x, column_2.x) - tangent.x * vec3(column_0.z, column_1.z, column_2.z));
    vec3 e_y = focal.y * (vec3(column_0.y, column_1.y, column_2.y) - tangent.y * vec3(column_0.z, column_1.z, column_2.z));
    vec3 y = f.scale * vec3(f.m0.y, f.m1.y, f.m2.y);
    vec3 p_u = (f.dilation * e_x + cross(y, f.minor)) / (sqrt(c) * sqrt(f.det));
    vec3 p_v = e_y / sqrt(c);
    vec3 h = TWO_LN_2 * h2 - vec3(area, 0.0, area);
    vec3 hp_u = h.x * p_u + h.y * p_v;
    vec3 hp_v = h.y * p_u + h.z * p_v;
    vec3 n_u = f.scale * p_u;
    vec3 n_v = f.scale * p_v;
    vec3 hn_u = f.scale * hp_u;
    vec3 hn_v = f.scale * hp_v;

    FootprintGradient o;
    vec2 g = ROOT_TWO_LN_2 * f.inverse_unit * h1;
    o.mean2d = vec2(root.x * g.x, root.y * g.x + root.z * g.y);
    o.relative = n_u * hn_u + n_v * hn_v;
    vec3 first = f.scale.yzx;
    vec3 second = f.scale.zxy;
    o.local = ((first + second) * p_u.yzx) * ((first - second) * hp_u.zxy)
            + ((first + second) * p_v.yzx) * ((first - second) * hp_v.zxy);
    vec3 depth = f.scale * vec3(column_0.z, column_1.z, column_2.z);
    vec2 weighted = vec2(dot(depth, hn_u), dot(depth, hn_v));
    o.tangent = -focal * vec2(root.x * weighted.x, root.y * weighted.x + root.z * weighted.y);
    if (area != 0.0) {
        float share = area / f.minors;
        vec3 squares = f.scale * f.scale;
        vec3 opposite = squares.yzx * squares.zxy; // what a minor has of the scales
        o.relative += share * (f.minors - opposite * f.minor * f.minor);
        o.local += share * f.minor.yzx * f.minor.zxy * squares * ((second - first) * (second + first));
        vec3 pull = share * focal.x * focal.y * opposite * f.minor;
        o.tangent += vec2(dot(pull, vec3(column_0.x, column_1.x, column_2.x)),
                          dot(pull, vec3(column_0.y, column_1.y, column_2.y)));
    }
    return o;
}

// 3-sigma radius of the footprint, px, as 3DGS takes it.
float footprint_radius(Footprint f) {
    float unit2 = f.inverse_unit * f.inverse_unit;
    float half_difference = 0.5 * (f.xx - f.yy);
    float root = sqrt(max(half_difference * half_difference + f.xy * f.xy, MIN_ROOT * unit2 * unit2));
    return ceil(3.0 * sqrt(0.5 * (f.xx + f.yy) + f.dilation + root) / f.inverse_unit);
}

vec4 quaternion_conjugate(vec4 q) {
    return vec4(q.x, -q.yzw);
}

// Gradient of q, |q| = norm, from that by a right tangent of unit = q / |q|: 2 unit * (0, local) / |q|, normal to q.
vec4 quaternion_gradient(vec4 unit, float norm, vec3 local) {
    return quaternion_product(unit, vec4(0.0, local)) * (2.0 / norm);
}

// Gradient by a right tangent of the unit quaternion `unit` from the gradient of its four numbers.
vec3 quaternion_tangent(vec4 unit, vec4 gradient) {
    return 0.5 * quaternion_product(quaternion_conjugate(unit), gradient).yzw;
}

#endif
