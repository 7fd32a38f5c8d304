// SPDX-License-Identifier: Apache-2.0
// Diagonal blocks from the stored Jacobian (layout in jacobian.cl): one work-group a tile.
#define LANE_WIDTH 8
#include "lanes.clh"

#ifndef COLUMNS
#define COLUMNS 9  // C: 6 + intrinsics of the camera model
#endif
#define ROWS (2 * COLUMNS + 6)
#define TRIANGLE (COLUMNS * (COLUMNS + 1) / 2)

// V = sum J_E^T J_E of each point, added to 6 rows: xx, yx, yy, zx, zy, zz.
// Writers: group t alone writes V of its points.
KERNEL void point_blocks(global const int* restrict tile_points,
                         global const int* restrict tile_runs,
                         global const int* restrict run_slots,
                         global const ushort* restrict slot_point,
                         global const REAL* restrict blocks, int num_point_slots,
                         global double* restrict v) {
    const int tile = get_group_id(0);
    global double* v00 = v + tile_points[tile];
    global double* v10 = v00 + num_point_slots;
    global double* v11 = v10 + num_point_slots;
    global double* v20 = v11 + num_point_slots;
    global double* v21 = v20 + num_point_slots;
    global double* v22 = v21 + num_point_slots;
    for (int run = tile_runs[tile]; run < tile_runs[tile + 1]; ++run) {
        const int first = run_slots[run];
        const int n = run_length(first, run_slots[run + 1]);
        global const ushort* point = slot_point + first;
        global const REAL* j_e = blocks + ROWS * (long)first + 2 * COLUMNS * n;
        LANES_MEET();
        LANES(l, 0, n) {
            const int i = point[l];
            const double e0 = j_e[l], e1 = j_e[n + l], e2 = j_e[2 * n + l];
            const double h0 = j_e[3 * n + l], h1 = j_e[4 * n + l], h2 = j_e[5 * n + l];
            v00[i] += e0 * e0 + h0 * h0;
            v10[i] += e1 * e0 + h1 * h0;
            v11[i] += e1 * e1 + h1 * h1;
            v20[i] += e2 * e0 + h2 * h0;
            v21[i] += e2 * e1 + h2 * h1;
            v22[i] += e2 * e2 + h2 * h2;
        }
    }
}

// M = I - J_E V^-1 J_E^T of each observation, with V^-1 = G^T G: 3 rows m00, m10, m11 of each run's
// slots. These weigh the image blocks of the Schur complement's diagonal.
// Writers: group t alone writes the slots of its runs.
KERNEL void schur_weights(global const int* restrict tile_points,
                          global const int* restrict tile_runs,
                          global const int* restrict run_slots,
                          global const ushort* restrict slot_point,
                          global const REAL* restrict blocks, int num_point_slots,
                          global const REAL* restrict point_factors,
                          global REAL* restrict weights) {
    const int tile = get_group_id(0);
    global const REAL* g = point_factors + tile_points[tile];
    for (int run = tile_runs[tile]; run < tile_runs[tile + 1]; ++run) {
        const int first = run_slots[run];
        const int n = run_length(first, run_slots[run + 1]);
        global const ushort* point = slot_point + first;
        global const REAL* j_e = blocks + ROWS * (long)first + 2 * COLUMNS * n;
        global REAL* out = weights + 3 * (long)first;
        LANES(l, 0, n) {
            const int i = point[l];
            const double g00 = g[i], g10 = g[num_point_slots + i], g11 = g[2 * num_point_slots + i];
            const double g20 = g[3 * num_point_slots + i], g21 = g[4 * num_point_slots + i];
            const double g22 = g[5 * num_point_slots + i];
            const double e0 = j_e[l], e1 = j_e[n + l], e2 = j_e[2 * n + l];
            const double h0 = j_e[3 * n + l], h1 = j_e[4 * n + l], h2 = j_e[5 * n + l];
            // Rows of J_E G^T.
            const double a0 = g00 * e0, a1 = g10 * e0 + g11 * e1;
            const double a2 = g20 * e0 + g21 * e1 + g22 * e2;
            const double b0 = g00 * h0, b1 = g10 * h0 + g11 * h1;
            const double b2 = g20 * h0 + g21 * h1 + g22 * h2;
            out[l] = (REAL)(1 - (a0 * a0 + a1 * a1 + a2 * a2));
            out[n + l] = (REAL)(-(a0 * b0 + a1 * b1 + a2 * b2));
            out[2 * n + l] = (REAL)(1 - (b0 * b0 + b1 * b1 + b2 * b2));
        }
    }
}

