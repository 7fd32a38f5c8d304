// SPDX-License-Identifier: Apache-2.0
// Blocks from the Jacobian (jacobian.clh): one work-group a tile.
#include "lanes.clh"
#include "tiles.clh"
#include "jacobian.clh"

#define TRIANGLE (COLUMNS * (COLUMNS + 1) / 2)
// Slots whose rows are held at a time: of doubles too they fit 32 KiB, which every device has.
#define PIECE (COLUMNS > 14 ? 64 : 128)
#define PART 3

// Sums of J_F^T M J_F over each run: TRIANGLE numbers a run, the lower triangle row by row. M = I
// where point_factors is NULL; else M = I - J_E V^-1 J_E^T with V^-1 = G^T G, which makes the diagonal
// blocks of the Schur complement. M is positive semidefinite and is taken apart as K^T K, so that
// the sums are positive semidefinite whatever the rounding. A pass over the rows K J_F of a piece for
// each 3 x 3 part, so that its sums stay in registers.
// Writers: group t alone writes the sums of its runs.
KERNEL void image_blocks(TILES, global const WIDE* restrict images,
                         global const REAL* restrict rows,
                         global const REAL* restrict point_factors,  // 6 rows, or NULL
                         global REAL* restrict run_blocks, local WIDE* scratch) {
    local REAL kept[2 * COLUMNS * PIECE];
    const int tile = get_group_id(0);
    global const REAL* g = point_factors + (point_factors ? tile_points[tile] : 0);
    const bool is_schur = point_factors != 0;
    for (int run = tile_runs[tile]; run < tile_runs[tile + 1]; ++run) {
        const int first = run_slots[run];
        const int n = run_length(first, run_slots[run + 1]);
        const run_t shared = load_run(rows, first, n, images + IMAGE_RECORD * run_image[run]);
        global const ushort* point = slot_point + first;
        WIDE total[TRIANGLE];
        for (int k = 0; k < TRIANGLE; ++k) total[k] = 0;
        for (int begin = 0; begin < n; begin += PIECE) {
            const int size = run_length(begin, min(n, begin + PIECE));
            LANES_MEET();
            if (is_schur) {
                LANES(l, 0, size) {
                    const jacobian_t j = load_jacobian(&shared, begin + l);
                    REAL f[2 * COLUMNS], e[6];
                    image_rows(&j, f);
                    point_rows(&shared, &j, e);
                    const int i = point[begin + l];
                    const REAL g00 = g[i], g10 = g[num_point_slots + i];
                    const REAL g11 = g[2 * num_point_slots + i], g20 = g[3 * num_point_slots + i];
                    const REAL g21 = g[4 * num_point_slots + i], g22 = g[5 * num_point_slots + i];
                    // Rows of J_E G^T.
                    const REAL a0 = g00 * e[0], a1 = g10 * e[0] + g11 * e[1];
                    const REAL a2 = g20 * e[0] + g21 * e[1] + g22 * e[2];
                    const REAL b0 = g00 * e[3], b1 = g10 * e[3] + g11 * e[4];
                    const REAL b2 = g20 * e[3] + g21 * e[4] + g22 * e[5];
                    const REAL m00 = 1 - (a0 * a0 + a1 * a1 + a2 * a2);
                    const REAL m10 = -(a0 * b0 + a1 * b1 + a2 * b2);
                    const REAL m11 = 1 - (b0 * b0 + b1 * b1 + b2 * b2);
                    // K = [k00, k01; 0, k11] with K^T K = M.
                    const REAL k00 = sqrt(fmax(m00, (REAL)0));
                    const REAL k01 = k00 > 0 ? m10 / k00 : (REAL)0;
                    const REAL k11 = sqrt(fmax(m11 - k01 * k01, (REAL)0));
#pragma unroll
                    for (int k = 0; k < COLUMNS; ++k) {
                        kept[k * PIECE + l] = k00 * f[k] + k01 * f[COLUMNS + k];
                        kept[(COLUMNS + k) * PIECE + l] = k11 * f[COLUMNS + k];
                    }
                }
            } else {
                LANES(l, 0, size) {
                    const jacobian_t j = load_jacobian(&shared, begin + l);
                    REAL f[2 * COLUMNS];
                    image_rows(&j, f);
#pragma unroll
                    for (int k = 0; k < 2 * COLUMNS; ++k) kept[k * PIECE + l] = f[k];
                }
            }
            LANES_MEET();
            int row = 0, column = 0;
            do {
                // Rows of the Jacobian for the part's rows and columns; past the last one, the last.
                int at_row[PART], at_column[PART];
#pragma unroll
                for (int k = 0; k < PART; ++k) {
                    at_row[k] = min(row + k, COLUMNS - 1) * PIECE;
                    at_column[k] = min(column + k, COLUMNS - 1) * PIECE;
                }
                REAL sum[PART * PART];
#pragma unroll
                for (int k = 0; k < PART * PART; ++k) sum[k] = 0;
                LANES(l, 0, size) {
#pragma unroll
                    for (int row_of_two = 0; row_of_two < 2; ++row_of_two) {
                        local const REAL* of = kept + row_of_two * COLUMNS * PIECE + l;
                        const REAL a0 = of[at_row[0]], a1 = of[at_row[1]], a2 = of[at_row[2]];
                        const REAL b0 = of[at_column[0]], b1 = of[at_column[1]];
                        const REAL b2 = of[at_column[2]];
                        sum[0] += a0 * b0;
                        sum[1] += a0 * b1;
                        sum[2] += a0 * b2;
                        sum[3] += a1 * b0;
                        sum[4] += a1 * b1;
                        sum[5] += a1 * b2;
                        sum[6] += a2 * b0;
                        sum[7] += a2 * b1;
                        sum[8] += a2 * b2;
                    }
                }
#pragma unroll
                for (int k = 0; k < PART * PART; ++k) {
                    const WIDE of_piece = GROUP_SUM(sum[k], scratch);
                    const int i = row + k / PART, j = column + k % PART;
                    if (i < COLUMNS && j <= i) total[i * (i + 1) / 2 + j] += of_piece;
                }
                column += PART;
                if (column > row) {
                    column = 0;
                    row += PART;
                }
            } while (row < COLUMNS);
        }
        if (IS_FIRST_LANE)
            for (int k = 0; k < TRIANGLE; ++k)
                run_blocks[TRIANGLE * (long)run + k] = (REAL)total[k];
    }
}

// The blocks of each observation as rows of its run, in the layout of STORED 1.
// Writers: group t alone writes the slots of its runs.
KERNEL void jacobian_rows(TILES, global const WIDE* restrict images,
                          global const REAL* restrict rows, global REAL* restrict expanded) {
    const int tile = get_group_id(0);
    for (int run = tile_runs[tile]; run < tile_runs[tile + 1]; ++run) {
        const int first = run_slots[run];
        const int n = run_length(first, run_slots[run + 1]);
        const run_t shared = load_run(rows, first, n, images + IMAGE_RECORD * run_image[run]);
        global REAL* out = expanded + (2 * COLUMNS + 6) * (long)first;
        LANES(l, 0, n) {
            const jacobian_t j = load_jacobian(&shared, l);
            REAL f[2 * COLUMNS], e[6];
            image_rows(&j, f);
            point_rows(&shared, &j, e);
#pragma unroll
            for (int k = 0; k < 2 * COLUMNS; ++k) out[k * n + l] = f[k];
#pragma unroll
            for (int k = 0; k < 6; ++k) out[(2 * COLUMNS + k) * n + l] = e[k];
        }
    }
}
