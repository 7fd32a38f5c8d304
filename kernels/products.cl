// SPDX-License-Identifier: Apache-2.0
// Products with the Jacobian J = [J_F, J_E] (jacobian.clh): one work-group a tile. Vectors of the F
// side (poses and intrinsics) are WIDE, of the E side (points) 3 rows of REAL over the point slots.
// What a run adds to its image's part of an F vector goes to run_sums, COLUMNS a run from first_sum,
// for reduce_runs to add up in a fixed order.
#include "lanes.clh"
#include "tiles.clh"
#include "jacobian.clh"
#include "positions.clh"

// Where the parameters of images are in an F vector, and what kernels read of images (state.cl).
#define IMAGES                                                                            \
    global const int *restrict pose_offsets, global const int *restrict intrinsics_offsets, \
        global const WIDE *restrict images

// Of run `run` of the tile: its Jacobian, its part of x_f, and its points.
#define RUN(x_f)                                                                            \
    const int image = run_image[run];                                                       \
    const int first = run_slots[run];                                                       \
    const int n = run_length(first, run_slots[run + 1]);                                    \
    const run_t shared = load_run(rows, first, n, images + IMAGE_RECORD * image);            \
    const image_part_t part = load_image_part(x_f, pose_offsets[image], intrinsics_offsets[image]); \
    global const ushort* point = slot_point + first

// y = J_F x_F + J_E x_E.
// Writers: group t alone writes y in the slots of its runs: run by run, 2 rows of its slots.
KERNEL void jx(TILES, IMAGES, global const REAL* restrict rows, global const WIDE* restrict x_f,
               global const REAL* restrict x_e, global REAL* restrict y) {
    const int tile = get_group_id(0);
    global const REAL* xe0 = x_e + tile_points[tile];
    global const REAL* xe1 = xe0 + num_point_slots;
    global const REAL* xe2 = xe1 + num_point_slots;
    for (int run = tile_runs[tile]; run < tile_runs[tile + 1]; ++run) {
        RUN(x_f);
        global REAL* out = y + 2 * (long)first;
        LANES(l, 0, n) {
            const int i = point[l];
            const jacobian_t j = load_jacobian(&shared, l);
            REAL y0, y1;
            jacobian_times(&shared, &j, &part, xe0[i], xe1[i], xe2[i], &y0, &y1);
            out[l] = y0;
            out[n + l] = y1;
        }
    }
}

// x_F = J_F^T y as run_sums, and x_E += J_E^T y.
// Writers: group t alone writes the sums of its runs and x_E of its points.
KERNEL void jty(TILES, global const WIDE* restrict images, global const REAL* restrict rows,
                global const REAL* restrict y, global REAL* restrict x_e,
                global REAL* restrict run_sums, int first_sum, local WIDE* scratch) {
    const int tile = get_group_id(0);
    global REAL* xe0 = x_e + tile_points[tile];
    global REAL* xe1 = xe0 + num_point_slots;
    global REAL* xe2 = xe1 + num_point_slots;
    for (int run = tile_runs[tile]; run < tile_runs[tile + 1]; ++run) {
        const int first = run_slots[run];
        const int n = run_length(first, run_slots[run + 1]);
        const run_t shared = load_run(rows, first, n, images + IMAGE_RECORD * run_image[run]);
        global const ushort* point = slot_point + first;
        global const REAL* in = y + 2 * (long)first;
        REAL sum[COLUMNS];
#pragma unroll
        for (int k = 0; k < COLUMNS; ++k) sum[k] = 0;
        LANES_MEET();
        LANES(l, 0, n) {
            const int i = point[l];
            const jacobian_t j = load_jacobian(&shared, l);
            const REAL y0 = in[l], y1 = in[n + l];
            REAL e[3];
            add_image_transposed(&j, y0, y1, sum);
            point_transposed(&shared, &j, y0, y1, e);
            xe0[i] += e[0];
            xe1[i] += e[1];
            xe2[i] += e[2];
        }
#pragma unroll
        for (int k = 0; k < COLUMNS; ++k) {
            const REAL total = (REAL)GROUP_SUM(sum[k], scratch);
            if (IS_FIRST_LANE) run_sums[first_sum + COLUMNS * run + k] = total;
        }
    }
}

