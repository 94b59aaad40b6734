// C(a, b) = sum over k of A(a, k) B(k, b), one tile of C at a time, always in the same order. The includer says where the
// numbers come from and where they go (the prototypes below), and defines
//   A_ALONG_K, B_ALONG_K  1 when neighbouring k lie side by side in memory, else 0 (neighbouring a or b do);
//   K_STEP                4, or 1 where the code of an operand is long: k per round of STAGE 0;
//   VECTORS               K_STEP 4 only: a specialisation constant, 1 when all strides and offsets are multiples of 4, so that
//                         four neighbours are one load; STAGE 0 is only for these;
//   ROW_SUMS              1 when the sums of A over k are wanted as well.
// It enables GL_KHR_shader_subgroup_{basic,shuffle} and has the specialisation constants STAGE and THREADS, of a workgroup.
//
// STAGE 0: a tile of 32 x (8 per lane) per subgroup; each lane reads eight columns of B and its share of
// the rows of A, and shuffles spread the latter. For devices where a load costs the same whether or not neighbours read the
// same word. They also take a subgroup that has no tile through all loads and stores, masked: workgroups are small there.
// STAGE 1: a tile of 32 x 32 per workgroup, in shared memory 64 k at a time; four groups of 64 threads, each with 4 x 4
// sums, take 16 of these k each, so that small matrices still fill a GPU.
#ifndef SPGS_MATRIX_PRODUCT
#define SPGS_MATRIX_PRODUCT

#extension GL_EXT_control_flow_attributes : require
#include "thread.glsl"

// Never called with a, b or k outside the matrices.
float operand_a(uint a, uint k);
float operand_b(uint k, uint b);
#if K_STEP == 4
// The same for four neighbours in memory, from a multiple of four on; called where VECTORS is 1.
vec4 operand_a_four(uint a, uint k);
vec4 operand_b_four(uint k, uint b);
void store_all_four(uint a, uint b, vec4 value);
#endif
// Four neighbours along b, of which those below `columns` are stored.
void store_four(uint a, uint b, uint columns, vec4 value);
#if ROW_SUMS
void store_row_sum(uint a, float value);
#endif

const uint PRODUCT_THREADS = 256u; // STAGE 1
const uint SHUFFLE_ROWS = 16u;
const uint SHUFFLE_COLUMNS = 8u; // per lane
const uint SHARED_TILE = 32u;
const uint SHARED_GROUPS = 4u; // of 64 threads
const uint SHARED_DEPTH = 16u; // k per group and round
const uint SHARED_PITCH = 9u;  // vec4 per k: 8 and one to spread the banks
const uint STAGED_DEPTH = SHARED_GROUPS * SHARED_DEPTH;
const uint STAGED_HALF = STAGED_DEPTH * SHARED_PITCH; // where B starts, in vec4

shared vec4 product_stage[2 * 4 * 16 * 9];
shared vec4 product_row_sums[4 * 8];


// Tiles of C along b and in all.
uvec2 product_tiles(uint rows, uint columns) {
    uint size = SUBGROUP_SIZE;
    uint stage = STAGE;
    uint high = stage == 0u ? SHUFFLE_ROWS : SHARED_TILE;
    uint wide = stage == 0u ? SHUFFLE_COLUMNS * size : SHARED_TILE;
    uint along_b = (columns + wide - 1u) / wide;
    return uvec2(along_b, along_b * ((rows + high - 1u) / high));
}

// The tile (of all slices) that this invocation works on: one per workgroup or one per subgroup.
uint product_tile() {
    uint size = SUBGROUP_SIZE;
    uint stage = STAGE;
    uint threads = THREADS;
    uint per_group = threads / size;
    uint unused = gl_SubgroupID < per_group ? 0u : 0x40000000u; // past every tile
    return stage == 0u ? workgroup_index() * per_group + gl_SubgroupID + unused : workgroup_index();
}

#if K_STEP == 4
vec4 zero_past_end(vec4 value, bool along_k, uint k, uint k_end) {
    return mix(vec4(0.0), value, lessThan(along_k ? k + uvec4(0u, 1u, 2u, 3u) : uvec4(k), uvec4(k_end)));
}
#endif

// K_STEP 4: what lies side by side from (a, k) on. K_STEP 1: along k one element, else four. 0 past the end of k.
vec4 load_a(uint a, uint k, uint rows, uint k_end) {
#if K_STEP == 4
    return zero_past_end(operand_a_four(a, min(k, k_end - 1u)), A_ALONG_K == 1, k, k_end);
#else
    vec4 value = vec4(0.0);
    for (uint j = 0u; j < (A_ALONG_K == 1 ? 1u : 4u); j++) {
        value[j] = operand_a(min(a + j, rows - 1u), k);
    }
    return value;
#endif
}

