#version 460
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_KHR_shader_subgroup_shuffle : require

// What the model must find, one FAULT at a time; 0 is none. Compiled by: glslc --target-env=vulkan1.2 -O0

layout(constant_id = 0) const uint SUBGROUP_SIZE = 32u;
layout(constant_id = 1) const uint FAULT = 0u;
layout(local_size_x = 256) in;
layout(std430, set = 0, binding = 0) buffer ValuesBlock { uint values[]; };

shared uint cells[256];

uint read_neighbor(uint i) {
    return cells[(i + 1u) % 256u];
}

void wait_for_all() {
    barrier();
}

void main() {
    uint fault = FAULT;
    uint i = gl_LocalInvocationID.x;
    uint value = i;
    if (fault <= 2u) {
        cells[i] = 0u;
        wait_for_all();
    }
    if (fault == 0u) {
        cells[i] = i;
        wait_for_all();
        value = read_neighbor(i);
        subgroupBarrier();
    } else if (fault == 1u) { // a race between lanes and subgroups
        cells[i] = i;
        value = read_neighbor(i);
    } else if (fault == 2u) { // ordered within the subgroup alone
        cells[i] = i;
        subgroupBarrier();
        value = read_neighbor(i);
    } else if (fault == 3u) { // some lanes at a barrier
        if (i % 5u != 0u) {
            wait_for_all();
        }
    } else if (fault == 4u) { // some subgroups at a barrier
        if (gl_SubgroupID == 0u) {
            wait_for_all();
        }
    } else if (fault == 5u) { // uniform for the subgroup, not for the workgroup
        if (gl_SubgroupID == 0u) {
            subgroupBarrier();
        }
    } else if (fault == 6u) { // nothing there
        value = read_neighbor(i);
    } else if (fault == 7u) { // past the end of shared memory
        cells[i + 1u] = i;
    } else if (fault == 8u) { // past the end of a private array
        uint own[4] = uint[4](1u, 2u, 3u, 4u);
        value = own[i / 60u];
    } else if (fault == 9u) { // barrier() orders shared memory, not buffers
        values[i] = i;
        wait_for_all();
        value = values[(i + 1u) % 256u];
    } else if (fault == 10u) { // another workgroup's words
        values[i] = gl_WorkGroupID.x;
    } else if (fault == 11u) { // a lane that is not active
        if (gl_SubgroupInvocationID > 0u) {
            value = subgroupShuffle(i, 0u);
        }
    } else if (fault == 12u) { // the same value by all is a race too
        cells[7] = 1u;
    } else if (fault == 13u) { // atomics against a plain load
        cells[i] = 0u;
        wait_for_all();
        atomicAdd(cells[i / 2u], 1u);
        value = cells[i / 2u];
    } else if (fault == 14u) { // atomics alone
        cells[i] = 0u;
        wait_for_all();
        atomicAdd(cells[i / 2u], 1u);
        wait_for_all();
        value = cells[i / 2u];
    }
    wait_for_all();
    if (fault != 10u) {
        values[gl_GlobalInvocationID.x + 1u] = value;
    }
}
