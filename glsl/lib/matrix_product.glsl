// C(a, b) = sum over k of A(a, k) B(k, b), one tile of C at a time, always in the same order. The includer says where the
// numbers come from and where they go (the prototypes below), and defines
//   A_ALONG_K, B_ALONG_K  1 when neighbouring k lie side by side in memory, else 0 (neighbouring a or b do);
//   ROW_SUMS              1 when the sums of A over k are wanted as well.
// It enables GL_KHR_shader_subgroup_{basic,shuffle} and has 256 threads per workgroup.
//
// STAGE 0: a tile of 32 x (8 per lane) per subgroup; each lane reads eight columns of B and its share of 32 rows of A, and
// shuffles spread the latter. For devices where a load costs the same whether or not neighbours read the same word.
// STAGE 1: a tile of 32 x 32 per workgroup, in shared memory 64 k at a time; four groups of 64 threads, each with 4 x 4
// sums, take 16 of these k each, so that small matrices still fill a GPU.
#ifndef SPGS_MATRIX_PRODUCT
#define SPGS_MATRIX_PRODUCT

#include "thread.glsl"

// Never called with a, b or k outside the matrices.
float operand_a(uint a, uint k);
float operand_b(uint k, uint b);
void store_element(uint a, uint b, float value);
#if ROW_SUMS
void store_row_sum(uint a, float value);
#endif

const uint PRODUCT_THREADS = 256u;
const uint SHUFFLE_ROWS = 32u;
const uint SHUFFLE_COLUMNS = 8u; // per lane
const uint SHUFFLE_TILES = 4u;   // per workgroup, if it has as many subgroups
const uint SHARED_TILE = 32u;
const uint SHARED_GROUPS = 4u; // of 64 threads
const uint SHARED_DEPTH = 16u; // k per group and round
const uint SHARED_PITCH = 9u;  // vec4 per k: 8 and one to spread the banks

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
    uint per_group = min(SHUFFLE_TILES, PRODUCT_THREADS / size);
    uint unused = gl_SubgroupID < per_group ? 0u : 0x40000000u; // past every tile
    return stage == 0u ? workgroup_index() * per_group + gl_SubgroupID + unused : workgroup_index();
}

// Written out, because compilers leave a loop this long as it is and then keep the sums in memory.
#define FOUR_ROWS(row, r) row((r)) row((r) + 1u) row((r) + 2u) row((r) + 3u)
#define SIXTEEN_ROWS(row, r) FOUR_ROWS(row, r) FOUR_ROWS(row, r + 4u) FOUR_ROWS(row, r + 8u) FOUR_ROWS(row, r + 12u)
#define EACH_ROW(row) SIXTEEN_ROWS(row, 0u) SIXTEEN_ROWS(row, 16u)
#define CLEAR_ROW(r) sum[2u * (r)] = vec4(0.0); sum[2u * (r) + 1u] = vec4(0.0);
#define ADD_ROW(r) \
    sum[2u * (r)] += subgroupShuffle(own[(r) / size], (r) % size) * b_0; \
    sum[2u * (r) + 1u] += subgroupShuffle(own[(r) / size], (r) % size) * b_1;
#define STORE_ROW(r) \
    store_elements(used && a_first + (r) < rows, a_first + (r), b_first, columns, sum[2u * (r)]); \
    store_elements(used && a_first + (r) < rows, a_first + (r), b_first + 4u, columns, sum[2u * (r) + 1u]);

void store_elements(bool used, uint a, uint b, uint columns, vec4 values) {
    for (uint c = 0u; c < 4u; c++) {
        if (used && b + c < columns) {
            store_element(a, b + c, values[c]);
        }
    }
}

void product_by_shuffle(uint tile, uint tiles_b, uint rows, uint columns, uint k_first, uint k_end) {
    uint size = SUBGROUP_SIZE;
    uint lane = gl_SubgroupInvocationID;
    uint a_first = tile / tiles_b * SHUFFLE_ROWS;
    uint b_first = (tile % tiles_b * size + lane) * SHUFFLE_COLUMNS;
    vec4 sum[SHUFFLE_ROWS * 2u];
    EACH_ROW(CLEAR_ROW)
    // Rows i·size + lane of A; subgroups of 32 and more need one, of 4 all eight.
    float own[8];
    float row_sum[8];
    for (uint i = 0u; i < 8u; i++) {
        row_sum[i] = 0.0;
    }
    for (uint k = k_first; k < k_end; k++) {
        for (uint i = 0u; i < 8u; i++) {
            own[i] = 0.0;
            if (i * size < SHUFFLE_ROWS) {
                own[i] = operand_a(min(a_first + i * size + lane % SHUFFLE_ROWS, rows - 1u), k);
                row_sum[i] += own[i];
            }
        }
        vec4 b_0 = vec4(0.0);
        vec4 b_1 = vec4(0.0);
        for (uint c = 0u; c < 4u; c++) {
            b_0[c] = operand_b(k, min(b_first + c, columns - 1u));
            b_1[c] = operand_b(k, min(b_first + 4u + c, columns - 1u));
        }
        EACH_ROW(ADD_ROW)
    }
    bool used = k_first < k_end;
    EACH_ROW(STORE_ROW)
#if ROW_SUMS
    for (uint i = 0u; i < 8u; i++) {
        uint r = i * size + lane;
        if (used && r < SHUFFLE_ROWS && tile % tiles_b == 0u && a_first + r < rows) {
            store_row_sum(a_first + r, row_sum[i]);
        }
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
    const uint DEPTH = SHARED_GROUPS * SHARED_DEPTH;
    const uint HALF = DEPTH * SHARED_PITCH;
    vec4 sum[4];
    for (uint r = 0u; r < 4u; r++) {
        sum[r] = vec4(0.0);
    }
    vec4 row_sum = vec4(0.0);
    for (uint k_0 = k_first; k_0 < k_end; k_0 += DEPTH) {
        barrier();
        for (uint item = thread; item < DEPTH * SHARED_TILE; item += PRODUCT_THREADS) {
            uint along_k = item % DEPTH;
            uint across = item / DEPTH;
            uint across_first = item % SHARED_TILE;
            uint k_after = item / SHARED_TILE;
            uint k = A_ALONG_K == 1 ? along_k : k_after;
            uint i = A_ALONG_K == 1 ? across : across_first;
            bool inside = k_0 + k < k_end && a_first + i < rows;
            product_stage[k * SHARED_PITCH + i / 4u][i % 4u] = inside ? operand_a(a_first + i, k_0 + k) : 0.0;
            k = B_ALONG_K == 1 ? along_k : k_after;
            i = B_ALONG_K == 1 ? across : across_first;
            inside = k_0 + k < k_end && b_first + i < columns;
            product_stage[HALF + k * SHARED_PITCH + i / 4u][i % 4u] = inside ? operand_b(k_0 + k, b_first + i) : 0.0;
        }
        barrier();
        for (uint j = 0u; j < SHARED_DEPTH; j++) {
            uint k = group * SHARED_DEPTH + j;
            vec4 a = product_stage[k * SHARED_PITCH + a_own];
            vec4 b = product_stage[HALF + k * SHARED_PITCH + b_own];
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
    for (uint c = 0u; c < 4u; c++) {
        uint b = b_first + 4u * (thread % 8u) + c;
        if (a < rows && b < columns) {
            store_element(a, b, total[c]);
        }
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