// Sums of J_F^T M J_F over each run, with M = I where weights is NULL: TRIANGLE doubles a run, the
// lower triangle row by row. A pass over the run for each 3 x 3 part, so that its sums stay in
// registers while the run's Jacobian stays in the cache.
// Writers: group t alone writes the sums of its runs.
#define PART 3
KERNEL void image_blocks(global const int* restrict tile_runs,
                         global const int* restrict run_slots,
                         global const REAL* restrict blocks, global const REAL* restrict weights,
                         global double* restrict run_blocks, local double* scratch) {
    const int tile = get_group_id(0);
    for (int run = tile_runs[tile]; run < tile_runs[tile + 1]; ++run) {
        const int first = run_slots[run];
        const int n = run_length(first, run_slots[run + 1]);
        global const REAL* top = blocks + ROWS * (long)first;
        global const REAL* bottom = top + COLUMNS * n;
        global const REAL* m = weights ? weights + 3 * (long)first : 0;
        global double* out = run_blocks + TRIANGLE * (long)run;
        int row = 0, column = 0;
        do {
            // Rows of the Jacobian for the part's rows and columns; past the last one, the last.
            int at_row[PART], at_column[PART];
#pragma unroll
            for (int k = 0; k < PART; ++k) {
                at_row[k] = min(row + k, COLUMNS - 1) * n;
                at_column[k] = min(column + k, COLUMNS - 1) * n;
            }
            double sum[PART * PART];
#pragma unroll
            for (int k = 0; k < PART * PART; ++k) sum[k] = 0;
            if (m) {
                LANES(l, 0, n) {
                    const double m00 = m[l], m10 = m[n + l], m11 = m[2 * n + l];
                    double a[PART], b[PART];
#pragma unroll
                    for (int k = 0; k < PART; ++k) {
                        const double j0 = top[at_row[k] + l], j1 = bottom[at_row[k] + l];
                        a[k] = m00 * j0 + m10 * j1;
                        b[k] = m10 * j0 + m11 * j1;
                    }
#pragma unroll
                    for (int k = 0; k < PART; ++k) {
                        const double j0 = top[at_column[k] + l], j1 = bottom[at_column[k] + l];
                        sum[k] += a[0] * j0 + b[0] * j1;
                        sum[PART + k] += a[1] * j0 + b[1] * j1;
                        sum[2 * PART + k] += a[2] * j0 + b[2] * j1;
                    }
                }
            } else {
                LANES(l, 0, n) {
                    double a[PART], b[PART];
#pragma unroll
                    for (int k = 0; k < PART; ++k) {
                        a[k] = top[at_row[k] + l];
                        b[k] = bottom[at_row[k] + l];
                    }
#pragma unroll
                    for (int k = 0; k < PART; ++k) {
                        const double j0 = top[at_column[k] + l], j1 = bottom[at_column[k] + l];
                        sum[k] += a[0] * j0 + b[0] * j1;
                        sum[PART + k] += a[1] * j0 + b[1] * j1;
                        sum[2 * PART + k] += a[2] * j0 + b[2] * j1;
                    }
                }
            }
#pragma unroll
            for (int k = 0; k < PART * PART; ++k) {
                const double total = GROUP_SUM(sum[k], scratch);
                const int i = row + k / PART, j = column + k % PART;
                if (IS_FIRST_LANE && i < COLUMNS && j <= i) out[i * (i + 1) / 2 + j] = total;
            }
            column += PART;
            if (column > row) {
                column = 0;
                row += PART;
            }
        } while (row < COLUMNS);
    }
}
