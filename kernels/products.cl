// SPDX-License-Identifier: Apache-2.0
// Products with the stored Jacobian J = [J_F, J_E] (layout in jacobian.cl): one work-group a tile.
// Vectors of the F side (poses and intrinsics) are doubles, of the E side (points) 3 rows of REAL
// over the point slots. What a run adds to its image's part of an F vector goes to run_sums,
// COLUMNS a run, for reduce_runs to add up in a fixed order.
#include "lanes.clh"

#ifndef COLUMNS
#define COLUMNS 9  // C: 6 + intrinsics of the camera model
#endif
#define ROWS (2 * COLUMNS + 6)

// What a run needs of an F vector: its image's pose and its camera's intrinsics.
typedef struct {
    REAL x[COLUMNS];
} image_part_t;

static inline image_part_t load_image_part(global const double* x, int pose_offset,
                                    int intrinsics_offset) {
    image_part_t part;
#pragma unroll
    for (int k = 0; k < 6; ++k) part.x[k] = (REAL)x[pose_offset + k];
#pragma unroll
    for (int k = 6; k < COLUMNS; ++k) part.x[k] = (REAL)x[intrinsics_offset + k - 6];
    return part;
}

// J_F x of one lane.
static inline void image_product(global const REAL* blocks, int n, int l, const image_part_t* part,
                          REAL* y0, REAL* y1) {
    REAL sum0 = 0, sum1 = 0;
#pragma unroll
    for (int k = 0; k < COLUMNS; ++k) {
        sum0 += blocks[k * n + l] * part->x[k];
        sum1 += blocks[(COLUMNS + k) * n + l] * part->x[k];
    }
    *y0 = sum0;
    *y1 = sum1;
}

// y = J_F x_F + J_E x_E.
// Writers: group t alone writes y in the slots of its runs: run by run, 2 rows of its slots.
KERNEL void jx(global const int* restrict tile_points, global const int* restrict tile_runs,
               global const int* restrict run_image, global const int* restrict run_slots,
               global const ushort* restrict slot_point, global const int* restrict pose_offsets,
               global const int* restrict intrinsics_offsets, global const REAL* restrict blocks,
               global const double* restrict x_f, int num_point_slots,
               global const REAL* restrict x_e, global REAL* restrict y) {
    const int tile = get_group_id(0);
    global const REAL* xe0 = x_e + tile_points[tile];
    global const REAL* xe1 = xe0 + num_point_slots;
    global const REAL* xe2 = xe1 + num_point_slots;
    for (int run = tile_runs[tile]; run < tile_runs[tile + 1]; ++run) {
        const int image = run_image[run];
        const int first = run_slots[run];
        const int n = run_length(first, run_slots[run + 1]);
        const image_part_t part =
            load_image_part(x_f, pose_offsets[image], intrinsics_offsets[image]);
        global const ushort* point = slot_point + first;
        global const REAL* j_f = blocks + ROWS * (long)first;
        global const REAL* j_e = j_f + 2 * COLUMNS * n;
        global REAL* out = y + 2 * (long)first;
        LANES(l, 0, n) {
            const int i = point[l];
            const REAL e0 = xe0[i], e1 = xe1[i], e2 = xe2[i];
            REAL y0, y1;
            image_product(j_f, n, l, &part, &y0, &y1);
            out[l] = y0 + j_e[l] * e0 + j_e[n + l] * e1 + j_e[2 * n + l] * e2;
            out[n + l] = y1 + j_e[3 * n + l] * e0 + j_e[4 * n + l] * e1 + j_e[5 * n + l] * e2;
        }
    }
}

// x_F = J_F^T y as run_sums, and x_E += J_E^T y.
// Writers: group t alone writes the sums of its runs and x_E of its points.
KERNEL void jty(global const int* restrict tile_points, global const int* restrict tile_runs,
                global const int* restrict run_slots, global const ushort* restrict slot_point,
                global const REAL* restrict blocks, global const REAL* restrict y,
                int num_point_slots, global REAL* restrict x_e, global REAL* restrict run_sums,
                local double* scratch) {
    const int tile = get_group_id(0);
    global REAL* xe0 = x_e + tile_points[tile];
    global REAL* xe1 = xe0 + num_point_slots;
    global REAL* xe2 = xe1 + num_point_slots;
    for (int run = tile_runs[tile]; run < tile_runs[tile + 1]; ++run) {
        const int first = run_slots[run];
        const int n = run_length(first, run_slots[run + 1]);
        global const ushort* point = slot_point + first;
        global const REAL* j_f = blocks + ROWS * (long)first;
        global const REAL* j_e = j_f + 2 * COLUMNS * n;
        global const REAL* in = y + 2 * (long)first;
        REAL sum[COLUMNS];
#pragma unroll
        for (int k = 0; k < COLUMNS; ++k) sum[k] = 0;
        LANES_MEET();
        LANES(l, 0, n) {
            const int i = point[l];
            const REAL y0 = in[l], y1 = in[n + l];
#pragma unroll
            for (int k = 0; k < COLUMNS; ++k)
                sum[k] += j_f[k * n + l] * y0 + j_f[(COLUMNS + k) * n + l] * y1;
            xe0[i] += j_e[l] * y0 + j_e[3 * n + l] * y1;
            xe1[i] += j_e[n + l] * y0 + j_e[4 * n + l] * y1;
            xe2[i] += j_e[2 * n + l] * y0 + j_e[5 * n + l] * y1;
        }
#pragma unroll
        for (int k = 0; k < COLUMNS; ++k) {
            const REAL total = (REAL)GROUP_SUM(sum[k], scratch);
            if (IS_FIRST_LANE) run_sums[COLUMNS * run + k] = total;
        }
    }
}

