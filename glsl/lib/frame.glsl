// What a frame is: camera, image, time and counts, written by the host once per frame. Binding 0 of the kernels that
// include this file; the Rust mirror is engine/src/render/frame.rs (offsets are checked against the SPIR-V).
#ifndef SPGS_FRAME
#define SPGS_FRAME

struct Frame {
    vec4 world_to_camera_0;    // rows of the rotation world -> camera; w = 0
    vec4 world_to_camera_1;
    vec4 world_to_camera_2;
    vec4 camera_position_high; // xyz = f32(camera centre), world units; w = near
    vec4 camera_position_low;  // xyz = camera centre - high; w = key_weight
    vec4 intrinsics;           // fx, fy, cx, cy, px
    vec4 tan_limit;            // range in which x/z and y/z enter the Jacobian: x_min, x_max, y_min, y_max
    vec4 background;           // rgb; w = time
    uvec4 size;                // width, height (px), tiles_x, tiles_y
    uvec4 counts;              // gaussians, superpoints, key_first, key_second
    uvec4 limits;              // instance_capacity, tile_count, tile_passes, sh_degree
};

layout(std430, set = 0, binding = 0) readonly buffer FrameBlock { Frame frame; };

#endif
