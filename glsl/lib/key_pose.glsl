// Key poses under training: a rotation vector r, and the place x = Exp(r) c + tau of the superpoint's centre c, with what Adam
// and the terms that hold them need. Planes [T][KEY_WORDS][M]. Rust mirror: engine/src/train/keys.rs.
#ifndef SPGS_KEY_POSE
#define SPGS_KEY_POSE

#include "lib/quaternion.glsl"

const uint KEY_ROTATION = 0u;
const uint KEY_PLACE = 3u;
const uint KEY_FIRST_ROTATION = 6u; // where it began
const uint KEY_FIRST_PLACE = 9u;
const uint KEY_MOMENT_1 = 12u;      // of rotation, of place
const uint KEY_MOMENT_2 = 18u;      // one of each
const uint KEY_DECAY = 20u;         // beta_1^t, beta_2^t after t updates
const uint KEY_WORDS = 22u;

// What does not learn of a superpoint: planes [SUPERPOINT_WORDS][M].
const uint SUPERPOINT_CENTER = 0u;
const uint SUPERPOINT_SCALE = 3u;   // radians of a pixel, world units of a pixel; 0: it stays as it is

#endif
