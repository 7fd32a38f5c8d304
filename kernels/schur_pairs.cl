// SPDX-License-Identifier: Apache-2.0
// Sums over pairs of observations, from the records of schur_complement.cl: each lane has blocks of
// its own, whose rows are vectors of 16 columns.
#include "lanes.clh"

#define JOIN_AGAIN(a, b) a##b
#define JOIN(a, b) JOIN_AGAIN(a, b)
typedef JOIN(WIDE, 16) wide16;
#define CONVERT_WIDE16 JOIN(convert_, JOIN(WIDE, 16))
#ifndef MAX_COLUMNS
#define MAX_COLUMNS 9  // of any image block
#endif
#define BLOCKS_PER_GROUP 16

// blocks[block_offset ...] += the block's sum: rows x columns, row-major.
// Writers: one block each.
KERNEL void schur_pairs(int num_blocks, global const int* restrict block_rows,
                        global const int* restrict block_columns,
                        global const long* restrict block_offset,
                        global const long* restrict block_pairs,  // first of each block, and end
                        global const int2* restrict pairs,        // records a and b
                        global const REAL* restrict image_records,
                        global const WIDE* restrict point_records, global WIDE* restrict blocks) {
    const int begin = BLOCKS_PER_GROUP * (int)get_group_id(0);
    const int end = min(num_blocks, begin + BLOCKS_PER_GROUP);
    LANES_UNVECTORIZED(block, begin, end) {
        wide16 sum[MAX_COLUMNS];
#pragma unroll
        for (int k = 0; k < MAX_COLUMNS; ++k) sum[k] = 0;
        const long pairs_end = block_pairs[block + 1];
        for (long pair = block_pairs[block]; pair < pairs_end; ++pair) {
            const int a = pairs[pair].x, b = pairs[pair].y;
            global const REAL* f = image_records + 32 * (long)a;
            global const REAL* f_b = image_records + 32 * (long)b;
            global const WIDE* p = point_records + 8 * (long)a;
            global const WIDE* p_b = point_records + 8 * (long)b;
            const WIDE same = a == b ? 1 : 0;
            const WIDE m00 = same - (p[0] * p_b[0] + p[1] * p_b[1] + p[2] * p_b[2]);
            const WIDE m01 = -(p[0] * p_b[3] + p[1] * p_b[4] + p[2] * p_b[5]);
            const WIDE m10 = -(p[3] * p_b[0] + p[4] * p_b[1] + p[5] * p_b[2]);
            const WIDE m11 = same - (p[3] * p_b[3] + p[4] * p_b[4] + p[5] * p_b[5]);
            const wide16 j0 = CONVERT_WIDE16(vload16(0, f_b));
            const wide16 j1 = CONVERT_WIDE16(vload16(1, f_b));
            const wide16 v0 = m00 * j0 + m01 * j1;
            const wide16 v1 = m10 * j0 + m11 * j1;
#pragma unroll
            for (int k = 0; k < MAX_COLUMNS; ++k) sum[k] += (WIDE)f[k] * v0 + (WIDE)f[16 + k] * v1;
        }
        global WIDE* out = blocks + block_offset[block];
        const int columns = block_columns[block];
#pragma unroll
        for (int k = 0; k < MAX_COLUMNS; ++k) {
            WIDE row[16];
            vstore16(sum[k], 0, row);
            if (k < block_rows[block])
                for (int c = 0; c < columns; ++c) out[k * columns + c] += row[c];
        }
    }
}
