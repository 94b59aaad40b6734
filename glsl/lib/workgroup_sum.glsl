// Sums over a workgroup of 256 threads in a fixed order: within subgroups, then over subgroups. Define SUM_VALUES (how
// many values are summed at once, at most 64) before including; the includer enables GL_KHR_shader_subgroup_arithmetic.
#ifndef SPGS_WORKGROUP_SUM
#define SPGS_WORKGROUP_SUM

#include "thread.glsl"

shared float sum_rows[64 * SUM_VALUES]; // one row per subgroup: 256 / 4 at most

// Every thread calls it; contains barriers. Thread v < SUM_VALUES gets the sum of value[v], others 0.
float workgroup_sums(float value[SUM_VALUES]) {
    uint subgroups = gl_NumSubgroups;
    for (uint v = 0u; v < SUM_VALUES; v++) {
        float sum = subgroupAdd(value[v]);
        if (gl_SubgroupInvocationID == 0u) {
            sum_rows[gl_SubgroupID * SUM_VALUES + v] = sum;
        }
    }
    barrier();
    uint thread = thread_index();
    float total = 0.0;
    if (thread < SUM_VALUES) {
        for (uint s = 0u; s < subgroups; s++) {
            total += sum_rows[s * SUM_VALUES + thread];
        }
    }
    barrier();
    return total;
}

#endif