// Stages of the two kernels below. One launch does all of them at once, unless runs of several camera
// models share the points: then the stages up to POINTS must have seen all of them before BACKWARD.
// Barriers stand outside of the stages: PoCL doubles all code behind one that may be passed by.
#define ZERO 1      // u = 0                                  over the tile's points
#define FORWARD 2   // u += J_E^T J_F x                       over its runs
#define POINTS 4    // u <- V^-1 u, or the step of the points over its points
#define BACKWARD 8  // sums of J_F^T (J_F x - J_E u), or the squared norm of J_F x + J_E u: its runs

// The points of the tile in 3 rows of the point slots.
typedef struct {
    global REAL *x, *y, *z;
} rows_t;

static inline rows_t rows_of(global REAL* u, int first, int num_point_slots) {
    rows_t rows;
    rows.x = u + first;
    rows.y = rows.x + num_point_slots;
    rows.z = rows.y + num_point_slots;
    return rows;
}

static inline void zero_points(int num_points, rows_t u) {
    LANES(i, 0, num_points) {
        u.x[i] = 0;
        u.y[i] = 0;
        u.z[i] = 0;
    }
}

static inline void forward_run(const run_t* shared, const image_part_t* part,
                               global const ushort* point, rows_t u) {
    LANES(l, 0, shared->n) {
        const int i = point[l];
        const jacobian_t j = load_jacobian(shared, l);
        REAL y0, y1, e[3];
        image_times(shared, &j, part, &y0, &y1);
        point_transposed(shared, &j, y0, y1, e);
        u.x[i] += e[0];
        u.y[i] += e[1];
        u.z[i] += e[2];
    }
}

// (z0, z1, z2) = V^-1 a = G^T G a of point i, with G in 6 rows.
static inline void apply_point_factor(global const REAL* g, int num_point_slots, int i, REAL a0,
                                      REAL a1, REAL a2, REAL* z0, REAL* z1, REAL* z2) {
    const REAL g00 = g[i], g10 = g[num_point_slots + i], g11 = g[2 * num_point_slots + i];
    const REAL g20 = g[3 * num_point_slots + i], g21 = g[4 * num_point_slots + i];
    const REAL g22 = g[5 * num_point_slots + i];
    const REAL b0 = g00 * a0, b1 = g10 * a0 + g11 * a1;
    const REAL b2 = g20 * a0 + g21 * a1 + g22 * a2;
    *z0 = g00 * b0 + g10 * b1 + g20 * b2;
    *z1 = g11 * b1 + g21 * b2;
    *z2 = g22 * b2;
}

// (J_F^T J_F - W V^-1 W^T) x as run_sums, with W = J_F^T J_E and V^-1 = G^T G.
// Writers: group t alone writes u of its points and the sums of its runs.
KERNEL void schur_product(TILES, int stages, IMAGES, global const REAL* restrict rows,
                          global const WIDE* restrict x_f,
                          global const REAL* restrict point_factors,  // G, 6 rows
                          global REAL* restrict points, global REAL* restrict run_sums,
                          int first_sum, local WIDE* scratch) {
    const int tile = get_group_id(0);
    const int num_points = tile_num_points[tile];
    const rows_t u = rows_of(points, tile_points[tile], num_point_slots);
    if (stages & ZERO) zero_points(num_points, u);
    const int forward_end = stages & FORWARD ? tile_runs[tile + 1] : tile_runs[tile];
    for (int run = tile_runs[tile]; run < forward_end; ++run) {
        RUN(x_f);
        LANES_MEET();
        forward_run(&shared, &part, point, u);
    }
    LANES_MEET();
    if (stages & POINTS) {
        global const REAL* g = point_factors + tile_points[tile];
        LANES(i, 0, num_points) {
            REAL z0, z1, z2;
            apply_point_factor(g, num_point_slots, i, u.x[i], u.y[i], u.z[i], &z0, &z1, &z2);
            u.x[i] = z0;
            u.y[i] = z1;
            u.z[i] = z2;
        }
    }
    LANES_MEET();
    const int backward_end = stages & BACKWARD ? tile_runs[tile + 1] : tile_runs[tile];
    for (int run = tile_runs[tile]; run < backward_end; ++run) {
        RUN(x_f);
        REAL sum[COLUMNS];
#pragma unroll
        for (int k = 0; k < COLUMNS; ++k) sum[k] = 0;
        LANES(l, 0, n) {
            const int i = point[l];
            const jacobian_t j = load_jacobian(&shared, l);
            REAL y0, y1;
            jacobian_times(&shared, &j, &part, -u.x[i], -u.y[i], -u.z[i], &y0, &y1);
            add_image_transposed(&j, y0, y1, sum);
        }
#pragma unroll
        for (int k = 0; k < COLUMNS; ++k) {
            const REAL total = (REAL)GROUP_SUM(sum[k], scratch);
            if (IS_FIRST_LANE) run_sums[first_sum + COLUMNS * run + k] = total;
        }
    }
}

