// What a frame is: camera, image, time and counts, written by the host once per frame. Binding 0 of the kernels that
// include this file; the Rust mirror is engine/src/render/frame.rs (offsets are checked against the SPIR-V).
#ifndef SPGS_FRAME
#define SPGS_FRAME

struct Frame {
    vec4 world_to_camera_0;    // rows of the rotation world -> camera; w = 0
    vec4 world_to_camera_1;
    vec4 world_to_camera_2;
    vec3 camera_position_high; // f32(camera centre), world units
    float near;                // Gaussians at depth z <= near are not drawn
    vec3 camera_position_low;  // camera centre - high
    float key_weight;          // of the second motion key
    vec4 intrinsics;           // fx, fy, cx, cy, px
    vec4 tan_limit;            // range in which x/z and y/z enter the Jacobian: x_min, x_max, y_min, y_max
    vec3 background;           // rgb
    float time;
    uvec2 size;                // width, height, px
    uvec2 tiles;               // in x and y
    uint gaussians;
    uint superpoints;
    uint first_key;            // motion keys around the time
    uint second_key;
    uint instance_capacity;    // tile instances that the buffers hold
    uint tile_count;           // tiles.x * tiles.y
    uint tile_room;            // pairs that the list of each tile has room for; 0: scan_tiles says where the lists lie
    uint unused;               // to a multiple of 16 bytes
};

layout(std430, set = 0, binding = 0) readonly buffer FrameBlock { Frame frame; };

#endif
