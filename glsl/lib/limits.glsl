// Constants that several kernels share with their Rust twins (engine/src/render/limits.rs; equality is tested).
#ifndef SPGS_LIMITS
#define SPGS_LIMITS

const uint TILE_SIZE = 16u;           // pixels per tile edge
const uint SORT_THREADS = 256u;       // threads of every workgroup of the sort and of the tile kernels
const uint SORT_ROUNDS = 16u;         // most keys per thread of sort_scatter
const uint SORT_PARTITION = 4096u;    // SORT_THREADS * SORT_ROUNDS: keys of the largest partition
const uint SORT_DIGITS = 256u;        // columns of a histogram row, whatever the digit width
const uint SCAN_BLOCK = 256u;         // elements per block sum
const uint SCAN_SUPER = 256u;         // block sums per super sum
// Words from the counter of a tile to that of the next: atomics on the same line of memory (128 bytes on NVIDIA) wait for each other.
const uint TILE_PITCH = 32u;

// counters[]
const uint COUNT_VISIBLE = 0u;
const uint COUNT_INSTANCES_LOW = 1u;  // 64-bit total over the visible Gaussians
const uint COUNT_INSTANCES_HIGH = 2u;
const uint COUNT_FAILED = 3u;         // bits below
const uint COUNT_REJECTED = 4u;
const uint COUNT_INSTANCES = 5u;      // instances to process; 0 when failed; of frames with scan_tiles
const uint COUNT_LONGEST = 6u;        // pairs of the longest list, where it takes more than 3/4 of its room (frame.tile_room)

const uint FAILED_INSTANCES = 1u;     // more instances than the buffers hold, or than there is room for in a list

#endif