// The step of the points that belongs to the step x of the images, and where it leads:
//   u = -V^-1 (g + W^T x),  trial = points + u,
// and in tile_sums, from first_sum: |J_F x + J_E u|^2, g . u, |u|^2 of each tile.
// Writers: group t alone writes u and trial of its points, and its sums.
KERNEL void back_substitute(TILES, int stages, IMAGES, global const REAL* restrict rows,
                            global const WIDE* restrict x_f,
                            global const REAL* restrict point_factors,   // G, 6 rows
                            global const REAL* restrict point_gradient,  // g, 3 rows
                            global const WIDE* restrict points, global REAL* restrict step,
                            global WIDE* restrict trial, int first_sum,
                            global WIDE* restrict tile_sums, local WIDE* scratch) {
    const int tile = get_group_id(0);
    const int num_points = tile_num_points[tile];
    const rows_t u = rows_of(step, tile_points[tile], num_point_slots);
    if (stages & ZERO) zero_points(num_points, u);
    const int forward_end = stages & FORWARD ? tile_runs[tile + 1] : tile_runs[tile];
    for (int run = tile_runs[tile]; run < forward_end; ++run) {
        RUN(x_f);
        LANES_MEET();
        forward_run(&shared, &part, point, u);
    }
    WIDE slope = 0, step_norm2 = 0;
    LANES_MEET();
    if (stages & POINTS) {
        global const REAL* factor = point_factors + tile_points[tile];
        global const REAL* g = point_gradient + tile_points[tile];
        global const WIDE* at = points + tile_points[tile];
        global WIDE* to = trial + tile_points[tile];
        LANES(i, 0, num_points) {
            const int iy = num_point_slots + i, iz = 2 * num_point_slots + i;
            const int low = 3 * num_point_slots;
            REAL z0, z1, z2;
            apply_point_factor(factor, num_point_slots, i, -g[i] - u.x[i], -g[iy] - u.y[i],
                               -g[iz] - u.z[i], &z0, &z1, &z2);
            u.x[i] = z0;
            u.y[i] = z1;
            u.z[i] = z2;
            move_position(at, to, i, low, z0);
            move_position(at, to, iy, low, z1);
            move_position(at, to, iz, low, z2);
            slope += (WIDE)g[i] * z0 + (WIDE)g[iy] * z1 + (WIDE)g[iz] * z2;
            step_norm2 += (WIDE)z0 * z0 + (WIDE)z1 * z1 + (WIDE)z2 * z2;
        }
    }
    LANES_MEET();
    WIDE moved2 = 0;
    const int backward_end = stages & BACKWARD ? tile_runs[tile + 1] : tile_runs[tile];
    for (int run = tile_runs[tile]; run < backward_end; ++run) {
        RUN(x_f);
        REAL sum = 0;
        LANES(l, 0, n) {
            const int i = point[l];
            const jacobian_t j = load_jacobian(&shared, l);
            REAL y0, y1;
            jacobian_times(&shared, &j, &part, u.x[i], u.y[i], u.z[i], &y0, &y1);
            sum += y0 * y0 + y1 * y1;
        }
        moved2 += sum;
    }
    const WIDE sums[3] = {GROUP_SUM(moved2, scratch), GROUP_SUM(slope, scratch),
                          GROUP_SUM(step_norm2, scratch)};
    if (IS_FIRST_LANE)
        for (int k = 0; k < 3; ++k) tile_sums[3 * (first_sum + tile) + k] = sums[k];
}