// The same of B.
vec4 load_b(uint k, uint b, uint columns, uint k_end) {
#if K_STEP == 4
    return zero_past_end(operand_b_four(min(k, k_end - 1u), b), B_ALONG_K == 1, k, k_end);
#else
    vec4 value = vec4(0.0);
    for (uint j = 0u; j < (B_ALONG_K == 1 ? 1u : 4u); j++) {
        value[j] = operand_b(k, min(b + j, columns - 1u));
    }
    return value;
#endif
}

// Unrolled, so that the sums are in registers.
#define EACH_ROW(row) [[unroll]] for (uint r = 0u; r < high; r++) { row(r) }
#define CLEAR_ROW(r) sum[2u * (r)] = vec4(0.0); sum[2u * (r) + 1u] = vec4(0.0);
// The lane that holds row r of A, and where: rows i·size + lane along k, else the four rows from 4·lane (4·(size + lane)) on.
#if A_ALONG_K
#define A_OF_ROW(r, j) subgroupShuffle(own[(r) / size][j], (r) % size)
#else
#define A_OF_ROW(r, j) subgroupShuffle(own[2u * (j) + (r) / 4u / size][(r) % 4u], (r) / 4u % size)
#endif
#if B_ALONG_K
#define B_OF(j, c) vec4(b[c][j], b[(c) + 1u][j], b[(c) + 2u][j], b[(c) + 3u][j])
#else
#define B_OF(j, c) b[2u * (j) + (c) / 4u]
#endif
#define ADD_K(r, j) \
    of_row = A_OF_ROW(r, j); \
    sum_0 += of_row * B_OF(j, 0u); \
    sum_1 += of_row * B_OF(j, 4u);
#if K_STEP == 4
#define ADD_EACH_K(r) ADD_K(r, 0u) ADD_K(r, 1u) ADD_K(r, 2u) ADD_K(r, 3u)
#else
#define ADD_EACH_K(r) ADD_K(r, 0u)
#endif
#define ADD_ROW(r) \
    sum_0 = sum[2u * (r)]; \
    sum_1 = sum[2u * (r) + 1u]; \
    ADD_EACH_K(r) \
    sum[2u * (r)] = sum_0; \
    sum[2u * (r) + 1u] = sum_1;
// Each of these 128 is a copy of what the includer stores: the vectors alone where it has them.
#if K_STEP == 4
#define STORE(a, b, value) if ((b) < columns) { store_all_four(a, b, value); }
#else
#define STORE(a, b, value) store_four(a, b, columns, value);
#endif
#define STORE_ROW(r) \
    if (used && a_first + (r) < rows) { \
        STORE(a_first + (r), b_first, sum[2u * (r)]) \
        STORE(a_first + (r), b_first + 4u, sum[2u * (r) + 1u]) \
    }

void product_by_shuffle(uint tile, uint tiles_b, uint rows, uint columns, uint k_first, uint k_end) {
    uint size = SUBGROUP_SIZE;
    uint lane = gl_SubgroupInvocationID;
    const uint high = SHUFFLE_ROWS;
    uint a_first = tile / tiles_b * high;
    uint b_first = (tile % tiles_b * size + lane) * SHUFFLE_COLUMNS;
    vec4 sum[2u * SHUFFLE_ROWS];
    EACH_ROW(CLEAR_ROW)
    // Subgroups of 64 and more need one row along k per lane, of 4 and 8 all eight; of others, two sets of four rows or one.
    vec4 own[8];
    vec4 b[8];
    vec4 row_sum[2];
    for (uint i = 0u; i < 8u; i++) {
        own[i] = vec4(0.0);
        b[i] = vec4(0.0);
    }
    row_sum[0] = vec4(0.0);
    row_sum[1] = vec4(0.0);
    vec4 sum_0;
    vec4 sum_1;
    float of_row;
    for (uint k = k_first; k < k_end; k += K_STEP) {
#if A_ALONG_K
        for (uint i = 0u; i < 8u; i++) {
            if (i * size < high) {
                own[i] = load_a(min(a_first + i * size + lane % high, rows - 1u), k, rows, k_end);
            }
        }
#else
        for (uint j = 0u; j < K_STEP; j++) {
            for (uint i = 0u; i < 2u; i++) {
                if (i * size < high / 4u) {
                    uint a = min(a_first + 4u * (i * size + lane % (high / 4u)), (rows - 1u) / 4u * 4u);
                    own[2u * j + i] = load_a(a, k + j, rows, k_end);
                    row_sum[i] += own[2u * j + i];
                }
            }
        }
#endif
#if B_ALONG_K
        for (uint c = 0u; c < 8u; c++) {
            b[c] = load_b(k, min(b_first + c, columns - 1u), columns, k_end);
        }
#else
        for (uint j = 0u; j < K_STEP; j++) {
            for (uint c = 0u; c < 2u; c++) {
                b[2u * j + c] = load_b(k + j, min(b_first + 4u * c, (columns - 1u) / 4u * 4u), columns, k_end);
            }
        }
#endif
        EACH_ROW(ADD_ROW)
    }
    bool used = k_first < k_end;
    EACH_ROW(STORE_ROW)
#if ROW_SUMS
    for (uint i = 0u; i < 2u; i++) {
        uint a = a_first + 4u * (i * size + lane);
        for (uint j = 0u; j < 4u; j++) {
            if (used && i * size + lane < high / 4u && tile % tiles_b == 0u && a + j < rows) {
                store_row_sum(a + j, row_sum[i][j]);
            }
        }
    }
#endif
}

