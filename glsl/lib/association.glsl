// What the kernels of the association matrix share. Rust mirror: engine/src/train/association.rs.
// NEIGHBORS (K) superpoints of each Gaussian are in use, SLOTS (K' >= K) are remembered.
#ifndef SPGS_ASSOCIATION
#define SPGS_ASSOCIATION

layout(constant_id = 1) const uint NEIGHBORS = 5u;
layout(constant_id = 2) const uint SLOTS = 8u;

const uint MAX_NEIGHBORS = 7u;
const uint MAX_SLOTS = 16u;
// A slot that has never been used.
const uint NO_SUPERPOINT = 0xffffffffu;
// Logit of a neighbour that was not remembered.
const float NEW_LOGIT = 0.1;

// A pair's value: slot (NEIGHBORS = the Gaussian's own superpoint) above, Gaussian below.
const uint PAIR_SHIFT = 28u;
const uint PAIR_MASK = 0x0fffffffu;

#endif
