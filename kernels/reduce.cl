// SPDX-License-Identifier: Apache-2.0
// What the runs of a parameter block add up to, in the order of the runs: one work-group a block.
// A block is `size` scalars of the F side from `offset`, found in a run's sums from column `first`:
// 0 for an image's block, 6 for the intrinsics of a shared camera.
#define LANE_WIDTH 8
#include "lanes.clh"

#ifndef RUN_REAL
#define RUN_REAL float  // type of the sums of a run
#endif
#ifndef RUN_VALUES
#define RUN_VALUES 9  // sums a run
#endif
#ifndef COLUMNS
#define COLUMNS 9
#endif
#define TRIANGLE (COLUMNS * (COLUMNS + 1) / 2)

// y[offset + k] += sum over the block's runs of run_sums[run][first_value + first + k].
// Writers: group b alone writes block b of y.
KERNEL void reduce_runs(global const int* restrict block_offset,
                        global const int* restrict block_size,
                        global const int* restrict block_column,
                        global const int* restrict block_runs,  // first of each block, and end
                        global const int* restrict runs, int first_value,
                        global const RUN_REAL* restrict run_sums, global WIDE* restrict y) {
    const int block = get_group_id(0);
    const int offset = block_offset[block], size = block_size[block];
    const int column = first_value + block_column[block];
    const int begin = block_runs[block], end = block_runs[block + 1];
    LANES_UNVECTORIZED(k, 0, size) {
        WIDE sum = y[offset + k];
        for (int i = begin; i < end; ++i) sum += run_sums[RUN_VALUES * (long)runs[i] + column + k];
        y[offset + k] = sum;
    }
}

// The same for the lower triangles of run_blocks, into the packed lower triangle at matrix_offset.
// Writers: group b alone writes the matrix of block b.
KERNEL void reduce_run_blocks(global const int* restrict block_size,
                              global const int* restrict block_column,
                              global const int* restrict block_runs,
                              global const int* restrict runs,
                              global const int* restrict matrix_offset,
                              global const REAL* restrict run_blocks,
                              global WIDE* restrict matrices) {
    const int block = get_group_id(0);
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