// Element (k, i) of the staged part of an operand, which starts at `start`.
void stage_element(uint start, uint k, uint i, float value) {
    product_stage[start + k * SHARED_PITCH + i / 4u][i % 4u] = value;
}

#if K_STEP == 4
// A whole load of an operand: four k of row i, or rows i to i + 3.
void stage_four(uint start, bool along_k, uint k, uint i, vec4 value) {
    if (along_k) {
        for (uint j = 0u; j < 4u; j++) {
            stage_element(start, k + j, i, value[j]);
        }
    } else {
        product_stage[start + k * SHARED_PITCH + i / 4u] = value;
    }
}

// (k, i) of a whole load: along k, neighbouring threads take 64 bytes of eight rows each, else 32 rows of a k.
uvec2 staged_four(uint item, bool along_k) {
    return along_k ? uvec2(4u * (item / 8u % (STAGED_DEPTH / 4u)), item % 8u + item / (2u * STAGED_DEPTH) * 8u)
        : uvec2(item / (SHARED_TILE / 4u), item % (SHARED_TILE / 4u) * 4u);
}

// A thread's share of what is staged next. It comes from memory while the sums take up what was staged before: few workgroups
// share the work of a small matrix, and nothing else would hide that time.
const uint STAGED_FOURS = 2u; // of an operand: STAGED_DEPTH * SHARED_TILE / 4 / PRODUCT_THREADS
vec4 next_a[2];
vec4 next_b[2];

void fetch_operands(uvec2 first, uint k_0, uvec2 size, uint k_end) {
    [[unroll]] for (uint i = 0u; i < STAGED_FOURS; i++) {
        uint item = thread_index() + i * PRODUCT_THREADS;
        uvec2 at = staged_four(item, A_ALONG_K == 1);
        bool inside = k_0 + at.x < k_end && first.x + at.y < size.x;
        next_a[i] = inside ? operand_a_four(first.x + at.y, k_0 + at.x) : vec4(0.0);
        at = staged_four(item, B_ALONG_K == 1);
        inside = k_0 + at.x < k_end && first.y + at.y < size.y;
        next_b[i] = inside ? operand_b_four(k_0 + at.x, first.y + at.y) : vec4(0.0);
    }
}

void stage_fetched() {
    [[unroll]] for (uint i = 0u; i < STAGED_FOURS; i++) {
        uint item = thread_index() + i * PRODUCT_THREADS;
        uvec2 at = staged_four(item, A_ALONG_K == 1);
        stage_four(0u, A_ALONG_K == 1, at.x, at.y, next_a[i]);
        at = staged_four(item, B_ALONG_K == 1);
        stage_four(STAGED_HALF, B_ALONG_K == 1, at.x, at.y, next_b[i]);
    }
}
#endif

// (k, i) of a single element: neighbouring threads take what lies side by side.
uvec2 staged_element(uint item, bool along_k) {
    return along_k ? uvec2(item % STAGED_DEPTH, item / STAGED_DEPTH) : uvec2(item / SHARED_TILE, item % SHARED_TILE);
}

