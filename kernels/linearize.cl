// SPDX-License-Identifier: Apache-2.0
// Derivatives at a state: what is kept of the Jacobian (jacobian_layout.clh), the gradient J^T r, the
// diagonal of J_F^T J_F, and V = J_E^T J_E of each point as its Cholesky factor.
// With A = d pixel / d P (2 x 3), whitened and multiplied by sqrt(rho'), the blocks of an
// observation are J_image = [-A [P]_x, A, d pixel / d theta] (2 x C) and J_point = A R (2 x 3), for
// the step R <- exp(w) R, t <- exp(w) t + v.
#define LANE_WIDTH 8
#include "lanes.clh"
#include "tiles.clh"
#include "observation.clh"
#include "jacobian_layout.clh"
#include "point_root.clh"

#ifndef POINT_PRIORS
#define POINT_PRIORS 0  // 1: points have priors
#endif
#if POINT_PRIORS
#include "point_priors.clh"
#endif

#define ZERO 1    // of the sums of a tile
#define RUNS 2    // sums over its runs
#define FINISH 4  // what is made of them; several segments share one FINISH
#define POINT_SUMS 9  // V, or its root with NO_DOUBLE: xx, yx, yy, zx, zy, zz, then J_E^T r

// V = L L^T of a positive semidefinite V: where a pivot is lost to rounding, its column is 0.
static inline void cholesky_root(const WIDE* v, WIDE* l) {
    const WIDE lost = 64 * WIDE_EPSILON;
    l[0] = sqrt(fmax(v[0], (WIDE)0));
    const WIDE inverse0 = l[0] > 0 ? 1 / l[0] : (WIDE)0;
    l[1] = v[1] * inverse0;
    l[3] = v[3] * inverse0;
    const WIDE p1 = v[2] - l[1] * l[1];
    const bool has1 = p1 > lost * v[2];
    l[2] = has1 ? sqrt(p1) : (WIDE)0;
    l[4] = has1 ? (v[4] - l[3] * l[1]) / l[2] : (WIDE)0;
    l[5] = sqrt(fmax(v[5] - l[3] * l[3] - l[4] * l[4], (WIDE)0));
}

#if POINT_PRIORS
// Adds V and J^T r of the priors of a tile's points to their sums.
static inline void add_point_priors(int num_points, int m, global const int* prior_of_slot,
                                    global const WIDE* values, global const WIDE* of_tile,
                                    int num_point_slots, int point_capacity, global WIDE* sums) {
    LANES(i, 0, num_points) {
        const int k = prior_of_slot[i];
        const prior_root_t w = load_prior_root(values, m, k);
        WIDE r0, r1, r2, g0, g1, g2;
        prior_times(&w, prior_offset(values, m, k, of_tile, num_point_slots, i, 0),
                    prior_offset(values, m, k, of_tile, num_point_slots, i, 1),
                    prior_offset(values, m, k, of_tile, num_point_slots, i, 2), &r0, &r1, &r2);
        prior_transposed(&w, r0, r1, r2, &g0, &g1, &g2);
        WIDE v[6];
#pragma unroll
        for (int row = 0; row < 6; ++row) v[row] = sums[row * point_capacity + i];
#ifdef NO_DOUBLE
        add_row_to_root(v, w.w00, 0, 0);
        add_row_to_root(v, w.w10, w.w11, 0);
        add_row_to_root(v, w.w20, w.w21, w.w22);
#else
        v[0] += w.w00 * w.w00 + w.w10 * w.w10 + w.w20 * w.w20;
        v[1] += w.w11 * w.w10 + w.w21 * w.w20;
        v[2] += w.w11 * w.w11 + w.w21 * w.w21;
        v[3] += w.w22 * w.w20;
        v[4] += w.w22 * w.w21;
        v[5] += w.w22 * w.w22;
#endif
#pragma unroll
        for (int row = 0; row < 6; ++row) sums[row * point_capacity + i] = v[row];
        sums[6 * point_capacity + i] += g0;
        sums[7 * point_capacity + i] += g1;
        sums[8 * point_capacity + i] += g2;
    }
}
#endif

