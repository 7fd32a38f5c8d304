// SPDX-License-Identifier: Apache-2.0
// Sums over pairs of observations, from their records: each lane has blocks of
// its own, whose rows are vectors of 16 columns, and of 4 more where any block has more than 16.
#include "lanes.clh"
#include "schur_records.clh"

#define JOIN_AGAIN(a, b) a##b
#define JOIN(a, b) JOIN_AGAIN(a, b)
typedef JOIN(WIDE, 16) wide16;
#define CONVERT_WIDE16 JOIN(convert_, JOIN(WIDE, 16))
#define MORE_COLUMNS (MAX_COLUMNS > 16)
#if MORE_COLUMNS
typedef JOIN(WIDE, 4) wide4;
#define CONVERT_WIDE4 JOIN(convert_, JOIN(WIDE, 4))
#endif
#define BLOCKS_PER_GROUP 16

// Records lie where the tiles put them: their addresses are known long before they are needed.
#define PAIRS_AHEAD 6

// values[block_offset ...] += the sum of each of the blocks: rows x columns, row-major.
// Writers: one block each.
KERNEL void schur_pairs(int num_blocks, global const int* restrict blocks,
                        global const int* restrict block_rows,
                        global const int* restrict block_columns,
                        global const long* restrict block_offset,
                        global const long* restrict block_pairs,  // first of each of `blocks`, and end
                        global const int2* restrict pairs,        // records a and b
                        global const char* restrict records, global WIDE* restrict values) {
    const int begin = BLOCKS_PER_GROUP * (int)get_group_id(0);
    const int end = min(num_blocks, begin + BLOCKS_PER_GROUP);
    LANES_UNVECTORIZED(entry, begin, end) {
        wide16 sum[MAX_COLUMNS];
#pragma unroll
        for (int k = 0; k < MAX_COLUMNS; ++k) sum[k] = 0;
#if MORE_COLUMNS
        wide4 more[MAX_COLUMNS];
#pragma unroll
        for (int k = 0; k < MAX_COLUMNS; ++k) more[k] = 0;
#endif
        const long pairs_end = block_pairs[entry + 1];
        for (long pair = block_pairs[entry]; pair < pairs_end; ++pair) {
            const int a = pairs[pair].x, b = pairs[pair].y;
            global const char* record_a = records + RECORD_BYTES * (long)a;
            global const char* record_b = records + RECORD_BYTES * (long)b;
            global const REAL* f = (global const REAL*)record_a;
            global const REAL* f_b = (global const REAL*)record_b;
            global const WIDE* p = (global const WIDE*)(record_a + POINT_OFFSET);
            global const WIDE* p_b = (global const WIDE*)(record_b + POINT_OFFSET);
            const int2 ahead = pairs[min(pair + PAIRS_AHEAD, pairs_end - 1)];
            fetch(records + RECORD_BYTES * (long)ahead.x, RECORD_BYTES);
            fetch(records + RECORD_BYTES * (long)ahead.y, RECORD_BYTES);
            const WIDE same = a == b ? 1 : 0;
            const WIDE m00 = same - (p[0] * p_b[0] + p[1] * p_b[1] + p[2] * p_b[2]);
            const WIDE m01 = -(p[0] * p_b[3] + p[1] * p_b[4] + p[2] * p_b[5]);
            const WIDE m10 = -(p[3] * p_b[0] + p[4] * p_b[1] + p[5] * p_b[2]);
            const WIDE m11 = same - (p[3] * p_b[3] + p[4] * p_b[4] + p[5] * p_b[5]);
            // Columns past the last hold other numbers, and end in columns that are not written.
            const wide16 j0 = CONVERT_WIDE16(vload16(0, f_b));
            const wide16 j1 = CONVERT_WIDE16(vload16(0, f_b + MAX_COLUMNS));
            const wide16 v0 = m00 * j0 + m01 * j1;
            const wide16 v1 = m10 * j0 + m11 * j1;
#pragma unroll
            for (int k = 0; k < MAX_COLUMNS; ++k) {
                sum[k] += (WIDE)f[k] * v0;
                sum[k] += (WIDE)f[MAX_COLUMNS + k] * v1;
            }
#if MORE_COLUMNS
            const wide4 more_j0 = CONVERT_WIDE4(vload4(0, f_b + 16));
            const wide4 more_j1 = CONVERT_WIDE4(vload4(0, f_b + MAX_COLUMNS + 16));
            const wide4 more_v0 = m00 * more_j0 + m01 * more_j1;
            const wide4 more_v1 = m10 * more_j0 + m11 * more_j1;
#pragma unroll
            for (int k = 0; k < MAX_COLUMNS; ++k) {
                more[k] += (WIDE)f[k] * more_v0;
                more[k] += (WIDE)f[MAX_COLUMNS + k] * more_v1;
            }
#endif
        }
        const int block = blocks[entry];
        global WIDE* out = values + block_offset[block];
        const int columns = block_columns[block];
#pragma unroll
        for (int k = 0; k < MAX_COLUMNS; ++k) {
            WIDE row[MORE_COLUMNS ? 20 : 16];
            vstore16(sum[k], 0, row);
#if MORE_COLUMNS
            vstore4(more[k], 4, row);
#endif
            if (k < block_rows[block])
                for (int c = 0; c < columns; ++c) out[k * columns + c] += row[c];
        }
    }
}
