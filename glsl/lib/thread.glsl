// The number of an invocation in its workgroup. Include after the declaration of SUBGROUP_SIZE; the includer enables
// GL_KHR_shader_subgroup_basic.
#ifndef SPGS_THREAD
#define SPGS_THREAD

// By subgroup and lane, never gl_LocalInvocationID: how a driver deals those out to subgroups is its own affair. Subgroups are
// full and there are no others, so this is a numbering too, and kernels that think in subgroups need it to be this one.
uint thread_index() {
    uint size = SUBGROUP_SIZE;
    return gl_SubgroupID * size + gl_SubgroupInvocationID;
}

#endif