// The tile's rows of both operands, k_0 up to k_0 + 63, into shared memory; zeros outside. Where VECTORS is 1 they were fetched.
void stage_operands(uvec2 first, uint k_0, uvec2 size, uint k_end) {
#if K_STEP == 4
    uint vectors = VECTORS;
    if (vectors == 1u) {
        stage_fetched();
    } else
#endif
    {
        for (uint item = thread_index(); item < STAGED_DEPTH * SHARED_TILE; item += PRODUCT_THREADS) {
            uvec2 at = staged_element(item, A_ALONG_K == 1);
            bool inside = k_0 + at.x < k_end && first.x + at.y < size.x;
            stage_element(0u, at.x, at.y, inside ? operand_a(first.x + at.y, k_0 + at.x) : 0.0);
            at = staged_element(item, B_ALONG_K == 1);
            inside = k_0 + at.x < k_end && first.y + at.y < size.y;
            stage_element(STAGED_HALF, at.x, at.y, inside ? operand_b(k_0 + at.x, first.y + at.y) : 0.0);
        }
    }
}

// Begins to read what will be staged from k_0 on, where that is by whole loads; nothing from k_end on.
void fetch_next(uvec2 first, uint k_0, uvec2 size, uint k_end) {
#if K_STEP == 4
    uint vectors = VECTORS;
    if (vectors == 1u && k_0 < k_end) {
        fetch_operands(first, k_0, size, k_end);
    }
#endif
}

void product_by_shared(uint tile, uint tiles_b, uint rows, uint columns, uint k_first, uint k_end) {
    uint thread = thread_index();
    uint group = thread / 64u;
    uint a_own = thread % 64u / 8u; // in vec4
    uint b_own = thread % 8u;
    uint a_first = tile / tiles_b * SHARED_TILE;
    uint b_first = tile % tiles_b * SHARED_TILE;
    vec4 sum[4];
    for (uint r = 0u; r < 4u; r++) {
        sum[r] = vec4(0.0);
    }
    vec4 row_sum = vec4(0.0);
    fetch_next(uvec2(a_first, b_first), k_first, uvec2(rows, columns), k_end);
    for (uint k_0 = k_first; k_0 < k_end; k_0 += STAGED_DEPTH) {
        barrier();
        stage_operands(uvec2(a_first, b_first), k_0, uvec2(rows, columns), k_end);
        barrier();
        fetch_next(uvec2(a_first, b_first), k_0 + STAGED_DEPTH, uvec2(rows, columns), k_end);
        for (uint j = 0u; j < SHARED_DEPTH; j++) {
            uint k = group * SHARED_DEPTH + j;
            vec4 a = product_stage[k * SHARED_PITCH + a_own];
            vec4 b = product_stage[STAGED_HALF + k * SHARED_PITCH + b_own];
            sum[0] += a.x * b;
            sum[1] += a.y * b;
            sum[2] += a.z * b;
            sum[3] += a.w * b;
            row_sum += a;
        }
    }
    barrier();
    for (uint r = 0u; r < 4u; r++) {
        product_stage[(group * SHARED_TILE + 4u * a_own + r) * 8u + b_own] = sum[r];
    }
    if (b_own == 0u) {
        product_row_sums[group * 8u + a_own] = row_sum;
    }
    barrier();
    // 32 rows of 8 vec4: one per thread.
    vec4 total = product_stage[thread];
    for (uint g = 1u; g < SHARED_GROUPS; g++) {
        total += product_stage[g * PRODUCT_THREADS + thread];
    }
    uint a = a_first + thread / 8u;
    uint b = b_first + 4u * (thread % 8u);
    if (a < rows && b < columns) {
        store_four(a, b, columns, total);
    }
#if ROW_SUMS
    if (thread < SHARED_TILE && b_first == 0u && a_first + thread < rows) {
        float row_total = 0.0;
        for (uint g = 0u; g < SHARED_GROUPS; g++) {
            row_total += product_row_sums[g * 8u + thread / 4u][thread % 4u];
        }
        store_row_sum(a_first + thread, row_total);
    }
#endif
}

// Tile number `tile`, k in [k_first, k_end); nothing where `tile` is not below the number of tiles. In STAGE 1 every thread
// of the workgroup must call it with the same arguments.
void matrix_product(uint tile, uint rows, uint columns, uint k_first, uint k_end) {
    uint stage = STAGE;
    uvec2 tiles = product_tiles(rows, columns);
    uint end = tile < tiles.y ? k_end : k_first;
    if (stage == 0u) {
        product_by_shuffle(min(tile, tiles.y - 1u), tiles.x, rows, columns, k_first, end);
    } else if (tile < tiles.y) {
        product_by_shared(tile, tiles.x, rows, columns, k_first, k_end);
    }
}

#endif
