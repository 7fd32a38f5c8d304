// SPDX-License-Identifier: Apache-2.0
// What the runs of a parameter block add up to, in the order of the runs: one work-group a block.
// A block is `size` scalars of the F side from `offset`, found in a run's sums from column `column`:
// 0 for an image's block, 6 for the intrinsics of a shared camera. Blocks are those of a chunk, segment
// by segment; its runs are counted in its segment.
#define LANE_WIDTH 8
#include "lanes.clh"

#ifndef RUN_REAL
#define RUN_REAL float  // type of the sums of a run
#endif
#ifndef RUN_PARTS
#define RUN_PARTS 1  // sums of as many vectors
#endif
#ifndef COLUMNS
#define COLUMNS 9
#endif
#define TRIANGLE (COLUMNS * (COLUMNS + 1) / 2)

// y[offset + k] += sum over the block's runs of their sums of the part, which has block_columns numbers
// a run; those of the segment begin at RUN_PARTS * first_sum.
// Writers: group b alone writes block b of y.
KERNEL void reduce_runs(global const int* restrict block_offset,
                        global const int* restrict block_size,
                        global const int* restrict block_column,
                        global const int* restrict block_columns,
                        global const int* restrict first_sum,
                        global const int* restrict block_runs,  // first of each block, and end
                        global const int* restrict runs, int part,
                        global const RUN_REAL* restrict run_sums, global WIDE* restrict y) {
    const int block = get_group_id(0);
    const int offset = block_offset[block], size = block_size[block];
    const int columns = block_columns[block];
    const int begin = block_runs[block], end = block_runs[block + 1];
    global const RUN_REAL* sums =
        run_sums + RUN_PARTS * (long)first_sum[block] + part * columns + block_column[block];
    LANES_UNVECTORIZED(k, 0, size) {
        WIDE sum = y[offset + k];
        for (int i = begin; i < end; ++i) sum += sums[RUN_PARTS * columns * (long)runs[i] + k];
        y[offset + k] = sum;
    }
}

// The same for the lower triangles of run_blocks, into the packed lower triangle at matrix_offset.
// Blocks are those of one segment, from first_block.
// Writers: group b alone writes the matrix of its block.
KERNEL void reduce_run_blocks(int first_block, global const int* restrict block_size,
                              global const int* restrict block_column,
                              global const int* restrict block_runs,
                              global const int* restrict runs,
                              global const int* restrict matrix_offset,
                              global const REAL* restrict run_blocks,
                              global WIDE* restrict matrices) {
    const int block = first_block + get_group_id(0);
    const int size = block_size[block], column = block_column[block];
    const int begin = block_runs[block], end = block_runs[block + 1];
    global WIDE* out = matrices + matrix_offset[block];
    for (int row = 0; row < size; ++row) {
        const int from = (column + row) * (column + row + 1) / 2 + column;
        const int to = row * (row + 1) / 2;
        LANES_UNVECTORIZED(k, 0, row + 1) {
            WIDE sum = out[to + k];
            for (int i = begin; i < end; ++i)
                sum += (WIDE)run_blocks[(long)TRIANGLE * runs[i] + from + k];
            out[to + k] = sum;
        }
    }
}
