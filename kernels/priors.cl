// SPDX-License-Identifier: Apache-2.0
// What priors add: those of poses and intrinsics as the sparse symmetric matrix P over the F side,
// which the host makes, those of points one by one (point_priors.clh).
#define LANE_WIDTH 8
#include "lanes.clh"
#include "positions.clh"
#include "point_priors.clh"

// y += P x, P by compressed rows: those that are not empty.
// Writers: one row each.
KERNEL void add_image_product(int num_rows, global const int* restrict rows,
                              global const int* restrict row_begin,
                              global const int* restrict columns,
                              global const WIDE* restrict values, global const WIDE* restrict x,
                              global WIDE* restrict y) {
    const int begin = share_begin(num_rows), end = share_end(num_rows);
    LANES_UNVECTORIZED(i, begin, end) {
        WIDE sum = 0;
        for (int k = row_begin[i]; k < row_begin[i + 1]; ++k) sum += values[k] * x[columns[k]];
        y[rows[i]] += sum;
    }
}

// matrices[targets[k]] += values[sources[k]]; no target twice.
// Writers: one target each.
KERNEL void add_image_blocks(int n, global const int* restrict targets,
                             global const int* restrict sources,
                             global const WIDE* restrict values, global WIDE* restrict matrices) {
    const int begin = share_begin(n), end = share_end(n);
    LANES(k, begin, end) matrices[targets[k]] += values[sources[k]];
}

// 1/2 sum |r|^2 of m priors, one partial a group.
// Writers: partials: one a group.
KERNEL void point_cost(int m, global const int* restrict slots, global const WIDE* restrict values,
                       int n, global const WIDE* restrict points, int first_partial,
                       global WIDE* restrict partials, local WIDE* scratch) {
    const int begin = share_begin(m), end = share_end(m);
    WIDE sum = 0;
    LANES(k, begin, end) {
        const int i = slots[k];
        const prior_root_t w = load_prior_root(values, m, k);
        WIDE r0, r1, r2;
        prior_times(&w, prior_offset(values, m, k, points, n, i, 0),
                    prior_offset(values, m, k, points, n, i, 1),
                    prior_offset(values, m, k, points, n, i, 2), &r0, &r1, &r2);
        sum += r0 * r0 + r1 * r1 + r2 * r2;
    }
    const WIDE total = GROUP_SUM(sum, scratch);
    if (IS_FIRST_LANE) partials[first_partial + get_group_id(0)] = (WIDE)0.5 * total;
}

// sum |W u|^2 for steps u, 3 rows of n.
// Writers: partials: one a group.
KERNEL void point_squared_norm(int m, global const int* restrict slots,
                               global const WIDE* restrict values, int n,
                               global const REAL* restrict steps, int first_partial,
                               global WIDE* restrict partials, local WIDE* scratch) {
    const int begin = share_begin(m), end = share_end(m);
    WIDE sum = 0;
    LANES(k, begin, end) {
        const int i = slots[k];
        const prior_root_t w = load_prior_root(values, m, k);
        WIDE r0, r1, r2;
        prior_times(&w, steps[i], steps[n + i], steps[2 * n + i], &r0, &r1, &r2);
        sum += r0 * r0 + r1 * r1 + r2 * r2;
    }
    const WIDE total = GROUP_SUM(sum, scratch);
    if (IS_FIRST_LANE) partials[first_partial + get_group_id(0)] = total;
}

// y += W^T W x, 3 rows of n.
// Writers: one point each.
KERNEL void add_point_product(int m, global const int* restrict slots,
                              global const WIDE* restrict values, int n,
                              global const WIDE* restrict x, global WIDE* restrict y) {
    const int begin = share_begin(m), end = share_end(m);
    LANES(k, begin, end) {
        const int i = slots[k];
        const prior_root_t w = load_prior_root(values, m, k);
        WIDE r0, r1, r2, y0, y1, y2;
        prior_times(&w, x[i], x[n + i], x[2 * n + i], &r0, &r1, &r2);
        prior_transposed(&w, r0, r1, r2, &y0, &y1, &y2);
        y[i] += y0;
        y[n + i] += y1;
        y[2 * n + i] += y2;
    }
}