// (J_F^T J_F - W V^-1 W^T) x as run_sums, with W = J_F^T J_E and V^-1 = G^T G, in the stages
//   1  u = 0                        over the tile's points
//   2  u += J_E^T J_F x             over its runs
//   4  u <- V^-1 u                  over its points
//   8  sums of J_F^T (J_F x - J_E u)  over its runs
// which one launch does all at once, unless runs of several camera models share the points: then
// stages 1 to 4 must have seen all of them before stage 8.
// Writers: group t alone writes u of its points and the sums of its runs.
KERNEL void schur_product(int stages, global const int* restrict tile_points,
                          global const int* restrict tile_num_points,
                          global const int* restrict tile_runs,
                          global const int* restrict run_image,
                          global const int* restrict run_slots,
                          global const ushort* restrict slot_point,
                          global const int* restrict pose_offsets,
                          global const int* restrict intrinsics_offsets,
                          global const REAL* restrict blocks, global const double* restrict x_f,
                          int num_point_slots,
                          global const REAL* restrict point_factors,  // G, 6 rows
                          global REAL* restrict u, global REAL* restrict run_sums,
                          local double* scratch) {
    const int tile = get_group_id(0);
    const int num_points = tile_num_points[tile];
    global REAL* u0 = u + tile_points[tile];
    global REAL* u1 = u0 + num_point_slots;
    global REAL* u2 = u1 + num_point_slots;
    if (stages & 1) {
        LANES(i, 0, num_points) {
            u0[i] = 0;
            u1[i] = 0;
            u2[i] = 0;
        }
    }
    // Barriers stand outside of the stages: PoCL doubles all code behind one that may be passed by.
    const int forward_end = stages & 2 ? tile_runs[tile + 1] : tile_runs[tile];
    for (int run = tile_runs[tile]; run < forward_end; ++run) {
        const int image = run_image[run];
        const int first = run_slots[run];
        const int n = run_length(first, run_slots[run + 1]);
        const image_part_t part =
            load_image_part(x_f, pose_offsets[image], intrinsics_offsets[image]);
        global const ushort* point = slot_point + first;
        global const REAL* j_f = blocks + ROWS * (long)first;
        global const REAL* j_e = j_f + 2 * COLUMNS * n;
        LANES_MEET();
        LANES(l, 0, n) {
            const int i = point[l];
            REAL y0, y1;
            image_product(j_f, n, l, &part, &y0, &y1);
            u0[i] += j_e[l] * y0 + j_e[3 * n + l] * y1;
            u1[i] += j_e[n + l] * y0 + j_e[4 * n + l] * y1;
            u2[i] += j_e[2 * n + l] * y0 + j_e[5 * n + l] * y1;
        }
    }
    LANES_MEET();
    if (stages & 4) {
        global const REAL* g = point_factors + tile_points[tile];
        LANES(i, 0, num_points) {
            const REAL g00 = g[i], g10 = g[num_point_slots + i], g11 = g[2 * num_point_slots + i];
            const REAL g20 = g[3 * num_point_slots + i], g21 = g[4 * num_point_slots + i];
            const REAL g22 = g[5 * num_point_slots + i];
            const REAL a0 = u0[i], a1 = u1[i], a2 = u2[i];
            const REAL b0 = g00 * a0, b1 = g10 * a0 + g11 * a1;
            const REAL b2 = g20 * a0 + g21 * a1 + g22 * a2;
            u0[i] = g00 * b0 + g10 * b1 + g20 * b2;
            u1[i] = g11 * b1 + g21 * b2;
            u2[i] = g22 * b2;
        }
    }
    LANES_MEET();
    const int backward_end = stages & 8 ? tile_runs[tile + 1] : tile_runs[tile];
    for (int run = tile_runs[tile]; run < backward_end; ++run) {
        const int image = run_image[run];
        const int first = run_slots[run];
        const int n = run_length(first, run_slots[run + 1]);
        const image_part_t part =
            load_image_part(x_f, pose_offsets[image], intrinsics_offsets[image]);
        global const ushort* point = slot_point + first;
        global const REAL* j_f = blocks + ROWS * (long)first;
        global const REAL* j_e = j_f + 2 * COLUMNS * n;
        REAL sum[COLUMNS];
#pragma unroll
        for (int k = 0; k < COLUMNS; ++k) sum[k] = 0;
        LANES(l, 0, n) {
            const int i = point[l];
            const REAL z0 = u0[i], z1 = u1[i], z2 = u2[i];
            REAL y0, y1;
            image_product(j_f, n, l, &part, &y0, &y1);
            y0 -= j_e[l] * z0 + j_e[n + l] * z1 + j_e[2 * n + l] * z2;
            y1 -= j_e[3 * n + l] * z0 + j_e[4 * n + l] * z1 + j_e[5 * n + l] * z2;
#pragma unroll
            for (int k = 0; k < COLUMNS; ++k)
                sum[k] += j_f[k * n + l] * y0 + j_f[(COLUMNS + k) * n + l] * y1;
        }
#pragma unroll
        for (int k = 0; k < COLUMNS; ++k) {
            const REAL total = (REAL)GROUP_SUM(sum[k], scratch);
            if (IS_FIRST_LANE) run_sums[COLUMNS * run + k] = total;
        }
    }
}