// Groups share the tiles out among themselves: group g has tiles g, g + groups, ...
// Writers: the group of a tile alone writes the rows and sums of its runs, and what belongs to its
// points; point_sums holds POINT_SUMS rows of point_capacity a group.
KERNEL void linearize(TILES, int stages, int num_tiles,
                      global const WIDE* restrict xy,         // run by run: 2 rows of its slots
                      global const WIDE* restrict whitening,  // 3 rows of its slots, or NULL
                      global const WIDE* restrict images,     // IMAGE_RECORD an image
                      global const WIDE* restrict points,     // 3 rows a part (positions.clh)
                      WIDE loss_scale,
                      global const WIDE* restrict point_scale,  // 3 rows, 0: constant; or NULL
                      global REAL* restrict rows,
                      global WIDE* restrict run_sums,  // of runs: gradient, then diagonal
                      int first_sum,                   // where they begin, counted in one of the two
                      int point_capacity, global WIDE* restrict point_sums,
                      global REAL* restrict point_roots,     // L of V = L L^T: 6 rows, like V
                      global REAL* restrict point_gradient,  // 3 rows
                      global WIDE* restrict wide_gradient,   // the same unrounded, or NULL
                      int num_priors,
                      global const int* restrict prior_of_slot,  // num_priors: none; or NULL
                      global const WIDE* restrict priors,        // point_priors.clh
                      int first_tile,
                      global WIDE* restrict tile_max,  // of |point_gradient|; inf for NaN
                      local WIDE* scratch) {
    global WIDE* sums = point_sums + (long)POINT_SUMS * point_capacity * get_group_id(0);
    for (int tile = get_group_id(0); tile < num_tiles; tile += get_num_groups(0)) {
        const int num_points = tile_num_points[tile];
        global const WIDE* of_tile = points + tile_points[tile];
        LANES_MEET();
        if (stages & ZERO) {
            for (int k = 0; k < POINT_SUMS; ++k) {
                global WIDE* row = sums + k * point_capacity;
                LANES(i, 0, num_points) row[i] = 0;
            }
        }
        const int runs_end = stages & RUNS ? tile_runs[tile + 1] : tile_runs[tile];
        for (int run = tile_runs[tile]; run < runs_end; ++run) {
            const image_t image = load_image(images + IMAGE_RECORD * run_image[run]);
            const int first = run_slots[run];
            const int n = run_length(first, run_slots[run + 1]);
            global const ushort* point = slot_point + first;
            global const WIDE* observed = xy + 2 * (long)first;
            fetch_next_run(observed + 2 * (long)n, n, 2 * (int)sizeof(WIDE));
#if WHITENED
            global const WIDE* factor = whitening + 3 * (long)first;
#endif
            global REAL* out = rows + ROWS * (long)first;
            WIDE sum[COLUMNS], diagonal[COLUMNS];
#pragma unroll
            for (int k = 0; k < COLUMNS; ++k) sum[k] = diagonal[k] = 0;
            LANES_MEET();
            LANES(l, 0, n) {
                const int i = point[l];
                const view_t p = view(&image, of_tile, num_point_slots, i);
                const bool is_real = i < num_points;
                WIDE rx, ry, d[4], b[2 * CAMERA_PARAMS], kept[CAMERA_KEPT + 1];
#if CAMERA_KEPT
                camera_keep(image.theta, p.u, p.v, kept);
#endif
                camera_pixel_derivatives(image.theta, kept, p.u, p.v, &rx, &ry, d, b);
                rx -= observed[l];
                ry -= observed[n + l];
                // Rows of A, with d(u, v) / dP = scale [1, 0, -sign u; 0, 1, -sign v].
                WIDE a0 = p.scale * d[0], a1 = p.scale * d[1];
                WIDE a2 = -CAMERA_SIGN * p.scale * (d[0] * p.u + d[1] * p.v);
                WIDE c0 = p.scale * d[2], c1 = p.scale * d[3];
                WIDE c2 = -CAMERA_SIGN * p.scale * (d[2] * p.u + d[3] * p.v);
#if WHITENED
                const WIDE l00 = factor[l], l10 = factor[n + l], l11 = factor[2 * n + l];
                ry = l10 * rx + l11 * ry;
                rx = l00 * rx;
                c0 = l10 * a0 + l11 * c0;
                c1 = l10 * a1 + l11 * c1;
                c2 = l10 * a2 + l11 * c2;
                a0 *= l00;
                a1 *= l00;
                a2 *= l00;
#pragma unroll
                for (int k = 0; k < CAMERA_PARAMS; ++k) {
                    b[CAMERA_PARAMS + k] = l10 * b[k] + l11 * b[CAMERA_PARAMS + k];
                    b[k] *= l00;
                }
#endif
                WIDE rho, slope;
                loss(rx * rx + ry * ry, loss_scale, &rho, &slope);
                // The residual is zeroed too: where there is no derivative it adds no gradient.
                const bool has_derivative = is_real && !p.is_singular;
                const WIDE weight = has_derivative ? sqrt(slope) : (WIDE)0;
                rx = is_real ? weight * rx : (WIDE)0;
                ry = is_real ? weight * ry : (WIDE)0;
                a0 *= weight;
                a1 *= weight;
                a2 *= weight;
                c0 *= weight;
                c1 *= weight;
                c2 *= weight;
                WIDE row[COLUMNS], row2[COLUMNS];
                row[0] = p.y * a2 - p.z * a1;
                row[1] = p.z * a0 - p.x * a2;
                row[2] = p.x * a1 - p.y * a0;
                row[3] = a0;
                row[4] = a1;
                row[5] = a2;
                row2[0] = p.y * c2 - p.z * c1;
                row2[1] = p.z * c0 - p.x * c2;
                row2[2] = p.x * c1 - p.y * c0;
                row2[3] = c0;
                row2[4] = c1;
                row2[5] = c2;
#pragma unroll
                for (int k = 0; k < CAMERA_PARAMS; ++k) {
                    row[6 + k] = weight * b[k];
                    row2[6 + k] = weight * b[CAMERA_PARAMS + k];
                }
#pragma unroll
                for (int k = 0; k < COLUMNS; ++k) {
                    sum[k] += row[k] * rx + row2[k] * ry;
                    diagonal[k] += row[k] * row[k] + row2[k] * row2[k];
                }
                const WIDE e0 = a0 * image.r[0] + a1 * image.r[3] + a2 * image.r[6];
                const WIDE e1 = a0 * image.r[1] + a1 * image.r[4] + a2 * image.r[7];
                const WIDE e2 = a0 * image.r[2] + a1 * image.r[5] + a2 * image.r[8];
                const WIDE h0 = c0 * image.r[0] + c1 * image.r[3] + c2 * image.r[6];
                const WIDE h1 = c0 * image.r[1] + c1 * image.r[4] + c2 * image.r[7];
                const WIDE h2 = c0 * image.r[2] + c1 * image.r[5] + c2 * image.r[8];
#if STORED
#pragma unroll
                for (int k = 0; k < COLUMNS; ++k) {
                    out[k * n + l] = (REAL)row[k];
                    out[(COLUMNS + k) * n + l] = (REAL)row2[k];
                }
                out[2 * COLUMNS * n + l] = (REAL)e0;
                out[(2 * COLUMNS + 1) * n + l] = (REAL)e1;
                out[(2 * COLUMNS + 2) * n + l] = (REAL)e2;
                out[(2 * COLUMNS + 3) * n + l] = (REAL)h0;
                out[(2 * COLUMNS + 4) * n + l] = (REAL)h1;
                out[(2 * COLUMNS + 5) * n + l] = (REAL)h2;
#else
                out[l] = has_derivative ? (REAL)p.u : (REAL)0;
                out[n + l] = has_derivative ? (REAL)p.v : (REAL)0;
                out[2 * n + l] = has_derivative ? (REAL)p.scale : (REAL)0;
#if WHITENED
                out[3 * n + l] = (REAL)(weight * l00);
                out[4 * n + l] = (REAL)(weight * l10);
                out[5 * n + l] = (REAL)(weight * l11);
#elif WEIGHT_ROWS
                out[3 * n + l] = (REAL)weight;
#endif
#pragma unroll
                for (int k = 0; k < CAMERA_KEPT; ++k)
                    out[(3 + WEIGHT_ROWS + k) * n + l] = has_derivative ? (REAL)kept[k] : (REAL)0;
#endif
#ifdef NO_DOUBLE
                WIDE root[6];
#pragma unroll
                for (int k = 0; k < 6; ++k) root[k] = sums[k * point_capacity + i];
                add_row_to_root(root, e0, e1, e2);
                add_row_to_root(root, h0, h1, h2);
#pragma unroll
                for (int k = 0; k < 6; ++k) sums[k * point_capacity + i] = root[k];
#else
                sums[i] += e0 * e0 + h0 * h0;
                sums[point_capacity + i] += e1 * e0 + h1 * h0;
                sums[2 * point_capacity + i] += e1 * e1 + h1 * h1;
                sums[3 * point_capacity + i] += e2 * e0 + h2 * h0;
                sums[4 * point_capacity + i] += e2 * e1 + h2 * h1;
                sums[5 * point_capacity + i] += e2 * e2 + h2 * h2;
#endif
                sums[6 * point_capacity + i] += e0 * rx + h0 * ry;
                sums[7 * point_capacity + i] += e1 * rx + h1 * ry;
                sums[8 * point_capacity + i] += e2 * rx + h2 * ry;
            }
            global WIDE* of_run = run_sums + 2 * (first_sum + COLUMNS * (long)run);
#pragma unroll
            for (int k = 0; k < COLUMNS; ++k) {
                const WIDE of_gradient = GROUP_SUM(sum[k], scratch);
                const WIDE of_diagonal = GROUP_SUM(diagonal[k], scratch);
                if (IS_FIRST_LANE) of_run[k] = of_gradient;
                if (IS_FIRST_LANE) of_run[COLUMNS + k] = of_diagonal;
            }
        }
        LANES_MEET();
        WIDE largest = 0;
#if POINT_PRIORS
        // Lane i alone goes on with point i: they need not meet.
        if (stages & FINISH)
            add_point_priors(num_points, num_priors, prior_of_slot + tile_points[tile], priors,
                             of_tile, num_point_slots, point_capacity, sums);
#endif
        if (stages & FINISH) {
            global REAL* roots = point_roots + tile_points[tile];
            global REAL* gradient = point_gradient + tile_points[tile];
            global const WIDE* scale = point_scale ? point_scale + tile_points[tile] : 0;
            LANES(i, 0, num_points) {
                WIDE v[6], root[6];
#pragma unroll
                for (int k = 0; k < 6; ++k) v[k] = sums[k * point_capacity + i];
#ifdef NO_DOUBLE
#pragma unroll
                for (int k = 0; k < 6; ++k) root[k] = v[k];
#else
                cholesky_root(v, root);
#endif
#pragma unroll
                for (int k = 0; k < 6; ++k) roots[k * num_point_slots + i] = (REAL)root[k];
#pragma unroll
                for (int k = 0; k < 3; ++k) {
                    const bool is_free = scale ? scale[k * num_point_slots + i] > 0 : true;
                    const WIDE g = is_free ? sums[(6 + k) * point_capacity + i] : (WIDE)0;
                    gradient[k * num_point_slots + i] = (REAL)g;
                    const WIDE size = g == g ? fabs(g) : (WIDE)INFINITY;
                    largest = size > largest ? size : largest;
                }
            }
        }
        if (stages & FINISH && wide_gradient) {
            global WIDE* gradient = wide_gradient + tile_points[tile];
            global const WIDE* scale = point_scale ? point_scale + tile_points[tile] : 0;
            for (int k = 0; k < 3; ++k) {
                LANES(i, 0, num_points) {
                    const bool is_free = scale ? scale[k * num_point_slots + i] > 0 : true;
                    gradient[k * num_point_slots + i] =
                        is_free ? sums[(6 + k) * point_capacity + i] : (WIDE)0;
                }
            }
        }
        const WIDE most = GROUP_MAX(largest, scratch);
        if (stages & FINISH && IS_FIRST_LANE) tile_max[first_tile + tile] = most;
    }
}
